//! What share each source has in the variance of f, at one pair of angles.

use nalgebra::DVector;

use super::budget::{SOURCES, Source};
use super::intervals::deviation;
use super::uncertainty::PosteriorSamples;
use crate::brdf::discrepancy::Material;

/// Relative variance of f at one pair of angles, mean over the channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellBudget {
    /// f, mean over the channels, 1/sr.
    pub value: f64,
    /// Variance of f over f² by source, in the order of [`Source::ALL`].
    pub relative_variance: [f64; SOURCES],
}

/// The budget at half and difference angles, degrees, at φd = 90°; `None` without samples.
pub fn at(
    material: &Material,
    posterior_samples: &[PosteriorSamples],
    theta_h_deg: f64,
    theta_d_deg: f64,
) -> Option<CellBudget> {
    let dictionary = material.mixture.dictionary();
    let atoms = DVector::from_vec(dictionary.values_at(theta_h_deg, theta_d_deg));
    let values = material.at(atoms.as_slice(), theta_h_deg, theta_d_deg, 90.0);
    let mut cell = CellBudget {
        value: 0.0,
        relative_variance: [0.0; SOURCES],
    };
    for (c, value) in values.into_iter().enumerate() {
        let group = posterior_samples.get(c.min(posterior_samples.len().checked_sub(1)?))?;
        let budget = group.budget.as_ref()?;
        let drawn: Vec<f64> = group.posterior.iter().map(|x| x.dot(&atoms)).collect();
        let count = drawn.len() as f64;
        let mean = drawn.iter().sum::<f64>() / count;
        if count < 2.0 || value <= 0.0 || mean <= 0.0 {
            return None;
        }
        let variance = drawn.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / (count - 1.0);
        // All samples have the same sum, so the shares are of the differences.
        let shares = budget.shares(&atoms.add_scalar(-atoms.mean()));
        cell.value += value / 3.0;
        for (sum, share) in cell.relative_variance.iter_mut().zip(shares) {
            // The samples are mixtures; the value includes the discrepancy.
            *sum += share * variance / (mean * mean) / 3.0;
        }
        let discrepancies = group.discrepancies.iter();
        let discrepancies: Vec<f64> = discrepancies
            .map(|d| d.factor(theta_h_deg, theta_d_deg, 90.0).ln())
            .collect();
        let beyond = deviation(&discrepancies);
        let scale = group.scale_deviation.min(beyond);
        cell.relative_variance[Source::Model as usize] += (beyond * beyond - scale * scale) / 3.0;
        cell.relative_variance[Source::Intensities as usize] += scale * scale / 3.0;
    }
    Some(cell)
}
