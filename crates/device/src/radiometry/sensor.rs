//! The noise model of a linear sensor, as the merge and the exposure planning
//! believe it.
//!
//! A count is `black + K (signal + dark + read) + quantisation`, after
//! EMVA 1288: signal and dark electrons are Poisson, the read noise is normal,
//! counts are rounded.

use std::f64::consts::PI;
use std::ops::Range;

use super::linearity::Linearity;

/// What one sensor, at one gain setting, does to light.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorNoise {
    /// System gain K, DN per electron; > 0.
    pub gain_dn_per_e: f64,
    /// Standard deviation of the read noise, electrons; >= 0.
    pub read_noise_e: f64,
    /// Mean count without light at zero exposure, DN. Below 0 where counts were cut to fewer
    /// bits after the black level was subtracted: cutting loses half a count in the mean.
    pub black_level_dn: f64,
    /// Standard uncertainty of that mean, which all pixels share, DN. It enters how well
    /// exposures can be compared, and no pixel's value.
    pub black_level_std_dn: f64,
    /// Standard deviation of the black level between pixels, DN; 0 means that
    /// every pixel has the same. The merge estimates each pixel's own level as
    /// far as the frames determine it.
    pub black_level_spread_dn: f64,
    /// Counts at or above this are clipped, DN.
    pub saturation_dn: f64,
    /// Counts above this are not proportional to light, corrected or not, DN; at
    /// most `saturation_dn`.
    pub linear_max_dn: f64,
    /// How counts become proportional to light.
    pub linearity: Linearity,
    /// Mean dark current, electrons per second; used where no dark or ambient
    /// frames are given.
    pub dark_current_e_s: f64,
    /// Standard deviation of the dark current between pixels, electrons per second.
    pub dark_current_spread_e_s: f64,
    /// Significant bits of a count, 1..=16.
    pub bit_depth: u32,
    /// Electrons per second for unit radiance at a pixel of flat-field value 1; > 0.
    pub responsivity_e_s: f64,
    /// Relative response of each pixel; `None`: all 1.
    pub flat_field: Option<FlatField>,
    /// What single pixels count without light; `None`: only the means are known.
    pub dark_pattern: Option<DarkPattern>,
    /// Pixels whose dark current makes them useless; `None`: none known.
    pub hot_pixels: Option<Vec<bool>>,
}

/// Standard uncertainty of a black level that is stated as a whole count, DN.
const STATED_TO_ONE_DN: f64 = 0.288_675;

/// Each pixel's deviation from the mean darkness, row by row. The spreads of the
/// noise model are then those of what remains unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct DarkPattern {
    /// Offset from the black level, DN.
    pub offset_dn: Vec<f32>,
    /// Dark current less the mean, electrons per second.
    pub dark_current_e_s: Vec<f32>,
    /// Covariance of what remains unknown of a pixel's offset and its dark
    /// current, DN e⁻/s.
    pub remaining_covariance: f64,
}

/// Relative response of each pixel (mean 1), row by row, with its standard
/// deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatField {
    /// Response over the sensor's mean response; > 0.
    pub response: Vec<f32>,
    /// Standard uncertainty of each value.
    pub std_dev: Vec<f32>,
}

/// A value of the noise model that no sensor can have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum SensorError {
    #[error("sensor: {name} = {value} is outside {allowed}")]
    OutOfRange {
        name: &'static str,
        value: f64,
        allowed: String,
    },
    #[error("sensor: the {map} has {found} pixels and the frames have {expected}")]
    MapSize {
        map: &'static str,
        found: usize,
        expected: usize,
    },
}

impl SensorNoise {
    /// A sensor with no flat field, no hot pixels and no spread between its
    /// pixels, linear up to full scale.
    pub fn ideal(
        gain_dn_per_e: f64,
        read_noise_e: f64,
        black_level_dn: f64,
        bit_depth: u32,
    ) -> Self {
        let full_scale_dn = (1u64 << bit_depth.clamp(1, 16)) as f64 - 1.0;
        Self {
            gain_dn_per_e,
            read_noise_e,
            black_level_dn,
            black_level_std_dn: STATED_TO_ONE_DN,
            black_level_spread_dn: 0.0,
            saturation_dn: full_scale_dn,
            linear_max_dn: full_scale_dn,
            linearity: Linearity::NONE,
            dark_current_e_s: 0.0,
            dark_current_spread_e_s: 0.0,
            bit_depth,
            responsivity_e_s: 1.0,
            flat_field: None,
            dark_pattern: None,
            hot_pixels: None,
        }
    }

    /// What to expect of a camera of which nothing was measured: ten thousand electrons at
    /// full scale and gain 1, 3 e⁻ of read noise, a black level of 1/64 of full scale, as
    /// machine vision sensors have. Good for estimates of time, never for a merge.
    pub fn usual(bit_depth: u32, gain: f64) -> Self {
        let full_scale_dn = (1u64 << bit_depth.clamp(1, 16)) as f64 - 1.0;
        let gain_dn_per_e = gain * full_scale_dn / 1e4;
        Self::ideal(
            gain_dn_per_e,
            3.0,
            (full_scale_dn / 64.0).floor(),
            bit_depth,
        )
    }

