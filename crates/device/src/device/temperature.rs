//! How warm sensor and lamp may become.

use serde::{Deserialize, Serialize};

/// What has a temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The camera's sensor.
    Sensor,
    /// The lamp.
    Lamp,
}

impl std::fmt::Display for Part {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Part::Sensor => "sensor",
            Part::Lamp => "lamp",
        })
    }
}

/// Temperatures above which a capture is suspended; where there is none, any is fine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct TemperatureLimits {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_c: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lamp_c: Option<f64>,
    /// From how far below them a capture warns, °C, 0 or more.
    pub margin_c: f64,
}

/// A temperature against its limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Warmth {
    /// Well below, or there is no limit.
    Fine,
    /// Within the margin below this limit, °C.
    Near(f64),
    /// Above this limit, °C.
    Above(f64),
}

impl TemperatureLimits {
    /// Whether nothing is limited.
    pub fn is_none(&self) -> bool {
        self.sensor_c.is_none() && self.lamp_c.is_none()
    }

    /// What to think of a temperature, °C. One that is no number is above any limit.
    pub fn judge(&self, part: Part, temperature_c: f64) -> Warmth {
        let limit_c = match part {
            Part::Sensor => self.sensor_c,
            Part::Lamp => self.lamp_c,
        };
        match limit_c {
            None => Warmth::Fine,
            Some(limit_c) if temperature_c <= limit_c - self.margin_c => Warmth::Fine,
            Some(limit_c) if temperature_c <= limit_c => Warmth::Near(limit_c),
            Some(limit_c) => Warmth::Above(limit_c),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_part_has_its_own_limit() {
        let limits = TemperatureLimits {
            sensor_c: Some(60.0),
            lamp_c: None,
            margin_c: 5.0,
        };
        for (temperature_c, expected) in [
            (20.0, Warmth::Fine),
            (55.0, Warmth::Fine),
            (55.1, Warmth::Near(60.0)),
            (60.0, Warmth::Near(60.0)),
            (60.1, Warmth::Above(60.0)),
            (f64::NAN, Warmth::Above(60.0)),
        ] {
            assert_eq!(limits.judge(Part::Sensor, temperature_c), expected);
            assert_eq!(limits.judge(Part::Lamp, temperature_c), Warmth::Fine);
        }
        assert!(TemperatureLimits::default().is_none() && !limits.is_none());
    }
}
