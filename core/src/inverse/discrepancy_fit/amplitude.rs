//! The amplitude of the discrepancy by empirical Bayes.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::normal::Joint;
use crate::inverse::normal_equations::{IN_USE, MIN_SCATTER, Marginal, scatter};

/// Log evidence that a discrepancy must gain over none: a Bayes factor of 20, the usual limit of
/// strong evidence.
const MIN_LOG_EVIDENCE: f64 = 3.0;

/// Largest amplitude, in units of that of measured materials. Images that are not linear ask for
/// more, and what they then get is not near enough to be linear around.
const MAX_AMPLITUDE: f64 = 1.25;

/// The amplitude of most evidence (empirical Bayes), all groups together, with the weights in
/// use free to follow the discrepancy; 0 where little is gained by any.
pub(super) fn amplitude(joint: &[Joint], mixture: &[DVector<f64>]) -> f64 {
    // Per direction of the modes: information and squared score, in units of the score's own
    // scatter.
    let mut directions = Vec::new();
    for (joint, mixture) in joint.iter().zip(mixture) {
        let n = mixture.len();
        let used: Vec<usize> = (0..n).filter(|&k| mixture[k] > IN_USE).collect();
        let Some((&last, others)) = used.split_last() else {
            continue;
        };
        // Steps that keep the sum of the weights.
        let tangent = DMatrix::from_fn(n, others.len(), |row, column| {
            f64::from(i8::from(row == others[column]) - i8::from(row == last))
        });
        let [weights, coupling, modes] = joint.parts();
        let own = tangent.tr_mul(&weights) * &tangent;
        let Some(root) = Cholesky::new(own + DMatrix::identity(others.len(), others.len())) else {
            continue;
        };
        let marginal = Marginal::new(&modes, &coupling.tr_mul(&tangent), &root.inverse());
        let eigen = marginal.information.symmetric_eigen();
        // From joint scores to scores along the directions.
        let m = modes.nrows();
        let mut along = DMatrix::zeros(n + m, m);
        along
            .rows_mut(0, n)
            .copy_from(&(&tangent * marginal.gain.transpose() * -&eigen.eigenvectors));
        along.rows_mut(n, m).copy_from(&eigen.eigenvectors);
        let score = along.tr_mul(&joint.score);
        let scatter = scatter(&along, &joint.blocks).diagonal();
        for m in 0..score.len() {
            let information = eigen.eigenvalues[m];
            if information > MIN_SCATTER {
                let spread = (scatter[m] / information).max(MIN_SCATTER);
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
    let candidates = (0..).map(|k| 0.05 * 1.15f64.powi(k));
    let candidates = candidates.take_while(|&amplitude| amplitude <= MAX_AMPLITUDE);
    let best = candidates.max_by(|a, b| gain(*a).total_cmp(&gain(*b)));
    best.filter(|&amplitude| gain(amplitude) > MIN_LOG_EVIDENCE)
        .unwrap_or(0.0)
}
