//! The bench's parameters, derivatives and refinement on small images.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, DVector};

use super::derivatives::{DerivativeImages, DerivativeOptions};
use super::parameters::{Axis, Nuisance, Parameter};
use super::spectrum::Spectrum;
use super::{RefineOptions, RefinedBench, refine_bench};
use crate::bench_priors::BenchPriors;
use crate::brdf::ggx::Cosines;
use crate::brdf::half_difference::HalfDifference;
use crate::brdf::{Dictionary, Mixture};
use crate::cells::{Captured, CellOptions};
use crate::frames::{Rigid, Sample};
use crate::geometry::Shape;
use crate::inverse::{Channels, FitOptions, fit};
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::transport::{
    Camera, Cells, Light, Proposal, RenderOptions, Scene, Shading, Steering, render,
};
use crate::units::StageAngles;

/// A bowl of 50 mm under lights at these angles, degrees.
fn bowl(segments: u32, size: usize, lights: &[[f64; 2]]) -> Scene {
    let mesh = Shape::Bowl {
        radius_mm: 25.0,
        segments,
    };
    let camera = Camera::above([size, size], DVec2::splat(54.0), 150.0);
    let lights = lights
        .iter()
        .map(|&[azimuth_deg, elevation_deg]| Light::Directional {
            to_light: StageAngles {
                azimuth_deg,
                elevation_deg,
            }
            .to_light(),
            irradiance: [1.0; 3],
            angular_radius_rad: 0.0,
        })
        .collect();
    Scene::new(mesh.mesh().unwrap(), Shading::Smooth, camera, lights)
}

/// A rough and rather dark material in the dictionary's span, grey: little noise.
fn material() -> Mixture {
    let dictionary = Arc::new(Dictionary::paper42());
    let mut weights = vec![0.0; dictionary.len()];
    (weights[38], weights[40], weights[41]) = (0.2, 0.3, 0.5);
    Mixture::grey(dictionary, weights).unwrap()
}

fn priors() -> BenchPriors {
    BenchPriors {
        light_rad: 0.01,
        intensity: 0.02,
        rotation_rad: 0.004,
        translation_mm: 0.2,
        stray_light: 0.0,
        ..BenchPriors::default()
    }
}

#[test]
fn camera_and_lights_move_as_if_the_sample_did() {
    let described = bowl(16, 8, &[[30.0, 50.0], [0.0, 90.0]]);
    let bench = Nuisance::new(&described, &priors());
    let mut values = DVector::zeros(bench.parameters().len());
    let group = |values: &mut DVector<f64>, parameter: Parameter, value: f64| {
        let at = bench.parameters().iter().position(|p| *p == parameter);
        values[at.unwrap()] = value;
    };
    group(&mut values, Parameter::LightElevation(0), 1f64.to_radians());
    group(&mut values, Parameter::Intensity(1), 0.1);
    group(&mut values, Parameter::Rotation(Axis::Y), 0.02);
    group(&mut values, Parameter::Translation(Axis::X), 0.3);
    group(&mut values, Parameter::Translation(Axis::Z), -0.1);
    let moved = bench.scene(&values);
    let pose: Rigid<Sample, Sample> =
        Rigid::from_rotation_vector(DVec3::new(0.0, 0.02, 0.0), DVec3::new(0.3, 0.0, -0.1));
    let at = DVec2::new(2.5, 6.1);
    let [before, after] = [&described, &moved].map(|s| s.camera.ray(at, DVec2::ZERO));
    assert!((pose.point(after.origin_mm.as_dvec3()) - before.origin_mm.as_dvec3()).length() < 1e-4);
    let direction = pose.direction(after.direction.as_dvec3());
    assert!((direction - before.direction.as_dvec3()).length() < 1e-6);
    let towards = |light: &Light| match *light {
        Light::Directional {
            to_light,
            irradiance,
            ..
        } => (to_light, irradiance[0]),
        Light::Point { .. } => panic!("no point light was given"),
    };
    let (raised, _) = towards(&moved.lights[0]);
    let angles = StageAngles::from_direction(pose.direction(raised));
    assert!((angles.elevation_deg - 51.0).abs() < 1e-9, "{angles:?}");
    assert!((angles.azimuth_deg - 30.0).abs() < 1e-9, "{angles:?}");
    let (_, brighter) = towards(&moved.lights[1]);
    assert!((brighter - 0.1f64.exp()).abs() < 1e-12);
}

