//! What the program does as functions of the library: fitting a captured session, fitting
//! images of a described scene, measuring how well a stage homes. Each has its own request and result types and reports what
//! happens meanwhile to an [`Observer`]; the command line only parses, shows and advises.
//!
//! ```no_run
//! use std::path::Path;
//! use rig_bench::workflow::{FitRequest, fit_session};
//!
//! let request = FitRequest {
//!     samples_per_cell: Some(256),
//!     ..FitRequest::default()
//! };
//! let outcome = fit_session(Path::new("sessions/red-plastic"), &request, &())?;
//! println!("{:?}: {:?}", outcome.folder, outcome.record.verdict());
//! # Ok::<(), rig_bench::workflow::WorkflowError>(())
//! ```

mod bench_records;
mod cell_images;
#[cfg(target_os = "linux")]
mod closed_loop;
mod error;
mod facets;
mod fit_course;
mod fit_images;
mod fit_memory;
mod fit_plan;
mod fit_run;
mod fit_session;
mod fit_work;
mod image_order;
mod lamp_drift;
mod notice;
#[cfg(target_os = "linux")]
mod repeatability;
mod scene_check;
mod session_images;
mod stated_result;
mod summary;
mod traceability;
mod validate;
mod validate_baselines;
mod validate_keep;
mod validate_pixels;
mod validate_predict;
mod validate_score;
mod warnings;

pub use crate::config::fit::FitRequest;
pub use crate::config::scene_concern::{DescribedIn, SceneConcern, extent_in_image, millimetres};
pub use crate::session::validation::{LeftOut, LightScore, RegionScore, Validation};
pub use bench_records::{BenchRecords, KnownBench, apply_lens, white_radiance};
pub use cell_images::UNSTATED_NOISE;
#[cfg(target_os = "linux")]
pub use closed_loop::{MEASURED_OVER_EXPECTED, QuickFits};
pub use error::WorkflowError;
pub use facets::{coarse_facets, remark_on_facets};
pub use fit_images::{ImageFit, NamedImage, fit_images, fit_images_in_memory};
pub use fit_session::{Expected, expected, fit_session, fit_session_into, work_of};
pub use fit_work::FitWork;
pub use notice::{Notice, Observer};
#[cfg(target_os = "linux")]
pub use repeatability::{Repeatability, measure_repeatability};
pub use scene_check::check_scene;
pub use session_images::{SessionImages, session_images};
pub use stated_result::{StatedResult, StatedResultError};
pub use traceability::{Reference, Traceability};
pub use validate::{
    HoldOut, HoldOutError, LightPrediction, Validated, validate_images, validate_images_in_memory,
    validate_session,
};
pub use validate_keep::{check_keeps_validations, keep_validation, write_validation};

use std::path::PathBuf;

use crate::session::fit_record::FitRecord;

/// A fit that was written.
#[derive(Clone, Debug)]
pub struct FitOutcome {
    /// The folder that holds it.
    pub folder: PathBuf,
    /// What it holds, but its images.
    pub record: FitRecord,
}
