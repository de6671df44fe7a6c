//! The topic `capture`: what the events of a capture come to.

use serde::Serialize;
use serde_json::Value;

use crate::capture::{DriftSpan, Ending, FrameEvent, Progress, Stamped};
use crate::radiometry::exposure::BracketStep;
use crate::session::fit_record::Verdict;
use crate::units::StageAngles;

/// The newest warnings are kept.
const MOST_WARNINGS: usize = 50;

/// A capture as the page shows it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CaptureState {
    /// The session's folder.
    pub session: Option<String>,
    /// The sample's name.
    pub sample: Option<String>,
    /// When it began or was resumed, UTC.
    pub began: Option<String>,
    /// What it does.
    pub state: Phase,
    /// Part that is done, 0 to 1.
    pub done: f64,
    /// How long the rest takes, seconds, as of [`Self::left_at`].
    pub left_s: Option<f64>,
    /// When that was estimated, UTC.
    pub left_at: Option<String>,
    /// Free on the session's disk.
    pub disk_free_bytes: Option<u64>,
    /// The planned lights, in their order.
    pub lights: Vec<Light>,
    /// The newest frame on the disk.
    pub frame: Option<StoredFrame>,
    /// The exposures of the present light.
    pub bracket: Vec<BracketStep>,
    /// Change of the lamp over the whole session, percent.
    pub drift_percent: Option<f64>,
    /// Its standard uncertainty, percent.
    pub drift_u_percent: Option<f64>,
    /// What was decided last, of a capture that chooses its lights.
    pub decision: Option<String>,
    /// Oldest first.
    pub warnings: Vec<String>,
    /// Why it failed.
    pub error: Option<String>,
    /// The verdict of its fit.
    pub verdict: Option<Verdict>,
    /// The phase of the fit.
    pub fit_stage: Option<String>,
    #[serde(skip)]
    before_pause: Phase,
    #[serde(skip)]
    is_resumed: bool,
    #[serde(skip)]
    stored: u64,
    /// Session and part that was done of the capture before.
    #[serde(skip)]
    before: Option<(String, f64)>,
}

/// What a capture does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// Nothing has moved yet.
    #[default]
    Preparing,
    /// The stage seeks its reference switches.
    Homing,
    /// The stage moves.
    Moving,
    /// Frames are taken.
    Exposing,
    /// A quick fit tells which light follows; the lamp is off.
    Choosing,
    /// The last images are being merged; the lamp is off.
    Merging,
    /// Lamp off, stage standing.
    Paused,
    /// The capture is complete and its fit runs.
    Fitting,
    /// It is over, and complete.
    Complete,
    /// It was stopped; the session can be resumed.
    Interrupted,
    /// It ended with an error.
    Failed,
}

/// One light of the plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Light {
    /// Its index in the plan.
    pub index: usize,
    /// Where it is.
    #[serde(flatten)]
    pub angles: StageAngles,
    /// Whether it has been captured.
    pub state: LightState,
    /// Expected signal-to-noise ratio of the sample's dark pixels.
    pub dark_snr: Option<f64>,
    /// Frames on the disk.
    pub frames: u32,
    /// Frames that were taken again.
    pub retakes: u32,
    /// The largest change of a lamp channel, percent.
    pub drift_percent: Option<f64>,
    /// Its standard uncertainty, percent.
    pub drift_u_percent: Option<f64>,
}

/// Whether a light has been captured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LightState {
    /// Not yet.
    ToCome,
    /// It is being captured.
    Now,
    /// All its frames are on the disk.
    Done,
}

/// A frame on the disk.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StoredFrame {
    /// Counts the frames up that captures of this console have stored, from 1.
    pub number: u64,
    /// Which.
    #[serde(flatten)]
    pub frame: FrameEvent,
    /// When it was reported, UTC.
    pub stored_at: String,
    /// Its histogram and the like, once somebody has looked.
    pub figures: Option<Value>,
    /// The image, relative to the session's folder.
    #[serde(skip)]
    pub file: String,
}

impl CaptureState {
    /// A capture that begins after another one, which it may continue.
    pub fn after(other: Option<&Self>) -> Self {
        Self {
            stored: other.map_or(0, |other| other.stored),
            before: other.and_then(|other| Some((other.session.clone()?, other.done))),
            ..Self::default()
        }
    }

