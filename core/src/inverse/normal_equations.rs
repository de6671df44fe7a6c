//! The linear algebra that all parts of the model share: sums over compared values, the
//! rule for Monte Carlo noise, marginalisation, and the scatter of scores.
//!
//! | item | rule |
//! |---|---|
//! | [`NormalEquations`] | sym(J_Aᵀ W J_B) and ½ (J_Aᵀ W r_B + J_Bᵀ W r_A) of independent halves of the paths |
//! | [`above_noise`], [`Signal`] | an indefinite product of halves without Monte Carlo noise |
//! | [`Marginal`] | the Schur complement |
//! | [`scatter`] | the filling of a sandwich covariance: Σ s sᵀ over blocks of cells |

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::outer_products::{Products, Squares};

/// Standard deviation of a weight before any image where a Gaussian prior stands for that of
/// [`super::sparse`]. That prior's mean variance of a weight, five of 26 to 42 atoms in use, is
/// as large; it also keeps the information invertible where atoms are alike.
pub(super) const WEIGHT_PRIOR_DEVIATION: f64 = 0.06;

/// Weight above which an atom is in use: the simplex programme leaves rounding below it.
pub(super) const IN_USE: f64 = 1e-9;

/// Least variance of a score over its information where model error is common to all cells, and
/// so scatters no block: with a discrepancy, and of nuisance parameters. Calibrated by the
/// coverage of intervals of measured materials; weights without a discrepancy need 1.
pub const MIN_SCATTER: f64 = 3.0;

/// A score Jᵀ W r of K unknowns, ½ (J_Aᵀ W r_B + J_Bᵀ W r_A), and its parts by block of cells.
#[derive(Clone, Debug)]
pub(super) struct Scores {
    /// Of all values, K.
    pub total: DVector<f64>,
    /// By block of cells.
    pub blocks: BTreeMap<usize, DVector<f64>>,
}

impl Scores {
    /// Of nothing.
    pub fn zero(unknowns: usize) -> Self {
        Self {
            total: DVector::zeros(unknowns),
            blocks: BTreeMap::new(),
        }
    }

    /// Adds a value: its derivatives and its residual (captured − model), of either half.
    pub fn add(&mut self, block: usize, weight: f64, rows: [&[f64]; 2], residual: [f64; 2]) {
        let unknowns = self.total.len();
        let none = || DVector::zeros(unknowns);
        let of_block = self.blocks.entry(block).or_insert_with(none);
        let [a, b] = rows;
        for k in 0..unknowns {
            let score = 0.5 * weight * (a[k] * residual[1] + b[k] * residual[0]);
            self.total[k] += score;
            of_block[k] += score;
        }
    }

    /// Adds other sums of as many unknowns.
    pub fn join(&mut self, other: &Self) {
        self.total += &other.total;
        for (block, score) in &other.blocks {
            let none = || DVector::zeros(score.len());
            *self.blocks.entry(*block).or_insert_with(none) += score;
        }
    }

    /// `map` of each block's score.
    pub fn each(&self, map: impl FnMut(&DVector<f64>) -> DVector<f64>) -> Vec<DVector<f64>> {
        self.blocks.values().map(map).collect()
    }
}

/// Normal equations of K unknowns: sums over compared values whose factors come from
/// independent halves of the paths, so that noise in neither counts as information.
pub(super) struct NormalEquations {
    /// sym(J_Aᵀ W J_B), K × K.
    pub information: DMatrix<f64>,
    /// Jᵀ W J with J the mean of both halves, K × K: the information and the noise of J.
    pub full: DMatrix<f64>,
    /// Jᵀ W r.
    pub scores: Scores,
}

/// The same while values are added.
pub(super) struct NormalSums {
    information: Products,
    full: Squares,
    scores: Scores,
    /// Mean of a row's halves.
    row_mean: Vec<f64>,
}

impl NormalSums {
    /// Sums over nothing, of `unknowns`.
    pub fn zero(unknowns: usize) -> Self {
        Self {
            information: Products::zero(unknowns),
            full: Squares::zero(unknowns),
            scores: Scores::zero(unknowns),
            row_mean: vec![0.0; unknowns],
        }
    }