/// What lights share makes their priors hang together: a turn of the stage about z moves
/// azimuths alike, a common scale all intensities.
#[test]
fn shared_errors_correlate_the_prior() {
    let described = bowl(16, 8, &[[0.0, 45.0], [90.0, 45.0]]);
    let priors = BenchPriors {
        light_rad: 0.003,
        stage_rad: 0.01,
        intensity: 0.01,
        common_intensity: 1.0,
        ..priors()
    };
    let bench = Nuisance::new(&described, &priors);
    let root = bench.prior_root();
    let covariance = root * root.transpose();
    let at = |parameter: Parameter| {
        let found = bench.parameters().iter().position(|p| *p == parameter);
        found.unwrap()
    };
    let (a, b) = (at(Parameter::Intensity(0)), at(Parameter::Intensity(1)));
    assert!((covariance[(a, b)] - 1.0).abs() < 1e-9);
    assert!((covariance[(a, a)] - 1.0001).abs() < 1e-9);
    let (a, b) = (
        at(Parameter::LightAzimuth(0)),
        at(Parameter::LightAzimuth(1)),
    );
    // d × e has the z part cos 45° for each; the rest is across each other.
    assert!((covariance[(a, b)] - 0.5e-4).abs() < 1e-12);
    assert!((bench.prior_deviation(a).powi(2) - (9e-6 + 1e-4)).abs() < 1e-12);
}

/// A measured pose brings its covariance in place of the described deviations, whatever
/// those are; the rest stays.
#[test]
fn a_measured_pose_is_the_prior() {
    let described = bowl(16, 8, &[[0.0, 45.0]]);
    let mut measured = [[0.0; 6]; 6];
    for (k, row) in measured.iter_mut().enumerate() {
        row[k] = 1e-4 * (k + 1) as f64;
    }
    (measured[0][4], measured[4][0]) = (5e-5, 5e-5);
    let priors = BenchPriors {
        translation_mm: 0.0,
        pose_covariance: Some(measured),
        ..priors()
    };
    let bench = Nuisance::new(&described, &priors);
    let at = |parameter: Parameter| {
        let found = bench.parameters().iter().position(|p| *p == parameter);
        found.unwrap()
    };
    let covariance = bench.prior_root() * bench.prior_root().transpose();
    let (turn, way) = (
        at(Parameter::Rotation(Axis::X)),
        at(Parameter::Translation(Axis::Y)),
    );
    assert!((covariance[(turn, turn)] - 1e-4).abs() < 1e-15);
    assert!((covariance[(turn, way)] - 5e-5).abs() < 1e-15);
    assert!((bench.prior_deviation(way).powi(2) - 5e-4).abs() < 1e-15);
    assert!((bench.prior_deviation(at(Parameter::LightAzimuth(0))) - 0.01).abs() < 1e-15);
}

