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
//! The bench's scores ask with derivatives Z of direct reflection (docs/adr/0009), Zᵀ W r:
//! they scatter by ZᵀZ, and answer to a bench that is off by ZᵀJ_p, all reflections.
//! So where the bench's scores are made free of the weights, F_pp is ZᵀZ and F_pw is ZᵀJ_w.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::derivatives::{Derivative, DerivativeImages};
use super::parameters::{Bench, Parameter};
use super::spectrum::Spectrum;
use crate::inverse::objective::{Objective, ResidualWeights};
use crate::transport::Cache;

/// Deviation of a weight before any image, which keeps F_ww invertible where atoms
/// are alike; that of the posterior's prior.
const WEIGHT_DEVIATION: f64 = 0.06;

/// What the objective is made of.
pub struct Model<'a> {
    /// The comparison.
    pub objective: &'a Objective<'a>,
    /// Its paths.
    pub cache: &'a Cache,
}

/// The bench's part of the normal equations; P parameters, N atoms.
pub struct Normal {
    /// ZᵀZ, P × P.
    information: DMatrix<f64>,
    /// ZᵀJ_p, P × P.
    response: DMatrix<f64>,
    /// ZᵀJ_w per weight set, P × N.
    asked: Vec<DMatrix<f64>>,
    /// F_pw per weight set, P × N, twice: from independent halves of the samples.
    coupling: Vec<[DMatrix<f64>; 2]>,
    /// Scores per block of cells, all lights together: they share the paths, and so
    /// their noise.
    blocks: BTreeMap<usize, Scores>,
}

/// Zᵀ W r of the bench and Jᵀ W r of each weight set.
#[derive(Clone)]
struct Scores {
    bench: DVector<f64>,
    weights: Vec<DVector<f64>>,
}

/// The bench's information and score with the weights eliminated.
pub struct Reduced {
    /// P × P.
    pub information: DMatrix<f64>,
    /// How the score answers to the bench by all reflections, P × P: the information, where
    /// the derivatives are of direct reflection alone.
    pub response: DMatrix<f64>,
    /// P.
    pub score: DVector<f64>,
    /// The score's parts by block of cells.
    pub block_scores: Vec<DVector<f64>>,
}

impl Normal {
    /// Sums over all compared cells at `mixture`.
    pub fn new(
        model: &Model<'_>,
        bench: &Bench,
        derivatives: &DerivativeImages,
        residual_weights: &ResidualWeights,
        mixture: &[DVector<f64>],
    ) -> Self {
        let (objective, cache) = (model.objective, model.cache);
        let (n, sets) = (objective.atoms(), objective.sets());
        let parameters = bench.parameters();
        let parts = objective.evaluate(
            mixture,
            false,
            || Self::zero(parameters.len(), n, sets),
            |sum, rows| {
                let cell = rows.cell;
                for (light, residual_weights) in residual_weights.iter().enumerate() {
                    for c in 0..3 {
                        let w = residual_weights[cell][c];
                        if w <= 0.0 {
                            continue;
                        }
                        let set = c.min(sets - 1);
                        let r = light * sets + set;
                        let first = objective.direct_light(cell, light, c, &mixture[set]);
                        let [target, _] = objective.captured(light, cell);
                        let value = [0, 1].map(|h| first + f64::from(rows.value[h][r]));
                        let residual = value.map(|v| target[c] - v);
                        let mut by_weight = [DVector::zeros(n), DVector::zeros(n)];
                        let halves = by_weight.each_mut().map(|half| half.as_mut_slice());
                        objective.derivatives(rows, light, c, halves);
                        let row = |h: usize, of: fn(&Derivative, usize) -> [f32; 3]| {
                            let mut row = DVector::zeros(parameters.len());
                            for (k, l, derivative) in derivatives.at(cell) {
                                if l == light {
                                    row[k] = f64::from(of(derivative, h)[c]);
                                }
                            }
                            for (k, parameter) in parameters.iter().enumerate() {
                                match *parameter {
                                    Parameter::Intensity(l) if l == light => row[k] = value[h],
                                    Parameter::StrayLight(l) if l == light => {
                                        row[k] = 1.0 / cache.strength[light][c];
                                    }
                                    _ => {}
                                }
                            }
                            row
                        };
                        let asked = [0, 1].map(|h| row(h, |derivative, _| derivative.direct));
                        let by_bench = [0, 1].map(|h| row(h, |derivative, h| derivative.halves[h]));
                        let block = sum
                            .blocks
                            .entry(objective.block(cell, 0))
                            .or_insert_with(|| Scores::zero(parameters.len(), n, sets));
                        for h in 0..2 {
                            let (a, b) = (h, 1 - h);
                            sum.information.ger(0.5 * w, &asked[a], &asked[b], 1.0);
                            sum.response.ger(0.5 * w, &asked[a], &by_bench[b], 1.0);
                            sum.asked[set].ger(0.5 * w, &asked[a], &by_weight[b], 1.0);
                            sum.coupling[set][h].ger(w, &by_bench[a], &by_weight[b], 1.0);
                            block.bench.axpy(0.5 * w * residual[b], &asked[a], 1.0);
                            block.weights[set].axpy(0.5 * w * residual[b], &by_weight[a], 1.0);
                        }
                    }
                }
            },
        );
        let mut total = Self::zero(parameters.len(), n, sets);
        for part in parts {
            total.information += part.information;
            total.response += part.response;
            for (sum, part) in total.asked.iter_mut().zip(&part.asked) {
                *sum += part;
            }
            let couplings = total.coupling.iter_mut().flatten();
            for (sum, part) in couplings.zip(part.coupling.iter().flatten()) {
                *sum += part;
            }
            for (block, scores) in part.blocks {
                total
                    .blocks
                    .entry(block)
                    .or_insert_with(|| Scores::zero(parameters.len(), n, sets))
                    .add(&scores);
            }
        }
        total
    }

