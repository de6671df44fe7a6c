//! Information of the images about the nuisance parameters, in units of their prior.
//!
//! In units of the prior (p = L q, prior covariance L Lᵀ) the information is A = LᵀSL;
//! along an eigenvector with value λ the posterior variance is 1/(1 + λ) of the
//! prior's. Directions with small λ are fixed at the prior: depth under a telecentric
//! camera, a bowl's rotation about its axis, translation along an extrusion, intensity
//! against albedo. They are found, not listed, and named after the fact.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::parameters::{Bench, MIN_INFORMATION, Parameter};
use crate::inverse::normal_equations::scatter;

/// Longest step along one direction, in prior deviations: the images are not linear
/// in the bench beyond.
const MAX_STEP: f64 = 2.0;

/// Variance of an estimate over the prior's where its scores answer to the bench the wrong way
/// round: it ends anywhere within the prior, as the truth does.
const MAX_VARIANCE: f64 = 2.0;

/// Eigenvalues and directions of the information in units of the prior.
#[derive(Clone, Debug)]
pub struct Spectrum {
    /// λ of each direction; below 0 where the estimate is worse than the prior.
    pub values: DVector<f64>,
    /// Fraction of the images' word that counts along each direction.
    attenuation: DVector<f64>,
    /// Directions as columns, in units of the prior.
    vectors: DMatrix<f64>,
    /// L.
    root: DMatrix<f64>,
}

impl Spectrum {
    /// Of the information S with the weights eliminated, P × P.
    pub fn new(bench: &Bench, information: &DMatrix<f64>) -> Self {
        let root = bench.prior_root().clone();
        let eigen = SymmetricEigen::new(root.transpose() * information * &root);
        Self {
            attenuation: DVector::repeat(eigen.eigenvalues.len(), 1.0),
            values: eigen.eigenvalues.map(|v| v.max(0.0)),
            vectors: eigen.eigenvectors,
            root,
        }
    }

    /// Inflates the covariance by the between-block variance of the score (cluster-robust): errors of the model are
    /// correlated between pixels, and the paths' noise between lights and channels. At least
    /// `least` times what independent noise would, 1 or more: some of it is common to all
    /// blocks.
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

    /// What is known where the estimate's scores, whose information this is, answer to the bench
    /// by `response`, P × P, instead: where they answer less, noise has moved the place where
    /// they vanish the farther. With A the response, S the scores' covariance and T the attenuation,
    /// 0 along what is fixed, all in units of the prior, the estimate p solves T s(p) = p, and
    /// p − p_true has the covariance (1 + TA)⁻¹ (TST + 1) (1 + TA)⁻ᵀ, and at most
    /// `MAX_VARIANCE` along any direction.
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

    /// The Gauss–Newton step from `values` by the score g, with the prior. Held directions
    /// go back to the prior's centre.
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

    /// Length of a step in posterior deviations, the largest over the directions.
    pub fn length(&self, step: &DVector<f64>) -> f64 {
        let along = self.whitened(step);
        (0..along.len())
            .map(|i| along[i].abs() * (1.0 + self.values[i]).sqrt())
            .fold(0.0, f64::max)
    }

    /// ½ pᵀ C⁻¹ p, the prior's part of the loss.
    pub fn prior_loss(&self, values: &DVector<f64>) -> f64 {
        0.5 * self.whitened(values).norm_squared()
    }

    /// R with R Rᵀ the posterior covariance.
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
    pub fn fixed(&self, bench: &Bench) -> Vec<String> {
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
