//! The figures of a photon transfer measurement in the terms and symbols of EMVA Standard
//! 1288, release 4.0 Linear. Section numbers are that document's.
//!
//! Without the irradiance in photons there is no quantum efficiency, so that everything is
//! stated in electrons. Where the procedure deviates from the standard, the field says so.

use serde::Serialize;

use super::{Exposed, Level, PhotonTransfer, SensorFit};
use crate::calibration::record::Measured;
use crate::radiometry::mosaic::Mosaic;

/// Variance of rounding to whole counts, σ_q², DN² (section 2.2).
const QUANTISATION_DN2: f64 = 1.0 / 12.0;
/// Least dark variance that rounding lets show, DN² (section 6.6).
const LEAST_DARK_VARIANCE_DN2: f64 = 0.24;
/// Flats from this to that part of saturation count for the linearity error (section 6.7).
const LINEARITY_RANGE: [f64; 2] = [0.05, 0.95];
/// Flats as near to half of saturation serve for the PRNU (section 4).
const PRNU_RANGE: [f64; 2] = [0.35, 0.65];

/// Figures of a sensor. Uncertainties are standard ones of this measurement alone.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Emva1288 {
    /// System gain K, DN/e⁻ (2.1, 6.6): slope of the photon transfer curve.
    pub system_gain_dn_per_e: Measured,
    /// Temporal dark noise in counts, σ_y.dark, DN (2.2).
    pub dark_noise_dn: f64,
    /// Temporal dark noise σ_d, e⁻ (2.2, 6.6): without that of rounding.
    pub dark_noise_e: Measured,
    /// Whether rounding hides the dark noise, so that σ_d is an upper limit.
    pub dark_noise_is_limit: bool,
    /// Saturation capacity μ_e.sat, e⁻ (2.4): electrons of the mean count that more light
    /// does not raise. The standard takes the greatest variance of at least 50 exposures,
    /// which lies a few noise widths lower.
    pub saturation_capacity_e: Measured,
    /// Absolute sensitivity threshold μ_e.min, e⁻ (2.4): the signal whose SNR is 1.
    pub sensitivity_threshold_e: Measured,
    /// Greatest signal-to-noise ratio SNR_max (2.4), a factor.
    pub snr_max: Measured,
    /// Dynamic range DR = μ_e.sat / μ_e.min (2.4), a factor.
    pub dynamic_range: Measured,
    /// Dark current μ_I.mean, e⁻/s (3), at the temperature of the measurement.
    pub dark_current_e_s: Measured,
    /// Dark signal nonuniformity DSNU₁₂₈₈, e⁻ (4), at `nonuniformity_exposure_s`, from the
    /// line of each pixel's darkness over exposure.
    pub dsnu_e: Measured,
    /// The same at no exposure, e⁻.
    pub dsnu_offset_e: Measured,
    /// Photo response nonuniformity PRNU₁₂₈₈, relative (4), with the unevenness of the light
    /// where there is any; absent where it cannot be stated.
    pub prnu: Option<Measured>,
    /// Why there is no PRNU.
    pub prnu_absent: Option<&'static str>,
    /// Exposure at which both nonuniformities are stated, s: near half of saturation.
    pub nonuniformity_exposure_s: f64,
    /// Linearity error LE, relative (6.7), before any correction.
    pub linearity_error: LinearityError,
    /// Pixels that are left out of all figures, because their dark current is too high.
    pub hot_pixels: usize,
}

/// Deviations of counts from a straight line over exposure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LinearityError {
    /// Mean of the absolute relative deviations, LE.
    pub mean: f64,
    /// Lowest relative deviation.
    pub lowest: f64,
    /// Highest relative deviation.
    pub highest: f64,
    /// Exposures from 5% to 95% of saturation.
    pub levels: usize,
}

impl Emva1288 {
    /// SNR_max, dB.
    pub fn snr_max_db(&self) -> f64 {
        20.0 * self.snr_max.value.log10()
    }

    /// DR, dB.
    pub fn dynamic_range_db(&self) -> f64 {
        20.0 * self.dynamic_range.value.log10()
    }
}

