//! Whether the frames of a bracket agree: exposures with the shorter ones,
//! repeats with each other. Something that moved shows as groups of pixels that
//! deviate far beyond their noise; a wrong exposure time or a drifting lamp shows
//! everywhere.
//!
//! All are sums over pixels, so those of bands of rows add up.

use super::rate::{Agreement, Level};
use super::sensor::SensorNoise;

/// How one light exposure agrees with the shorter ones.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ExposureAgreement {
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Frames averaged.
    pub frames: u32,
    /// Pixels that took it in with full weight, those that moved apart.
    pub pixels: usize,
    /// Signal over the signal that the shorter exposures predict, summed over
    /// those pixels: 1 if exposures and linearity are as stated. 1 for the
    /// shortest.
    pub signal_ratio: f64,
    /// Standard uncertainty of that ratio from noise; 0 for the shortest.
    pub signal_ratio_std: f64,
    /// Mean squared deviation from that prediction over its variance; about 1
    /// if the noise model holds. 0 for the shortest.
    pub reduced_chi2: f64,
    /// Pixels, in groups, that deviate from the shorter exposures or from earlier
    /// frames of this one although most do not: something moved there, or the
    /// light changed by more than 5% between frames.
    pub moved_pixels: usize,
    /// Relative change of the light over the frames of this exposure, by a
    /// straight line through their levels; 0 for a single frame.
    pub drift: f64,
    /// Standard uncertainty of the drift from noise; 0 for a single frame.
    pub drift_std: f64,
}

/// A pixel deviates where it differs by this many standard deviations ...
const DEPARTURE_SIGMA: f64 = 5.0;
/// ... and by what this relative error of the light, times them, explains.
const TOLERATED: f64 = 0.01;
/// So many of a pixel and its eight neighbours deviate together where something moved.
const GROUP: usize = 3;
/// Repeats are compared where all of them together stay below this part of the
/// usable range.
const REPEAT_BELOW: f64 = 0.9;

/// Whether a difference is beyond noise and tolerance. One electron more of
/// noise allows for the long tail of the Poisson distribution of few.
fn beyond(difference_dn: f64, variance_dn2: f64, signal_dn: f64, gain_dn_per_e: f64) -> bool {
    let tolerated_dn2 = (TOLERATED * signal_dn).powi(2) + gain_dn_per_e * gain_dn_per_e;
    difference_dn * difference_dn > DEPARTURE_SIGMA.powi(2) * (variance_dn2 + tolerated_dn2)
}

/// Whether an exposure deviates from what the shorter ones predict. Beyond the
/// usable range, counts and predictions are only known to be there.
pub(super) fn deviates(noise: &SensorNoise, level: &Level, agreement: &Agreement) -> bool {
    let usable_dn = noise.usable_range_dn();
    let signal_dn = match level.clipped {
        true => usable_dn,
        false => level.signal_dn,
    };
    let difference_dn = signal_dn - agreement.predicted_dn.min(usable_dn);
    let offset_dn = agreement.per_offset * noise.black_level_spread_dn;
    beyond(
        difference_dn,
        agreement.innovation_dn2 + offset_dn * offset_dn,
        agreement.predicted_dn,
        noise.gain_dn_per_e,
    )
}

/// A frame against the mean of the earlier ones of its exposure, summed over pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RepeatSum {
    signal_dn: f64,
    earlier_dn: f64,
    /// Variance of the frame's own signal.
    variance_dn2: f64,
}

impl RepeatSum {
    /// Adds a pixel's count, `sum_dn` being that of the `earlier` frames. Returns
    /// whether the pixel deviates. Which pixels are summed is decided from all
    /// frames together, so that the choice favours neither side.
    pub fn add(
        &mut self,
        noise: &SensorNoise,
        count_dn: f64,
        sum_dn: f64,
        earlier: u32,
        counts: bool,
    ) -> bool {
        let earlier = f64::from(earlier);
        let before_dn = noise.signal_dn(sum_dn / earlier);
        let signal_dn = noise.signal_dn(count_dn);
        let pooled_dn = (earlier * before_dn + signal_dn) / (earlier + 1.0);
        let variance_dn2 = noise.count_variance_dn2(pooled_dn / noise.gain_dn_per_e);
        if counts && pooled_dn < REPEAT_BELOW * noise.usable_range_dn() {
            self.signal_dn += signal_dn;
            self.earlier_dn += before_dn;
            self.variance_dn2 += variance_dn2;
        }
        beyond(
            signal_dn - before_dn,
            variance_dn2 * (1.0 + 1.0 / earlier),
            pooled_dn,
            noise.gain_dn_per_e,
        )
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    pixels: usize,
    signal_dn: f64,
    predicted_dn: f64,
    variance_dn2: f64,
    chi2: f64,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.signal_dn += other.signal_dn;
        self.predicted_dn += other.predicted_dn;
        self.variance_dn2 += other.variance_dn2;
        self.chi2 += other.chi2;
    }

    /// Signal over prediction and its uncertainty.
    fn ratio(&self) -> Option<(f64, f64)> {
        let known = self.pixels > 0 && self.predicted_dn > 0.0;
        known.then(|| {
            (
                self.signal_dn / self.predicted_dn,
                self.variance_dn2.sqrt() / self.predicted_dn,
            )
        })
    }
}

