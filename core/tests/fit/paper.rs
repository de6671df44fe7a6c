//! The paper's algorithm on one page (`examples/paper.rs`) against the library: its image
//! against the renderer's, its gradient against differences of its own loss and against the
//! fit's objective, its result against the fit's.

use glam::DVec2;
use nalgebra::DVector;
use rig_core::brdf::environment::EnvironmentMap;
use rig_core::brdf::score::environment_error;
use rig_core::brdf::{Brdf, Mixture};
use rig_core::cells::Captured;
use rig_core::inverse::objective::Objective;
use rig_core::inverse::{Channels, FitOptions};
use rig_core::radiance_image::RadianceImage;
use rig_core::transport::{
    Cache, CacheOptions, Cells, DirectMatrix, Kernel, Projection, Proposal, RenderOptions, render,
};

#[allow(dead_code)]
#[path = "../../examples/paper.rs"]
mod algorithm;

use crate::statistics::{
    anderson_darling, chi2_score, mean_and_error, normal_score, sidak, two_sided,
};
use algorithm::{Known, Sampling};

const LONGEST: u32 = 4;

/// The page's bowl with 12 x 12 pixels.
fn known() -> Known {
    Known::new(
        algorithm::bowl(96, 12).unwrap(),
        algorithm::dictionary().unwrap(),
    )
}

fn material(known: &Known, weights: &[f64]) -> Mixture {
    Mixture::grey(known.dictionary.clone(), weights.to_vec()).unwrap()
}

/// All weights positive, none like the truth's.
const ELSEWHERE: [f64; 8] = [0.05, 0.05, 0.1, 0.1, 0.1, 0.15, 0.35, 0.1];

fn sampling(known: &Known, paths: u32, seed: u64) -> Sampling {
    let q = Proposal::resembling(&material(known, &ELSEWHERE), 0.05);
    Sampling {
        paths,
        longest: LONGEST,
        q,
        seed,
    }
}

/// Standard normal deviates of the differences between the means of two groups of rows, per
/// column (Welch); columns that scatter in neither group are left out.
fn deviates(ours: &[Vec<f64>], theirs: &[Vec<f64>]) -> Vec<f64> {
    let [(a, a_error), (b, b_error)] = [ours, theirs].map(mean_and_error);
    let [m, n] = [ours, theirs].map(|rows| (rows.len() - 1) as f64);
    (0..a.len())
        .filter_map(|k| {
            let [u, v] = [a_error[k].powi(2), b_error[k].powi(2)];
            let t = (a[k] - b[k]) / (u + v).sqrt();
            let freedom = (u + v).powi(2) / (u * u / m + v * v / n);
            (u + v > 0.0).then(|| normal_score(t, freedom))
        })
        .collect()
}

/// The image with paths of up to four reflections is the renderer's within the scatter of 16
/// independent images of either: per light, Anderson–Darling's test and χ² of the pixels'
/// deviates, and the image's sum, at a family significance of 1%. With up to three
/// reflections only it is not.
#[test]
fn the_image_is_the_renderers() {
    const GROUPS: u64 = 16;
    const PATHS: u32 = 256;
    let known = known();
    let brdf = material(&known, &ELSEWHERE);
    let pixels = known.scene.camera.pixels();
    let lights = known.scene.lights.len();
    let (mut ours, mut shorter) = (vec![Vec::new(); lights], vec![Vec::new(); lights]);
    let mut theirs = vec![Vec::new(); lights];
    for group in 0..GROUPS {
        let sampling = sampling(&known, PATHS, 100 + group);
        for (longest, images) in [(LONGEST, &mut ours), (LONGEST - 1, &mut shorter)] {
            let sampling = Sampling {
                longest,
                ..sampling.clone()
            };
            let values: Vec<_> = (0..pixels)
                .map(|p| algorithm::estimate(&known, &ELSEWHERE, &sampling, p, 0))
                .collect();
            for (m, image) in images.iter_mut().enumerate() {
                image.push(values.iter().map(|of_pixel| of_pixel[m].radiance).collect());
            }
        }
        let options = RenderOptions {
            samples_per_pixel: PATHS,
            max_reflections: LONGEST,
            seed: 900 + group,
            proposal: sampling.q,
            ..RenderOptions::default()
        };
        let images = render(&known.scene, &brdf, &options);
        for (rows, image) in theirs.iter_mut().zip(images) {
            rows.push(image.mean.iter().map(|rgb| f64::from(rgb[0])).collect());
        }
    }
    let sums = |rows: &[Vec<f64>]| -> Vec<Vec<f64>> {
        rows.iter().map(|row| vec![row.iter().sum()]).collect()
    };
    for m in 0..lights {
        let p = |ours: &[Vec<f64>]| {
            let z = deviates(ours, &theirs[m]);
            let chi2: f64 = z.iter().map(|z| z * z).sum();
            let total = deviates(&sums(ours), &sums(&theirs[m]))[0];
            let chi2 = two_sided(chi2_score(chi2, z.len() as f64));
            [anderson_darling(&z), chi2, two_sided(total)]
        };
        let (same, shorter) = (p(&ours[m]), p(&shorter[m]));
        println!("light {m}: p {same:.3?}, with one reflection less {shorter:?}");
        assert!(
            same.iter().all(|&p| p > sidak(0.01, 3 * lights)),
            "light {m}: {same:?}"
        );
        assert!(
            shorter[2] < 1e-6,
            "one reflection less was not noticed: {shorter:?}"
        );
    }
}

