//! Photon transfer: gain, read noise, black level, dark current, full well,
//! linearity and hot pixels of a sensor, from dark frames and frames of a
//! steady uniform light at several exposures, after EMVA 1288.
//!
//! Only sums per exposure are kept. Variances are temporal (each pixel against
//! its own mean, each frame's mean level taken out, so that a slowly drifting
//! lamp does no harm); what differs between pixels stays out of them.

use super::record::{Measured, SensorValues};

/// Which light a calibration frame has seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exposed {
    /// The steady, uniform light.
    Flat,
    /// No light.
    Dark,
}

/// Why frames do not make a calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SensorFitError {
    /// A frame of another size.
    #[error("the frame has {found} pixels, the first one had {expected}")]
    FrameSize {
        /// Pixels of the frame.
        found: usize,
        /// Of the frames before.
        expected: usize,
    },
    /// Too few frames of a kind.
    #[error("{what}: {found}, and at least {needed} are needed")]
    TooFew {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many it takes.
        needed: usize,
    },
    /// The brightest flats are still far from saturation.
    #[error(
        "no flat saturates; the brightest has a mean of {brightest_dn:.0} DN, so the full well remains unknown"
    )]
    NeverSaturates {
        /// Mean count of the brightest level, DN.
        brightest_dn: f64,
    },
    /// The counts do not follow the light.
    #[error(
        "counts depart by {error:.1}% from proportionality below 70% of saturation; at most {allowed:.0}% can be accepted"
    )]
    NotLinear {
        /// Largest departure, percent.
        error: f64,
        /// Limit, percent.
        allowed: f64,
    },
    /// Noise that does not grow with the light.
    #[error("the variance does not grow with the mean (slope {slope:.3e} DN per DN)")]
    NoPhotonNoise {
        /// Slope of the curve.
        slope: f64,
    },
}

/// Largest departure from proportionality that a correction-free model may have.
const MAX_LINEARITY_ERROR: f64 = 0.03;
/// A level departs from proportionality beyond this.
const LINEAR_WITHIN: f64 = 0.01;
/// The curve is fitted up to this part of saturation (EMVA 1288, 6.6).
const FIT_UP_TO: f64 = 0.7;
/// Dark current this many standard deviations above the median makes a pixel hot.
const HOT_SIGMA: f64 = 8.0;

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

/// One point of the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransferPoint {
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Which light.
    pub exposed: Exposed,
    /// Mean count above the black level, DN.
    pub signal_dn: f64,
    /// Temporal variance, DN².
    pub variance_dn2: f64,
    /// Standard uncertainty of the variance, DN².
    pub variance_std_dn2: f64,
    /// Whether it is part of the fit.
    pub fitted: bool,
}

