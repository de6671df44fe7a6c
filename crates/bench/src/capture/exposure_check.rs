//! Whether an exposure was what the camera reports, from two frames of one scene.

use std::fmt;

use crate::radiometry::sensor::SensorNoise;

/// A ratio of exposures within this of 1 is as claimed.
pub const GOOD: f64 = 0.01;
/// A ratio of exposures further than this from 1 is refused.
pub const REFUSED: f64 = 0.03;

/// Standard deviations of noise that a frame may be off before it is taken again. Low,
/// because that costs a frame, and a stale one must not pass.
const TO_REFUSE: f64 = 3.0;
/// ... and before a warning says so: a capture makes hundreds of comparisons.
const TO_WARN: f64 = 5.0;

/// ... and that a change of 1% should be worth, so that 95 of 100 are found: among ten
/// thousand comparisons 5.3 are needed for a false-alarm rate of 0.1%, and 1.6 more.
const TO_FIND: f64 = 7.0;

/// Signal per exposure time of one frame over that of another, both of the same
/// scene: 1 if the exposures are what they claim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalRatio {
    /// The later frame over the earlier one.
    pub ratio: f64,
    /// Its standard uncertainty from noise and black level. The exposures are taken to be as
    /// read back, and what both frames share cancels: the pixels' own response and offset.
    pub std_dev: f64,
}

/// What a ratio says about the later frame's exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Within 1%, or the signal is too weak to tell.
    Good,
    /// Between 1% and 3%, beyond what noise explains.
    Doubtful,
    /// Beyond 3%: the frame was not taken with this exposure.
    Refused,
}

/// Counts and the exposure that they claim.
#[derive(Clone, Copy, Debug)]
pub struct Exposed<'a> {
    /// Raw counts, DN.
    pub counts: &'a [u16],
    /// Read back, seconds.
    pub exposure_s: f64,
}

/// A pixel says most about the exposure where its signal in both frames together is
/// at least this part of the usable range. Where no pixel reaches it, all are
/// taken: their sum is unbiased, and its uncertainty says what it is worth.
pub(super) const MIN_SIGNAL: f64 = 0.05;
/// ... and at most this part, so that noise at the clipping level cannot bias.
pub(super) const MAX_SIGNAL: f64 = 0.9;
/// Uncertainty of the black level common to all pixels and to both frames, DN.
const BLACK_LEVEL_STD_DN: f64 = 0.25;

/// Compares two frames over the pixels that are well exposed in either, or else all,
/// that are clipped in none and not hot. `None` where they show no signal.
pub fn signal_ratio(
    noise: &SensorNoise,
    earlier: Exposed<'_>,
    later: Exposed<'_>,
) -> Option<SignalRatio> {
    ratio_above(noise, MIN_SIGNAL, earlier, later)
        .or_else(|| ratio_above(noise, f64::NEG_INFINITY, earlier, later))
}

fn ratio_above(
    noise: &SensorNoise,
    min_signal: f64,
    earlier: Exposed<'_>,
    later: Exposed<'_>,
) -> Option<SignalRatio> {
    let signal = |frame: Exposed<'_>, pixel: usize| signal_dn(noise, frame, pixel);
    let range_dn = noise.usable_range_dn();
    let (mut sums_dn, mut variances_dn2, mut pixels) = ([0.0; 2], [0.0; 2], 0.0);
    for pixel in 0..earlier.counts.len().min(later.counts.len()) {
        // Both frames decide together: what share of their electrons one of them has does not
        // depend on how many there are, so pixels chosen by the sum, noise included, bias
        // nothing. By the brighter frame alone, pixels near the limit would be those with
        // more than their share in it.
        let signals = [earlier, later].map(|frame| signal(frame, pixel) / range_dn);
        let (together, brightest) = (signals[0] + signals[1], signals[0].max(signals[1]));
        let is_hot = noise
            .hot_pixels
            .as_ref()
            .is_some_and(|hot| hot.get(pixel) == Some(&true));
        if is_hot || together < min_signal || brightest > MAX_SIGNAL {
            continue;
        }
        pixels += 1.0;
        for (i, frame) in [earlier, later].into_iter().enumerate() {
            let signal_dn = signal(frame, pixel);
            sums_dn[i] += signal_dn;
            variances_dn2[i] += variance_dn2(noise, frame, signal_dn);
        }
    }
    let rate = |i: usize, frame: Exposed<'_>| sums_dn[i] / frame.exposure_s;
    if pixels == 0.0 || sums_dn[0] <= 0.0 {
        return None;
    }
    let ratio = rate(1, later) / rate(0, earlier);
    let relative2 = |i: usize| variances_dn2[i] / sums_dn[i].max(1.0).powi(2);
    let per_black_dn = |i: usize| pixels / sums_dn[i].max(1.0);
    let black = BLACK_LEVEL_STD_DN * (per_black_dn(1) - per_black_dn(0));
    Some(SignalRatio {
        ratio,
        std_dev: ratio.abs() * (relative2(0) + relative2(1) + black * black).sqrt(),
    })
}

