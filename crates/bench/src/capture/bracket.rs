//! Which exposures a light direction needs, from its pilot frames: pure, so
//! that a resumed capture decides as the first one did.
//!
//! A light begins with rounds of pilot frames, one per lamp channel, all at one
//! exposure. While a pixel clips the next round is shorter, while all are dark
//! it is longer; then one bracket is planned that suits all channels together,
//! so that they share the frames with the lamp off.

use crate::radiometry::exposure::{
    BracketStep, BracketTarget, ExposureLimits, PilotOptions, PilotReading, PilotStatistics,
    PlanError, plan_bracket, read_pilot,
};
use crate::radiometry::sensor::SensorNoise;
use crate::session::ExposureRules;

/// A clipped round is followed by one this much shorter.
const SHORTEN: f64 = 8.0;
/// A dark round is followed by one at most this much longer.
const LENGTHEN_AT_MOST: f64 = 8.0;
/// A round is dark while its brightest pixel is below this part of the usable range.
const DARK_PEAK: f64 = 0.1;
/// Brightest pixel of a lengthened round, as part of the usable range.
const AIMED_PEAK: f64 = 0.5;
/// The brightest of a million pixels of pure noise stays below this many
/// standard deviations.
const NOISE_PEAK_SIGMAS: f64 = 6.0;
/// A sum of noise over all pixels stays below this many standard deviations.
const LIT_SIGMAS: f64 = 5.0;
/// From full scale to nothing in steps of [`SHORTEN`] and back: enough for 16 bits.
const MAX_ROUNDS: usize = 12;

/// Pilot frames of all lamp channels at one exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct PilotRound {
    /// Applied exposure, seconds.
    pub exposure_s: f64,
    /// What each channel's frame showed.
    pub readings: Vec<PilotReading>,
}

impl PilotRound {
    /// Reads one frame per channel; `region_of_interest` selects the sample's pixels.
    pub fn read(
        noise: &SensorNoise,
        exposure_s: f64,
        frames: &[&[u16]],
        region_of_interest: Option<&[bool]>,
    ) -> Self {
        let options = PilotOptions::default();
        let read =
            |frame: &&[u16]| read_pilot(noise, exposure_s, &[frame], region_of_interest, &options);
        Self {
            exposure_s,
            readings: frames.iter().map(read).collect(),
        }
    }

    fn is_clipped(&self) -> bool {
        self.readings
            .iter()
            .any(|reading| matches!(reading, PilotReading::Clipped { .. }))
    }

    /// Whether every pixel of every channel is clipped: these frames say nothing.
    pub fn is_saturated(&self) -> bool {
        self.readings.iter().all(
            |reading| matches!(reading, PilotReading::Clipped { fraction } if *fraction >= 1.0),
        )
    }

    fn usable(&self) -> impl Iterator<Item = PilotStatistics> + '_ {
        self.readings.iter().filter_map(|reading| match reading {
            PilotReading::Usable(statistics) => Some(*statistics),
            PilotReading::Clipped { .. } => None,
        })
    }
}

/// Whether a frame with the lamp on is brighter than one without it at the same
/// exposure, beyond five standard deviations of the sum over the pixels of
/// `region_of_interest`.
pub fn shows_light(
    noise: &SensorNoise,
    lit: &[u16],
    unlit: &[u16],
    region_of_interest: Option<&[bool]>,
) -> bool {
    let wanted =
        |pixel: usize| region_of_interest.is_none_or(|mask| mask.get(pixel) == Some(&true));
    let (mut excess_dn, mut variance_dn2) = (0.0, 0.0);
    for (_, (&lit, &unlit)) in lit
        .iter()
        .zip(unlit)
        .enumerate()
        .filter(|(p, _)| wanted(*p))
    {
        excess_dn += f64::from(lit) - f64::from(unlit);
        let charge_dn = f64::from(lit) + f64::from(unlit) - 2.0 * noise.black_level_dn;
        variance_dn2 += noise.gain_dn_per_e * charge_dn.max(0.0)
            + 2.0 * (noise.gain_dn_per_e * noise.read_noise_e).powi(2)
            + 2.0 / 12.0;
    }
    excess_dn > LIT_SIGMAS * f64::sqrt(variance_dn2)
}

/// What to do after some rounds of pilot frames.
#[derive(Clone, Debug, PartialEq)]
pub enum Decision {
    /// Another round at this exposure, seconds.
    Pilot {
        /// Not yet rounded to the camera's step.
        exposure_s: f64,
    },
    /// The bracket, shortest exposure first.
    Bracket {
        /// Exposures and the frames averaged at each.
        steps: Vec<BracketStep>,
        /// Expected SNR of the dark pixels.
        dark_snr: f64,
        /// Whether the stated SNR is reached with the longest exposure and the
        /// most frames allowed.
        reached: bool,
        /// Pixels clip even in the camera's shortest exposure.
        clips: bool,
    },
    /// No channel shows any light in the longest exposure.
    NoLight,
}

