//! A capture's progress, and that of the fit that may follow it, for other programs: one
//! JSON object per event. This is the one place that defines the form;
//! `docs/reference/events.md` describes it.

use serde::{Deserialize, Serialize};

use super::progress::{DriftSpan, Outcome, Progress};
use crate::device::{FrameKey, FrameKind, LampChannel, LampState};
use crate::session::fit_record::Verdict;
use crate::session::utc_now;
use crate::shown::with_causes;
use crate::units::{Seconds, StageAngles};

/// An event, and when it was reported: one line of the stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stamped {
    /// What.
    #[serde(flatten)]
    pub event: CaptureEvent,
    /// When, RFC 3339, UTC, to the millisecond.
    pub at: String,
}

/// What happens in a capture, as another program reads it. Paths are as this process would
/// open them; names that are no Unicode have `�` in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum CaptureEvent {
    /// A run begins; nothing has moved yet.
    Begun {
        /// The session's folder.
        session: String,
        /// The sample's name.
        sample: String,
        /// The planned light directions; events name a light by its index here.
        lights: Vec<StageAngles>,
        /// Numbers of the lamp channels of each light.
        channels: Vec<LampChannel>,
        /// Of the capture.
        pid: u32,
    },
    /// The session was begun before.
    Resumed {
        /// Frames that need not be taken again.
        frames: usize,
    },
    /// The stage seeks its reference switches.
    Homing,
    /// The stage moves to a light.
    Moving {
        /// Index.
        light: u32,
        /// Target, degrees.
        azimuth_deg: f64,
        /// Target, degrees.
        elevation_deg: f64,
    },
    /// The exposures of a light are decided.
    Planned {
        /// Index.
        light: u32,
        /// Shortest first.
        steps: Vec<Step>,
        /// Expected signal-to-noise ratio of the sample's dark pixels; `None` where it is not
        /// finite.
        dark_snr: Option<f64>,
    },
    /// A frame is about to be taken.
    Frame {
        /// Which.
        #[serde(flatten)]
        frame: FrameEvent,
        /// Whether it becomes a file.
        kept: bool,
        /// Part of the whole capture that is done, 0 to 1.
        done: f64,
    },
    /// A frame is on the disk and journalled.
    Stored {
        /// Which.
        #[serde(flatten)]
        frame: FrameEvent,
        /// The image, relative to the session's folder.
        file: String,
        /// Frames that came wrong or not at all before this one.
        retakes: u32,
    },
    /// How long the rest will take.
    Left {
        /// Expected, seconds.
        seconds: f64,
    },
    /// The lamp was compared with itself.
    Drift {
        /// Index of the light.
        light: u32,
        /// Number of the lamp channel.
        channel: LampChannel,
        /// Between which frames.
        span: DriftSpan,
        /// Change of the signal, 0.01 for 1%.
        relative: f64,
        /// Its standard uncertainty, likewise.
        uncertainty: f64,
    },
    /// All frames of a light are taken.
    LightDone {
        /// Index.
        light: u32,
    },
    /// All frames are taken and the lamp is off; the last images are being merged.
    Merging,
    /// The capture is paused: lamp off, stage standing, every frame on the disk.
    Paused,
    /// The capture continues after a pause.
    Continued,
    /// Something that the operator should know.
    Warning {
        /// One sentence or more.
        text: String,
    },
    /// The capture is over; the lamp is off.
    Ended {
        /// How.
        outcome: Ending,
        /// The session's folder; `None` where none was made.
        session: Option<String>,
        /// Wall time, seconds.
        elapsed_s: f64,
        /// Why it failed.
        error: Option<String>,
    },
    /// A phase of the fit begins.
    Fit {
        /// Its name.
        stage: String,
        /// Part of the fit's expected time that is over, 0 to 1.
        done: f64,
    },
    /// The fit is done.
    Fitted {
        /// What it comes to.
        verdict: Verdict,
        /// The fit's folder.
        fit: String,
        /// The report, where one was written.
        report: Option<String>,
    },
    /// The fit failed; the capture is complete.
    FitFailed {
        /// Why.
        error: String,
        /// What to do.
        hint: Option<String>,
    },
    /// The reader was too slow: events are missing here.
    Dropped {
        /// How many.
        count: u64,
    },
}

/// One exposure of a bracket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Of one frame, seconds.
    pub exposure_s: f64,
    /// Frames averaged.
    pub frames: u32,
}

/// Which frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameEvent {
    /// Index of the light.
    pub light: u32,
    /// Running number of exposure and lamp channel within the light.
    pub exposure: u32,
    /// Repeat at the same settings, from 0.
    pub repeat: u32,
    /// What it is for.
    pub kind: FrameKind,
    /// Whether it only serves to choose or check exposures and is no part of the bracket.
    pub pilot: bool,
    /// Requested before the frame is taken, the camera's own report afterwards, seconds.
    pub exposure_s: f64,
    /// The channel that is lit.
    pub lamp: Option<LampChannel>,
}

/// How a capture ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// Every planned frame is there and merged.
    Complete,
    /// Stopped by a signal; the session can be resumed.
    Interrupted,
    /// By an error; a session that was begun can be resumed once its cause is removed.
    Failed,
}

impl Stamped {
    /// With the time of now.
    pub fn now(event: CaptureEvent) -> Self {
        Self {
            event,
            at: utc_now(),
        }
    }
}

impl FrameEvent {
    fn new(key: FrameKey, pilot: bool, exposure: Seconds, lamp: LampState) -> Self {
        Self {
            light: key.light,
            exposure: key.exposure,
            repeat: key.repeat,
            kind: key.kind,
            pilot,
            exposure_s: exposure.0,
            lamp: match lamp {
                LampState::Off => None,
                LampState::On(channel) => Some(channel),
            },
        }
    }
}

