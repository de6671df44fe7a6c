//! Radiance of given surface points by light of two and more reflections.

use glam::Vec3;
use rayon::prelude::*;

use super::points::SobolSampler;
use super::render::{Carrier, RenderOptions, follow_from};
use super::scene::{Scene, Surface};
use crate::brdf::Brdf;

/// Radiance under the scene's first lamp, R, G, B, that leaves each point towards its viewer (a
/// local direction) after two to `max_reflections` reflections: the mean over paths from exactly
/// there, as many as `paths` gives or else `samples_per_pixel`. The paths are quasi-random whatever
/// `scrambles` is, and those of a point depend on its index alone.
pub fn indirect(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    points: &[(Surface, Vec3)],
    paths: &[u32],
) -> Vec<[f32; 3]> {
    let continuations = options.continuations(scene);
    let Some(lamp) = scene.lights.first() else {
        return vec![[0.0; 3]; points.len()];
    };
    let strength = lamp.strength();
    let options = &RenderOptions {
        min_reflections: options.min_reflections.max(2),
        ..options.clone()
    };
    let points = points.par_iter().enumerate();
    let of_point = |(index, point): (usize, &(Surface, Vec3))| {
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
            let begun = (&mut numbers, carried, *point);
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
    points.map(of_point).collect()
}
