use std::sync::Arc;

use glam::DVec3;

use super::*;
use crate::random::{Purpose, stream};
use crate::transport::Light;

/// Values of a synthetic material, its modes, and values of each light's image.
const VALUES: usize = 9;
const MODES: usize = 5;
const IMAGE: usize = 2;

/// For each material its modes and the metric of the values.
type Parts = Vec<[DMatrix<f64>; 2]>;

/// Random materials and images: the prospects, their parts, and for each material the images'
/// derivatives by the values, in units of their noise.
fn synthetic(candidates: usize) -> (Prospects, Parts, Vec<Vec<DMatrix<f64>>>) {
    let mut numbers = stream(4, Purpose::Experiment, 0, 0, 0);
    let mut matrix = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| numbers.normal());
    let (mut parts, mut images) = (Vec::new(), Vec::new());
    let materials = (0..2).map(|_| {
        let (modes, spheres) = (matrix(VALUES, MODES), matrix(12, VALUES));
        let metric = spheres.tr_mul(&spheres);
        let curvature = modes.tr_mul(&metric) * &modes;
        let of_lights: Vec<_> = (0..candidates).map(|_| matrix(IMAGE, VALUES)).collect();
        let information = of_lights.iter().map(|j| {
            let along = j * &modes;
            along.tr_mul(&along)
        });
        let prospect = Prospect {
            information: information.collect(),
            subject: Arc::new(Subject {
                name: String::new(),
                ln_f: Discrepancy::none(),
                prior: Arc::new(Prior::of_modes(modes.clone())),
                bands: std::array::from_fn(|_| curvature.clone()),
                curvature,
            }),
        };
        parts.push([modes, metric]);
        images.push(of_lights);
        prospect
    });
    let materials = materials.collect();
    let prospects = Prospects {
        candidates,
        materials,
    };
    (prospects, parts, images)
}

/// The error after some images against the regression of the values on them: Σ − Σ Jᵀ (J Σ Jᵀ + 1)⁻¹ J Σ.
#[test]
fn errors_are_those_of_the_dense_regression() {
    let (prospects, parts, images) = synthetic(7);
    let regression = |chosen: &[usize]| {
        let errors = parts.iter().zip(&images).map(|([modes, metric], images)| {
            let sigma = modes * modes.transpose();
            let rows: Vec<_> = chosen
                .iter()
                .flat_map(|&light| images[light].row_iter().map(|row| row.into_owned()))
                .collect();
            let left = match rows.is_empty() {
                true => sigma,
                false => {
                    let j = DMatrix::from_rows(&rows);
                    let noise = DMatrix::identity(j.nrows(), j.nrows());
                    let inner = (&j * &sigma * j.transpose() + noise).try_inverse().unwrap();
                    &sigma - &sigma * j.transpose() * inner * &j * &sigma
                }
            };
            metric.dot(&left).sqrt()
        });
        errors.collect::<Vec<f64>>()
    };
    for chosen in [&[][..], &[2], &[0, 3], &[6, 1, 4, 2]] {
        let expected = regression(chosen);
        let found = prospects.by_material(chosen);
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found.error / expected - 1.0).abs() < 1e-9, "{chosen:?}");
        }
        let mean = (expected[0] * expected[1]).sqrt();
        assert!((prospects.error(chosen) / mean - 1.0).abs() < 1e-9);
    }
}

#[test]
fn greedy_steps_are_the_best_single_steps_and_the_best_no_worse_than_the_plan() {
    let (prospects, ..) = synthetic(7);
    let mut chosen = Vec::new();
    for choice in prospects.greedy(&[], 3) {
        let with = |light: usize| prospects.error(&[&chosen[..], &[light]].concat());
        let left = (0..7).filter(|light| !chosen.contains(light));
        let best = left.min_by(|&a, &b| with(a).total_cmp(&with(b))).unwrap();
        assert_eq!((choice.candidate, choice.error), (best, with(best)));
        chosen.push(best);
    }
    // What is taken is not chosen again, and there are no more than there are.
    let rest = prospects.greedy(&chosen, 100);
    assert_eq!(rest.len(), 4);
    assert!(
        rest.iter()
            .all(|choice| !chosen.contains(&choice.candidate))
    );
    for count in 1..=7 {
        let best = prospects.best(count);
        let planned: Vec<usize> = (0..count).collect();
        assert_eq!(best.len(), count);
        assert!(best[count - 1].error <= prospects.error(&planned));
    }
}

fn bowl(lights: Vec<Light>) -> Scene {
    let mut scene = Scene::bowl(24, [12, 12], 2.2);
    scene.lights = lights;
    scene
}

fn choices(threads: usize) -> Vec<Choice> {
    let light = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Light::distant(DVec3::new(sin, 0.0, cos), [1.0; 3])
    };
    let lights = [
        0.0, 120.0, -30.0, 30.0, 50.0, -50.0, 10.0, -10.0, 20.0, 65.0,
    ];
    let subjects = ["green-latex", "pvc"].map(|name| Arc::new(Subject::embedded(name).unwrap()));
    let options = PredictionOptions {
        samples_per_cell: 16,
        ..PredictionOptions::default()
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| Prospects::new(bowl(lights.map(light).into()), &subjects, &options))
        .unwrap()
        .greedy(&[], 10)
}

/// Bit for bit; and the light from below, which lights nothing, comes last.
#[test]
fn the_choice_is_the_same_for_any_number_of_threads() {
    let (one, three) = (choices(1), choices(3));
    assert_eq!(one, three);
    assert_eq!(one.last().unwrap().candidate, 1);
    let falling = one
        .windows(2)
        .all(|pair| pair[1].error <= pair[0].error * (1.0 + 1e-12));
    assert!(falling && one[0].error < 0.5, "{one:?}");
}

/// A bench as described adds nothing; twice the deviation adds twice as much, and lights that are off
/// on their own add in squares.
#[test]
fn deviations_add_in_proportion() {
    let light = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Light::distant(DVec3::new(sin, 0.0, cos), [1.0; 3])
    };
    let lights = |[first, second]: [f64; 2]| vec![light(20.0 + first), light(-50.0 + second)];
    let subjects = [Arc::new(Subject::embedded("green-latex").unwrap())];
    let options = PredictionOptions {
        samples_per_cell: 512,
        ..PredictionOptions::default()
    };
    let added = |off_deg: &[[f64; 2]], by_light: bool| {
        let deviations: Vec<Deviation> = off_deg
            .iter()
            .map(|&off| Deviation {
                scene: bowl(lights(off)),
                weight: 1.0,
                by_light,
            })
            .collect();
        let described = bowl(lights([0.0; 2]));
        error_by_deviations(&described, &deviations, &subjects, &options).unwrap()[0]
    };
    assert_eq!(added(&[[0.0; 2]], false), 0.0);
    let (once, twice) = (added(&[[2.0; 2]], false), added(&[[4.0; 2]], false));
    assert!((twice / once - 2.0).abs() < 0.3, "{once} {twice}");
    let (apart, one_by_one) = (
        added(&[[4.0; 2]], true),
        added(&[[4.0, 0.0], [0.0, 4.0]], false),
    );
    assert!(
        (apart / one_by_one - 1.0).abs() < 0.1,
        "{apart} {one_by_one}"
    );
}
