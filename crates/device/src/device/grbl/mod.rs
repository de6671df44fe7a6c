//! Light stages with a GRBL 1.1 controller: two axes turn the lamp, the spindle
//! and coolant outputs switch it.

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
pub use driver::{GrblStage, stop_port};

use super::kinematics::TwoAxes;
use crate::units::Seconds;

/// A GRBL stage as its driver needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct GrblConfig {
    /// Path of the serial port, best below `/dev/serial/by-id`.
    pub port: String,
    /// Bits per second; GRBL's default is 115200.
    pub baud: u32,
    /// Letters of the two axes, of XYZABC.
    pub axes: [char; 2],
    /// What the two axes do with the lamp.
    pub kinematics: TwoAxes,
    /// Speed of a move, axis units per minute; the firmware limits it to its own maximum.
    pub feed_per_min: f64,
    /// Commands that turn every lamp channel off, e.g. `M5`, `M9`.
    pub lamp_off: Vec<String>,
    /// Commands that turn on each channel, e.g. `M3 S1000` or `M7`.
    pub lamp_on: Vec<Vec<String>>,
    /// How long the firmware may take from opening the port until it speaks;
    /// boards that reset at opening need about 2 s.
    pub connect_timeout: Seconds,
    /// How long a reply may take.
    pub reply_timeout: Seconds,
    /// How long homing may take.
    pub homing_timeout: Seconds,
    /// How far a reached position may be from the commanded one, degrees.
    pub position_tolerance_deg: f64,
}

impl GrblConfig {
    /// A stage of which only the port is known: it can be queried, homed and
    /// stopped. X and Y count as azimuth and elevation in degrees, without limits;
    /// there is no lamp but `M5` and `M9` turn it off.
    pub fn of_port(port: &str, baud: u32) -> Self {
        Self {
            port: port.to_owned(),
            baud,
            axes: ['X', 'Y'],
            kinematics: TwoAxes::unlimited(),
            feed_per_min: 1000.0,
            lamp_off: vec!["M5".to_owned(), "M9".to_owned()],
            lamp_on: Vec::new(),
            connect_timeout: Seconds(5.0),
            reply_timeout: Seconds(2.0),
            homing_timeout: Seconds(120.0),
            position_tolerance_deg: 0.05,
        }
    }
}

/// Place of an axis in GRBL's position reports, X first.
#[cfg(feature = "serial")]
pub(super) fn axis_index(letter: char) -> Option<usize> {
    "XYZABC".find(letter)
}