    /// What an event changes.
    pub fn apply(&mut self, stamped: Stamped) {
        use Progress::*;
        let at = stamped.at;
        match stamped.event {
            Begun {
                session,
                sample,
                lights,
                ..
            } => {
                self.session = Some(session);
                self.sample = Some(sample);
                self.began = Some(at);
                let lights = lights.iter().enumerate();
                self.lights = lights
                    .map(|(index, angles)| Light::to_come(index, *angles))
                    .collect();
            }
            Resumed { .. } => {
                self.is_resumed = true;
                // Until the first frame tells.
                let before = self.before.take();
                let same = before.filter(|(session, _)| Some(session) == self.session.as_ref());
                self.done = same.map_or(0.0, |(_, done)| done);
            }
            Homing => self.state = Phase::Homing,
            Moving { light, .. } => {
                self.state = Phase::Moving;
                self.turn_to(light);
            }
            Planned {
                light,
                steps,
                dark_snr,
            } => {
                self.bracket = steps;
                if let Some(light) = self.light(light) {
                    light.dark_snr = dark_snr;
                }
            }
            Frame { frame, done, .. } => {
                self.state = Phase::Exposing;
                self.done = done.clamp(0.0, 1.0);
                self.turn_to(frame.light);
            }
            Stored {
                frame,
                file,
                retakes,
            } => self.store(frame, file, retakes, at),
            Left { seconds } => {
                self.left_s = Some(seconds);
                self.left_at = Some(at);
            }
            Drift {
                light,
                span,
                relative,
                uncertainty,
                ..
            } => self.drift(light, span, 100.0 * relative, 100.0 * uncertainty),
            LightDone { light } => {
                if let Some(light) = self.light(light) {
                    light.state = LightState::Done;
                }
            }
            Choosing => self.state = Phase::Choosing,
            Decided(decision) => {
                self.decision = Some(decision.to_string());
                let index = self.lights.len();
                let next = decision.next();
                self.lights.extend(next.map(|at| Light::to_come(index, at)));
            }
            Merging => self.state = Phase::Merging,
            Paused => {
                if self.state != Phase::Paused {
                    self.before_pause = self.state;
                }
                self.state = Phase::Paused;
            }
            Continued => {
                if self.state == Phase::Paused {
                    self.state = self.before_pause;
                }
            }
            Warning { text } => self.warn(text),
            Ended {
                outcome,
                session,
                error,
                ..
            } => self.end(outcome, session, error),
            Fit { stage, done } => {
                self.state = Phase::Fitting;
                self.fit_stage = Some(stage);
                self.done = done.clamp(0.0, 1.0);
            }
            Fitted { verdict, .. } => {
                self.state = Phase::Complete;
                self.verdict = Some(verdict);
                self.done = 1.0;
            }
            FitFailed { error, .. } => {
                self.state = Phase::Complete;
                self.warn(format!("the fit failed: {error}"));
                self.done = 1.0;
            }
            // Of the job.
            Asked { .. } | Calibrating { .. } => {}
            Dropped { count } => self.warn(format!("{count} reports of the capture were lost")),
        }
    }

    /// The process has ended; whatever it did not report itself.
    pub fn process_ended(&mut self, was_stopped: bool) {
        self.left_s = None;
        match self.state {
            Phase::Complete | Phase::Interrupted | Phase::Failed => {}
            // The capture was complete before its fit began.
            Phase::Fitting => self.state = Phase::Complete,
            _ if was_stopped => self.end(Ending::Interrupted, None, None),
            _ => self.end(Ending::Failed, None, None),
        }
    }

    fn end(&mut self, outcome: Ending, session: Option<String>, error: Option<String>) {
        self.state = match outcome {
            Ending::Complete => Phase::Complete,
            Ending::Interrupted => Phase::Interrupted,
            Ending::Failed => Phase::Failed,
        };
        if outcome == Ending::Complete {
            self.done = 1.0;
        }
        self.session = session.or_else(|| self.session.take());
        self.error = error;
        self.left_s = None;
        for light in &mut self.lights {
            if light.state == LightState::Now {
                light.state = LightState::ToCome;
            }
        }
    }

    fn light(&mut self, index: u32) -> Option<&mut Light> {
        self.lights.get_mut(index as usize)
    }

    /// This light is the present one. A resumed session has those before it already; a done
    /// one that is visited again stays done.
    fn turn_to(&mut self, index: u32) {
        if std::mem::take(&mut self.is_resumed) {
            let before = self.lights.iter_mut().take(index as usize);
            before.for_each(|light| light.state = LightState::Done);
            let part = f64::from(index) / self.lights.len().max(1) as f64;
            self.done = self.done.max(part.min(1.0));
        }
        for light in &mut self.lights {
            match light.state {
                LightState::ToCome if light.index == index as usize => {
                    light.state = LightState::Now;
                }
                LightState::Now if light.index != index as usize => {
                    light.state = LightState::ToCome;
                }
                _ => {}
            }
        }
    }