/// Decides from the rounds taken so far.
///
/// # Errors
/// Rules that make no sense (see [`plan_bracket`]).
pub fn decide(
    noise: &SensorNoise,
    rules: &ExposureRules,
    rounds: &[PilotRound],
) -> Result<Decision, PlanError> {
    let (shortest_s, longest_s) = (rules.shortest_s.0, rules.longest_s.0);
    let Some(last) = rounds.last() else {
        let exposure_s = rules.pilot_s.0.clamp(shortest_s, longest_s);
        return Ok(Decision::Pilot { exposure_s });
    };
    let more = rounds.len() < MAX_ROUNDS;
    let full_e = noise.usable_range_dn() / noise.gain_dn_per_e;
    let is_shortest = last.exposure_s <= shortest_s * (1.0 + 1e-9);
    if last.is_clipped() {
        if more && !is_shortest {
            let exposure_s = (last.exposure_s / SHORTEN).max(shortest_s);
            return Ok(Decision::Pilot { exposure_s });
        }
        return bracket(noise, rules, joint(rounds, true), true);
    }
    let brightest_e = peak(last) * last.exposure_s;
    let clipped_before = rounds.iter().any(PilotRound::is_clipped);
    if more
        && !clipped_before
        && brightest_e < DARK_PEAK * full_e
        && last.exposure_s < longest_s * (1.0 - 1e-9)
    {
        let factor = (AIMED_PEAK * full_e / brightest_e.max(1e-9)).min(LENGTHEN_AT_MOST);
        let exposure_s = (last.exposure_s * factor).min(longest_s);
        return Ok(Decision::Pilot { exposure_s });
    }
    let noise_e = (noise.read_noise_e.powi(2)
        + noise.dark_current_e_s * last.exposure_s
        + 1.0 / (12.0 * noise.gain_dn_per_e.powi(2)))
    .sqrt();
    if brightest_e < NOISE_PEAK_SIGMAS * noise_e {
        return Ok(Decision::NoLight);
    }
    bracket(noise, rules, joint(rounds, false), false)
}

fn peak(round: &PilotRound) -> f64 {
    round.usable().map(|s| s.brightest_e_s).fold(0.0, f64::max)
}

/// One range of levels for all channels: each from its longest usable round. A
/// channel that still clips is brighter than any number.
fn joint(rounds: &[PilotRound], clips: bool) -> PilotStatistics {
    let channels = rounds
        .iter()
        .map(|round| round.readings.len())
        .min()
        .unwrap_or(0);
    let of_channel = |channel: usize| {
        rounds
            .iter()
            .filter_map(|round| match round.readings[channel] {
                PilotReading::Usable(statistics) => Some((round.exposure_s, statistics)),
                PilotReading::Clipped { .. } => None,
            })
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, statistics)| statistics)
    };
    let found: Vec<PilotStatistics> = (0..channels).filter_map(of_channel).collect();
    let brightest_e_s = if clips {
        f64::INFINITY
    } else {
        found.iter().map(|s| s.brightest_e_s).fold(0.0, f64::max)
    };
    let darkest_e_s = found
        .iter()
        .map(|s| s.darkest_e_s)
        .filter(|&rate| rate > 0.0)
        .fold(brightest_e_s, f64::min);
    PilotStatistics {
        brightest_e_s,
        darkest_e_s,
    }
}

fn bracket(
    noise: &SensorNoise,
    rules: &ExposureRules,
    levels: PilotStatistics,
    clips: bool,
) -> Result<Decision, PlanError> {
    // What is brighter than the shortest exposure can take begins there.
    let peak_e = rules.peak_fraction * noise.usable_range_dn() / noise.gain_dn_per_e;
    let ceiling_e_s = 0.999_999 * peak_e / rules.shortest_s.0 - noise.dark_current_e_s;
    let brightest_e_s = levels.brightest_e_s.min(ceiling_e_s);
    let faintest_e_s = brightest_e_s * PilotOptions::default().darkest_fraction;
    let statistics = PilotStatistics {
        brightest_e_s,
        darkest_e_s: levels.darkest_e_s.clamp(faintest_e_s, brightest_e_s),
    };
    let plan = plan_bracket(noise, &statistics, &limits(rules), &target(rules))?;
    Ok(Decision::Bracket {
        steps: plan.steps,
        dark_snr: plan.dark_snr,
        reached: plan.reached,
        clips,
    })
}

/// The camera's side of the rules.
pub fn limits(rules: &ExposureRules) -> ExposureLimits {
    ExposureLimits {
        shortest_s: rules.shortest_s.0,
        longest_s: rules.longest_s.0,
        step_s: rules.step_s.0,
        max_frames: rules.max_frames,
    }
}

