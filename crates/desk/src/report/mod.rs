//! The report of a session: one self-contained HTML file that can be read on a
//! phone and printed, with the verdict first.
//!
//! [`write()`] makes a session's report. [`ReportInput`] is plain data, loaded from disk
//! by [`load::load`] or made by a test; [`render`] turns it into the page. Parts that a
//! session does not have (no fit yet, no known truth) are named as missing, never left
//! out silently.

mod budget;
mod captured;
pub mod certificate;
pub mod figures;
pub mod load;
mod map_scale;
pub mod sensor_page;
mod summary;
mod template;
mod value;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use captured::{CapturedInput, SignalToNoise};

use self::load::FitChoice;
use crate::brdf::Brdf;
use crate::plot::PlotError;
use crate::radiance_image::RadianceImage;
use crate::session::commit::SystemDisk;
use crate::session::fit_record::{FitImages, FitRecord};
use crate::session::validation::Validation;
use crate::session::{SessionError, SessionWriter, layout};
use crate::units::{Seconds, StageAngles};
use crate::whole_file;

/// Why a report could not be made.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ReportError {
    /// A figure failed.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// The page's template failed: a defect of the program.
    #[error("report template: {0}")]
    Template(#[from] minijinja::Error),
    /// The session or its fit could not be read.
    #[error(transparent)]
    Load(#[from] load::LoadError),
    /// The page could not be added to the session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The page could not be written elsewhere.
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
}

/// What to report, and where.
#[derive(Clone, Debug)]
pub struct ReportRequest {
    /// The session's folder.
    pub session: PathBuf,
    /// The fit to show; the latest if `None`.
    pub fit: Option<FitChoice>,
    /// The file to write; the session's own `report.html` if `None`.
    pub out: Option<PathBuf>,
}

impl ReportRequest {
    /// The latest fit of a session, reported in the session.
    pub fn of(session: &Path) -> Self {
        Self {
            session: session.to_owned(),
            fit: None,
            out: None,
        }
    }
}

/// A report that was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenReport {
    /// The HTML file.
    pub path: PathBuf,
    /// Whether it shows a fit.
    pub has_fit: bool,
}

/// Writes the report of a session: whole or not at all, journalled where it becomes a
/// file of the session.
///
/// # Errors
/// Anything on disk that is damaged, a fit that the session doesn't have, a figure that
/// could not be drawn, or a file that could not be written.
pub fn write(request: &ReportRequest) -> Result<WrittenReport, ReportError> {
    let input = load::load(&request.session, request.fit.as_ref())?;
    let html = render(&input)?;
    let path = match &request.out {
        Some(path) => {
            let written = whole_file::replace(path, |file| file.write_all(html.as_bytes()));
            written.map_err(|source| ReportError::Io {
                path: path.clone(),
                source,
            })?;
            path.clone()
        }
        None => {
            let mut session = SessionWriter::open(Arc::new(SystemDisk), &request.session)?;
            session.commit_file(layout::REPORT_FILE, html.as_bytes())?;
            session.refresh_manifest()?;
            request.session.join(layout::REPORT_FILE)
        }
    };
    Ok(WrittenReport {
        path,
        has_fit: input.fit.is_some(),
    })
}

/// Everything a report shows.
pub struct ReportInput {
    /// Name of the sample.
    pub sample: String,
    /// Name of the session's folder.
    pub session: String,
    /// When it was captured, for the reader.
    pub captured: String,
    /// Made on a simulated bench.
    pub simulated: bool,
    /// What is unfinished about the capture, if anything.
    pub incomplete: Option<String>,
    /// The lights, in the order of the plan.
    pub lights: Vec<LightInput>,
    /// Radiance of a white diffuser that faces the lamp (R, G, B), where it is known.
    pub diffuser: Option<[f64; 3]>,
    /// The fit to show, if there is one.
    pub fit: Option<FitInput>,
    /// The latest validation, if there is one.
    pub validation: Option<ValidationInput>,
    /// The true material, where it is known.
    pub truth: Option<Truth>,
    /// Spheres under environment maps.
    pub spheres: Vec<SphereInput>,
    /// Where everything comes from, by group.
    pub provenance: Vec<ProvenanceGroup>,
}

/// One light of the session.
pub struct LightInput {
    /// Index in the plan.
    pub index: u32,
    /// Angles of the lamp, as read back, or else as planned.
    pub place: Option<StageAngles>,
    /// What was exposed.
    pub exposures: Vec<ExposureInput>,
    /// The merged image.
    pub captured: Option<CapturedInput>,
}

/// One entry of a light's bracket.
pub struct ExposureInput {
    /// The lamp's channel and its colour; `None` for a lamp of one channel.
    pub lamp: Option<(u8, &'static str)>,
    /// Exposure of one frame.
    pub exposure: Seconds,
    /// Frames averaged.
    pub frames: u32,
}

/// A fit with what is needed to draw it.
#[allow(missing_docs)]
pub struct FitInput {
    /// Its number or folder.
    pub name: String,
    /// What it left on disk.
    pub record: FitRecord,
    pub images: FitImages,
    pub estimate: Arc<dyn Brdf>,
}

/// What was predicted of images that a fit had not seen.
pub struct ValidationInput {
    /// Its number.
    pub number: u32,
    /// The errors.
    pub record: Validation,
    /// The picture (PNG) of each predicted light that has one, with the light's number.
    pub pictures: Vec<(usize, Vec<u8>)>,
}

/// The true material.
#[allow(missing_docs)]
pub struct Truth {
    pub name: String,
    pub brdf: Arc<dyn Brdf>,
}

/// A sphere under one environment map; pixels off the sphere are not `valid`.
pub struct SphereInput {
    /// A matte ball of [`GreyCard`](crate::brdf::sphere::GreyCard)'s reflectance, which sets the exposure.
    pub grey: RadianceImage,
    /// The map's name.
    pub map: String,
    /// With the fitted BRDF.
    pub estimate: RadianceImage,
    /// With the true BRDF, where it is known.
    pub truth: Option<RadianceImage>,
}

/// A table of the provenance.
pub struct ProvenanceGroup {
    /// Its heading.
    pub title: String,
    /// Keys and values, in order.
    pub entries: Vec<(String, String)>,
}

/// The page, as one HTML document without any external resource.
///
/// # Errors
/// A figure or the template failed; the input is never at fault.
pub fn render(input: &ReportInput) -> Result<String, ReportError> {
    template::render(input)
}

#[cfg(test)]
mod tests;
