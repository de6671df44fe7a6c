//! Fig. 3: how many atoms one image of a corner can distinguish.

use std::sync::Arc;

use super::experiment::{Case, EvaluateError, Experiment, Medians, Row, Scale, Table};
use super::lab::{Lab, Sample};
use crate::brdf::discrepancy::Material;
use crate::brdf::{Dictionary, Mixture};
use crate::plot::{Axis, Chart, Figure, charts};
use crate::random::{Purpose, Stream, stream};

/// Nested random dictionaries, targets in their span.
pub static DICTIONARY_SIZE: Experiment = Experiment {
    name: "dictionary-size",
    shows: "Fig. 3: error of in-span targets against the size of nested random dictionaries, one image of the convex and of the concave corner",
    full: Scale {
        resolution_px: 48,
        samples_per_pixel: 2048,
        truth_samples_per_pixel: 8192,
        sphere_px: 64,
        azimuths: 3,
        ..Scale::NONE
    },
    quick: Scale {
        resolution_px: 16,
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        sphere_px: 24,
        azimuths: 3,
        ..Scale::NONE
    },
    cases,
    figures,
};

const SIZES: [usize; 8] = [3, 4, 6, 10, 16, 24, 32, 42];

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let trials: u64 = if lab.settings.quick { 4 } else { 20 };
    let all = lab.dictionary.len();
    let mut cases = Vec::new();
    for trial in 0..trials {
        for size in SIZES.into_iter().filter(|&n| n <= all) {
            for sample in [Sample::ConvexCorner, Sample::ConcaveCorner] {
                let key = format!("{trial}/{size}/{}", sample.name());
                cases.push(Case::new(key, move |lab: &Lab| {
                    let row = Row::new()
                        .with("trial", trial)
                        .with("atoms", size)
                        .with("shape", sample.name());
                    Ok(vec![row.and(one(lab, trial, size, sample)?)])
                }));
            }
        }
    }
    Ok(cases)
}

fn one(lab: &Lab, trial: u64, size: usize, sample: Sample) -> Result<Row, EvaluateError> {
    let key = |what| stream(lab.settings.seed, Purpose::Experiment, trial, what, 3);
    let atoms = &permutation(lab.dictionary.len(), &mut key(0))[..size];
    let part = atoms.iter().map(|&k| lab.dictionary.atoms()[k]).collect();
    let part = Arc::new(Dictionary::new(format!("{size} atoms"), part)?);
    let truth = Mixture::grey(part.clone(), dirichlet(size, &mut key(size as u64)))?;

    let lights = sample.lights(1);
    let captured = lab.capture(sample, &lights, &truth)?;
    let scene = sample.scene(lab.settings.resolution_px, lights)?;
    let estimate = lab.fit_with(&scene, &captured, &part, &lab.fit_options())?;

    // In terms of the whole dictionary, whose spheres are known.
    let material = estimate.fit.material;
    let whole = material.mixture.weights().each_ref().map(|weights| {
        let mut whole = vec![0.0; lab.dictionary.len()];
        for (&atom, &weight) in atoms.iter().zip(weights) {
            whole[atom] = weight;
        }
        whole
    });
    let whole = Material {
        mixture: Mixture::new(lab.dictionary.clone(), whole)?,
        discrepancies: material.discrepancies,
    };
    let figures = lab.score(&whole, &truth);
    Ok(Row::new()
        .with("environment_error", figures.environment)
        .with("brdf_error", figures.brdf)
        .with("cube_root_error", figures.cube_root))
}

/// 0..n in random order (Fisher and Yates).
fn permutation(n: usize, numbers: &mut Stream) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, (numbers.uniform() * (i + 1) as f64) as usize);
    }
    order
}

/// Uniform on the simplex.
fn dirichlet(n: usize, numbers: &mut Stream) -> Vec<f64> {
    let mut weights: Vec<f64> = (0..n).map(|_| -(1.0 - numbers.uniform()).ln()).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    weights
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let sizes = table.numbers("atoms");
    let ticks = sizes.iter().map(|n| (n.log2(), format!("{n}"))).collect();
    let errors = Medians {
        table,
        column: "environment_error",
        x_column: "atoms",
        x: &sizes,
        position: f64::log2,
    };
    let series = [Sample::ConvexCorner, Sample::ConcaveCorner]
        .map(Sample::name)
        .into_iter()
        .enumerate()
        .map(|(color, shape)| errors.series(shape, color, |row| row.text("shape") == shape));
    Ok(vec![charts(
        "dictionary-size",
        1,
        &[Chart {
            title: "median over targets in the dictionary's span".to_owned(),
            x: Axis::with_ticks(1.45..5.55, ticks, "atoms of the dictionary"),
            y: Axis::decades(-3.5..0.5, "environment error (relative)"),
            series: series.collect(),
        }],
    )])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_are_permutations_and_mixtures() {
        let mut numbers = stream(1, Purpose::Experiment, 0, 0, 0);
        let mut order = permutation(42, &mut numbers);
        assert_ne!(order, (0..42).collect::<Vec<_>>());
        order.sort_unstable();
        assert_eq!(order, (0..42).collect::<Vec<_>>());
        let weights = dirichlet(5, &mut numbers);
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(weights.iter().all(|&w| w > 0.0));
    }
}
