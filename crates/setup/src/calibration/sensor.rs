//! Photon transfer: gain, read noise, black level, dark current, full well,
//! linearity and hot pixels of a sensor, from dark frames and frames of a
//! steady uniform light at several exposures, after EMVA 1288.
//!
//! Only sums per exposure are kept. Variances are temporal (each pixel against
//! its own mean, each frame's mean level taken out, so that a slowly drifting
//! lamp does no harm); what differs between pixels stays out of them.

mod darkness;
pub mod emva1288;
mod linearity;
mod saturation;
mod variance_line;

use serde::Serialize;

use self::darkness::Darkness;
use self::linearity::{LinearLevel, LinearityFit};
use self::saturation::Saturation;
use self::variance_line::VarianceLine;
use super::pixel_map::{MapError, NamedBytes, PixelMap};
use super::record::{DarkPatternValues, Measured, SensorValues};
use crate::radiometry::linearity::Linearity;

/// Which light a calibration frame has seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exposed {
    /// The steady, uniform light.
    Flat,
    /// No light.
    Dark,
    /// What else lights the camera, the light itself off.
    Ambient,
}

/// Why frames do not make a calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum SensorFitError {
    #[error("the frame has {found} pixels, the first one had {expected}")]
    FrameSize { found: usize, expected: usize },
    #[error("{what}: {found}, and at least {needed} are needed")]
    TooFew {
        what: &'static str,
        found: usize,
        needed: usize,
    },
    /// The brightest flats are still far from saturation.
    #[error(
        "no flat saturates; the brightest has a mean of {brightest_dn:.0} DN, so the full well remains unknown"
    )]
    NeverSaturates { brightest_dn: f64 },
    #[error(
        "counts deviate by {error:.1}% from proportionality to light; at most {allowed:.0}% can be corrected"
    )]
    NotLinear { error: f64, allowed: f64 },
    #[error(
        "counts deviate by up to {error:.1}% from any smooth curve below 70% of saturation; at most {allowed:.0}% can be accepted"
    )]
    NotSmooth { error: f64, allowed: f64 },
    #[error("the variance does not grow with the mean (slope {slope:.3e} DN per DN)")]
    NoPhotonNoise { slope: f64 },
}

/// The curve is fitted up to this part of saturation (EMVA 1288, 6.6).
const FIT_UP_TO: f64 = 0.7;

/// The frames of a photon transfer measurement, summed.
#[derive(Clone, Debug, Default)]
pub struct PhotonTransfer {
    levels: Vec<Level>,
}

/// All frames of one light and one exposure.
#[derive(Clone, Debug)]
struct Level {
    exposed: Exposed,
    exposure_s: f64,
    frames: u32,
    sum: Vec<u32>,
    sum_of_squares: Vec<u64>,
    frame_means: Vec<f64>,
}

/// One point of the curve, its linearity corrected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TransferPoint {
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Which light.
    #[serde(skip)]
    pub exposed: Exposed,
    /// Mean count above the black level, as counted, DN.
    pub counted_dn: f64,
    /// The same in proportion to light, DN.
    pub signal_dn: f64,
    /// Temporal variance of that, DN².
    pub variance_dn2: f64,
    /// Standard uncertainty of the variance, DN².
    pub variance_std_dn2: f64,
    /// Whether it is part of the fit.
    pub fitted: bool,
}

/// Each pixel's deviation from the mean darkness.
#[derive(Clone, Debug, PartialEq)]
pub struct DarkFit {
    /// Offset from the black level, DN.
    pub offset_dn: Vec<f64>,
    /// Dark current less the mean, electrons per second.
    pub dark_current_e_s: Vec<f64>,
    /// Covariance of what remains unknown of both.
    pub covariance: [[f64; 2]; 2],
}

