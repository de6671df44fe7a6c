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

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use super::*;
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::config::scene::SceneFile;
    use crate::random::{Purpose, stream};
    use crate::session::fit_record::{PosteriorRecord, example};
    use crate::statistics::normal_cdf;
    use crate::transport::render;
    use crate::workflow::validate_pixels::{compared, of_sample};
    use crate::workflow::validate_score::{Compared, Tally};

    /// Standard deviation of the true albedos around the fitted one, relative to it.
    const DEVIATION: f64 = 0.1;
    const ALBEDO: f64 = 0.5;
    const TRUTHS: usize = 200;

    /// The true albedo of a part of a ball scatters by 10% around the fitted one. Posterior samples
    /// state 10%, three times as much, or a third: the intervals of rendered images cover what
    /// follows from that.
    #[test]
    fn coverage_of_images_is_that_of_the_posterior() {
        let text = "[camera]\nmodel = \"orthographic\"\nresolution_px = [8, 8]\nextent_mm = [0.3, 0.3]\nposition_mm = [0.0, 0.0, 9.0]\n[sample]\nshape = { kind = \"sphere\", radius_mm = 1.0, segments = 96 }\nshading = \"smooth\"\n[[light]]\nkind = \"directional\"\nto_light = [0.3, 0.1, 1.0]\nirradiance = 3.0\n";
        let file = SceneFile::parse("scene.toml", Path::new(""), text).unwrap();
        let scene = file.scene().unwrap();
        let atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
        let dictionary = Arc::new(Dictionary::new("two", atoms).unwrap());
        let material = |albedos: [f64; 3]| {
            let weights = albedos.map(|albedo| vec![albedo, 1.0 - albedo]);
            Material::from(Mixture::new(dictionary.clone(), weights).unwrap())
        };
        let mut numbers = stream(5, Purpose::Experiment, 0, 0, 0);
        let options = RenderOptions {
            samples_per_pixel: 32,
            max_reflections: 1,
            seed: 9,
            ..RenderOptions::default()
        };
        let truths: Vec<RadianceImage> = (0..TRUTHS)
            .map(|_| {
                let albedos = [0; 3].map(|_| ALBEDO * (1.0 + DEVIATION * numbers.normal()));
                render(&scene, &material(albedos), &options).remove(0)
            })
            .collect();
        let sample = of_sample(&scene);

        // Samples of unit deviation exactly.
        let mut drawn: Vec<f64> = (0..SAMPLES).map(|_| numbers.normal()).collect();
        let mean = drawn.iter().sum::<f64>() / SAMPLES as f64;
        drawn.iter_mut().for_each(|z| *z -= mean);
        let square: f64 = drawn.iter().map(|z| z * z).sum();
        let deviation = (square / (SAMPLES - 1) as f64).sqrt();

        for factor in [3.0, 1.0, 1.0 / 3.0] {
            let sampled = |z: &f64| {
                let albedo = (ALBEDO * (1.0 + factor * DEVIATION * z / deviation)) as f32;
                [0, 1, 2].map(|_| vec![albedo, 1.0 - albedo])
            };
            let mut record = example::fit();
            record.settings.max_reflections = 1;
            record.atoms.remove(0);
            record.posterior = Some(PosteriorRecord {
                samples: drawn.iter().map(sampled).collect(),
            });
            let mut predicted = None;
            predict(
                &scene,
                &[0],
                &material([ALBEDO; 3]),
                &record,
                &(),
                |_, of_light| {
                    predicted = Some(of_light);
                    Ok(())
                },
            )
            .unwrap();
            let predicted = predicted.unwrap();
            let mut all = Tally::default();
            for truth in &truths {
                let (pixels, left_out) = compared(&scene, 0, &sample, truth, None);
                all.join(Tally::of(
                    &Compared {
                        pixels: &pixels,
                        left_out,
                        captured: truth,
                        predicted: &predicted.image,
                        deviations: Some(&predicted.deviations),
                        lambertian: [0.0; 3],
                    },
                    &mut None,
                ));
            }
            let score = all.score(1, true);
            let (found, width) = (score.coverage.unwrap(), score.median_half_width.unwrap());
            let expected = 2.0 * normal_cdf(1.96 * factor) - 1.0;
            // Three deviations of the scatter of three albedos of each truth.
            let scatter = (expected * (1.0 - expected) / (3 * TRUTHS) as f64).sqrt();
            println!("{factor:.2}: coverage {found:.3} for {expected:.3}, half width {width:.3}");
            assert!((found - expected).abs() < 3.0 * scatter + 0.005, "{found}");
            let half_width = 1.96 * factor * DEVIATION;
            assert!((width / half_width - 1.0).abs() < 0.05, "{width}");
        }
    }
}
