//! Images of lights that were not fitted, with the standard deviation that the posterior samples
//! give them.

use crate::brdf::BrdfError;
use crate::brdf::discrepancy::Material;
use crate::progress::Progress;
use crate::radiance_image::RadianceImage;
use crate::rendering::deviations;
use crate::session::fit_record::FitRecord;
use crate::transport::{RenderOptions, Scene, Steering, render_with_progress, suited_proposal};

/// Posterior samples that are rendered: their standard deviation is then known within 18%.
const SAMPLES: usize = 16;
/// Paths per pixel of the prediction at most, and of all pixels together if that leaves two.
const PATHS: u32 = 32;
const PATHS_OF_ALL: usize = 40_000_000;

/// The predicted image of each light of a scene.
pub(super) struct Predicted {
    /// Radiance, and the variance of the paths' mean.
    pub images: Vec<RadianceImage>,
    /// Standard deviation over the posterior samples, per light and pixel, R, G, B.
    pub deviations: Vec<Vec<[f32; 3]>>,
    /// Posterior samples that were rendered; 0 where the fit has none.
    pub samples: usize,
}

/// One phase, whatever is rendered in it.
struct OnePhase<'a>(&'a dyn Progress);

impl Progress for OnePhase<'_> {
    fn advance(&self, rows: usize) {
        self.0.advance(rows);
    }

    fn pulse(&self) {
        self.0.pulse();
    }
}

/// Predicts the images of all lights of `scene`.
///
/// # Errors
/// Samples that are no mixture; none of a fit.
pub(super) fn predict(
    scene: &Scene,
    material: &Material,
    record: &FitRecord,
    progress: &dyn Progress,
) -> Result<Predicted, BrdfError> {
    let samples = record.sampled_materials(SAMPLES)?;
    let pixels = scene.camera.pixels();
    let mut options = RenderOptions {
        samples_per_pixel: ((PATHS_OF_ALL / pixels.max(1)) as u32).clamp(2, PATHS),
        max_reflections: record.settings.max_reflections,
        seed: record.settings.seed,
        steering: Steering::default(),
        ..RenderOptions::default()
    };
    options.proposal = suited_proposal(scene, material, &options);
    let rows = scene.camera.resolution_px[1] * (1 + samples.len());
    progress.begin("predicting", Some(rows));
    let progress = &OnePhase(progress);
    Ok(Predicted {
        images: render_with_progress(scene, material, &options, progress),
        deviations: deviations(scene, &samples, &options, progress),
        samples: samples.len(),
    })
}