impl DarkFit {
    /// As the record has it, with the bytes of its two maps: `<id>-offset.png` and
    /// `<id>-dark.png` of rows of `width` pixels.
    ///
    /// # Errors
    /// A size that is not `width` times rows.
    pub fn to_values(
        &self,
        width: usize,
        id: &str,
    ) -> Result<(DarkPatternValues, [NamedBytes; 2]), MapError> {
        let files = ["offset", "dark"].map(|what| format!("{id}-{what}.png"));
        let (offset_dn, offset_png) = PixelMap::new(&self.offset_dn, width, &files[0])?;
        let (dark_current_e_s, dark_png) = PixelMap::new(&self.dark_current_e_s, width, &files[1])?;
        let values = DarkPatternValues {
            offset_dn,
            dark_current_e_s,
            covariance: self.covariance,
        };
        let [offset_file, dark_file] = files;
        Ok((values, [(offset_file, offset_png), (dark_file, dark_png)]))
    }
}

/// A sensor's calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorFit {
    /// What the record holds.
    pub values: SensorValues,
    /// Hot pixels, row by row.
    pub hot: Vec<bool>,
    /// What single pixels count without light.
    pub dark: DarkFit,
    /// The curve, dark levels first, by exposure.
    pub curve: Vec<TransferPoint>,
    /// Variance at zero signal: read noise and quantisation, DN².
    pub variance_at_zero_dn2: f64,
    /// χ² of the fitted points over their degrees of freedom.
    pub reduced_chi2: f64,
}

impl TransferPoint {
    fn corrected(&self, linearity: &Linearity) -> Self {
        Self {
            signal_dn: linearity.proportional_dn(self.counted_dn),
            variance_dn2: self.variance_dn2 * linearity.slope(self.counted_dn).powi(2),
            ..*self
        }
    }
}

impl PhotonTransfer {
    /// Adds a frame of raw counts.
    ///
    /// # Errors
    /// A frame of another size than the first.
    pub fn add(
        &mut self,
        exposed: Exposed,
        exposure_s: f64,
        counts: &[u16],
    ) -> Result<(), SensorFitError> {
        if let Some(first) = self.levels.first()
            && first.sum.len() != counts.len()
        {
            return Err(SensorFitError::FrameSize {
                found: counts.len(),
                expected: first.sum.len(),
            });
        }
        let same = |level: &Level| {
            level.exposed == exposed && (level.exposure_s - exposure_s).abs() <= 1e-9 * exposure_s
        };
        let at = match self.levels.iter().position(same) {
            Some(at) => at,
            None => {
                self.levels.push(Level {
                    exposed,
                    exposure_s,
                    frames: 0,
                    sum: vec![0; counts.len()],
                    sum_of_squares: vec![0; counts.len()],
                    frame_means: Vec::new(),
                });
                self.levels.len() - 1
            }
        };
        let level = &mut self.levels[at];
        // 16-bit counts: the sums hold 65,536 frames, more than anyone takes.
        let mut total = 0u64;
        for ((sum, squares), &count) in level
            .sum
            .iter_mut()
            .zip(&mut level.sum_of_squares)
            .zip(counts)
        {
            *sum = sum.saturating_add(u32::from(count));
            *squares += u64::from(count).pow(2);
            total += u64::from(count);
        }
        level.frames += 1;
        level
            .frame_means
            .push(total as f64 / counts.len().max(1) as f64);
        Ok(())
    }

