//! What is found while a capture is prepared: facts worth a remark, and those that refuse it.

use std::path::PathBuf;

use super::CaptureError;
use super::open::OpenError;
use crate::brdf::BrdfError;
use crate::calibration::RecordError;
use crate::calibration::depth_of_field::DepthOfField;
use crate::calibration::fitness::Concern;
use crate::calibration::noise::NoiseError;
use crate::calibration::record::Kind;
use crate::config::BuildError;
use crate::config::ConfigError;
use crate::geometry::FileRemark;
use crate::session::SceneFileError;
use crate::session::SessionError;
use crate::session::fit_record::FitRecordError;
use crate::transport::cache::CacheError;
use crate::transport::visibility::{self, Visibility};
use crate::units::StageAngles;

/// Something worth a remark before a capture; it does not refuse it.
#[derive(Debug)]
pub enum Notice<'a> {
    /// A calibration record that should be measured anew.
    Record {
        /// Which kind of record.
        kind: Kind,
        /// Why.
        concern: Concern,
    },
    /// A record that was measured with the sensor warmer or colder.
    Temperature(Concern),
    /// The lamp takes longer to warm up than the rig file waits.
    WarmUp {
        /// By the lamp's record, seconds.
        needed_s: f64,
        /// `capture.lamp_warm_up_s`, seconds.
        stated_s: f64,
    },
    /// Something about the files that describe the scene.
    File(&'a FileRemark),
    /// A part of the sample is not seen.
    View {
        /// Which.
        concern: &'a visibility::Concern,
        /// What the camera sees.
        seen: &'a Visibility,
    },
    /// The lens blurs a part of the sample by more than `capture.blur_limit_px`.
    Blur {
        /// How far.
        blur: DepthOfField,
        /// `capture.blur_limit_px`, pixels.
        limit_px: f64,
    },
    /// Planned lights that shine towards the camera: more than 90° from its axis, as seen from
    /// the sample.
    TowardsLens {
        /// Their places in the plan, their directions and their angles to the camera's axis,
        /// degrees.
        lights: Vec<(usize, StageAngles, f64)>,
    },
    /// So many light directions are compared now, which takes a while.
    Comparing {
        /// How many.
        directions: usize,
    },
}

/// Why a capture cannot begin. Nothing has moved, and no session was written.
#[derive(Debug, thiserror::Error)]
pub enum PrepareError {
    /// The plan.
    #[error("{0}")]
    Capture(#[from] CaptureError),
    /// The devices.
    #[error("{0}")]
    Open(#[from] OpenError),
    /// The session's folder.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// The rig file that a session holds.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// The scene.
    #[error("{0}")]
    Scene(#[from] BuildError),
    /// A file that describes the scene, to be copied into the session.
    #[error("{0}")]
    SceneFile(#[from] SceneFileError),
    /// A calibration record.
    #[error("{0}")]
    Record(#[from] RecordError),
    /// A map of the sensor.
    #[error("{0}")]
    Noise(#[from] NoiseError),
    /// The sensor's noise is not known.
    #[error("there is no sensor record in {searched}")]
    NoSensorRecord {
        /// Where it was looked for.
        searched: String,
    },
    /// The camera does not see the front of the sample.
    #[error("{concern}")]
    View {
        /// What is wrong.
        concern: visibility::Concern,
        /// What the camera sees.
        seen: Box<Visibility>,
    },
    /// A planned light reaches nothing of what the camera sees.
    #[error("{concern} ({angles})")]
    Unlit {
        /// What is wrong.
        concern: visibility::Concern,
        /// The light's direction.
        angles: StageAngles,
        /// What the camera sees.
        seen: Box<Visibility>,
    },
    /// A direction that is listed twice: its light would count as two.
    #[error("the light direction {first} is named twice{}", spelled_otherwise(*first, *second))]
    SameLight {
        /// First.
        first: StageAngles,
        /// Again.
        second: StageAngles,
    },
    /// The camera's frames have another size.
    #[error(
        "the camera gives frames of {} x {}, the rig file states {} x {}",
        is[0], is[1], stated[0], stated[1]
    )]
    Resolution {
        /// Of the camera, pixels.
        is: [u32; 2],
        /// Of the rig file, pixels.
        stated: [u32; 2],
    },
    /// The dictionary that light directions are compared with.
    #[error("{0}")]
    Dictionary(#[from] BrdfError),
    /// Light directions cannot be compared for this dictionary or scene.
    #[error("{0}")]
    LightSelection(#[source] CacheError),
    /// A session's fit.
    #[error("{0}")]
    Fit(#[from] FitRecordError),
    /// A session that was not fitted yet.
    #[error("{} holds no fit", session.display())]
    NoFit {
        /// Its folder.
        session: PathBuf,
    },
}

fn spelled_otherwise(first: StageAngles, second: StageAngles) -> String {
    match first == second {
        true => String::new(),
        false => format!(", also as {second}"),
    }
}
