//! How long a capture takes, as its plan lets expect.

use super::CaptureError;
use super::bracket;
use super::pace::Pace;
use crate::device::LampState;
use crate::radiometry::exposure::{BracketStep, PilotStatistics, plan_bracket};
use crate::radiometry::sensor::SensorNoise;
use crate::session::{ExposureRules, PlanRecord};
use crate::units::StageAngles;

/// Brightest over darkest level of interest of the scene that estimates assume.
const USUAL_CONTRAST: f64 = 100.0;
/// Rounds of pilot frames: one in the middle of the camera's range, one near what the
/// sample requests.
const PILOT_ROUNDS: f64 = 2.0;
/// Getting up to speed, coming from the side that every target is approached from, and
/// being seen to stand, seconds of each move.
const STARTING_S: f64 = 1.5;
/// Of the first move, from the switches: degrees.
const FIRST_MOVE_DEG: f64 = 90.0;
/// The last light's merge, seconds per pixel, and per pixel and frame.
const MERGE_PIXEL_S: f64 = 0.15e-6;
const MERGE_FRAME_S: f64 = 0.02e-6;

/// Expected seconds of the parts of a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// Until the stage knows where it is.
    pub homing_s: f64,
    /// From the end of what was before to a light's first frame, per light; the lamp's
    /// warm-up belongs to the first. The first light once more at the end, where the plan
    /// has it.
    pub arrivals_s: Vec<f64>,
    /// Frames of a light whose pilot is well exposed and whose contrast is usual.
    pub light_s: f64,
    /// Frames of such a light.
    pub frames_per_light: u64,
    /// Frames of the visit to the first light at the end.
    pub revisit_s: f64,
    /// From the last frame to the end.
    pub end_s: f64,
    /// Of single frames.
    pub frames: FrameTiming,
}

/// Expected seconds of single frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameTiming {
    lamp_settle_s: f64,
    latency_frames: f64,
    interval_s: f64,
}

impl FrameTiming {
    /// Every frame takes this long, seconds.
    #[cfg(test)]
    pub(super) fn exactly(frame_s: f64) -> Self {
        Self {
            lamp_settle_s: -0.5 * frame_s,
            latency_frames: 0.0,
            interval_s: frame_s,
        }
    }

    /// A frame of this exposure, seconds, after one of the state `before`.
    pub fn frame_s(
        &self,
        exposure_s: f64,
        lamp: LampState,
        before: Option<(f64, LampState)>,
    ) -> f64 {
        let same_exposure = before.is_some_and(|(before_s, _)| before_s == exposure_s);
        let same_lamp = before.is_some_and(|(_, before)| before == lamp);
        self.changed_s(exposure_s, !same_exposure, !same_lamp)
    }

    /// After a change of the lamp the frame under way is lost, half of one on average; after
    /// one of the settings those that the camera still takes with the old ones.
    fn changed_s(&self, exposure_s: f64, new_exposure: bool, new_lamp: bool) -> f64 {
        let frame_s = exposure_s.max(self.interval_s);
        let lamp_s = if new_lamp {
            self.lamp_settle_s + 0.5 * frame_s
        } else {
            0.0
        };
        let settings_s = if new_exposure {
            self.latency_frames * frame_s
        } else {
            0.0
        };
        frame_s + lamp_s.max(settings_s)
    }

    /// The frames of a bracket under this number of lamp channels, with the first exposure
    /// once more under each against drift of the lamp.
    pub fn bracket_s(&self, steps: &[BracketStep], rules: &ExposureRules, channels: usize) -> f64 {
        let of_step = |step: &BracketStep| {
            let states = channels + usize::from(rules.ambient);
            let all = states as f64 * f64::from(step.frames) + f64::from(rules.dark_frames);
            let changed = self.changed_s(step.exposure_s, false, true);
            let more = self.changed_s(step.exposure_s, true, true) - changed;
            more + states as f64 * changed
                + (all - states as f64) * self.changed_s(step.exposure_s, false, false)
        };
        let again = steps
            .first()
            .map_or(0.0, |first| self.states_s(first.exposure_s, channels));
        steps.iter().map(of_step).sum::<f64>() + again
    }

