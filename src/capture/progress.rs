//! How a capture ends, and what it reports meanwhile.

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

/// Is informed of what a capture is doing; `()` ignores it.
pub trait Observer {
    /// Called between frames; should return soon.
    fn observe(&mut self, progress: Progress<'_>);
    /// A pause was requested: the lamp is off, the stage stands, every frame is on
    /// the disk. Returns when the capture shall go on.
    fn pause(&mut self) {}
}

impl Observer for () {
    fn observe(&mut self, _: Progress<'_>) {}
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
    },
    /// How long the rest will take; reported before anything moves, and before every frame.
    Left(Seconds),
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
