//! The stage driver: homing, moves, lamp and status over a [`Link`].

mod connect;
mod stop;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use self::stop::GrblStop;
use super::codes;
use super::link::{HOLD, Link, RESET, STATUS};
use super::protocol::{
    Accessories, Code, Dialect, MachineState, Reply, Spindle, StatusReport, effect_of,
};
use super::{GrblConfig, axis_index};
use crate::device::guardian::{Exchange, PortStop};
use crate::device::kinematics::Pose;
use crate::device::{
    AlarmCause, DeviceError, FirmwareFault, LampChannel, LampState, LightStage, StageActivity,
    StageInfo, StageStatus, StageStep, StopHandle,
};
use crate::units::StageAngles;

pub use self::stop::stop_port;

/// A stage is lost after this many status requests without an answer.
const STATUS_ATTEMPTS: u32 = 3;
/// Status reports until one has the outputs: GRBL sends them in every tenth at
/// the latest, one later if the offset's turn comes first.
const REPORTS_WITH_OUTPUTS: u32 = 12;
/// Longest pause between two looks at a move.
const POLL_PAUSE: Duration = Duration::from_millis(50);
/// Standing still elsewhere than at the target for this long ends a move: right
/// after a command GRBL may report idle before it starts.
const START_GRACE: Duration = Duration::from_millis(500);
/// How long a controller that took no command may take to say what it does.
const STATE_PATIENCE: Duration = Duration::from_millis(300);
/// GRBL's line buffer holds 80 characters.
const LONGEST_COMMAND: usize = 79;

/// In a banner, also of builds with a name of their own.
const BANNERS: &[&[u8]] = &[b"Grbl", b"for help]"];
/// In a report of a controller that does not move.
const STANDING: &[&[u8]] = &[
    b"<Idle",
    b"<Alarm",
    b"<ConfigAlarm",
    b"<Sleep",
    b"<Hold:0",
    b"<Door:0",
    b"<Door:1",
];

/// A light stage with a GRBL 1.1 controller.
///
/// Dropping it turns the lamp off and ends any motion.
pub struct GrblStage {
    config: GrblConfig,
    link: Arc<Link>,
    info: StageInfo,
    settings: BTreeMap<u16, f64>,
    /// The lamp by the firmware's last word on it; `None` if it said nothing.
    lamp: Option<LampState>,
    /// A command that moves the stage is under way.
    in_motion: bool,
    /// The firmware has spoken: before, there is nothing to turn off.
    is_alive: bool,
}

impl GrblStage {
    /// Opens the port and asks the controller what it is. Nothing moves. The
    /// position is unknown until [`home`](LightStage::home).
    pub fn open(config: GrblConfig) -> Result<Self, DeviceError> {
        let link = Arc::new(Link::open(&config.port, config.baud)?);
        let info = StageInfo {
            driver: "grbl".to_owned(),
            firmware: String::new(),
            port: config.port.clone(),
            has_watchdog: false,
        };
        let mut stage = Self {
            config,
            link,
            info,
            settings: BTreeMap::new(),
            lamp: None,
            in_motion: false,
            is_alive: false,
        };
        stage.check_config()?;
        stage.wait_until_alive()?;
        stage.is_alive = true;
        stage.identify()?;
        stage.lamp = stage.read_lamp()?;
        // What has no position is refused before it moves.
        stage.report_with_position()?;
        Ok(stage)
    }

    fn check_config(&self) -> Result<(), DeviceError> {
        for letter in self.config.axes {
            if axis_index(letter).is_none() {
                return Err(self.refused(&letter.to_string(), "not one of the axes XYZABC"));
            }
        }
        Ok(())
    }

    fn setting(&self, number: u16) -> Option<f64> {
        self.settings.get(&number).copied()
    }

    fn reply_timeout(&self) -> Duration {
        self.config.reply_timeout.to_duration()
    }

    fn refused(&self, command: &str, reason: &str) -> DeviceError {
        self.link.line().refused(command, reason)
    }

