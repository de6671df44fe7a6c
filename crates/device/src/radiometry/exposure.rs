//! Which exposures a scene needs: pure planning from a pilot frame.

use serde::{Deserialize, Serialize};

use super::sensor::SensorNoise;

/// Statistics of pilot frames of a scene, in electrons per second at the sensor,
/// lamp and room light together, dark current excluded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PilotStatistics {
    /// The brightest pixel that is not hot.
    pub brightest_e_s: f64,
    /// The darkest level that must still be measured well.
    pub darkest_e_s: f64,
}

/// What one pilot exposure showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PilotReading {
    /// Nothing clipped: the scene is known well enough to plan.
    Usable(PilotStatistics),
    /// This fraction of the pixels of interest is clipped: try a shorter exposure.
    Clipped {
        /// In (0, 1].
        fraction: f64,
    },
}

/// Which pixels of a pilot are used, and which are dark but still of interest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PilotOptions {
    /// The darkest level of interest is this quantile of the pixels; [0, 1]; default 0.05.
    pub darkest_quantile: f64,
    /// ... but never below this fraction of the brightest, so that an empty
    /// background does not need endless exposures; (0, 1]; default 1/2000.
    pub darkest_fraction: f64,
}

impl Default for PilotOptions {
    fn default() -> Self {
        Self {
            darkest_quantile: 0.05,
            darkest_fraction: 1.0 / 2000.0,
        }
    }
}

/// What the camera can do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureLimits {
    /// Shortest exposure, seconds; > 0.
    pub shortest_s: f64,
    /// Longest exposure of one frame, seconds.
    pub longest_s: f64,
    /// Step between possible exposures, seconds; 0 means continuous.
    pub step_s: f64,
    /// Most frames averaged at one exposure; >= 1.
    pub max_frames: u32,
}

/// What the bracket is to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BracketTarget {
    /// The brightest pixel reaches at most this part of the usable range in the
    /// shortest exposure; (0, 1); default 0.7.
    pub peak_fraction: f64,
    /// Signal-to-noise ratio of the darkest level of interest (and of
    /// everything brighter) after the merge; > 0; default 20.
    pub dark_snr: f64,
    /// Largest ratio of neighbouring exposures; > 1; default 4.
    pub ratio: f64,
}

impl Default for BracketTarget {
    fn default() -> Self {
        Self {
            peak_fraction: 0.7,
            dark_snr: 20.0,
            ratio: 4.0,
        }
    }
}

/// One exposure of a bracket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BracketStep {
    /// Exposure of one frame, seconds, on the camera's step.
    pub exposure_s: f64,
    /// Frames averaged.
    pub frames: u32,
}

/// The exposures to take, shortest first, and what they will reach.
#[derive(Clone, Debug, PartialEq)]
pub struct BracketPlan {
    /// Shortest first, at least one.
    pub steps: Vec<BracketStep>,
    /// Expected signal-to-noise ratio at the darkest level of interest, if as
    /// many ambient or dark frames are taken at the longest exposure as light
    /// frames.
    pub dark_snr: f64,
    /// Whether the target is reached at every level; if not, the camera's
    /// longest exposure or the largest number of frames is in the way.
    pub reached: bool,
}

/// Why no bracket can be planned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum PlanError {
    /// A limit, target or pilot value that makes no sense.
    #[error("bracket: {name} = {value} is outside {allowed}")]
    OutOfRange {
        name: &'static str,
        value: f64,
        allowed: &'static str,
    },
    #[error(
        "bracket: the brightest pixel reaches {reached_fraction:.2} of the usable range in the \
         shortest exposure of {shortest_s} s, and {allowed_fraction:.2} is allowed"
    )]
    TooBright {
        reached_fraction: f64,
        shortest_s: f64,
        allowed_fraction: f64,
    },
}

