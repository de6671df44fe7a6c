//! What is found while a capture is prepared: facts worth a remark, and those that refuse it.

use std::fmt;
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
use crate::config::scene_concern::SceneConcern;
use crate::geometry::FileRemark;
use crate::inverse::expected_error::PredictionError;
use crate::session::SceneFileError;
use crate::session::SessionError;
use crate::session::fit_record::FitRecordError;
use crate::shown::nth;
use crate::units::StageAngles;

/// Something worth a remark before a capture; it does not refuse it.
#[derive(Debug)]
#[allow(missing_docs)]
pub enum Notice<'a> {
    /// A calibration record that should be measured anew.
    Record { kind: Kind, concern: Concern },
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
    View(&'a SceneConcern),
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
    Comparing { directions: usize },
}

impl fmt::Display for Notice<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Record { kind, concern } => write!(out, "{}: {concern}", kind.folder()),
            Self::Temperature(concern) => concern.fmt(out),
            Self::WarmUp { needed_s, stated_s } => write!(
                out,
                "lamp: it takes {needed_s:.0} s to warm up, and capture.lamp_warm_up_s is {stated_s:.0}"
            ),
            Self::File(remark) => remark.fmt(out),
            Self::View(concern) => concern.fmt(out),
            Self::Blur { blur, limit_px } => {
                write!(out, "depth of field: {}", blur.concern(*limit_px))
            }
            Self::TowardsLens { lights } => {
                let each = lights.iter().map(|(light, angles, off_deg)| {
                    format!("{} ({angles}) {off_deg:.0}°", nth("light", *light))
                });
                write!(
                    out,
                    "lights from behind the sample, by their angle to the camera's axis: {}",
                    each.collect::<Vec<_>>().join(", ")
                )
            }
            Self::Comparing { directions } => {
                write!(out, "comparing {directions} light directions")
            }
        }
    }
}

/// Why a capture cannot begin. Nothing has moved, and no session was written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
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
    NoSensorRecord { searched: String },
    /// The camera does not see the front of the sample.
    #[error("{0}")]
    View(#[from] Box<SceneConcern>),
    /// A planned light reaches nothing of what the camera sees.
    #[error("{concern} ({angles})")]
    Unlit {
        concern: Box<SceneConcern>,
        angles: StageAngles,
    },
    /// A direction that is listed twice: its light would count as two.
    #[error("the light direction {first} is named twice{}", spelled_otherwise(*first, *second))]
    SameLight {
        first: StageAngles,
        second: StageAngles,
    },
    #[error(
        "the camera gives frames of {} x {}, the rig file states {} x {}",
        is[0], is[1], stated[0], stated[1]
    )]
    Resolution { is: [u32; 2], stated: [u32; 2] },
    /// The dictionary that light directions are compared with.
    #[error("{0}")]
    Dictionary(#[from] BrdfError),
    /// Light directions cannot be compared for this scene.
    #[error("{0}")]
    LightChoice(#[from] PredictionError),
    /// A session's fit.
    #[error("{0}")]
    Fit(#[from] FitRecordError),
    /// A session that was not fitted yet.
    #[error("{} holds no fit", session.display())]
    NoFit { session: PathBuf },
}

fn spelled_otherwise(first: StageAngles, second: StageAngles) -> String {
    match first == second {
        true => String::new(),
        false => format!(", also as {second}"),
    }
}
