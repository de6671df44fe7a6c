//! The `$` commands and the startup lines.

use super::faults::Cause;
use super::firmware::{Action, Firmware, Line, Mode};
use super::gcode;
use std::collections::VecDeque;

impl Firmware {
    /// `$...`: an error code, or what remains to be done before the "ok".
    pub(super) fn system_command(
        &mut self,
        command: &str,
        now_s: f64,
    ) -> Result<VecDeque<Action>, u8> {
        let cause = || Cause::Line(format!("${command}"));
        let mut actions = VecDeque::new();
        // Also while it moves or is locked.
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
                let mut listing = self.config.settings.listing();
                if self.config.hal {
                    listing += "$70=15\r\n$73=\r\n$300=grblHAL\r\n$302=192.168.5.1\r\n$341=0\r\n";
                }
                self.say(cause(), listing);
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
            // Only while it stands.
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
            // A setting: `$number=value`.
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

    pub(super) fn run_startup_lines(&mut self) {
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
                    text: None,
                    actions: queue,
                });
            }
            self.say(Cause::Push, format!(">{line}:{verdict}\r\n"));
        }
    }

    pub(super) fn run_startup_after_homing(&mut self) {
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
}
