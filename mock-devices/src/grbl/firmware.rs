//! The firmware's state machine: bytes and time in, answers and motion out.

use super::GrblConfig;
use super::LampPin;
use super::faults::Cause;
use super::gcode::{self, Block, Motion, Once, Program, Spindle};
use super::planner::Planner;
use super::report::{RX_BYTES, Refresh};
use crate::bench::Bench;
use crate::motion::{Piece, Position, trapezoid};
use std::collections::VecDeque;

/// Characters of a line that are kept; a longer line is refused (error 11).
const LINE_LENGTH: usize = 79;

/// The pause after an alarm message, seconds.
const ALARM_PAUSE_S: f64 = 0.5;

/// Homing searches this many times the travel before it gives up.
const SEARCH_FACTOR: f64 = 1.5;

const BANNER: &str = "\r\nGrbl 1.1h ['$' for help]\r\n";
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

/// The parser's state.
#[derive(Clone, Debug)]
pub(super) struct Modal {
    pub motion: Motion,
    pub inches: bool,
    pub relative: bool,
    pub plane: u8,
    pub coordinates: usize,
    pub spindle: Spindle,
    pub mist: bool,
    pub flood: bool,
    /// mm/min.
    pub feed: f64,
    pub speed: f64,
    pub tool: f64,
    /// The G92 offset, mm.
    pub shift: Position,
    /// Where the parser has got to, mm, machine coordinates.
    position: Position,
}

