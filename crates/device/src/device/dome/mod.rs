//! Light domes: many lights that stand still, one lit at a time, over the
//! dome line protocol (docs/reference/dome-protocol.md) or over DMX512 behind an Enttec DMX USB
//! Pro or a compatible interface.

#[cfg(feature = "serial")]
mod dmx;
#[cfg(feature = "serial")]
mod line;
#[cfg(feature = "serial")]
mod port;
pub mod protocol;
#[cfg(feature = "serial")]
mod stage;
#[cfg(all(test, feature = "serial"))]
mod tests;
pub mod widget;

#[cfg(feature = "serial")]
pub use stage::{DomeStage, stop_port};

use super::kinematics::FixedLights;
use crate::units::Seconds;

/// A dome as its driver needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct DomeConfig {
    /// Path of the serial port, best below `/dev/serial/by-id`.
    pub port: String,
    /// Bits per second.
    pub baud: u32,
    /// Where the lights are.
    pub lights: FixedLights,
    /// What the dome speaks, and how its lights are addressed.
    pub wiring: DomeWiring,
    /// Colour channels of every light, 1 to 3.
    pub channels: u8,
    /// Drive of a lit light, 1 to 255.
    pub level: u8,
    /// How long the dome may take to answer at connection.
    pub connect_timeout: Seconds,
    /// How long a reply may take.
    pub reply_timeout: Seconds,
}

/// What a dome speaks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DomeWiring {
    /// The dome line protocol; lights are numbered as they are listed, from 0.
    Line,
    /// DMX512: address of each light's first colour channel, 1 to 512.
    Dmx {
        /// One for each light, in their order.
        addresses: Vec<u16>,
    },
}

/// A light that is lit: all others are dark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lit {
    /// Number of the light, from 0.
    pub light: usize,
    /// Its colour channel, from 0.
    pub channel: u8,
    /// Its drive, 1 to 255.
    pub level: u8,
}
