//! The firmware's state machine: bytes and time in, answers and motion out.

use super::GrblConfig;
use super::LampPin;
use super::faults::Cause;
use super::gcode::Spindle;
use super::interpreter::Modal;
use super::planner::Planner;
use super::report::{RX_BYTES, Refresh};
use crate::bench::Bench;
use crate::motion::{Piece, Position};
use std::collections::VecDeque;

/// Characters of a line that are kept; a longer line is refused (error 11).
const LINE_LENGTH: usize = 79;

/// The pause after an alarm message, seconds.
const ALARM_PAUSE_S: f64 = 0.5;

const BANNER: &str = "\r\nGrbl 1.1h ['$' for help]\r\n";
const HAL_BANNER: &str = "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n";
const UNLOCK: &str = "[MSG:'$H'|'$X' to unlock]\r\n";

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Mode {
    /// Idle, Run or Jog, by what the planner does.
    Normal,
    Hold,
    JogCancel,
    Home {
        start_s: f64,
        end_s: f64,
        fails: bool,
    },
    Alarm,
    /// An alarm that only a reset ends, deaf to all else.
    Critical,
    Check,
    Sleep,
}

/// The pins.
#[derive(Clone, Debug)]
pub(super) struct Outputs {
    pub spindle: Spindle,
    /// S as limited by $30 and $31; 0 when off.
    pub speed: f64,
    pub flood: bool,
    pub mist: bool,
}

impl Outputs {
    const OFF: Self = Self {
        spindle: Spindle::Off,
        speed: 0.0,
        flood: false,
        mist: false,
    };
}

/// What an accepted line still has to do, in order.
#[derive(Clone, Debug)]
pub(super) enum Action {
    /// Wait until nothing moves.
    Synchronise,
    Spindle(Spindle, f64),
    Coolant {
        mist: bool,
        flood: bool,
    },
    Dwell(f64),
    DwellUntil(f64),
    Move {
        to: Position,
        speed: f64,
        jog: bool,
    },
    SoftLimit,
    Pause,
    ProgramEnd,
    Home,
    Sleep,
    Reset,
}

/// A line under execution.
#[derive(Debug)]
pub(super) struct Line {
    /// As received; `None` if the firmware gave it to itself, and no "ok" is due.
    pub text: Option<String>,
    pub actions: VecDeque<Action>,
}

/// One answer.
#[derive(Debug)]
pub(super) struct Output {
    pub cause: Cause,
    pub text: String,
}

pub(super) struct Firmware {
    pub(super) config: GrblConfig,
    pub(super) bench: Bench,
    pub(super) mode: Mode,
    pub(super) planner: Planner,
    pub(super) modal: Modal,
    pub(super) outputs: Outputs,
    /// G54 to G59.
    pub(super) offsets: [Position; 6],
    pub(super) refresh: Refresh,
    pub(super) build_name: String,
    pub(super) startup: [String; 2],
    pub(super) rx: VecDeque<u8>,
    line: String,
    overflow: bool,
    comment: Option<u8>,
    pub(super) current: Option<Line>,
    status_asked: bool,
    /// Deaf until then: starting, or the pause after an alarm.
    pause_until_s: f64,
    /// A restart's welcome is still to be said, with the alarm that came before it.
    welcome: bool,
    out: Vec<Output>,
}

impl Firmware {
    /// A board that has just got its power.
    pub(super) fn new(mut config: GrblConfig, bench: Bench) -> Self {
        config.homing_order.retain(|&axis| axis < 3);
        let mut firmware = Self {
            config,
            bench,
            mode: Mode::Normal,
            planner: Planner::default(),
            modal: Modal::at([0.0; 3]),
            outputs: Outputs::OFF,
            offsets: [[0.0; 3]; 6],
            refresh: Refresh::default(),
            build_name: String::new(),
            startup: Default::default(),
            rx: VecDeque::new(),
            line: String::new(),
            overflow: false,
            comment: None,
            current: None,
            status_asked: false,
            pause_until_s: 0.0,
            welcome: false,
            out: Vec::new(),
        };
        let now_s = firmware.bench.clock().now_s();
        firmware.power_up(now_s);
        firmware
    }