impl Modal {
    fn at(position: Position) -> Self {
        Self {
            motion: Motion::Seek,
            inches: false,
            relative: false,
            plane: 17,
            coordinates: 0,
            spindle: Spindle::Off,
            mist: false,
            flood: false,
            feed: 0.0,
            speed: 0.0,
            tool: 0.0,
            shift: [0.0; 3],
            position,
        }
    }
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
enum Action {
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
struct Line {
    text: String,
    actions: VecDeque<Action>,
}

/// One answer.
#[derive(Debug)]
pub(super) struct Output {
    pub cause: Cause,
    pub text: String,
}

pub(super) struct Firmware {
    pub(super) config: GrblConfig,
    bench: Bench,
    pub(super) mode: Mode,
    pub(super) planner: Planner,
    pub(super) modal: Modal,
    pub(super) outputs: Outputs,
    /// G54 to G59.
    pub(super) offsets: [Position; 6],
    pub(super) refresh: Refresh,
    pub(super) build_name: String,
    startup: [String; 2],
    pub(super) rx: VecDeque<u8>,
    line: String,
    overflow: bool,
    comment: Option<u8>,
    current: Option<Line>,
    status_asked: bool,
    /// Deaf until then: starting, or the pause after an alarm.
    pause_until_s: f64,
    /// A restart's welcome is still to be said, with the alarm that came before it.
    welcome: bool,
    out: Vec<Output>,
}

impl Firmware {
    /// A board that has just got its power.
    pub(super) fn new(config: GrblConfig, bench: Bench) -> Self {
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
            self.planner.retire(now_s);
            self.check_limit_switches(now_s);
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

    fn say(&mut self, cause: Cause, text: impl Into<String>) {
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
        self.say(Cause::Banner, BANNER);
        if matches!(self.mode, Mode::Alarm | Mode::Sleep) {
            self.mode = Mode::Alarm;
            self.say(Cause::Push, UNLOCK);
        } else {
            self.mode = Mode::Normal;
            self.run_startup_lines();
        }
    }

    fn run_startup_lines(&mut self) {
        for line in self.startup.clone() {
            if line.is_empty() {
                continue;
            }
            let result = self.plan_line(&line, false);
            let verdict = match &result {
                Ok(_) => "ok".to_owned(),
                Err(code) => format!("error:{code}"),
            };
            if let Ok(actions) = result {
                // Its own "ok" is the one printed here, not an answer.
                let earlier = self.current.take();
                let mut queue = earlier.map_or_else(VecDeque::new, |line| line.actions);
                queue.extend(actions);
                self.current = Some(Line {
                    text: String::new(),
                    actions: queue,
                });
            }
            self.say(Cause::Push, format!(">{line}:{verdict}\r\n"));
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

    fn abort(&mut self, now_s: f64, alarm: Option<u8>) {
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
        if let Some(line) = self.current.take().filter(|line| !line.text.is_empty()) {
            self.say(Cause::Line(line.text), "ok\r\n");
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
            Ok(actions) => self.current = Some(Line { text, actions }),
            Err(code) => self.say(Cause::Line(text), format!("error:{code}\r\n")),
        }
    }

    fn idle(&self) -> bool {
        self.mode == Mode::Normal && self.planner.is_empty()
    }

    /// `$...`: an error code, or what remains to be done before the "ok".
    fn system_command(&mut self, command: &str, now_s: f64) -> Result<VecDeque<Action>, u8> {
        let cause = || Cause::Line(format!("${command}"));
        let mut actions = VecDeque::new();
        match command.as_bytes() {
            [] => {
                let help =
                    "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n";
                self.say(cause(), help);
            }
            [b'J', rest @ ..] => {
                if !self.idle() && !self.planner.is_jogging() {
                    return Err(8);
                }
                if rest.first() != Some(&b'=') {
                    return Err(3);
                }
                return self.plan_line(&command[2..], true);
            }
            b"$" => {
                if self.mode == Mode::Normal && !self.idle() && !self.planner.is_jogging() {
                    return Err(8);
                }
                self.say(cause(), self.config.settings.listing());
            }
            b"G" => self.say(cause(), self.modes()),
            b"X" => {
                if self.mode == Mode::Alarm {
                    self.say(cause(), "[MSG:Caution: Unlocked]\r\n");
                    self.mode = Mode::Normal;
                    self.bench.set_alarm(None);
                }
            }
            b"C" if self.mode == Mode::Check => {
                self.say(cause(), "[MSG:Disabled]\r\n");
                actions.push_back(Action::Reset);
            }
            b"C" => {
                if !self.idle() {
                    return Err(8);
                }
                self.say(cause(), "[MSG:Enabled]\r\n");
                self.mode = Mode::Check;
            }
            [b'$' | b'G' | b'C' | b'X', ..] => return Err(3),
            _ if !self.idle() && self.mode != Mode::Alarm => return Err(8),
            b"#" => self.say(cause(), self.parameters()),
            b"I" => self.say(cause(), self.build_info()),
            [b'I', b'=', ..] => self.build_name = command[2..].to_owned(),
            b"H" => {
                if !self.config.settings.homing {
                    return Err(5);
                }
                self.begin_homing(now_s);
                actions.push_back(Action::Home);
            }
            b"SLP" => {
                actions.push_back(Action::Sleep);
            }
            [b'R', b'S', b'T', b'=', which @ (b'$' | b'#' | b'*')] => {
                if matches!(which, b'$' | b'*') {
                    self.config.settings = super::GrblSettings::default();
                }
                if matches!(which, b'#' | b'*') {
                    self.offsets = [[0.0; 3]; 6];
                }
                self.say(cause(), "[MSG:Restoring defaults]\r\n");
                actions.push_back(Action::Reset);
            }
            b"N" => {
                let [first, second] = &self.startup;
                self.say(cause(), format!("$N0={first}\r\n$N1={second}\r\n"));
            }
            [b'N', index @ (b'0' | b'1'), b'=', ..] => {
                if !self.idle() {
                    return Err(8);
                }
                let line = &command[3..];
                actions = self.plan_line(line, false)?;
                self.startup[usize::from(index - b'0')] = line.to_owned();
            }
            _ => {
                let (number, rest) = gcode::read_number(command).ok_or(2_u8)?;
                let rest = rest.strip_prefix('=').ok_or(3_u8)?;
                let (value, rest) = gcode::read_number(rest).ok_or(2_u8)?;
                if !rest.is_empty() || !(0.0..=255.0).contains(&number) {
                    return Err(3);
                }
                self.config.settings.store(number.trunc() as u8, value)?;
                if number.trunc() == 13.0 {
                    self.refresh.wco_changed();
                }
            }
        }
        Ok(actions)
    }

    pub(super) fn work_offset(&self) -> Position {
        let base = self.offsets[self.modal.coordinates];
        std::array::from_fn(|axis| base[axis] + self.modal.shift[axis])
    }

    /// The parser: an error code (and nothing has changed), or the modal state
    /// is the new one and the actions are what remains.
    fn plan_line(&mut self, line: &str, jog: bool) -> Result<VecDeque<Action>, u8> {
        let block = gcode::parse(line)?;
        let mut modal = self.modal.clone();
        let mut actions = VecDeque::new();
        if jog {
            if block.not_for_jog {
                return Err(16);
            }
            if block.speed.is_some() || block.tool.is_some() {
                return Err(36);
            }
            if !block.has_axes() {
                return Err(26);
            }
            let scale = unit(block.inches.unwrap_or(modal.inches));
            let Some(feed) = block.feed.filter(|&feed| feed > 0.0) else {
                return Err(22);
            };
            let to = self.target(&block, &modal);
            if self.config.settings.soft_limits && self.outside(to) {
                return Err(15);
            }
            // A jog changes no mode, only the position.
            self.modal.position = to;
            actions.push_back(Action::Move {
                to,
                speed: feed * scale / 60.0,
                jog: true,
            });
            return Ok(actions);
        }
        modal.inches = block.inches.unwrap_or(modal.inches);
        modal.relative = block.relative.unwrap_or(modal.relative);
        modal.plane = block.plane.unwrap_or(modal.plane);
        modal.motion = block.motion.unwrap_or(modal.motion);
        modal.tool = block.tool.unwrap_or(modal.tool);
        modal.feed = block
            .feed
            .map_or(modal.feed, |feed| feed * unit(modal.inches));
        let moves = block.has_axes()
            && !matches!(block.once, Some(Once::SetOffset { .. } | Once::ShiftOrigin));
        if moves {
            match modal.motion {
                Motion::None => return Err(31),
                Motion::Feed if modal.feed == 0.0 => return Err(22),
                _ if matches!(block.once, Some(Once::Dwell | Once::ClearShift)) => return Err(24),
                _ => {}
            }
        }
        if block.machine_coordinates && modal.motion == Motion::None {
            return Err(30);
        }

        let speed = block.speed.unwrap_or(modal.speed);
        let spindle = block.spindle.unwrap_or(modal.spindle);
        let lit = spindle != Spindle::Off;
        if spindle != modal.spindle || (lit && speed != modal.speed) {
            if !self.config.settings.laser_mode {
                actions.push_back(Action::Synchronise);
            }
            actions.push_back(Action::Spindle(spindle, speed));
        }
        modal.speed = speed;
        modal.spindle = spindle;
        if let Some(coolant) = block.coolant {
            Self::apply_coolant(&mut modal.mist, &mut modal.flood, coolant);
            actions.push_back(Action::Synchronise);
            actions.push_back(Action::Coolant {
                mist: modal.mist,
                flood: modal.flood,
            });
        }
        if block.once == Some(Once::Dwell) {
            actions.push_back(Action::Synchronise);
            actions.push_back(Action::Dwell(block.p.unwrap_or(0.0)));
        }
        let mut new_offset = None;
        if let Some(coordinates) = block.coordinates {
            modal.coordinates = coordinates;
            self.refresh.wco_changed();
        }
        match block.once {
            Some(Once::SetOffset { from_position }) => {
                let index = match block.p.map_or(0, |p| p as usize) {
                    0 => modal.coordinates,
                    p => p - 1,
                };
                let mut offset = self.offsets[index];
                for (axis, value) in block.axes.iter().enumerate() {
                    if let Some(value) = value {
                        let value = value * unit(modal.inches);
                        offset[axis] = if from_position {
                            modal.position[axis] - modal.shift[axis] - value
                        } else {
                            value
                        };
                    }
                }
                new_offset = Some((index, offset));
            }
            Some(Once::ShiftOrigin) => {
                let base = self.offsets[modal.coordinates];
                for (axis, value) in block.axes.iter().enumerate() {
                    if let Some(value) = value {
                        modal.shift[axis] =
                            modal.position[axis] - base[axis] - value * unit(modal.inches);
                    }
                }
                self.refresh.wco_changed();
            }
            Some(Once::ClearShift) => {
                modal.shift = [0.0; 3];
                self.refresh.wco_changed();
            }
            _ => {}
        }
        if let Some((index, offset)) = new_offset {
            self.offsets[index] = offset;
            self.refresh.wco_changed();
        }
        if moves {
            let to = self.target(&block, &modal);
            modal.position = to;
            let speed = match modal.motion {
                Motion::Seek => f64::INFINITY,
                _ => modal.feed / 60.0,
            };
            if self.config.settings.soft_limits && self.outside(to) {
                actions.push_back(Action::SoftLimit);
            } else {
                actions.push_back(Action::Move {
                    to,
                    speed,
                    jog: false,
                });
            }
        }
        match block.program {
            Some(Program::Pause) => {
                actions.push_back(Action::Synchronise);
                actions.push_back(Action::Pause);
            }
            Some(Program::End(_)) => {
                modal.motion = Motion::Feed;
                modal.plane = 17;
                modal.relative = false;
                modal.coordinates = 0;
                modal.spindle = Spindle::Off;
                (modal.mist, modal.flood) = (false, false);
                actions.push_back(Action::Synchronise);
                actions.push_back(Action::ProgramEnd);
            }
            None => {}
        }
        if self.mode == Mode::Check {
            actions.retain(|action| matches!(action, Action::SoftLimit));
        }
        self.modal = modal;
        Ok(actions)
    }

    /// Machine coordinates, on a whole step, of where a block wants to go.
    fn target(&self, block: &Block, modal: &Modal) -> Position {
        let scale = unit(block.inches.unwrap_or(modal.inches));
        let relative = block.relative.unwrap_or(modal.relative);
        let base = self.offsets[modal.coordinates];
        std::array::from_fn(|axis| {
            let Some(value) = block.axes[axis] else {
                return modal.position[axis];
            };
            let value = value * scale;
            let target = if block.machine_coordinates {
                value
            } else if relative {
                modal.position[axis] + value
            } else {
                value + base[axis] + modal.shift[axis]
            };
            let steps = self.config.settings.steps_per_mm[axis];
            if steps > 0.0 {
                (target * steps).round() / steps
            } else {
                target
            }
        })
    }

    fn outside(&self, to: Position) -> bool {
        let settings = &self.config.settings;
        (0..3).any(|axis| {
            let travel = settings.max_travel[axis];
            let (low, high) = if self.config.zero_at_home && settings.homes_down(axis) {
                (0.0, travel)
            } else {
                (-travel, 0.0)
            };
            !(low..=high).contains(&to[axis])
        })
    }

    /// Goes on with the line under execution; false if it must wait.
    fn act(&mut self, now_s: f64) -> bool {
        let Some(mut line) = self.current.take() else {
            return true;
        };
        let Some(action) = line.actions.pop_front() else {
            if !line.text.is_empty() {
                self.say(Cause::Line(line.text), "ok\r\n");
            }
            return true;
        };
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
                self.say(Cause::Line(line.text), "ok\r\n");
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

    /// Where the switch of an axis closes, motor coordinates.
    fn switch_mm(&self, axis: usize) -> f64 {
        let settings = &self.config.settings;
        let away = if settings.homes_down(axis) { -1.0 } else { 1.0 };
        self.home_mm(axis) + away * settings.homing_pull_off
    }

    /// The position that an axis has after homing.
    fn home_mm(&self, axis: usize) -> f64 {
        let settings = &self.config.settings;
        if self.config.zero_at_home {
            0.0
        } else if settings.homes_down(axis) {
            settings.homing_pull_off - settings.max_travel[axis]
        } else {
            -settings.homing_pull_off
        }
    }

    /// Letters of the axes whose switch is closed.
    pub(super) fn limit_pins(&self) -> String {
        let motor = self.bench.motor_position();
        self.config
            .homing_order
            .iter()
            .filter(|&&axis| axis < 3 && self.switch_closed(axis, motor[axis]))
            .map(|&axis| ["X", "Y", "Z"][axis])
            .collect()
    }

    fn switch_closed(&self, axis: usize, motor_mm: f64) -> bool {
        let beyond = motor_mm - self.switch_mm(axis);
        if self.config.settings.homes_down(axis) {
            beyond <= 1e-9
        } else {
            beyond >= -1e-9
        }
    }

    fn check_limit_switches(&mut self, now_s: f64) {
        let moving = self.mode == Mode::Normal && !self.planner.is_empty();
        if moving && self.config.settings.hard_limits && !self.limit_pins().is_empty() {
            self.raise_alarm(1, now_s);
        }
    }

    /// Search at the seek rate, back off, approach at the feed rate, back off:
    /// for each axis in turn.
    fn begin_homing(&mut self, now_s: f64) {
        let settings = self.config.settings.clone();
        let mut at = self.bench.begin_homing();
        let mut pieces: Vec<Piece> = Vec::new();
        let mut time_s = now_s;
        let mut fails = false;
        for &axis in self.config.homing_order.iter().filter(|&&axis| axis < 3) {
            let switch = self.switch_mm(axis);
            let sign = if settings.homes_down(axis) { -1.0 } else { 1.0 };
            let distance = (switch - at[axis]) * sign;
            let search = SEARCH_FACTOR * settings.max_travel[axis];
            fails = distance > search;
            let back = switch - sign * settings.homing_pull_off;
            let found = if fails {
                at[axis] + sign * search
            } else {
                switch
            };
            let legs: &[(f64, f64)] = if fails {
                &[(found, settings.homing_seek)]
            } else {
                &[
                    (found, settings.homing_seek),
                    (back, settings.homing_feed),
                    (switch, settings.homing_feed),
                    (back, settings.homing_feed),
                ]
            };
            for &(to_mm, rate) in legs {
                let mut to = at;
                to[axis] = to_mm;
                let speed = (rate / 60.0).min(settings.max_rate[axis] / 60.0).max(1e-3);
                let acceleration = settings.acceleration[axis].max(1e-3);
                let leg = trapezoid(at, to, time_s, speed, acceleration);
                time_s =
                    leg.last().map_or(time_s, Piece::end_s) + settings.homing_debounce_ms / 1000.0;
                pieces.extend(leg);
                at = to;
            }
            if fails {
                break;
            }
        }
        self.planner = Planner::at(at);
        self.bench.follow(now_s, &pieces);
        self.mode = Mode::Home {
            start_s: now_s,
            end_s: time_s,
            fails,
        };
    }

    fn end_homing(&mut self, end_s: f64, fails: bool) {
        if fails {
            self.abort(end_s, Some(9));
            return;
        }
        let mut position = self.planner.position(end_s);
        for &axis in self.config.homing_order.iter().filter(|&&axis| axis < 3) {
            position[axis] = self.home_mm(axis);
        }
        self.planner = Planner::at(position);
        self.modal.position = position;
        self.bench.end_homing(&self.config.homing_order);
        self.bench.set_alarm(None);
        self.mode = Mode::Normal;
        self.run_startup_after_homing();
    }

    fn run_startup_after_homing(&mut self) {
        // The actions join the homing line, whose "ok" comes after them.
        let line = self.current.take();
        self.run_startup_lines();
        let mut actions = self
            .current
            .take()
            .map_or_else(VecDeque::new, |startup| startup.actions);
        if let Some(mut line) = line {
            actions.extend(line.actions.drain(..));
            line.actions = actions;
            self.current = Some(line);
        }
    }

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

/// Millimetres per unit.
fn unit(inches: bool) -> f64 {
    if inches { 25.4 } else { 1.0 }
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
