//! What a GRBL 1.1 controller reports, line by line (`interface.md` of its
//! documentation). Pure functions: any bytes in, a reply out.

/// One line from the controller.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// The line before was accepted.
    Ok,
    /// The line before was refused for this.
    Error(Code),
    /// Something went wrong; the position is unknown.
    Alarm(Code),
    /// Answer to `?`.
    Status(StatusReport),
    /// Answer to `?` as GRBL before 1.1 gives it, with commas between its fields.
    OldStatus(String),
    /// The firmware has (re)started.
    Banner {
        /// Its version, or its name where it reports none.
        version: String,
        /// How it counts.
        dialect: Dialect,
    },
    /// A line of `$$`.
    Setting {
        /// Number after the `$`.
        number: u16,
        /// Its value.
        value: f64,
    },
    /// `[KEY:text]`: answers to `$I`, messages, parser state.
    Info {
        /// What stands before the first colon, e.g. `VER` or `MSG`.
        key: String,
        /// The rest.
        text: String,
    },
    /// A start-up line that was executed at reset, `>…:ok`.
    StartupLine,
    /// An empty line, which the controller sends around its banner.
    Empty,
    /// Nothing that the protocol knows.
    Unknown(String),
}

/// Why something was refused, or an alarm was raised.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Code {
    /// Its number.
    Number(u16),
    /// In words, as older and verbose builds have it.
    Text(String),
}

/// How a firmware counts its errors and alarms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dialect {
    /// As GRBL 1.1, whose numbers grblHAL continues.
    #[default]
    Grbl,
    /// As FluidNC.
    FluidNc,
}

impl Dialect {
    /// By what a firmware reports of itself.
    pub fn of(text: &str) -> Self {
        match text.contains("FluidNC") {
            true => Self::FluidNc,
            false => Self::Grbl,
        }
    }
}

/// What the machine is doing, with its sub-state where it has one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MachineState {
    /// Standing still.
    Idle,
    /// Executing motion.
    Run,
    /// Holding: 0 stands, 1 still brakes.
    Hold(u8),
    /// Jogging.
    Jog,
    /// Locked.
    Alarm,
    /// The safety door is open (sub-states 0 to 3).
    Door(u8),
    /// Checks G-code without moving.
    Check,
    /// Homing.
    Home,
    /// Outputs off until a reset.
    Sleep,
    /// FluidNC: locked, because its configuration is faulty.
    ConfigAlarm,
}

/// Which way the spindle output turns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Spindle {
    #[default]
    Off,
    Clockwise,
    Counterclockwise,
}

/// The switched outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Accessories {
    /// M3, M4, M5.
    pub spindle: Spindle,
    /// M8.
    pub flood: bool,
    /// M7.
    pub mist: bool,
}

/// As the firmware writes it.
impl std::fmt::Display for MachineState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hold(step) => write!(f, "Hold:{step}"),
            Self::Door(step) => write!(f, "Door:{step}"),
            other => write!(f, "{other:?}"),
        }
    }
}

/// The outputs that are on.
impl std::fmt::Display for Accessories {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let on = [
            (self.spindle == Spindle::Clockwise, "spindle (M3)"),
            (
                self.spindle == Spindle::Counterclockwise,
                "spindle backwards (M4)",
            ),
            (self.mist, "mist (M7)"),
            (self.flood, "flood (M8)"),
        ];
        let on: Vec<&str> = on
            .iter()
            .filter(|(is_on, _)| *is_on)
            .map(|(_, name)| *name)
            .collect();
        match &on[..] {
            [] => f.write_str("all off"),
            on => write!(f, "{} on", on.join(", ")),
        }
    }
}

/// A real-time status report.
#[derive(Clone, Debug, PartialEq)]
pub struct StatusReport {
    /// What it is doing.
    pub state: MachineState,
    /// Machine position, axis units, X first.
    pub machine: Option<Vec<f64>>,
    /// Work position, axis units.
    pub work: Option<Vec<f64>>,
    /// Work coordinate offset: machine − work. Only in some reports.
    pub work_offset: Option<Vec<f64>>,
    /// Spindle speed (S) now.
    pub speed: Option<f64>,
    /// The outputs. Reported only together with the overrides, in some reports
    /// and in the first one after a change.
    pub accessories: Option<Accessories>,
}

/// Longest line that is worth parsing, bytes; GRBL's longest is about 110.
pub const LONGEST_LINE: usize = 256;