    fn alarm(&self, (cause, reason): (AlarmCause, String)) -> DeviceError {
        DeviceError::Alarm {
            device: self.link.line().device().to_owned(),
            cause,
            reason,
        }
    }

    fn alarm_of(&self, code: &Code) -> DeviceError {
        let dialect = self.link.known().dialect;
        self.alarm(codes::alarm(dialect, code))
    }

    /// Why the firmware refused a line.
    fn refused_for(&self, line: &str, code: &Code) -> DeviceError {
        let dialect = self.link.known().dialect;
        let reason = codes::error(dialect, code);
        let command = line.to_owned();
        let fault = match code {
            // Alarms in all but name.
            Code::Number(45) => return self.alarm((AlarmCause::LimitSwitch, reason)),
            Code::Number(46) => return self.alarm((AlarmCause::HomingRequired, reason)),
            Code::Number(50) => return self.alarm((AlarmCause::EmergencyStop, reason)),
            Code::Number(40) if dialect == Dialect::FluidNc => {
                return self.alarm((AlarmCause::EmergencyStop, reason));
            }
            Code::Number(13) => FirmwareFault::Door(1),
            Code::Number(5) => FirmwareFault::HomingDisabled { command },
            Code::Number(18) if line == "$H" => FirmwareFault::NothingToHome { command },
            Code::Number(20) => FirmwareFault::Unsupported { command, reason },
            Code::Number(152) => FirmwareFault::Configuration(reason),
            Code::Text(_) if reason.to_ascii_lowercase().contains("unsupported") => {
                FirmwareFault::Unsupported { command, reason }
            }
            _ => return self.refused(line, &reason),
        };
        self.link.firmware(fault)
    }

    /// An error where the controller takes no commands in this state.
    fn check_open(&self, state: MachineState) -> Result<(), DeviceError> {
        Err(self.link.firmware(match state {
            MachineState::Door(step) => FirmwareFault::Door(step),
            MachineState::Hold(step) => FirmwareFault::Held(step),
            MachineState::Sleep => FirmwareFault::Asleep,
            MachineState::ConfigAlarm => FirmwareFault::Configuration("ConfigAlarm".to_owned()),
            _ => return Ok(()),
        }))
    }

    /// What a controller that did not answer a line says of its state, if anything.
    fn check_open_after_silence(&self) -> Result<(), DeviceError> {
        self.link.send(&[STATUS])?;
        let deadline = Instant::now() + STATE_PATIENCE;
        while let Some(reply) = self.link.receive(deadline)? {
            if let Reply::Status(report) = reply {
                return self.check_open(report.state);
            }
        }
        Ok(())
    }

    fn not_homed(&self, since: String) -> DeviceError {
        DeviceError::NotHomed {
            device: self.link.line().device().to_owned(),
            since,
        }
    }

    fn check_homed(&self) -> Result<(), DeviceError> {
        match self.link.known().unhomed_since.clone() {
            Some(since) => Err(self.not_homed(since)),
            None => Ok(()),
        }
    }

    /// Sends a line and returns what came before its `ok`.
    pub(super) fn command(&self, line: &str, timeout: Duration) -> Result<Vec<Reply>, DeviceError> {
        let printable = line.bytes().all(|byte| (b' '..=b'~').contains(&byte));
        if line.len() > LONGEST_COMMAND || !printable {
            return Err(self.refused(line, "not a line of at most 79 printable characters"));
        }
        tracing::trace!(device = self.link.line().device(), line, "sent");
        let restarts = self.link.known().restarts;
        // Late answers to something else would count as this line's.
        while self.link.receive(Instant::now())?.is_some() {}
        self.check_restart(restarts)?;
        self.link.send(format!("{line}\n").as_bytes())?;
        let deadline = Instant::now() + timeout;
        let mut replies = Vec::new();
        let mut damaged = None;
        while let Some(reply) = self.link.receive(deadline)? {
            match reply {
                Reply::Ok => return Ok(replies),
                // Locked out.
                Reply::Error(Code::Number(9)) => return Err(self.alarm(self.reason_of_lock())),
                Reply::Error(code) => return Err(self.refused_for(line, &code)),
                Reply::Alarm(code) => return Err(self.alarm_of(&code)),
                // An echo, or what a build says in its own way; an answer may follow.
                Reply::Unknown(text) => damaged = Some(text),
                Reply::Status(_)
                | Reply::OldStatus(_)
                | Reply::Empty
                | Reply::StartupLine
                | Reply::Banner { .. } => {}
                Reply::Setting { .. } | Reply::Info { .. } => replies.push(reply),
            }
            self.check_restart(restarts)?;
        }
        // Another reader (a stop) may have taken the banner.
        self.check_restart(restarts)?;
        self.check_open_after_silence()?;
        Err(match damaged {
            Some(text) => self.link.garbled(&text, "ok or error:N"),
            None => self.link.no_reply(line.as_bytes(), timeout),
        })
    }

