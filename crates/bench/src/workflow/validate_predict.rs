//! Images of lights that were not fitted, with the standard deviation that the posterior samples
//! give them.

use super::WorkflowError;
use crate::brdf::discrepancy::Material;
use crate::progress::{OnePhase, Progress};
use crate::radiance_image::RadianceImage;
use crate::rendering::deviations;
use crate::session::fit_record::FitRecord;
use crate::transport::{RenderOptions, Scene, Steering, render_with_progress, suited_proposal};

/// Posterior samples that are rendered: their standard deviation is then known within 18%.
const SAMPLES: usize = 16;
/// Paths per pixel of the prediction at most, and of all pixels together if that leaves two.
const PATHS: u32 = 32;
const PATHS_OF_ALL: usize = 40_000_000;

/// Lights that are rendered at a time: the paths are traced once for all of them, and their
/// images are in memory together.
const AT_A_TIME: usize = 8;

/// The predicted image of a light.
pub(super) struct Predicted {
    /// Radiance, and the variance of the paths' mean.
    pub image: RadianceImage,
    /// Standard deviation over the posterior samples, per pixel, R, G, B.
    pub deviations: Vec<[f32; 3]>,
}

/// Predicts the image of each of these lights of a scene and hands it out, in their order.
/// Posterior samples that were rendered; 0 where the fit has none.
///
/// # Errors
/// Samples that are no mixture; none of a fit; those of `each`.
pub(super) fn predict(
    scene: &Scene,
    lights: &[usize],
    material: &Material,
    record: &FitRecord,
    progress: &dyn Progress,
    mut each: impl FnMut(usize, Predicted) -> Result<(), WorkflowError>,
) -> Result<usize, WorkflowError> {
    let samples = record.sampled_materials(SAMPLES)?;
    let pixels = scene.camera.pixels();
    let mut options = RenderOptions {
        samples_per_pixel: ((PATHS_OF_ALL / pixels.max(1)) as u32).clamp(2, PATHS),
        max_reflections: record.settings.max_reflections,
        seed: record.settings.seed,
        steering: Steering::default(),
        ..RenderOptions::default()
    };
    options.proposal = suited_proposal(&under(scene, lights), material, &options);
    let rows = scene.camera.resolution_px[1] * (1 + samples.len());
    let steps = rows * lights.len().div_ceil(AT_A_TIME);
    let progress = &OnePhase::begun(progress, "predicting", steps);
    for lights in lights.chunks(AT_A_TIME) {
        let part = under(scene, lights);
        let images = render_with_progress(&part, material, &options, progress);
        let deviations = deviations(&part, &samples, &options, progress);
        for ((&light, image), deviations) in lights.iter().zip(images).zip(deviations) {
            each(light, Predicted { image, deviations })?;
        }
    }
    Ok(samples.len())
}

/// The scene under some of its lights alone.
pub(super) fn under(scene: &Scene, lights: &[usize]) -> Scene {
    let mut part = scene.clone();
    part.lights = lights.iter().map(|&light| scene.lights[light]).collect();
    let falloffs = lights
        .iter()
        .filter_map(|&light| scene.falloffs.get(light).cloned());
    part.falloffs = falloffs.collect();
    part
}
