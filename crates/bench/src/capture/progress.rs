//! How a capture ends, and what it reports meanwhile: the one stream that every display of a
//! capture follows, in this process and, as JSON lines, in others.

use serde::{Deserialize, Serialize};

use super::Spent;
use crate::device::{FrameKey, FrameKind, LampChannel, LampState};
use crate::radiometry::exposure::BracketStep;
use crate::session::fit_record::Verdict;
use crate::session::{Decision, utc_now};
use crate::units::{Seconds, StageAngles};

/// How a capture ended without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Every planned frame is journalled, every bracket merged.
    Complete,
    /// Stopped as requested; the session can be resumed.
    Interrupted,
}

/// Is informed of what a capture is doing; `()` ignores it, a pair informs both.
pub trait Observer {
    /// Called between frames; should return soon.
    fn observe(&mut self, progress: &Progress);
    /// A pause was requested: the lamp is off, the stage stands, every frame is on
    /// the disk. Returns when the capture shall continue.
    fn pause(&mut self) {}
}

impl Observer for () {
    fn observe(&mut self, _: &Progress) {}
}

impl<T: Observer> Observer for Option<T> {
    fn observe(&mut self, progress: &Progress) {
        if let Some(observer) = self {
            observer.observe(progress);
        }
    }

    fn pause(&mut self) {
        if let Some(observer) = self {
            observer.pause();
        }
    }
}

/// Both, one after the other: the second one's pause begins when the first one's has ended.
impl<A: Observer, B: Observer> Observer for (A, B) {
    fn observe(&mut self, progress: &Progress) {
        self.0.observe(progress);
        self.1.observe(progress);
    }

    fn pause(&mut self) {
        self.0.pause();
        self.1.pause();
    }
}

/// Between which frames the lamp is compared with itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DriftSpan {
    /// A light's first frames and its last.
    Light,
    /// The first light's first frames and those of its second visit after the last light.
    Session,
}

/// What a capture is doing, and the fit that may follow it. Serialised, it is what another
/// program reads (`docs/reference/events.md`): paths are as this process would open them; names
/// that are no Unicode have `�` in them.
///
/// Of each run: [`Begun`](Self::Begun) first (unless the session cannot be read),
/// [`Ended`](Self::Ended) last. Every frame that is kept is reported by
/// [`Frame`](Self::Frame) before it is taken and by [`Stored`](Self::Stored) in the order of
/// the journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
#[allow(missing_docs)]
pub enum Progress {
    /// A run begins; nothing has moved yet.
    Begun {
        session: String,
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
        light: u32,
        #[serde(flatten)]
        target: StageAngles,
    },
    /// The person at the bench is asked to do something; what they answer is a line of this
    /// process's stdin.
    Asked {
        /// Counts the requests up, from 1.
        number: u64,
        /// What to do.
        #[serde(flatten)]
        work: HandWork,
    },
    /// The exposures of a light are decided.
    Planned {
        light: u32,
        /// Shortest first.
        steps: Vec<BracketStep>,
        /// Expected signal-to-noise ratio of the sample's dark pixels; `None` where it is not
        /// finite.
        dark_snr: Option<f64>,
    },
    /// A frame is about to be taken.
    Frame {
        #[serde(flatten)]
        frame: FrameEvent,
        /// Whether it becomes a file; one that only compares the light after a new homing
        /// does not.
        kept: bool,
        /// Part of the whole capture that is done, 0 to 1.
        done: f64,
    },
    /// A frame is on the disk and journalled.
    Stored {
        #[serde(flatten)]
        frame: FrameEvent,
        /// The image, relative to the session's folder.
        file: String,
        /// Frames that came wrong or not at all before this one.
        retakes: u32,
    },
    /// How long the rest will take; reported before anything moves, and before every frame.
    Left {
        /// Expected, seconds.
        seconds: f64,
    },
    /// The lamp was compared with itself.
    Drift {
        light: u32,
        /// Number of the lamp channel.
        channel: LampChannel,
        /// Between which frames.
        span: DriftSpan,
        /// Change of the signal, 0.01 for 1%.
        relative: f64,
        /// Its standard uncertainty if the lamp is constant, likewise: noise of both frames, and
        /// the stage's tolerance where it moved in between.
        uncertainty: f64,
    },
    /// All frames of a light are taken; the last of them may still wait for the disk.
    LightDone { light: u32 },
    /// Of a capture that chooses its lights: the lamp rests while a quick fit tells which follows.
    Choosing,
    /// What was decided after the lights so far.
    Decided(Decision),
    /// All frames are taken and the lamp is off; the last images are being merged.
    Merging,
    /// The capture is paused: lamp off, stage standing, every frame on the disk.
    Paused,
    /// The capture continues after a pause; the stage is homed first.
    Continued,
    /// Something that the operator should know; it is journalled too.
    Warning {
        /// One sentence or more.
        text: String,
    },
    /// The capture is over; the lamp is off.
    Ended {
        outcome: Ending,
        /// The session's folder; `None` where none was made.
        session: Option<String>,
        /// Wall time, seconds.
        elapsed_s: f64,
        error: Option<String>,
        /// By what was waited for; `None` where no device was used, and for other programs.
        #[serde(skip)]
        spent: Option<Spent>,
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
        verdict: Verdict,
        /// The fit's folder.
        fit: String,
        /// The report, where one was written.
        report: Option<String>,
    },
    /// The fit failed; the capture is complete.
    FitFailed { error: String, hint: Option<String> },
    /// A calibration takes its frames.
    Calibrating {
        /// Part of them that is taken, 0 to 1.
        done: f64,
    },
    /// The reader was too slow: events are missing here.
    Dropped { count: u64 },
}