    fn store(&mut self, frame: FrameEvent, file: String, retakes: u32, at: String) {
        self.stored += 1;
        self.frame = Some(StoredFrame {
            number: self.stored,
            frame,
            stored_at: at,
            figures: None,
            file,
        });
        if let Some(light) = self.light(frame.light) {
            light.frames += 1;
            light.retakes += retakes;
        }
    }

    fn drift(&mut self, light: u32, span: DriftSpan, percent: f64, u_percent: f64) {
        let (drift, uncertainty) = match (span, self.lights.get_mut(light as usize)) {
            (DriftSpan::Session, _) => (&mut self.drift_percent, &mut self.drift_u_percent),
            (DriftSpan::Light, Some(light)) => {
                (&mut light.drift_percent, &mut light.drift_u_percent)
            }
            (DriftSpan::Light, None) => return,
        };
        if drift.is_none_or(|largest| percent.abs() > largest.abs()) {
            *drift = Some(percent);
            *uncertainty = Some(u_percent);
        }
    }

    fn warn(&mut self, text: String) {
        if self.warnings.len() == MOST_WARNINGS {
            self.warnings.remove(0);
        }
        self.warnings.push(text);
    }
}

impl Light {
    fn to_come(index: usize, angles: StageAngles) -> Self {
        Self {
            index,
            angles,
            state: LightState::ToCome,
            dark_snr: None,
            frames: 0,
            retakes: 0,
            drift_percent: None,
            drift_u_percent: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// The state after these events, whose time is their number in seconds.
    fn after(events: &[Value]) -> CaptureState {
        let mut state = CaptureState::default();
        for (second, event) in events.iter().enumerate() {
            let mut event = event.clone();
            event["at"] = format!("2026-11-27T08:00:{second:02}Z").into();
            state.apply(serde_json::from_value(event).unwrap());
        }
        state
    }

    fn begun() -> Value {
        json!({"event": "begun", "session": "sessions/s", "sample": "bowl", "channels": [0, 1], "pid": 7,
            "lights": [{"azimuth_deg": 10.0, "elevation_deg": 20.0}, {"azimuth_deg": 30.0, "elevation_deg": 40.0}]})
    }

    fn frame(event: &str, light: u32, more: Value) -> Value {
        let mut frame = json!({"event": event, "light": light, "exposure": 0, "repeat": 0, "kind": "light",
            "pilot": false, "exposure_s": 0.02, "lamp": 1});
        frame
            .as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        frame
    }

    #[test]
    fn events_become_the_state_of_lights_and_frames() {
        let moving = |light| json!({"event": "moving", "light": light, "azimuth_deg": 1.0, "elevation_deg": 2.0});
        let mut events = vec![begun(), json!({"event": "homing"}), moving(0)];
        assert_eq!(after(&events).state, Phase::Moving);
        assert_eq!(after(&events[..2]).state, Phase::Homing);
        events.extend([
            json!({"event": "planned", "light": 0, "steps": [{"exposure_s": 0.01, "frames": 2}], "dark_snr": 31.0}),
            frame("frame", 0, json!({"kept": true, "done": 0.25})),
            frame("stored", 0, json!({"file": "raw/a.png", "retakes": 2})),
            json!({"event": "left", "seconds": 33.0}),
            json!({"event": "drift", "light": 0, "channel": 0, "span": "light", "relative": -0.003, "uncertainty": 0.001}),
            json!({"event": "drift", "light": 0, "channel": 1, "span": "light", "relative": 0.001, "uncertainty": 0.002}),
            json!({"event": "light-done", "light": 0}),
            moving(1),
            frame("frame", 1, json!({"kept": true, "done": 0.5})),
        ]);
        let state = serde_json::to_value(after(&events)).unwrap();
        let lights = state["lights"].as_array().unwrap();
        assert_eq!(
            lights[0],
            json!({"index": 0, "azimuth_deg": 10.0, "elevation_deg": 20.0, "state": "done", "dark_snr": 31.0,
                "frames": 1, "retakes": 2, "drift_percent": -0.3, "drift_u_percent": 0.1})
        );
        assert_eq!(lights[1]["state"], "now");
        assert_eq!(
            (&state["state"], &state["done"]),
            (&json!("exposing"), &json!(0.5))
        );
        assert_eq!(state["left_at"], "2026-11-27T08:00:06Z");
        assert_eq!(
            state["frame"],
            json!({"number": 1, "light": 0, "exposure": 0, "repeat": 0, "kind": "light",
                "pilot": false, "exposure_s": 0.02, "lamp": 1, "stored_at": "2026-11-27T08:00:05Z", "figures": null})
        );
        assert_eq!(state["bracket"], json!([{"exposure_s": 0.01, "frames": 2}]));
    }

    #[test]
    fn a_pause_returns_to_what_was_done_before() {
        let mut events = vec![
            begun(),
            json!({"event": "merging"}),
            json!({"event": "paused"}),
            json!({"event": "paused"}),
        ];
        assert_eq!(after(&events).state, Phase::Paused);
        events.push(json!({"event": "continued"}));
        assert_eq!(after(&events).state, Phase::Merging);
    }

    #[test]
    fn a_capture_ends_by_its_own_report_or_that_of_its_process() {
        let ended = |outcome: &str| json!({"event": "ended", "outcome": outcome, "session": "sessions/s", "elapsed_s": 3.0, "error": null});
        let mut state = after(&[
            begun(),
            frame("frame", 0, json!({"kept": true, "done": 0.9})),
            ended("interrupted"),
        ]);
        assert_eq!(state.state, Phase::Interrupted);
        assert_eq!(state.lights[0].state, LightState::ToCome);
        state.process_ended(false);
        assert_eq!(state.state, Phase::Interrupted);

        let fit = json!({"event": "fit", "stage": "tracing", "done": 0.3});
        let mut state = after(&[begun(), ended("complete"), fit.clone()]);
        assert_eq!((state.state, state.done), (Phase::Fitting, 0.3));
        state.process_ended(true);
        assert_eq!(state.state, Phase::Complete);
        let fitted = json!({"event": "fitted", "verdict": "explains", "fit": "f", "report": null});
        let state = after(&[begun(), ended("complete"), fit, fitted]);
        assert_eq!((state.state, state.done), (Phase::Complete, 1.0));
        assert_eq!(serde_json::to_value(state).unwrap()["verdict"], "explains");

        for (was_stopped, expected) in [(true, Phase::Interrupted), (false, Phase::Failed)] {
            let mut state = after(&[begun()]);
            state.process_ended(was_stopped);
            assert_eq!(state.state, expected);
        }
    }

    #[test]
    fn a_resumed_session_has_the_lights_before_the_first() {
        let state = after(&[
            begun(),
            json!({"event": "resumed", "frames": 9}),
            json!({"event": "moving", "light": 1, "azimuth_deg": 1.0, "elevation_deg": 2.0}),
        ]);
        let states: Vec<_> = state.lights.iter().map(|light| light.state).collect();
        assert_eq!(states, [LightState::Done, LightState::Now]);
        assert_eq!(state.done, 0.5, "one of two lights");
        // The page goes on from what it showed of this session, and of no other.
        let resumed = json!({"event": "resumed", "frames": 9});
        for (session, done) in [(state.session.as_deref(), 0.5), (Some("other"), 0.0)] {
            let other = CaptureState {
                session: session.map(str::to_owned),
                ..state.clone()
            };
            let mut next = CaptureState::after(Some(&other));
            for mut event in [begun(), resumed.clone()] {
                event["at"] = "2026-11-27T09:00:00Z".into();
                next.apply(serde_json::from_value(event).unwrap());
            }
            assert_eq!(next.done, done, "{session:?}");
        }
    }

    #[test]
    fn events_of_lights_that_are_none_and_many_warnings_are_harmless() {
        let mut events = vec![
            begun(),
            frame("stored", 99, json!({"file": "x", "retakes": 0})),
        ];
        events.extend((0..200).map(|n| json!({"event": "warning", "text": n.to_string()})));
        let mut state = after(&events);
        assert_eq!(state.warnings.len(), MOST_WARNINGS);
        assert_eq!(state.warnings.last().unwrap(), "199");
        assert_eq!(state.frame.take().unwrap().number, 1);
        let mut next = CaptureState::after(Some(&state));
        let event = frame("stored", 0, json!({"file": "x", "retakes": 0, "at": "t"}));
        next.apply(serde_json::from_value(event).unwrap());
        assert_eq!(next.frame.unwrap().number, 2);
    }
}
