//! The cache's derivatives against closed forms and against differences of rendered images.
//!
//! Per pixel, means of independent groups of paths and their scatter; z through Student's
//! distribution as in [`super::references`]. A score summed over all reflections but the
//! last is what the tests must notice: an atom beside black makes each order of reflection
//! a power of its weight, so leaving the last factor's score out takes value/weight off the
//! derivative.

use std::sync::Arc;

use rig::brdf::{Atom, Dictionary, Mixture};
use rig::transport::{
    Cache, CacheOptions, Camera, DirectMatrix, Kernel, Proposal, RenderOptions, Scene, Shading,
    render,
};

use super::references::{above, mesh, sun};
use super::statistics::{
    anderson_darling, chi2_score, mean_and_error, normal_score, sidak, two_sided,
};

const GROUPS: u64 = 16;

/// Per pixel: multiple reflection per unit lamp strength, and its derivative with respect
/// to the first atom of a dictionary of two.
fn cached(scene: &Scene, dictionary: &Arc<Dictionary>, weight: f64, seed: u64) -> [Vec<f64>; 2] {
    // Far fewer rare and bright paths than by the default proposal: nearly normal means.
    let brdf = Mixture::grey(dictionary.clone(), vec![weight, 1.0 - weight]).unwrap();
    let options = CacheOptions {
        proposal: Proposal::resembling(&brdf, 0.05),
        samples_per_pixel: 128,
        max_reflections: 12,
        seed,
        ..CacheOptions::default()
    };
    let cache = Cache::trace(scene, dictionary, &options).unwrap();
    let weights = [weight, 1.0 - weight];
    let mut pixels: Vec<[f64; 3]> = cache
        .evaluate(Kernel::detect(), &[&weights], Vec::new, |out, rows| {
            let mean = |pair: [f32; 2]| 0.5 * f64::from(pair[0] + pair[1]);
            out.push([
                rows.pixel as f64,
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

/// A hemisphere under coaxial light: order k ≥ 2 is (ρ/π)(ρ/4)(ρ/2)^(k−2) everywhere.
#[test]
fn the_lambertian_bowl_has_its_closed_derivative() {
    let camera = Camera {
        resolution_px: [16, 16],
        ..Camera::looking_at(
            [16, 16],
            rig::transport::Projection::Orthographic {
                extent_mm: glam::DVec2::splat(1.3),
            },
            glam::DVec3::new(0.0, 0.0, 5.0),
            glam::DVec3::ZERO,
            glam::DVec3::Y,
        )
        .unwrap()
    };
    let bowl = rig::geometry::Shape::Bowl {
        radius_mm: 1.0,
        segments: 256,
    };
    let scene = Scene::new(
        bowl.mesh().unwrap(),
        Shading::Smooth,
        camera,
        vec![sun(0.0, 0.0)],
    );
    let grey = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
    let dictionary = Arc::new(Dictionary::new("grey", grey).unwrap());
    let rho = 0.9f64;
    let order = |k: i32| rho / std::f64::consts::PI * rho / 4.0 * (rho / 2.0).powi(k - 2);
    let exact: f64 = (2..=12).map(|k| f64::from(k) * order(k) / rho).sum();
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
                    proposal: Proposal::default(),
                };
                render(&scene, &brdf, &options, &|_| {}).remove(0).mean
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

/// Image of the cached paths plus the direct matrix against the plain renderer, for
/// both record layouts, with the fit's own (unadapted) proposal in the cache.
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
            Dictionary::reference_grid42(),
            vec![(16, 0.35), (32, 0.15), (40, 0.4), (41, 0.1)],
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
        };
        let image = render(&scene, &truth, &options, &|_| {}).remove(0);
        let options = CacheOptions {
            samples_per_pixel: 1024,
            max_reflections: 8,
            ..CacheOptions::default()
        };
        let cache = Cache::trace(&scene, &dictionary, &options).unwrap();
        let direct = DirectMatrix::new(&scene, &dictionary, 16, 3);
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