/// Reads pilot frames taken at one exposure. `frames` are raw counts of equal
/// size; `interest` selects pixels (`None`: all). The mean of the frames is
/// used; hot pixels are left out.
pub fn read_pilot(
    noise: &SensorNoise,
    exposure_s: f64,
    frames: &[&[u16]],
    interest: Option<&[bool]>,
    options: &PilotOptions,
) -> PilotReading {
    let pixels = frames.iter().map(|f| f.len()).min().unwrap_or(0);
    let wanted = |p: usize| {
        interest.is_none_or(|mask| mask.get(p).copied().unwrap_or(false))
            && !noise
                .hot_pixels
                .as_ref()
                .is_some_and(|hot| hot.get(p).copied().unwrap_or(false))
    };
    let ceiling_dn = noise.ceiling_dn();
    let mut rates_e_s = Vec::with_capacity(pixels);
    let mut clipped = 0usize;
    for p in (0..pixels).filter(|&p| wanted(p)) {
        if frames.iter().any(|f| f64::from(f[p]) >= ceiling_dn) {
            clipped += 1;
        }
        let mean_dn = frames.iter().map(|f| f64::from(f[p])).sum::<f64>() / frames.len() as f64;
        rates_e_s.push(
            noise.signal_dn(mean_dn) / (noise.gain_dn_per_e * exposure_s) - noise.dark_current_e_s,
        );
    }
    if rates_e_s.is_empty() {
        return PilotReading::Usable(PilotStatistics {
            brightest_e_s: 0.0,
            darkest_e_s: 0.0,
        });
    }
    if clipped > 0 {
        return PilotReading::Clipped {
            fraction: clipped as f64 / rates_e_s.len() as f64,
        };
    }
    rates_e_s.sort_unstable_by(f64::total_cmp);
    let last = rates_e_s.len() - 1;
    let brightest_e_s = rates_e_s[last].max(0.0);
    let quantile = rates_e_s[(options.darkest_quantile.clamp(0.0, 1.0) * last as f64) as usize];
    PilotReading::Usable(PilotStatistics {
        brightest_e_s,
        darkest_e_s: quantile.max(brightest_e_s * options.darkest_fraction),
    })
}

/// Plans a bracket: the shortest exposure keeps the brightest pixel below
/// `target.peak_fraction` of the usable range; exposures then grow by at most
/// `target.ratio` until the darkest level of interest reaches `target.dark_snr`,
/// with frames averaged where one does not suffice. Every level in between gets
/// the target from the longest exposure in which it is not clipped.
///
/// # Errors
/// Values out of range, or a scene too bright for the shortest exposure.
pub fn plan_bracket(
    noise: &SensorNoise,
    pilot: &PilotStatistics,
    limits: &ExposureLimits,
    target: &BracketTarget,
) -> Result<BracketPlan, PlanError> {
    check(pilot, limits, target)?;
    let full_e = noise.usable_range_dn() / noise.gain_dn_per_e;
    let peak_e = target.peak_fraction * full_e;
    let brightest_e_s = pilot.brightest_e_s + noise.dark_current_e_s;
    if brightest_e_s * limits.shortest_s > peak_e {
        return Err(PlanError::TooBright {
            reached_fraction: brightest_e_s * limits.shortest_s / full_e,
            shortest_s: limits.shortest_s,
            allowed_fraction: target.peak_fraction,
        });
    }
    let shortest_s = limits.round_down(peak_e / brightest_e_s);
    let longest_s = if snr(noise, pilot.darkest_e_s, shortest_s, 1) >= target.dark_snr {
        shortest_s
    } else {
        let needed_s =
            exposure_for_snr(noise, pilot.darkest_e_s, target.dark_snr, limits.longest_s);
        limits.round_up(needed_s).max(shortest_s)
    };
    let octaves = (longest_s / shortest_s).ln() / target.ratio.ln();
    // The small allowance keeps a span of exactly n ratios at n steps.
    let intervals = (octaves - 1e-9).ceil().max(0.0) as u32;
    let mut exposures_s: Vec<f64> = (0..=intervals)
        .map(|i| {
            let part = f64::from(i) / f64::from(intervals.max(1));
            limits.round_down(shortest_s * (longest_s / shortest_s).powf(part))
        })
        .collect();
    exposures_s.dedup();

    let mut reached = true;
    let mut steps = Vec::with_capacity(exposures_s.len());
    for (i, &exposure_s) in exposures_s.iter().enumerate() {
        // The darkest level that relies on this exposure clips in the next.
        let level_e_s = match exposures_s.get(i + 1) {
            Some(&next_s) => (peak_e / next_s).max(pilot.darkest_e_s),
            None => pilot.darkest_e_s,
        };
        let enough = (1..=limits.max_frames)
            .find(|&frames| snr(noise, level_e_s, exposure_s, frames) >= target.dark_snr);
        reached &= enough.is_some();
        steps.push(BracketStep {
            exposure_s,
            frames: enough.unwrap_or(limits.max_frames),
        });
    }
    let dark_snr = steps
        .iter()
        .map(|step| snr(noise, pilot.darkest_e_s, step.exposure_s, step.frames).powi(2))
        .sum::<f64>()
        .sqrt();
    Ok(BracketPlan {
        steps,
        dark_snr,
        reached: reached || dark_snr >= target.dark_snr,
    })
}

