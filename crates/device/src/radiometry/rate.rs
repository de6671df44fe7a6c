//! One pixel's electron rate from frames of several exposures.
//!
//! The model of a mean count above the nominal black level is
//! `y = offset + K·t·rate + noise`, where the pixel's own offset is shared by
//! all its frames, lit or not. The estimator follows the exposures from the
//! shortest to the longest and keeps the rate *given* the offset, together with
//! the frames' own estimate of the offset; the two are put together at the end.
//! This is generalised least squares over all frames with every correlation
//! that the common offset and the common reference frames make.

use super::sensor::SensorNoise;

/// All frames of one pixel at one exposure.
#[derive(Clone, Copy, Debug)]
pub(super) struct Level {
    /// Exposure of one frame, seconds.
    pub exposure_s: f64,
    pub frames: u32,
    /// Mean count less the nominal black level, in proportion to light, DN.
    pub signal_dn: f64,
    /// Its derivatives by the coefficients of the linearity correction, DN.
    pub per_linearity: [f64; 2],
    /// Whether any of the frames clips.
    pub clipped: bool,
}

/// What is known of a rate before a pixel's frames are weighted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expectation {
    /// The rate from which variances are computed, e⁻/s.
    pub rate_e_s: f64,
    /// Rate of the neighbours without the pixel itself, and its variance, where
    /// enough of them agree with it.
    pub around: Option<(f64, f64)>,
}

/// An exposure is left out where its expected count lies within this many
/// standard deviations (of expectation and noise together) of clipping ...
const CLIP_MARGIN: f64 = 3.0;
/// ... and comes in gradually over this many more if the neighbours decide ...
const RAMP_AROUND: f64 = 1.0;
/// ... or this many if the pixel's own shorter exposures do.
const RAMP_OWN: f64 = 4.0;

/// A rate given the pixel's offset, and what is known of the offset.
#[derive(Clone, Copy, Debug)]
pub(super) struct RateEstimate {
    /// Electrons per second if the offset is zero.
    pub rate_e_s: f64,
    /// Variance of the rate at a known offset, (e⁻/s)².
    pub variance: f64,
    /// Decrease of the rate per DN of offset, e⁻/s/DN.
    pub per_offset: f64,
    /// Derivatives of the rate by the coefficients of the linearity correction, e⁻/s.
    pub per_linearity: [f64; 2],
    /// Information on the offset, 1/DN².
    pub offset_information: f64,
    /// Information times the best offset, 1/DN.
    pub offset_score: f64,
}

/// How one exposure agreed with the shorter ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// Share with which the exposure was taken in, 0 (it clips) to 1.
    pub share: f64,
    /// Count that the shorter exposures predict, DN above black.
    pub predicted_dn: f64,
    /// Variance of the mean count less the prediction at a known offset, DN².
    pub innovation_dn2: f64,
    /// Change of that difference per DN of the pixel's offset.
    pub per_offset: f64,
    /// Squared deviation from it over its variance.
    pub chi2: f64,
}

impl RateEstimate {
    /// A pixel's dark current as the noise model has it: where the same dark frames
    /// gave offset and dark current, an offset that is higher than thought means a
    /// dark current that is lower.
    pub fn by_record(noise: &SensorNoise, pixel: usize) -> Self {
        let offset_variance = noise.black_level_spread_dn.powi(2);
        let covariance = match &noise.dark_pattern {
            Some(dark) if offset_variance > 0.0 => dark.remaining_covariance,
            _ => 0.0,
        };
        let explained = covariance / offset_variance.max(f64::MIN_POSITIVE);
        Self {
            rate_e_s: noise.dark_current_of(pixel),
            variance: (noise.dark_current_spread_e_s.powi(2) - explained * covariance).max(0.0),
            per_offset: -explained,
            per_linearity: [0.0; 2],
            offset_information: 0.0,
            offset_score: 0.0,
        }
    }

    /// The rate from the shortest exposure alone.
    fn first(level: &Level, gain_dn_per_e: f64, variance_dn2: f64) -> Self {
        let slope = gain_dn_per_e * level.exposure_s;
        Self {
            rate_e_s: level.signal_dn / slope,
            variance: variance_dn2 / (slope * slope),
            per_offset: 1.0 / slope,
            per_linearity: level.per_linearity.map(|dn| dn / slope),
            offset_information: 0.0,
            offset_score: 0.0,
        }
    }

