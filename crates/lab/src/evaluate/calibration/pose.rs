//! Where the sample lies, by the edges that two images of it show.

use glam::DVec3;

use super::{EvaluateError, Recovered, failed};
use crate::bench_priors::BenchPriors;
use crate::calibration::pose::{PoseOptions, align};
use crate::calibration::record::Measured;
use crate::geometry::Shape;
use crate::inverse::nuisance::with_sample_at;
use crate::random::{Purpose, stream};
use crate::simulation::posed_sample::{bowl, corner, photographs, scene, telecentric};
use crate::transport::Projection;

/// A bowl, whose turn about its axis and whose depth cannot be seen.
pub(super) fn bowl_through_a_telecentric_lens(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    one(seed, bowl, telecentric())
}

/// A corner of three faces.
pub(super) fn corner_in_perspective(seed: u64) -> Result<Vec<Recovered>, EvaluateError> {
    one(seed, corner, Projection::Perspective { fov_rad: 0.13 })
}

fn one(
    seed: u64,
    shape: fn(u32) -> Shape,
    projection: Projection,
) -> Result<Vec<Recovered>, EvaluateError> {
    let priors = BenchPriors {
        light_rad: 0.1f64.to_radians(),
        rotation_rad: 0.4f64.to_radians(),
        translation_mm: 0.3,
        ..BenchPriors::default()
    };
    let mut numbers = stream(seed, Purpose::Experiment, 1, 0, 0);
    let turned_rad = [[0; 2]; 2].map(|light| light.map(|_| priors.light_rad * numbers.normal()));
    let mut vector = |s: f64| DVec3::new(numbers.normal(), numbers.normal(), numbers.normal()) * s;
    let (rotation, translation) = (vector(priors.rotation_rad), vector(priors.translation_mm));
    let described = scene(shape(64).mesh()?, projection, [[0.0; 2]; 2]);
    let truth = scene(shape(180).mesh()?, projection, turned_rad);
    let truth = with_sample_at(truth, rotation, translation);
    let options = PoseOptions {
        subsamples: 4,
        ..PoseOptions::default()
    };
    let found = align(&described, &photographs(&truth, seed), &priors, &options);
    let found = found.map_err(failed)?;
    let truth = [rotation.to_array(), translation.to_array()].concat();
    let of = |i: usize| {
        let scale = if i < 3 { 1f64.to_degrees() } else { 1.0 };
        Recovered {
            quantity: NAMES[i],
            unit: if i < 3 { "°" } else { "mm" },
            truth: 0.0,
            found: Measured {
                value: scale * (found.values[i] - truth[i]),
                std: scale * found.covariance[i][i].sqrt(),
            },
        }
    };
    Ok((0..6).map(of).collect())
}

const NAMES: [&str; 6] = [
    "sample turned about x",
    "sample turned about y",
    "sample turned about z",
    "sample moved along x",
    "sample moved along y",
    "sample moved along z",
];