    /// Fits the sensor. `width` is the number of pixels per row and
    /// `bit_depth` the significant bits of a count.
    ///
    /// It takes two frames per level, dark frames at two exposures or more,
    /// and flats at five or more below and one at saturation.
    ///
    /// # Errors
    /// Too few frames, no saturated level, or a sensor that is not linear or
    /// shows no photon noise.
    pub fn solve(&self, width: usize, bit_depth: u32) -> Result<SensorFit, SensorFitError> {
        let dark = self.sorted(Exposed::Dark);
        let flats = self.sorted(Exposed::Flat);
        at_least("exposures of dark frames", dark.len(), 2)?;
        at_least("exposures of flats", flats.len(), 6)?;
        for level in dark.iter().chain(&flats) {
            at_least("frames at an exposure", level.frames as usize, 2)?;
        }

        // Darkness: black level and dark current, and how pixels scatter about them.
        let darkness = Darkness::fit(&dark);
        let hot = darkness.hot_pixels();
        let cold: Vec<usize> = (0..hot.len()).filter(|&p| !hot[p]).collect();
        at_least("pixels that are not hot", cold.len(), 2)?;
        let (black, black_spread) = darkness.statistics(&darkness.offset_dn, &cold, 0);
        let (slope, slope_spread) = darkness.statistics(&darkness.slope_dn_s, &cold, 1);
        let black_dn = black.value;

        // The transfer curve as counted: signal and temporal variance of each level.
        let saturation = Saturation::find(&flats, &cold, bit_depth)?;
        let usable_dn = saturation.count_dn - black_dn;
        let levels: Vec<&Level> = dark.iter().chain(&flats).copied().collect();
        let counted: Vec<TransferPoint> = levels
            .iter()
            .map(|level| {
                let counted_dn = level.mean_over(&cold) - black_dn;
                let variance_dn2 = level.temporal_variance(&cold);
                TransferPoint {
                    exposure_s: level.exposure_s,
                    exposed: level.exposed,
                    counted_dn,
                    signal_dn: counted_dn,
                    variance_dn2,
                    variance_std_dn2: variance_dn2 * (2.0 / level.freedom(&cold)).sqrt(),
                    fitted: counted_dn <= FIT_UP_TO * usable_dn,
                }
            })
            .collect();
        let fitted_flats = counted
            .iter()
            .filter(|p| p.fitted && p.exposed == Exposed::Flat);
        at_least("flats below 70% of saturation", fitted_flats.count(), 4)?;
        // Linearity, and the variance line of the corrected curve.
        let lit: Vec<LinearLevel> = levels
            .iter()
            .zip(&counted)
            .filter(|(level, _)| level.exposed == Exposed::Flat)
            .map(|(level, point)| level.linear_level(point, &cold, slope.value))
            .collect();
        let bend = LinearityFit::find(&lit, black.std, usable_dn)?;
        let freedom: Vec<f64> = levels.iter().map(|level| level.freedom(&cold)).collect();
        let line_by = |linearity: &Linearity| {
            let mut curve: Vec<TransferPoint> =
                counted.iter().map(|p| p.corrected(linearity)).collect();
            let line = VarianceLine::fit(&mut curve, &freedom, black.std);
            (curve, line)
        };
        let (curve, line) = line_by(&bend.linearity);
        let grows = line.slope > 5.0 * line.slope_std; // false for NaN
        if !grows {
            return Err(SensorFitError::NoPhotonNoise { slope: line.slope });
        }
        // Gain and read noise; the uncertainty of the linearity adds to theirs.
        let by_bend = |of: fn(&VarianceLine) -> f64| {
            let per_coefficient = [0, 1].map(|i| {
                let step = bend.linearity.covariance[i][i].sqrt().max(1e-9);
                let [up, down] = [step, -step].map(|step| {
                    let mut other = bend.linearity;
                    other.coefficients[i] += step;
                    of(&line_by(&other).1)
                });
                (up - down) / (2.0 * step)
            });
            bend.linearity.variance(per_coefficient).sqrt()
        };
        let gain = Measured::new(line.slope, line.slope_std.hypot(by_bend(|line| line.slope)));
        let mut read_noise_e = line.read_noise_e();
        read_noise_e.std = read_noise_e
            .std
            .hypot(by_bend(|line| line.read_noise_e().value));
        let per_gain = |x: Measured| Measured {
            value: (x.value / gain.value).max(0.0),
            std: (x.std / gain.value).hypot(x.value * gain.std / gain.value.powi(2)),
        };
        // The dark pattern, and everything in electrons.
        let dark = darkness.pattern(
            [black.value, slope.value],
            [black_spread.value, slope_spread.value],
            &hot,
            gain.value,
        );
        Ok(SensorFit {
            dark,
            values: SensorValues {
                gain_dn_per_e: gain,
                read_noise_e,
                black_level_dn: black,
                black_level_spread_dn: black_spread,
                full_well_e: per_gain(Measured {
                    value: bend
                        .linearity
                        .proportional_dn(saturation.plateau_dn - black_dn),
                    std: saturation.plateau_std_dn,
                }),
                dark_current_e_s: per_gain(slope),
                dark_current_spread_e_s: per_gain(slope_spread),
                saturation_dn: saturation.count_dn,
                linear_max_dn: match bend.is_whole {
                    true => saturation.count_dn,
                    false => (black_dn + bend.highest_dn).min(saturation.count_dn),
                },
                linearity_error: bend.error,
                linearity: Some(bend.linearity),
                dark_pattern: None,
                linearity_residual: Some(bend.residual),
                bit_depth,
                hot_pixels: (0..hot.len())
                    .filter(|&p| hot[p])
                    .map(|p| [(p % width) as u32, (p / width) as u32])
                    .collect(),
            },
            hot,
            curve,
            variance_at_zero_dn2: line.at_zero,
            reduced_chi2: line.reduced_chi2,
        })
    }