    /// The processor restarts: it forgets its position and everything but its settings.
    pub(super) fn power_up(&mut self, now_s: f64) {
        self.planner = Planner::at([0.0; 3]);
        self.bench.cut_drives(now_s, [0.0; 3]);
        self.bench.forget_homing();
        self.current = None;
        self.mode = if self.config.settings.homing {
            Mode::Alarm
        } else {
            Mode::Normal
        };
        self.bench.set_alarm(None);
        self.initialise(now_s);
        self.pause_until_s = now_s + self.config.boot_s;
    }

    /// The start is over, and nobody listened.
    pub(super) fn finish_boot(&mut self, now_s: f64) {
        self.pause_until_s = now_s;
        self.step(now_s);
        self.out.clear();
    }

    /// What power-up and soft reset have in common.
    fn initialise(&mut self, now_s: f64) {
        self.planner.clear(now_s);
        self.modal = Modal::at(self.planner.position(now_s));
        self.set_outputs(now_s, Outputs::OFF);
        self.refresh = Refresh::default();
        self.rx.clear();
        self.line.clear();
        self.overflow = false;
        self.comment = None;
        self.status_asked = false;
        self.welcome = true;
    }

    pub(super) fn take_output(&mut self) -> Vec<Output> {
        std::mem::take(&mut self.out)
    }

    pub(super) fn moving_since_s(&self) -> Option<f64> {
        match self.mode {
            Mode::Home { start_s, .. } => Some(start_s),
            _ => self.planner.moving_since_s(),
        }
    }

    pub(super) fn motion_end_s(&self) -> Option<f64> {
        match self.mode {
            Mode::Normal => self.planner.end_s(),
            _ => None,
        }
    }

    /// The time until which nothing can happen but by a byte from the host.
    pub(super) fn waits_until_s(&self, now_s: f64) -> Option<f64> {
        if now_s < self.pause_until_s {
            return Some(self.pause_until_s);
        }
        match self.mode {
            Mode::Home { end_s, .. } => return Some(end_s),
            Mode::Hold if self.planner.is_braking(now_s) => return self.planner.end_s(),
            Mode::JogCancel => return self.planner.end_s(),
            Mode::Normal => {}
            _ => return None,
        }
        match self.current.as_ref()?.actions.front()? {
            Action::DwellUntil(end_s) => Some(*end_s),
            Action::Move { .. } => self.planner.first_end_s(),
            _ => self.planner.end_s(),
        }
    }

    /// A byte from the host. Real-time commands act at once, the rest is queued
    /// as far as the buffer has room.
    pub(super) fn receive(&mut self, byte: u8, now_s: f64) {
        match byte {
            0x18 => self.reset(now_s),
            b'?' => self.status_asked = true,
            b'!' => self.feed_hold(now_s),
            b'~' => self.cycle_start(now_s),
            0x85 => {
                if self.mode == Mode::Normal && self.planner.is_jogging() {
                    self.brake(now_s, Mode::JogCancel);
                }
            }
            0x80.. => {}
            _ => {
                if self.rx.len() < RX_BYTES {
                    self.rx.push_back(byte);
                }
            }
        }
    }

    /// Does all that can be done at this time.
    pub(super) fn step(&mut self, now_s: f64) {
        loop {
            if now_s < self.pause_until_s {
                return;
            }
            if self.welcome {
                self.say_welcome();
            }
            self.check_limit_switches(now_s);
            self.planner.retire(now_s);
            match self.mode {
                Mode::Home { end_s, fails, .. } => {
                    if now_s < end_s {
                        return;
                    }
                    // Asked during homing, a report comes at its end.
                    self.answer_status(now_s);
                    self.end_homing(end_s, fails);
                    continue;
                }
                Mode::Critical => return,
                Mode::JogCancel if !self.planner.is_braking(now_s) => {
                    self.planner.clear(now_s);
                    self.modal.position = self.planner.position(now_s);
                    self.mode = Mode::Normal;
                }
                _ => {}
            }
            self.answer_status(now_s);
            if matches!(self.mode, Mode::Hold | Mode::JogCancel | Mode::Sleep) {
                return;
            }
            if self.current.is_some() {
                if !self.act(now_s) {
                    return;
                }
                continue;
            }
            match self.rx.pop_front() {
                Some(byte) => self.read(byte, now_s),
                None => return,
            }
        }
    }

    fn answer_status(&mut self, now_s: f64) {
        if std::mem::take(&mut self.status_asked) {
            let text = self.status_report(now_s);
            self.say(Cause::StatusQuery, text);
        }
    }

    pub(super) fn say(&mut self, cause: Cause, text: impl Into<String>) {
        self.out.push(Output {
            cause,
            text: text.into(),
        });
    }

