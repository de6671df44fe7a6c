//! Light domes: many lights that stand still, one lit at a time, over DMX512 behind an Enttec DMX
//! USB Pro or a compatible interface.

#[cfg(feature = "serial")]
mod dmx;
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
    /// DMX address of each light's first colour channel, 1 to 512, in their order.
    pub addresses: Vec<u16>,
    /// Colour channels of every light, 1 to 3.
    pub channels: u8,
    /// Drive of a lit light, 1 to 255.
    pub level: u8,
    /// How long the interface may take to answer at connection.
    pub connect_timeout: Seconds,
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