/// Reads a line without its line end.
pub fn parse(line: &[u8]) -> Reply {
    let text = String::from_utf8_lossy(line);
    // A line that echoes what it receives may begin with the request for a report.
    let text = text.trim().trim_start_matches(['?', '!', '~']);
    match text {
        "" => return Reply::Empty,
        "ok" => return Reply::Ok,
        _ => {}
    }
    known(text).unwrap_or_else(|| Reply::Unknown(text.chars().take(LONGEST_LINE).collect()))
}

fn known(text: &str) -> Option<Reply> {
    if let Some(code) = text.strip_prefix("error:") {
        return Some(Reply::Error(code_in(code)?));
    }
    if let Some(code) = text.strip_prefix("ALARM:") {
        return Some(Reply::Alarm(code_in(code)?));
    }
    if let Some(body) = enclosed(text, '<', '>') {
        if body.contains(",MPos:") || body.contains(",WPos:") {
            return Some(Reply::OldStatus(text.to_owned()));
        }
        return status(body).map(Reply::Status);
    }
    if let Some(body) = enclosed(text, '[', ']') {
        let (key, text) = body.split_once(':')?;
        return Some(Reply::Info {
            key: key.to_owned(),
            text: text.to_owned(),
        });
    }
    if text.starts_with("Grbl ") || text.ends_with("for help]") {
        return Some(banner(text));
    }
    if let Some(setting) = text.strip_prefix('$') {
        let (name, value) = setting.split_once('=')?;
        let Ok(number) = name.parse::<u16>() else {
            // Start-up blocks ($N0), and settings that have names, as FluidNC's.
            return Some(Reply::Info {
                key: format!("${name}"),
                text: value.to_owned(),
            });
        };
        // Older builds add a description in parentheses.
        let first = value.split_whitespace().next().unwrap_or("");
        return match number_in(first) {
            Some(value) => Some(Reply::Setting { number, value }),
            // GRBL 1.1's are all numbers; grblHAL has names and addresses as well.
            None if is_hal_setting(number) => Some(Reply::Info {
                key: format!("${number}"),
                text: value.to_owned(),
            }),
            None => None,
        };
    }
    (text.starts_with('>') && text.ends_with(":ok")).then_some(Reply::StartupLine)
}

/// Whether a `$` setting is one that GRBL 1.1 lacks.
fn is_hal_setting(number: u16) -> bool {
    !matches!(number, 0..=32 | 100..=132)
}

/// A number, or a space and words.
fn code_in(text: &str) -> Option<Code> {
    match text.strip_prefix(' ') {
        Some(words) if words.contains(char::is_alphabetic) => Some(Code::Text(words.to_owned())),
        _ => Some(Code::Number(text.trim().parse().ok()?)),
    }
}

/// The version is the first word that begins as one; builds put their own name before it,
/// or none at all.
fn banner(text: &str) -> Reply {
    let (name, _) = text.split_once('[').unwrap_or((text, ""));
    let version = name.split_whitespace().find(|word| {
        let number = word.strip_prefix('v').unwrap_or(word);
        number.starts_with(|c: char| c.is_ascii_digit())
    });
    Reply::Banner {
        version: version
            .unwrap_or(name.trim())
            .trim_end_matches(':')
            .to_owned(),
        dialect: Dialect::of(text),
    }
}

/// Whether this version of GRBL is older than 1.1, whose protocol is another.
pub fn is_old(version: &str) -> bool {
    let number = version.strip_prefix('v').unwrap_or(version);
    number.starts_with("0.")
}

fn enclosed(text: &str, open: char, close: char) -> Option<&str> {
    text.strip_prefix(open)?.strip_suffix(close)
}

fn status(body: &str) -> Option<StatusReport> {
    let mut fields = body.split('|');
    let mut report = StatusReport {
        state: machine_state(fields.next()?)?,
        machine: None,
        work: None,
        work_offset: None,
        speed: None,
        accessories: None,
    };
    for field in fields {
        let Some((key, value)) = field.split_once(':') else {
            // What later builds add may have no value; what is read here has one.
            match field {
                "MPos" | "WPos" | "WCO" | "FS" | "Ov" | "A" => return None,
                _ => continue,
            }
        };
        match key {
            // A controller that has lost count says nan: that is no position.
            "MPos" | "WPos" if value.contains("nan") || value.contains("inf") => {}
            "MPos" => report.machine = Some(numbers(value)?),
            "WPos" => report.work = Some(numbers(value)?),
            "WCO" => report.work_offset = Some(numbers(value)?),
            "FS" => report.speed = Some(*numbers(value)?.get(1)?),
            // No accessory on: the overrides come alone.
            "Ov" => {
                report.accessories.get_or_insert_default();
            }
            "A" => report.accessories = Some(accessories(value)?),
            // Bf, Ln, F, Pn and what later builds add.
            _ => {}
        }
    }
    Some(report)
}

