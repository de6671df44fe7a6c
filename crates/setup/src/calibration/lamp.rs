//! The lamp over time: how it warms up, drifts and flickers, from frames of a
//! still scene that it lights.

use nalgebra::{DMatrix, DVector, Matrix4, Vector4};
use serde::{Serialize, Serializer};

use super::record::{Flicker, LampValues, Measured};
use crate::statistics::{STD_OVER_MAD, median};

/// One mean level of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LampLevel {
    /// Since the lamp was switched on, seconds.
    pub time_s: f64,
    /// Signal over exposure; relative to the warm lamp in a [`LampFit`].
    pub level: f64,
}

/// Frames in quick succession at one exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Burst {
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Mean signal of each frame, DN above the frames without lamp.
    pub signals_dn: Vec<f64>,
    /// Variance of such a mean from the noise of its pixels, DN².
    pub noise_dn2: f64,
}

/// A lamp's calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LampFit {
    /// What the record holds.
    pub values: LampValues,
    /// The levels, relative to the warm lamp.
    #[serde(serialize_with = "pairs")]
    pub levels: Vec<LampLevel>,
}

/// Times and levels.
fn pairs<S: Serializer>(levels: &[LampLevel], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(levels.iter().map(|level| [level.time_s, level.level]))
}

/// Why levels do not make a calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum LampFitError {
    #[error("{found} levels, and at least {MIN_LEVELS} are needed")]
    TooFew { found: usize },
    /// The scene is not lit by the lamp.
    #[error("the lamp adds no light to what the camera sees")]
    NoLight,
    #[error(
        "the lamp is still warming up: it was watched for {watched_s:.0} s, and its time constant is about {constant_s:.0} s"
    )]
    StillWarming { watched_s: f64, constant_s: f64 },
    /// Something else changed: the lamp or the scene moved, a door opened.
    #[error(
        "the light jumped by {percent:.1}% after {time_s:.0} s, which neither warm-up nor drift does"
    )]
    Jump {
        /// Largest step between two levels beyond the fit's, percent.
        percent: f64,
        time_s: f64,
    },
}

/// Levels that it takes.
pub const MIN_LEVELS: usize = 20;
/// A lamp is warm when less than this part of its light is missing.
const WARM_WITHIN: f64 = 1e-3;
/// Flicker below this does no harm.
const STEADY_WITHIN: f64 = 2e-3;
/// A watch must last this many time constants.
const WATCHED: f64 = 3.0;
/// Warm-up is there where its two parameters lower χ² by this much.
const EXPLAINS: f64 = 25.0;
/// A step between two levels beyond this and [`JUMP_SIGMA`] deviations is a jump.
const JUMP: f64 = 0.01;
const JUMP_SIGMA: f64 = 6.0;

impl LampFit {
    /// Fits `warm (1 + drift t − missing exp(−t/constant))` to levels in order of
    /// time, and takes flicker from bursts.
    pub fn new(levels: &[LampLevel], bursts: &[Burst]) -> Result<Self, LampFitError> {
        if levels.len() < MIN_LEVELS {
            let found = levels.len();
            return Err(LampFitError::TooFew { found });
        }
        let mean = levels.iter().map(|l| l.level).sum::<f64>() / levels.len() as f64;
        let lit = mean.is_finite() && mean > 0.0;
        if !lit {
            return Err(LampFitError::NoLight);
        }
        let watched_s = levels[levels.len() - 1].time_s - levels[0].time_s;
        let warming = Warming::fit(levels, watched_s);
        warming.check(levels, watched_s)?;
        let relative = |l: &LampLevel| LampLevel {
            time_s: l.time_s,
            level: l.level / warming.warm,
        };
        let flicker: Vec<Flicker> = bursts.iter().map(Burst::flicker).collect();
        let missing = warming.missing.value;
        let warm_up_time_s = match missing.abs() > WARM_WITHIN {
            true => warming.constant_s.value * (missing.abs() / WARM_WITHIN).ln(),
            false => 0.0,
        };
        Ok(Self {
            values: LampValues {
                warm_up_fraction: warming.missing,
                warm_up_constant_s: warming.constant_s,
                warm_up_time_s,
                drift_per_hour: warming.drift_per_hour,
                steady_from_s: steady_from(&flicker),
                flicker,
            },
            levels: levels.iter().map(relative).collect(),
        })
    }