impl PhotonTransfer {
    /// The figures of these frames, which `fit` is the solution of. Hot pixels are left out.
    pub fn emva1288(&self, fit: &SensorFit, mosaic: Mosaic) -> Emva1288 {
        let v = &fit.values;
        let gain = v.gain_dn_per_e;
        // Noise and range.
        let threshold = threshold_e(v.read_noise_e, gain);
        let capacity = v.full_well_e;
        let snr_max = Measured::new(
            capacity.value.sqrt(),
            0.5 * capacity.std / capacity.value.sqrt(),
        );
        let dynamic_range = capacity.value / threshold.value;
        let relative = (capacity.std / capacity.value).hypot(threshold.std / threshold.value);
        // Nonuniformity at the exposure nearest to half of saturation.
        let usable_dn = v.saturation_dn - v.black_level_dn.value;
        let dark_dn_s = v.dark_current_e_s.value * gain.value;
        let cold: Vec<usize> = (0..fit.hot.len()).filter(|&p| !fit.hot[p]).collect();
        let flats: Vec<(&Level, f64)> = self
            .sorted(Exposed::Flat)
            .into_iter()
            .map(|level| (level, level.mean_over(&cold) - v.black_level_dn.value))
            .collect();
        let off_half = |dn: f64| (dn / usable_dn - 0.5).abs();
        let half = flats
            .iter()
            .min_by(|a, b| off_half(a.1).total_cmp(&off_half(b.1)));
        let exposure_s = half.map_or(0.0, |(level, _)| level.exposure_s);
        let offset_e = Measured::new(
            v.black_level_spread_dn.value / gain.value,
            v.black_level_spread_dn.std / gain.value,
        );
        let current_e = Measured::new(
            v.dark_current_spread_e_s.value * exposure_s,
            v.dark_current_spread_e_s.std * exposure_s,
        );
        let dsnu_e = root_of_squares(offset_e, current_e);
        let prnu = match half {
            _ if mosaic != Mosaic::None => {
                Err("colour filters: pixels of different colours respond differently")
            }
            Some((level, signal_dn))
                if (PRNU_RANGE[0]..=PRNU_RANGE[1]).contains(&(signal_dn / usable_dn)) =>
            {
                let signal_dn = signal_dn - dark_dn_s * level.exposure_s;
                Ok(level.prnu(&cold, signal_dn, dsnu_e.value * gain.value))
            }
            _ => Err("no flats near half of saturation"),
        };
        Emva1288 {
            system_gain_dn_per_e: gain,
            dark_noise_dn: fit.variance_at_zero_dn2.max(LEAST_DARK_VARIANCE_DN2).sqrt(),
            dark_noise_e: v.read_noise_e,
            dark_noise_is_limit: fit.variance_at_zero_dn2 < LEAST_DARK_VARIANCE_DN2,
            saturation_capacity_e: capacity,
            sensitivity_threshold_e: threshold,
            snr_max,
            dynamic_range: Measured::new(dynamic_range, dynamic_range * relative),
            dark_current_e_s: v.dark_current_e_s,
            dsnu_e,
            dsnu_offset_e: offset_e,
            prnu: prnu.ok(),
            prnu_absent: prnu.err(),
            nonuniformity_exposure_s: exposure_s,
            linearity_error: linearity_error(&flats, usable_dn, dark_dn_s),
            hot_pixels: fit.hot.len() - cold.len(),
        }
    }
}

/// The signal μ of SNR 1: μ² = σ_d² + σ_q²/K² + μ (section 2.4).
fn threshold_e(dark_noise_e: Measured, gain_dn_per_e: Measured) -> Measured {
    let rounding_e2 = QUANTISATION_DN2 / gain_dn_per_e.value.powi(2);
    let root = (dark_noise_e.value.powi(2) + rounding_e2 + 0.25).sqrt();
    let by_noise = dark_noise_e.value / root;
    let by_gain = rounding_e2 / gain_dn_per_e.value / root;
    Measured::new(
        root + 0.5,
        (by_noise * dark_noise_e.std).hypot(by_gain * gain_dn_per_e.std),
    )
}

fn root_of_squares(a: Measured, b: Measured) -> Measured {
    let value = a.value.hypot(b.value);
    let std = match value > 0.0 {
        true => (a.value * a.std).hypot(b.value * b.std) / value,
        false => a.std.hypot(b.std),
    };
    Measured { value, std }
}