/// The gradient is the derivative of the loss with the same paths, within 10⁻⁶ of the largest
/// component.
#[test]
fn the_gradient_is_the_difference_of_the_loss() {
    let known = known();
    let pixels = known.scene.camera.pixels();
    let captured = vec![vec![0.3; pixels]; known.scene.lights.len()];
    let sampling = sampling(&known, 8, 1);
    let (_, gradient) = algorithm::loss(&known, &captured, &ELSEWHERE, &sampling);
    let largest = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    for (n, &derivative) in gradient.iter().enumerate() {
        let step = 1e-4;
        let [above, below] = [step, -step].map(|step| {
            let mut weights = ELSEWHERE;
            weights[n] += step;
            algorithm::loss(&known, &captured, &weights, &sampling).0
        });
        let difference = (above - below) / (2.0 * step);
        println!("atom {n}: {derivative:.8}, difference {difference:.8}");
        assert!(
            (derivative - difference).abs() < 1e-6 * largest,
            "atom {n}: {derivative}, {difference}"
        );
    }
}

/// The gradient has the expectation of that of the library's objective, which has the same
/// loss up to a factor: from two paths in each half, so that noise would bias a gradient that
/// took residual and derivative from the same paths. Family significance 1% over the atoms.
/// The objective leaves out pixels at edges of the sample and of shadows, so the camera sees
/// none.
#[test]
fn the_gradient_is_the_objectives() {
    const OURS: u64 = 400;
    const THEIRS: u64 = 24;
    const TARGET: f32 = 0.3;
    let mut known = known();
    known.scene.lights.truncate(1);
    let field = DVec2::splat(1.3);
    known.scene.camera.projection = Projection::Orthographic { extent_mm: field };
    let resolution_px = known.scene.camera.resolution_px;
    let pixels = known.scene.camera.pixels();

    // The page's, and what it would be without independent halves.
    let captured = vec![vec![f64::from(TARGET); pixels]];
    let [mut ours, mut same_paths] = [Vec::new(), Vec::new()];
    for seed in 0..OURS {
        let sampling = sampling(&known, 2, 100 + seed);
        ours.push(algorithm::loss(&known, &captured, &ELSEWHERE, &sampling).1);
        let mut biased = vec![0.0; ELSEWHERE.len()];
        for (p, &photographed) in captured[0].iter().enumerate() {
            let [image] = &algorithm::estimate(&known, &ELSEWHERE, &sampling, p, 0)[..] else {
                panic!("one light");
            };
            let residual = photographed - image.radiance;
            let terms = image.derivative.iter().map(|d| -2.0 * residual * d);
            biased
                .iter_mut()
                .zip(terms)
                .for_each(|(sum, term)| *sum += term);
        }
        same_paths.push(biased);
    }

    // The library's. Its loss is half the sum over three equal channels, its g minus the
    // gradient.
    let mut target = RadianceImage::new(resolution_px[0], resolution_px[1]);
    target.mean.fill([TARGET; 3]);
    let captured = Captured::of_pixels(std::slice::from_ref(&target), |_| true);
    let cells = Cells::of_pixels(resolution_px);
    let weights = [DVector::from_column_slice(&ELSEWHERE)];
    let gradient = |seed: u64| -> Vec<f64> {
        let options = CacheOptions {
            samples_per_cell: 64,
            max_reflections: LONGEST,
            seed: 900 + seed,
            proposal: sampling(&known, 1, 0).q,
            ..CacheOptions::default()
        };
        let cache = Cache::trace(&known.scene, &cells, &known.dictionary, &options).unwrap();
        let direct = DirectMatrix::new(&known.scene, &cells, &known.dictionary, 16, seed);
        let (kernel, channels) = (Kernel::detect(), Channels::Shared);
        let objective = Objective::new(&cache, &direct, &captured, channels, kernel, 0.0);
        let pass = objective.linearise(&weights, &vec![vec![[1.0; 3]; pixels]]);
        pass.quadratics[0]
            .g
            .iter()
            .map(|g| -2.0 / 3.0 * g)
            .collect()
    };
    let theirs: Vec<_> = (0..THEIRS).map(gradient).collect();

    let z = deviates(&ours, &theirs);
    let biased = deviates(&same_paths, &theirs);
    println!("gradient {:.3?}", mean_and_error(&ours));
    println!("objective's {:.3?}", mean_and_error(&theirs));
    println!("deviates {z:.2?}, with the same paths {biased:.2?}");
    // Black has no derivative.
    assert_eq!(z.len(), ELSEWHERE.len() - 1);
    let limit = sidak(0.01, z.len());
    assert!(z.iter().all(|&z| two_sided(z) > limit), "{z:?}");
    let noticed = biased.iter().any(|&z| two_sided(z) < 1e-6);
    assert!(noticed, "the covariance was not noticed: {biased:?}");
}

