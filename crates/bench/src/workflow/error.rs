//! Why a workflow failed; facts only.

use std::path::PathBuf;

use super::{HoldOutError, SceneConcern};
use crate::brdf::BrdfError;
use crate::brdf::projection::ProjectionError;
use crate::calibration::RecordError;
use crate::cells::AverageError;
use crate::config::BuildError;
use crate::config::ConfigError;
use crate::inverse::FitError;
use crate::inverse::memory::TooLittleMemory;
use crate::plausibility::Implausible;
use crate::radiance_image::exr::ExrError;
use crate::session::SessionError;
use crate::session::fit_record::FitRecordError;
use crate::transport::Kernel;

/// A workflow could not be carried out. A wrapped error shows its own text and is the
/// `source`.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum WorkflowError {
    /// The session cannot be read or written.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// A calibration record cannot be used.
    #[error("{0}")]
    Record(#[from] RecordError),
    /// A rig or scene file cannot be used.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// The scene cannot be built.
    #[error("{0}")]
    Build(#[from] BuildError),
    /// A dictionary or material cannot be used.
    #[error("{0}")]
    Brdf(#[from] BrdfError),
    /// An image cannot be read.
    #[error("{0}")]
    Image(#[from] ExrError),
    /// A merged image of a session is missing, damaged or cannot be read.
    #[error("{source}")]
    MergedImage {
        session: PathBuf,
        source: Box<WorkflowError>,
    },
    /// The mask cannot be used.
    #[error("{}: {fact}", path.display())]
    Mask { path: PathBuf, fact: String },
    /// The camera doesn't see the sample, or the lights don't reach it.
    #[error("{0}")]
    Scene(#[from] Box<SceneConcern>),
    /// The images cannot be averaged over the scene's cells.
    #[error("{0}")]
    Average(#[from] AverageError),
    /// No pixel of an image can be compared.
    #[error("{file}: {source}{}", masked(mask))]
    NothingValid {
        file: String,
        source: AverageError,
        /// The mask and the part of the image that it leaves, percent.
        mask: Option<(PathBuf, f64)>,
    },
    /// The images cannot be those of the scene.
    #[error("{}{source}", file.as_ref().map_or(String::new(), |file| format!("{file}: ")))]
    Implausible {
        file: Option<String>,
        source: Implausible,
    },
    #[error("this processor lacks what kernel {0} needs")]
    Kernel(Kernel),
    #[error("it is stated how well the bench is known, but the bench is not refined")]
    UnusedUncertainty,
    /// The fit needs more memory than it may have.
    #[error("{0}")]
    Memory(#[from] TooLittleMemory),
    /// The fit failed.
    #[error("{0}")]
    Fit(#[from] FitError),
    /// Lights that cannot be divided into those that are fitted and those that are predicted.
    #[error("{0}")]
    HoldOut(#[from] HoldOutError),
    /// The fit cannot be compared with the truth.
    #[error("{0}")]
    Score(#[from] ProjectionError),
    /// The fit cannot be written or read.
    #[error("{0}")]
    FitRecord(#[from] FitRecordError),
}

fn masked(mask: &Option<(PathBuf, f64)>) -> String {
    let described = mask.as_ref().map(|(path, percent)| {
        let path = path.display();
        format!("; mask {path} leaves {percent:.1}% of it")
    });
    described.unwrap_or_default()
}
