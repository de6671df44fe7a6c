//! How much the images say about each combination of nuisance parameters, compared with what
//! the prior knows already.
//!
//! With the prior covariance LLᵀ and the images' information S, the eigenvalues λ of LᵀSL
//! compare the two: along an eigenvector the posterior variance is 1/(1 + λ) of the prior's.
//! Combinations with a small λ keep their prior value, because the images cannot tell: depth
//! under a telecentric camera, a bowl's rotation about its axis, a shift along an extrusion,
//! intensity against albedo. None of these is listed in the code; the eigenvectors show them,
//! and [`Spectrum::fixed`] names them.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::parameters::{MIN_INFORMATION, Nuisance, Parameter};
use crate::inverse::normal_equations::scatter;

/// Longest step along one direction, in prior standard deviations; the images are not linear
/// in the parameters farther away.
const MAX_STEP: f64 = 2.0;

/// Largest ratio of an estimate's variance to the prior's. It is reached where the gradient
/// points the wrong way: the estimate then ends anywhere within the prior, independently of the
/// truth, so that the variances of both add.
const MAX_VARIANCE: f64 = 2.0;

/// Eigenvalues and directions of the information in units of the prior.
#[derive(Clone, Debug)]
pub struct Spectrum {
    /// λ of each direction; negative where the estimate is worse than the prior mean.
    pub values: DVector<f64>,
    /// By how much the images' gradient is scaled down along each direction, 0 to 1.
    attenuation: DVector<f64>,
    /// Directions as columns, in units of the prior.
    vectors: DMatrix<f64>,
    /// Lower Cholesky factor L of the prior covariance.
    root: DMatrix<f64>,
}

impl Spectrum {
    /// Of the images' information about the P parameters, P × P, after the weights have been
    /// eliminated from it.
    pub fn new(bench: &Nuisance, information: &DMatrix<f64>) -> Self {
        let root = bench.prior_root().clone();
        let eigen = SymmetricEigen::new(root.transpose() * information * &root);
        Self {
            attenuation: DVector::repeat(eigen.eigenvalues.len(), 1.0),
            values: eigen.eigenvalues.map(|v| v.max(0.0)),
            vectors: eigen.eigenvectors,
            root,
        }
    }

    /// Widens the covariance to what the gradient's scatter between blocks of pixels says (a
    /// cluster-robust covariance), because errors of the model are correlated between pixels, and
    /// the noise of the paths between lights and channels. Some of both is common to all blocks,
    /// so the scatter counts as at least `least` (1 or more) times that of independent noise.
    pub fn widened(mut self, block_scores: &[DVector<f64>], least: f64) -> Self {
        let scatter = scatter(&(&self.root * &self.vectors), block_scores).diagonal();
        for (i, &scatter) in scatter.iter().enumerate() {
            let scatter = scatter.max(least * self.values[i]);
            if scatter > 0.0 {
                self.attenuation[i] = self.values[i] / scatter;
                self.values[i] *= self.attenuation[i];
            }
        }
        self
    }

    /// The posterior where the gradient changes with the parameters by `response`, P × P, rather
    /// than by the information that this spectrum was made of. A gradient that changes less
    /// leaves the estimate, where it vanishes, farther off for the same noise.
    ///
    /// In units of the prior, with the response A, the gradient's covariance S and its scaling T
    /// (0 along fixed directions), the estimate p solves T s(p) = p, so that p − p_true has the
    /// covariance (1 + TA)⁻¹ (TST + 1) (1 + TA)⁻ᵀ. No direction gets more than `MAX_VARIANCE`.
    pub fn sandwich(&self, response: &DMatrix<f64>) -> Self {
        let n = self.values.len();
        let where_observed = |of: &DVector<f64>| {
            of.zip_map(
                &self.values,
                |own, v| if v < MIN_INFORMATION { 0.0 } else { own },
            )
        };
        let (attenuation, noise) = (
            where_observed(&self.attenuation),
            where_observed(&self.values),
        );
        let along = &self.root * &self.vectors;
        let answer = along.tr_mul(response) * &along;
        let pull = DMatrix::identity(n, n) + DMatrix::from_diagonal(&attenuation) * answer;
        let noise = DMatrix::from_diagonal(&noise.add_scalar(1.0));
        // Singular where a score answers just so that nothing holds the estimate.
        let covariance = match pull.try_inverse() {
            Some(inverse) => &inverse * noise * inverse.transpose(),
            None => MAX_VARIANCE * DMatrix::identity(n, n),
        };
        let eigen = SymmetricEigen::new(0.5 * (&covariance + covariance.transpose()));
        let variances = eigen.eigenvalues.map(|v| v.min(MAX_VARIANCE));
        Self {
            values: variances.map(|variance| 1.0 / variance - 1.0),
            attenuation: DVector::repeat(n, 1.0),
            vectors: &self.vectors * eigen.eigenvectors,
            root: self.root.clone(),
        }
    }