    /// One frame under each of so many states of the lamp, at a new exposure.
    fn states_s(&self, exposure_s: f64, states: usize) -> f64 {
        self.changed_s(exposure_s, true, true)
            + (states as f64 - 1.0) * self.changed_s(exposure_s, false, true)
    }
}

impl Expected {
    /// Of a plan on a bench of this pace, whose frames have so many pixels.
    ///
    /// # Errors
    /// Exposure rules that make no sense.
    pub fn of(
        plan: &PlanRecord,
        pixels: u64,
        pace: &Pace,
        noise: &SensorNoise,
    ) -> Result<Self, CaptureError> {
        let frames = FrameTiming {
            lamp_settle_s: plan.lamp_settle_s.0,
            latency_frames: f64::from(plan.settings_latency_frames),
            interval_s: pace.frame_interval.0,
        };
        let (rules, channels) = (&plan.exposure, plan.channels.len());
        let states = channels + usize::from(rules.ambient);
        let pilot_s = rules.pilot_s.0.clamp(rules.shortest_s.0, rules.longest_s.0);
        let steps = usual_bracket(rules, pilot_s, noise)?;
        let taken: u64 = steps
            .iter()
            .map(|step| u64::from(step.frames) * states as u64 + u64::from(rules.dark_frames))
            .sum();
        let pilots = PILOT_ROUNDS as u64 * states as u64;
        let frames_per_light = taken + pilots + channels as u64;
        let revisit_s = steps
            .first()
            .map_or(0.0, |step| frames.states_s(step.exposure_s, channels));
        let again: &[StageAngles] = if plan.revisit_first {
            &plan.lights[..1]
        } else {
            &[]
        };
        let way: Vec<StageAngles> = plan.lights.iter().chain(again).copied().collect();
        let arrival_s =
            |deg: f64| STARTING_S + deg / pace.stage_deg_s + plan.settle_s.0 + pace.view.0;
        let first_s = plan.lamp_warm_up_s.0 + arrival_s(FIRST_MOVE_DEG);
        let moves = way
            .windows(2)
            .map(|pair| arrival_s(move_deg(pair[0], pair[1])));
        Ok(Self {
            homing_s: pace.homing.0,
            arrivals_s: std::iter::once(first_s).chain(moves).collect(),
            light_s: PILOT_ROUNDS * frames.states_s(pilot_s, states)
                + frames.bracket_s(&steps, rules, channels),
            frames_per_light,
            revisit_s: if plan.revisit_first { revisit_s } else { 0.0 },
            end_s: pixels as f64 * (MERGE_PIXEL_S + MERGE_FRAME_S * frames_per_light as f64),
            frames,
        })
    }

    /// All of it, for so many lights.
    pub fn total_s(&self, lights: usize) -> f64 {
        let arrivals_s: f64 = self.arrivals_s.iter().sum();
        self.homing_s + arrivals_s + lights as f64 * self.light_s + self.revisit_s + self.end_s
    }

    /// A light that is chosen after others, without the choice: the stage is homed anew.
    pub fn chosen_s(&self) -> f64 {
        self.homing_s + self.arrivals_s.first().unwrap_or(&0.0) + self.light_s
    }
}

/// The axes turn together; the longer way counts.
fn move_deg(from: StageAngles, to: StageAngles) -> f64 {
    let azimuth_deg = (to.azimuth_deg - from.azimuth_deg).abs();
    azimuth_deg.max((to.elevation_deg - from.elevation_deg).abs())
}

/// The exposures of a light over a scene whose pilot is well exposed and whose contrast is
/// usual.
fn usual_bracket(
    rules: &ExposureRules,
    pilot_s: f64,
    noise: &SensorNoise,
) -> Result<Vec<BracketStep>, CaptureError> {
    let full_e = noise.usable_range_dn() / noise.gain_dn_per_e;
    let brightest_e_s = 0.5 * rules.peak_fraction * full_e / pilot_s;
    let usual = PilotStatistics {
        brightest_e_s,
        darkest_e_s: brightest_e_s / USUAL_CONTRAST,
    };
    let bracket = plan_bracket(
        noise,
        &usual,
        &bracket::limits(rules),
        &bracket::target(rules),
    )?;
    Ok(bracket.steps)
}
