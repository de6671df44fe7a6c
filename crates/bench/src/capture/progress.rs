//! How a capture ends, and what it reports meanwhile: the one stream that every display of a
//! capture follows.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{CaptureError, Spent};
use crate::device::{FrameKey, LampChannel, LampState};
use crate::radiometry::exposure::BracketStep;
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
    fn observe(&mut self, progress: Progress<'_>);
    /// A pause was requested: the lamp is off, the stage stands, every frame is on
    /// the disk. Returns when the capture shall continue.
    fn pause(&mut self) {}
}

impl Observer for () {
    fn observe(&mut self, _: Progress<'_>) {}
}

impl<T: Observer> Observer for Option<T> {
    fn observe(&mut self, progress: Progress<'_>) {
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
    fn observe(&mut self, progress: Progress<'_>) {
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

/// A frame that is on the disk and journalled.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredFrame {
    /// Its position in the plan.
    pub key: FrameKey,
    /// Whether it only serves to choose or check exposures and is no part of the bracket.
    pub pilot: bool,
    /// As the camera reported it.
    pub exposure: Seconds,
    /// As the stage reported it.
    pub lamp: LampState,
    /// The image, relative to the session's folder.
    pub file: String,
    /// Frames that came wrong or not at all before this one.
    pub retakes: u32,
}

/// What a capture is doing.
///
/// Of each run: [`Begun`](Self::Begun) first (unless the session cannot be read),
/// [`Ended`](Self::Ended) last. Every frame that is kept is reported by
/// [`Frame`](Self::Frame) before it is taken and by [`Stored`](Self::Stored) in the order of
/// the journal.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// A run begins; nothing has moved yet.
    Begun {
        /// The session's folder.
        session: &'a Path,
        /// The sample's name.
        sample: &'a str,
        /// The planned light directions, in their order.
        lights: &'a [StageAngles],
        /// Lamp channels of each light, in their order.
        channels: &'a [LampChannel],
    },
    /// Frames of the session that need not be taken again.
    Resumed {
        /// How many.
        frames: usize,
    },
    /// The stage seeks its reference switches.
    Homing,
    /// The stage moves.
    Moving {
        /// Index in the plan.
        light: u32,
        /// Target.
        target: StageAngles,
    },
    /// The exposures of a light are decided.
    Planned {
        /// Index in the plan.
        light: u32,
        /// Shortest first.
        steps: &'a [BracketStep],
        /// Expected SNR of the sample's dark pixels.
        dark_snr: f64,
    },
    /// A frame is about to be taken.
    Frame {
        /// Its position in the plan.
        key: FrameKey,
        /// Requested.
        exposure: Seconds,
        /// Lamp.
        lamp: LampState,
        /// Whether it only serves to choose or check exposures and is no part of the bracket.
        pilot: bool,
        /// Whether it becomes a file; one that only compares the light after a new homing
        /// does not.
        kept: bool,
        /// Part of the whole capture that is done, 0 to 1.
        done: f64,
    },
    /// A frame is on the disk and journalled.
    Stored(&'a StoredFrame),
    /// How long the rest will take; reported before anything moves, and before every frame.
    Left(Seconds),
    /// The lamp was compared with itself.
    Drift {
        /// Index of the light in the plan.
        light: u32,
        /// The lamp's channel.
        channel: LampChannel,
        /// Between which frames.
        span: DriftSpan,
        /// Relative change of the signal.
        relative: f64,
        /// Its standard uncertainty if the lamp is constant, relative: noise of both frames,
        /// and the stage's tolerance where it moved in between.
        uncertainty: f64,
    },
    /// All frames of a light are taken; the last of them may still wait for the disk.
    LightDone {
        /// Index in the plan.
        light: u32,
    },
    /// All frames are taken and the lamp is off; the last brackets are being merged.
    Merging,
    /// A pause begins: the lamp is off, the stage stands, every frame is on the disk.
    Paused,
    /// The capture continues after a pause; the stage is homed first.
    Continued,
    /// Something that the operator should know; it is journalled too.
    Warning(&'a str),
    /// The run is over: the lamp is off and the session is closed.
    Ended {
        /// The session's folder.
        session: &'a Path,
        /// How it ended.
        result: Result<Outcome, &'a CaptureError>,
        /// Wall time of the run.
        elapsed: Seconds,
        /// By what was waited for; `None` where no device was used.
        spent: Option<Spent>,
    },
}
