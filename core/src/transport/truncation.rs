//! What paths longer than the longest that is followed would have added.

use rayon::prelude::*;

use super::points::IndependentSampler;
use super::render::{RenderOptions, follow};
use super::scene::Scene;
use crate::brdf::Brdf;

/// Energy beyond the longest path, per lamp.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Remainder {
    /// Light that longer paths bring to the camera over all that there is, channels
    /// together, in strength of the lamp; 0..=1.
    pub share: f64,
    /// Standard error of `share`, of the paths that were drawn.
    pub standard_error: f64,
    /// Light of one more reflection over the light of one fewer, near the cut.
    pub ratio: f64,
}

/// Orders of reflection per window beyond the cut.
const WINDOW: u32 = 3;
/// Independent groups of paths, for the standard error.
const GROUPS: usize = 16;
/// Pixels that are looked at, spread evenly.
const PIXELS: usize = 1024;
/// Largest ratio that the extrapolation believes: a white surface in a nearly closed
/// cavity comes near it.
const MAX_RATIO: f64 = 0.99;

/// Estimates, per lamp, what `options.max_reflections` cuts off, by `samples` paths on each of
/// about a thousand pixels spread over the image. The next six orders of reflection are
/// measured, those after them continue as the geometric series that the six begin.
pub fn truncation_remainder(
    scene: &Scene,
    brdf: &dyn Brdf,
    options: &RenderOptions,
    samples: u32,
) -> Vec<Remainder> {
    let cut = options.max_reflections;
    let longer = RenderOptions {
        max_reflections: cut + 2 * WINDOW,
        // Other paths than the image's, so that the two errors are independent.
        seed: options.seed ^ 0x5eed_0f7e_7a11,
        ..options.clone()
    };
    let continuations = longer.continuations(scene);
    let pixels: Vec<usize> = (0..scene.camera.pixels())
        .step_by(scene.camera.pixels().div_ceil(PIXELS))
        .collect();
    let lights = scene.lights.len();
    let per_group = samples.div_ceil(GROUPS as u32).max(1);
    // Per lamp: followed orders, first and second window beyond.
    let groups: Vec<Vec<[f64; 3]>> = (0..GROUPS)
        .into_par_iter()
        .map(|group| {
            let mut sums = vec![[0.0; 3]; lights];
            let first = group as u32 * per_group;
            for &pixel in &pixels {
                for sample in first..first + per_group {
                    let path = IndependentSampler::begin(&scene.camera, longer.seed, pixel, sample);
                    follow::<[f64; 3], _>(
                        scene,
                        brdf,
                        &longer,
                        &continuations,
                        path,
                        |order, light, reading| {
                            let strength = scene.lights[light].strength();
                            let part = order.saturating_sub(cut).div_ceil(WINDOW) as usize;
                            sums[light][part] +=
                                (0..3).map(|c| reading[c] * strength[c]).sum::<f64>();
                        },
                    );
                }
            }
            sums
        })
        .collect();
    (0..lights)
        .map(|light| {
            let total = |without: Option<usize>| {
                let mut sum = [0.0; 3];
                for (group, sums) in groups.iter().enumerate() {
                    if Some(group) != without {
                        (0..3).for_each(|k| sum[k] += sums[light][k]);
                    }
                }
                sum
            };
            let (share, ratio) = extrapolated(total(None));
            // Jackknife over the groups.
            let n = GROUPS as f64;
            let squares: f64 = (0..GROUPS)
                .map(|group| (extrapolated(total(Some(group))).0 - share).powi(2))
                .sum();
            Remainder {
                share,
                standard_error: (squares * (n - 1.0) / n).sqrt(),
                ratio,
            }
        })
        .collect()
}

/// Share of the whole beyond the cut, and the ratio of one order to the one before.
fn extrapolated([followed, near, far]: [f64; 3]) -> (f64, f64) {
    if near <= 0.0 {
        return (0.0, 0.0);
    }
    let ratio = (far / near).cbrt().min(MAX_RATIO);
    let window = ratio.powi(WINDOW as i32);
    let beyond = near + far + far * window / (1.0 - window);
    (beyond / (followed + beyond), ratio)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::transport::{Light, Proposal};
    use glam::DVec3;
    use std::sync::Arc;

    /// The Lambertian hemisphere under coaxial light: order k ≥ 2 adds the same
    /// (ρ/π)(ρ/4)(ρ/2)^(k−2) everywhere, order 1 (ρ/π) cos θ, whose mean over the disc is 2/3.
    #[test]
    fn a_lambertian_bowl_has_the_closed_form() {
        let mut scene = Scene::bowl(128, [24, 24], 2.2);
        scene.lights = vec![Light::distant(DVec3::Z, [2.0, 1.0, 1.0])];
        for (albedo, cut) in [(0.9f64, 1), (0.9, 3), (0.9, 8), (0.5, 4), (1.0, 6)] {
            let dictionary = Dictionary::new("grey", vec![Atom::Lambertian { albedo }]).unwrap();
            let brdf = Mixture::grey(Arc::new(dictionary), vec![1.0]).unwrap();
            let options = RenderOptions {
                max_reflections: cut,
                proposal: Proposal::resembling(&brdf, 0.0),
                ..RenderOptions::default()
            };
            let [found] = truncation_remainder(&scene, &brdf, &options, 64)[..] else {
                panic!("one lamp")
            };
            let ratio = albedo / 2.0;
            let from = |order: u32| albedo / 4.0 * ratio.powi(order as i32 - 2) / (1.0 - ratio);
            let exact = from(cut + 1) / (2.0 / 3.0 + from(2));
            assert!(
                (found.share - exact).abs() < 4.0 * found.standard_error + 0.01 * exact,
                "{albedo} after {cut}: {found:?}, exactly {exact}"
            );
            assert!(found.standard_error < 0.3 * exact, "{found:?}, {exact}");
            assert!((found.ratio - ratio).abs() < 0.1, "{found:?}");
        }
    }

    #[test]
    fn a_flat_sample_has_none() {
        assert_eq!(extrapolated([3.0, 0.0, 0.0]), (0.0, 0.0));
        // A series that does not fall is cut, not infinite.
        assert!(extrapolated([1.0, 1.0, 1.0]).0 < 1.0);
    }
}
