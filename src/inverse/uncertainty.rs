//! What the images leave open: draws from an approximate posterior of the weights.
//!
//! Around the fit the log-likelihood is −½ (x−ŵ)ᵀ F (x−ŵ) with the information F.
//! Each draw perturbs the data term by a random score z and the prior's centre x₀,
//! and minimises over the simplex exactly (randomise-then-optimise, Bardsley et al.
//! 2014): weights at the boundary get the right one-sided spread. Model error is
//! correlated between neighbouring pixels, so z is a wild bootstrap over the scores
//! of blocks of pixels (a block sandwich), widened to F where the blocks show less
//! than the noise alone would.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rayon::prelude::*;

use super::bench::BenchCoupling;
use super::objective::Linearised;
use super::simplex::{self, SimplexError};
use crate::random::{Purpose, Stream, stream};

/// Draws of one set of weights, and of the prior alone.
pub struct Draws {
    /// Posterior draws, each on the simplex.
    pub posterior: Vec<DVector<f64>>,
    /// Prior draws, each on the simplex.
    pub prior: Vec<DVector<f64>>,
}

/// Concentration of the Dirichlet prior: sparse mixtures, about six atoms of 42.
pub(super) const CONCENTRATION: f64 = 0.15;

/// Draws `count` weights for each set around `mixture`; `bench` is what an uncertain
/// bench adds to their spread.
pub fn draw(
    mixture: &[DVector<f64>],
    pass: &Linearised,
    bench: Option<&BenchCoupling>,
    count: usize,
    seed: u64,
) -> Result<Vec<Draws>, SimplexError> {
    (0..mixture.len())
        .map(|set| draw_set(&mixture[set], pass, bench, set, count, seed))
        .collect()
}

fn draw_set(
    mixture: &DVector<f64>,
    pass: &Linearised,
    bench: Option<&BenchCoupling>,
    set: usize,
    count: usize,
    seed: u64,
) -> Result<Draws, SimplexError> {
    let n = mixture.len();
    let (information, root) = positive_part(&pass.information[set]);
    let prior_precision = {
        let total = CONCENTRATION * n as f64;
        let share = 1.0 / n as f64;
        (total + 1.0) / (share * (1.0 - share))
    };
    let mut h = information.clone();
    for k in 0..n {
        h[(k, k)] += prior_precision;
    }
    let scores = &pass.block_scores[set];
    let noise_variance = information.diagonal();
    let mut block_variance = DVector::<f64>::zeros(n);
    for score in scores {
        block_variance += score.component_mul(score);
    }
    // The larger of the two, by total scaled variance.
    let ratio = {
        let total: f64 = noise_variance
            .iter()
            .zip(block_variance.iter())
            .filter(|(noise, _)| **noise > 0.0)
            .map(|(noise, block)| block / noise)
            .sum();
        total / n as f64
    };
    let (posterior, prior) = (0..count)
        .into_par_iter()
        .map(|index| {
            let mut numbers = stream(seed, Purpose::Posterior, set as u64, 0, index as u64);
            let centre = dirichlet(n, &mut numbers);
            let mut score = if ratio > 1.0 {
                let mut z = DVector::<f64>::zeros(n);
                for score in scores {
                    z.axpy(numbers.normal(), score, 1.0);
                }
                z
            } else {
                let normal = DVector::from_fn(n, |_, _| numbers.normal());
                &root * normal
            };
            if let Some(bench) = bench {
                score += bench.score(set, seed, index as u64);
            }
            // ½ (x−ŵ)ᵀF(x−ŵ) − zᵀx + ½ p ‖x−x₀‖²
            let g = &information * mixture + score + &centre * prior_precision;
            Ok((simplex::solve(&h, &g, Some(mixture))?.x, centre))
        })
        .collect::<Result<Vec<_>, SimplexError>>()?
        .into_iter()
        .unzip();
    Ok(Draws { posterior, prior })
}

/// The nearest positive semidefinite matrix and a root R with R Rᵀ equal to it.
fn positive_part(matrix: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
    let eigen = SymmetricEigen::new(matrix.clone());
    let values = eigen.eigenvalues.map(|v| v.max(0.0));
    let root = &eigen.eigenvectors * DMatrix::from_diagonal(&values.map(f64::sqrt));
    (&root * root.transpose(), root)
}

/// One draw of a symmetric Dirichlet distribution.
pub(super) fn dirichlet(n: usize, numbers: &mut Stream) -> DVector<f64> {
    // Γ(a) for a < 1 is Γ(a + 1) · U^(1/a); in logarithms, so that tiny ones survive.
    let logs: Vec<f64> = (0..n)
        .map(|_| {
            gamma_above_one(CONCENTRATION + 1.0, numbers).ln()
                + (1.0 - numbers.uniform()).ln() / CONCENTRATION
        })
        .collect();
    let largest = logs.iter().fold(f64::NEG_INFINITY, |m, &v| m.max(v));
    let x = DVector::from_iterator(n, logs.iter().map(|l| (l - largest).exp()));
    let sum = x.sum();
    x / sum
}

/// Gamma variate of shape ≥ 1 (Marsaglia & Tsang 2000).
fn gamma_above_one(shape: f64, numbers: &mut Stream) -> f64 {
    let d = shape - 1.0 / 3.0;
    let c = 1.0 / (9.0 * d).sqrt();
    loop {
        let x = numbers.normal();
        let v = (1.0 + c * x).powi(3);
        if v > 0.0 && (1.0 - numbers.uniform()).ln() < 0.5 * x * x + d - d * v + d * v.ln() {
            return d * v;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean 1/n and variance (1/n)(1 − 1/n)/(a n + 1) of a symmetric Dirichlet.
    #[test]
    fn dirichlet_has_its_moments() {
        let n = 10;
        let mut numbers = stream(1, Purpose::Posterior, 0, 0, 0);
        let count = 40_000;
        let (mut sum, mut square) = (0.0, 0.0);
        for _ in 0..count {
            let x = dirichlet(n, &mut numbers);
            assert!((x.sum() - 1.0).abs() < 1e-12);
            sum += x[3];
            square += x[3] * x[3];
        }
        let mean = sum / f64::from(count);
        let variance = square / f64::from(count) - mean * mean;
        let expected = 0.1 * 0.9 / (CONCENTRATION * n as f64 + 1.0);
        assert!(
            (mean - 0.1).abs() < 5.0 * (expected / f64::from(count)).sqrt(),
            "mean {mean}"
        );
        assert!(
            (variance / expected - 1.0).abs() < 0.06,
            "variance {variance} for {expected}"
        );
    }
}
