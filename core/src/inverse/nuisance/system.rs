//! Normal equations of weights and bench together, and their reduction to the bench.
//!
//! With r the residual over σ, J_w its derivative in the weights and J_p in the bench,
//! the information is F_ww = J_wᵀJ_w, F_pw = J_pᵀJ_w, F_pp = J_pᵀJ_p. What the
//! weights can absorb is no evidence about the bench: on the face of the simplex
//! where the mixture lies, the bench's own information is the Schur complement
//! F_pp − F_pw F_ww⁻¹ F_wp, and its score g_p − F_pw F_ww⁻¹ g_w. All products take
//! their two factors from independent halves of the samples, so that noise in
//! neither of them counts as information.
//!
//! The estimating equations of the nuisance parameters are Zᵀ W r = 0, with the derivatives Z of
//! direct light as instruments (docs/adr/0009): their covariance is ZᵀWZ, their sensitivity to
//! the parameters ZᵀWJ_p. So where the weights are marginalised, F_pp is ZᵀZ and F_pw is ZᵀJ_w.

use nalgebra::{DMatrix, DVector};

use super::derivatives::{Derivative, DerivativeImages};
use super::parameters::{Nuisance, Parameter};
use super::spectrum::Spectrum;
use crate::inverse::normal_equations::{
    IN_USE, Marginal, Scores, WEIGHT_PRIOR_DEVIATION, add_cross,
};
use crate::inverse::objective::{Objective, ResidualWeights, Value};

/// How the images change with the P nuisance parameters.
pub struct Columns<'a> {
    /// The parameters.
    pub bench: &'a Nuisance,
    /// Derivatives by those that are geometric.
    pub derivatives: &'a DerivativeImages,
}

/// Information and score of the nuisance parameters, the weights marginalised.
pub struct Reduced {
    /// P × P.
    pub information: DMatrix<f64>,
    /// Sensitivity of the score to the parameters by all reflections, P × P: the information,
    /// where the derivatives are of direct light alone.
    pub response: DMatrix<f64>,
    /// P.
    pub score: DVector<f64>,
    /// Whether the images say nothing of the intensities' common scale.
    pub scale_is_open: bool,
    /// The score's parts by block of cells.
    pub block_scores: Vec<DVector<f64>>,
}

