//! How much the images ask for a discrepancy.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::normal::Normal;
use crate::inverse::uncertainty::LEAST_SPREAD;

/// Log probability that the images must gain by a discrepancy.
const LEAST_GAIN: f64 = 3.0;

/// The amplitude under which the images are most probable, all sets together, with the
/// weights in use free to follow the discrepancy; 0 where little is gained by any.
pub(super) fn amplitude(normal: &[Normal], mixture: &[DVector<f64>]) -> f64 {
    // Per direction that the images tell apart: information and squared score, in units of
    // the score's own scatter.
    let mut directions = Vec::new();
    for (normal, mixture) in normal.iter().zip(mixture) {
        let n = mixture.len();
        let used: Vec<usize> = (0..n).filter(|&k| mixture[k] > 0.0).collect();
        let Some((&last, others)) = used.split_last() else {
            continue;
        };
        // Steps that keep the sum of the weights.
        let tangent = DMatrix::from_fn(n, others.len(), |row, column| {
            f64::from(i8::from(row == others[column]) - i8::from(row == last))
        });
        let own = tangent.tr_mul(&normal.information) * &tangent;
        let own = own + DMatrix::identity(others.len(), others.len());
        let coupling = tangent.tr_mul(&normal.coupling);
        let Some(root) = Cholesky::new(own) else {
            continue;
        };
        let follow = root.solve(&coupling);
        let left = &normal.discrepancy - coupling.tr_mul(&follow);
        let eigen = (0.5 * (&left + left.transpose())).symmetric_eigen();
        let along = |weights: &DVector<f64>, modes: &DVector<f64>| {
            let followed = follow.tr_mul(&tangent.tr_mul(weights));
            eigen.eigenvectors.tr_mul(&(modes - followed))
        };
        let score = along(&normal.scores[0], &normal.scores[1]);
        let mut scatter = DVector::zeros(score.len());
        for [weights, modes] in &normal.blocks {
            scatter += along(weights, modes).map(|v| v * v);
        }
        for m in 0..score.len() {
            let information = eigen.eigenvalues[m];
            if information > LEAST_SPREAD {
                let spread = (scatter[m] / information).max(LEAST_SPREAD);
                directions.push([information / spread, (score[m] / spread).powi(2)]);
            }
        }
    }
    let gain = |amplitude: f64| -> f64 {
        let variance = amplitude * amplitude;
        let gains = directions.iter().map(|[information, square]| {
            let seen = variance * information;
            0.5 * (variance * square / (1.0 + seen) - seen.ln_1p())
        });
        gains.sum()
    };
    let candidates = (0..24).map(|k| 0.05 * 1.15f64.powi(k));
    let best = candidates.max_by(|a, b| gain(*a).total_cmp(&gain(*b)));
    best.filter(|&amplitude| gain(amplitude) > LEAST_GAIN)
        .unwrap_or(0.0)
}
