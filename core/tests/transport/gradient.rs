//! The cache's derivatives against closed forms and against differences of rendered images.
//!
//! Per pixel, means of independent groups of paths and their scatter; z through Student's
//! distribution as in [`super::references`]. A score summed over all reflections but the
//! last is what the tests must notice: an atom next to black makes each order of reflection
//! a power of its weight, so leaving the last factor's score out takes value/weight off the
//! derivative.

use std::sync::Arc;

use glam::DVec2;
use nalgebra::DVector;
use rig_core::brdf::{Atom, Dictionary, Mixture};
use rig_core::cells::Captured;
use rig_core::geometry::Shape;
use rig_core::inverse::{
    Channels,
    objective::{Modelled, Objective},
};
use rig_core::radiance_image::RadianceImage;
use rig_core::random::{Purpose, stream};
use rig_core::transport::{
    Cache, CacheOptions, Camera, Cells, DirectMatrix, Kernel, Proposal, RenderOptions, Scene,
    Shading, render,
};

use super::references::{above, mesh, sun};
use super::statistics::{
    anderson_darling, chi2_score, mean_and_error, normal_score, sidak, two_sided,
};

const GROUPS: u64 = 16;

/// Every pixel of a scene's image as a cell.
fn pixels_of(scene: &Scene) -> Cells {
    Cells::of_pixels(scene.camera.resolution_px)
}

/// Per pixel: multiple reflection per unit lamp strength, and its derivative with respect
/// to the first atom of a dictionary of two.
fn cached(scene: &Scene, dictionary: &Arc<Dictionary>, weight: f64, seed: u64) -> [Vec<f64>; 2] {
    // Far fewer rare and bright paths than by the default proposal: nearly normal means.
    let brdf = Mixture::grey(dictionary.clone(), vec![weight, 1.0 - weight]).unwrap();
    let options = CacheOptions {
        proposal: Proposal::resembling(&brdf, 0.05),
        samples_per_cell: 128,
        max_reflections: 12,
        seed,
        ..CacheOptions::default()
    };
    let cache = Cache::trace(scene, &pixels_of(scene), dictionary, &options).unwrap();
    let weights = [weight, 1.0 - weight];
    let mut pixels: Vec<[f64; 3]> = cache
        .evaluate(Kernel::detect(), &[&weights], Vec::new, |out, rows| {
            let mean = |pair: [f32; 2]| 0.5 * f64::from(pair[0] + pair[1]);
            out.push([
                rows.cell as f64,
                mean(rows.value.map(|v| v[0])),
                mean(rows.jacobian.map(|j| j[0])),
            ]);
        })
        .concat();
    pixels.sort_by(|a, b| a[0].total_cmp(&b[0]));
    [1, 2].map(|k| pixels.iter().map(|p| p[k]).collect())
}

/// p of Anderson–Darling and of χ², and the deviate of the image's mean, of
/// `ours` against `theirs`, both groups × pixels; `theirs` may be one exact row.
fn compare(ours: &[Vec<f64>], theirs: &[Vec<f64>], systematic: f64) -> [f64; 3] {
    let (mean, error) = mean_and_error(ours);
    let (expected, their_error) = if theirs.len() == 1 {
        (theirs[0].clone(), vec![0.0; mean.len()])
    } else {
        mean_and_error(theirs)
    };
    let (mut z, mut total, mut variance, mut sum) = (Vec::new(), 0.0, 0.0, 0.0);
    for i in 0..mean.len() {
        let (a, b) = (error[i].powi(2), their_error[i].powi(2));
        total += mean[i] - expected[i];
        sum += expected[i];
        variance += a + b;
        if a + b > 0.0 {
            let freedom = (a + b).powi(2) / (a * a + b * b) * (ours.len() - 1) as f64;
            z.push(normal_score(
                (mean[i] - expected[i]) / (a + b).sqrt(),
                freedom,
            ));
        }
    }
    assert!(z.len() > 100, "{} pixels", z.len());
    let chi2: f64 = z.iter().map(|z| z * z).sum();
    let tolerance = (variance + (systematic * sum).powi(2)).sqrt();
    [
        anderson_darling(&z),
        two_sided(chi2_score(chi2, z.len() as f64)),
        two_sided(total / tolerance),
    ]
}

