//! How much the images really say about the pose: by how much the score falls over a step.
//!
//! JᵀWJ promises too much where parameters make up for each other, as when a bowl turns
//! together with the lights: its derivatives are smoothed by their steps, each parameter's by
//! another width, and noisy by their rays, so that what is left of them there is mostly their
//! own error. Bowls under four lights had rotations of ±0.01° that were 0.4° off.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};

use super::patches::{Eliminated, PatchEquations};
use crate::inverse::nuisance::Nuisance;

/// Information about a direction, in units of the prior's, below which it is as none.
const LEAST: f64 = 1e-6;

/// By how much the score falls as the parameters rise, P × P, symmetric, measured over a
/// step along each direction of the pose; at most the information. `patches` are the
/// equations at the present values, `step_of` is the length of a step along a direction, and
/// `moved` the equations after a change of the parameters, weighted as `patches`.
pub fn slope(
    bench: &Nuisance,
    patches: &[PatchEquations],
    step_of: impl Fn(&DVector<f64>) -> f64,
    moved: impl Fn(&DVector<f64>) -> Vec<PatchEquations>,
) -> DMatrix<f64> {
    let n = bench.parameters().len();
    let eliminated = Eliminated::new(patches, n);
    let directions = directions(bench, &eliminated.information);
    // Equally weighted at both ends of a step.
    let fall = |along: &DVector<f64>| {
        let step = step_of(along);
        let [after, before] = [step, -step].map(|step| {
            let patches = moved(&(along * step));
            let zero = DVector::zeros(n);
            patches
                .iter()
                .fold(zero, |sum, p| sum + eliminated.score(p))
        });
        (before - after) / (2.0 * step)
    };
    // In the directions' coordinates, of which lights keep what they have of their own.
    let mut slope = directions.tr_mul(&eliminated.information) * &directions;
    let pose = bench.of_light(None);
    let promised = DVector::from_iterator(
        pose.len(),
        pose.iter().map(|&k| slope[(k, k)].max(LEAST).sqrt()),
    );
    let columns: Vec<DVector<f64>> = pose
        .iter()
        .map(|&k| directions.tr_mul(&fall(&directions.column(k).into())))
        .collect();
    let kept = DMatrix::from_fn(pose.len(), pose.len(), |i, j| {
        let [fall, same] = [columns[j][pose[i]], columns[i][pose[j]]];
        0.5 * (fall + same) / (promised[i] * promised[j])
    })
    .symmetric_eigen();
    // No more than was promised: a step's noise must not add.
    let part = kept.eigenvalues.map(|v| v.clamp(0.0, 1.0));
    let kept = &kept.eigenvectors * DMatrix::from_diagonal(&part) * kept.eigenvectors.transpose();
    for &k in &pose {
        slope.row_mut(k).fill(0.0);
        slope.column_mut(k).fill(0.0);
    }
    for (i, &row) in pose.iter().enumerate() {
        for (j, &column) in pose.iter().enumerate() {
            slope[(row, column)] = kept[(i, j)] * promised[i] * promised[j];
        }
    }
    let Some(back) = directions.try_inverse() else {
        return eliminated.information;
    };
    let slope = back.tr_mul(&slope) * &back;
    0.5 * (&slope + slope.transpose())
}

/// Directions of the parameters, as columns: each light's own angles, and six of the pose,
/// a prior deviation long, along which the lights turn to where they fit best by `information`.
fn directions(bench: &Nuisance, information: &DMatrix<f64>) -> DMatrix<f64> {
    let parameters = bench.parameters();
    let n = parameters.len();
    let block =
        |rows: &[usize], columns: &[usize]| information.select_rows(rows).select_columns(columns);
    let pose = bench.of_light(None);
    let lights: BTreeSet<usize> = parameters.iter().filter_map(|p| p.light()).collect();
    let mut left = block(&pose, &pose);
    let mut turns = DMatrix::zeros(n, pose.len());
    for light in lights.into_iter().map(|light| bench.of_light(Some(light))) {
        let mut own = block(&light, &light);
        for (i, &k) in light.iter().enumerate() {
            own[(i, i)] += bench.prior_deviation(k).powi(-2);
        }
        let Some(turned) = own.lu().solve(&block(&light, &pose)) else {
            continue;
        };
        left -= block(&pose, &light) * &turned;
        for (i, &k) in light.iter().enumerate() {
            turns.set_row(k, &-turned.row(i));
        }
    }
    let deviations = pose.iter().map(|&k| bench.prior_deviation(k));
    let scale = DMatrix::from_diagonal(&DVector::from_iterator(pose.len(), deviations));
    let eigen = (&scale * 0.5 * (&left + left.transpose()) * &scale).symmetric_eigen();
    let vectors = scale * eigen.eigenvectors;
    for (j, &k) in pose.iter().enumerate() {
        turns[(k, j)] = 1.0;
    }
    let columns = turns * vectors;
    let mut directions = DMatrix::identity(n, n);
    for (j, &k) in pose.iter().enumerate() {
        directions.set_column(k, &columns.column(j));
    }
    directions
}
