//! Why a capture ended early; facts only.

use crate::device::DeviceError;
use crate::radiometry::exposure::PlanError;
use crate::session::SessionError;
use crate::shown::nth;
use crate::transport::Obstruction;
use crate::units::{StageAngles, size};

/// A capture could not be planned, or did not come to its end.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum CaptureError {
    /// A device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The session could not be written or read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The exposure rules make no sense.
    #[error(transparent)]
    Exposure(#[from] PlanError),
    #[error("{light} ({angles}) is outside the stage's limits ({limits})", light = nth("light", *light))]
    LightOutOfReach {
        light: usize,
        angles: StageAngles,
        limits: String,
    },
    /// Something stands between a planned light and the sample, or between the sample and
    /// the camera.
    #[error("{light} ({angles}): {by}; {}", free_as_text(*free), light = nth("light", *light))]
    LightBlocked {
        light: usize,
        angles: StageAngles,
        by: Obstruction,
        /// The nearest direction that is free: at the same azimuth, or another fixed light.
        free: Option<StageAngles>,
    },
    /// More lights than the stage has distinct directions.
    #[error(
        "{wanted} lights were requested, and the stage reaches {reachable}{}",
        blocked_as_text(*blocked)
    )]
    TooManyLights {
        wanted: usize,
        reachable: usize,
        /// Directions that the stage reaches and the camera's body blocks.
        blocked: usize,
    },
    /// Nothing to capture.
    #[error("the plan has no {what}")]
    Empty {
        /// What is missing, e.g. `light`.
        what: &'static str,
    },
    /// The disk cannot hold the session.
    #[error(
        "the session takes about {} and {} shall remain, but {} has only {} free",
        size(*estimated_bytes), size(*reserve_bytes), folder.display(), size(*free_bytes)
    )]
    NotEnoughSpace {
        folder: std::path::PathBuf,
        estimated_bytes: u64,
        reserve_bytes: u64,
        free_bytes: u64,
    },
    /// The file system cannot hold the session's files.
    #[error(
        "the session takes about {estimated_files} files, \
         but in {folder} only {free_files} more can be made",
        folder = folder.display()
    )]
    NotEnoughFiles {
        folder: std::path::PathBuf,
        estimated_files: u64,
        free_files: u64,
    },
    /// The disk is nearly full in mid-capture.
    #[error(
        "the disk of {} has only {} free, and {} shall remain",
        folder.display(), size(*free_bytes), size(*reserve_bytes)
    )]
    LowDisk {
        folder: std::path::PathBuf,
        free_bytes: u64,
        reserve_bytes: u64,
    },
    /// The lamp is no longer what it was when the light began.
    #[error(
        "the lamp drifted by {change} during {light} (lamp channel {channel}), more than {} %",
        100.0 * super::exposure_check::REFUSED, light = nth("light", *light)
    )]
    LampDrift {
        light: u32,
        channel: u8,
        /// Signal over that of the first frame at the same exposure.
        change: super::exposure_check::SignalRatio,
    },
    #[error(
        "{light}: since the stage was homed anew, the image at the same exposure differs by {:.1} % \
         (root mean square of its pixels, beyond noise), as if the lamp stood roughly {turned_deg:.2}° \
         from where it was; the stage's position_tolerance_deg of {tolerance_deg}° explains {:.1} %",
        100.0 * pattern, 100.0 * explained, light = nth("light", *light)
    )]
    LightMoved {
        light: u32,
        /// Root mean square relative change of the pixels, beyond noise.
        pattern: f64,
        /// Roughly the turn of the light that makes it, degrees.
        turned_deg: f64,
        tolerance_deg: f64,
        /// The most that this makes of `pattern`.
        explained: f64,
    },
    /// After a new homing the signal is not what the light's frames from before lead to
    /// expect, and those cannot show whether the light has moved.
    #[error(
        "{light}: since the stage was homed anew, the images show {ratio:.3} of the signal \
         that the frames before lead to expect", light = nth("light", *light)
    )]
    NotAsBefore { light: u32, ratio: f64 },
    /// The sensor or the lamp has become too hot.
    #[error(
        "{light}: the {part} has {temperature_c:.1} °C, more than the limit of {limit_c} °C", light = nth("light", *light)
    )]
    TooHot {
        light: u32,
        part: crate::device::temperature::Part,
        temperature_c: f64,
        limit_c: f64,
    },
    #[error("the camera's {what} is {found}, the plan was made for {expected}")]
    OtherCamera {
        what: &'static str,
        found: String,
        expected: String,
    },
    #[error(
        "{light}: the exposure is {exposure_s} s by the camera, but the images show \
         {ratio:.3} of the expected signal after {discarded} discarded frames", light = nth("light", *light)
    )]
    ExposureNotApplied {
        light: u32,
        exposure_s: f64,
        ratio: f64,
        /// Frames thrown away while waiting for the change.
        discarded: u32,
    },
    #[error(
        "{light}: the lamp is on by the stage, but the images of {exposure_s} s stay dark", light = nth("light", *light)
    )]
    NoLight { light: u32, exposure_s: f64 },
    #[error(
        "{light}: every pixel of the sample is saturated in the shortest exposure of {exposure_s} s", light = nth("light", *light)
    )]
    AllSaturated { light: u32, exposure_s: f64 },
    /// Merging a bracket failed.
    #[error("{light} could not be merged: {source}", light = nth("light", *light))]
    Merge {
        light: u32,
        source: super::disk::SinkError,
    },
    /// The lights so far do not tell which one follows.
    #[error("the next light cannot be chosen: {source}")]
    Choice { source: super::disk::SinkError },
    /// The journalled frames lead to other decisions than the ones recorded.
    #[error("frame {frame} in the session was taken with {found}, the plan leads to {expected}")]
    OtherFrame {
        frame: String,
        found: String,
        expected: String,
    },
    #[error("cannot start a thread: {0}")]
    Thread(#[source] std::io::Error),
    /// A device's or the disk's thread ended unexpectedly.
    #[error("the {name} thread ended unexpectedly")]
    WorkerGone { name: &'static str },
    /// The lamp may still be on, and the stage may still move.
    #[error("the stage did not confirm that it stopped ({source}), after: {cause}")]
    NotStopped { cause: String, source: DeviceError },
    /// The operator asked once.
    #[error("stopped after a frame as asked")]
    Interrupted,
    /// The operator asked twice, or once while the stage was moving or settling:
    /// motion and lamp were stopped at once.
    #[error("stopped at once")]
    StoppedNow,
}

fn free_as_text(free: Option<StageAngles>) -> String {
    match free {
        Some(angles) => format!("the nearest free direction is {angles}"),
        None => "no direction near it is free".to_owned(),
    }
}

fn blocked_as_text(blocked: usize) -> String {
    match blocked {
        0 => String::new(),
        blocked => format!(" that the camera's body does not block ({blocked} are blocked)"),
    }
}