impl Columns<'_> {
    /// Derivatives of a value by the parameters, of either half: `of` takes that by a geometric
    /// one from its derivatives.
    fn rows(
        &self,
        objective: &Objective<'_>,
        value: &Value<'_>,
        of: impl Fn(&Derivative, usize) -> [f32; 3],
    ) -> [DVector<f64>; 2] {
        let parameters = self.bench.parameters();
        [0, 1].map(|half| {
            let mut row = DVector::zeros(parameters.len());
            for (k, light, derivative) in self.derivatives.at(value.cell) {
                if light == value.light {
                    row[k] = f64::from(of(derivative, half)[value.channel]);
                }
            }
            for (k, parameter) in parameters.iter().enumerate() {
                match *parameter {
                    Parameter::Intensity(l) if l == value.light => row[k] = value.model[half],
                    Parameter::StrayLight(l) if l == value.light => {
                        row[k] = 1.0 / objective.strength(value.light)[value.channel];
                    }
                    _ => {}
                }
            }
            row
        })
    }

    /// The equations of the parameters at `mixture`, with the weights in use marginalised;
    /// `information` is F_ww per group.
    pub fn reduced(
        &self,
        objective: &Objective<'_>,
        residual_weights: &ResidualWeights,
        mixture: &[DVector<f64>],
        information: &[DMatrix<f64>],
    ) -> Reduced {
        let (n, groups) = (objective.atoms(), objective.groups());
        let p = self.bench.parameters().len();
        // ZᵀWZ, ZᵀWJ_p, ZᵀWJ_w of all groups, and scores of Z and of the weights.
        let zero = || {
            let matrices = [p, p, groups * n].map(|columns| DMatrix::zeros(p, columns));
            (matrices, Scores::zero(p + groups * n))
        };
        let ([own, response, coupling], scores) = objective.accumulate(
            mixture,
            residual_weights,
            None,
            zero,
            |([own, response, coupling], scores), value| {
                let z = self.rows(objective, value, |d, _| d.direct);
                let all = self.rows(objective, value, |d, half| d.halves[half]);
                let from = value.group * n;
                let mut weights = [0, 1].map(|_| DVector::zeros(groups * n));
                for (row, by_weights) in weights.iter_mut().zip(value.by_weights) {
                    row.rows_mut(from, n).copy_from_slice(by_weights);
                }
                add_cross(own, &z, &z, value.weight);
                add_cross(response, &z, &all, value.weight);
                add_cross(coupling, &z, &weights, value.weight);
                let rows = [0, 1].map(|half| {
                    let row = z[half].iter().chain(&weights[half]);
                    row.copied().collect::<Vec<f64>>()
                });
                let rows = rows.each_ref().map(Vec::as_slice);
                // Blocks of all lights together: they share the paths, and so their noise.
                let block = objective.block(value.cell, 0);
                scores.add(block, value.weight, rows, value.residual);
            },
            |(total, scores), (part, part_scores)| {
                total.iter_mut().zip(part).for_each(|(t, p)| *t += p);
                scores.join(&part_scores);
            },
        );
        let marginal = |scale_is_free: bool| {
            let mut inverse = DMatrix::zeros(groups * n, groups * n);
            for (group, (mixture, information)) in mixture.iter().zip(information).enumerate() {
                let at = (group * n, group * n);
                let mut of_group = inverse_on_face(information, mixture);
                if scale_is_free {
                    of_group = with_free_scale(of_group, information, mixture);
                }
                inverse.view_mut(at, (n, n)).copy_from(&of_group);
            }
            Marginal::new(&own, &coupling, &inverse)
        };
        // What the images say of the common scale if the material may be as bright as it likes:
        // by interreflection alone. If that is nothing, neither the weights' prior nor white as
        // the brightest material may decide.
        let free = marginal(true);
        let scale_is_open = self.bench.leaves_scale_open(&free.information);
        let marginal = match scale_is_open {
            true => free,
            false => marginal(false),
        };
        // F_wp, by symmetry of the halves.
        let by_parameters = self.couplings(objective, residual_weights, mixture);
        let response = by_parameters
            .iter()
            .enumerate()
            .fold(response, |sum, (group, [a, b])| {
                sum - 0.5 * marginal.gain.columns(group * n, n) * (a + b)
            });
        Reduced {
            scale_is_open,
            response,
            score: marginal.score(&scores.total),
            block_scores: scores.each(|s| marginal.score(s)),
            information: marginal.information,
        }
    }

    /// F_wp per group, N × P, from either pair of independent halves.
    fn couplings(
        &self,
        objective: &Objective<'_>,
        residual_weights: &ResidualWeights,
        mixture: &[DVector<f64>],
    ) -> Vec<[DMatrix<f64>; 2]> {
        let none = || DMatrix::zeros(objective.atoms(), self.bench.parameters().len());
        objective.accumulate(
            mixture,
            residual_weights,
            None,
            || vec![[none(), none()]; objective.groups()],
            |sums, value| {
                let rows = self.rows(objective, value, |d, half| d.halves[half]);
                for (half, sum) in sums[value.group].iter_mut().enumerate() {
                    let by_weights = DVector::from_column_slice(value.by_weights[1 - half]);
                    sum.ger(value.weight, &by_weights, &rows[half], 1.0);
                }
            },
            |total, part| {
                let total = total.iter_mut().flatten();
                total
                    .zip(part.into_iter().flatten())
                    .for_each(|(t, p)| *t += p);
            },
        )
    }
}

/// Inverse of the information among steps that keep the sum and leave zero weights
/// at zero, with the weights' prior; N × N, zero outside the face.
fn inverse_on_face(information: &DMatrix<f64>, mixture: &DVector<f64>) -> DMatrix<f64> {
    let n = mixture.len();
    let free: Vec<usize> = (0..n).filter(|&k| mixture[k] > IN_USE).collect();
    let m = free.len();
    let eigen = DMatrix::from_fn(m, m, |i, j| information[(free[i], free[j])]).symmetric_eigen();
    let precision = WEIGHT_PRIOR_DEVIATION.powi(-2);
    let inverse = eigen.eigenvalues.map(|v| 1.0 / (v.max(0.0) + precision));
    let vectors = &eigen.eigenvectors;
    let mut face = vectors * DMatrix::from_diagonal(&inverse) * vectors.transpose();
    // The sum is fixed: project its direction out.
    let row = face.column_sum();
    let total = row.sum();
    if total > 0.0 {
        face -= &row * row.transpose() / total;
    }
    let mut all = DMatrix::zeros(n, n);
    for (i, &k) in free.iter().enumerate() {
        for (j, &l) in free.iter().enumerate() {
            all[(k, l)] = face[(i, j)];
        }
    }
    all
}

/// The inverse on the face with the material's brightness, a factor of all weights, marginalised
/// as well and without a prior: a further column x to the face's.
fn with_free_scale(
    on_face: DMatrix<f64>,
    information: &DMatrix<f64>,
    mixture: &DVector<f64>,
) -> DMatrix<f64> {
    let by_scale = information * mixture;
    let own = mixture - &on_face * &by_scale;
    let left = by_scale.dot(&own);
    // Else the face contains it.
    if left <= IN_USE * by_scale.dot(mixture).abs() {
        return on_face;
    }
    &on_face + &own * own.transpose() / left
}