    fn zero(parameters: usize, atoms: usize, sets: usize) -> Self {
        Self {
            information: DMatrix::zeros(parameters, parameters),
            response: DMatrix::zeros(parameters, parameters),
            asked: vec![DMatrix::zeros(parameters, atoms); sets],
            coupling: vec![[(); 2].map(|()| DMatrix::zeros(parameters, atoms)); sets],
            blocks: BTreeMap::new(),
        }
    }

    /// Eliminates the weights that are above zero in `mixture`; `information` is F_ww per set.
    pub fn reduced(&self, information: &[DMatrix<f64>], mixture: &[DVector<f64>]) -> Reduced {
        // G = F_pw F_ww⁻¹ per set, so that S = F_pp − G F_wp and g = g_p − G g_w.
        let gains: Vec<DMatrix<f64>> = mixture
            .iter()
            .zip(information)
            .zip(&self.asked)
            .map(|((mixture, information), asked)| asked * inverse_on_face(information, mixture))
            .collect();
        let (mut own, mut response) = (self.information.clone(), self.response.clone());
        for ((gain, asked), [a, b]) in gains.iter().zip(&self.asked).zip(&self.coupling) {
            own -= gain * asked.transpose();
            response -= 0.5 * gain * (a + b).transpose();
        }
        let block_scores: Vec<DVector<f64>> = self
            .blocks
            .values()
            .map(|scores| {
                let mut own = scores.bench.clone();
                for (gain, weights) in gains.iter().zip(&scores.weights) {
                    own -= gain * weights;
                }
                own
            })
            .collect();
        Reduced {
            information: 0.5 * (&own + own.transpose()),
            response,
            score: block_scores
                .iter()
                .fold(DVector::zeros(own.nrows()), |sum, s| sum + s),
            block_scores,
        }
    }
}

impl Scores {
    fn zero(parameters: usize, atoms: usize, sets: usize) -> Self {
        Self {
            bench: DVector::zeros(parameters),
            weights: vec![DVector::zeros(atoms); sets],
        }
    }

    fn add(&mut self, other: &Self) {
        self.bench += &other.bench;
        for (sum, other) in self.weights.iter_mut().zip(&other.weights) {
            *sum += other;
        }
    }
}

/// Inverse of the information among steps that keep the sum and leave zero weights
/// at zero, with the weights' prior; N × N, zero outside the face.
fn inverse_on_face(information: &DMatrix<f64>, mixture: &DVector<f64>) -> DMatrix<f64> {
    let n = mixture.len();
    let free: Vec<usize> = (0..n).filter(|&k| mixture[k] > 1e-9).collect();
    let m = free.len();
    let eigen = DMatrix::from_fn(m, m, |i, j| information[(free[i], free[j])]).symmetric_eigen();
    let precision = WEIGHT_DEVIATION.powi(-2);
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

/// How images change with a refined bench, for a fit that shall know how much the
/// bench's remaining uncertainty adds to its own.
pub struct BenchLinearisation {
    /// The bench.
    pub bench: Bench,
    /// Derivatives of the images.
    pub derivatives: DerivativeImages,
    /// What is known about the bench.
    pub spectrum: Spectrum,
}

impl BenchLinearisation {
    /// What the bench adds at a fit's final point.
    pub fn coupling(
        &self,
        model: &Model<'_>,
        residual_weights: &ResidualWeights,
        mixture: &[DVector<f64>],
    ) -> BenchCoupling {
        let normal = Normal::new(
            model,
            &self.bench,
            &self.derivatives,
            residual_weights,
            mixture,
        );
        let root = self.spectrum.posterior_root();
        let to_weights = |halves: &[DMatrix<f64>; 2]| halves.each_ref().map(DMatrix::transpose);
        BenchCoupling {
            to_weights: normal.coupling.iter().map(to_weights).collect(),
            covariance: &root * root.transpose(),
            parameters: self.bench.parameters().to_vec(),
        }
    }
}

/// What an uncertain bench adds to the spread of the weights. Given the bench at p from
/// its estimate, the weights' score changes by −F_wp p; p is drawn from its posterior,
/// which has the weights eliminated, so that both together are drawn from the joint one.
pub struct BenchCoupling {
    /// F_wp per set, N × P, from independent halves.
    to_weights: Vec<[DMatrix<f64>; 2]>,
    /// The bench's posterior covariance, P × P.
    covariance: DMatrix<f64>,
    parameters: Vec<Parameter>,
}

impl BenchCoupling {
    /// Covariance that it adds to the score of a set's weights, N × N. Each product has its two
    /// factors from independent halves: of one matrix with itself the noise of the derivatives
    /// would be counted as spread, the more the more lights there are. What noise is left can
    /// make it indefinite.
    pub fn covariance(&self, set: usize) -> DMatrix<f64> {
        self.part(set, |_| true)
    }

    /// The part of some parameters in it; what they share with others counts half. Parts
    /// of all parameters sum to the whole.
    pub fn part(&self, set: usize, of: impl Fn(Parameter) -> bool) -> DMatrix<f64> {
        let [first, second] = &self.to_weights[set];
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