    /// Checks every value, and the maps against frames of `pixels` pixels.
    pub fn check(&self, pixels: usize) -> Result<(), SensorError> {
        let check = |name, value: f64, low: f64, high: f64, open: bool| {
            let inside =
                value.is_finite() && value <= high && value >= low && !(open && value == low);
            if inside {
                return Ok(());
            }
            let bracket = if open { '(' } else { '[' };
            Err(SensorError::OutOfRange {
                name,
                value,
                allowed: format!("{bracket}{low}, {high}]"),
            })
        };
        let from = |name, value, low, high| check(name, value, low, high, false);
        let above = |name, value, low, high| check(name, value, low, high, true);
        // Numbers.
        from("bit_depth", f64::from(self.bit_depth), 1.0, 16.0)?;
        let (own, full) = (self, (1u64 << self.bit_depth) as f64 - 1.0);
        above("gain_dn_per_e", own.gain_dn_per_e, 0.0, 1e9)?;
        from("read_noise_e", own.read_noise_e, 0.0, 1e9)?;
        above("saturation_dn", own.saturation_dn, 0.0, full)?;
        let (saturation, most) = (own.saturation_dn, own.linear_max_dn);
        above("linear_max_dn", most, 0.0, saturation)?;
        from("black_level_dn", own.black_level_dn, -full, most)?;
        from("black_level_std_dn", own.black_level_std_dn, 0.0, full)?;
        let spread = own.black_level_spread_dn;
        from("black_level_spread_dn", spread, 0.0, full)?;
        from("dark_current_e_s", own.dark_current_e_s, 0.0, 1e12)?;
        let spread = own.dark_current_spread_e_s;
        from("dark_current_spread_e_s", spread, 0.0, 1e12)?;
        let responsivity = own.responsivity_e_s;
        above("responsivity_e_s", responsivity, 0.0, f64::MAX)?;
        let range_dn = self.ceiling_dn() - self.black_level_dn;
        if !(self.linearity.grows_up_to(range_dn) && self.linearity.has_covariance()) {
            return Err(SensorError::OutOfRange {
                name: "linearity",
                value: self.linearity.coefficients[0],
                allowed: "those whose signal grows with every count".to_owned(),
            });
        }
        // Maps.
        if let Some(hot) = &self.hot_pixels {
            map_size("hot-pixel map", hot.len(), pixels)?;
        }
        if let Some(dark) = &self.dark_pattern {
            map_size("offset map", dark.offset_dn.len(), pixels)?;
            map_size("dark-current map", dark.dark_current_e_s.len(), pixels)?;
            for &value in dark.offset_dn.iter().chain(&dark.dark_current_e_s) {
                from("dark pattern", f64::from(value), -1e12, 1e12)?;
            }
        }
        if let Some(flat) = &self.flat_field {
            map_size("flat field", flat.response.len(), pixels)?;
            map_size("flat field's uncertainty", flat.std_dev.len(), pixels)?;
            for &value in &flat.response {
                above("flat field", f64::from(value), 0.0, 1e6)?;
            }
            for &value in &flat.std_dev {
                from("flat field's uncertainty", value.into(), 0.0, 1e6)?;
            }
        }
        Ok(())
    }

    /// The same sensor of which only these rows of `width` pixels are read.
    pub fn rows(&self, width: usize, rows: Range<usize>) -> Self {
        let pixels = rows.start * width..rows.end * width;
        Self {
            flat_field: self.flat_field.as_ref().map(|flat| FlatField {
                response: flat.response[pixels.clone()].to_vec(),
                std_dev: flat.std_dev[pixels.clone()].to_vec(),
            }),
            dark_pattern: self.dark_pattern.as_ref().map(|dark| DarkPattern {
                offset_dn: dark.offset_dn[pixels.clone()].to_vec(),
                dark_current_e_s: dark.dark_current_e_s[pixels.clone()].to_vec(),
                ..*dark
            }),
            hot_pixels: self.hot_pixels.as_ref().map(|hot| hot[pixels].to_vec()),
            ..*self
        }
    }

    /// Highest count that may be used, DN.
    pub fn ceiling_dn(&self) -> f64 {
        self.linear_max_dn.min(self.saturation_dn)
    }

    /// Signal of the highest count that may be used, DN.
    pub fn usable_range_dn(&self) -> f64 {
        self.signal_dn(self.ceiling_dn())
    }

    /// What is proportional to light of a count, or of a mean of counts of one
    /// pixel: less the black level, and corrected, DN.
    pub fn signal_dn(&self, count_dn: f64) -> f64 {
        self.linearity
            .proportional_dn(count_dn - self.black_level_dn)
    }

    /// What of a pixel's counts its own offset makes, DN.
    pub fn offset_dn(&self, pixel: usize) -> f64 {
        let dark = self.dark_pattern.as_ref();
        dark.map_or(0.0, |dark| f64::from(dark.offset_dn[pixel]))
    }

