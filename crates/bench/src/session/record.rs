//! `session.toml`: what was planned and with what. Written once, before
//! anything moves; a resume needs nothing else.

use std::ops::RangeInclusive;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::SessionError;
use super::decision::Until;
use crate::device::temperature::TemperatureLimits;
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
    /// What the operator has noted of the sample's material.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// What the operator has noted otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub comment: Option<String>,
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

impl SessionRecord {
    /// Whether a capture can be carried out by it: each value in the range that a rig
    /// file allows, whoever wrote the file.
    pub(super) fn check(&self, file: &Path) -> Result<(), SessionError> {
        let plan = &self.plan;
        let rules = &plan.exposure;
        let refused = |key: &str, value: String, allowed: String| SessionError::Value {
            path: file.to_owned(),
            key: format!("plan.{key}"),
            value,
            allowed,
        };
        // Numbers within a range.
        let ranges: [(&str, f64, RangeInclusive<f64>); 16] = [
            ("gain", plan.gain, 1.0..=1000.0),
            ("settle_s", plan.settle_s.0, 0.0..=60.0),
            ("lamp_settle_s", plan.lamp_settle_s.0, 0.0..=60.0),
            ("lamp_warm_up_s", plan.lamp_warm_up_s.0, 0.0..=7200.0),
            (
                "settings_latency_frames",
                plan.settings_latency_frames.into(),
                0.0..=32.0,
            ),
            ("estimated_s", plan.estimated_s.0, 0.0..=f64::MAX),
            ("limits.margin_c", plan.limits.margin_c, 0.0..=50.0),
            ("exposure.shortest_s", rules.shortest_s.0, 1e-9..=1000.0),
            (
                "exposure.longest_s",
                rules.longest_s.0,
                rules.shortest_s.0..=1000.0,
            ),
            ("exposure.pilot_s", rules.pilot_s.0, 1e-9..=1000.0),
            ("exposure.step_s", rules.step_s.0, 0.0..=1000.0),
            ("exposure.peak_fraction", rules.peak_fraction, 0.1..=0.95),
            ("exposure.dark_snr", rules.dark_snr, 1.0..=1e4),
            ("exposure.ratio", rules.ratio, 1.2..=64.0),
            ("exposure.max_frames", rules.max_frames.into(), 1.0..=4096.0),
            (
                "exposure.dark_frames",
                rules.dark_frames.into(),
                0.0..=1024.0,
            ),
        ];
        for (key, value, range) in ranges {
            // Neither contains a value that is no number.
            if !range.contains(&value) {
                let allowed = format!("{} to {}", range.start(), range.end());
                return Err(refused(key, value.to_string(), allowed));
            }
        }
        // Angles, temperatures, channels.
        for (index, light) in plan.lights.iter().enumerate() {
            if !(light.azimuth_deg.is_finite() && light.elevation_deg.is_finite()) {
                let key = format!("lights[{index}]");
                return Err(refused(&key, light.to_string(), "two finite angles".into()));
            }
        }
        for (key, limit_c) in [
            ("limits.sensor_c", plan.limits.sensor_c),
            ("limits.lamp_c", plan.limits.lamp_c),
        ] {
            if let Some(limit_c) = limit_c.filter(|limit_c| !limit_c.is_finite()) {
                return Err(refused(key, limit_c.to_string(), "finite".into()));
            }
        }
        if plan.channels.is_empty() {
            return Err(refused(
                "channels",
                "[]".into(),
                "at least one lamp channel".into(),
            ));
        }
        Ok(())
    }
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

/// The plan of a capture as data: which directions, and the rules by which each
/// bracket's exposures are chosen from pilot frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanRecord {
    /// Lamp channels, lit one after the other.
    pub channels: Vec<LampChannel>,
    /// Analogue gain of every frame.
    pub gain: f64,
    /// Exposures and averaging.
    pub exposure: ExposureRules,
    /// Wait after a move, seconds.
    pub settle_s: Seconds,
    /// Wait after the lamp was switched, seconds.
    pub lamp_settle_s: Seconds,
    /// Wait with the lamp on before the first light of a run, seconds.
    pub lamp_warm_up_s: Seconds,
    /// Frames thrown away after a change of the camera's settings, at least.
    pub settings_latency_frames: u32,
    /// Whether the first light is visited again after the last one, against drift of the lamp.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub revisit_first: bool,
    /// How far the stage may stand from where it was sent, degrees: what a second visit of a
    /// light may make of its signal is part of a comparison's uncertainty.
    #[serde(default)]
    pub stage_tolerance_deg: f64,
    /// Temperatures above which the capture is suspended.
    #[serde(default, skip_serializing_if = "TemperatureLimits::is_none")]
    pub limits: TemperatureLimits,
    /// Estimated time of the whole capture for a scene of usual contrast, seconds.
    pub estimated_s: Seconds,
    /// Estimated size of the session for a scene of usual contrast, bytes.
    pub estimated_bytes: u64,
    /// Estimated number of its files; not kept.
    #[serde(skip)]
    pub estimated_files: u64,
    /// When it has enough lights, where the others are chosen as it goes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Until>,
    /// Light directions in the order of capture.
    pub lights: Vec<StageAngles>,
}

impl PlanRecord {
    /// Lights that the capture has at most.
    pub fn most_lights(&self) -> usize {
        let bound = self.until.map_or(0, |until| until.max_lights as usize);
        self.lights.len().max(bound)
    }
}

/// What decides the exposures of a bracket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureRules {
    /// Exposure of the first pilot frames, seconds.
    pub pilot_s: Seconds,
    /// The camera's shortest exposure, seconds.
    pub shortest_s: Seconds,
    /// The longest exposure of one frame that may be used, seconds.
    pub longest_s: Seconds,
    /// Step of the camera's exposures, seconds.
    pub step_s: Seconds,
    /// Part of the usable range that the brightest pixel of the sample may reach
    /// in the shortest exposure, (0, 1).
    pub peak_fraction: f64,
    /// Signal-to-noise ratio that the sample's dark pixels shall reach.
    pub dark_snr: f64,
    /// Largest ratio of neighbouring exposures, > 1.
    pub ratio: f64,
    /// Most frames averaged at one exposure, at least 1.
    pub max_frames: u32,
    /// Whether as many frames with the lamp off as with it are taken at each exposure.
    pub ambient: bool,
    /// Frames without any light at each exposure, where the camera has a shutter.
    pub dark_frames: u32,
}