/// A pixel's counts of light, DN.
pub(super) fn signal_dn(noise: &SensorNoise, frame: Exposed<'_>, pixel: usize) -> f64 {
    noise.signal_dn(f64::from(frame.counts[pixel])) - noise.gain_dn_per_e * dark_e(noise, frame)
}

/// Variance of a pixel's counts, DN², of which so many are of light.
pub(super) fn variance_dn2(noise: &SensorNoise, frame: Exposed<'_>, signal_dn: f64) -> f64 {
    noise.count_variance_dn2(signal_dn / noise.gain_dn_per_e + dark_e(noise, frame))
}

fn dark_e(noise: &SensorNoise, frame: Exposed<'_>) -> f64 {
    noise.dark_current_e_s * frame.exposure_s
}

/// The change: `+0.53 ± 0.12%`.
impl fmt::Display for SignalRatio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [change, std_dev] = [self.ratio - 1.0, self.std_dev].map(|part| 100.0 * part);
        write!(f, "{change:+.2} ± {std_dev:.2}%")
    }
}

impl SignalRatio {
    /// The ratio, where it is certain enough to tell what would be refused.
    pub fn if_known(self) -> Option<Self> {
        (self.std_dev <= REFUSED).then_some(self)
    }

    /// Whether a change of 1% would be found.
    pub fn tells_good(&self) -> bool {
        TO_FIND * self.std_dev <= GOOD
    }

    /// Whether another ratio would be refused: the one that a frame shows whose
    /// exposure was ignored.
    pub fn would_tell(&self, ignored_ratio: f64) -> bool {
        // Signal and noise of that frame would not be this one's.
        let std_dev = 2.0 * self.std_dev * ignored_ratio.max(1.0);
        (ignored_ratio - 1.0).abs() > REFUSED + TO_REFUSE * std_dev
    }

    /// Judges; noise is granted three standard deviations before a frame is refused, five
    /// before it is doubted.
    pub fn verdict(&self) -> Verdict {
        self.verdict_beyond(0.0)
    }

