//! What a viewer reads of given places by light of two and more reflections.

use glam::Vec3;
use rayon::prelude::*;

use super::points::SobolSampler;
use super::render::{Carrier, RenderOptions, follow_from};
use super::scene::{Scene, Surface};
use crate::brdf::Brdf;

/// Light under the scene's first lamp, R, G, B, that leaves each place towards its viewer (a
/// local direction) after two to `max_reflections` reflections: the mean over
/// paths from exactly there, as many as `paths` says or else `samples_per_pixel`, W/(m² sr). The paths are evenly spread points
/// whatever `scrambles` says, and a place's depend on its index alone.
pub fn indirect(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    places: &[(Surface, Vec3)],
    paths: &[u32],
) -> Vec<[f32; 3]> {
    let continuations = options.continuations(scene);
    let Some(lamp) = scene.lights.first() else {
        return vec![[0.0; 3]; places.len()];
    };
    let strength = lamp.strength();
    let options = &RenderOptions {
        min_reflections: options.min_reflections.max(2),
        ..options.clone()
    };
    let places = places.par_iter().enumerate();
    let of_place = |(index, place): (usize, &(Surface, Vec3))| {
        let mut sum = [0.0; 3];
        let number = paths
            .get(index)
            .copied()
            .unwrap_or(options.samples_per_pixel);
        for path in 0..number {
            // The ray is known already.
            let (mut numbers, ray) =
                SobolSampler::begin(&scene.camera, options.seed, index, 0, path);
            let carried = <[f64; 3]>::start(ray.direction);
            let begun = (&mut numbers, carried, *place);
            follow_from(
                scene,
                brdf,
                options,
                &continuations,
                begun,
                |_, lamp, reading| {
                    if lamp == 0 {
                        for (sum, value) in sum.iter_mut().zip(reading) {
                            *sum += value;
                        }
                    }
                },
            );
        }
        let number = f64::from(number.max(1));
        std::array::from_fn(|c| (sum[c] / number * strength[c]) as f32)
    };
    places.map(of_place).collect()
}