    /// A pixel's dark current, electrons per second.
    pub fn dark_current_of(&self, pixel: usize) -> f64 {
        let dark = self.dark_pattern.as_ref();
        self.dark_current_e_s + dark.map_or(0.0, |dark| f64::from(dark.dark_current_e_s[pixel]))
    }

    /// Derivatives of [`Self::signal_dn`] by the coefficients of the linearity
    /// correction, DN.
    pub fn per_linearity(&self, count_dn: f64) -> [f64; 2] {
        self.linearity
            .per_coefficient(count_dn - self.black_level_dn)
    }

    /// Variance of one count with a mean of `electrons` (signal and dark), DN²,
    /// after the correction of its linearity (which photon noise makes an exact
    /// statement; that read noise grows with the correction's slope is neglected).
    /// Negative means, which noisy estimates have, count as zero.
    pub fn count_variance_dn2(&self, electrons: f64) -> f64 {
        self.analogue_variance_dn2(electrons) + 1.0 / 12.0
    }

    /// Variance of the mean of `frames` counts of one pixel, DN².
    ///
    /// Rounding errors of repeated frames are independent only where noise
    /// spans several counts; the part that all frames share is the variance of
    /// the mean rounding error over the position between two counts,
    /// `Σ exp(−4π²k²σ²) / (2π²k²)` for normal noise of σ DN (the Fourier series
    /// of the rounding error, damped by the noise's characteristic function).
    pub fn mean_count_variance_dn2(&self, electrons: f64, frames: u32) -> f64 {
        let analogue = self.analogue_variance_dn2(electrons);
        let shared = shared_rounding_variance_dn2(analogue);
        shared + (analogue + 1.0 / 12.0 - shared) / f64::from(frames.max(1))
    }

    fn analogue_variance_dn2(&self, electrons: f64) -> f64 {
        self.gain_dn_per_e.powi(2) * (self.read_noise_e.powi(2) + electrons.max(0.0))
    }
}

fn map_size(map: &'static str, found: usize, expected: usize) -> Result<(), SensorError> {
    if found == expected {
        return Ok(());
    }
    Err(SensorError::MapSize {
        map,
        found,
        expected,
    })
}

fn shared_rounding_variance_dn2(variance_dn2: f64) -> f64 {
    if variance_dn2 > 0.5 {
        return 0.0;
    }
    if variance_dn2 < 1e-4 {
        return 1.0 / 12.0;
    }
    (1..40)
        .map(|k| {
            let k2 = f64::from(k * k);
            (-4.0 * PI * PI * k2 * variance_dn2).exp() / (2.0 * PI * PI * k2)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_core::random::{Purpose, stream};

    /// Mean of n rounded normal numbers over random positions between counts,
    /// against the formula; 5 standard deviations of a sample variance.
    #[test]
    fn rounding_is_shared_between_frames_where_the_noise_is_small() {
        let trials = 40_000u64;
        for (sigma_dn, frames) in [(0.0, 16), (0.15, 16), (0.3, 8), (1.0, 16)] {
            let sensor = SensorNoise::ideal(1.0, sigma_dn, 0.0, 12);
            let mut sum2 = 0.0;
            for trial in 0..trials {
                let mut random = stream(11, Purpose::Experiment, frames, trial, 0);
                let level = 100.0 + random.uniform();
                let mean: f64 = (0..frames)
                    .map(|_| (level + sigma_dn * random.normal()).round())
                    .sum::<f64>()
                    / frames as f64;
                sum2 += (mean - level).powi(2);
            }
            let measured = sum2 / trials as f64;
            let stated = sensor.mean_count_variance_dn2(0.0, frames as u32);
            assert!(
                (measured / stated - 1.0).abs() < 5.0 * (2.0 / trials as f64).sqrt(),
                "sigma {sigma_dn} DN, {frames} frames: measured {measured}, stated {stated}"
            );
        }
    }

    #[test]
    fn impossible_sensors_are_named() {
        let good = SensorNoise::ideal(0.5, 2.0, 64.0, 12);
        assert_eq!(good.check(4), Ok(()));
        type Spoil = fn(&mut SensorNoise);
        let cases: [(&str, Spoil); 9] = [
            ("linearity", |s| s.linearity.coefficients = [-5000.0, 0.0]),
            ("gain_dn_per_e", |s| s.gain_dn_per_e = 0.0),
            ("gain_dn_per_e", |s| s.gain_dn_per_e = f64::NAN),
            ("read_noise_e", |s| s.read_noise_e = -1.0),
            ("saturation_dn", |s| s.saturation_dn = 4096.0),
            ("linear_max_dn", |s| s.linear_max_dn = 4095.5),
            ("black_level_dn", |s| s.black_level_dn = 5000.0),
            ("bit_depth", |s| s.bit_depth = 40),
            ("hot-pixel map", |s| s.hot_pixels = Some(vec![false; 3])),
        ];
        for (name, spoil) in cases {
            let mut sensor = good.clone();
            spoil(&mut sensor);
            let message = sensor.check(4).unwrap_err().to_string();
            assert!(message.contains(name), "{name}: {message}");
        }
    }
}
