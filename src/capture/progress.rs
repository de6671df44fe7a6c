//! How a capture ends, and what it says meanwhile.

use std::time::Instant;

use super::Spent;
use crate::device::{FrameKey, LampState};
use crate::radiometry::exposure::BracketStep;
use crate::units::{Seconds, StageAngles};

/// How a capture ended without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Every planned frame is journalled, every bracket merged.
    Complete,
    /// Stopped as asked; the session can be resumed.
    Interrupted,
}

/// Hears what a capture is doing.
pub trait Observer {
    /// Called between frames; should return soon.
    fn observe(&mut self, progress: Progress<'_>);
    /// A pause was asked for: the lamp is off, the stage stands, every frame is on
    /// the disk. Returns when the capture shall go on.
    fn pause(&mut self) {}
}

/// What a capture is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress<'a> {
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
        /// Its place.
        key: FrameKey,
        /// Exposure.
        exposure: Seconds,
        /// Lamp.
        lamp: LampState,
        /// Part of the whole capture that is done, 0 to 1.
        done: f64,
        /// Estimated time left.
        left: Seconds,
    },
    /// All frames of a light are taken.
    LightDone {
        /// Index in the plan.
        light: u32,
    },
    /// All frames are taken and the lamp is off; the last brackets are being merged.
    Merging,
    /// The capture is over, as far as it went.
    Ended(Spent),
    /// Something that the operator should know; it is journalled too.
    Warning(&'a str),
}

/// How far the capture is, and how long the rest may take.
pub(super) struct Clock {
    pub(super) start: Instant,
    pub(super) done: f64,
    done_at_start: Option<f64>,
}

impl Clock {
    pub(super) fn start() -> Self {
        Self {
            start: Instant::now(),
            done: 0.0,
            done_at_start: None,
        }
    }

    pub(super) fn within_light(&mut self, light: u32, lights: usize, part: f64) {
        self.done = (f64::from(light) + part) / lights as f64;
        self.done_at_start.get_or_insert(self.done);
    }

    /// From the pace so far; from the plan's estimate where there is none yet.
    pub(super) fn left(&self, estimated: Seconds) -> Seconds {
        let gained = self.done - self.done_at_start.unwrap_or(0.0);
        let rest = 1.0 - self.done;
        if gained > 0.02 {
            Seconds(self.start.elapsed().as_secs_f64() / gained * rest)
        } else {
            Seconds(estimated.0 * rest)
        }
    }
}