/// Two comparisons of three tests: family significance 1%.
fn agrees(p: [f64; 3]) -> bool {
    p.iter().all(|&p| p > sidak(0.01, 6))
}

/// What is left of a derivative when the last reflection's score is forgotten.
fn without_last(groups: &[[Vec<f64>; 2]], weight: f64) -> Vec<Vec<f64>> {
    let one = |[value, derivative]: &[Vec<f64>; 2]| {
        let pairs = value.iter().zip(derivative);
        pairs.map(|(v, d)| d - v / weight).collect()
    };
    groups.iter().map(one).collect()
}

/// A hemisphere seen from above within its rim, under coaxial light, and the dictionary of
/// one grey atom next to black.
fn grey_bowl(pixels: usize) -> (Scene, Arc<Dictionary>) {
    let camera = Camera::above([pixels; 2], DVec2::splat(1.3), 5.0);
    let bowl = Shape::Bowl {
        radius_mm: 1.0,
        segments: 256,
    };
    let lights = vec![sun(0.0, 0.0)];
    let scene = Scene::new(bowl.mesh().unwrap(), Shading::Smooth, camera, lights);
    let atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
    let dictionary = Dictionary::new("grey", atoms).unwrap();
    (scene, Arc::new(dictionary))
}

/// Radiance of 2 to `longest` reflections in the grey bowl under unit irradiance, and its
/// derivative: order k is (ρ/π)(ρ/4)(ρ/2)^(k−2) everywhere.
fn grey_bowl_radiance(rho: f64, longest: i32) -> [f64; 2] {
    let order = |k: i32| rho / std::f64::consts::PI * rho / 4.0 * (rho / 2.0).powi(k - 2);
    [
        (2..=longest).map(order).sum(),
        (2..=longest).map(|k| f64::from(k) * order(k) / rho).sum(),
    ]
}

#[test]
fn the_lambertian_bowl_has_its_closed_derivative() {
    let (scene, dictionary) = grey_bowl(16);
    let rho = 0.9f64;
    let [_, exact] = grey_bowl_radiance(rho, 12);
    let exact = vec![vec![exact; 256]];
    let groups: Vec<_> = (0..GROUPS)
        .map(|seed| cached(&scene, &dictionary, rho, 100 + seed))
        .collect();
    let derivatives: Vec<_> = groups.iter().map(|g| g[1].clone()).collect();
    let p = compare(&derivatives, &exact, 2e-4);
    println!("closed form: p {p:.3?}");
    assert!(agrees(p), "{p:?}");
    let mutant = compare(&without_last(&groups, rho), &exact, 2e-4);
    assert!(!agrees(mutant) && mutant[0] < 1e-6, "{mutant:?}");
}

