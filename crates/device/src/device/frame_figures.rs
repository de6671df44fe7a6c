//! The figures of one raw frame, with the camera and the settings that it was taken by.

use serde::Serialize;

use super::{CameraInfo, CameraSettings, RawFrame};
use crate::radiometry::framing::{Framing, saturation_dn};
use crate::units::Seconds;

/// What helps to frame, focus and expose, as a page or `rig camera preview --json` shows it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct FrameFigures {
    /// Model of the camera.
    pub model: String,
    pub width: u32,
    pub height: u32,
    /// Significant bits of a count.
    pub bit_depth: u32,
    /// Largest count that the bit depth allows, DN.
    pub saturation_dn: u16,
    /// Exposure as the camera applied it; NaN where it cannot be set.
    pub exposure_s: Seconds,
    /// Gain as the camera applied it, a factor.
    pub gain: f64,
    /// The device's running number, where it has one.
    pub sequence: Option<u64>,
    /// Histogram, clipping and sharpness.
    #[serde(flatten)]
    pub framing: Framing,
}

impl FrameFigures {
    /// Of a frame that this camera took with these settings.
    pub fn of(frame: &RawFrame, camera: &CameraInfo, settings: CameraSettings) -> Self {
        let width = frame.width as usize;
        Self {
            model: camera.model.clone(),
            width: frame.width,
            height: frame.height,
            bit_depth: camera.bit_depth,
            saturation_dn: saturation_dn(camera.bit_depth),
            exposure_s: settings.exposure,
            gain: settings.gain,
            sequence: frame.sequence,
            framing: Framing::of(&frame.counts, width, camera.bit_depth, camera.mosaic),
        }
    }
}
