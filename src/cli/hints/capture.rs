//! Advice on opening devices and preparing a capture.

use crate::capture::findings::PrepareError;
use crate::capture::open::OpenError;
use crate::cli::preflight;

pub(super) fn for_open(error: &OpenError) -> Option<String> {
    Some(match error {
        OpenError::Mosaic { .. } => "correct camera.mosaic or camera.format in the rig file".into(),
        OpenError::NoSerial => "build it with the feature `serial`".into(),
        OpenError::NoVideo4Linux => "build it with the feature `v4l`".into(),
        OpenError::Device(_)
        | OpenError::Scene(_)
        | OpenError::Simulated { .. }
        | OpenError::NoOperator => return None,
    })
}

pub(super) fn for_prepare(error: &PrepareError) -> Option<String> {
    Some(match error {
        PrepareError::View(concern) | PrepareError::Unlit { concern, .. } => {
            preflight::remedy_of(concern)
        }
        PrepareError::SceneFile(_) => {
            "`mesh`, `table` and `weights` in the rig file are relative to that file".into()
        }
        PrepareError::NoSensorRecord { .. } => {
            "run `rig calibrate sensor`, once for each camera and gain".into()
        }
        PrepareError::SameLight { .. } => {
            "name each direction once; how well a light repeats, `rig stage repeatability` tells"
                .into()
        }
        PrepareError::Resolution { .. } => {
            "correct camera.resolution_px in the rig file; `rig camera info` shows what the camera offers".into()
        }
        PrepareError::LightChoice(_) => {
            "a plain number after --lights spreads the lights evenly".into()
        }
        PrepareError::NoFit { .. } => {
            "`rig fit SESSION` makes one; before a capture, `rig capture --lights best:N` chooses"
                .into()
        }
        _ => return None,
    })
}
