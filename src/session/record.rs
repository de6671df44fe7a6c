//! `session.toml`: what was planned and with what. Written once, before
//! anything moves; a resume needs nothing else.

use serde::{Deserialize, Serialize};

use crate::device::{CameraInfo, LampChannel, StageInfo};
use crate::units::{Seconds, StageAngles};

/// Everything that a capture is decided by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionRecord {
    /// The sample's name.
    pub sample: String,
    /// Start, RFC 3339, UTC.
    pub created_utc: String,
    /// Whether any device was a simulated one.
    pub simulated: bool,
    /// The material that the simulated sample is made of; only on a simulated rig.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub true_material: Option<String>,
    /// Seed of every random stream.
    pub seed: u64,
    /// The rig's configuration by its file or name.
    pub rig: String,
    /// The whole resolved configuration, TOML.
    pub config: String,
    /// Programs and devices.
    pub versions: Versions,
    /// What was captured.
    pub plan: PlanRecord,
    /// Calibration records that were used; copies lie in `calibration/`.
    #[serde(default)]
    pub calibration: Vec<CalibrationCopy>,
}

/// What made the session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Versions {
    /// Of this program.
    pub rig: String,
    /// The camera as found at connection.
    pub camera: CameraInfo,
    /// The stage as found at connection.
    pub stage: StageInfo,
}

/// A calibration record that a session was captured with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationCopy {
    /// What it calibrates, e.g. `sensor`.
    pub id: String,
    /// The copy, relative to the session.
    pub file: String,
    /// Lowercase hexadecimal.
    pub sha256: String,
}

/// The plan of a capture as data: which directions, which exposures are
/// possible, and what decides between them.
///
/// A bracket entry is a (lamp channel, exposure step) pair with the index
/// `channel · steps + step`: the `exposure` of a frame's key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanRecord {
    /// Lamp channels, lit one after the other.
    pub channels: Vec<LampChannel>,
    /// Exposures that may be used, shortest first, seconds.
    pub ladder_s: Vec<Seconds>,
    /// Step of the ladder at which each bracket begins.
    pub pilot_step: u32,
    /// Analogue gain of every frame.
    pub gain: f64,
    /// Signal-to-noise ratio that the sample's dark pixels shall reach.
    pub dark_snr: f64,
    /// Most frames averaged at one exposure, at least 1.
    pub max_repeats: u32,
    /// Frames with the lamp off at each exposure used.
    pub ambient_repeats: u32,
    /// Frames without light at each exposure used; taken once per session and exposure.
    pub dark_repeats: u32,
    /// Wait after a move, seconds.
    pub settle_s: Seconds,
    /// Frames thrown away after a change of the camera's settings, at least.
    pub settings_latency_frames: u32,
    /// Estimated time of the whole capture, seconds.
    pub estimated_s: Seconds,
    /// Estimated size of the raw frames, bytes.
    pub estimated_bytes: u64,
    /// Light directions in the order of capture.
    pub lights: Vec<PlannedLight>,
}

/// One direction of the lamp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedLight {
    /// Where the stage goes.
    #[serde(flatten)]
    pub angles: StageAngles,
}

impl PlanRecord {
    /// Lamp channel and exposure step of a bracket entry; `None` outside the plan.
    pub fn entry(&self, exposure: u32) -> Option<(LampChannel, Seconds)> {
        let steps = u32::try_from(self.ladder_s.len()).ok()?;
        let channel = self.channels.get((exposure.checked_div(steps)?) as usize)?;
        Some((*channel, self.ladder_s[(exposure % steps) as usize]))
    }

    /// Bracket entry of a channel's index and a ladder step.
    pub fn entry_index(&self, channel: usize, step: usize) -> u32 {
        (channel * self.ladder_s.len() + step) as u32
    }
}