    /// Adds a value: its derivatives and its residual (captured − model), of either half.
    pub fn add(&mut self, block: usize, weight: f64, rows: [&[f64]; 2], residual: [f64; 2]) {
        let [a, b] = rows;
        for (mean, (a, b)) in self.row_mean.iter_mut().zip(a.iter().zip(b)) {
            *mean = 0.5 * (a + b);
        }
        self.full.add(weight, &self.row_mean);
        self.information.add(weight, rows);
        self.scores.add(block, weight, rows, residual);
    }

    /// Adds other sums of as many unknowns.
    pub fn join(&mut self, other: Self) {
        self.information.join(other.information);
        self.full.join(other.full);
        self.scores.join(&other.scores);
    }

    /// After the last value.
    pub fn equations(self) -> NormalEquations {
        NormalEquations {
            information: self.information.matrix(),
            full: self.full.matrix(),
            scores: self.scores,
        }
    }
}

/// `h += w · ½ (z_A x_Bᵀ + z_B x_Aᵀ)`: instruments z, derivatives x, of either half.
pub(super) fn add_cross(
    h: &mut DMatrix<f64>,
    z: &[DVector<f64>; 2],
    x: &[DVector<f64>; 2],
    w: f64,
) {
    h.ger(0.5 * w, &z[0], &x[1], 1.0);
    h.ger(0.5 * w, &z[1], &x[0], 1.0);
}

/// A symmetric matrix with its eigenvalues changed.
pub(super) fn with_eigenvalues(matrix: DMatrix<f64>, change: impl Fn(f64) -> f64) -> DMatrix<f64> {
    let eigen = SymmetricEigen::new(matrix);
    &eigen.eigenvectors
        * DMatrix::from_diagonal(&eigen.eigenvalues.map(change))
        * eigen.eigenvectors.transpose()
}

/// The rule for Monte Carlo noise. A product of independent halves has no bias, but its noise
/// makes eigenvalues of both signs alike: those no larger than the most negative one are noise.
fn noise_level(eigenvalues: &DVector<f64>) -> f64 {
    (-eigenvalues.min()).max(0.0)
}

/// A product of independent halves, without what their noise alone could have made.
pub(super) fn above_noise(product: DMatrix<f64>) -> DMatrix<f64> {
    let level = noise_level(&product.symmetric_eigenvalues());
    with_eigenvalues(product, |v| if v > level { v } else { 0.0 })
}

/// Information in the directions above Monte Carlo noise, and the projector onto them.
pub(super) struct Signal {
    pub information: DMatrix<f64>,
    /// Removes the other directions from a score.
    pub projector: DMatrix<f64>,
}

impl Signal {
    /// By the rule of [`above_noise`] in units of the noise, which is the difference between
    /// `full`, of the halves' mean, and `information`, of independent halves.
    pub fn new(information: &DMatrix<f64>, full: &DMatrix<f64>) -> Self {
        let noise = full - information;
        let eigen = SymmetricEigen::new(0.5 * (&noise + noise.transpose()));
        let largest = eigen.eigenvalues.max().max(1e-9);
        let scales = eigen
            .eigenvalues
            .map(|v| (v.max(0.0) + 1e-12 * largest + 1e-6).sqrt());
        let root = &eigen.eigenvectors * DMatrix::from_diagonal(&scales);
        let inverse = &eigen.eigenvectors * DMatrix::from_diagonal(&scales.map(|s| 1.0 / s));
        let relative = inverse.tr_mul(information) * &inverse;
        let relative = SymmetricEigen::new(0.5 * (&relative + relative.transpose()));
        let level = noise_level(&relative.eigenvalues);
        let kept: Vec<usize> = (0..relative.eigenvalues.len())
            .filter(|&k| relative.eigenvalues[k] > level)
            .collect();
        let vectors = relative.eigenvectors.select_columns(&kept);
        let values = relative.eigenvalues.select_rows(&kept);
        let root = root * &vectors;
        Self {
            information: &root * DMatrix::from_diagonal(&values) * root.transpose(),
            projector: &root * (inverse * vectors).transpose(),
        }
    }
}

/// The equations of some unknowns, others marginalised: F_aa − G F_ba and s_a − G s_b with
/// G = F_ab (F_bb + Λ_b)⁻¹.
pub(super) struct Marginal {
    /// F_aa − G F_ba, symmetric.
    pub information: DMatrix<f64>,
    /// G.
    pub gain: DMatrix<f64>,
}