    fn reason_of_lock(&self) -> (AlarmCause, String) {
        let alarm = self.link.known().alarm.clone();
        alarm.unwrap_or_else(|| {
            let reason = "locked until it is homed".to_owned();
            (AlarmCause::HomingRequired, reason)
        })
    }

    /// An error if the firmware has restarted since it had restarted `before` times.
    fn check_restart(&self, before: u64) -> Result<(), DeviceError> {
        let known = self.link.known();
        if known.restarts == before {
            return Ok(());
        }
        let since = known.unhomed_since.clone();
        drop(known);
        Err(self.not_homed(since.unwrap_or_else(|| "the firmware restarted".to_owned())))
    }

    /// A fresh status report. It has no side effects, so it is requested again
    /// when the answer is lost or damaged.
    fn report(&self) -> Result<StatusReport, DeviceError> {
        let restarts = self.link.known().restarts;
        let mut damaged = None;
        let slice = self.reply_timeout() / STATUS_ATTEMPTS;
        for _ in 0..STATUS_ATTEMPTS {
            self.link.send(&[STATUS])?;
            let deadline = Instant::now() + slice;
            while let Some(reply) = self.link.receive(deadline)? {
                match reply {
                    Reply::Status(report) => return Ok(report),
                    Reply::Alarm(code) => return Err(self.alarm_of(&code)),
                    Reply::OldStatus(_) => return Err(self.old_by_status()),
                    Reply::Unknown(text) => {
                        damaged = Some(text);
                        break;
                    }
                    _ => self.check_restart(restarts)?,
                }
            }
            self.check_restart(restarts)?;
        }
        Err(match damaged {
            Some(text) => self.link.garbled(&text, "a GRBL status report"),
            None => self.link.no_reply(&[STATUS], self.reply_timeout()),
        })
    }

    /// A report that says where the axes are: GRBL set to report work positions
    /// sends the offset only now and then.
    fn report_with_position(&self) -> Result<(StatusReport, Pose), DeviceError> {
        for _ in 0..=30 {
            let report = self.report()?;
            let offset = self.link.known().work_offset.clone();
            if let Some(axes) = report.machine_position(offset.as_deref()) {
                let pose = self.pose_of(&axes)?;
                return Ok((report, pose));
            }
        }
        Err(self.link.firmware(FirmwareFault::NoPosition))
    }

    fn pose_of(&self, axes: &[f64]) -> Result<Pose, DeviceError> {
        let mut pose = Pose([0.0; 2]);
        let maps = self.config.kinematics.axes();
        for ((value, map), letter) in pose.0.iter_mut().zip(maps).zip(self.config.axes) {
            let position = axis_index(letter).and_then(|index| axes.get(index));
            let Some(&position) = position else {
                let axes = axes.len();
                return Err(self.link.firmware(FirmwareFault::NoAxis { axes, letter }));
            };
            *value = map.coordinate(position);
        }
        Ok(pose)
    }