    fn say_welcome(&mut self) {
        self.welcome = false;
        // What came during the start is lost.
        self.rx.clear();
        self.status_asked = false;
        let banner = if self.config.hal { HAL_BANNER } else { BANNER };
        self.say(Cause::Banner, banner);
        if matches!(self.mode, Mode::Alarm | Mode::Sleep) {
            self.mode = Mode::Alarm;
            self.say(Cause::Push, UNLOCK);
        } else {
            self.mode = Mode::Normal;
            self.run_startup_lines();
        }
    }

    // Real-time commands.

    /// 0x18, and what else restarts the firmware without its power going.
    pub(super) fn reset(&mut self, now_s: f64) {
        if now_s < self.pause_until_s && self.welcome {
            return; // one reset is already under way
        }
        self.planner.retire(now_s);
        let alarm = match self.mode {
            Mode::Home { .. } => Some(6),
            Mode::Normal if !self.planner.is_empty() => Some(3),
            Mode::Hold if self.planner.is_braking(now_s) => Some(3),
            Mode::JogCancel => Some(3),
            _ => None,
        };
        self.abort(now_s, alarm);
    }

    pub(super) fn abort(&mut self, now_s: f64, alarm: Option<u8>) {
        self.planner.clear(now_s);
        if let Some(code) = alarm {
            self.bench.cut_drives(now_s, self.planner.position(now_s));
            self.say(Cause::Push, format!("ALARM:{code}\r\n"));
            self.bench.set_alarm(Some(code));
            self.bench.forget_homing();
            self.mode = Mode::Alarm;
            self.pause_until_s = now_s + ALARM_PAUSE_S;
        } else if self.mode == Mode::Critical {
            self.mode = Mode::Alarm;
        }
        // The line under execution returns, and says so, before the restart.
        if let Some(text) = self.current.take().and_then(|line| line.text) {
            self.say(Cause::Line(text), "ok\r\n");
        }
        self.initialise(now_s);
    }

    /// An alarm from outside, e.g. noise on a limit switch's wire.
    pub(super) fn raise_alarm(&mut self, code: u8, now_s: f64) {
        self.planner.retire(now_s);
        if code > 2 {
            self.abort(now_s, Some(code));
            return;
        }
        self.say(Cause::Push, format!("ALARM:{code}\r\n"));
        if code == 1 {
            self.planner.clear(now_s);
            self.bench.cut_drives(now_s, self.planner.position(now_s));
            self.bench.forget_homing();
        }
        self.bench.set_alarm(Some(code));
        self.set_outputs(now_s, Outputs::OFF);
        self.say(Cause::Push, "[MSG:Reset to continue]\r\n");
        self.mode = Mode::Critical;
        self.status_asked = false;
        self.pause_until_s = now_s + ALARM_PAUSE_S;
    }

    fn feed_hold(&mut self, now_s: f64) {
        if now_s < self.pause_until_s || self.mode != Mode::Normal {
            return;
        }
        self.planner.retire(now_s);
        let mode = if self.planner.is_jogging() {
            Mode::JogCancel
        } else {
            Mode::Hold
        };
        self.brake(now_s, mode);
    }

    fn brake(&mut self, now_s: f64, mode: Mode) {
        self.planner.hold(now_s);
        self.bench.follow(now_s, self.planner.pieces());
        self.mode = mode;
    }

    fn cycle_start(&mut self, now_s: f64) {
        if self.mode == Mode::Hold && !self.planner.is_braking(now_s) {
            self.planner.resume(now_s);
            self.bench.follow(now_s, self.planner.pieces());
            self.mode = Mode::Normal;
        }
    }

    // Lines.

    fn read(&mut self, byte: u8, now_s: f64) {
        if byte == b'\n' || byte == b'\r' {
            let line = std::mem::take(&mut self.line);
            self.comment = None;
            if std::mem::take(&mut self.overflow) {
                self.say(Cause::Line(line), "error:11\r\n");
            } else {
                self.execute(line, now_s);
            }
            return;
        }
        match (self.comment, byte) {
            (Some(b'('), b')') => self.comment = None,
            (Some(_), _) | (None, 0..=b' ' | b'/') => {}
            (None, b'(' | b';') => self.comment = Some(byte),
            (None, _) if self.overflow => {}
            (None, _) if self.line.len() >= LINE_LENGTH => self.overflow = true,
            (None, _) => self.line.push(char::from(byte.to_ascii_uppercase())),
        }
    }

