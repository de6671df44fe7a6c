//! The record's format. Every number has its standard uncertainty.

mod values;

use std::fmt::{self, Display, Formatter};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

pub use self::values::{
    DarkPatternValues, FlatValues, Flicker, LampValues, LightsValues, ResponseCurve,
    ResponseValues, ScaleValues, SensorValues,
};

/// What a record is about; also the name of its folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Noise, gain and limits of the sensor.
    Sensor,
    /// Relative response by pixel.
    Flat,
    /// Electrons per second for unit radiance.
    Scale,
    /// Irradiance of the lamp's channels at the sample.
    Lights,
    /// Exposure by count of a camera that is not linear.
    Response,
    /// How the lamp warms up, drifts and flickers.
    Lamp,
    /// Directions of the lights.
    Directions,
    /// Where the sample lies.
    Pose,
    /// Point spread, focus and aperture of the camera.
    Focus,
    /// The lens, and where the camera stands.
    Camera,
    /// Light that the lens scatters over the image.
    Glare,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Kind; 11] = [
        Kind::Sensor,
        Kind::Flat,
        Kind::Scale,
        Kind::Lights,
        Kind::Response,
        Kind::Lamp,
        Kind::Directions,
        Kind::Pose,
        Kind::Focus,
        Kind::Camera,
        Kind::Glare,
    ];

    /// The folder's name.
    pub fn folder(self) -> &'static str {
        match self {
            Kind::Sensor => "sensor",
            Kind::Flat => "flat",
            Kind::Scale => "scale",
            Kind::Lights => "lights",
            Kind::Response => "response",
            Kind::Lamp => "lamp",
            Kind::Directions => "directions",
            Kind::Pose => "pose",
            Kind::Focus => "focus",
            Kind::Camera => "camera",
            Kind::Glare => "glare",
        }
    }
}

/// One calibration, as its file has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Record<V> {
    /// The file's name without `.toml`; starts with the date by custom.
    pub id: String,
    pub kind: Kind,
    pub rig: String,
    /// Serial number of the device it was measured on.
    pub device_serial: String,
    /// When it was measured, UTC, RFC 3339.
    pub date: String,
    /// Until when it may be used, UTC, RFC 3339; absent: no end.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub valid_until: Option<String>,
    /// How the values were found, in words, e.g. "photon transfer, 20 levels of 2 frames".
    pub method: String,
    /// What they were found from: sessions, data sheet, certificate.
    pub source: String,
    /// The settings to which the values belong.
    #[serde(default)]
    pub settings: Settings,
    pub values: V,
}

/// Device settings to which a record's values belong; an absent one doesn't matter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Analogue gain, a factor.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub gain: Option<f64>,
    /// Significant bits of a raw count.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub bit_depth: Option<u32>,
    /// Width and height of a frame, pixels.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub resolution_px: Option<[u32; 2]>,
    /// Temperature of the sensor at the end of the measurement, °C.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub sensor_c: Option<f64>,
    /// Temperature of the lamp then, °C.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lamp_c: Option<f64>,
}

/// A measured number and its standard uncertainty (coverage factor 1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// The estimate.
    pub value: f64,
    /// Its standard uncertainty, same unit; 0 for a definition.
    pub std: f64,
}

impl Measured {
    /// A value with its standard uncertainty.
    pub const fn new(value: f64, std: f64) -> Self {
        Self { value, std }
    }
}

/// A value that no bench can have.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct BadValue {
    /// Dotted path of the key.
    pub key: String,
    pub value: String,
    pub allowed: String,
}

impl Measured {
    pub(super) fn check(self, key: &str, low: f64, high: f64) -> Result<(), BadValue> {
        within(&format!("{key}.value"), self.value, low, high)?;
        let known = self.std >= 0.0 && self.std.is_finite();
        must(
            known,
            &format!("{key}.std"),
            self.std,
            "a number of at least 0",
        )
    }
}

/// Value and uncertainty, with as many digits as the uncertainty has two of.
impl Display for Measured {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let digits = match self.std > 0.0 && self.std.is_finite() {
            true => (1.0 - self.std.log10().floor()).clamp(0.0, 9.0) as usize,
            false => 3,
        };
        write!(out, "{:.digits$} ± {:.digits$}", self.value, self.std)
    }
}

/// What the values of a kind of record must provide.
pub trait Values: Serialize + DeserializeOwned {
    /// Their kind.
    const KIND: Kind;
    /// Whether a bench can have them.
    fn check(&self) -> Result<(), BadValue>;
    /// Files next to the record that belong to it.
    fn maps(&self) -> Vec<&MapFile> {
        Vec::new()
    }
}

/// A file next to the record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    /// Its name, without folder.
    pub file: String,
    /// SHA-256 of its bytes, 64 hexadecimal digits.
    pub sha256: String,
}

/// Whether a value of the table `[values]` is as it must be.
pub(super) fn must(
    holds: bool,
    key: &str,
    value: impl Display,
    allowed: impl Into<String>,
) -> Result<(), BadValue> {
    match holds {
        true => Ok(()),
        false => Err(BadValue {
            key: format!("values.{key}"),
            value: value.to_string(),
            allowed: allowed.into(),
        }),
    }
}

/// Whether a number of the table `[values]` is in its range.
pub(super) fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), BadValue> {
    let allowed = format!("a number from {low} to {high}");
    must((low..=high).contains(&value), key, value, allowed)
}
