//! The `[stage]` table: port, axes, lamp.

use super::ConfigError;
use super::reader::Section;
use crate::device::grbl::GrblConfig;
use crate::device::kinematics::{AxisMap, Kinematics};
use crate::units::Seconds;

/// A light stage as the rig file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct StageConfig {
    /// Real or simulated.
    pub driver: StageDriver,
    /// What the GRBL driver needs. The simulated firmware speaks the same
    /// protocol; its port is only known once it runs, and empty here.
    pub grbl: GrblConfig,
    /// Which colour frames under each lamp channel measure, one to three
    /// entries, as many as `grbl.lamp_on`.
    pub measures: Vec<Measures>,
}

/// Where the stage's firmware is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageDriver {
    /// GRBL 1.1 on a serial port.
    Grbl,
    /// Simulated firmware on a pseudo-terminal.
    Simulated,
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
    /// Reads the `[stage]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let drivers = [
            ("grbl", StageDriver::Grbl),
            ("simulated", StageDriver::Simulated),
        ];
        let driver = table.choice("driver", &drivers)?.required()?;
        let (port, baud) = match driver {
            StageDriver::Simulated => (String::new(), DEFAULT_BAUD),
            StageDriver::Grbl => (
                table.text("port")?.required()?,
                table.integer("baud", 1200..=3_000_000)?.or(DEFAULT_BAUD),
            ),
        };
        let azimuth = read_axis(table.section("azimuth")?.required()?)?;
        let elevation = read_axis(table.section("elevation")?.required()?)?;
        if azimuth.axis == elevation.axis {
            let allowed = "another axis than the azimuth's";
            return Err(table.conflict("elevation.axis", elevation.axis, allowed));
        }
        let (measures, lamp_on) = read_lamp(&mut table)?;
        let grbl = GrblConfig {
            port,
            baud: baud as u32,
            kinematics: Kinematics {
                azimuth,
                elevation,
                approach_deg: table.number("approach_deg", 0.0..=45.0)?.or(2.0),
            },
            feed_per_min: table.number("feed_per_min", 1.0..=1e5)?.or(3000.0),
            lamp_off: table.parsed("lamp_off", COMMANDS, commands)?.required()?,
            lamp_on,
            connect_timeout: Seconds(table.number("connect_timeout_s", 0.1..=60.0)?.or(5.0)),
            reply_timeout: Seconds(table.number("reply_timeout_s", 0.05..=60.0)?.or(2.0)),
            homing_timeout: Seconds(table.number("homing_timeout_s", 1.0..=600.0)?.or(120.0)),
            position_tolerance_deg: table.number("position_tolerance_deg", 1e-4..=5.0)?.or(0.05),
        };
        table.finish()?;
        Ok(Self {
            driver,
            grbl,
            measures,
        })
    }
}

/// GRBL's own.
const DEFAULT_BAUD: u64 = 115_200;

fn read_axis(mut table: Section) -> Result<AxisMap, ConfigError> {
    let axis = |text: &str| match text {
        "X" | "Y" | "Z" | "A" | "B" | "C" => text.chars().next(),
        _ => None,
    };
    let map = AxisMap {
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

/// What each channel measures, and the commands that turn it on.
type Lamp = (Vec<Measures>, Vec<Vec<String>>);

fn read_lamp(table: &mut Section) -> Result<Lamp, ConfigError> {
    let sections = table.sections("lamp")?.required()?;
    let (mut channels, mut commands_on) = (Vec::new(), Vec::new());
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
        channels.push(measures);
        commands_on.push(section.parsed("on", COMMANDS, commands)?.required()?);
        section.finish()?;
    }
    if measured != [true; 3] {
        let names: Vec<_> = channels.iter().map(|channel| channel.name()).collect();
        let allowed = "channels that together measure R, G and B";
        return Err(table.conflict("lamp", names.join(" and "), allowed));
    }
    Ok((channels, commands_on))
}