    fn execute(&mut self, text: String, now_s: f64) {
        let result = if let Some(command) = text.strip_prefix('$') {
            self.system_command(command, now_s)
        } else if text.is_empty() {
            Ok(VecDeque::new())
        } else if self.mode == Mode::Alarm || self.planner.is_jogging() {
            Err(9)
        } else {
            self.plan_line(&text, false)
        };
        match result {
            Ok(actions) => {
                self.current = Some(Line {
                    text: Some(text),
                    actions,
                });
            }
            Err(code) => self.say(Cause::Line(text), format!("error:{code}\r\n")),
        }
    }

    pub(super) fn idle(&self) -> bool {
        self.mode == Mode::Normal && self.planner.is_empty()
    }

    /// Goes on with the line under execution; false if it must wait.
    fn act(&mut self, now_s: f64) -> bool {
        let Some(mut line) = self.current.take() else {
            return true;
        };
        let Some(action) = line.actions.pop_front() else {
            if let Some(text) = line.text {
                self.say(Cause::Line(text), "ok\r\n");
            }
            return true;
        };
        // What is left of the action.
        let still = match action {
            Action::Synchronise => (!self.planner.is_empty()).then_some(Action::Synchronise),
            Action::Spindle(spindle, speed) => {
                let settings = &self.config.settings;
                let limited = match spindle {
                    Spindle::Off => 0.0,
                    _ if speed == 0.0 => 0.0,
                    _ => speed.max(settings.spindle_min).min(settings.spindle_max),
                };
                let outputs = Outputs {
                    spindle,
                    speed: limited,
                    ..self.outputs.clone()
                };
                self.set_outputs(now_s, outputs);
                None
            }
            Action::Coolant { mist, flood } => {
                let outputs = Outputs {
                    mist,
                    flood,
                    ..self.outputs.clone()
                };
                self.set_outputs(now_s, outputs);
                None
            }
            Action::Dwell(seconds) => Some(Action::DwellUntil(now_s + seconds)),
            Action::DwellUntil(end_s) => (now_s < end_s).then_some(action),
            Action::Move { to, speed, jog } => {
                if self.planner.free() == 0 {
                    Some(action)
                } else {
                    let settings = &self.config.settings;
                    let limits = (
                        settings.max_rate.map(|rate| rate / 60.0),
                        settings.acceleration,
                    );
                    self.planner.push(now_s, to, speed, limits, jog);
                    self.bench.follow(now_s, &self.upcoming(now_s));
                    None
                }
            }
            Action::SoftLimit if self.planner.is_empty() => {
                self.raise_alarm(2, now_s);
                // The line returns once the reset has come.
                self.current = Some(line);
                return true;
            }
            Action::SoftLimit => {
                self.brake_for_soft_limit(now_s);
                if self.planner.is_empty() {
                    line.actions.push_front(Action::SoftLimit);
                    self.current = Some(line);
                    return true;
                }
                Some(Action::SoftLimit)
            }
            Action::Pause => {
                self.planner.hold(now_s);
                self.mode = Mode::Hold;
                None
            }
            Action::ProgramEnd => {
                self.set_outputs(now_s, Outputs::OFF);
                self.say(Cause::Push, "[MSG:Pgm End]\r\n");
                None
            }
            Action::Home => None,
            Action::Sleep => {
                self.say(Cause::Line(line.text.unwrap_or_default()), "ok\r\n");
                self.say(Cause::Push, "[MSG:Sleeping]\r\n");
                self.set_outputs(now_s, Outputs::OFF);
                self.mode = Mode::Sleep;
                self.bench.forget_homing();
                return true;
            }
            Action::Reset => {
                line.actions.clear();
                self.current = Some(line);
                self.reset(now_s);
                return true;
            }
        };
        // Whether the line must wait.
        let waits = still
            .as_ref()
            .is_some_and(|action| !matches!(action, Action::DwellUntil(end_s) if *end_s <= now_s));
        if let Some(action) = still {
            line.actions.push_front(action);
        }
        self.current = Some(line);
        !waits
    }

    /// The moves still ahead, the one under way from its beginning: the bench
    /// keeps what is past of it.
    fn upcoming(&self, now_s: f64) -> Vec<Piece> {
        self.planner
            .pieces()
            .iter()
            .filter(|piece| piece.end_s() > now_s)
            .map(|piece| from_time(piece, now_s))
            .collect()
    }

