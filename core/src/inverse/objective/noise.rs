//! How much of the score's scatter the noise of the images makes, and how much that of
//! the render.

use nalgebra::{DMatrix, DVector};

use super::{ModelImage, Objective, ResidualWeights};
use crate::inverse::normal_equations::add_product;

/// Covariance of the score Jᵀ W r per channel group by what makes the residual scatter, N × N each.
#[derive(Clone, Debug)]
pub struct ScoreNoise {
    /// Noise of the captured images.
    pub captured: DMatrix<f64>,
    /// Noise of the rendered paths.
    pub rendered: DMatrix<f64>,
}

impl Objective<'_> {
    /// sym(J_Aᵀ W² σ² J_B) at `mixture` with the variances of capture and of `model`.
    pub fn score_noise(
        &self,
        mixture: &[DVector<f64>],
        residual_weights: &ResidualWeights,
        model: &[ModelImage],
    ) -> Vec<ScoreNoise> {
        let (n, groups) = (self.atoms(), self.groups());
        let none = || ScoreNoise {
            captured: DMatrix::zeros(n, n),
            rendered: DMatrix::zeros(n, n),
        };
        let mut total = self.accumulate(
            mixture,
            residual_weights,
            false,
            || vec![none(); groups],
            |sums, value| {
                let [a, b] = value.by_weights;
                let square = value.weight * value.weight;
                let rendered = model[value.light][value.cell][value.channel].variance;
                let sum = &mut sums[value.group];
                add_product(&mut sum.captured, a, b, square * value.variance);
                add_product(&mut sum.rendered, a, b, square * rendered);
            },
            |total, part| {
                for (sum, part) in total.iter_mut().zip(part) {
                    sum.captured += part.captured;
                    sum.rendered += part.rendered;
                }
            },
        );
        for sum in &mut total {
            sum.captured.fill_upper_triangle_with_lower_triangle();
            sum.rendered.fill_upper_triangle_with_lower_triangle();
        }
        total
    }
}
