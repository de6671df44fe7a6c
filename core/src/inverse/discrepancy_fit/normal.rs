//! The normal equations of weights and discrepancy together.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::LinearizationPoint;
use crate::inverse::normal_equations::{NormalEquations, NormalSums, Scores, Signal};
use crate::inverse::objective::Value;

/// Normal equations of one channel group: N weights x, then the M free modes z.
pub(super) struct Joint {
    /// Number of weights.
    pub weights: usize,
    /// F, above Monte Carlo noise.
    pub information: DMatrix<f64>,
    /// Of all cells.
    pub score: DVector<f64>,
    /// By block of cells.
    pub blocks: Vec<DVector<f64>>,
    /// Removes noise from scores.
    projector: DMatrix<f64>,
}

impl Joint {
    fn new(equations: &NormalEquations, free: &DMatrix<f64>, weights: usize) -> Self {
        let map = onto_free(weights, free);
        let free = |matrix: &DMatrix<f64>| map.tr_mul(matrix) * &map;
        let signal = Signal::new(&free(&equations.information), &free(&equations.full));
        let blocks = equations.scores.each(|s| &signal.projector * map.tr_mul(s));
        let none = DVector::zeros(map.ncols());
        Self {
            weights,
            information: signal.information,
            score: blocks.iter().fold(none, |sum, s| sum + s),
            blocks,
            projector: signal.projector,
        }
    }

    /// F_xx, F_xz and F_zz.
    pub fn parts(&self) -> [DMatrix<f64>; 3] {
        let (n, m) = (self.weights, self.score.len() - self.weights);
        let part = |from, shape| self.information.view(from, shape).into_owned();
        [
            part((0, 0), (n, n)),
            part((0, n), (n, m)),
            part((n, n), (m, m)),
        ]
    }

    /// (F_zz + Λ)⁻¹ for modes of this amplitude, in images whose noise counts as this many times
    /// its variance.
    pub fn covariance(&self, amplitude: f64, noise_inflation: f64) -> DMatrix<f64> {
        let [.., modes] = self.parts();
        let m = modes.nrows();
        let prior = DMatrix::identity(m, m) * (noise_inflation / (amplitude * amplitude));
        Cholesky::new(modes + prior).map_or_else(|| DMatrix::zeros(m, m), |root| root.inverse())
    }
}

/// (x, z) ↦ (x, `free` z).
fn onto_free(weights: usize, free: &DMatrix<f64>) -> DMatrix<f64> {
    let mut map = DMatrix::zeros(weights + free.nrows(), weights + free.ncols());
    map.fill_diagonal(1.0);
    let (rows, columns) = free.shape();
    map.view_mut((weights, weights), (rows, columns))
        .copy_from(free);
    map
}

/// The equations of each group with its `free` modes.
pub(super) fn equations(at: &LinearizationPoint<'_>, free: &[DMatrix<f64>]) -> Vec<Joint> {
    let k = at.objective.atoms() + at.prior.modes().ncols();
    let equations = over_values(
        at,
        || NormalSums::zero(k),
        |sums, value, rows| sums.add(value.block, value.weight, rows, value.residual),
        |total, part| total.join(part),
    );
    let equations = equations.into_iter().map(NormalSums::equations);
    let groups = equations.zip(free);
    groups
        .map(|(equations, free)| Joint::new(&equations, free, at.objective.atoms()))
        .collect()
}

/// Sets the scores by block of cells to those of the residual that small discrepancies (values
/// of all modes, per group) leave.
pub(super) fn blocks_after(
    at: &LinearizationPoint<'_>,
    discrepancies: &[DVector<f64>],
    free: &[DMatrix<f64>],
    joint: &mut [Joint],
) {
    let n = at.objective.atoms();
    let scores = over_values(
        at,
        || Scores::zero(n + at.prior.modes().ncols()),
        |sums, value, rows| {
            let discrepancy = &discrepancies[value.group];
            let residual = [0, 1].map(|half| {
                let change = rows[half][n..].iter().zip(discrepancy.iter());
                value.residual[half] - change.map(|(d, z)| d * z).sum::<f64>()
            });
            sums.add(value.block, value.weight, rows, residual);
        },
        |total, part| total.join(&part),
    );
    for ((joint, scores), free) in joint.iter_mut().zip(scores).zip(free) {
        let map = onto_free(n, free);
        joint.blocks = scores.each(|s| &joint.projector * map.tr_mul(s));
    }
}

/// Sums per group over the values with the derivatives by the weights and all modes.
fn over_values<T: Send>(
    at: &LinearizationPoint<'_>,
    zero: impl Fn() -> T + Sync,
    visit: impl Fn(&mut T, &Value<'_>, [&[f64]; 2]) + Sync,
    join: impl Fn(&mut T, T),
) -> Vec<T> {
    at.objective.accumulate(
        at.mixture,
        at.residual_weights,
        Some(at.prior.modes()),
        || at.mixture.iter().map(|_| zero()).collect::<Vec<_>>(),
        |sums, value| {
            let direct = at.direct.by_modes(value.cell, value.light, value.channel);
            let rows = [0, 1].map(|half| {
                let both = value.by_modes[half].iter().zip(direct);
                let by_modes = both.map(|(&i, &d)| f64::from(i) + value.direct * f64::from(d));
                let by_weights = value.by_weights[half].iter().copied();
                by_weights.chain(by_modes).collect::<Vec<f64>>()
            });
            let rows = rows.each_ref().map(Vec::as_slice);
            visit(&mut sums[value.group], value, rows);
        },
        |total, part| {
            for (total, part) in total.iter_mut().zip(part) {
                join(total, part);
            }
        },
    )
}