    /// The fit's level at a time after switching on, relative to the warm lamp.
    pub fn level(&self, time_s: f64) -> f64 {
        let v = &self.values;
        let constant_s = v.warm_up_constant_s.value;
        let missing = match constant_s > 0.0 {
            true => v.warm_up_fraction.value * (-time_s / constant_s).exp(),
            false => 0.0,
        };
        1.0 + v.drift_per_hour.value * time_s / 3600.0 - missing
    }
}

/// The shortest exposure from which on flicker does no harm.
fn steady_from(flicker: &[Flicker]) -> Option<f64> {
    let mut sorted: Vec<&Flicker> = flicker.iter().collect();
    sorted.sort_by(|a, b| b.exposure_s.total_cmp(&a.exposure_s));
    sorted
        .into_iter()
        .take_while(|f| f.relative.value - f.relative.std < STEADY_WITHIN)
        .map(|f| f.exposure_s)
        .last()
}

impl Burst {
    /// Standard deviation between the frames, a straight trend and noise taken out.
    fn flicker(&self) -> Flicker {
        let n = self.signals_dn.len() as f64;
        let mean = self.signals_dn.iter().sum::<f64>() / n.max(1.0);
        let middle = 0.5 * (n - 1.0);
        let (mut score, mut information) = (0.0, 0.0);
        for (i, signal) in self.signals_dn.iter().enumerate() {
            score += (i as f64 - middle) * signal;
            information += (i as f64 - middle).powi(2);
        }
        let slope = score / f64::max(information, 1.0);
        let residual = |(i, signal): (usize, &f64)| signal - mean - slope * (i as f64 - middle);
        let sum2: f64 = self
            .signals_dn
            .iter()
            .enumerate()
            .map(|r| residual(r).powi(2))
            .sum();
        let freedom = f64::max(n - 2.0, 1.0);
        let variance = sum2 / freedom;
        let own = (variance - self.noise_dn2).max(0.0);
        let variance_std = variance * (2.0 / freedom).sqrt();
        let std = match own > variance_std {
            true => 0.5 * variance_std / own.sqrt(),
            false => variance_std.sqrt(),
        };
        Flicker {
            exposure_s: self.exposure_s,
            relative: Measured::new(
                own.sqrt() / mean.abs().max(1e-12),
                std / mean.abs().max(1e-12),
            ),
        }
    }
}

struct Warming {
    warm: f64,
    missing: Measured,
    constant_s: Measured,
    drift_per_hour: Measured,
    residuals: Vec<f64>,
}

impl Warming {
    fn fit(levels: &[LampLevel], watched_s: f64) -> Self {
        // The time constant alone is not linear: a grid, then golden sections.
        let shortest_s = watched_s / levels.len() as f64;
        let steps = 48;
        let constant = |i: usize| {
            let part = i as f64 / (steps - 1) as f64;
            shortest_s * (4.0 * watched_s / shortest_s).powf(part)
        };
        let best = (0..steps)
            .min_by(|&a, &b| {
                linear(levels, constant(a))
                    .1
                    .total_cmp(&linear(levels, constant(b)).1)
            })
            .unwrap_or(0);
        let (mut low, mut high) = (
            constant(best.saturating_sub(1)),
            constant((best + 1).min(steps - 1)),
        );
        for _ in 0..60 {
            let third = (high - low) / 3.0;
            if linear(levels, low + third).1 < linear(levels, high - third).1 {
                high -= third;
            } else {
                low += third;
            }
        }
        let constant_s = 0.5 * (low + high);
        let (c, sum2) = linear(levels, constant_s);
        let n = levels.len() as f64;
        let noise2 = sum2 / (n - 4.0);
        // Normal matrix of (warm, drift, missing, constant) at the minimum.
        let mut normal = Matrix4::zeros();
        for l in levels {
            let decay = (-l.time_s / constant_s).exp();
            let row = Vector4::new(
                1.0,
                l.time_s,
                decay,
                c[2] * decay * l.time_s / constant_s.powi(2),
            );
            normal += row * row.transpose();
        }
        let covariance = normal.try_inverse().unwrap_or_else(Matrix4::zeros) * noise2;
        let std = |i: usize| covariance[(i, i)].max(0.0).sqrt();
        // Whether there was a warm-up at all.
        let warm = c[0];
        let missing = Measured::new(-c[2] / warm, std(2) / warm.abs());
        let (without, without2) = line(levels);
        if (without2 - sum2) / noise2 < EXPLAINS {
            return Self::steady(levels, without, without2);
        }
        let residual = |l: &LampLevel| {
            let decay = (-l.time_s / constant_s).exp();
            (l.level - c[0] - c[1] * l.time_s - c[2] * decay) / warm
        };
        Self {
            warm,
            missing,
            constant_s: Measured::new(constant_s, std(3)),
            drift_per_hour: Measured::new(3600.0 * c[1] / warm, 3600.0 * std(1) / warm.abs()),
            residuals: levels.iter().map(residual).collect(),
        }
    }

