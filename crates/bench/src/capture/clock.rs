//! How far a capture is and how long the rest may take: what the plan lets expect, at the
//! pace so far.

use std::collections::VecDeque;
use std::time::Instant;

use super::duration::Expected;
use crate::device::LampState;
use crate::radiometry::exposure::BracketStep;
use crate::session::ExposureRules;

/// Expected and measured seconds of what is done.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    expected_s: f64,
    measured_s: f64,
}

impl Tally {
    /// Measured over expected, 1 before anything was measured.
    fn pace(&self, trusted_s: f64) -> f64 {
        (trusted_s + self.measured_s) / (trusted_s + self.expected_s)
    }
}

/// The expectation counts as much as a measurement of so many seconds.
const ARRIVAL_TRUST_S: f64 = 1.0;
const FRAME_TRUST_S: f64 = 0.3;

/// Follows a capture frame by frame. Moves and frames have paces of their own: a stage that
/// is slower than expected says nothing about the camera.
pub(super) struct Clock {
    pub(super) start: Instant,
    expected: Expected,
    /// When what was counted last had ended, seconds since the start.
    counted_until_s: f64,
    arrivals: Tally,
    frames: Tally,
    /// Expected seconds of frames that the session held already.
    held_s: f64,
    homing_left_s: f64,
    arrivals_left_s: VecDeque<f64>,
    /// After the one under way.
    lights_left: usize,
    /// Expected of the frames of the light under way: taken, and to come.
    light_taken_s: f64,
    light_left_s: f64,
    revisit_left_s: f64,
    /// Expected seconds of the frames of each light that is done.
    lights_s: Vec<f64>,
    state: Option<(f64, LampState)>,
    done: f64,
}

impl Clock {
    /// For the lights that are not `finished` already.
    pub(super) fn start(expected: Expected, finished: &[bool]) -> Self {
        let to_come = |view: &usize| finished.get(*view) != Some(&true);
        let views = (0..expected.arrivals_s.len()).filter(to_come);
        let mut arrivals_left_s: VecDeque<f64> = views.map(|k| expected.arrivals_s[k]).collect();
        if let Some(first_s) = arrivals_left_s.front_mut()
            && finished.first() == Some(&true)
        {
            // Warm-up comes before any first light.
            *first_s = expected.arrivals_s[0];
        }
        Self {
            start: Instant::now(),
            counted_until_s: 0.0,
            arrivals: Tally::default(),
            frames: Tally::default(),
            held_s: expected.light_s * finished.iter().filter(|&&done| done).count() as f64,
            homing_left_s: if arrivals_left_s.is_empty() {
                0.0
            } else {
                expected.homing_s
            },
            arrivals_left_s,
            lights_left: finished.iter().filter(|&&done| !done).count(),
            light_taken_s: 0.0,
            light_left_s: 0.0,
            revisit_left_s: expected.revisit_s,
            lights_s: Vec::new(),
            state: None,
            done: 0.0,
            expected,
        }
    }

    /// Seconds since the start.
    pub(super) fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// The stage was homed, which says nothing about its moves.
    pub(super) fn homed(&mut self, now_s: f64) {
        self.homing_left_s = 0.0;
        self.forget_until(now_s);
    }

    /// One more light follows, to which the stage is homed anew.
    pub(super) fn add_light(&mut self) {
        let arrival_s = self.expected.arrivals_s.first().copied();
        self.arrivals_left_s.push_front(arrival_s.unwrap_or(0.0));
        self.homing_left_s = self.expected.homing_s;
        self.lights_left += 1;
        self.forget_until(self.now_s());
    }

    /// A light's frames begin, with its pilots.
    pub(super) fn begin_light(&mut self) {
        self.lights_left = self.lights_left.saturating_sub(1);
        self.light_taken_s = 0.0;
        self.light_left_s = self.usual_light_s();
    }

    /// Its exposures are decided.
    pub(super) fn decided(
        &mut self,
        steps: &[BracketStep],
        rules: &ExposureRules,
        channels: usize,
    ) {
        self.light_left_s = self.expected.frames.bracket_s(steps, rules, channels);
    }

    /// Its frames are all taken.
    pub(super) fn end_light(&mut self) {
        self.lights_s.push(self.light_taken_s);
        self.light_left_s = 0.0;
    }

    /// All lights are done; what follows is the visit to the first.
    pub(super) fn begin_revisit(&mut self) {
        self.light_left_s = std::mem::take(&mut self.revisit_left_s);
    }

    /// What passed until now, a pause, says nothing about the pace.
    pub(super) fn forget_until(&mut self, now_s: f64) {
        self.counted_until_s = now_s;
    }

    /// A frame that the session held.
    pub(super) fn held(&mut self, exposure_s: f64, lamp: LampState, now_s: f64) {
        let frame_s = self.frame(exposure_s, lamp);
        self.held_s += frame_s;
        self.forget_until(now_s);
    }