/// Sums over the pixels of one light exposure.
#[derive(Clone, Debug, Default)]
pub(super) struct ExposureTally {
    exposure_s: f64,
    frames: u32,
    /// Each frame after the first.
    pub repeats: Vec<RepeatSum>,
    pub moved_pixels: usize,
    seen: usize,
    deviating: usize,
    steady: Sums,
    unsteady: Sums,
}

impl ExposureTally {
    /// No pixel seen yet.
    pub fn of(exposure_s: f64, frames: u32) -> Self {
        Self {
            exposure_s,
            frames,
            ..Self::default()
        }
    }

    /// Takes in a pixel; `step` is how the exposure agreed with the shorter ones.
    pub fn take_in(&mut self, deviates: bool, step: Option<(&Level, &Agreement)>) {
        self.seen += 1;
        self.deviating += usize::from(deviates);
        if let Some((level, agreement)) = step
            && agreement.share == 1.0
        {
            let sums = if deviates {
                &mut self.unsteady
            } else {
                &mut self.steady
            };
            sums.add(&Sums {
                pixels: 1,
                signal_dn: level.signal_dn,
                predicted_dn: agreement.predicted_dn,
                variance_dn2: agreement.innovation_dn2,
                chi2: agreement.chi2,
            });
        }
    }

    /// Adds another part of the image.
    pub fn add(&mut self, other: &Self) {
        self.moved_pixels += other.moved_pixels;
        self.seen += other.seen;
        self.deviating += other.deviating;
        self.steady.add(&other.steady);
        self.unsteady.add(&other.unsteady);
        for (mine, theirs) in self.repeats.iter_mut().zip(&other.repeats) {
            mine.signal_dn += theirs.signal_dn;
            mine.earlier_dn += theirs.earlier_dn;
            mine.variance_dn2 += theirs.variance_dn2;
        }
    }

    /// Whether the exposure as a whole deviates, so that single pixels prove
    /// nothing: most do, or the others are off together.
    pub fn deviates_everywhere(&self) -> bool {
        let off = |(ratio, std): (f64, f64)| (ratio - 1.0).abs() > TOLERATED + 3.0 * std;
        2 * self.deviating > self.seen || self.steady.ratio().is_some_and(off)
    }

    pub fn agreement(&self) -> ExposureAgreement {
        let mut sums = self.steady;
        if self.deviates_everywhere() {
            sums.add(&self.unsteady);
        }
        let (signal_ratio, signal_ratio_std) = sums.ratio().unwrap_or((1.0, 0.0));
        let (drift, drift_std) = self.drift();
        ExposureAgreement {
            exposure_s: self.exposure_s,
            frames: self.frames,
            pixels: sums.pixels,
            signal_ratio,
            signal_ratio_std,
            reduced_chi2: sums.chi2 / sums.pixels.max(1) as f64,
            moved_pixels: self.moved_pixels,
            drift,
            drift_std,
        }
    }

    /// Relative change from the first frame to the last, and its uncertainty.
    fn drift(&self) -> (f64, f64) {
        let mut levels = vec![1.0];
        let mut own_variance = 0.0;
        for repeat in &self.repeats {
            if repeat.earlier_dn <= 0.0 {
                return (0.0, 0.0);
            }
            let before = levels.iter().sum::<f64>() / levels.len() as f64;
            levels.push(before * repeat.signal_dn / repeat.earlier_dn);
            own_variance += repeat.variance_dn2 / repeat.earlier_dn.powi(2);
        }
        let n = levels.len() as f64;
        if n < 2.0 {
            return (0.0, 0.0);
        }
        own_variance /= n - 1.0;
        let middle = 0.5 * (n - 1.0);
        let (mut score, mut information) = (0.0, 0.0);
        for (i, level) in levels.iter().enumerate() {
            let at = i as f64 - middle;
            score += at * level;
            information += at * at;
        }
        let whole = n - 1.0;
        (
            whole * score / information,
            whole * (own_variance / information).sqrt(),
        )
    }
}

/// Bit of an exposure in a pixel's set of deviating exposures.
pub(super) fn bit(exposure: usize) -> u16 {
    1 << exposure.min(15)
}

/// The exposures of which a pixel deviates together with its neighbours (`step`
/// pixels away), of those in `trusted`.
pub(super) fn moved(
    deviating: &[u16],
    width: usize,
    [x, y]: [usize; 2],
    step: usize,
    trusted: u16,
) -> u16 {
    let here = deviating[y * width + x] & trusted;
    if here == 0 {
        return 0;
    }
    let height = deviating.len() / width;
    let mut counts = [0; 16];
    let around = |at: usize, limit: usize| {
        [at.checked_sub(step), Some(at), at.checked_add(step)]
            .into_iter()
            .flatten()
            .filter(move |&at| at < limit)
    };
    for row in around(y, height) {
        for column in around(x, width) {
            let there = deviating[row * width + column] & here;
            for (bit, count) in counts.iter_mut().enumerate() {
                *count += usize::from(there >> bit & 1);
            }
        }
    }
    (0..16)
        .filter(|&bit| counts[bit] >= GROUP)
        .fold(0, |set, bit| set | 1 << bit)
}