/// The state at the beginning of a report.
pub fn machine_state(text: &str) -> Option<MachineState> {
    let (name, sub) = match text.split_once(':') {
        Some((name, sub)) => (name, sub.parse().ok()?),
        None => (text, 0),
    };
    Some(match name {
        "Idle" => MachineState::Idle,
        "Run" => MachineState::Run,
        // grblHAL waits for a tool like a hold.
        "Hold" | "Tool" => MachineState::Hold(sub),
        "Jog" => MachineState::Jog,
        "Alarm" => MachineState::Alarm,
        "Door" => MachineState::Door(sub),
        "Check" => MachineState::Check,
        "Home" => MachineState::Home,
        "Sleep" => MachineState::Sleep,
        "ConfigAlarm" => MachineState::ConfigAlarm,
        _ => return None,
    })
}

fn accessories(text: &str) -> Option<Accessories> {
    let mut on = Accessories::default();
    for letter in text.chars() {
        match letter {
            'S' => on.spindle = Spindle::Clockwise,
            'C' => on.spindle = Spindle::Counterclockwise,
            'F' => on.flood = true,
            'M' => on.mist = true,
            // grblHAL: a tool change is pending, the spindle is encoded.
            'T' | 'E' => {}
            _ => return None,
        }
    }
    Some(on)
}

/// One to six finite numbers, separated by commas.
fn numbers(text: &str) -> Option<Vec<f64>> {
    let numbers: Vec<f64> = text
        .split(',')
        .take(7)
        .map(number_in)
        .collect::<Option<_>>()?;
    (numbers.len() <= 6).then_some(numbers)
}

fn number_in(text: &str) -> Option<f64> {
    text.parse().ok().filter(|value: &f64| value.is_finite())
}

impl StatusReport {
    /// Machine position: as reported, or from work position and the last known offset.
    pub fn machine_position(&self, last_offset: Option<&[f64]>) -> Option<Vec<f64>> {
        if self.machine.is_some() {
            return self.machine.clone();
        }
        let work = self.work.as_ref()?;
        let offset = self.work_offset.as_deref().or(last_offset)?;
        Some(work.iter().zip(offset).map(|(w, o)| w + o).collect())
    }
}

/// The outputs and the spindle speed that a list of commands leaves behind,
/// all off before it.
pub fn effect_of<'a>(commands: impl IntoIterator<Item = &'a String>) -> (Accessories, Option<f64>) {
    let mut on = Accessories::default();
    let mut speed = None;
    for command in commands {
        for (letter, value) in words(command) {
            match (letter, value as i64) {
                ('M', 3) => on.spindle = Spindle::Clockwise,
                ('M', 4) => on.spindle = Spindle::Counterclockwise,
                ('M', 5) => on.spindle = Spindle::Off,
                ('M', 7) => on.mist = true,
                ('M', 8) => on.flood = true,
                ('M', 9) => (on.mist, on.flood) = (false, false),
                ('S', _) => speed = Some(value),
                _ => {}
            }
        }
    }
    (on, speed.filter(|_| on.spindle != Spindle::Off))
}