impl From<Progress<'_>> for CaptureEvent {
    fn from(progress: Progress<'_>) -> Self {
        match progress {
            Progress::Begun {
                session,
                sample,
                lights,
                channels,
            } => Self::Begun {
                session: session.to_string_lossy().into_owned(),
                sample: sample.to_owned(),
                lights: lights.to_vec(),
                channels: channels.to_vec(),
                pid: std::process::id(),
            },
            Progress::Resumed { frames } => Self::Resumed { frames },
            Progress::Homing => Self::Homing,
            Progress::Moving { light, target } => Self::Moving {
                light,
                azimuth_deg: target.azimuth_deg,
                elevation_deg: target.elevation_deg,
            },
            Progress::Planned {
                light,
                steps,
                dark_snr,
            } => Self::Planned {
                light,
                steps: steps
                    .iter()
                    .map(|step| Step {
                        exposure_s: step.exposure_s,
                        frames: step.frames,
                    })
                    .collect(),
                dark_snr: Some(dark_snr).filter(|snr| snr.is_finite()),
            },
            Progress::Frame {
                key,
                exposure,
                lamp,
                pilot,
                kept,
                done,
            } => Self::Frame {
                frame: FrameEvent::new(key, pilot, exposure, lamp),
                kept,
                done,
            },
            Progress::Stored(stored) => Self::Stored {
                frame: FrameEvent::new(stored.key, stored.pilot, stored.exposure, stored.lamp),
                file: stored.file.clone(),
                retakes: stored.retakes,
            },
            Progress::Left(left) => Self::Left { seconds: left.0 },
            Progress::Drift {
                light,
                channel,
                span,
                relative,
                uncertainty,
            } => Self::Drift {
                light,
                channel,
                span,
                relative,
                uncertainty,
            },
            Progress::LightDone { light } => Self::LightDone { light },
            Progress::Merging => Self::Merging,
            Progress::Paused => Self::Paused,
            Progress::Continued => Self::Continued,
            Progress::Warning(text) => Self::Warning {
                text: text.to_owned(),
            },
            Progress::Ended {
                session,
                result,
                elapsed,
                ..
            } => Self::Ended {
                outcome: match result {
                    Ok(Outcome::Complete) => Ending::Complete,
                    Ok(Outcome::Interrupted) => Ending::Interrupted,
                    Err(_) => Ending::Failed,
                },
                session: Some(session.to_string_lossy().into_owned()),
                elapsed_s: elapsed.0,
                error: result.err().map(|error| with_causes(error)),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::capture::CaptureError;
    use crate::capture::progress::StoredFrame;
    use crate::radiometry::exposure::BracketStep;

    fn json(event: CaptureEvent) -> serde_json::Value {
        let stamped = Stamped {
            event,
            at: "2026-11-27T08:00:00.000Z".to_owned(),
        };
        let text = serde_json::to_string(&stamped).unwrap();
        let again: Stamped = serde_json::from_str(&text).unwrap();
        assert_eq!(again, stamped, "{text}");
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn events_have_the_documented_form_and_are_read_again() {
        let key = FrameKey {
            light: 2,
            exposure: 5,
            repeat: 1,
            kind: FrameKind::Light,
        };
        let stored = StoredFrame {
            key,
            pilot: false,
            exposure: Seconds(0.02),
            lamp: LampState::On(LampChannel(1)),
            file: "raw/L002_E05_R01_light.png".to_owned(),
            retakes: 3,
        };
        assert_eq!(
            json(Progress::Stored(&stored).into()),
            serde_json::json!({
                "event": "stored", "at": "2026-11-27T08:00:00.000Z", "light": 2, "exposure": 5,
                "repeat": 1, "kind": "light", "pilot": false, "exposure_s": 0.02, "lamp": 1,
                "file": "raw/L002_E05_R01_light.png", "retakes": 3,
            })
        );
        let frame = Progress::Frame {
            key: FrameKey {
                kind: FrameKind::Ambient,
                ..key
            },
            exposure: Seconds(0.5),
            lamp: LampState::Off,
            pilot: true,
            kept: true,
            done: 0.25,
        };
        let frame = json(frame.into());
        assert_eq!(frame["event"], "frame");
        assert_eq!(frame["kind"], "ambient");
        assert!(frame["lamp"].is_null() && frame["done"] == 0.25, "{frame}");
        let steps = [BracketStep {
            exposure_s: 0.01,
            frames: 2,
        }];
        let planned = Progress::Planned {
            light: 0,
            steps: &steps,
            dark_snr: f64::INFINITY,
        };
        let planned = json(planned.into());
        assert_eq!(planned["steps"][0]["frames"], 2);
        assert!(planned["dark_snr"].is_null(), "{planned}");
        assert_eq!(
            json(Progress::LightDone { light: 1 }.into())["event"],
            "light-done"
        );
    }

    #[test]
    fn the_end_has_its_outcome_and_the_reason_of_a_failure() {
        let error = CaptureError::Merge {
            light: 1,
            source: "no frame".into(),
        };
        let ended = |result| {
            json(
                Progress::Ended {
                    session: Path::new("sessions/a"),
                    result,
                    elapsed: Seconds(1.5),
                    spent: None,
                }
                .into(),
            )
        };
        let complete = ended(Ok(Outcome::Complete));
        assert_eq!(complete["outcome"], "complete");
        assert!(complete["error"].is_null(), "{complete}");
        assert_eq!(complete["session"], "sessions/a");
        let failed = ended(Err(&error));
        assert_eq!(failed["outcome"], "failed");
        let reason = failed["error"].as_str().unwrap();
        assert!(
            reason.contains("light 1") && reason.ends_with("no frame"),
            "{reason}"
        );
    }
}