/// The material found is the one that the library's fit finds in the same images, and the
/// true one, both within an environment error of 2%. The single-bounce start is further from
/// the truth by a factor of five or more.
#[test]
fn the_result_is_that_of_the_fit() {
    let known = known();
    let truth = material(&known, &algorithm::TRUTH);
    let [width, height] = known.scene.camera.resolution_px;
    let captured = algorithm::capture(&truth, width).unwrap();
    let as_image = |values: &Vec<f64>| {
        let mut image = RadianceImage::new(width, height);
        image.mean = values.iter().map(|&v| [v as f32; 3]).collect();
        image
    };
    let images: Vec<_> = captured.iter().map(as_image).collect();
    let options = FitOptions {
        channels: Channels::Shared,
        ..FitOptions::default()
    };
    let theirs = rig_core::inverse::fit(
        &known.scene,
        &Captured::of_pixels(&images, |_| true),
        &known.dictionary,
        &options,
    )
    .unwrap();
    let sampling = Sampling {
        paths: 8,
        longest: 8,
        q: Proposal::default(),
        seed: 1,
    };
    let [start, found] = algorithm::fit(&known, &captured, &sampling, 300).unwrap();
    println!("start  {start:.3?}\nfound  {found:.3?}");
    println!("theirs {:.3?}", theirs.material.mixture.weights()[0]);
    let maps = EnvironmentMap::all();
    let error = |a: &dyn Brdf, b: &dyn Brdf| environment_error(a, b, &maps, 32).mean.all;
    let found = material(&known, &found);
    let to_fit = error(&found, &theirs.material);
    let to_truth = error(&found, &truth);
    let of_start = error(&material(&known, &start), &truth);
    println!("to the fit {to_fit:.4}, to the truth {to_truth:.4}, of the start {of_start:.4}");
    assert!(to_fit < 0.02, "{to_fit}");
    assert!(to_truth < 0.02, "{to_truth}");
    assert!(of_start > 5.0 * to_truth, "{of_start} against {to_truth}");
}