    /// Likewise where the ratio may be off by `granted` for a reason that is known.
    pub fn verdict_beyond(&self, granted: f64) -> Verdict {
        let off = (self.ratio - 1.0).abs() - granted;
        if off > REFUSED + TO_REFUSE * self.std_dev {
            Verdict::Refused
        } else if off > GOOD + TO_WARN * self.std_dev {
            Verdict::Doubtful
        } else {
            Verdict::Good
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Frames of a ramp, taken with `true_s`.
    fn frame(noise: &SensorNoise, true_s: f64, seed: u64) -> Vec<u16> {
        (0..4096u64)
            .map(|pixel| {
                let signal_e = 2e4 * (1.0 + pixel as f64 / 4096.0) * true_s;
                let std_e = (signal_e + noise.read_noise_e.powi(2)).sqrt();
                let normal = stream(seed, Purpose::Experiment, 0, pixel, 0).normal();
                let dn = noise.black_level_dn + noise.gain_dn_per_e * (signal_e + std_e * normal);
                dn.round().clamp(0.0, 4095.0) as u16
            })
            .collect()
    }

    fn judge(claimed_s: f64, true_s: f64) -> (SignalRatio, Verdict) {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        let earlier = frame(&noise, 0.05, 1);
        let later = frame(&noise, true_s, 2);
        let ratio = signal_ratio(
            &noise,
            Exposed {
                counts: &earlier,
                exposure_s: 0.05,
            },
            Exposed {
                counts: &later,
                exposure_s: claimed_s,
            },
        )
        .unwrap();
        (ratio, ratio.verdict())
    }

    #[test]
    fn true_exposures_are_good_and_stale_or_wrong_ones_refused() {
        for claimed_s in [0.0125, 0.025, 0.1, 0.2] {
            let (ratio, verdict) = judge(claimed_s, claimed_s);
            assert_eq!(verdict, Verdict::Good, "{claimed_s}: {ratio:?}");
            assert!((ratio.ratio - 1.0).abs() < 4.0 * ratio.std_dev, "{ratio:?}");
            let (ratio, verdict) = judge(claimed_s, 0.05);
            assert_eq!(verdict, Verdict::Refused, "stale at {claimed_s}: {ratio:?}");
        }
        let (ratio, _) = judge(0.1, 0.1);
        assert!(ratio.would_tell(0.5) && ratio.would_tell(2.0));
        assert!(!ratio.would_tell(1.0) && !ratio.would_tell(1.02));
        let weak = SignalRatio {
            ratio: 1.0,
            std_dev: 0.1,
        };
        assert!(!weak.would_tell(0.5) && !weak.would_tell(2.0));
        assert_eq!(judge(0.1, 0.1 * 1.06).1, Verdict::Refused);
        assert_eq!(judge(0.1, 0.1 * 1.024).1, Verdict::Doubtful);
        assert_eq!(judge(0.1, 0.1 * 1.005).1, Verdict::Good);
    }

    /// All pixels clip or show a few electrons: enough to notice a frame of the
    /// old exposure, not enough to state a ratio.
    #[test]
    fn a_few_electrons_tell_a_stale_frame() {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        let frame = |dn: u16| [vec![4095; 32], vec![64 + dn; 32]].concat();
        let (old, new) = (frame(2), frame(8));
        let earlier = Exposed {
            counts: &old,
            exposure_s: 0.25,
        };
        let judge = |counts| {
            let exposure_s = 1.0;
            signal_ratio(&noise, earlier, Exposed { counts, exposure_s }).unwrap()
        };
        assert_eq!(judge(&new).verdict(), Verdict::Good);
        assert_eq!(judge(&new).if_known(), None);
        assert_eq!(judge(&old).verdict(), Verdict::Refused);
    }

    /// Two thousand comparisons of weak frames: no warning, and few taken again.
    #[test]
    fn noise_alone_is_no_finding() {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        let (mut largest, mut refused) = (0.0f64, 0);
        for seed in 0..2000 {
            let frames = [0, 1].map(|i| frame(&noise, 1e-3, 2 * seed + i + 10));
            let part = 64 * (seed as usize % 64);
            let [first, second] = frames.each_ref().map(|counts| Exposed {
                counts: &counts[part..part + 64],
                exposure_s: 1e-3,
            });
            let found = signal_ratio(&noise, first, second).unwrap();
            assert_ne!(found.verdict(), Verdict::Doubtful, "{seed}: {found:?}");
            refused += u32::from(found.verdict() == Verdict::Refused);
            largest = largest.max((found.ratio - 1.0).abs() / found.std_dev);
        }
        assert!(largest > 2.5, "these frames have no noise: {largest}");
        assert!(refused <= 10, "{refused}");
    }

    /// A few pixels near the least signal, most of them below it, as a dark sample's highlight
    /// has them: those that noise lifts over it are no sign of a longer exposure. 400 pairs
    /// of frames, so the mean ratio is known to a twentieth of one's uncertainty.
    #[test]
    fn pixels_near_the_least_signal_bias_nothing() {
        let noise = SensorNoise::ideal(0.38, 2.4, 64.0, 12);
        let frame = |exposure_s: f64, seed: u64| -> Vec<u16> {
            (0..400u64)
                .map(|pixel| {
                    // 20 to 300 electrons in 1 ms; the limit is at 530 in both frames.
                    let signal_e = 2e4 * (1.0 + 14.0 * pixel as f64 / 400.0) * exposure_s;
                    let std_e = (signal_e + noise.read_noise_e.powi(2)).sqrt();
                    let normal = stream(seed, Purpose::Experiment, 2, pixel, 0).normal();
                    let dn = 64.0 + 0.38 * (signal_e + std_e * normal);
                    dn.round().clamp(0.0, 4095.0) as u16
                })
                .collect()
        };
        for (earlier_s, later_s) in [(0.00088, 0.00119), (0.00119, 0.00088), (0.0004, 0.0016)] {
            let (mut sum, mut variance) = (0.0, 0.0f64);
            for seed in 0..400 {
                let [earlier, later] = [(earlier_s, 0), (later_s, 1)]
                    .map(|(exposure_s, which)| (frame(exposure_s, 2 * seed + which), exposure_s));
                let [earlier, later] = [&earlier, &later].map(|(counts, exposure_s)| Exposed {
                    counts,
                    exposure_s: *exposure_s,
                });
                let found = signal_ratio(&noise, earlier, later).unwrap();
                sum += found.ratio - 1.0;
                variance += found.std_dev.powi(2);
            }
            let (bias, std_dev) = (sum / 400.0, variance.sqrt() / 400.0);
            assert!(
                bias.abs() < 0.001 + 4.0 * std_dev,
                "{earlier_s} s, {later_s} s: {bias} ± {std_dev}"
            );
        }
    }

    #[test]
    fn darkness_says_nothing() {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        let dark = Exposed {
            counts: &[64; 100],
            exposure_s: 0.1,
        };
        assert_eq!(signal_ratio(&noise, dark, dark), None);
    }
}
