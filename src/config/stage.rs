//! The `[stage]` table: port, axes, lamp.

use super::ConfigError;
use super::reader::Section;
use crate::units::{Seconds, StageAngles};

/// A light stage as the rig file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct StageConfig {
    /// Where the firmware is reached.
    pub port: StagePort,
    /// The axis that turns the lamp about the stage's +z.
    pub azimuth: AxisMap,
    /// The axis that raises the lamp.
    pub elevation: AxisMap,
    /// Speed of a move, axis units per minute.
    pub feed_per_min: f64,
    /// Every target is approached from this far below it on each axis, degrees; 0 turns it off.
    pub approach_deg: f64,
    /// How long a reply may take.
    pub reply_timeout: Seconds,
    /// How long homing may take.
    pub homing_timeout: Seconds,
    /// How long a move may take.
    pub move_timeout: Seconds,
    /// Commands that turn every channel off.
    pub lamp_off: Vec<String>,
    /// The lamp's channels, one to three.
    pub lamp: Vec<LampChannelConfig>,
}

/// Where the stage's firmware is reached.
#[derive(Clone, Debug, PartialEq)]
pub enum StagePort {
    /// GRBL 1.1 on a serial port.
    Serial {
        /// Path, best below `/dev/serial/by-id`.
        path: String,
        /// Bits per second.
        baud: u32,
    },
    /// The simulated firmware on a pseudo-terminal.
    Simulated,
}

/// How an angle maps to an axis of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisMap {
    /// The axis' letter: X, Y, Z, A, B or C.
    pub axis: char,
    /// Axis units per degree; not 0, negative where the axis turns the other way.
    pub scale: f64,
    /// The angle at axis position 0, degrees.
    pub offset_deg: f64,
    /// Smallest angle, degrees.
    pub min_deg: f64,
    /// Largest angle, degrees.
    pub max_deg: f64,
}

impl AxisMap {
    /// The axis position of an angle.
    pub fn position(&self, angle_deg: f64) -> f64 {
        (angle_deg - self.offset_deg) * self.scale
    }

    /// The angle of an axis position, degrees.
    pub fn angle_deg(&self, position: f64) -> f64 {
        position / self.scale + self.offset_deg
    }

    /// Whether an angle is within the limits.
    pub fn reaches(&self, angle_deg: f64) -> bool {
        (self.min_deg..=self.max_deg).contains(&angle_deg)
    }
}

/// One switchable colour of the lamp.
#[derive(Clone, Debug, PartialEq)]
pub struct LampChannelConfig {
    /// Which colour its frames measure.
    pub measures: Measures,
    /// Commands that turn it on.
    pub on: Vec<String>,
}

/// The colours that a frame under one lamp channel measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Measures {
    Red,
    Green,
    Blue,
    /// All three at once: a white lamp.
    All,
}

impl Measures {
    /// Indices of the colours: R is 0, G is 1, B is 2.
    pub fn colours(self) -> &'static [usize] {
        match self {
            Measures::Red => &[0],
            Measures::Green => &[1],
            Measures::Blue => &[2],
            Measures::All => &[0, 1, 2],
        }
    }

    /// `R`, `G`, `B` or `RGB`.
    pub fn name(self) -> &'static str {
        match self {
            Measures::Red => "R",
            Measures::Green => "G",
            Measures::Blue => "B",
            Measures::All => "RGB",
        }
    }
}

impl StageConfig {
    /// Whether both axes reach these angles.
    pub fn reaches(&self, angles: StageAngles) -> bool {
        self.azimuth.reaches(angles.azimuth_deg) && self.elevation.reaches(angles.elevation_deg)
    }