/// The words of a G-code line; what is not a word is skipped.
fn words(line: &str) -> impl Iterator<Item = (char, f64)> {
    let upper: String = line.chars().filter(|c| !c.is_whitespace()).collect();
    let upper = upper.to_ascii_uppercase();
    let starts: Vec<usize> = upper
        .char_indices()
        .filter(|(_, c)| c.is_ascii_uppercase())
        .map(|(at, _)| at)
        .collect();
    let words: Vec<_> = starts
        .iter()
        .enumerate()
        .filter_map(|(i, &at)| {
            let end = starts.get(i + 1).copied().unwrap_or(upper.len());
            let letter = upper[at..].chars().next()?;
            Some((letter, number_in(&upper[at + 1..end])?))
        })
        .collect();
    words.into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn report(state: MachineState) -> StatusReport {
        StatusReport {
            state,
            machine: None,
            work: None,
            work_offset: None,
            speed: None,
            accessories: None,
        }
    }

    #[test]
    fn versions_before_1_1_are_old() {
        assert!(is_old("0.9j") && is_old("v0.8c"));
        assert!(!is_old("1.1h") && !is_old("3.7") && !is_old("v1.1f") && !is_old("Turntable"));
    }

    #[test]
    fn lines_as_controllers_send_them() {
        const CASES: &str = r#"
            ok => Ok
            error:20 => Error(Number(20))
            error: Unsupported command => Error(Text("Unsupported command"))
            ALARM:1 => Alarm(Number(1))
            ALARM: Hard limit => Alarm(Text("Hard limit"))
            Grbl 1.1h ['$' for help] => Banner { version: "1.1h", dialect: Grbl }
            Grbl 1.1h: LongMill build ['$' for help] => Banner { version: "1.1h", dialect: Grbl }
            ArcBench 1.1h ['$' for help] => Banner { version: "1.1h", dialect: Grbl }
            Grbl-Mega-5X 1.1t ['$' for help] => Banner { version: "1.1t", dialect: Grbl }
            grblHAL 1.1f ['$' or '$HELP' for help] => Banner { version: "1.1f", dialect: Grbl }
            Grbl v1.1f [uCNC v1.8.9 '$' for help] => Banner { version: "v1.1f", dialect: Grbl }
            Turntable ['$' for help] => Banner { version: "Turntable", dialect: Grbl }
            Grbl 3.7 [FluidNC v3.7.13 (wifi) '$' for help] => Banner { version: "3.7", dialect: FluidNc }
            <Idle,MPos:0.000,0.000,WPos:0.000,0.000> => OldStatus("<Idle,MPos:0.000,0.000,WPos:0.000,0.000>")
            $/axes/x/steps_per_mm=80.000 => Info { key: "$/axes/x/steps_per_mm", text: "80.000" }
            $N0= => Info { key: "$N0", text: "" }
            $302=192.168.5.1 => Info { key: "$302", text: "192.168.5.1" }
            $73= => Info { key: "$73", text: "" }
            $110=500.000 => Setting { number: 110, value: 500.0 }
            $32=0 (laser mode, bool) => Setting { number: 32, value: 0.0 }
            [VER:1.1h.20190825:] => Info { key: "VER", text: "1.1h.20190825:" }
            [MSG:'$H'|'$X' to unlock] => Info { key: "MSG", text: "'$H'|'$X' to unlock" }
            >G21:ok => StartupLine
        "#;
        for case in CASES.trim().lines() {
            let (line, reply) = case.trim().split_once(" => ").unwrap();
            assert_eq!(format!("{:?}", parse(line.as_bytes())), reply, "{line}");
        }
        assert_eq!(parse(b""), Reply::Empty);
    }

    #[test]
    fn statuses_as_controllers_send_them() {
        let cases: &[(&str, StatusReport)] = &[
            ("<Idle|MPos:nan,0.000,0.000>", report(MachineState::Idle)),
            (
                "?<Door:1|MPos:0.000,0.000,0.000|Pn:D|H||X>",
                StatusReport {
                    machine: Some(vec![0.0; 3]),
                    ..report(MachineState::Door(1))
                },
            ),
            (
                "<Idle|MPos:0.000,-5.529,0.000|FS:0,0|Ov:100,100,100>",
                StatusReport {
                    machine: Some(vec![0.0, -5.529, 0.0]),
                    speed: Some(0.0),
                    accessories: Some(Accessories::default()),
                    ..report(MachineState::Idle)
                },
            ),
            (
                "<Run|WPos:1.500,2.000,0.000|Bf:14,127|FS:500,8000|WCO:1.000,0.000,1.551>",
                StatusReport {
                    work: Some(vec![1.5, 2.0, 0.0]),
                    work_offset: Some(vec![1.0, 0.0, 1.551]),
                    speed: Some(8000.0),
                    ..report(MachineState::Run)
                },
            ),
            (
                "<Hold:1|MPos:5.000,0.000,0.000|F:500|Pn:XYZPDHRS|Ov:100,100,100|A:SFM>",
                StatusReport {
                    machine: Some(vec![5.0, 0.0, 0.0]),
                    accessories: Some(Accessories {
                        spindle: Spindle::Clockwise,
                        flood: true,
                        mist: true,
                    }),
                    ..report(MachineState::Hold(1))
                },
            ),
            (
                "<Alarm:11|MPos:1.0,2.0,3.0|Bf:35,1023|FS:0,0,0|Ov:100,100,100|A:FT|H:0,3|FW:grblHAL>",
                StatusReport {
                    machine: Some(vec![1.0, 2.0, 3.0]),
                    speed: Some(0.0),
                    accessories: Some(Accessories {
                        flood: true,
                        ..Accessories::default()
                    }),
                    ..report(MachineState::Alarm)
                },
            ),
            (
                "<Alarm|MPos:1.0,2.0,3.0,4.0|FS:0,0>",
                StatusReport {
                    machine: Some(vec![1.0, 2.0, 3.0, 4.0]),
                    speed: Some(0.0),
                    ..report(MachineState::Alarm)
                },
            ),
        ];
        for (line, report) in cases {
            assert_eq!(
                parse(line.as_bytes()),
                Reply::Status(report.clone()),
                "{line}"
            );
        }
    }

    #[test]
    fn damaged_lines_are_unknown_rather_than_half_read() {
        for line in [
            "o",
            "okk",
            "error:",
            "error:x",
            "ALARM:70000",
            "<Idle|MPos:0.000,-5.5",
            "<Idle|MPos:0.000,x,0.000>",
            "<Idle|MPos:1,2,3,4,5,6,7>",
            "<Idle|MPos>",
            "<Rum|MPos:0,0,0>",
            "<Idle|Ov:1,1,1|A:Q>",
            "<Idle|FS:3>",
            "$110=",
            "[VER]",
            "Grbl ",
            "smoothie",
        ] {
            assert_eq!(
                parse(line.as_bytes()),
                Reply::Unknown(line.trim().to_owned())
            );
        }
        assert!(matches!(parse(b"\xff\xfe"), Reply::Unknown(_)));
    }

    #[test]
    fn machine_position_from_the_work_position_needs_the_offset() {
        let work = |text: &str| match parse(text.as_bytes()) {
            Reply::Status(report) => report,
            other => panic!("{other:?}"),
        };
        let with = work("<Idle|WPos:1.0,2.0,0.0|FS:0,0|WCO:10.0,0.0,0.0>");
        assert_eq!(with.machine_position(None), Some(vec![11.0, 2.0, 0.0]));
        let without = work("<Idle|WPos:1.0,2.0,0.0|FS:0,0>");
        assert_eq!(without.machine_position(None), None);
        assert_eq!(
            without.machine_position(Some(&[5.0, 0.0, 0.0])),
            Some(vec![6.0, 2.0, 0.0])
        );
    }

    #[test]
    fn the_effect_of_lamp_commands() {
        let effect = |commands: &[&str]| {
            let commands: Vec<String> = commands.iter().map(|&c| c.to_owned()).collect();
            effect_of(&commands)
        };
        let (on, speed) = effect(&["M5", "M9", "m3 s 750.5"]);
        assert_eq!(
            (on.spindle, on.flood, on.mist),
            (Spindle::Clockwise, false, false)
        );
        assert_eq!(speed, Some(750.5));
        let (on, speed) = effect(&["M7", "M8"]);
        assert_eq!((on.spindle, on.flood, on.mist), (Spindle::Off, true, true));
        assert_eq!(speed, None);
        assert_eq!(
            effect(&["M3 S9 M8", "M5M9"]),
            (Accessories::default(), None)
        );
    }

    proptest! {
        #[test]
        fn any_bytes_are_parsed_without_panic(line in proptest::collection::vec(any::<u8>(), 0..300)) {
            if let Reply::Status(report) = parse(&line) {
                report.machine_position(None);
            }
        }

        #[test]
        fn near_misses_are_parsed_without_panic(
            line in "(<[A-Z][a-z]{2,4}(:[0-9])?(\\|(MPos|WPos|WCO|FS|Ov|A|Bf)?:?[-0-9.,SCFM]{0,12}){0,5}>?|[$\\[][0-9A-Z=:.]{0,9}\\]?|(ok|error:|ALARM:|Grbl )[0-9.]{0,7})"
        ) {
            parse(line.as_bytes());
            effect_of(&[line]);
        }

        #[test]
        fn positions_survive(values in proptest::collection::vec(-1e4..1e4f64, 1..=6)) {
            let text = values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(",");
            let Reply::Status(report) = parse(format!("<Idle|MPos:{text}|FS:0,0>").as_bytes()) else {
                return Err(TestCaseError::fail("no status"));
            };
            for (read, sent) in report.machine.unwrap().iter().zip(&values) {
                prop_assert!((read - sent).abs() <= 5.001e-4);
            }
        }
    }
}