    /// Drives in a straight line and waits until the stage stands there.
    fn drive(&mut self, from: Pose, to: Pose) -> Result<Pose, DeviceError> {
        // The command, and how long it may take.
        let [first, second] = self.config.kinematics.axes();
        let line = format!(
            "G21 G90 G94 G53 G1 {}{:.4} {}{:.4} F{:.1}",
            self.config.axes[0],
            first.position(to.0[0]),
            self.config.axes[1],
            second.position(to.0[1]),
            self.config.feed_per_min,
        );
        let expected = self.duration(from, to);
        // Twice what it should take, and something for the firmware itself.
        let timeout = 2 * expected + self.reply_timeout() + Duration::from_secs(1);
        let restarts = self.link.known().restarts;
        self.check_homed()?;
        self.in_motion = true;
        self.command(&line, self.reply_timeout())?;
        // Status reports until the stage stands.
        let start = Instant::now();
        let mut pause = Duration::from_millis(1);
        let mut idle_elsewhere: Option<Instant> = None;
        loop {
            let (report, pose) = self.report_with_position()?;
            // Whoever reads the banner, the move is over.
            self.check_restart(restarts)?;
            let off_deg = self.config.kinematics.distance_deg(pose, to);
            let arrived = off_deg <= self.config.position_tolerance_deg;
            match report.state {
                MachineState::Idle if arrived => {
                    self.in_motion = false;
                    return Ok(pose);
                }
                MachineState::Idle => {
                    let since = *idle_elsewhere.get_or_insert_with(Instant::now);
                    if since.elapsed() > START_GRACE {
                        self.in_motion = false;
                        return Err(self.not_applied("position", pose, to));
                    }
                }
                MachineState::Alarm => return Err(self.alarm(self.reason_of_lock())),
                // Whoever holds it at the machine may let it go on, in time.
                MachineState::Run | MachineState::Hold(_) | MachineState::Door(_) => {
                    idle_elsewhere = None;
                }
                state => {
                    return Err(self.refused(&line, &format!("the controller is in state {state}")));
                }
            }
            if start.elapsed() > timeout {
                self.link.forget_position("a move did not end in time");
                let what = match self.check_open(report.state) {
                    Ok(()) => "position".to_owned(),
                    Err(_) => format!("position (in state {})", report.state),
                };
                return Err(self.not_applied(&what, pose, to));
            }
            std::thread::sleep(pause);
            pause = (2 * pause).min(POLL_PAUSE);
        }
    }

    fn not_applied(&self, what: &str, is: Pose, wanted: Pose) -> DeviceError {
        let text = |pose| self.config.kinematics.angles(pose).to_string();
        DeviceError::NotApplied {
            device: self.link.line().device().to_owned(),
            what: what.to_owned(),
            is: text(is),
            wanted: text(wanted),
        }
    }