    fn sorted(&self, exposed: Exposed) -> Vec<&Level> {
        let mut levels: Vec<&Level> = self
            .levels
            .iter()
            .filter(|level| level.exposed == exposed)
            .collect();
        levels.sort_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
        levels
    }
}

fn at_least(what: &'static str, found: usize, needed: usize) -> Result<(), SensorFitError> {
    if found >= needed {
        return Ok(());
    }
    Err(SensorFitError::TooFew {
        what,
        found,
        needed,
    })
}

impl Level {
    fn pixel_mean(&self, pixel: usize) -> f64 {
        f64::from(self.sum[pixel]) / f64::from(self.frames)
    }

    fn mean_over(&self, pixels: &[usize]) -> f64 {
        pixels.iter().map(|&p| self.pixel_mean(p)).sum::<f64>() / pixels.len() as f64
    }

    /// Linearity at this level of flats: `point` is its mean.
    fn linear_level(&self, point: &TransferPoint, pixels: &[usize], dark_dn_s: f64) -> LinearLevel {
        let frames = f64::from(self.frames);
        let noise_dn2 = point.variance_dn2 / pixels.len() as f64;
        let mean_of_means = self.frame_means.iter().sum::<f64>() / frames;
        let scatter: f64 = self
            .frame_means
            .iter()
            .map(|mean| (mean - mean_of_means).powi(2))
            .sum();
        LinearLevel {
            exposure_s: self.exposure_s,
            signal_dn: point.counted_dn,
            dark_dn: dark_dn_s * self.exposure_s,
            variance_dn2: point.variance_dn2,
            frames,
            mean_variance_dn2: noise_dn2 / frames,
            light_variance_dn2: scatter / (frames - 1.0) - noise_dn2,
        }
    }

    fn freedom(&self, pixels: &[usize]) -> f64 {
        f64::from(self.frames - 1) * (pixels.len() as f64 - 1.0)
    }

    /// Mean variance of a pixel over the frames, the frames' own levels taken
    /// out (they cost one degree of freedom each).
    fn temporal_variance(&self, pixels: &[usize]) -> f64 {
        let frames = f64::from(self.frames);
        let about_pixel_means: f64 = pixels
            .iter()
            .map(|&p| self.sum_of_squares[p] as f64 - f64::from(self.sum[p]).powi(2) / frames)
            .sum();
        let mean_of_means = self.frame_means.iter().sum::<f64>() / frames;
        let between_frames: f64 = self
            .frame_means
            .iter()
            .map(|mean| (mean - mean_of_means).powi(2))
            .sum();
        let shared = between_frames * pixels.len() as f64;
        (about_pixel_means - shared).max(0.0) / self.freedom(pixels)
    }
}
