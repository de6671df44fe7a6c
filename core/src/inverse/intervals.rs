//! From samples of the weights to an interval for f at every (θh, θd).
//!
//! Weights alone are not identifiable (atoms overlap); the BRDF they add up to is.

use super::uncertainty::PosteriorSamples;
use crate::brdf::HalfDifference;
use crate::brdf::discrepancy::Material;

/// f at one pair of angles, per channel, 1/sr.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// As reported.
    pub value: [f64; 3],
    /// 2.5% quantile of the posterior samples, never above `value`.
    pub lower: [f64; 3],
    /// 97.5% quantile, never below `value`.
    pub upper: [f64; 3],
    /// Whether the posterior's deviation is below half the prior's in every channel.
    pub constrained: bool,
}

/// Intervals over the grid of half and difference angles (degrees), θd fastest, at one φd.
pub fn table(
    material: &Material,
    posterior_samples: &[PosteriorSamples],
    theta_h_deg: &[f64],
    theta_d_deg: &[f64],
    phi_d_deg: f64,
) -> Vec<Interval> {
    let cell = |theta_h_deg: f64, theta_d_deg: f64| {
        let atoms = material.mixture.dictionary().values_of(HalfDifference {
            theta_h_rad: theta_h_deg.to_radians(),
            theta_d_rad: theta_d_deg.to_radians(),
            phi_d_rad: phi_d_deg.to_radians(),
        });
        let values = material.at(&atoms, theta_h_deg, theta_d_deg, phi_d_deg);
        let mut interval = Interval {
            value: [0.0; 3],
            lower: [0.0; 3],
            upper: [0.0; 3],
            constrained: true,
        };
        for (c, value) in values.into_iter().enumerate() {
            let f = |w: &[f64]| -> f64 { w.iter().zip(&atoms).map(|(w, f)| w * f).sum() };
            let Some(group) =
                posterior_samples.get(c.min(posterior_samples.len().saturating_sub(1)))
            else {
                (interval.value[c], interval.lower[c], interval.upper[c]) = (value, value, value);
                continue;
            };
            let factor = |draw: usize| match group.discrepancies.get(draw) {
                Some(discrepancy) => discrepancy.factor(theta_h_deg, theta_d_deg, phi_d_deg),
                None => 1.0,
            };
            let mut posterior: Vec<f64> = (0..)
                .zip(&group.posterior)
                .map(|(draw, x)| f(x.as_slice()) * factor(draw))
                .collect();
            let prior: Vec<f64> = group.prior.iter().map(|x| f(x.as_slice())).collect();
            interval.constrained &= deviation(&posterior) < 0.5 * deviation(&prior);
            posterior.sort_by(f64::total_cmp);
            interval.value[c] = value;
            interval.lower[c] = quantile(&posterior, 0.025).unwrap_or(value).min(value);
            interval.upper[c] = quantile(&posterior, 0.975).unwrap_or(value).max(value);
        }
        interval
    };
    let mut cells = Vec::with_capacity(theta_h_deg.len() * theta_d_deg.len());
    for &theta_h in theta_h_deg {
        for &theta_d in theta_d_deg {
            cells.push(cell(theta_h, theta_d));
        }
    }
    cells
}

/// Standard deviation of ln f that no mixture of a dictionary explains, for a relative
/// excess error of the images. Images show the material's discrepancies from the dictionary only
/// where they look; towards grazing angles they look least and dictionaries of
/// microfacet lobes fail most. Calibrated on measured materials (docs/measurements/intervals.md).
pub fn unexplained_deviation(excess_error: f64, theta_h_deg: f64, theta_d_deg: f64) -> f64 {
    let grazing = 0.03 * (theta_d_deg / 40.0).exp() + 0.6 * (theta_h_deg / 85.0).powi(8);
    let peak = 0.04 * (-theta_h_deg / 3.0).exp();
    DEVIATION_PER_MEDIAN * (excess_error / TYPICAL_EXCESS_ERROR).min(1.0) * (grazing + peak)
}

/// Deviations of ln f over the median error that the angles' part describes.
const DEVIATION_PER_MEDIAN: f64 = 2.0;
/// Relative excess error of the images of measured materials.
const TYPICAL_EXCESS_ERROR: f64 = 0.01;

/// Standard deviation of each weight over the posterior samples, per channel.
pub fn weight_deviations(posterior_samples: &[PosteriorSamples], atoms: usize) -> [Vec<f64>; 3] {
    std::array::from_fn(|c| {
        match posterior_samples.get(c.min(posterior_samples.len().saturating_sub(1))) {
            None => vec![0.0; atoms],
            Some(group) => (0..atoms)
                .map(|n| deviation(&group.posterior.iter().map(|x| x[n]).collect::<Vec<_>>()))
                .collect(),
        }
    })
}

/// Standard deviation; 0 of nothing.
pub(super) fn deviation(values: &[f64]) -> f64 {
    let n = values.len().max(2) as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
}

/// Linear interpolation between order statistics; `None` of nothing.
fn quantile(sorted: &[f64], q: f64) -> Option<f64> {
    let position = q * (sorted.len().checked_sub(1)?) as f64;
    let (below, fraction) = (position.floor() as usize, position.fract());
    let above = sorted[(below + 1).min(sorted.len() - 1)];
    Some(sorted[below] * (1.0 - fraction) + above * fraction)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::DVector;

    use super::*;
    use crate::brdf::Dictionary;
    use crate::brdf::Mixture;
    use crate::brdf::dictionary::Atom;

    /// Two atoms, uniform weights between them: quantiles and deviations are known.
    #[test]
    fn intervals_follow_the_draws() {
        let dictionary =
            Dictionary::new("two", vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black]).unwrap();
        let draw = |w: f64| DVector::from_vec(vec![w, 1.0 - w]);
        let group = || PosteriorSamples {
            posterior: (0..=100)
                .map(|i| draw(0.4 + 0.002 * f64::from(i)))
                .collect(),
            prior: (0..=100).map(|i| draw(0.01 * f64::from(i))).collect(),
            excess_error: 0.0,
            informed: 1,
            scale_deviation: 0.0,
            discrepancies: Vec::new(),
            budget: None,
        };
        let mixture = Mixture::grey(Arc::new(dictionary), vec![0.5, 0.5]).unwrap();
        let material = Material::from(mixture);
        let posterior_samples = [group(), group(), group()];
        let cells = table(&material, &posterior_samples, &[0.0, 30.0], &[45.0], 90.0);
        for cell in &cells {
            let pi = std::f64::consts::PI;
            assert!((cell.value[1] - 0.5 / pi).abs() < 1e-7);
            assert!((cell.lower[1] - 0.405 / pi).abs() < 1e-9, "{cell:?}");
            assert!((cell.upper[1] - 0.595 / pi).abs() < 1e-9, "{cell:?}");
            assert!(cell.constrained);
        }
        let wide = [PosteriorSamples {
            posterior: group().prior,
            prior: group().prior,
            excess_error: 0.0,
            informed: 1,
            scale_deviation: 0.0,
            discrepancies: Vec::new(),
            budget: None,
        }];
        assert!(!table(&material, &wide, &[0.0], &[45.0], 90.0)[0].constrained);
        assert!((weight_deviations(&posterior_samples, 2)[0][0] - 0.0586).abs() < 1e-3);
    }
}
