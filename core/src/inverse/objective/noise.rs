//! How much of the score's scatter the noise of the images makes, and how much that of
//! the render; and what errors make of it that all values have in common.

use nalgebra::{DMatrix, DVector};

use super::{ModelImage, Objective, ResidualWeights};
use crate::inverse::normal_equations::with_eigenvalues;
use crate::outer_products::Products;

/// Covariance of the score Jᵀ W r per channel group by what makes the residual scatter, N × N each.
#[derive(Clone, Debug)]
pub struct ScoreNoise {
    /// Noise of the captured images.
    pub captured: DMatrix<f64>,
    /// Noise of the rendered paths.
    pub rendered: DMatrix<f64>,
}

impl Objective<'_> {
    /// Covariance of the score per channel group by the errors that all values have in common;
    /// empty where there are none. Every product is one of independent halves.
    pub fn common_error_covariance(
        &self,
        mixture: &[DVector<f64>],
        residual_weights: &ResidualWeights,
    ) -> Vec<DMatrix<f64>> {
        let (n, groups) = (self.atoms(), self.groups());
        let errors = &self.values.common_errors;
        if errors.is_empty() {
            return Vec::new();
        }
        let none = || vec![vec![[DVector::zeros(n), DVector::zeros(n)]; errors.len()]; groups];
        let scores = self.accumulate(
            mixture,
            residual_weights,
            None,
            none,
            |sums, value| {
                for (sums, error) in sums[value.group].iter_mut().zip(errors) {
                    let factor = value.weight * error[value.light][value.cell][value.channel];
                    for (sum, derivatives) in sums.iter_mut().zip(&value.by_weights) {
                        for (sum, derivative) in sum.iter_mut().zip(derivatives.iter()) {
                            *sum += factor * derivative;
                        }
                    }
                }
            },
            |total, part| {
                let total = total.iter_mut().flatten().flatten();
                for (sum, part) in total.zip(part.into_iter().flatten().flatten()) {
                    *sum += part;
                }
            },
        );
        let covariance = |of_group: Vec<[DVector<f64>; 2]>| {
            let mut sum = DMatrix::zeros(n, n);
            for [a, b] in of_group {
                sum.ger(0.5, &a, &b, 1.0);
                sum.ger(0.5, &b, &a, 1.0);
            }
            with_eigenvalues(sum, |v| v.max(0.0))
        };
        scores.into_iter().map(covariance).collect()
    }

    /// sym(J_Aᵀ W² σ² J_B) at `mixture` with the variances of capture and of `model`.
    pub fn score_noise(
        &self,
        mixture: &[DVector<f64>],
        residual_weights: &ResidualWeights,
        model: &[ModelImage],
    ) -> Vec<ScoreNoise> {
        let (n, groups) = (self.atoms(), self.groups());
        let none = || vec![[Products::zero(n), Products::zero(n)]; groups];
        let total = self.accumulate(
            mixture,
            residual_weights,
            None,
            none,
            |sums, value| {
                let square = value.weight * value.weight;
                let rendered = model[value.light][value.cell][value.channel].variance;
                let [of_capture, of_render] = &mut sums[value.group];
                of_capture.add(square * value.variance, value.by_weights);
                of_render.add(square * rendered, value.by_weights);
            },
            |total, part| {
                let total = total.iter_mut().flatten();
                let both = total.zip(part.into_iter().flatten());
                both.for_each(|(sum, part)| sum.join(part));
            },
        );
        let total = total.into_iter().map(|sums| sums.map(Products::matrix));
        total
            .map(|[captured, rendered]| ScoreNoise { captured, rendered })
            .collect()
    }
}
