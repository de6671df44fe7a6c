//! A prior that spreads weight over atoms where the images cannot distinguish them.
//!
//! Near-equal atoms, and atoms that differ only at angles that no path visits, leave the
//! least squares a valley whose lowest corner follows noise and model error. ½ ρ |w|² is
//! least for uniform weights and decides there; where the images speak, their curvature
//! is larger by orders of magnitude (docs/adr/0026).

use nalgebra::DVector;

use super::objective::{Linearised, Objective};
use crate::simplex::Quadratic;

/// ρ where the model explains the images, in units of χ².
const MIN_RIDGE: f64 = 300.0;

/// Curvature in every direction that the prior has in any fit and that counts towards the
/// convexity of the loss (docs/adr/0003).
pub const TOWARDS_CONVEXITY: f64 = MIN_RIDGE / 10.0;

/// What ρ gains with each unit of χ² that the model leaves unexplained: what no mixture
/// explains pulls on all weights, and its covariance is that of the pulls.
const RIDGE_PER_EXCESS: f64 = 1.0;

/// Strength of the prior per channel group.
#[derive(Clone, Debug, PartialEq)]
pub struct Ridge(Vec<f64>);

impl Ridge {
    /// For a first fit, when nothing is known of what the model explains.
    pub fn first(objective: &Objective<'_>) -> Self {
        Self(vec![MIN_RIDGE; objective.groups()])
    }

    /// After a fit that ended with `pass`.
    pub fn after(pass: &Linearised) -> Self {
        Self(
            pass.unexplained
                .iter()
                .map(|unexplained| MIN_RIDGE + RIDGE_PER_EXCESS * unexplained.max(0.0))
                .collect(),
        )
    }

    /// The quadratics of `pass`, made at `mixture`, with the prior.
    pub fn add_to(&self, pass: &Linearised, mixture: &[DVector<f64>]) -> Vec<Quadratic> {
        let mut quadratics = pass.quadratics.clone();
        for ((q, weights), ridge) in quadratics.iter_mut().zip(mixture).zip(&self.0) {
            for k in 0..weights.len() {
                q.h[(k, k)] += ridge;
            }
            q.g.axpy(-ridge, weights, 1.0);
            q.c += 0.5 * ridge * weights.norm_squared();
        }
        quadratics
    }
}
