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
        // Of the mixtures; all have the same sum, so the shares are of the differences.
        let variance = (deviation(&drawn) / mean).powi(2);
        let shares = budget.shares(&atoms.add_scalar(-atoms.mean()));
        let mut parts = shares.map(|share| share * variance);
        // Of the discrepancies.
        let factors = group.discrepancies.iter();
        let factors: Vec<f64> = factors
            .map(|d| d.factor(theta_h_deg, theta_d_deg, 90.0))
            .collect();
        let beyond = deviation(&factors.iter().map(|factor| factor.ln()).collect::<Vec<_>>());
        let scale = group.scale_deviation.min(beyond);
        parts[Source::Model as usize] += beyond * beyond - scale * scale;
        parts[Source::Intensities as usize] += scale * scale;
        // Of f, their product: the images often determine it better than either.
        let of_f: Vec<f64> = (0..)
            .zip(&drawn)
            .map(|(draw, f)| f * factors.get(draw).unwrap_or(&1.0))
            .collect();
        let mean_of_f = of_f.iter().sum::<f64>() / count;
        let together = (deviation(&of_f) / mean_of_f).powi(2) / (variance + beyond * beyond);
        cell.value += value / 3.0;
        for (sum, part) in cell.relative_variance.iter_mut().zip(parts) {
            *sum += if part > 0.0 { together * part } else { 0.0 } / 3.0;
        }
    }
    Some(cell)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::DMatrix;

    use super::super::budget::Budget;
    use super::*;
    use crate::brdf::discrepancy::Discrepancy;
    use crate::brdf::{Atom, Dictionary, Mixture};

    /// Weights and discrepancies that vary against one another leave f as it is.
    #[test]
    fn the_parts_sum_to_the_variance_of_f_itself() {
        let atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
        let dictionary = Arc::new(Dictionary::new("two", atoms).unwrap());
        let mixture = Mixture::grey(dictionary, vec![0.5, 0.5]).unwrap();
        let weights: Vec<f64> = (0..=40).map(|draw| 0.4 + 0.005 * f64::from(draw)).collect();
        let identity = DMatrix::identity(2, 2);
        for (follows, expected) in [(0.0, 0.1197), (-1.0, 0.0), (-0.5, 0.0597)] {
            let factor = |w: &f64| Discrepancy::even(|_| follows * (w / 0.5).ln());
            let group = PosteriorSamples {
                posterior: weights
                    .iter()
                    .map(|&w| DVector::from_vec(vec![w, 1.0 - w]))
                    .collect(),
                prior: Vec::new(),
                excess_error: 0.0,
                informed: 1,
                scale_deviation: 0.0,
                discrepancies: weights.iter().map(factor).collect(),
                budget: Some(Budget::new(&identity, &identity, &[])),
            };
            let cell = at(&Material::from(mixture.clone()), &[group], 10.0, 50.0).unwrap();
            let std = cell.relative_variance.iter().sum::<f64>().sqrt();
            assert!((std - expected).abs() < 1e-3, "{follows}: {std}");
        }
    }
}