/// A sensor's calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorFit {
    /// What the record holds.
    pub values: SensorValues,
    /// Hot pixels, row by row.
    pub hot: Vec<bool>,
    /// The curve, dark levels first, by exposure.
    pub curve: Vec<TransferPoint>,
    /// Variance at zero signal: read noise and quantisation, DN².
    pub variance_at_zero_dn2: f64,
    /// χ² of the fitted points over their degrees of freedom.
    pub reduced_chi2: f64,
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

        let darkness = Darkness::fit(&dark);
        let hot = darkness.hot_pixels();
        let cold: Vec<usize> = (0..hot.len()).filter(|&p| !hot[p]).collect();
        at_least("pixels that are not hot", cold.len(), 2)?;
        let (black, black_spread) = darkness.statistics(&darkness.offset_dn, &cold, 0);
        let (slope, slope_spread) = darkness.statistics(&darkness.slope_dn_s, &cold, 1);
        let black_dn = black.value;

        let saturation = Saturation::find(&flats, &cold, bit_depth)?;
        let usable_dn = saturation.count_dn - black_dn;
        let mut curve: Vec<TransferPoint> = dark
            .iter()
            .chain(&flats)
            .map(|level| {
                let signal_dn = level.mean_over(&cold) - black_dn;
                let variance_dn2 = level.temporal_variance(&cold);
                TransferPoint {
                    exposure_s: level.exposure_s,
                    exposed: level.exposed,
                    signal_dn,
                    variance_dn2,
                    variance_std_dn2: variance_dn2 * (2.0 / level.freedom(&cold)).sqrt(),
                    fitted: signal_dn <= FIT_UP_TO * usable_dn,
                }
            })
            .collect();
        let fitted_flats = curve
            .iter()
            .filter(|p| p.fitted && p.exposed == Exposed::Flat);
        at_least("flats below 70% of saturation", fitted_flats.count(), 4)?;
        let line = VarianceLine::fit(&mut curve, &dark, &flats, &cold);
        let grows = line.slope > 5.0 * line.slope_std; // false for NaN
        if !grows {
            return Err(SensorFitError::NoPhotonNoise { slope: line.slope });
        }
        let gain = Measured {
            value: line.slope,
            std: line.slope_std,
        };
        let (linear_max_dn, linearity_error) =
            linearity(&curve, slope.value, black_dn, saturation.count_dn)?;
        let per_gain = |x: Measured| Measured {
            value: (x.value / gain.value).max(0.0),
            std: (x.std / gain.value).hypot(x.value * gain.std / gain.value.powi(2)),
        };
        Ok(SensorFit {
            values: SensorValues {
                gain_dn_per_e: gain,
                read_noise_e: line.read_noise_e(),
                black_level_dn: black,
                black_level_spread_dn: black_spread,
                full_well_e: per_gain(Measured {
                    value: saturation.plateau_dn - black_dn,
                    std: saturation.plateau_std_dn,
                }),
                dark_current_e_s: per_gain(slope),
                dark_current_spread_e_s: per_gain(slope_spread),
                saturation_dn: saturation.count_dn,
                linear_max_dn,
                linearity_error,
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

/// Each pixel's dark counts as offset plus slope times exposure.
struct Darkness {
    offset_dn: Vec<f64>,
    slope_dn_s: Vec<f64>,
    /// Covariance of (offset, slope) of one pixel from the temporal noise.
    covariance: [[f64; 2]; 2],
}

impl Darkness {
    fn fit(dark: &[&Level]) -> Self {
        let pixels: Vec<usize> = (0..dark[0].sum.len()).collect();
        // Typical pixels: the noise of hot ones is far larger.
        let mut means: Vec<(f64, usize)> = pixels
            .iter()
            .map(|&p| (dark[dark.len() - 1].pixel_mean(p), p))
            .collect();
        means.sort_by(|a, b| a.0.total_cmp(&b.0));
        let typical: Vec<usize> = means[..means.len().div_ceil(2).max(2).min(means.len())]
            .iter()
            .map(|&(_, p)| p)
            .collect();
        let weights: Vec<f64> = dark
            .iter()
            .map(|level| {
                let variance = level.temporal_variance(&typical).max(1.0 / 12.0);
                f64::from(level.frames) / variance
            })
            .collect();
        let sum = |power: i32| -> f64 {
            dark.iter()
                .zip(&weights)
                .map(|(level, w)| w * level.exposure_s.powi(power))
                .sum()
        };
        let (s0, s1, s2) = (sum(0), sum(1), sum(2));
        let determinant = s0 * s2 - s1 * s1;
        let covariance = [
            [s2 / determinant, -s1 / determinant],
            [-s1 / determinant, s0 / determinant],
        ];
        let (offset_dn, slope_dn_s) = pixels
            .iter()
            .map(|&p| {
                let (mut r0, mut r1) = (0.0, 0.0);
                for (level, w) in dark.iter().zip(&weights) {
                    let y = level.pixel_mean(p);
                    r0 += w * y;
                    r1 += w * y * level.exposure_s;
                }
                (
                    covariance[0][0] * r0 + covariance[0][1] * r1,
                    covariance[1][0] * r0 + covariance[1][1] * r1,
                )
            })
            .unzip();
        Self {
            offset_dn,
            slope_dn_s,
            covariance,
        }
    }

    fn hot_pixels(&self) -> Vec<bool> {
        let middle = median(&self.slope_dn_s);
        let deviations: Vec<f64> = self.slope_dn_s.iter().map(|s| (s - middle).abs()).collect();
        // 1.4826 times the median deviation is the standard deviation of a normal.
        let sigma = 1.4826 * median(&deviations);
        let floor = self.covariance[1][1].sqrt();
        let limit = middle + HOT_SIGMA * sigma.max(floor);
        self.slope_dn_s.iter().map(|&s| s > limit).collect()
    }

    /// Mean over the pixels and the spread that is not measurement noise;
    /// `which` is 0 for offsets and 1 for slopes.
    fn statistics(&self, values: &[f64], pixels: &[usize], which: usize) -> (Measured, Measured) {
        let n = pixels.len() as f64;
        let mean = pixels.iter().map(|&p| values[p]).sum::<f64>() / n;
        let variance = pixels
            .iter()
            .map(|&p| (values[p] - mean).powi(2))
            .sum::<f64>()
            / (n - 1.0);
        let own = (variance - self.covariance[which][which]).max(0.0);
        // The variance of a sample variance, carried to its root.
        let variance_std = variance * (2.0 / (n - 1.0)).sqrt();
        let spread_std = if own > variance_std {
            0.5 * variance_std / own.sqrt()
        } else {
            variance_std.sqrt()
        };
        (
            Measured {
                value: mean,
                std: (variance / n).sqrt(),
            },
            Measured {
                value: own.sqrt(),
                std: spread_std,
            },
        )
    }
}

/// Where counts stop growing.
struct Saturation {
    plateau_dn: f64,
    plateau_std_dn: f64,
    count_dn: f64,
}

impl Saturation {
    /// The plateau is the brightest level, if its noise has collapsed to less
    /// than half of the largest (beyond the peak of the curve noise is clipped);
    /// counts within four standard deviations of it are not trusted.
    fn find(flats: &[&Level], cold: &[usize], bit_depth: u32) -> Result<Self, SensorFitError> {
        let variances: Vec<f64> = flats.iter().map(|l| l.temporal_variance(cold)).collect();
        let largest = variances.iter().copied().fold(0.0, f64::max);
        let top = flats.len() - 1;
        let plateau_dn = flats[top].mean_over(cold);
        if variances[top] > 0.5 * largest || largest <= 0.0 {
            return Err(SensorFitError::NeverSaturates {
                brightest_dn: plateau_dn,
            });
        }
        let spatial: f64 = cold
            .iter()
            .map(|&p| (flats[top].pixel_mean(p) - plateau_dn).powi(2))
            .sum::<f64>()
            / cold.len() as f64;
        let deviation = (spatial + variances[top]).sqrt();
        let full_scale_dn = ((1u64 << bit_depth.clamp(1, 16)) - 1) as f64;
        Ok(Self {
            plateau_dn,
            plateau_std_dn: deviation,
            count_dn: (plateau_dn - 4.0 * deviation).floor().min(full_scale_dn),
        })
    }
}

/// Variance against signal: a straight line whose slope is the gain.
struct VarianceLine {
    at_zero: f64,
    at_zero_std: f64,
    slope: f64,
    slope_std: f64,
    covariance: f64,
    reduced_chi2: f64,
}

impl VarianceLine {
    /// Weighted least squares; the weights come from the line of the round
    /// before, since measured variances would favour low ones.
    fn fit(curve: &mut [TransferPoint], dark: &[&Level], flats: &[&Level], cold: &[usize]) -> Self {
        let freedom: Vec<f64> = dark
            .iter()
            .chain(flats)
            .map(|level| level.freedom(cold))
            .collect();
        let mut expected: Vec<f64> = curve.iter().map(|p| p.variance_dn2.max(1e-3)).collect();
        let mut line = None;
        for _ in 0..4 {
            let (mut s0, mut s1, mut s2, mut r0, mut r1) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for ((point, &f), &e) in curve.iter().zip(&freedom).zip(&expected) {
                if !point.fitted {
                    continue;
                }
                let w = f / (2.0 * e * e);
                s0 += w;
                s1 += w * point.signal_dn;
                s2 += w * point.signal_dn.powi(2);
                r0 += w * point.variance_dn2;
                r1 += w * point.variance_dn2 * point.signal_dn;
            }
            let determinant = s0 * s2 - s1 * s1;
            let at_zero = (s2 * r0 - s1 * r1) / determinant;
            let slope = (s0 * r1 - s1 * r0) / determinant;
            let mut chi2 = 0.0;
            let mut points = 0.0;
            for ((point, &f), e) in curve.iter_mut().zip(&freedom).zip(&mut expected) {
                *e = (at_zero + slope * point.signal_dn).max(1e-3);
                point.variance_std_dn2 = *e * (2.0 / f).sqrt();
                if point.fitted {
                    chi2 += ((point.variance_dn2 - *e) / point.variance_std_dn2).powi(2);
                    points += 1.0;
                }
            }
            line = Some(Self {
                at_zero,
                at_zero_std: (s2 / determinant).sqrt(),
                slope,
                slope_std: (s0 / determinant).sqrt(),
                covariance: -s1 / determinant,
                reduced_chi2: chi2 / f64::max(points - 2.0, 1.0),
            });
        }
        line.expect("the loop runs")
    }

    /// Standard deviation of the read noise: what remains at zero signal
    /// without quantisation. Below 0.24 DN² rounding hides it, and 0.40 DN is
    /// its upper limit (EMVA 1288, 6.5), given with an uncertainty of its half.
    fn read_noise_e(&self) -> Measured {
        if self.at_zero < 0.24 {
            return Measured {
                value: 0.40 / self.slope,
                std: 0.20 / self.slope,
            };
        }
        let sigma_dn = (self.at_zero - 1.0 / 12.0).sqrt();
        // σ_e = σ_dn(v) / K with v and K correlated by the fit.
        let by_v = 0.5 / (sigma_dn * self.slope);
        let by_k = -sigma_dn / self.slope.powi(2);
        let variance = (by_v * self.at_zero_std).powi(2)
            + (by_k * self.slope_std).powi(2)
            + 2.0 * by_v * by_k * self.covariance;
        Measured {
            value: sigma_dn / self.slope,
            std: variance.max(0.0).sqrt(),
        }
    }
}

/// Highest count that is proportional to light within 1%, and the largest
/// departure up to it: signal (less dark) over exposure against the mean ratio
/// of the fitted flats, from 5% of saturation up.
fn linearity(
    curve: &[TransferPoint],
    dark_dn_s: f64,
    black_dn: f64,
    saturation_dn: f64,
) -> Result<(f64, f64), SensorFitError> {
    let usable_dn = saturation_dn - black_dn;
    let flats: Vec<(f64, f64)> = curve
        .iter()
        .filter(|p| p.exposed == Exposed::Flat && p.signal_dn > 0.05 * usable_dn)
        .map(|p| (p.signal_dn, p.signal_dn / p.exposure_s - dark_dn_s))
        .collect();
    let fitted: Vec<f64> = flats
        .iter()
        .filter(|(signal, _)| *signal <= FIT_UP_TO * usable_dn)
        .map(|&(_, ratio)| ratio)
        .collect();
    at_least("flats from 5% to 70% of saturation", fitted.len(), 2)?;
    let reference = fitted.iter().sum::<f64>() / fitted.len() as f64;
    let mut highest_dn = 0.0f64;
    let mut error = 0.0f64;
    for &(signal_dn, ratio) in &flats {
        let departure = (ratio / reference - 1.0).abs();
        let in_fit = signal_dn <= FIT_UP_TO * usable_dn;
        if in_fit || departure <= LINEAR_WITHIN {
            error = error.max(departure);
            highest_dn = highest_dn.max(signal_dn);
        } else {
            break;
        }
    }
    if error > MAX_LINEARITY_ERROR {
        return Err(SensorFitError::NotLinear {
            error: 100.0 * error,
            allowed: 100.0 * MAX_LINEARITY_ERROR,
        });
    }
    // Levels are a few percent apart: one within 10% of saturation speaks for all of it.
    let linear_max_dn = if highest_dn >= 0.9 * usable_dn {
        saturation_dn
    } else {
        black_dn + highest_dn
    };
    Ok((linear_max_dn.min(saturation_dn), error))
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