    /// A target beyond the travel while others are under way: a controlled
    /// stop comes first, then the alarm.
    fn brake_for_soft_limit(&mut self, now_s: f64) {
        if self.planner.is_braking(now_s) {
            return;
        }
        let stopped = self
            .planner
            .end_s()
            .is_some_and(|end_s| end_s <= now_s && self.planner.speed(now_s) == 0.0);
        if stopped {
            self.planner.clear(now_s);
        } else {
            self.planner.hold(now_s);
            self.bench.follow(now_s, self.planner.pieces());
        }
    }

    // Homing and switches.

    fn set_outputs(&mut self, now_s: f64, outputs: Outputs) {
        let full = self.config.settings.spindle_max;
        let spindle = if full > 0.0 {
            outputs.speed / full
        } else {
            0.0
        };
        let drive = self.config.lamp_wiring.map(|pin| match pin {
            LampPin::None => 0.0,
            LampPin::Spindle => spindle.clamp(0.0, 1.0),
            LampPin::Flood => f64::from(u8::from(outputs.flood)),
            LampPin::Mist => f64::from(u8::from(outputs.mist)),
        });
        self.outputs = outputs;
        self.bench.set_lamp(now_s, drive);
    }
}

/// What is left of a stretch of motion at a time.
fn from_time(piece: &Piece, time_s: f64) -> Piece {
    if time_s <= piece.start_s {
        return *piece;
    }
    Piece {
        start_s: time_s,
        duration_s: piece.end_s() - time_s,
        from: piece.position(time_s),
        speed: piece.speed_at(time_s),
        ..*piece
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::BenchConfig;
    use crate::clock::Clock;
    use proptest::prelude::*;

    fn firmware(homing: bool) -> (Firmware, Clock) {
        let clock = Clock::manual();
        let mut config = GrblConfig::default();
        config.settings.homing = homing;
        config.settings.soft_limits = homing;
        config.settings.hard_limits = homing;
        let mut firmware = Firmware::new(config, Bench::new(BenchConfig::default(), clock.clone()));
        firmware.finish_boot(clock.now_s());
        (firmware, clock)
    }

    proptest! {
        /// Whatever is sent, whenever: no panic, and a reset always brings it back.
        #[test]
        fn no_bytes_break_it(
            chunks in prop::collection::vec(
                (prop_oneof![
                    prop::collection::vec(any::<u8>(), 0..40),
                    "[$GMXYFSJH0-9=.!~?\\-\n]{0,40}".prop_map(String::into_bytes),
                ], 0.0..3.0_f64),
                0..20,
            ),
            homing in any::<bool>(),
        ) {
            let (mut firmware, clock) = firmware(homing);
            for (bytes, seconds) in chunks {
                for byte in bytes {
                    firmware.receive(byte, clock.now_s());
                    firmware.step(clock.now_s());
                }
                clock.advance(seconds);
                firmware.step(clock.now_s());
            }
            clock.advance(1.0);
            firmware.step(clock.now_s());
            firmware.take_output();
            firmware.receive(0x18, clock.now_s());
            clock.advance(1.0);
            firmware.step(clock.now_s());
            prop_assert!(firmware.take_output().iter().any(|output| output.text == BANNER));
        }

        /// Every line that the buffer took gets one "ok" or one "error", in the end.
        #[test]
        fn every_line_has_one_answer(
            lines in prop::collection::vec(
                prop::sample::select(vec![
                    "", "G0X5", "G1X-3F500", "G91", "G4P0.1", "M3S10", "M5", "M8", "Q", "$G",
                    "$$", "$J=X1F100", "$J=X1", "G0", "$110=50", "M2",
                ]),
                0..40,
            ),
        ) {
            let (mut firmware, clock) = firmware(false);
            let mut answers = 0;
            for line in &lines {
                for byte in line.bytes().chain([b'\n']) {
                    firmware.receive(byte, clock.now_s());
                    firmware.step(clock.now_s());
                }
                // As a host that waits for each answer.
                for _ in 0..1000 {
                    if firmware.current.is_none() && firmware.rx.is_empty() {
                        break;
                    }
                    clock.advance(1.0);
                    firmware.step(clock.now_s());
                }
                answers += firmware
                    .take_output()
                    .iter()
                    .filter(|output| output.text == "ok\r\n" || output.text.starts_with("error:"))
                    .count();
            }
            prop_assert_eq!(answers, lines.len());
        }
    }
}
