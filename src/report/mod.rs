//! The report of a session: one self-contained HTML file that can be read on a
//! phone and printed, with the verdict first.
//!
//! [`ReportInput`] is plain data, loaded from disk by [`load::load`] or made by a
//! test; [`render`] turns it into the page. Parts that a session does not have
//! (no fit yet, no known truth) are said to be missing, never left out silently.

mod budget;
mod captured;
pub mod figures;
pub mod images;
pub mod load;
pub mod plots;
mod summary;
mod template;

use std::sync::Arc;

pub use captured::{CapturedInput, SignalToNoise};

use crate::brdf::Brdf;
use crate::radiance_image::RadianceImage;
use crate::session::fit_record::{FitImages, FitRecord};
use crate::units::{Seconds, StageAngles};

/// Why a report could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A figure failed.
    #[error(transparent)]
    Plot(#[from] plots::PlotError),
    /// The page's template failed: a defect of the program.
    #[error("report template: {0}")]
    Template(#[from] minijinja::Error),
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
    /// The fit to show, if there is one.
    pub fit: Option<FitInput>,
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
    /// Where the lamp stood, as read back, or else as planned.
    pub place: Option<StageAngles>,
    /// What was exposed.
    pub exposures: Vec<ExposureInput>,
    /// The merged image.
    pub captured: Option<CapturedInput>,
}

/// One entry of a light's bracket.
pub struct ExposureInput {
    /// The lamp's channel; `None` for a lamp of one colour.
    pub lamp_channel: Option<u8>,
    /// Exposure of one frame.
    pub exposure: Seconds,
    /// Frames averaged.
    pub frames: u32,
}

/// A fit with what is needed to draw it.
pub struct FitInput {
    /// Its number or folder.
    pub name: String,
    /// What it left on disk.
    pub record: FitRecord,
    /// Its images.
    pub images: FitImages,
    /// The fitted BRDF.
    pub estimate: Arc<dyn Brdf>,
}

/// The true material.
pub struct Truth {
    /// Its name.
    pub name: String,
    /// Its BRDF.
    pub brdf: Arc<dyn Brdf>,
}

/// A sphere under one environment map; pixels off the sphere are not `valid`.
pub struct SphereInput {
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