    /// Reads the `[stage]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let simulated = table
            .choice("driver", &[("grbl", false), ("simulated", true)])?
            .required()?;
        let port = if simulated {
            StagePort::Simulated
        } else {
            StagePort::Serial {
                path: table.text("port")?.required()?,
                baud: table.integer("baud", 1200..=3_000_000)?.or(115_200) as u32,
            }
        };
        let azimuth = AxisMap::read(table.section("azimuth")?.required()?)?;
        let elevation = AxisMap::read(table.section("elevation")?.required()?)?;
        if azimuth.axis == elevation.axis {
            let allowed = "another axis than the azimuth's";
            return Err(table.conflict("elevation.axis", elevation.axis, allowed));
        }
        let seconds = |found: f64| Seconds(found);
        let stage = Self {
            port,
            azimuth,
            elevation,
            feed_per_min: table.number("feed_per_min", 1.0..=1e5)?.or(3000.0),
            approach_deg: table.number("approach_deg", 0.0..=45.0)?.or(2.0),
            reply_timeout: seconds(table.number("reply_timeout_s", 0.05..=60.0)?.or(2.0)),
            homing_timeout: seconds(table.number("homing_timeout_s", 1.0..=600.0)?.or(60.0)),
            move_timeout: seconds(table.number("move_timeout_s", 1.0..=600.0)?.or(60.0)),
            lamp_off: table.parsed("lamp_off", COMMANDS, commands)?.required()?,
            lamp: read_lamp(&mut table)?,
        };
        table.finish()?;
        Ok(stage)
    }
}

impl AxisMap {
    fn read(mut table: Section) -> Result<Self, ConfigError> {
        let axis = |text: &str| match text {
            "X" | "Y" | "Z" | "A" | "B" | "C" => text.chars().next(),
            _ => None,
        };
        let map = Self {
            axis: table
                .parsed("axis", "one of X, Y, Z, A, B, C", axis)?
                .required()?,
            scale: table.number("scale", -1e4..=1e4)?.or(1.0),
            offset_deg: table.number("offset_deg", -360.0..=360.0)?.or(0.0),
            min_deg: table.number("min_deg", -360.0..=360.0)?.required()?,
            max_deg: table.number("max_deg", -360.0..=360.0)?.required()?,
        };
        if map.scale.abs() < 1e-6 {
            return Err(table.conflict("scale", map.scale, "away from 0"));
        }
        if map.min_deg > map.max_deg {
            let allowed = format!("at least min_deg ({})", map.min_deg);
            return Err(table.conflict("max_deg", map.max_deg, &allowed));
        }
        table.finish()?;
        Ok(map)
    }
}

const COMMANDS: &str = "controller commands separated by `;`, printable ASCII, at most 80 each";

/// `"M5; M9"` as its commands. Real-time characters would act out of turn and are refused.
fn commands(text: &str) -> Option<Vec<String>> {
    let commands: Vec<_> = text
        .split(';')
        .map(|command| command.trim().to_owned())
        .collect();
    let valid = |command: &String| {
        !command.is_empty()
            && command.len() <= 80
            && command
                .bytes()
                .all(|b| (b' '..=b'~').contains(&b) && !b"?!~$".contains(&b))
    };
    commands.iter().all(valid).then_some(commands)
}

fn read_lamp(table: &mut Section) -> Result<Vec<LampChannelConfig>, ConfigError> {
    let sections = table.sections("lamp")?.required()?;
    let mut channels = Vec::with_capacity(sections.len());
    let mut measured = [false; 3];
    for mut section in sections {
        let measures = section
            .choice(
                "measures",
                &[
                    ("R", Measures::Red),
                    ("G", Measures::Green),
                    ("B", Measures::Blue),
                    ("RGB", Measures::All),
                ],
            )?
            .required()?;
        for &colour in measures.colours() {
            if std::mem::replace(&mut measured[colour], true) {
                let allowed = "a colour that no earlier channel measures";
                return Err(section.conflict("measures", measures.name(), allowed));
            }
        }
        channels.push(LampChannelConfig {
            measures,
            on: section.parsed("on", COMMANDS, commands)?.required()?,
        });
        section.finish()?;
    }
    if measured != [true; 3] {
        let names: Vec<_> = channels.iter().map(|c| c.measures.name()).collect();
        let allowed = "channels that together measure R, G and B";
        return Err(table.conflict("lamp", names.join(" and "), allowed));
    }
    Ok(channels)
}
