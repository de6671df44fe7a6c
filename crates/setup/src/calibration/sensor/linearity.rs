//! How the counts of flats follow their exposures, and the smooth curve that
//! makes them proportional.

use nalgebra::{Matrix4, Vector4};

use super::{FIT_UP_TO, SensorFitError, at_least};
use crate::radiometry::linearity::Linearity;

/// Largest deviation from proportionality that a smooth correction may remove.
const MAX_ERROR: f64 = 0.03;
/// A level off the corrected curve by more than this is not linear.
const LINEAR_WITHIN: f64 = 0.01;
/// Deviations count from this part of saturation up; black level and noise rule below.
const FROM: f64 = 0.05;
/// A level so near saturation that noise clips is left out: its mean is lower.
const CLIP_SIGMAS: f64 = 4.0;
/// Levels up to this part of saturation represent all of it.
const REPRESENTS_ALL: f64 = 0.8;

/// One exposure of flats.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinearLevel {
    pub exposure_s: f64,
    /// Mean count above the black level, DN.
    pub signal_dn: f64,
    /// Of which without light, DN.
    pub dark_dn: f64,
    /// Temporal variance of one count, DN².
    pub variance_dn2: f64,
    pub frames: f64,
    /// Variance of the mean over pixels and frames from their noise, DN².
    pub mean_variance_dn2: f64,
    /// Variance of a frame's level beyond that, from an unsteady light, DN²; an
    /// estimate, which may be negative.
    pub light_variance_dn2: f64,
}

/// The curve, and up to where it holds.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinearityFit {
    pub linearity: Linearity,
    /// Highest signal for which it holds, as counted, DN.
    pub highest_dn: f64,
    /// Whether it holds up to saturation.
    pub is_whole: bool,
    /// Largest relative deviation from proportionality before the correction.
    pub error: f64,
    /// ... and after it.
    pub residual: f64,
}

impl LinearityFit {
    /// Fits `levels` up to 70% of saturation and takes in those above while they
    /// follow the curve within 1%. `black_std_dn` is the uncertainty of the black
    /// level and `usable_dn` the signal at saturation.
    ///
    /// # Errors
    /// Too few levels, more than 3% to correct, or more than 1% left.
    pub fn find(
        levels: &[LinearLevel],
        black_std_dn: f64,
        usable_dn: f64,
    ) -> Result<Self, SensorFitError> {
        let low = levels
            .iter()
            .take_while(|l| l.signal_dn <= FIT_UP_TO * usable_dn);
        let low = &levels[..low.count()];
        let from_dn = FROM * usable_dn;
        let seen = low.iter().filter(|l| l.signal_dn > from_dn).count();
        at_least("flats from 5% to 70% of saturation", seen, 2)?;

        // A first curve, and the brighter levels that follow it.
        let first = Curve::fit(low, black_std_dn, usable_dn);
        let brightest = low.last().copied().unwrap_or(levels[0]);
        let clips = |l: &LinearLevel| {
            let variance_dn2 = brightest.variance_dn2 * l.signal_dn / brightest.signal_dn;
            l.signal_dn + CLIP_SIGMAS * variance_dn2.sqrt() > usable_dn
        };
        let above: Vec<&LinearLevel> = levels[low.len()..].iter().filter(|l| !clips(l)).collect();
        let follow = above
            .iter()
            .take_while(|l| first.deviation(l).abs() <= LINEAR_WITHIN)
            .count();
        let used: Vec<LinearLevel> = low
            .iter()
            .chain(above[..follow].iter().copied())
            .copied()
            .collect();
        // The curve through all of them, before and after the correction.
        let curve = Curve::fit(&used, black_std_dn, usable_dn);
        let largest = |deviation: &dyn Fn(&LinearLevel) -> f64| {
            let counted = used.iter().filter(|l| l.signal_dn > from_dn);
            counted.map(|l| deviation(l).abs()).fold(0.0, f64::max)
        };
        let rate = |l: &LinearLevel| (l.signal_dn - l.dark_dn) / l.exposure_s;
        let reference = low
            .iter()
            .filter(|l| l.signal_dn > from_dn)
            .map(rate)
            .sum::<f64>()
            / seen as f64;
        let error = largest(&|l| rate(l) / reference - 1.0);
        let residual = largest(&|l| curve.deviation(l));
        // Whether it can be corrected.
        let percent = |part: f64| 100.0 * part;
        let grows = curve.linearity.grows_up_to(usable_dn);
        if error > MAX_ERROR || !grows {
            return Err(SensorFitError::NotLinear {
                error: percent(error),
                allowed: percent(MAX_ERROR),
            });
        }
        if residual > LINEAR_WITHIN {
            return Err(SensorFitError::NotSmooth {
                error: percent(residual),
                allowed: percent(LINEAR_WITHIN),
            });
        }
        let highest_dn = used.iter().map(|l| l.signal_dn).fold(0.0, f64::max);
        Ok(Self {
            linearity: curve.linearity,
            highest_dn,
            is_whole: follow == above.len() && highest_dn >= REPRESENTS_ALL * usable_dn,
            error,
            residual,
        })
    }
}