/// What the rules want to reach.
pub fn target(rules: &ExposureRules) -> BracketTarget {
    BracketTarget {
        peak_fraction: rules.peak_fraction,
        dark_snr: rules.dark_snr,
        ratio: rules.ratio,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Seconds;

    fn noise() -> SensorNoise {
        SensorNoise {
            dark_current_e_s: 0.2,
            ..SensorNoise::ideal(0.4, 2.5, 64.0, 12)
        }
    }

    fn rules() -> ExposureRules {
        ExposureRules {
            pilot_s: Seconds(0.02),
            shortest_s: Seconds(1e-4),
            longest_s: Seconds(2.0),
            max_frames: 8,
            ..crate::session::example::plan().exposure
        }
    }

    /// Noise-free counts of pixels with these rates, electrons per second.
    fn counts(rates_e_s: &[f64], exposure_s: f64) -> Vec<u16> {
        let noise = noise();
        let count = |&rate: &f64| {
            let signal_e = (rate + noise.dark_current_e_s) * exposure_s;
            (noise.black_level_dn + noise.gain_dn_per_e * signal_e)
                .round()
                .min(4095.0) as u16
        };
        rates_e_s.iter().map(count).collect()
    }

    /// Pilot rounds as a capture would take them, and the last decision.
    fn decide_for(channels: &[&[f64]]) -> (Vec<PilotRound>, Decision) {
        let mut rounds = Vec::new();
        loop {
            match decide(&noise(), &rules(), &rounds).unwrap() {
                Decision::Pilot { exposure_s } => {
                    let frames: Vec<_> = channels.iter().map(|c| counts(c, exposure_s)).collect();
                    let frames: Vec<_> = frames.iter().map(Vec::as_slice).collect();
                    rounds.push(PilotRound::read(&noise(), exposure_s, &frames, None));
                }
                done => return (rounds, done),
            }
            assert!(rounds.len() <= MAX_ROUNDS);
        }
    }

    #[test]
    fn no_pixel_stays_saturated_and_dark_pixels_reach_the_snr() {
        for scale in [3e2, 1e4, 1e5, 5e5] {
            let bright: Vec<f64> = (1..=100).map(|i| scale * f64::from(i)).collect();
            let dim: Vec<f64> = bright.iter().map(|rate| 0.2 * rate).collect();
            let (rounds, decision) = decide_for(&[&bright, &dim]);
            let Decision::Bracket {
                steps,
                dark_snr,
                reached,
                clips,
            } = decision
            else {
                panic!("{scale}: {decision:?}");
            };
            assert!(!clips && reached && dark_snr >= 20.0, "{scale}: {steps:?}");
            let first = counts(&bright, steps[0].exposure_s);
            assert!(
                first.iter().all(|&c| f64::from(c) < 64.0 + 0.71 * 4031.0),
                "{scale}"
            );
            assert!(rounds.len() <= 5, "{scale}: {} rounds", rounds.len());
        }
    }

    #[test]
    fn too_bright_a_scene_is_captured_in_the_shortest_exposure_and_said_so() {
        // Clipped in the shortest exposure, and so bright that noise could clip it.
        for (brightest_e_s, clipped) in [(2e9, true), (9.5e7, false)] {
            let (_, decision) = decide_for(&[&[brightest_e_s, 1e5]]);
            let Decision::Bracket { steps, clips, .. } = decision else {
                panic!("{decision:?}");
            };
            assert_eq!(clips, clipped, "{brightest_e_s}");
            assert_eq!(steps[0].exposure_s, 1e-4);
        }
    }

    #[test]
    fn a_dark_lamp_is_noticed_and_one_dark_channel_is_not_a_dark_lamp() {
        assert_eq!(decide_for(&[&[0.0, 0.0], &[0.0, 0.1]]).1, Decision::NoLight);
        let (_, decision) = decide_for(&[&[1e5, 1e4], &[0.0, 0.0]]);
        assert!(
            matches!(decision, Decision::Bracket { clips: false, .. }),
            "{decision:?}"
        );
    }

    #[test]
    fn light_is_told_from_room_light_and_noise() {
        let room = counts(&[500.0; 400], 0.1);
        let lit = counts(&[540.0; 400], 0.1);
        assert!(shows_light(&noise(), &lit, &room, None));
        assert!(!shows_light(&noise(), &room, &room, None));
        assert!(!shows_light(&noise(), &lit, &room, Some(&[false; 400])));
    }

    #[test]
    fn the_first_pilot_is_the_rules() {
        assert_eq!(
            decide(&noise(), &rules(), &[]).unwrap(),
            Decision::Pilot { exposure_s: 0.02 }
        );
    }
}
