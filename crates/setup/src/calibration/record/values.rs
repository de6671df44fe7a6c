//! The values of the sensor's, the lamp's and the scale's records.

use serde::{Deserialize, Serialize};

use super::{BadValue, Kind, MapFile, Measured, Values, must, within};
use crate::calibration::pixel_map::PixelMap;
use crate::calibration::white_lights::LightIntensity;
use crate::radiometry::linearity::Linearity;
use crate::radiometry::response::Response;

/// Noise, gain and limits of a sensor at one gain setting, after EMVA 1288.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorValues {
    /// System gain K, DN per electron.
    pub gain_dn_per_e: Measured,
    /// Read noise, standard deviation, electrons.
    pub read_noise_e: Measured,
    /// Mean count without light at zero exposure, DN.
    pub black_level_dn: Measured,
    /// Standard deviation of the black level over the pixels, DN.
    pub black_level_spread_dn: Measured,
    /// Electrons at saturation.
    pub full_well_e: Measured,
    /// Mean dark current at the temperature of the measurement, electrons per second.
    pub dark_current_e_s: Measured,
    /// Standard deviation of the dark current over the pixels, electrons per second.
    pub dark_current_spread_e_s: Measured,
    /// Counts at or above this are clipped, DN.
    pub saturation_dn: f64,
    /// Counts above this are not proportional to light, DN.
    pub linear_max_dn: f64,
    /// Largest deviation from proportionality below `linear_max_dn`, relative,
    /// before any correction.
    pub linearity_error: f64,
    /// ... and after the correction; absent where there is none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub linearity_residual: Option<f64>,
    /// Significant bits of a count.
    pub bit_depth: u32,
    /// Pixels whose dark current makes them useless: column, row.
    #[serde(default)]
    pub hot_pixels: Vec<[u32; 2]>,
    /// How counts become proportional to light; absent: they are.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub linearity: Option<Linearity>,
    /// What single pixels count without light; absent: only the means are known.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub dark_pattern: Option<DarkPatternValues>,
}

/// Each pixel's deviation from the sensor's mean darkness (DSNU), as far as the
/// dark frames determine it above noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DarkPatternValues {
    /// Offset of a pixel from the black level, DN; 0 at hot pixels.
    pub offset_dn: PixelMap,
    /// Dark current of a pixel less the mean, electrons per second; 0 at hot pixels.
    pub dark_current_e_s: PixelMap,
    /// Covariance of what remains unknown of a pixel's offset (DN) and dark
    /// current (electrons per second).
    pub covariance: [[f64; 2]; 2],
}

impl Values for SensorValues {
    const KIND: Kind = Kind::Sensor;

    fn check(&self) -> Result<(), BadValue> {
        self.gain_dn_per_e.check("gain_dn_per_e", 1e-6, 1e6)?;
        self.read_noise_e.check("read_noise_e", 0.0, 1e5)?;
        self.black_level_dn.check("black_level_dn", 0.0, 65_535.0)?;
        self.black_level_spread_dn
            .check("black_level_spread_dn", 0.0, 65_535.0)?;
        self.full_well_e.check("full_well_e", 1.0, 1e9)?;
        self.dark_current_e_s.check("dark_current_e_s", 0.0, 1e9)?;
        self.dark_current_spread_e_s
            .check("dark_current_spread_e_s", 0.0, 1e9)?;
        let bits = self.bit_depth;
        must((1..=16).contains(&bits), "bit_depth", bits, "from 1 to 16")?;
        let full_scale_dn = f64::from((1u32 << bits) - 1);
        within("saturation_dn", self.saturation_dn, 0.0, full_scale_dn)?;
        let below = (0.0..=self.saturation_dn).contains(&self.linear_max_dn);
        let allowed = format!("from 0 to saturation_dn ({})", self.saturation_dn);
        must(below, "linear_max_dn", self.linear_max_dn, allowed)?;
        within("linearity_error", self.linearity_error, 0.0, 1.0)?;
        const COVARIANCE: &str = "symmetric and positive semidefinite";
        if let Some(dark) = &self.dark_pattern {
            dark.offset_dn.check("dark_pattern.offset_dn")?;
            let key = "dark_pattern.dark_current_e_s";
            dark.dark_current_e_s.check(key)?;
            let [[a, b], [c, d]] = dark.covariance;
            let possible = a >= 0.0 && d >= 0.0 && b == c && b * b <= a * d * (1.0 + 1e-9);
            let possible = possible && a.is_finite() && d.is_finite();
            let value = format!("{:?}", dark.covariance);
            must(possible, "dark_pattern.covariance", value, COVARIANCE)?;
        }
        if let Some(linearity) = &self.linearity {
            let range_dn = self.linear_max_dn - self.black_level_dn.value;
            let allowed = format!("such that the signal grows up to {range_dn} DN");
            let value = format!("{:?}", linearity.coefficients);
            let grows = linearity.grows_up_to(range_dn);
            must(grows, "linearity.coefficients", value, allowed)?;
            let value = format!("{:?}", linearity.covariance);
            let possible = linearity.has_covariance();
            must(possible, "linearity.covariance", value, COVARIANCE)?;
        }
        Ok(())
    }

    fn maps(&self) -> Vec<&MapFile> {
        let patterns = self.dark_pattern.iter();
        patterns
            .flat_map(|dark| [&dark.offset_dn.map, &dark.dark_current_e_s.map])
            .collect()
    }
}

/// Relative response by pixel (mean 1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlatValues {
    /// One channel, 16-bit PNG or EXR.
    pub map: MapFile,
    /// Response of a PNG's count 1: `response = count * response_per_count`; 1 for EXR.
    pub response_per_count: f64,
    /// Standard uncertainty of each pixel's response.
    pub std: f64,
    /// Other light over the light itself, which was subtracted; absent where only
    /// dark frames were.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ambient: Option<Measured>,
}

