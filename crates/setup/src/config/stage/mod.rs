//! The `[stage]` table: which protocol, its port, axes or lights, and the lamp.

mod axes;
mod dome;
mod grbl;
mod lamp;
mod zaber;

use super::ConfigError;
use super::reader::Section;
use crate::device::dome::DomeConfig;
use crate::device::grbl::GrblConfig;
use crate::device::kinematics::Kinematics;
use crate::device::manual::{self, ManualConfig};
use crate::device::zaber::ZaberConfig;
use crate::units::Seconds;

pub use lamp::Measures;

/// A light stage as the rig file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct StageConfig {
    /// Which protocol, with what its driver needs.
    pub driver: StageDriver,
    /// Which colour frames under each lamp channel measure, one to three
    /// entries, as many as the lamp has channels.
    pub measures: Vec<Measures>,
}

/// What the stage speaks.
#[derive(Clone, Debug, PartialEq)]
pub enum StageDriver {
    /// Simulated GRBL firmware on a pseudo-terminal, whose port is only known
    /// once it runs, and empty here.
    Simulated(GrblConfig),
    /// GRBL 1.1 or grblHAL on a serial port.
    Grbl(GrblConfig),
    /// Zaber devices on a serial port.
    Zaber(ZaberConfig),
    /// A dome of fixed lights on DMX512, behind an interface on a serial port.
    Dome(DomeConfig),
    /// A person places and switches the light.
    Manual(ManualConfig),
}

impl StageConfig {
    /// Reads the `[stage]` table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        #[derive(Clone, Copy)]
        enum Kind {
            Grbl,
            Zaber,
            Dmx,
            Manual,
            Simulated,
        }
        let drivers = [
            ("grbl", Kind::Grbl),
            ("zaber", Kind::Zaber),
            ("dmx", Kind::Dmx),
            ("manual", Kind::Manual),
            ("simulated", Kind::Simulated),
        ];
        let (driver, measures) = match table.choice("driver", &drivers)?.required()? {
            Kind::Grbl => {
                let (config, measures) = grbl::read(&mut table, false)?;
                (StageDriver::Grbl(config), measures)
            }
            Kind::Zaber => {
                let (config, measures) = zaber::read(&mut table)?;
                (StageDriver::Zaber(config), measures)
            }
            Kind::Dmx => {
                let (config, measures) = dome::read(&mut table)?;
                (StageDriver::Dome(config), measures)
            }
            Kind::Manual => {
                let (config, measures) = dome::read_manual(&mut table)?;
                (StageDriver::Manual(config), measures)
            }
            Kind::Simulated => {
                let (config, measures) = grbl::read(&mut table, true)?;
                (StageDriver::Simulated(config), measures)
            }
        };
        table.finish()?;
        Ok(Self { driver, measures })
    }

    /// The driver's name in rig files.
    pub fn driver_name(&self) -> &'static str {
        match &self.driver {
            StageDriver::Simulated(_) => "simulated",
            StageDriver::Grbl(_) => "grbl",
            StageDriver::Zaber(_) => "zaber",
            StageDriver::Manual(_) => manual::DRIVER,
            StageDriver::Dome(_) => "dmx",
        }
    }

    /// Whether its firmware is simulated.
    pub fn is_simulated(&self) -> bool {
        matches!(self.driver, StageDriver::Simulated(_))
    }

    /// The serial port; `None` where there is none, or none yet.
    pub fn port(&self) -> Option<&str> {
        match &self.driver {
            StageDriver::Simulated(_) | StageDriver::Manual(_) => None,
            StageDriver::Grbl(config) => Some(&config.port),
            StageDriver::Zaber(config) => Some(&config.port),
            StageDriver::Dome(config) => Some(&config.port),
        }
    }

    /// How it brings light from a direction.
    pub fn kinematics(&self) -> Kinematics {
        match &self.driver {
            StageDriver::Simulated(config) | StageDriver::Grbl(config) => {
                Kinematics::TwoAxes(config.kinematics)
            }
            StageDriver::Zaber(config) => Kinematics::TwoAxes(config.kinematics),
            StageDriver::Dome(config) => Kinematics::FixedLights(config.lights.clone()),
            StageDriver::Manual(config) => Kinematics::FixedLights(config.lights.clone()),
        }
    }

    /// How far a position may be off, degrees; `None` where nothing moves by itself.
    pub fn position_tolerance_deg(&self) -> Option<f64> {
        match &self.driver {
            StageDriver::Simulated(config) | StageDriver::Grbl(config) => {
                Some(config.position_tolerance_deg)
            }
            StageDriver::Zaber(config) => Some(config.position_tolerance_deg),
            StageDriver::Dome(_) | StageDriver::Manual(_) => None,
        }
    }

    /// How many degrees per second the light's direction turns at least, and
    /// how long homing may take: for estimates.
    pub fn pace(&self) -> (f64, Seconds) {
        match &self.driver {
            StageDriver::Simulated(config) | StageDriver::Grbl(config) => {
                let per_s = config.feed_per_min / 60.0;
                config.kinematics.pace([per_s; 2])
            }
            // It switches within a frame.
            StageDriver::Dome(_) => (1e4, Seconds(0.1)),
            // Half a minute for a quarter turn.
            StageDriver::Manual(_) => (3.0, Seconds(5.0)),
            StageDriver::Zaber(config) => {
                let axes = config.kinematics.axes();
                let microsteps_per_s = axes.map(|map| config.speed_per_s * map.scale.abs());
                config.kinematics.pace(microsteps_per_s)
            }
        }
    }
}

/// Path of the port and bits per second.
fn read_port(table: &mut Section, default_baud: u64) -> Result<(String, u64), ConfigError> {
    let port = table.text("port")?.required()?;
    let baud = table.integer("baud", 1200..=3_000_000)?.or(default_baud);
    Ok((port, baud))
}

/// What all controllers with axes have.
struct LinkTimes {
    connect: Seconds,
    reply: Seconds,
    homing: Seconds,
    position_tolerance_deg: f64,
}

impl LinkTimes {
    fn read(table: &mut Section) -> Result<Self, ConfigError> {
        Ok(Self {
            connect: Seconds(table.number("connect_timeout_s", 0.1..=60.0)?.or(5.0)),
            reply: Seconds(table.number("reply_timeout_s", 0.05..=60.0)?.or(2.0)),
            homing: Seconds(table.number("homing_timeout_s", 1.0..=600.0)?.or(120.0)),
            position_tolerance_deg: table.number("position_tolerance_deg", 1e-4..=5.0)?.or(0.05),
        })
    }
}
