//! Whatever the images, what a fit reports and every posterior sample is a physical material.

use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};
use rig_core::bench_priors::BenchPriors;
use rig_core::brdf::discrepancy::Material;
use rig_core::brdf::ggx::{self, Cosines};
use rig_core::brdf::{Brdf, Dictionary, Mixture, check, nbrdf, source};
use rig_core::cells::{Captured, CellOptions};
use rig_core::geometry::Shape;
use rig_core::inverse::{FitOptions, fit};
use rig_core::random::{Purpose, stream};
use rig_core::transport::{Camera, Light, RenderOptions, Scene, Shading, render, suited_proposal};

/// Dark below a narrow lobe: its images ask for a discrepancy that is anything but small.
struct DarkGloss;

impl Brdf for DarkGloss {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) else {
            return [0.0; 3];
        };
        let lobes = 0.8 * ggx::eval(0.055, 1.5, &at) + 0.15 * ggx::eval(0.3, 1.6, &at);
        [0.004, 0.002, 0.001].map(|diffuse| diffuse + lobes)
    }
}

fn scene(shape: &Shape, lights: usize) -> Scene {
    let camera = Camera::above([12; 2], DVec2::splat(2.2), 5.0);
    let toward = [[0.0, 0.0], [0.5, 0.1], [-0.3, 0.6], [-0.2, -0.9]];
    let lights = toward[..lights]
        .iter()
        .map(|&[x, y]| Light::distant(DVec3::new(x, y, 1.0), [1.0; 3]));
    let mesh = shape.mesh().unwrap();
    Scene::new(mesh, Shading::Smooth, camera, lights.collect())
}

fn assert_physical(material: &Material, case: &str) {
    let found = check::check_with(material, 768, 100);
    assert!(found.passes(), "{case}: {found:?}");
}

/// Every bundled material, mirrors too, and a dark glossy one: bowl or sphere, one light or four,
/// with noise, as they are and brighter or darker by a factor. In full (RIG_LONG) every material,
/// and each as it is as well; otherwise every third.
#[test]
fn no_images_make_a_material_that_reflects_more_than_arrives() {
    let bowl = Shape::Bowl {
        radius_mm: 1.0,
        segments: 48,
    };
    let cap = Shape::Cap {
        radius_mm: 1.0,
        opening_deg: 90.0,
        segments: 48,
    };
    let dictionary = Dictionary::load(Dictionary::DEFAULT).unwrap();
    let mut materials: Vec<(String, Arc<dyn Brdf>)> = nbrdf::NAMES
        .iter()
        .map(|name| {
            let loaded = source::load(&format!("nbrdf:{name}")).unwrap();
            ((*name).to_owned(), loaded.into())
        })
        .collect();
    materials.push(("dark gloss".into(), Arc::new(DarkGloss)));
    let is_full = std::env::var_os("RIG_LONG").is_some();
    let step = if is_full { 1 } else { 3 };
    for (k, (name, material)) in materials.iter().enumerate().step_by(step) {
        let lights = [1, 4][k % 2];
        let shape = if k % 5 == 4 { &cap } else { &bowl };
        let scene = scene(shape, lights);
        let mut options = RenderOptions {
            samples_per_pixel: 64,
            max_reflections: 6,
            seed: 3,
            ..RenderOptions::default()
        };
        options.proposal = suited_proposal(&scene, &**material, &options);
        let rendered = render(&scene, &**material, &options);
        let changed = [1000.0, 5.0, 0.1, 1.0][k % 4];
        let as_it_is = is_full && changed != 1.0;
        for factor in [changed].into_iter().chain(as_it_is.then_some(1.0)) {
            let case = format!("{name}, {lights} lights, times {factor}");
            let mut numbers = stream(5, Purpose::Experiment, 0, k as u64, 0);
            let mut images = rendered.clone();
            for image in &mut images {
                for (mean, variance) in image.mean.iter_mut().zip(&mut image.variance) {
                    for c in 0..3 {
                        let noise = 0.02 * mean[c] + 1e-4;
                        mean[c] = factor * (mean[c] + noise * numbers.normal() as f32);
                        variance[c] = factor * factor * (variance[c] + noise * noise);
                    }
                }
            }
            let cells = CellOptions::new(&dictionary, &BenchPriors::EXACT);
            let captured = Captured::new(&scene, &images, &cells).unwrap();
            let mut options = FitOptions::default();
            options.cache.samples_per_cell = 32;
            options.cache.max_reflections = 6;
            let found = fit(&scene, &captured, &dictionary, &options).unwrap();
            assert_physical(&found.material, &case);
            let shared = found.material.mixture.dictionary();
            for sample in (0..options.posterior_samples).step_by(67) {
                let weights = [0, 1, 2].map(|c| {
                    let x = &found.posterior_samples[c].posterior[sample];
                    x.as_slice().to_vec()
                });
                let mixture = Mixture::new(shared.clone(), weights).unwrap();
                let discrepancies =
                    [0, 1, 2].map(|c| found.posterior_samples[c].discrepancies[sample].clone());
                let sample = Material::new(mixture, &discrepancies);
                assert_physical(&sample, &case);
            }
            let (half, difference) = ([0.0, 2.0, 30.0, 80.0], [0.0, 40.0, 85.0]);
            for interval in found.intervals(&half, &difference) {
                for c in 0..3 {
                    let [low, value, high] = [&interval.lower, &interval.value, &interval.upper];
                    let ordered = 0.0 <= low[c] && low[c] <= value[c] && value[c] <= high[c];
                    assert!(ordered && high[c].is_finite(), "{case}: {interval:?}");
                }
            }
        }
    }
}