/// With few paths per pixel the gradient of the squared loss has the expectation that the
/// noiseless image gives, (model − target)·derivative: zero where the target is the truth.
/// Residual and derivative from the same paths would miss it by their covariance.
#[test]
fn the_gradient_of_the_loss_is_unbiased() {
    const SEEDS: u64 = 64;
    const PIXELS: usize = 8;
    let (scene, dictionary) = grey_bowl(PIXELS);
    let rho = 0.8f64;
    let mixture = [DVector::from_vec(vec![rho, 1.0 - rho])];
    let [multiple, derivative] = grey_bowl_radiance(rho, 12);
    let direct = DirectMatrix::new(&scene, &pixels_of(&scene), &dictionary, 16, 3);
    // Paths so rare and bright as by the default proposal would need many more seeds.
    let truth = Arc::new(Dictionary::clone(&dictionary));
    let truth = Mixture::grey(truth, vec![rho, 1.0 - rho]).unwrap();
    let proposal = Proposal::resembling(&truth, 0.05);
    for brightness in [1.0, 0.8] {
        let mut target = RadianceImage::new(PIXELS, PIXELS);
        let mut expected = 0.0;
        for (pixel, target) in target.mean.iter_mut().enumerate() {
            let first = f64::from(direct.row(pixel, 0)[0]);
            let truth = first * rho + multiple;
            *target = [(brightness * truth) as f32; 3];
            // Minus the gradient, as the quadratic holds it; three channels share the weights.
            let residual = truth - f64::from(target[0]);
            expected -= 3.0 * residual * (first + derivative);
        }
        let weights = vec![vec![[1.0; 3]; PIXELS * PIXELS]];
        let [mut unbiased, mut same_paths] = [Vec::new(), Vec::new()];
        for seed in 0..SEEDS {
            let options = CacheOptions {
                samples_per_cell: 8,
                max_reflections: 12,
                seed: 500 + seed,
                proposal: proposal.clone(),
                ..CacheOptions::default()
            };
            let cache = Cache::trace(&scene, &pixels_of(&scene), &dictionary, &options).unwrap();
            let captured = Captured::of_pixels(std::slice::from_ref(&target), |_| true);
            let objective = Objective::new(
                &cache,
                &direct,
                &captured,
                Channels::Shared,
                Kernel::detect(),
                0.0,
            );
            unbiased.push(objective.linearise(&mixture, &weights).quadratics[0].g[0]);
            let parts = cache.evaluate(
                Kernel::detect(),
                &[mixture[0].as_slice()],
                || 0.0,
                |sum, rows| {
                    let mean = |pair: [f32; 2]| 0.5 * f64::from(pair[0] + pair[1]);
                    let first = f64::from(direct.row(rows.cell, 0)[0]);
                    let model = first * rho + mean(rows.value.map(|v| v[0]));
                    let residual = model - f64::from(target.mean[rows.cell][0]);
                    *sum -= 3.0 * residual * (first + mean(rows.jacobian.map(|j| j[0])));
                },
            );
            same_paths.push(parts.iter().sum::<f64>());
        }
        let deviates = [&unbiased, &same_paths].map(|gradients| {
            let n = SEEDS as f64;
            let mean = gradients.iter().sum::<f64>() / n;
            let variance = gradients.iter().map(|g| (g - mean).powi(2)).sum::<f64>();
            let error = (variance / (n * (n - 1.0))).sqrt();
            normal_score((mean - expected) / error, n - 1.0)
        });
        println!("target {brightness} x truth: deviates {deviates:.2?}");
        // Two targets at a family significance of 1%.
        let p = deviates.map(two_sided);
        assert!(p[0] > sidak(0.01, 2), "{deviates:?}");
        assert!(p[1] < 1e-6, "the covariance was not noticed: {deviates:?}");
    }
}

/// What the model leaves unexplained is found as the relative error that it is, free of
/// the noise of few paths and of the capture, and weights the values from then on.
#[test]
fn the_error_of_the_model_is_found_below_the_noise() {
    const PIXELS: usize = 16;
    let (scene, dictionary) = grey_bowl(PIXELS);
    let rho = 0.8f64;
    let mixture = [DVector::from_vec(vec![rho, 1.0 - rho])];
    let [multiple, _] = grey_bowl_radiance(rho, 12);
    let direct = DirectMatrix::new(&scene, &pixels_of(&scene), &dictionary, 16, 3);
    let options = CacheOptions {
        samples_per_cell: 64,
        max_reflections: 12,
        seed: 77,
        ..CacheOptions::default()
    };
    let cache = Cache::trace(&scene, &pixels_of(&scene), &dictionary, &options).unwrap();
    let (noise, stated) = (0.03, 0.02);
    for error in [0.0, 0.25] {
        let mut target = RadianceImage::new(PIXELS, PIXELS);
        for pixel in 0..PIXELS * PIXELS {
            let truth = f64::from(direct.row(pixel, 0)[0]) * rho + multiple;
            let sign = if pixel % 3 == 0 { -2.0 } else { 1.0 };
            for channel in 0..3 {
                let key = 3 * pixel as u64 + channel as u64;
                let normal = stream(5, Purpose::Experiment, 0, key, 0).normal();
                let captured = truth * (1.0 + error * sign / 2f64.sqrt() + noise * normal);
                target.mean[pixel][channel] = captured as f32;
                target.variance[pixel][channel] = (noise * truth).powi(2) as f32;
            }
            target.valid[pixel] = true;
        }
        let captured = Captured::of_pixels(std::slice::from_ref(&target), |_| true);
        let objective = Objective::new(
            &cache,
            &direct,
            &captured,
            Channels::Shared,
            Kernel::detect(),
            stated,
        );
        let pass = objective.linearise(&mixture, &objective.weights(None));
        let found = pass.relative_error(0);
        assert!(
            (found - error).abs() < 0.2 * error + 0.04,
            "{error}: {found}"
        );
        // What is allowed beyond the stated error, all over the image.
        let before = objective.weights(Some(&pass.model));
        let after = objective.weights_after(&pass);
        let [mut added, mut power] = [0.0, 0.0];
        for pixel in 0..PIXELS * PIXELS {
            let [before, after] = [&before, &after].map(|w| w[0][pixel][0]);
            if before > 0.0 {
                added += 1.0 / after - 1.0 / before;
                power += pass.model[0][pixel][0].value().powi(2);
            }
        }
        let expected = (found.max(stated).powi(2) - stated.powi(2)).sqrt();
        let allowed = (added / power).sqrt();
        println!("{error}: found {found:.4}, allowed {allowed:.4} beyond what is stated");
        assert!(
            (allowed - expected).abs() <= 0.05 * expected + 1e-9,
            "{allowed} {expected}"
        );
    }
}