/// How images change with a refined bench, for a fit that shall know how much the
/// bench's remaining uncertainty adds to its own.
pub struct BenchLinearisation {
    /// The bench.
    pub bench: Nuisance,
    /// Derivatives of the images.
    pub derivatives: DerivativeImages,
    /// What is known about the bench.
    pub spectrum: Spectrum,
    /// Whether the images say nothing of the intensities' common scale.
    pub scale_is_open: bool,
}

impl BenchLinearisation {
    /// What the nuisance parameters add at a fit's final point.
    pub fn coupling(
        &self,
        objective: &Objective<'_>,
        residual_weights: &ResidualWeights,
        mixture: &[DVector<f64>],
    ) -> BenchCoupling {
        let columns = Columns {
            bench: &self.bench,
            derivatives: &self.derivatives,
        };
        let to_weights = columns.couplings(objective, residual_weights, mixture);
        let root = self.spectrum.posterior_root();
        let mut covariance = &root * root.transpose();
        let mut scale_deviation = 0.0;
        // An open scale is a factor of f, for which the weights' linear answer is no
        // approximation: what varies with it is taken out.
        let common = self.bench.common_scale();
        if let (true, Some(factor)) = (self.scale_is_open, covariance.clone().cholesky()) {
            let variance = 1.0 / common.dot(&factor.solve(&common));
            scale_deviation = variance.sqrt();
            covariance.ger(-variance, &common, &common, 1.0);
        }
        BenchCoupling {
            to_weights,
            scale_deviation,
            covariance,
            parameters: self.bench.parameters().to_vec(),
        }
    }
}

/// What an uncertain bench adds to the spread of the weights. Given the bench at p from
/// its estimate, the weights' score changes by −F_wp p; p is drawn from its posterior,
/// which has the weights eliminated, so that both together are drawn from the joint one.
pub struct BenchCoupling {
    /// F_wp per channel group, N × P, from independent halves.
    to_weights: Vec<[DMatrix<f64>; 2]>,
    /// The bench's posterior covariance, P × P, at a fixed scale where that is open.
    covariance: DMatrix<f64>,
    /// Deviation of the natural logarithm of the common scale where that is open, else 0.
    pub scale_deviation: f64,
    parameters: Vec<Parameter>,
}

impl BenchCoupling {
    /// Covariance that it adds to the score of a set's weights, N × N. Each product has its two
    /// factors from independent halves: of one matrix with itself the noise of the derivatives
    /// would be counted as spread, the more the more lights there are. What noise is left can
    /// make it indefinite.
    pub fn covariance(&self, group: usize) -> DMatrix<f64> {
        self.part(group, |_| true)
    }

    /// The part of some parameters in it; what they share with others counts half. Parts
    /// of all parameters sum to the whole.
    pub fn part(&self, group: usize, of: impl Fn(Parameter) -> bool) -> DMatrix<f64> {
        let [first, second] = &self.to_weights[group];
        let own = |whole: &DMatrix<f64>| {
            let mut own = whole.clone();
            for (k, parameter) in self.parameters.iter().enumerate() {
                if !of(*parameter) {
                    own.column_mut(k).fill(0.0);
                }
            }
            own
        };
        let part = own(first) * &self.covariance * second.transpose()
            + own(second) * &self.covariance * first.transpose();
        0.25 * (&part + part.transpose())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Derivatives that are nothing but noise spread no weights, however many parameters
    /// there are; those without noise as much as they should, and the parts sum to the whole.
    #[test]
    fn noise_of_the_derivatives_is_no_spread() {
        const N: usize = 6;
        let mut numbers = stream(5, Purpose::Experiment, 0, 0, 0);
        let parameters: Vec<Parameter> = (0..40)
            .map(|k| match k % 2 {
                0 => Parameter::LightAzimuth(k / 2),
                _ => Parameter::Intensity(k / 2),
            })
            .collect();
        let count = parameters.len();
        let coupling = |to_weights: [DMatrix<f64>; 2]| BenchCoupling {
            to_weights: vec![to_weights],
            scale_deviation: 0.0,
            covariance: DMatrix::identity(count, count),
            parameters: parameters.clone(),
        };
        let mut noise = || DMatrix::from_fn(N, count, |_, _| numbers.normal());
        const TIMES: usize = 200;
        let mut trace = 0.0;
        for _ in 0..TIMES {
            trace += coupling([noise(), noise()]).covariance(0).trace();
        }
        // The variance of each trace is N · P; of one matrix with itself the mean were N · P.
        let deviation = (N as f64 * count as f64 / TIMES as f64).sqrt();
        assert!((trace / TIMES as f64).abs() < 4.0 * deviation, "{trace}");

        let exact = noise();
        let coupling = coupling([exact.clone(), exact.clone()]);
        let whole = coupling.covariance(0);
        assert!((&whole - &exact * exact.transpose()).norm() < 1e-9);
        let is_light = |p: Parameter| matches!(p, Parameter::LightAzimuth(_));
        let parts = coupling.part(0, is_light) + coupling.part(0, |p| !is_light(p));
        assert!((whole - parts).norm() < 1e-9);
    }
}
