//! What the firmware reports when asked.

use super::firmware::{Firmware, Mode};
use super::gcode::{Coolant, Motion, Spindle};
use super::planner::CAPACITY;
use crate::motion::Position;

/// Bytes of the receive buffer.
pub(super) const RX_BYTES: usize = 128;

/// Status reports between two that carry WCO (or Ov): standing, moving.
const WCO_EVERY: [u32; 2] = [10, 30];
const OV_EVERY: [u32; 2] = [10, 20];

/// When the fields that do not come with every report are next due.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Refresh {
    wco: u32,
    ov: u32,
}

impl Refresh {
    pub(super) fn wco_changed(&mut self) {
        self.wco = 0;
    }
}

impl Firmware {
    fn axes(&self, values: Position) -> String {
        let scale = self.report_scale();
        values
            .map(|value| {
                let decimals = if self.config.settings.report_inches {
                    4
                } else {
                    3
                };
                // No negative zero: the firmware counts steps.
                format!("{:.decimals$}", value * scale + 0.0)
            })
            .map(|text| {
                if text.trim_start_matches(['-', '0', '.']).is_empty() {
                    text.trim_start_matches('-').to_owned()
                } else {
                    text
                }
            })
            .join(",")
    }

    fn report_scale(&self) -> f64 {
        if self.config.settings.report_inches {
            1.0 / 25.4
        } else {
            1.0
        }
    }