impl Marginal {
    /// From F_aa, F_ab and (F_bb + Λ_b)⁻¹.
    pub fn new(own: &DMatrix<f64>, coupling: &DMatrix<f64>, inverse: &DMatrix<f64>) -> Self {
        let gain = coupling * inverse;
        let information = own - &gain * coupling.transpose();
        Self {
            information: 0.5 * (&information + information.transpose()),
            gain,
        }
    }

    /// The score s_a − G s_b, of both scores in one vector, those that stay first.
    pub fn score(&self, both: &DVector<f64>) -> DVector<f64> {
        let (own, other) = self.gain.shape();
        both.rows(0, own) - &self.gain * both.rows(own, other)
    }
}

/// Σ (`map`ᵀ s)(`map`ᵀ s)ᵀ over the blocks' scores s: their covariance where blocks of cells
/// are independent, the filling of the sandwich F⁻¹ S F⁻¹.
pub(super) fn scatter<'a>(
    map: &DMatrix<f64>,
    scores: impl IntoIterator<Item = &'a DVector<f64>>,
) -> DMatrix<f64> {
    let mut scatter = DMatrix::zeros(map.ncols(), map.ncols());
    for score in scores {
        let z = map.tr_mul(score);
        scatter.ger(1.0, &z, &z, 1.0);
    }
    scatter
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_noise_could_have_made_is_left_out() {
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, 0.7, -0.2).into_inner();
        let of = |values: [f64; 3]| {
            let m = turn * nalgebra::Matrix3::from_diagonal(&values.into()) * turn.transpose();
            DMatrix::from_fn(3, 3, |i, j| m[(i, j)])
        };
        let signal = above_noise(of([9.0, -2.0, 1.5]));
        assert!((signal - of([9.0, 0.0, 0.0])).norm() < 1e-12);
        let sure = of([9.0, 2.0, 0.5]);
        assert!((above_noise(sure.clone()) - sure).norm() < 1e-12);
    }

    /// The marginal of a Gaussian: the inverse of the kept part of the inverse.
    #[test]
    fn marginals_are_those_of_the_joint_gaussian() {
        let root = DMatrix::from_fn(5, 5, |i, j| ((3 * i + 7 * j) % 5) as f64 - 1.0);
        let joint = &root * root.transpose() + DMatrix::identity(5, 5);
        let part =
            |rows: usize, columns: usize, shape| joint.view((rows, columns), shape).into_owned();
        let inverse = part(2, 2, (3, 3)).try_inverse().unwrap();
        let marginal = Marginal::new(&part(0, 0, (2, 2)), &part(0, 2, (2, 3)), &inverse);
        let covariance = joint.clone().try_inverse().unwrap();
        let kept = covariance
            .view((0, 0), (2, 2))
            .into_owned()
            .try_inverse()
            .unwrap();
        assert!((&marginal.information - &kept).amax() < 1e-9 * kept.amax());
        // The solution of the joint system, by the marginal alone.
        let score = DVector::from_vec(vec![1.0, -2.0, 0.5, 3.0, -1.0]);
        let whole = covariance * &score;
        let own = kept.try_inverse().unwrap() * marginal.score(&score);
        assert!((whole.rows(0, 2) - own).amax() < 1e-9);
    }

    /// Noise of independent halves adds nothing on average to the information, and its
    /// variance to the product of the mean.
    #[test]
    fn independent_halves_have_no_bias() {
        use crate::random::{Purpose, stream};
        let mut numbers = stream(2, Purpose::Experiment, 0, 0, 0);
        let mut sums = NormalSums::zero(1);
        const VALUES: usize = 20_000;
        for k in 0..VALUES {
            let rows = [0, 1].map(|_| [1.0 + numbers.normal()]);
            let residual = [0, 1].map(|_| 0.3 + numbers.normal());
            sums.add(k % 7, 0.5, [&rows[0], &rows[1]], residual);
        }
        let count = VALUES as f64;
        let sums = sums.equations();
        assert!((sums.information[(0, 0)] / (0.5 * count) - 1.0).abs() < 0.05);
        assert!((sums.full[(0, 0)] / (0.5 * count) - 1.5).abs() < 0.05);
        assert!((sums.scores.total[0] / (0.5 * count) - 0.3).abs() < 0.05);
        let blocks: f64 = sums.scores.blocks.values().map(|s| s[0]).sum();
        assert!(
            sums.scores.blocks.len() == 7 && (blocks - sums.scores.total[0]).abs() < 1e-9 * count
        );
    }
}