/// Columns of a highlight next to columns a thousand times as dark, without noise of paths:
/// each value weighs by its own light and its own variance, also along the edge.
#[test]
fn a_highlight_does_not_hide_the_dark_beside_it() {
    const PIXELS: usize = 16;
    let (scene, dictionary) = grey_bowl(PIXELS);
    let direct = DirectMatrix::new(&scene, &pixels_of(&scene), &dictionary, 2, 3);
    let options = CacheOptions {
        samples_per_cell: 2,
        ..CacheOptions::default()
    };
    let cache = Cache::trace(&scene, &pixels_of(&scene), &dictionary, &options).unwrap();
    let radiance = |pixel: usize| -> f64 { if pixel % PIXELS < 5 { 1e-3 } else { 1.0 } };
    let mut target = RadianceImage::new(PIXELS, PIXELS);
    for pixel in 0..PIXELS * PIXELS {
        target.mean[pixel] = [radiance(pixel) as f32; 3];
        target.variance[pixel] = [(0.03 * radiance(pixel)).powi(2) as f32; 3];
        target.valid[pixel] = true;
    }
    let captured = Captured::of_pixels(std::slice::from_ref(&target), |_| true);
    let objective = Objective::new(
        &cache,
        &direct,
        &captured,
        Channels::Shared,
        Kernel::detect(),
        0.04,
    );
    let modelled = |pixel: usize| Modelled {
        direct: radiance(pixel),
        ..Modelled::default()
    };
    let model = (0..PIXELS * PIXELS).map(|pixel| [modelled(pixel); 3]);
    let weights = objective.weights(Some(&[model.collect()]));
    let mut compared = 0;
    for pixel in (0..PIXELS * PIXELS).filter(|&p| objective.is_compared(0, p)) {
        let deviation = weights[0][pixel][0].sqrt().recip();
        let expected = 0.05 * radiance(pixel);
        assert!(
            (deviation / expected - 1.0).abs() < 1e-4,
            "pixel {pixel}: {deviation}, not {expected}"
        );
        compared += 1;
    }
    assert!(compared > 50, "{compared}");
}

