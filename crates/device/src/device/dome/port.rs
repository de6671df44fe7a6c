//! What the two kinds of domes have in common: lights over a serial line.

use std::time::Duration;

use super::Lit;
use crate::device::DeviceError;
use crate::device::guardian::Exchange;
use crate::device::serial_line::SerialLine;

/// What carries the wish for a light to the dome.
pub trait LightPort: Send + Sync {
    /// The port and its errors.
    fn line(&self) -> &SerialLine;
    /// What answers on the port.
    fn identify(&self, timeout: Duration) -> Result<Found, DeviceError>;
    /// Lights one, all others off.
    fn show(&self, lit: Option<Lit>) -> Result<(), DeviceError>;
    /// What the dome reports of its lights.
    fn read_back(&self) -> Result<ReadBack, DeviceError>;
    /// How warm the lights are, °C, where the dome reports.
    fn temperature_c(&self) -> Result<Option<f64>, DeviceError> {
        Ok(None)
    }
    /// How often the dome has said that it has restarted.
    fn restarts(&self) -> u64;
    /// All off, sent at once, also while a request is under way.
    fn off_now(&self) -> Result<(), DeviceError>;
    /// What another process sends to turn all off, whatever was under way, and
    /// what confirms it.
    fn off_exchanges(&self) -> Vec<Exchange>;
    /// Whether the dome reports which lights are lit.
    fn reports_lights(&self) -> bool;
}

/// What answers on a port.
pub struct Found {
    /// Version.
    pub firmware: String,
    /// Number of lights and of colour channels, where the dome reports.
    pub lights: Option<(usize, u8)>,
    /// Silence after which it turns its lights off.
    pub watchdog: Option<Duration>,
}

/// What a dome reports of its lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadBack {
    /// All off.
    Off,
    /// One is lit.
    Lit(Lit),
    /// One is driven, but no current flows.
    Dark(Lit),
    /// It doesn't say.
    Unverified,
}