/// The solution of `y − d = s t − c₁ y u − c₂ y u² + δ` over levels of signal y,
/// dark signal d and exposure t, by weighted least squares: s is the light, δ
/// what the black level is off, constrained by its uncertainty. Errors of the y on the
/// right are c times smaller than those on the left and neglected.
struct Curve {
    linearity: Linearity,
    light_dn_s: f64,
    black_error_dn: f64,
}

impl Curve {
    fn fit(levels: &[LinearLevel], black_std_dn: f64, usable_dn: f64) -> Self {
        let longest_s = levels.iter().map(|l| l.exposure_s).fold(0.0, f64::max);
        let linearity = |c: [f64; 2], covariance| Linearity {
            scale_dn: usable_dn,
            coefficients: c,
            covariance,
        };
        let bend = linearity([0.0; 2], [[0.0; 2]; 2]);
        // An unsteady light is so by the same part of every level.
        let unsteady: f64 = levels
            .iter()
            .map(|l| l.light_variance_dn2 / l.signal_dn.max(1.0).powi(2))
            .sum::<f64>()
            .max(0.0)
            / levels.len() as f64;
        let variance = |l: &LinearLevel| {
            l.mean_variance_dn2.max(1e-12) + unsteady * l.signal_dn.powi(2) / l.frames
        };
        let row = |l: &LinearLevel| {
            let [first, second] = bend.per_coefficient(l.signal_dn);
            Vector4::new(usable_dn * l.exposure_s / longest_s, -first, -second, 1.0)
        };
        let mut normal = Matrix4::zeros();
        let mut right = Vector4::zeros();
        normal[(3, 3)] = black_std_dn.max(1e-9).powi(-2);
        for level in levels {
            let (row, weight) = (row(level), 1.0 / variance(level));
            normal += weight * row * row.transpose();
            right += weight * (level.signal_dn - level.dark_dn) * row;
        }
        let covariance = normal.try_inverse().unwrap_or_else(Matrix4::zeros);
        let solution = covariance * right;
        let chi2: f64 = levels
            .iter()
            .map(|l| (l.signal_dn - l.dark_dn - row(l).dot(&solution)).powi(2) / variance(l))
            .sum();
        // Where levels scatter beyond their noise, so may the curve. Beyond what
        // chance does (1% of the time) only: a factor of every dice would widen it.
        let freedom = (levels.len() as f64 - 3.0).max(1.0);
        let reduced = chi2 / freedom;
        let by_chance =
            (1.0 + 2.33 * (2.0 / (9.0 * freedom)).sqrt() - 2.0 / (9.0 * freedom)).powi(3);
        let widened = if reduced > by_chance { reduced } else { 1.0 };
        let c = covariance * widened;
        Self {
            linearity: linearity(
                [solution[1], solution[2]],
                [[c[(1, 1)], c[(1, 2)]], [c[(1, 2)], c[(2, 2)]]],
            ),
            light_dn_s: solution[0] * usable_dn / longest_s,
            black_error_dn: solution[3],
        }
    }

    /// Corrected signal over that of the exposure, less 1.
    fn deviation(&self, level: &LinearLevel) -> f64 {
        let corrected_dn = self.linearity.proportional_dn(level.signal_dn);
        let expected_dn = self.light_dn_s * level.exposure_s;
        (corrected_dn - level.dark_dn - self.black_error_dn) / expected_dn - 1.0
    }
}