/// What the person at the bench is asked to do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case")]
pub enum HandWork {
    /// Put or hold the lamp where it shines from this direction.
    Place(StageAngles),
    /// Switch on this channel of the lamp, and no other.
    LampOn {
        /// Its number.
        channel: LampChannel,
    },
    /// Switch the lamp off.
    LampOff,
    /// Cover the lens.
    Cover,
    /// Take the cover off.
    Uncover,
    /// Switch the even light on and leave the room as it is.
    LightOn,
    /// Likewise off.
    LightOff,
}

/// Which frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct FrameEvent {
    pub light: u32,
    /// Running number of exposure and lamp channel within the light.
    pub exposure: u32,
    /// Repeat at the same settings, from 0.
    pub repeat: u32,
    pub kind: FrameKind,
    /// Whether it only serves to choose or check exposures and is no part of the bracket.
    pub pilot: bool,
    /// Requested before the frame is taken, the camera's own report afterwards, seconds.
    pub exposure_s: f64,
    /// The channel that is lit.
    pub lamp: Option<LampChannel>,
}

impl FrameEvent {
    pub(super) fn new(key: FrameKey, pilot: bool, exposure: Seconds, lamp: LampState) -> Self {
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

/// An event, and when it was reported: one line of the stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stamped<E = Progress> {
    /// What.
    #[serde(flatten)]
    pub event: E,
    /// When, RFC 3339, UTC, to the millisecond.
    pub at: String,
}

impl<E> Stamped<E> {
    /// With the time of now.
    pub fn now(event: E) -> Self {
        Self {
            event,
            at: utc_now(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(event: Progress) -> serde_json::Value {
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
        let key = FrameKey::new(2, 5, 1, FrameKind::Light);
        let lamp = LampState::On(LampChannel(1));
        let stored = Progress::Stored {
            frame: FrameEvent::new(key, false, Seconds(0.02), lamp),
            file: "raw/L002_E05_R01_light.png".to_owned(),
            retakes: 3,
        };
        assert_eq!(
            json(stored),
            serde_json::json!({
                "event": "stored", "at": "2026-11-27T08:00:00.000Z", "light": 2, "exposure": 5,
                "repeat": 1, "kind": "light", "pilot": false, "exposure_s": 0.02, "lamp": 1,
                "file": "raw/L002_E05_R01_light.png", "retakes": 3,
            })
        );
        let target = StageAngles::new(10.0, 20.5);
        let moving = json(Progress::Moving { light: 1, target });
        assert_eq!(
            moving,
            serde_json::json!({"event": "moving", "at": "2026-11-27T08:00:00.000Z", "light": 1,
                "azimuth_deg": 10.0, "elevation_deg": 20.5})
        );
        let key = FrameKey {
            kind: FrameKind::Ambient,
            ..key
        };
        let frame = json(Progress::Frame {
            frame: FrameEvent::new(key, true, Seconds(0.5), LampState::Off),
            kept: true,
            done: 0.25,
        });
        assert_eq!(
            (&frame["event"], &frame["kind"]),
            (&"frame".into(), &"ambient".into())
        );
        assert!(frame["lamp"].is_null() && frame["done"] == 0.25, "{frame}");
        let planned = json(Progress::Planned {
            light: 0,
            steps: vec![BracketStep {
                exposure_s: 0.01,
                frames: 2,
            }],
            dark_snr: None,
        });
        assert_eq!(planned["steps"][0]["frames"], 2);
        assert!(planned["dark_snr"].is_null(), "{planned}");
        assert_eq!(
            json(Progress::LightDone { light: 1 })["event"],
            "light-done"
        );
        let ended = json(Progress::Ended {
            outcome: Ending::Complete,
            session: Some("sessions/a".to_owned()),
            elapsed_s: 1.5,
            error: None,
            spent: None,
        });
        assert_eq!(ended["outcome"], "complete");
        assert!(
            ended["error"].is_null() && ended.get("spent").is_none(),
            "{ended}"
        );
    }
}