/// Derivative images against central differences of the plain renderer with other paths
/// and another step, as sums over the image with three patterns. The noise of a sum is
/// taken from the difference of the halves in every pixel, that of the renders from
/// three of them; 5 deviations, and 3% for the other step, over 3 patterns × 16 columns.
#[test]
fn derivatives_are_those_of_independent_renders() {
    let size = 12;
    let described = bowl(64, size, &[[20.0, 60.0], [200.0, 75.0]]);
    let bench = Nuisance::new(&described, &priors());
    let values = DVector::zeros(bench.parameters().len());
    let brdf = material();
    let inside = |pixel: usize| {
        let [x, y] = [pixel % size, pixel / size].map(|i| i as f64 + 0.5 - size as f64 / 2.0);
        x.hypot(y) < 0.33 * size as f64
    };
    let wanted: Vec<bool> = (0..size * size).map(inside).collect();
    let options = DerivativeOptions {
        samples_per_half: 48,
        max_reflections: 4,
        seed: 11,
        proposal: Proposal::resembling(&brdf, 0.2),
        steering: Steering::default(),
        direct_strata: 8,
        average: 0.0,
    };
    let cells = Cells::of_pixels([size; 2]);
    let images = DerivativeImages::trace(&bench, &values, &cells, &brdf, &wanted, &options);
    let patterns: [fn(f64, f64) -> f64; 3] = [|_, _| 1.0, |x, _| x, |_, y| y];
    let sum = |pattern: fn(f64, f64) -> f64, value: &dyn Fn(usize) -> f64| -> f64 {
        let pixels = (0..size * size).filter(|&p| wanted[p]);
        pixels
            .map(|p| {
                let [x, y] = [p % size, p / size].map(|i| i as f64 / size as f64 - 0.46);
                pattern(x, y) * value(p)
            })
            .sum()
    };
    let render_at = |values: &DVector<f64>, seed: u64| -> Vec<RadianceImage> {
        let options = RenderOptions {
            samples_per_pixel: 96,
            max_reflections: 4,
            seed,
            proposal: options.proposal.clone(),
            ..RenderOptions::default()
        };
        render(&bench.scene(values), &brdf, &options)
    };
    let mut compared = 0;
    for (k, parameter) in bench.parameters().iter().enumerate() {
        if !parameter.is_geometric() {
            continue;
        }
        let step = 0.8 * bench.prior_deviation(k);
        let renders = [5, 6, 7].map(|seed| {
            [step, -step].map(|step| {
                let mut moved = values.clone();
                moved[k] += step;
                render_at(&moved, seed)
            })
        });
        for light in 0..2 {
            let at = |pixel: usize, half: usize| {
                let found = images.at(pixel).find(|(p, l, _)| (*p, *l) == (k, light));
                found.map(|(_, _, value)| f64::from(value.halves[half][1]))
            };
            if at(wanted.iter().position(|&w| w).unwrap(), 0).is_none() {
                continue;
            }
            for pattern in patterns {
                let halves = [0, 1].map(|h| sum(pattern, &|p| at(p, h).unwrap()));
                let found = renders.each_ref().map(|[above, below]| {
                    sum(pattern, &|p| {
                        let difference = above[light].mean[p][1] - below[light].mean[p][1];
                        f64::from(difference) / (2.0 * step)
                    })
                });
                // Few paths jump over an edge, but those count much: the spread of the
                // renders has more information on that than any pixel's.
                let expected = found.iter().sum::<f64>() / 3.0;
                let spread = found
                    .iter()
                    .fold(0.0f64, |s, f| s.max((f - expected).abs()));
                let mean = 0.5 * (halves[0] + halves[1]);
                let square = sum(|_, _| 1.0, &|p| {
                    let [x, y] = [p % size, p / size].map(|i| i as f64 / size as f64 - 0.46);
                    (0.5 * pattern(x, y) * (at(p, 0).unwrap() - at(p, 1).unwrap())).powi(2)
                });
                let noise = (2.0 * square).sqrt();
                assert!(
                    (mean - expected).abs() <= 5.0 * noise + 3.0 * spread + 0.03 * expected.abs(),
                    "{parameter}, light {light}: {mean} ± {noise}, expected {expected}"
                );
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 3 * (4 + 6 * 2));
}

#[test]
fn a_step_follows_the_images_where_they_tell_and_the_prior_elsewhere() {
    let described = bowl(16, 8, &[[20.0, 60.0]]);
    let bench = Nuisance::new(&described, &priors());
    let n = bench.parameters().len();
    // Sure of the first parameter, silent on all others.
    let mut information = DMatrix::zeros(n, n);
    let sigma = bench.prior_deviation(0);
    information[(0, 0)] = 99.0 / (sigma * sigma);
    let spectrum = Spectrum::new(&bench, &information);
    let truth = 0.5 * sigma;
    let mut score = DVector::zeros(n);
    score[0] = information[(0, 0)] * truth;
    let mut values = DVector::from_element(n, 0.0);
    values[n - 1] = 0.1;
    let step = spectrum.step(&values, &score);
    assert!((step[0] - 0.99 * truth).abs() < 1e-9 * sigma);
    assert!((step[n - 1] + 0.1).abs() < 1e-12, "back to the prior");
    let deviations = spectrum.deviations();
    assert!((deviations[0] - 0.1 * sigma).abs() < 1e-9 * sigma);
    assert!((deviations[3] - bench.prior_deviation(3)).abs() < 1e-12);
    assert_eq!(spectrum.fixed(&bench).len(), n - 1);
    // Scores that scatter a hundred times as much as noise would are believed that much less.
    let mut outlying = DVector::zeros(n);
    outlying[0] = (100.0 * information[(0, 0)]).sqrt();
    let widened = spectrum.clone().widened(&[outlying], 1.0);
    assert!((widened.deviations()[0] / sigma - (1.0f64 / 1.99).sqrt()).abs() < 1e-6);
    // What scatters no more than noise is still believed a third.
    let calm = spectrum.widened(&[], 3.0);
    assert!((calm.deviations()[0] / sigma - 1.0 / 34f64.sqrt()).abs() < 1e-6);
}

/// Scores that answer half as much as their information says leave (1 + λ) / (1 + λ/2)² of the
/// prior's variance where they left 1 / (1 + λ); as much, the same; the wrong way round, no more
/// than another draw of the prior.
#[test]
fn what_the_scores_answer_decides_what_is_known() {
    let bench = Nuisance::new(&bowl(16, 8, &[[20.0, 60.0]]), &priors());
    let n = bench.parameters().len();
    let sigma = bench.prior_deviation(0);
    let mut information = DMatrix::zeros(n, n);
    information[(0, 0)] = 24.0 / (sigma * sigma);
    let spectrum = Spectrum::new(&bench, &information);
    let known = |part: f64| {
        let answering = spectrum.sandwich(&(part * &information));
        let deviations = answering.deviations();
        assert!((deviations[3] - bench.prior_deviation(3)).abs() < 1e-12);
        assert_eq!(answering.fixed(&bench).len(), n - 1);
        deviations[0] / sigma
    };
    assert!((known(1.0) - 0.2).abs() < 1e-9);
    assert!((known(0.5) - 5.0 / 13.0).abs() < 1e-9);
    let wrong = spectrum.sandwich(&(-0.03 * &information)).deviations();
    assert!((wrong[0] / sigma - 2f64.sqrt()).abs() < 1e-9);
}

/// Images of a bench at `values`: another mesh and other paths than the fit's, 1% noise.
fn captured(fine: &Scene, values: &DVector<f64>, brdf: &Mixture) -> Vec<RadianceImage> {
    let options = RenderOptions {
        samples_per_pixel: 768,
        max_reflections: 8,
        seed: 77,
        proposal: Proposal::resembling(brdf, 0.2),
        ..RenderOptions::default()
    };
    let scene = Nuisance::new(fine, &priors()).scene(values);
    let mut images = render(&scene, brdf, &options);
    let mut numbers = stream(3, Purpose::Experiment, 0, 0, 0);
    for image in &mut images {
        for (mean, variance) in image.mean.iter_mut().zip(&mut image.variance) {
            for (mean, variance) in mean.iter_mut().zip(variance) {
                let sigma = 0.01 * *mean;
                *variance += sigma * sigma;
                *mean += sigma * numbers.normal() as f32;
            }
        }
    }
    images
}

fn options() -> FitOptions {
    let mut options = FitOptions {
        channels: Channels::Shared,
        model_error: 0.005,
        posterior_samples: 60,
        ..FitOptions::default()
    };
    options.cache.samples_per_cell = 192;
    options.cache.max_reflections = 8;
    options
}

const LIGHTS: [[f64; 2]; 3] = [[20.0, 80.0], [110.0, 60.0], [250.0, 70.0]];

fn refined(values: &DVector<f64>, size: usize) -> (RefinedBench, Captured, Mixture) {
    let brdf = material();
    let described = bowl(96, size, &LIGHTS);
    let images = captured(&bowl(128, size, &LIGHTS), values, &brdf);
    let images = Captured::new(&described, &images, &CellOptions::exact()).unwrap();
    let how = RefineOptions {
        rounds: 4,
        times_paths: 1,
        ..RefineOptions::default()
    };
    let result = refine_bench(
        &described,
        &images,
        brdf.dictionary(),
        &options(),
        &priors(),
        &how,
        &(),
    );
    (result.unwrap(), images, brdf)
}

/// On a bench that is as described, nothing moves by more than 3.5 of its stated
/// deviations (15 parameters), and what a bowl under a telecentric camera leaves open is
/// fixed and named.
#[test]
fn a_known_bench_stays_and_a_bowl_does_not_tell_depth_or_its_turn() {
    let n = 3 * 2 + 3 + 6;
    let (refined, ..) = refined(&DVector::zeros(n), 16);
    let estimate = &refined.estimate;
    assert_eq!(estimate.parameters.len(), n);
    for p in &estimate.parameters {
        assert!(p.value.abs() < 3.5 * p.deviation, "{p:?}");
        // But for noise of how the scores answer.
        assert!(p.deviation <= 1.001 * p.prior_deviation, "{p:?}");
    }
    for name in ["rotation about z", "translation along z"] {
        assert!(
            estimate.fixed.iter().any(|fixed| fixed == name),
            "{name} is not among {:?}",
            estimate.fixed
        );
    }
}

/// Lights that are off by about their prior come back closer, within what is stated; the
/// samples know what the bench leaves open.
#[test]
fn misplaced_lights_come_back() {
    let (size, off) = (20, 0.012);
    let mut truth = DVector::zeros(15);
    for (k, sign) in [1.0, -1.0, 1.0, 1.0, -1.0, -1.0].into_iter().enumerate() {
        truth[k] = sign * off;
    }
    (truth[6], truth[7], truth[8]) = (0.02, -0.03, 0.01);
    let (refined, images, brdf) = refined(&truth, size);
    let estimate = &refined.estimate;
    let rms = |of: &dyn Fn(usize) -> f64, range: std::ops::Range<usize>| {
        let count = range.len() as f64;
        (range.map(|k| of(k).powi(2)).sum::<f64>() / count).sqrt()
    };
    let error = |k: usize| estimate.parameters[k].value - truth[k];
    assert!(rms(&error, 0..6) < 0.75 * off, "{estimate:?}");
    let z = |k: usize| error(k) / estimate.parameters[k].deviation;
    assert!(rms(&z, 0..15) < 2.0, "{estimate:?}");
    // The spread of the reflectance, over samples with the bench's share and without.
    let plain = fit(&refined.scene, &images, brdf.dictionary(), &options()).unwrap();
    let angles = [10.0f64, 30.0, 50.0].map(f64::to_radians);
    let cells: Vec<Vec<f64>> = angles
        .iter()
        .flat_map(|&theta_h_rad| {
            angles.map(|theta_d_rad| HalfDifference {
                theta_h_rad,
                theta_d_rad,
                phi_d_rad: std::f64::consts::FRAC_PI_2,
            })
        })
        .filter_map(|cell| {
            let (to_light, to_viewer) = cell.to_directions();
            let at = Cosines::new(to_light.to_array(), to_viewer.to_array())?;
            let atoms = brdf.dictionary().atoms();
            Some(atoms.iter().map(|atom| atom.eval(&at)).collect())
        })
        .collect();
    let spread = |posterior_samples: &[crate::inverse::uncertainty::PosteriorSamples]| {
        let relative = |atoms: &Vec<f64>| {
            let f = |x: &DVector<f64>| -> f64 { x.iter().zip(atoms).map(|(w, f)| w * f).sum() };
            let values: Vec<f64> = posterior_samples[0].posterior.iter().map(f).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let square = values.iter().map(|v| (v / mean - 1.0).powi(2));
            square.sum::<f64>() / values.len() as f64
        };
        (cells.iter().map(relative).sum::<f64>() / cells.len() as f64).sqrt()
    };
    let on_refined = refined.fit(brdf.dictionary(), &options(), &()).unwrap();
    let [with, without] = [&on_refined.posterior_samples, &plain.posterior_samples]
        .map(|posterior_samples| spread(posterior_samples));
    assert!(
        with > without,
        "{with} with the bench's share, {without} without"
    );
}
