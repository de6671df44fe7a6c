//! How much of the score's scatter the noise of the images makes, and how much that of
//! the render.

use nalgebra::{DMatrix, DVector};

use super::pass::add_product;
use super::{ModelImage, Objective, ResidualWeights};

/// Covariance of the score Jᵀ W r per set by what makes the residual scatter, N × N each.
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
        let (n, sets, lights) = (self.atoms(), self.sets(), self.lights());
        let none = || ScoreNoise {
            captured: DMatrix::zeros(n, n),
            rendered: DMatrix::zeros(n, n),
        };
        let parts = self.evaluate(
            mixture,
            false,
            || vec![none(); sets],
            |sums, rows| {
                let cell = rows.cell;
                let mut derivatives = [vec![0.0; n], vec![0.0; n]];
                for light in 0..lights {
                    for c in 0..3 {
                        let set = self.set_of(c);
                        let w = residual_weights[light][cell][c];
                        if w <= 0.0 {
                            continue;
                        }
                        let [a, b] = &mut derivatives;
                        self.derivatives(rows, light, c, [a, b]);
                        let captured = w * w * self.values.variance[light][cell][c];
                        let rendered = w * w * model[light][cell][c].variance;
                        add_product(&mut sums[set].captured, a, b, captured);
                        add_product(&mut sums[set].rendered, a, b, rendered);
                    }
                }
            },
        );
        let mut total = vec![none(); sets];
        for part in parts {
            for (sum, part) in total.iter_mut().zip(part) {
                sum.captured += part.captured;
                sum.rendered += part.rendered;
            }
        }
        for sum in &mut total {
            sum.captured.fill_upper_triangle_with_lower_triangle();
            sum.rendered.fill_upper_triangle_with_lower_triangle();
        }
        total
    }
}