impl Values for FlatValues {
    const KIND: Kind = Kind::Flat;

    fn check(&self) -> Result<(), BadValue> {
        let scale = self.response_per_count;
        let possible = scale > 0.0 && scale <= 1.0;
        must(possible, "response_per_count", scale, "above 0, at most 1")?;
        within("std", self.std, 0.0, 1.0)?;
        if let Some(ambient) = self.ambient {
            ambient.check("ambient", -1.0, 10.0)?;
        }
        Ok(())
    }

    fn maps(&self) -> Vec<&MapFile> {
        vec![&self.map]
    }
}

/// The radiometric scale of lens and sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScaleValues {
    /// Electrons per second for a radiance of 1 W/(m² sr) at a pixel of response 1.
    pub responsivity_e_s: Measured,
}

impl Values for ScaleValues {
    const KIND: Kind = Kind::Scale;

    fn check(&self) -> Result<(), BadValue> {
        self.responsivity_e_s.check("responsivity_e_s", 1e-9, 1e15)
    }
}

/// The lamp, as the sample sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightsValues {
    /// Irradiance across the light at the sample's origin, for R, G and B, W/m²; the mean
    /// of several lights.
    pub irradiance_w_m2: [Measured; 3],
    /// Each light against their mean, where a session of several was measured.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub lights: Vec<LightIntensity>,
}

impl Values for LightsValues {
    const KIND: Kind = Kind::Lights;

    fn check(&self) -> Result<(), BadValue> {
        let mut channels = self.irradiance_w_m2.iter();
        channels.try_for_each(|channel| channel.check("irradiance_w_m2", 1e-9, 1e9))?;
        for light in &self.lights {
            for relative in light.relative {
                relative.check("lights.relative", 1e-3, 1e3)?;
            }
            let shape = light.slope_per_mm.iter().chain(&light.curve_per_mm2);
            for term in shape.chain([&light.uneven]) {
                must(
                    term.is_finite(),
                    "lights.slope_per_mm",
                    term,
                    "finite numbers",
                )?;
            }
        }
        Ok(())
    }
}

/// Which exposure each 8-bit count of a camera that is not linear stands for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResponseValues {
    /// One curve (grey) or three (red, green, blue).
    pub channels: Vec<ResponseCurve>,
}

/// The curve of one channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResponseCurve {
    /// Natural logarithm of the relative exposure for each of the 256 counts; grows.
    pub ln_exposure: Vec<f64>,
    /// Standard uncertainty of each.
    pub ln_std: Vec<f64>,
    /// Lowest count that depends on light; 0 in records that do not state it.
    #[serde(default)]
    pub darkest: u8,
}

impl From<Response> for ResponseCurve {
    fn from(response: Response) -> Self {
        Self {
            ln_exposure: response.ln_exposure,
            ln_std: response.ln_std,
            darkest: response.darkest,
        }
    }
}

impl From<ResponseCurve> for Response {
    fn from(curve: ResponseCurve) -> Self {
        Self {
            ln_exposure: curve.ln_exposure,
            ln_std: curve.ln_std,
            darkest: curve.darkest,
        }
    }
}

impl Values for ResponseValues {
    const KIND: Kind = Kind::Response;

    fn check(&self) -> Result<(), BadValue> {
        let channels = self.channels.len();
        must(
            [1, 3].contains(&channels),
            "channels",
            channels,
            "1 or 3 curves",
        )?;
        for curve in &self.channels {
            let darkest = curve.darkest;
            must(darkest <= 128, "channels.darkest", darkest, "at most 128")?;
            let mut numbers = curve.ln_exposure.iter().chain(&curve.ln_std);
            let counts = [curve.ln_exposure.len(), curve.ln_std.len()];
            let whole = counts == [256; 2] && numbers.all(|x| x.is_finite());
            let value = format!("{counts:?} numbers");
            must(whole, "channels", value, "256 finite numbers each")?;
            for pair in curve.ln_exposure.windows(2) {
                let allowed = "above the one of the count before";
                must(pair[1] > pair[0], "channels.ln_exposure", pair[1], allowed)?;
            }
        }
        Ok(())
    }
}

/// The lamp over time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LampValues {
    /// Part of the warm lamp's light that is missing at switching on.
    pub warm_up_fraction: Measured,
    /// Time constant with which it appears, seconds; 0 where none is missing.
    pub warm_up_constant_s: Measured,
    /// Time after which less than a thousandth is missing, seconds.
    pub warm_up_time_s: f64,
    /// Relative change of the warm lamp per hour.
    pub drift_per_hour: Measured,
    /// Shortest measured exposure from which on flicker stays below 0.2%; absent: none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub steady_from_s: Option<f64>,
    /// Flicker by exposure.
    pub flicker: Vec<Flicker>,
}

/// How much frames of one exposure differ.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flicker {
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Standard deviation between frames over their mean, noise taken out.
    pub relative: Measured,
}

impl Values for LampValues {
    const KIND: Kind = Kind::Lamp;

    fn check(&self) -> Result<(), BadValue> {
        self.warm_up_fraction
            .check("warm_up_fraction", -10.0, 1.0)?;
        self.warm_up_constant_s
            .check("warm_up_constant_s", 0.0, 1e6)?;
        self.drift_per_hour.check("drift_per_hour", -100.0, 100.0)?;
        within("warm_up_time_s", self.warm_up_time_s, 0.0, 1e7)?;
        for flicker in &self.flicker {
            flicker.relative.check("flicker.relative", 0.0, 10.0)?;
        }
        Ok(())
    }
}