    /// The Gauss–Newton step from `values` by the gradient `score`, prior included. Along fixed
    /// directions it leads back to the prior mean.
    pub fn step(&self, values: &DVector<f64>, score: &DVector<f64>) -> DVector<f64> {
        let at = self.whitened(values);
        let push = self.vectors.tr_mul(&self.root.tr_mul(score));
        let step = DVector::from_fn(at.len(), |i, _| {
            if self.values[i] < MIN_INFORMATION {
                return -at[i];
            }
            let own = (self.attenuation[i] * push[i] - at[i]) / (1.0 + self.values[i]);
            own.clamp(-MAX_STEP, MAX_STEP)
        });
        &self.root * (&self.vectors * step)
    }

    /// Length of a step in posterior standard deviations, the largest over the directions.
    pub fn length(&self, step: &DVector<f64>) -> f64 {
        let along = self.whitened(step);
        (0..along.len())
            .map(|i| along[i].abs() * (1.0 + self.values[i]).sqrt())
            .fold(0.0, f64::max)
    }

    /// The prior's part of the loss: ½ pᵀ C⁻¹ p with the prior covariance C.
    pub fn prior_loss(&self, values: &DVector<f64>) -> f64 {
        0.5 * self.whitened(values).norm_squared()
    }

    /// A root R of the posterior covariance, which is R Rᵀ.
    pub fn posterior_root(&self) -> DMatrix<f64> {
        let scale = self.values.map(|v| 1.0 / (1.0 + v).sqrt());
        &self.root * &self.vectors * DMatrix::from_diagonal(&scale)
    }

    /// Posterior standard deviation of each parameter.
    pub fn deviations(&self) -> Vec<f64> {
        let root = self.posterior_root();
        root.row_iter().map(|row| row.norm()).collect()
    }

    /// Names of the directions that are fixed at the prior.
    pub fn fixed(&self, bench: &Nuisance) -> Vec<String> {
        let parameters = bench.parameters();
        let n = parameters.len();
        let fixed: Vec<usize> = (0..n)
            .filter(|&i| self.values[i] < MIN_INFORMATION)
            .collect();
        if fixed.is_empty() {
            return Vec::new();
        }
        // Coordinates in the basis of the fixed directions.
        let basis = DMatrix::from_fn(n, fixed.len(), |i, j| self.vectors[(i, fixed[j])]);
        let mut rest = DMatrix::identity(fixed.len(), fixed.len());
        let mut names = Vec::new();
        let mut name = |direction: &DVector<f64>, rest: &mut DMatrix<f64>, text: &str| {
            let q = self.to_prior_units(direction);
            let within = &*rest * basis.tr_mul(&(&q / q.norm()));
            let share = within.norm_squared();
            if share >= 0.8 {
                *rest -= &within * within.transpose() / share;
                names.push(text.to_owned());
            }
        };
        let intensities = DVector::from_fn(n, |i, _| {
            f64::from(u8::from(matches!(parameters[i], Parameter::Intensity(_))))
        });
        let lights = intensities.sum() as usize;
        for (i, parameter) in parameters.iter().enumerate() {
            let mut unit = DVector::zeros(n);
            unit[i] = 1.0;
            name(&unit, &mut rest, &parameter.to_string());
        }
        if lights > 1 {
            name(
                &intensities,
                &mut rest,
                "intensity of all lights against the sample's albedo",
            );
        }
        // What is left are combinations; each is named by its larger parts.
        let left = SymmetricEigen::new(rest);
        for (j, &value) in left.eigenvalues.iter().enumerate() {
            if value > 0.5 {
                let q = &basis * left.eigenvectors.column(j);
                names.push(combination(&q, parameters));
            }
        }
        names
    }

    fn to_prior_units(&self, values: &DVector<f64>) -> DVector<f64> {
        self.root
            .solve_lower_triangular(values)
            .unwrap_or_else(|| DVector::zeros(values.len()))
    }

    /// Coordinates along the directions, in prior deviations.
    fn whitened(&self, values: &DVector<f64>) -> DVector<f64> {
        self.vectors.tr_mul(&self.to_prior_units(values))
    }
}

/// "a with b with c": the parts whose squares are above a tenth, the largest first.
fn combination(direction: &DVector<f64>, parameters: &[Parameter]) -> String {
    let mut parts: Vec<(f64, String)> = direction
        .iter()
        .zip(parameters)
        .map(|(v, parameter)| (v * v, parameter.to_string()))
        .filter(|(share, _)| *share > 0.1)
        .collect();
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let names: Vec<String> = parts.into_iter().take(4).map(|(_, name)| name).collect();
    if names.is_empty() {
        return "a combination of many".to_owned();
    }
    names.join(" with ")
}