    /// Takes in a longer exposure, unless it clips.
    ///
    /// Whether it clips is not decided from its own noisy count: that keeps the
    /// low counts and drops the high ones. The neighbours decide where they
    /// agree with the pixel (a clipped frame is a veto, for edges that noise
    /// hides), else the pixel's shorter exposures. Those also make up the rate,
    /// so a hard decision would leave a bias; the share falls smoothly, and the
    /// bias that remains, `E[(x − μ) w(x)] = σ² E[w′(x)]` for normal x (Stein
    /// 1981), is subtracted.
    fn take_in(
        &mut self,
        level: &Level,
        noise: &SensorNoise,
        around: Option<(f64, f64)>,
        mean_variance_dn2: f64,
        count_variance_dn2: f64,
    ) -> Agreement {
        let slope = noise.gain_dn_per_e * level.exposure_s;
        let predicted_dn = slope * self.rate_e_s;
        let prediction_dn2 = slope * slope * self.variance;
        let (share, share_per_rate) = match around {
            Some(_) if level.clipped => (0.0, 0.0),
            Some((rate_e_s, variance)) => {
                let spread_dn = (slope * slope * variance + count_variance_dn2).sqrt();
                let headroom_dn = noise.usable_range_dn() - slope * rate_e_s;
                (ramp(headroom_dn / spread_dn, RAMP_AROUND).0, 0.0)
            }
            None => {
                let spread_dn = (prediction_dn2 + count_variance_dn2).sqrt();
                let headroom_dn = noise.usable_range_dn() - predicted_dn;
                let (share, share_slope) = ramp(headroom_dn / spread_dn, RAMP_OWN);
                (share, -share_slope * slope / spread_dn)
            }
        };

        let innovation_dn = level.signal_dn - predicted_dn;
        let innovation_dn2 = mean_variance_dn2 + prediction_dn2;
        let lever = 1.0 - slope * self.per_offset;
        self.offset_information += share * lever * lever / innovation_dn2;
        self.offset_score += share * lever * innovation_dn / innovation_dn2;

        let added = slope * slope / mean_variance_dn2; // information on the rate
        let kept = 1.0 / self.variance;
        let total = kept + share * added;
        let weight = share * added / total;
        self.rate_e_s += weight * innovation_dn / slope + added * share_per_rate / (total * total);
        self.variance = (1.0 - weight).powi(2) * self.variance + weight * weight / added;
        self.per_offset += weight * (1.0 / slope - self.per_offset);
        for (mine, dn) in self.per_linearity.iter_mut().zip(level.per_linearity) {
            *mine += weight * (dn / slope - *mine);
        }
        Agreement {
            share,
            predicted_dn,
            innovation_dn2,
            per_offset: lever,
            chi2: innovation_dn * innovation_dn / innovation_dn2,
        }
    }
}

/// Follows `levels`, shortest exposure first; `expected` is `None` while only
/// the frames themselves are known. `watch` sees each exposure after the first. `None` without levels.
pub(super) fn follow(
    levels: impl Iterator<Item = Level>,
    noise: &SensorNoise,
    expected: Option<Expectation>,
    mut watch: impl FnMut(usize, &Level, Agreement),
) -> Option<RateEstimate> {
    let mut estimate: Option<RateEstimate> = None;
    for (index, level) in levels.enumerate() {
        let own_e_s = level.signal_dn / (noise.gain_dn_per_e * level.exposure_s);
        let rate_e_s = match (&expected, &estimate) {
            (Some(expected), _) => expected.rate_e_s,
            (None, Some(estimate)) => estimate.rate_e_s,
            (None, None) => own_e_s,
        };
        let electrons = rate_e_s * level.exposure_s;
        let mean_dn2 = noise.mean_count_variance_dn2(electrons, level.frames);
        match &mut estimate {
            None => {
                estimate = Some(RateEstimate::first(&level, noise.gain_dn_per_e, mean_dn2));
            }
            Some(estimate) => {
                let count_dn2 = noise.count_variance_dn2(electrons);
                let around = expected.and_then(|expected| expected.around);
                let agreement = estimate.take_in(&level, noise, around, mean_dn2, count_dn2);
                watch(index, &level, agreement);
            }
        }
    }
    estimate
}