    /// A frame was taken at `now_s`; the stage `moved` before it.
    pub(super) fn took(&mut self, exposure_s: f64, lamp: LampState, moved: bool, now_s: f64) {
        let measured_s = now_s - self.counted_until_s;
        self.counted_until_s = now_s;
        let frame_s = self.frame(exposure_s, lamp);
        if moved {
            self.arrivals.expected_s += self.arrivals_left_s.pop_front().unwrap_or(0.0);
            self.arrivals.measured_s += (measured_s - frame_s * self.frame_pace()).max(0.0);
        } else {
            self.frames.expected_s += frame_s;
            self.frames.measured_s += measured_s;
        }
    }

    fn frame(&mut self, exposure_s: f64, lamp: LampState) -> f64 {
        let frame_s = self.expected.frames.frame_s(exposure_s, lamp, self.state);
        self.state = Some((exposure_s, lamp));
        self.light_taken_s += frame_s;
        self.light_left_s = (self.light_left_s - frame_s).max(0.0);
        frame_s
    }

    /// The lights that are done tell what one takes; before any, the plan does.
    fn usual_light_s(&self) -> f64 {
        match self.lights_s.len() {
            0 => self.expected.light_s,
            count => self.lights_s.iter().sum::<f64>() / count as f64,
        }
    }

    fn frame_pace(&self) -> f64 {
        self.frames.pace(FRAME_TRUST_S)
    }

    /// Expected time left, seconds.
    pub(super) fn left_s(&self) -> f64 {
        let frames_s = self.light_left_s
            + self.lights_left as f64 * self.usual_light_s()
            + self.revisit_left_s;
        self.homing_left_s
            + self.arrivals_left_s.iter().sum::<f64>() * self.arrivals.pace(ARRIVAL_TRUST_S)
            + frames_s * self.frame_pace()
            + self.expected.end_s
    }

    /// Part of the whole that is done, 0 to 1; never less than it was.
    pub(super) fn done(&mut self) -> f64 {
        let so_far_s = self.arrivals.expected_s * self.arrivals.pace(ARRIVAL_TRUST_S)
            + (self.frames.expected_s + self.held_s) * self.frame_pace();
        let whole_s = so_far_s + self.left_s();
        if whole_s > 0.0 {
            self.done = self.done.max(so_far_s / whole_s);
        }
        self.done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::duration::FrameTiming;
    use crate::device::LampChannel;

    /// Four lights, the first visited again; ten frames of 0.1 s each.
    fn expected() -> Expected {
        Expected {
            homing_s: 3.0,
            arrivals_s: vec![3.0; 5],
            light_s: 1.0,
            frames_per_light: 10,
            revisit_s: 0.1,
            end_s: 0.5,
            frames: FrameTiming::exactly(0.1),
        }
    }

    /// Drives a clock through `lights` of ten frames; gives the time left that it stated
    /// before each frame, and the true one.
    fn drive(expected: Expected, arrival_s: f64, frame_s: f64) -> Vec<(f64, f64)> {
        let mut clock = Clock::start(expected, &[false; 4]);
        let lamp = LampState::On(LampChannel(0));
        let (mut now_s, mut said) = (3.0, vec![(0.0, clock.left_s())]);
        clock.homed(now_s);
        for light in 0..5 {
            match light {
                4 => clock.begin_revisit(),
                _ => clock.begin_light(),
            }
            for frame in 0..if light == 4 { 1 } else { 10 } {
                said.push((now_s, clock.left_s()));
                now_s += frame_s + if frame == 0 { arrival_s } else { 0.0 };
                clock.took(0.1, lamp, frame == 0, now_s);
            }
            if light < 4 {
                clock.end_light();
            }
        }
        let end_s = now_s + 0.5;
        said.into_iter()
            .map(|(at, left)| (left, end_s - at))
            .collect()
    }

    #[test]
    fn the_time_left_is_right_where_the_plan_is() {
        for (left, truth) in drive(expected(), 3.0, 0.1) {
            assert!((left / truth - 1.0).abs() < 0.2, "{left} of {truth}");
        }
    }

    /// A stage or a camera three times as slow as expected: known when the first light is done.
    #[test]
    fn a_wrong_plan_is_corrected_by_the_pace() {
        for (arrival_s, frame_s) in [(9.0, 0.1), (3.0, 0.3), (1.0, 0.4)] {
            for (left, truth) in drive(expected(), arrival_s, frame_s).into_iter().skip(11) {
                let off = (left / truth - 1.0).abs();
                assert!(off < 0.3, "{arrival_s} {frame_s}: {left} of {truth}");
            }
        }
    }

    /// What a resumed session holds is done; its time is not the camera's.
    #[test]
    fn held_frames_count_as_done_and_not_as_fast() {
        let mut clock = Clock::start(expected(), &[true, true, false, false]);
        let lamp = LampState::On(LampChannel(0));
        clock.begin_light();
        let before_s = clock.left_s();
        for _ in 0..5 {
            clock.held(0.1, lamp, 0.01);
        }
        assert!(clock.done() > 0.1);
        let left_s = clock.left_s();
        assert!(
            (before_s - left_s - 0.5).abs() < 1e-9,
            "{before_s} {left_s}"
        );
        // One homing, two lights and the return; frames of one and a half lights.
        assert!(
            (left_s - (3.0 + 3.0 * 3.0 + 1.5 + 0.1 + 0.5)).abs() < 1e-9,
            "{left_s}"
        );
    }
}