    /// How long a straight move takes: at the feed, but no axis faster than its
    /// $110 (units/min), with ramps of $120 (units/s²).
    fn duration(&self, from: Pose, to: Pose) -> Duration {
        let maps = self.config.kinematics.axes();
        let ways = [0, 1].map(|i| {
            let way = (to.0[i] - from.0[i]) * maps[i].scale;
            (axis_index(self.config.axes[i]).unwrap_or(0), way.abs())
        });
        let length = ways[0].1.hypot(ways[1].1);
        if length == 0.0 {
            return Duration::ZERO;
        }
        let limit = |first_setting: u16, unlimited: f64| {
            ways.iter()
                .filter(|(_, way)| *way > 0.0)
                .filter_map(|(index, way)| {
                    let of_axis = self.setting(first_setting + *index as u16)?;
                    (of_axis > 0.0).then_some(of_axis * length / way)
                })
                .fold(unlimited, f64::min)
        };
        let speed = limit(110, self.config.feed_per_min) / 60.0;
        let acceleration = limit(120, f64::INFINITY);
        let seconds = length / speed + speed / acceleration;
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::from_secs(600))
    }

    /// The lamp by the outputs that the firmware reports; `None` if it does not
    /// report them or they are none of the configured states.
    fn read_lamp(&self) -> Result<Option<LampState>, DeviceError> {
        self.link.known().accessories = None;
        for _ in 0..REPORTS_WITH_OUTPUTS {
            self.report()?;
            if self.link.known().accessories.is_some() {
                break;
            }
        }
        Ok(self.lamp_by_outputs())
    }

    fn lamp_by_outputs(&self) -> Option<LampState> {
        let known = self.link.known();
        let outputs = known.accessories?;
        let states = std::iter::once(LampState::Off).chain(
            (0..self.config.lamp_on.len()).map(|channel| LampState::On(LampChannel(channel as u8))),
        );
        states.into_iter().find(|&state| {
            let (expected, speed) = self.outputs_of(state);
            let same_speed = match (speed, known.speed) {
                (Some(wanted), Some(is)) => (wanted - is).abs() <= 0.5,
                _ => true,
            };
            expected == outputs && same_speed
        })
    }

    /// A controller that is locked takes no lamp command, and one that has just
    /// restarted has its outputs off; if not, a restart turns them off.
    fn lamp_off_while_locked(&mut self) -> Result<LampState, DeviceError> {
        if !matches!(self.read_lamp(), Ok(Some(LampState::Off))) {
            let timeout = self.config.connect_timeout.to_duration();
            self.link
                .restart(true, "it was restarted to turn the lamp off", timeout)?;
            stop::confirm_stopped(&self.link)?;
        }
        self.lamp = Some(LampState::Off);
        Ok(LampState::Off)
    }

    fn commands_of(&self, lamp: LampState) -> Result<Vec<String>, DeviceError> {
        let mut commands = self.config.lamp_off.clone();
        if let LampState::On(LampChannel(channel)) = lamp {
            let on = self
                .config
                .lamp_on
                .get(usize::from(channel))
                .ok_or_else(|| {
                    let channels = self.config.lamp_on.len();
                    self.refused(
                        &format!("lamp channel {channel}"),
                        &format!("the lamp has {channels} channels, counted from 0"),
                    )
                })?;
            commands.extend(on.iter().cloned());
        }
        Ok(commands)
    }

    fn outputs_of(&self, lamp: LampState) -> (Accessories, Option<f64>) {
        effect_of(&self.commands_of(lamp).unwrap_or_default())
    }
}

/// The outputs, and the speed of a spindle that is on.
fn with_speed(outputs: Accessories, speed: Option<f64>) -> String {
    match speed {
        Some(speed) if outputs.spindle != Spindle::Off => format!("{outputs} at S{speed}"),
        _ => outputs.to_string(),
    }
}

fn activity(state: MachineState) -> StageActivity {
    match state {
        MachineState::Idle | MachineState::Check => StageActivity::Idle,
        MachineState::Run | MachineState::Jog => StageActivity::Moving,
        MachineState::Home => StageActivity::Homing,
        MachineState::Hold(0) | MachineState::Door(0 | 1) => StageActivity::Held,
        // It still brakes, or goes on.
        MachineState::Hold(_) | MachineState::Door(_) => StageActivity::Moving,
        MachineState::Alarm | MachineState::Sleep | MachineState::ConfigAlarm => {
            StageActivity::Alarm
        }
    }
}