    /// No warm-up to be seen.
    fn steady(levels: &[LampLevel], c: [f64; 2], sum2: f64) -> Self {
        let n = levels.len() as f64;
        let noise2 = sum2 / (n - 2.0);
        let middle = levels.iter().map(|l| l.time_s).sum::<f64>() / n;
        let spread: f64 = levels.iter().map(|l| (l.time_s - middle).powi(2)).sum();
        let none = Measured::new(0.0, noise2.sqrt() / c[0].abs());
        Self {
            warm: c[0],
            missing: none,
            constant_s: Measured::new(0.0, 0.0),
            drift_per_hour: Measured::new(
                3600.0 * c[1] / c[0],
                3600.0 * (noise2 / spread.max(1e-30)).sqrt() / c[0].abs(),
            ),
            residuals: levels
                .iter()
                .map(|l| (l.level - c[0] - c[1] * l.time_s) / c[0])
                .collect(),
        }
    }

    fn check(&self, levels: &[LampLevel], watched_s: f64) -> Result<(), LampFitError> {
        // From one level to the next, so that a poor fit hides no jump.
        let steps: Vec<f64> = self
            .residuals
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).abs())
            .collect();
        let typical = median(steps.iter().copied()).unwrap_or(0.0);
        let limit = JUMP.max(JUMP_SIGMA * STD_OVER_MAD * typical);
        let largest = (0..steps.len()).max_by(|&a, &b| steps[a].total_cmp(&steps[b]));
        if let Some(at) = largest
            && steps[at] > limit
        {
            return Err(LampFitError::Jump {
                percent: 100.0 * steps[at],
                time_s: levels[at + 1].time_s,
            });
        }
        let constant_s = self.constant_s.value;
        if watched_s < WATCHED * constant_s {
            return Err(LampFitError::StillWarming {
                watched_s,
                constant_s,
            });
        }
        Ok(())
    }
}

/// Least squares of (1, t, exp(−t/constant)): coefficients and sum of squares.
fn linear(levels: &[LampLevel], constant_s: f64) -> ([f64; 3], f64) {
    let row = |l: &LampLevel| [1.0, l.time_s, (-l.time_s / constant_s).exp()];
    solve(levels, row)
}

/// Least squares of (1, t).
fn line(levels: &[LampLevel]) -> ([f64; 2], f64) {
    solve(levels, |l| [1.0, l.time_s])
}

fn solve<const N: usize>(
    levels: &[LampLevel],
    row: impl Fn(&LampLevel) -> [f64; N],
) -> ([f64; N], f64) {
    let matrix = DMatrix::from_fn(levels.len(), N, |i, j| row(&levels[i])[j]);
    let right = DVector::from_iterator(levels.len(), levels.iter().map(|l| l.level));
    // Columns of very different size: orthogonalise rather than square.
    let scale: Vec<f64> = (0..N)
        .map(|j| matrix.column(j).norm().max(1e-300))
        .collect();
    let mut scaled = matrix.clone();
    for (j, s) in scale.iter().enumerate() {
        scaled.column_mut(j).unscale_mut(*s);
    }
    let solution = scaled
        .svd(true, true)
        .solve(&right, 1e-13)
        .unwrap_or_else(|_| DVector::zeros(N));
    let c = std::array::from_fn(|j| solution[j] / scale[j]);
    let sum2 = levels
        .iter()
        .map(|l| {
            let fitted: f64 = row(l)
                .iter()
                .zip(&c)
                .map(|(a, b): (&f64, &f64)| a * b)
                .sum();
            (l.level - fitted).powi(2)
        })
        .sum();
    (c, sum2)
}

#[cfg(test)]
mod tests;
