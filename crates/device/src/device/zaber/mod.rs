//! Light stages on Zaber devices (ASCII protocol, firmware 6 and 7): two axes
//! turn the lamp, digital outputs or an illuminator switch it.

#[cfg(feature = "serial")]
mod codes;
#[cfg(feature = "serial")]
mod driver;
#[cfg(feature = "serial")]
mod link;
pub mod protocol;
#[cfg(all(test, feature = "serial"))]
mod tests;

#[cfg(feature = "serial")]
pub use driver::{ZaberStage, stop_port};

use super::kinematics::TwoAxes;
use crate::units::Seconds;

/// Where an axis is on the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisAddress {
    /// Number of the device, 1 to 99.
    pub device: u8,
    /// Number of the axis on it, 1 to 9.
    pub axis: u8,
}

impl std::fmt::Display for AxisAddress {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{}/{}", self.device, self.axis)
    }
}

/// What switches a channel of the lamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LampSwitch {
    /// A digital output of a device.
    Output {
        /// Number of the device.
        device: u8,
        /// Number of the output, from 1.
        output: u8,
    },
    /// A lamp of an illuminator, at the flux that is set in it.
    Illuminator(AxisAddress),
}

#[cfg(feature = "serial")]
impl LampSwitch {
    /// Device, axis and words that turn it on or off.
    fn command(self, on: bool) -> (u8, u8, String) {
        match self {
            Self::Output { device, output } => {
                (device, 0, format!("io set do {output} {}", u8::from(on)))
            }
            Self::Illuminator(AxisAddress { device, axis }) => {
                let words = if on { "lamp on" } else { "lamp off" };
                (device, axis, words.to_owned())
            }
        }
    }
}

/// A Zaber stage as its driver needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct ZaberConfig {
    /// Path of the serial port, best below `/dev/serial/by-id`.
    pub port: String,
    /// Bits per second; Zaber's ASCII default is 115200.
    pub baud: u32,
    /// The two axes on the chain.
    pub axes: [AxisAddress; 2],
    /// What the two axes do with the lamp; scales in microsteps.
    pub kinematics: TwoAxes,
    /// Speed of an axis for estimates, degrees or mm per second; what counts is
    /// the device's own setting.
    pub speed_per_s: f64,
    /// The lamp's channels.
    pub lamp: Vec<LampSwitch>,
    /// How long the devices may take to answer at connection.
    pub connect_timeout: Seconds,
    /// How long a reply may take.
    pub reply_timeout: Seconds,
    /// How long homing may take.
    pub homing_timeout: Seconds,
    /// How far a reached position may be from the commanded one, degrees.
    pub position_tolerance_deg: f64,
}

impl ZaberConfig {
    /// Axes 1 and 2 of device 1, of which only the port is known: they can be
    /// queried, homed and stopped. There is no lamp.
    pub fn of_port(port: &str, baud: u32) -> Self {
        Self {
            port: port.to_owned(),
            baud,
            axes: [1, 2].map(|axis| AxisAddress { device: 1, axis }),
            kinematics: TwoAxes::unlimited(),
            speed_per_s: 20.0,
            lamp: Vec::new(),
            connect_timeout: Seconds(5.0),
            reply_timeout: Seconds(1.0),
            homing_timeout: Seconds(120.0),
            position_tolerance_deg: 0.05,
        }
    }
}
