//! A controller that says what builds other than GRBL 1.1 say. Nothing moves and nothing
//! shines: homing and moves succeed at once, as far as they are not refused.

use crate::clock::Clock;
use crate::pty::{Board, Port};
use std::io;
use std::path::Path;

/// What it reports. Lines are without their ends.
#[derive(Clone, Debug)]
#[allow(missing_docs)]
pub struct Dialect {
    /// At its start.
    pub banner: &'static [&'static str],
    /// To `$I`, before the `ok`.
    pub version: &'static [&'static str],
    /// To `$$`, before the `ok`.
    pub settings: &'static [&'static str],
    /// To `$H`, all of it.
    pub homing: &'static [&'static str],
    /// To `?`, with `STATE` for the state.
    pub report: &'static str,
    /// What every third report has in addition, with `OUTPUTS` for the letters of those
    /// that are on.
    pub outputs: &'static str,
    /// The state when it is connected.
    pub state: &'static str,
    pub state_after_reset: &'static str,
    /// Beginnings of lines, and what is answered to them instead.
    pub refusals: &'static [(&'static str, &'static [&'static str])],
    /// Whether lines come back as they were sent.
    pub echoes: bool,
    /// Whether lines are read at all: GRBL reads none while its door is open.
    pub reads_lines: bool,
    pub line_end: &'static str,
}

impl Dialect {
    /// Stock GRBL 1.1h, idle.
    pub const GRBL: Self = Self {
        banner: &["", "Grbl 1.1h ['$' for help]"],
        version: &["[VER:1.1h.20190825:]", "[OPT:V,15,128]"],
        settings: &["$10=1", "$13=0", "$22=1", "$32=0", "$110=3000.000"],
        homing: &["ok"],
        report: "<STATE|MPos:0.000,0.000,0.000|FS:0,0",
        outputs: "|Ov:100,100,100OUTPUTS",
        state: "Idle",
        state_after_reset: "Idle",
        refusals: &[],
        echoes: false,
        reads_lines: true,
        line_end: "\r\n",
    };
}

/// A controller of such a dialect on a pseudo-terminal; dropping it takes the port away.
#[derive(Debug)]
pub struct DialectSimulator(Port<Controller>);

impl DialectSimulator {
    /// Starts it.
    ///
    /// # Errors
    /// If there can be no pseudo-terminal or thread.
    pub fn spawn(dialect: Dialect) -> io::Result<Self> {
        let controller = Controller {
            state: dialect.state,
            dialect,
            on: Vec::new(),
            reports: 0,
            line: Vec::new(),
        };
        Port::start("grbl-dialect", controller, Clock::instant()).map(Self)
    }

    /// The host's end.
    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// Letters of the outputs that are on, as reports have them.
    pub fn outputs(&self) -> String {
        self.0.board().on.iter().collect()
    }
}

#[derive(Debug)]
struct Controller {
    dialect: Dialect,
    state: &'static str,
    on: Vec<char>,
    reports: u32,
    line: Vec<u8>,
}

impl Controller {
    fn say(&self, lines: &[&str]) -> String {
        lines
            .iter()
            .map(|line| format!("{line}{}", self.dialect.line_end))
            .collect()
    }

    fn report(&mut self) -> String {
        self.reports += 1;
        let mut text = self.dialect.report.replace("STATE", self.state);
        let is_report = text.starts_with('<');
        if is_report && self.reports.is_multiple_of(3) {
            let on: String = self.on.iter().collect();
            let on = match on.as_str() {
                "" => String::new(),
                on => format!("|A:{on}"),
            };
            text += &self.dialect.outputs.replace("OUTPUTS", &on);
        }
        if is_report {
            text.push('>');
        }
        self.say(&[&text])
    }

    fn reset(&mut self) -> String {
        self.on.clear();
        self.state = self.dialect.state_after_reset;
        self.say(self.dialect.banner)
    }

    fn answer(&mut self, line: &str) -> String {
        let mut said = match self.dialect.echoes {
            true => self.say(&[line]),
            false => String::new(),
        };
        let refusal = self.dialect.refusals.iter();
        let refusal = refusal.copied().find(|(start, _)| line.starts_with(start));
        said += &match (line, refusal) {
            _ if !self.dialect.reads_lines => return String::new(),
            (_, Some((_, lines))) => self.say(lines),
            ("$I", _) => self.say(self.dialect.version) + &self.say(&["ok"]),
            ("$$", _) => self.say(self.dialect.settings) + &self.say(&["ok"]),
            ("$H", _) => {
                if self.dialect.homing.last() == Some(&"ok") {
                    self.state = "Idle";
                }
                self.say(self.dialect.homing)
            }
            _ => {
                self.switch(line);
                self.say(&["ok"])
            }
        };
        said
    }

    fn switch(&mut self, line: &str) {
        let off = |on: &mut Vec<char>, letters: &str| on.retain(|c| !letters.contains(*c));
        match line.split_whitespace().next() {
            Some("M3") => self.on.push('S'),
            Some("M7") => self.on.push('M'),
            Some("M8") => self.on.push('F'),
            Some("M5") => off(&mut self.on, "S"),
            Some("M9") => off(&mut self.on, "FM"),
            _ => {}
        }
    }
}

impl Board for Controller {
    fn receive(&mut self, bytes: &[u8], _: f64) -> Vec<u8> {
        let mut said = String::new();
        for &byte in bytes {
            match byte {
                b'?' => said += &self.report(),
                b'!' | b'~' | b'\r' => {}
                0x18 => said += &self.reset(),
                b'\n' => {
                    let line = String::from_utf8_lossy(&self.line).into_owned();
                    self.line.clear();
                    said += &self.answer(line.trim());
                }
                byte => self.line.push(byte),
            }
        }
        said.into_bytes()
    }

    fn step(&mut self, _: f64) -> Vec<u8> {
        Vec::new()
    }

    fn jump_to_s(&self) -> Option<f64> {
        None
    }
}