/// Lit less unlit rate and its variance, e⁻/s, with the offset from all frames
/// of the pixel (`dark` only helps to know the offset).
pub(super) fn difference(
    lit: &RateEstimate,
    unlit: &RateEstimate,
    dark: Option<&RateEstimate>,
    noise: &SensorNoise,
) -> (f64, f64) {
    let rate = lit.rate_e_s - unlit.rate_e_s;
    let per_linearity = [0, 1].map(|i| lit.per_linearity[i] - unlit.per_linearity[i]);
    let variance = lit.variance + unlit.variance + noise.linearity.variance(per_linearity);
    let offset_spread_dn = noise.black_level_spread_dn;
    if offset_spread_dn <= 0.0 {
        return (rate, variance);
    }
    let mut information = offset_spread_dn.powi(-2);
    let mut score = 0.0;
    for source in [Some(lit), Some(unlit), dark].into_iter().flatten() {
        information += source.offset_information;
        score += source.offset_score;
    }
    let per_offset = lit.per_offset - unlit.per_offset;
    (
        rate - per_offset * score / information,
        variance + per_offset * per_offset / information,
    )
}

/// The share of an exposure at a headroom in standard deviations, 3x² − 2x³
/// over a ramp of this width; and its derivative.
fn ramp(headroom: f64, width: f64) -> (f64, f64) {
    let x = ((headroom - CLIP_MARGIN) / width).clamp(0.0, 1.0);
    (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    /// Against least squares with the full 3 × 3 normal matrix (lit rate,
    /// unlit rate, offset), far from clipping.
    #[test]
    fn equals_generalised_least_squares_with_a_shared_offset() {
        let noise = SensorNoise {
            black_level_spread_dn: 1.5,
            ..SensorNoise::ideal(0.5, 3.0, 64.0, 16)
        };
        let level = |exposure_s: f64, frames, signal_dn| Level {
            exposure_s,
            frames,
            signal_dn,
            per_linearity: [0.0; 2],
            clipped: false,
        };
        let lit = [
            level(0.01, 2, 9.0),
            level(0.05, 1, 44.0),
            level(0.2, 4, 161.0),
        ];
        let unlit = [level(0.05, 3, 2.0), level(0.2, 4, 5.5)];
        let (lit_e_s, unlit_e_s) = (1600.0, 30.0);

        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        normal[(2, 2)] = noise.black_level_spread_dn.powi(-2);
        for (column, levels, rate) in [(0, &lit[..], lit_e_s), (1, &unlit[..], unlit_e_s)] {
            for l in levels {
                let mut row = Vector3::new(0.0, 0.0, 1.0);
                row[column] = noise.gain_dn_per_e * l.exposure_s;
                let weight = 1.0 / noise.mean_count_variance_dn2(rate * l.exposure_s, l.frames);
                normal += weight * row * row.transpose();
                right += weight * l.signal_dn * row;
            }
        }
        let covariance = normal.try_inverse().unwrap();
        let solution = covariance * right;
        let contrast = Vector3::new(1.0, -1.0, 0.0);
        let expected = contrast.dot(&solution);
        let expected_variance = contrast.dot(&(covariance * contrast));

        let ignore = |_: usize, _: &Level, _: Agreement| {};
        let expect = |rate_e_s| {
            Some(Expectation {
                rate_e_s,
                around: None,
            })
        };
        let lit = follow(lit.into_iter(), &noise, expect(lit_e_s), ignore).unwrap();
        let unlit = follow(unlit.into_iter(), &noise, expect(unlit_e_s), ignore).unwrap();
        let (rate, variance) = difference(&lit, &unlit, None, &noise);
        assert!((rate / expected - 1.0).abs() < 1e-9, "{rate} {expected}");
        assert!(
            (variance / expected_variance - 1.0).abs() < 1e-9,
            "{variance} {expected_variance}"
        );
    }

    #[test]
    fn a_clipped_exposure_is_ignored() {
        let noise = SensorNoise::ideal(0.5, 3.0, 64.0, 12);
        let level = |exposure_s: f64, signal_dn| Level {
            exposure_s,
            frames: 1,
            signal_dn,
            per_linearity: [0.0; 2],
            clipped: false,
        };
        let ignore = |_: usize, _: &Level, _: Agreement| {};
        let short = follow([level(0.01, 2000.0)].into_iter(), &noise, None, ignore).unwrap();
        let both = follow(
            [level(0.01, 2000.0), level(0.04, 4031.0)].into_iter(),
            &noise,
            None,
            |_, _, agreement| assert_eq!(agreement.share, 0.0),
        )
        .unwrap();
        assert_eq!(short.rate_e_s, both.rate_e_s);
        assert_eq!(short.variance, both.variance);
    }
}