    fn state_name(&self, now_s: f64) -> &'static str {
        match self.mode {
            Mode::Normal if self.planner.is_empty() => "Idle",
            Mode::Normal if self.planner.is_braking(now_s) => "Hold:1",
            Mode::Normal if self.planner.is_jogging() => "Jog",
            Mode::Normal => "Run",
            Mode::Hold if self.planner.is_braking(now_s) => "Hold:1",
            Mode::Hold => "Hold:0",
            Mode::JogCancel => "Jog",
            Mode::Home { .. } => "Home",
            Mode::Alarm | Mode::Critical => "Alarm",
            Mode::Check => "Check",
            Mode::Sleep => "Sleep",
        }
    }

    /// The line that answers `?`.
    pub(super) fn status_report(&mut self, now_s: f64) -> String {
        // State and position.
        let settings = &self.config.settings;
        let machine = self.planner.position(now_s);
        let wco = self.work_offset();
        let shown = if settings.status_mask & 1 == 1 {
            format!("MPos:{}", self.axes(machine))
        } else {
            let work = std::array::from_fn(|axis| machine[axis] - wco[axis]);
            format!("WPos:{}", self.axes(work))
        };
        let mut state = self.state_name(now_s).to_owned();
        if self.config.hal && state == "Alarm" {
            // Without an alarm the lock is alarm 11, homing required.
            state += &format!(":{}", self.bench.alarm().unwrap_or(11));
        }
        let mut text = format!("<{state}|{shown}");
        // Buffers, speeds, switches.
        if settings.status_mask & 2 == 2 {
            let blocks = self.planner.free();
            text += &format!("|Bf:{blocks},{}", RX_BYTES - self.rx.len().min(RX_BYTES));
        }
        let rate = self.planner.speed(now_s) * 60.0 * self.report_scale();
        text += &format!("|FS:{rate:.0},{:.0}", self.outputs.speed);
        let pins = self.limit_pins();
        if !pins.is_empty() {
            text += &format!("|Pn:{pins}");
        }
        // Offsets and accessories, every so many reports.
        let busy = usize::from(
            !matches!(
                self.mode,
                Mode::Normal | Mode::Alarm | Mode::Critical | Mode::Check | Mode::Sleep
            ) || !self.planner.is_empty(),
        );
        if self.refresh.wco > 0 {
            self.refresh.wco -= 1;
        } else {
            self.refresh.wco = WCO_EVERY[busy] - 1;
            // The overrides wait for the next report.
            self.refresh.ov = self.refresh.ov.max(1);
            text += &format!("|WCO:{}", self.axes(wco));
        }
        if self.refresh.ov > 0 {
            self.refresh.ov -= 1;
        } else {
            self.refresh.ov = OV_EVERY[busy] - 1;
            text += "|Ov:100,100,100";
            let outputs = &self.outputs;
            let mut accessories = String::new();
            if outputs.speed > 0.0 {
                accessories.push(match outputs.spindle {
                    Spindle::Counterclockwise => 'C',
                    _ => 'S',
                });
            }
            if outputs.flood {
                accessories.push('F');
            }
            if outputs.mist {
                accessories.push('M');
            }
            if !accessories.is_empty() {
                text += &format!("|A:{accessories}");
            }
            if self.config.hal {
                let homed = u8::from(self.bench.is_homed());
                text += &format!("|SD:Pending|H:{homed},3|TLR:0|FW:grblHAL");
            }
        }
        text + ">\r\n"
    }

    /// The line of `$G`.
    pub(super) fn modes(&self) -> String {
        let modal = &self.modal;
        let motion = match modal.motion {
            Motion::Seek => "0",
            Motion::Feed => "1",
            Motion::None => "80",
        };
        let spindle = match modal.spindle {
            Spindle::Clockwise => 3,
            Spindle::Counterclockwise => 4,
            Spindle::Off => 5,
        };
        let coolant = match (modal.mist, modal.flood) {
            (false, false) => "M9",
            (true, false) => "M7",
            (false, true) => "M8",
            (true, true) => "M7 M8",
        };
        let scale = if modal.inches { 1.0 / 25.4 } else { 1.0 };
        format!(
            "[GC:G{motion} G{} G{} G{} G{} G94 M{spindle} {coolant} T{:.0} F{:.0} S{:.0}]\r\n",
            54 + modal.coordinates,
            modal.plane,
            if modal.inches { 20 } else { 21 },
            if modal.relative { 91 } else { 90 },
            modal.tool,
            modal.feed * scale,
            modal.speed,
        )
    }

    /// The lines of `$#`.
    pub(super) fn parameters(&self) -> String {
        let mut text = String::new();
        for (index, offset) in self.offsets.iter().enumerate() {
            text += &format!("[G{}:{}]\r\n", 54 + index, self.axes(*offset));
        }
        for name in ["G28", "G30"] {
            text += &format!("[{name}:{}]\r\n", self.axes([0.0; 3]));
        }
        text += &format!("[G92:{}]\r\n", self.axes(self.modal.shift));
        text += "[TLO:0.000]\r\n";
        text += &format!("[PRB:{}:0]\r\n", self.axes([0.0; 3]));
        text
    }

    /// The lines of `$I`.
    pub(super) fn build_info(&self) -> String {
        let name = match self.config.host_watchdog_s {
            Some(seconds) if self.build_name.is_empty() => format!("host-watchdog={seconds}"),
            _ => self.build_name.clone(),
        };
        let zero = if self.config.zero_at_home { "Z" } else { "" };
        if self.config.hal {
            return format!(
                "[VER:1.1f.20250110:{name}]\r\n[OPT:VNM{zero}SL,{CAPACITY},{RX_BYTES},3,0]\r\n\
                 [AXS:3:XYZ]\r\n[NEWOPT:ENUMS,RT-,HOME]\r\n[FIRMWARE:grblHAL]\r\n[NVS STORAGE:*EEPROM 2K]\r\n"
            );
        }
        format!("[VER:1.1h.20190830:{name}]\r\n[OPT:VM{zero},{CAPACITY},{RX_BYTES}]\r\n")
    }

    pub(super) fn apply_coolant(mist: &mut bool, flood: &mut bool, coolant: Coolant) {
        match coolant {
            Coolant::Mist => *mist = true,
            Coolant::Flood => *flood = true,
            Coolant::Off => (*mist, *flood) = (false, false),
        }
    }
}
