//! How far the images of a material scatter over its posterior samples.

use crate::brdf::discrepancy::Material;
use crate::progress::Progress;
use crate::transport::{RenderOptions, Scene, render_with_progress};

/// Most paths per pixel of a sample, and paths of all samples together: a scatter over the same
/// random numbers needs few.
const PATHS_OF_SAMPLE: u32 = 16;
const PATHS_OF_ALL: usize = 10_000_000;

/// Standard deviation of the radiance over `samples`, per light and pixel, R, G, B; 0 for fewer
/// than two. All samples are rendered with the random numbers, longest path and proposal of
/// `options`; the paths per pixel are 2 to 16, of all together ten million if that suffices.
///
/// The progress has the rows of pixels of each sample as its steps.
pub fn deviations(
    scene: &Scene,
    samples: &[Material],
    options: &RenderOptions,
    progress: &dyn Progress,
) -> Vec<Vec<[f32; 3]>> {
    let pixels = scene.camera.pixels();
    let per_pixel = PATHS_OF_ALL / (pixels * samples.len()).max(1);
    let options = RenderOptions {
        samples_per_pixel: (per_pixel as u32).clamp(2, PATHS_OF_SAMPLE),
        ..options.clone()
    };
    // By the updates of Welford, which lose no digits where the scatter is small.
    let mut moments = vec![vec![[[0.0f32; 2]; 3]; pixels]; scene.lights.len()];
    for (k, sample) in samples.iter().enumerate() {
        let images = render_with_progress(scene, sample, &options, progress);
        for (moments, image) in moments.iter_mut().zip(&images) {
            for (moments, value) in moments.iter_mut().zip(&image.mean) {
                for ([mean, squares], &value) in moments.iter_mut().zip(value) {
                    let from_mean = value - *mean;
                    *mean += from_mean / (k + 1) as f32;
                    *squares += from_mean * (value - *mean);
                }
            }
        }
    }
    let degrees = samples.len().saturating_sub(1).max(1) as f32;
    let deviation = |[_, squares]: [f32; 2]| (squares / degrees).max(0.0).sqrt();
    let of_light = |light: Vec<[[f32; 2]; 3]>| light.iter().map(|p| p.map(deviation)).collect();
    moments.into_iter().map(of_light).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::config::scene::SceneFile;
    use std::path::Path;
    use std::sync::Arc;

    /// The radiance of a flat white of albedo ρ under irradiance E is ρ E / π, so that its
    /// scatter is that of ρ.
    #[test]
    fn the_scatter_of_albedos_is_that_of_the_radiance() {
        let text = "[camera]\nmodel = \"orthographic\"\nresolution_px = [8, 8]\nextent_mm = [0.2, 0.2]\nposition_mm = [0.0, 0.0, 9.0]\n[sample]\nshape = { kind = \"sphere\", radius_mm = 1.0, segments = 64 }\n[[light]]\nkind = \"directional\"\nto_light = [0.0, 0.0, 1.0]\nirradiance = 3.0\n";
        let file = SceneFile::parse("scene.toml", Path::new(""), text).unwrap();
        let atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
        let dictionary = Arc::new(Dictionary::new("white and black", atoms).unwrap());
        let of = |albedo: f64| {
            let weights = vec![albedo, 1.0 - albedo];
            Material::from(Mixture::grey(dictionary.clone(), weights).unwrap())
        };
        let options = RenderOptions {
            max_reflections: 1,
            ..RenderOptions::default()
        };
        let scene = file.scene().unwrap();
        let found = deviations(&scene, &[0.4, 0.5, 0.6].map(of), &options, &());
        // The deviation of 0.4, 0.5, 0.6 is 0.1.
        let expected = 0.1 * 3.0 / std::f32::consts::PI;
        let middle = found[0][8 * 4 + 4][1];
        assert!(
            (middle / expected - 1.0).abs() < 0.01,
            "{middle} {expected}"
        );
        assert_eq!(
            deviations(&scene, &[of(0.5)], &options, &())[0][0],
            [0.0; 3]
        );
    }
}