impl Level {
    /// PRNU at this level of flats: the spread between pixels' means without what temporal
    /// noise leaves in them (section 8) and without the `dark_dn` of darkness, over the signal.
    fn prnu(&self, pixels: &[usize], signal_dn: f64, dark_dn: f64) -> Measured {
        let freedom = pixels.len() as f64 - 1.0;
        let mean = self.mean_over(pixels);
        let measured: f64 = pixels
            .iter()
            .map(|&p| (self.pixel_mean(p) - mean).powi(2))
            .sum::<f64>()
            / freedom;
        let temporal = self.temporal_variance(pixels) / f64::from(self.frames);
        let own = (measured - temporal - dark_dn.powi(2)).max(0.0);
        let variance_std = measured * (2.0 / freedom).sqrt();
        Measured {
            value: own.sqrt() / signal_dn,
            std: match own > variance_std {
                true => 0.5 * variance_std / own.sqrt() / signal_dn,
                false => variance_std.sqrt() / signal_dn,
            },
        }
    }
}

/// A straight line y = a + b t through counts without darkness over exposures that makes the
/// squares of relative deviations least, and those deviations.
fn linearity_error(flats: &[(&Level, f64)], usable_dn: f64, dark_dn_s: f64) -> LinearityError {
    let [from, to] = LINEARITY_RANGE;
    let points: Vec<[f64; 2]> = flats
        .iter()
        .map(|(level, dn)| [level.exposure_s, dn - dark_dn_s * level.exposure_s])
        .filter(|[_, dn]| (from..=to).contains(&(dn / usable_dn)))
        .collect();
    let sum = |of: &dyn Fn(f64, f64) -> f64| points.iter().map(|&[t, y]| of(t, y)).sum::<f64>();
    let (s0, s1, s2) = (
        sum(&|_, y| 1.0 / (y * y)),
        sum(&|t, y| t / (y * y)),
        sum(&|t, y| t * t / (y * y)),
    );
    let (r0, r1) = (sum(&|_, y| 1.0 / y), sum(&|t, y| t / y));
    let determinant = s0 * s2 - s1 * s1;
    let [offset, slope] = match determinant > 0.0 {
        true => [
            (s2 * r0 - s1 * r1) / determinant,
            (s0 * r1 - s1 * r0) / determinant,
        ],
        false => [0.0, r1 / s2],
    };
    let deviations = points.iter().map(|&[t, y]| {
        let line = offset + slope * t;
        (y - line) / line
    });
    let deviations: Vec<f64> = deviations.collect();
    let absolute: f64 = deviations.iter().map(|d| d.abs()).sum();
    LinearityError {
        mean: absolute / deviations.len().max(1) as f64,
        lowest: deviations.iter().copied().fold(0.0, f64::min),
        highest: deviations.iter().copied().fold(0.0, f64::max),
        levels: deviations.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_threshold_is_where_signal_equals_noise() {
        let of = |value| Measured { value, std: 0.0 };
        for (dark_e, gain) in [(2.4, 0.38), (0.0, 1.0), (10.0, 0.05)] {
            let signal = threshold_e(of(dark_e), of(gain)).value;
            let noise = (dark_e * dark_e + 1.0 / 12.0 / (gain * gain) + signal).sqrt();
            assert!((signal / noise - 1.0).abs() < 1e-12, "{signal} {noise}");
        }
    }

    #[test]
    fn a_bent_curve_has_the_linearity_error_of_its_deviations() {
        let level = |exposure_s: f64| Level {
            exposed: Exposed::Flat,
            exposure_s,
            frames: 2,
            sum: Vec::new(),
            sum_of_squares: Vec::new(),
            frame_means: Vec::new(),
        };
        let levels: Vec<Level> = (1..=9).map(|n| level(0.01 * f64::from(n))).collect();
        let of = |count: &dyn Fn(f64) -> f64| {
            let flats: Vec<(&Level, f64)> =
                levels.iter().map(|l| (l, count(l.exposure_s))).collect();
            linearity_error(&flats, 4000.0, 100.0)
        };
        // Counts with dark current are straight; an offset is none of it.
        let straight = of(&|t| 7.0 + (4e4 + 100.0) * t);
        assert!(
            straight.mean < 1e-12 && straight.levels == 9,
            "{straight:?}"
        );
        // One level in nine that is 1% too high takes the line with it in part.
        let bent = of(&|t| 4.01e4 * t * if (t - 0.05).abs() < 1e-9 { 1.01 } else { 1.0 });
        assert!((0.008..0.01).contains(&bent.highest), "{bent:?}");
        assert!(bent.lowest < 0.0 && bent.lowest > -0.003, "{bent:?}");
        assert!((0.001..0.003).contains(&bent.mean), "{bent:?}");
    }
}