/// A GGX lobe in a corner: central differences of the plain renderer's images in the
/// lobe's weight, same paths on both sides, without the direct reflection.
#[test]
fn derivatives_are_differences_of_rendered_images() {
    let scene = Scene::new(
        mesh("tet_concave"),
        Shading::Flat,
        above([24, 24]),
        vec![sun(25.0, 20.0)],
    );
    let lobe = Atom::Ggx {
        alpha: 0.3,
        eta: 2.0,
    };
    let dictionary = Arc::new(Dictionary::new("lobe", vec![lobe, Atom::Black]).unwrap());
    let (weight, step) = (0.7, 0.02);
    let rendered = |seed: u64| -> Vec<f64> {
        let multiple = |weight: f64| -> Vec<f64> {
            let brdf = Mixture::grey(dictionary.clone(), vec![weight, 1.0 - weight]).unwrap();
            let image = |max_reflections| {
                let options = RenderOptions {
                    samples_per_pixel: 96,
                    max_reflections,
                    seed,
                    ..RenderOptions::default()
                };
                render(&scene, &brdf, &options).remove(0).mean
            };
            let pairs = image(12).into_iter().zip(image(1));
            pairs
                .map(|(all, direct)| f64::from(all[0] - direct[0]))
                .collect()
        };
        let pairs = multiple(weight + step)
            .into_iter()
            .zip(multiple(weight - step));
        pairs.map(|(up, down)| (up - down) / (2.0 * step)).collect()
    };
    let differences: Vec<_> = (0..GROUPS).map(|seed| rendered(300 + seed)).collect();
    let groups: Vec<_> = (0..GROUPS)
        .map(|seed| cached(&scene, &dictionary, weight, 100 + seed))
        .collect();
    let derivatives: Vec<_> = groups.iter().map(|g| g[1].clone()).collect();
    let p = compare(&derivatives, &differences, 1e-3);
    println!("differences: p {p:.3?}");
    assert!(agrees(p), "{p:?}");
    let mutant = compare(&without_last(&groups, weight), &differences, 1e-3);
    assert!(!agrees(mutant) && mutant[0] < 1e-6, "{mutant:?}");
}

/// Image of the cached paths plus the direct matrix against the plain renderer, with the fit's own (unadapted) proposal in the cache.
#[test]
fn cached_paths_give_the_rendered_image() {
    let scene = Scene::new(
        mesh("tet_concave"),
        Shading::Flat,
        above([32, 32]),
        vec![sun(25.0, 20.0)],
    );
    for (dictionary, weights) in [
        (
            Dictionary::rig26(),
            vec![(5, 0.35), (9, 0.15), (24, 0.4), (25, 0.1)],
        ),
        (
            Dictionary::paper42(),
            vec![(1, 0.3), (6, 0.3), (40, 0.3), (41, 0.1)],
        ),
    ] {
        let mut w = vec![0.0; dictionary.len()];
        weights.iter().for_each(|&(i, v): &(usize, f64)| w[i] = v);
        let truth = Mixture::grey(Arc::new(dictionary.clone()), w.clone()).unwrap();
        let options = RenderOptions {
            samples_per_pixel: 2048,
            max_reflections: 8,
            seed: 5,
            proposal: Proposal::resembling(&truth, 0.1),
            ..RenderOptions::default()
        };
        let image = render(&scene, &truth, &options).remove(0);
        let options = CacheOptions {
            samples_per_cell: 1024,
            max_reflections: 8,
            ..CacheOptions::default()
        };
        let cache = Cache::trace(&scene, &pixels_of(&scene), &dictionary, &options).unwrap();
        let direct = DirectMatrix::new(&scene, &pixels_of(&scene), &dictionary, 16, 3);
        let pixels: Vec<_> = cache
            .evaluate(Kernel::detect(), &[&w], Vec::new, |out, rows| {
                out.push((
                    0.5 * (rows.value[0][0] + rows.value[1][0]),
                    rows.variance[0],
                ));
            })
            .concat();
        let (mut chi2, mut n) = (0.0, 0.0);
        for (i, &(value, variance)) in pixels.iter().enumerate() {
            let direct: f64 = direct
                .row(i, 0)
                .iter()
                .zip(&w)
                .map(|(&d, &w)| f64::from(d) * w)
                .sum();
            let (ours, theirs) = (f64::from(value) + direct, f64::from(image.mean[i][0]));
            let spread = f64::from(variance) + f64::from(image.variance[i][0]);
            if spread > 0.0 && spread.sqrt() < 0.1 * theirs && direct.min(1.0) > 0.0 {
                chi2 += (ours - theirs).powi(2) / (spread + (2e-3 * theirs).powi(2));
                n += 1.0;
            }
        }
        let score = chi2_score(chi2, n);
        println!(
            "{}: chi2/dof {:.3} over {n} (score {score:+.1})",
            dictionary.name(),
            chi2 / n
        );
        assert!(
            n > 150.0 && score.abs() < 4.5,
            "{}: score {score}",
            dictionary.name()
        );
    }
}