/// Signal-to-noise ratio of `frames` light frames less as many frames without
/// the lamp, at one exposure.
fn snr(noise: &SensorNoise, rate_e_s: f64, exposure_s: f64, frames: u32) -> f64 {
    let dark_e = noise.dark_current_e_s * exposure_s;
    let light_dn2 = noise.mean_count_variance_dn2(rate_e_s * exposure_s + dark_e, frames);
    let unlit_dn2 = noise.mean_count_variance_dn2(dark_e, frames);
    noise.gain_dn_per_e * rate_e_s * exposure_s / (light_dn2 + unlit_dn2).sqrt()
}

/// Shortest exposure with `wanted` SNR in one frame, or `longest_s`; the SNR
/// grows with the exposure, so bisection finds it.
fn exposure_for_snr(noise: &SensorNoise, rate_e_s: f64, wanted: f64, longest_s: f64) -> f64 {
    if snr(noise, rate_e_s, longest_s, 1) <= wanted {
        return longest_s;
    }
    let (mut low, mut high) = (0.0, longest_s);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if snr(noise, rate_e_s, middle, 1) < wanted {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

impl ExposureLimits {
    fn round_down(&self, exposure_s: f64) -> f64 {
        self.on_step(exposure_s, f64::floor)
    }

    fn round_up(&self, exposure_s: f64) -> f64 {
        self.on_step(exposure_s, f64::ceil)
    }

    fn on_step(&self, exposure_s: f64, round: fn(f64) -> f64) -> f64 {
        let stepped = if self.step_s > 0.0 {
            let steps = exposure_s / self.step_s;
            // A multiple of the step that floating point missed by a hair stays itself.
            let nearest = steps.round();
            let steps = if (steps - nearest).abs() < 1e-6 {
                nearest
            } else {
                round(steps)
            };
            steps * self.step_s
        } else {
            exposure_s
        };
        stepped.clamp(self.shortest_s, self.longest_s)
    }
}

fn check(
    pilot: &PilotStatistics,
    limits: &ExposureLimits,
    target: &BracketTarget,
) -> Result<(), PlanError> {
    let positive = |x: f64| x.is_finite() && x > 0.0;
    // Name, value, whether it is allowed, what is.
    let cases = [
        (
            "brightest_e_s",
            pilot.brightest_e_s,
            positive(pilot.brightest_e_s),
            "> 0",
        ),
        (
            "darkest_e_s",
            pilot.darkest_e_s,
            positive(pilot.darkest_e_s) && pilot.darkest_e_s <= pilot.brightest_e_s,
            "(0, brightest_e_s]",
        ),
        (
            "shortest_s",
            limits.shortest_s,
            positive(limits.shortest_s),
            "> 0",
        ),
        (
            "longest_s",
            limits.longest_s,
            positive(limits.longest_s) && limits.longest_s >= limits.shortest_s,
            "[shortest_s, inf)",
        ),
        (
            "step_s",
            limits.step_s,
            limits.step_s.is_finite() && limits.step_s >= 0.0,
            ">= 0",
        ),
        (
            "max_frames",
            f64::from(limits.max_frames),
            (1..=65_536).contains(&limits.max_frames),
            "1..=65536",
        ),
        (
            "peak_fraction",
            target.peak_fraction,
            target.peak_fraction > 0.0 && target.peak_fraction < 1.0,
            "(0, 1)",
        ),
        (
            "dark_snr",
            target.dark_snr,
            positive(target.dark_snr),
            "> 0",
        ),
        (
            "ratio",
            target.ratio,
            target.ratio.is_finite() && target.ratio > 1.0,
            "> 1",
        ),
    ];
    for (name, value, good, allowed) in cases {
        if !good {
            return Err(PlanError::OutOfRange {
                name,
                value,
                allowed,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor() -> SensorNoise {
        SensorNoise {
            dark_current_e_s: 0.5,
            ..SensorNoise::ideal(0.4, 2.5, 64.0, 12)
        }
    }

    fn limits() -> ExposureLimits {
        ExposureLimits {
            shortest_s: 1e-4,
            longest_s: 1.0,
            step_s: 1e-4,
            max_frames: 16,
        }
    }

    #[test]
    fn the_plan_keeps_its_promises_over_scenes() {
        let (noise, limits) = (sensor(), limits());
        let full_e = noise.usable_range_dn() / noise.gain_dn_per_e;
        for brightest_e_s in [2e3, 3e4, 5e5, 2e7] {
            for range in [1.0, 10.0, 200.0, 5000.0] {
                for snr_wanted in [10.0, 40.0, 120.0] {
                    let pilot = PilotStatistics {
                        brightest_e_s,
                        darkest_e_s: brightest_e_s / range,
                    };
                    let target = BracketTarget {
                        dark_snr: snr_wanted,
                        ..BracketTarget::default()
                    };
                    let plan = plan_bracket(&noise, &pilot, &limits, &target).unwrap();
                    let case = format!("{pilot:?}, snr {snr_wanted}: {plan:?}");
                    let first_s = plan.steps[0].exposure_s;
                    assert!(first_s * brightest_e_s <= 0.7001 * full_e, "{case}");
                    for pair in plan.steps.windows(2) {
                        let ratio = pair[1].exposure_s / pair[0].exposure_s;
                        // Rounding to the camera's step can stretch a ratio of short exposures.
                        let slack = limits.step_s / pair[0].exposure_s;
                        assert!(ratio > 1.0 && ratio <= 4.0 * (1.0 + slack) + 1e-9, "{case}");
                    }
                    for step in &plan.steps {
                        assert!((1..=16).contains(&step.frames), "{case}");
                        let steps = step.exposure_s / limits.step_s;
                        assert!((steps - steps.round()).abs() < 1e-6, "{case}");
                    }
                    assert!(!plan.reached || plan.dark_snr >= snr_wanted, "{case}");
                }
            }
        }
    }

    #[test]
    fn a_flat_bright_scene_needs_one_exposure() {
        let pilot = PilotStatistics {
            brightest_e_s: 1e5,
            darkest_e_s: 5e4,
        };
        let plan = plan_bracket(&sensor(), &pilot, &limits(), &BracketTarget::default()).unwrap();
        assert_eq!(plan.steps.len(), 1, "{plan:?}");
        assert_eq!(plan.steps[0].frames, 1);
        assert!(plan.reached);
    }

    #[test]
    fn an_unreachable_target_is_reported() {
        let pilot = PilotStatistics {
            brightest_e_s: 1e4,
            darkest_e_s: 1.0,
        };
        let plan = plan_bracket(&sensor(), &pilot, &limits(), &BracketTarget::default()).unwrap();
        assert!(!plan.reached);
        assert!(plan.dark_snr < 20.0 && plan.dark_snr > 0.1, "{plan:?}");
        assert_eq!(plan.steps.last().unwrap().frames, 16);
        assert_eq!(plan.steps.last().unwrap().exposure_s, 1.0);
    }

    #[test]
    fn too_much_light_and_nonsense_are_errors() {
        let (noise, limits, target) = (sensor(), limits(), BracketTarget::default());
        let pilot = PilotStatistics {
            brightest_e_s: 1e9,
            darkest_e_s: 1e6,
        };
        let error = plan_bracket(&noise, &pilot, &limits, &target).unwrap_err();
        assert!(matches!(error, PlanError::TooBright { .. }), "{error}");
        let error = plan_bracket(
            &noise,
            &pilot,
            &ExposureLimits {
                longest_s: f64::NAN,
                ..limits
            },
            &target,
        )
        .unwrap_err();
        assert!(error.to_string().contains("longest_s"), "{error}");
    }

    #[test]
    fn a_pilot_leaves_hot_pixels_out_and_reports_clipping() {
        let mut noise = sensor();
        let mut counts = vec![64 + 400; 100];
        counts[7] = 4095;
        counts[8] = 64 + 800;
        let options = PilotOptions::default();
        assert_eq!(
            read_pilot(&noise, 0.1, &[&counts], None, &options),
            PilotReading::Clipped { fraction: 0.01 }
        );
        noise.hot_pixels = Some((0..100).map(|p| p == 7).collect());
        let PilotReading::Usable(pilot) = read_pilot(&noise, 0.1, &[&counts], None, &options)
        else {
            panic!("the clipped pixel is hot");
        };
        assert!((pilot.brightest_e_s - (800.0 / 0.04 - 0.5)).abs() < 1e-9);
        assert!((pilot.darkest_e_s - (400.0 / 0.04 - 0.5)).abs() < 1e-9);
    }
}
