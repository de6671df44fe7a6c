//! Images of lights that were not fitted, with the standard deviation that the posterior samples
//! give them.

use crate::brdf::discrepancy::{Discrepancy, Material};
use crate::brdf::{Brdf, BrdfError, Mixture};
use crate::inverse::Fit;
use crate::progress::Progress;
use crate::radiance_image::RadianceImage;
use crate::transport::{RenderOptions, Scene, Steering, render_with_progress, suited_proposal};

/// Posterior samples that are rendered: their standard deviation is then known within 18%.
pub(super) const SAMPLES: usize = 16;
/// Paths per pixel of the prediction.
const PATHS: u32 = 32;
/// Most paths per pixel of a posterior sample, and paths of all of them together: a scatter
/// over the same random numbers needs few.
const PATHS_OF_SAMPLE: u32 = 16;
const PATHS_OF_ALL: usize = 10_000_000;

/// The predicted image of each light of a scene.
pub(super) struct Predicted {
    /// Radiance, and the variance of the paths' mean.
    pub images: Vec<RadianceImage>,
    /// Standard deviation over the posterior samples, per light and pixel, R, G, B.
    pub deviations: Vec<Vec<[f32; 3]>>,
    /// Posterior samples that were rendered; 0 where the fit has none.
    pub samples: usize,
}

/// Predicts the images of all lights of `scene`.
///
/// # Errors
/// Samples that are no mixture; none of a fit.
pub(super) fn predict(
    scene: &Scene,
    fit: &Fit,
    max_reflections: u32,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Predicted, BrdfError> {
    let mut options = RenderOptions {
        samples_per_pixel: PATHS,
        max_reflections,
        seed,
        steering: Steering::default(),
        ..RenderOptions::default()
    };
    options.proposal = suited_proposal(scene, &fit.material, &options);
    let images = render_with_progress(scene, &fit.material, &options, progress);

    // Common random numbers: one seed and one proposal for all samples.
    let samples = materials(fit)?;
    let per_pixel = PATHS_OF_ALL / (scene.camera.pixels() * samples.len().max(1));
    options.samples_per_pixel = (per_pixel as u32).clamp(2, PATHS_OF_SAMPLE);
    let pixels = scene.camera.pixels();
    let mut moments = vec![vec![[[0.0f64; 2]; 3]; pixels]; scene.lights.len()];
    for sample in &samples {
        let images = render_with_progress(scene, sample as &dyn Brdf, &options, progress);
        for (moments, image) in moments.iter_mut().zip(&images) {
            for (moments, mean) in moments.iter_mut().zip(&image.mean) {
                for ([sum, squares], &value) in moments.iter_mut().zip(mean) {
                    *sum += f64::from(value);
                    *squares += f64::from(value) * f64::from(value);
                }
            }
        }
    }
    let n = samples.len() as f64;
    let deviation = |[sum, squares]: [f64; 2]| match samples.len() {
        0 | 1 => 0.0,
        _ => ((squares - sum * sum / n) / (n - 1.0)).max(0.0).sqrt() as f32,
    };
    let of_light = |light: Vec<[[f64; 2]; 3]>| light.iter().map(|p| p.map(deviation)).collect();
    Ok(Predicted {
        images,
        deviations: moments.into_iter().map(of_light).collect(),
        samples: samples.len(),
    })
}

/// Materials by up to [`SAMPLES`] posterior samples, evenly spread over the chain.
fn materials(fit: &Fit) -> Result<Vec<Material>, BrdfError> {
    let groups = &fit.posterior_samples;
    let drawn = groups.iter().map(|group| group.posterior.len()).min();
    let drawn = drawn.unwrap_or(0);
    let count = SAMPLES.min(drawn);
    let dictionary = fit.material.mixture.dictionary();
    let of_sample = |k: usize| {
        let at = k * drawn / count;
        let group = |c: usize| &groups[c.min(groups.len() - 1)];
        let weights = [0, 1, 2].map(|c| group(c).posterior[at].as_slice().to_vec());
        let mixture = Mixture::new(dictionary.clone(), weights)?;
        let discrepancies = [0, 1, 2].map(|c| {
            let given = group(c).discrepancies.get(at);
            given.cloned().unwrap_or_else(Discrepancy::none)
        });
        Ok(Material::new(mixture, &discrepancies))
    };
    (0..count).map(of_sample).collect()
}
