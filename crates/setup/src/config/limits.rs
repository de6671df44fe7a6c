//! The `[limits]` table: how warm the devices may become.

use super::ConfigError;
use super::reader::Section;
use crate::device::temperature::TemperatureLimits;

/// Limits of a bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitsConfig {
    /// Above these a capture is suspended.
    pub temperature: TemperatureLimits,
    /// A calibration record is doubted where its temperature differs from now by more
    /// than this, °C.
    pub record_differs_c: f64,
}

impl LimitsConfig {
    /// Reads the table.
    pub fn read(mut table: Section) -> Result<Self, ConfigError> {
        let limits = Self {
            temperature: TemperatureLimits {
                sensor_c: table.number("sensor_c", -40.0..=150.0)?.optional(),
                lamp_c: table.number("lamp_c", -40.0..=300.0)?.optional(),
                margin_c: table.number("margin_c", 0.0..=50.0)?.or(5.0),
            },
            record_differs_c: table.number("record_differs_c", 0.1..=100.0)?.or(10.0),
        };
        table.finish()?;
        Ok(limits)
    }
}