impl LightStage for GrblStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        self.link.forget_position("homing began");
        self.link.drain()?;
        let reset = || -> Result<(), DeviceError> {
            let timeout = self.config.connect_timeout.to_duration();
            self.link
                .restart(false, "it was reset before homing", timeout)?;
            self.link.drain()
        };
        if self.link.known().needs_reset {
            reset()?;
        }
        // A reset ends a hold and a sleep, and the wait after a door that is closed again.
        if self.check_open(self.report()?.state).is_err() {
            reset()?;
            self.check_open(self.report()?.state)?;
        }
        self.in_motion = true;
        let homed = self.command("$H", self.config.homing_timeout.to_duration());
        // What is refused did not begin.
        self.in_motion = !matches!(homed, Ok(_) | Err(DeviceError::Firmware { .. }));
        homed?;
        let mut known = self.link.known();
        known.alarm = None;
        known.needs_reset = false;
        known.unhomed_since = None;
        drop(known);
        self.status()
    }

    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        let kinematics = self.config.kinematics;
        let device = self.link.line().device().to_owned();
        let wanted = kinematics
            .solve(target)
            .ok_or_else(|| DeviceError::OutOfReach {
                device,
                target,
                limits: kinematics.limits(),
            })?;
        self.check_homed()?;
        let (report, from) = self.report_with_position()?;
        self.check_open(report.state)?;
        if report.state != MachineState::Idle {
            let reason = format!("the controller is in state {}", report.state);
            return Err(self.refused("move", &reason));
        }
        let mut at = from;
        if let Some(start) = kinematics.approach(at, wanted) {
            at = self.drive(at, start)?;
        }
        let reached = self.drive(at, wanted)?;
        Ok(kinematics.angles_like(target, wanted, reached))
    }

    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        let commands = self.commands_of(lamp)?;
        self.lamp = None;
        for command in &commands {
            match self.command(command, self.reply_timeout()) {
                Ok(_) => {}
                Err(DeviceError::Alarm { .. } | DeviceError::NotHomed { .. })
                    if lamp == LampState::Off =>
                {
                    return self.lamp_off_while_locked();
                }
                Err(error) => return Err(error),
            }
        }
        let (expected, speed) = self.outputs_of(lamp);
        self.lamp = self.read_lamp()?;
        let known = self.link.known().clone();
        match (self.lamp, known.accessories) {
            (Some(is), _) if is == lamp => Ok(lamp),
            // This build never reports its outputs: `ok` is all there is.
            (_, None) => {
                self.lamp = Some(lamp);
                Ok(lamp)
            }
            (_, Some(outputs)) => Err(DeviceError::NotApplied {
                device: self.link.line().device().to_owned(),
                what: "the lamp's outputs".to_owned(),
                is: with_speed(outputs, known.speed),
                wanted: format!("{} ({})", with_speed(expected, speed), commands.join("; ")),
            }),
        }
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        let (report, pose) = self.report_with_position()?;
        self.lamp = self.lamp_by_outputs().or(self.lamp);
        let homed = self.link.known().unhomed_since.is_none();
        Ok(StageStatus {
            activity: activity(report.state),
            position: homed.then(|| self.config.kinematics.angles(pose)),
            lamp: self.lamp,
        })
    }

    fn reports_lamp(&self) -> bool {
        self.link.known().reports_outputs
    }

    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        Ok(Box::new(GrblStop {
            link: Arc::downgrade(&self.link),
            timeout: self
                .config
                .connect_timeout
                .to_duration()
                .min(stop::RESTARTED),
        }))
    }

    fn port_stop(&self) -> Result<Option<PortStop>, DeviceError> {
        Ok(Some(PortStop {
            port: self.link.line().duplicate()?,
            name: self.config.port.clone(),
            exchanges: vec![
                Exchange::new(&[HOLD], &[]),
                Exchange::new(&[RESET], BANNERS),
                Exchange::new(&[STATUS], STANDING),
            ],
            reports_lamp: self.reports_lamp(),
            gate: self.link.line().gate(),
        }))
    }

    fn longest(&self, step: StageStep) -> Duration {
        let reply = self.reply_timeout();
        let [from, to] = self.config.kinematics.whole_travel();
        let whole = self.duration(from, to);
        let homing = self.config.homing_timeout.to_duration();
        match step {
            StageStep::Move => step.longest(homing, whole, reply, 2) + reply,
            step => step.longest(homing, whole, reply, 2),
        }
    }
}

impl Drop for GrblStage {
    fn drop(&mut self) {
        let known = self.link.known().clone();
        let is_off = self.lamp == Some(LampState::Off) && !known.needs_reset;
        if !self.is_alive || (is_off && !self.in_motion) {
            return;
        }
        // Silent since it was reset, it takes no command either.
        let takes_commands = !self.in_motion && !known.needs_reset;
        let turned_off = takes_commands && self.set_lamp(LampState::Off).is_ok();
        if !turned_off {
            // The firmware's restart ends motion and turns all outputs off.
            let timeout = match known.needs_reset {
                true => STATE_PATIENCE,
                false => self.reply_timeout(),
            };
            let _ = self.link.restart(true, "its driver ended", timeout);
        }
    }
}
