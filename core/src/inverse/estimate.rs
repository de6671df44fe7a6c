//! The material that is reported: that of least expected error over the samples.
//!
//! Errors of appearance are relative to how bright the true material looks. Samples f of the
//! posterior are therefore averaged with weights 1/‖f‖², which makes E ‖a − f‖²/‖f‖² least
//! at a; ‖f‖ is the radiance of a sphere under the maps of the environment error. Where the
//! images decide, all draws are about as bright and this is their mean; where they say
//! little, samples that shine like mirrors don't decide (docs/adr/0006).

use nalgebra::{DMatrix, DVector};

use super::discrepancy_fit::Eliminated;
use super::solve::per_channel;
use super::uncertainty::PosteriorSamples;
use crate::brdf::Mixture;
use crate::brdf::discrepancy::{Discrepancy, Material};
use crate::brdf::projection::{EnvironmentMatrix, ProjectionError};

/// Albedo of what looks black: darker materials count as this bright.
const MIN_BRIGHTNESS: f64 = 0.02;

/// The material to report: the mean of the samples around `center` with its discrepancy, written
/// as the mixture closest to it in environment error and the discrepancy from that one.
pub(super) fn estimate(
    spheres: &EnvironmentMatrix<'_>,
    center: &[DVector<f64>],
    posterior_samples: &[PosteriorSamples],
    discrepancy: &[Eliminated],
) -> Result<Material, ProjectionError> {
    let dictionary = spheres.dictionary();
    let mean = mean_of_samples(spheres, posterior_samples);
    let mixture = Mixture::new(dictionary.clone(), per_channel(&mean))?;
    if discrepancy.is_empty() {
        return Ok(Material::from(mixture));
    }
    let groups = discrepancy.iter().zip(mean.iter().zip(center));
    let discrepancies: Vec<_> = groups
        .map(|(d, (mean, x))| d.discrepancy(&d.modes(&(mean - x))))
        .collect();
    let with_discrepancy = Material::new(mixture, &discrepancies);
    let (_, mut closest) = spheres.of(&with_discrepancy).floor()?;
    if let [_] = mean[..] {
        let [r, g, b] = closest
            .weights()
            .each_ref()
            .map(|w| DVector::from_column_slice(w));
        closest = Mixture::new(dictionary.clone(), per_channel(&[(r + g + b) / 3.0]))?;
    }
    Ok(relative_to(closest, &with_discrepancy))
}

/// Most that ln f of a mixture differs from that of the one closest to it, as far as a table
/// of nodes can say it: in the tails of narrow lobes one may be all there is of the other.
const MAX_LOG_RATIO: f64 = 3.0;

/// `material` as another mixture and the discrepancy from that one.
fn relative_to(mixture: Mixture, material: &Material) -> Material {
    let apart = Discrepancy::closest(|angles| {
        let atoms = mixture.dictionary().values_of(angles);
        let [wanted, there] = [&material.mixture, &mixture].map(|m| m.of_atoms(&atoms));
        [0, 1, 2].map(|c| {
            let both = wanted[c] > 0.0 && there[c] > 0.0;
            let ratio = if both { wanted[c] / there[c] } else { 1.0 };
            ratio.ln().clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)
        })
    });
    let mut other = Material::from(mixture);
    let discrepancies = material.discrepancies.iter().zip(apart);
    for (other, (g, apart)) in other.discrepancies.iter_mut().zip(discrepancies) {
        other.0 = &g.0 + apart.0;
    }
    other
}

/// Per channel group, the weights of least expected relative error over the samples, of which there is one
/// at least.
pub(super) fn mean_of_samples(
    spheres: &EnvironmentMatrix<'_>,
    posterior_samples: &[PosteriorSamples],
) -> Vec<DVector<f64>> {
    let of_set = |(group, of_set): (usize, &PosteriorSamples)| {
        let mean_square = match posterior_samples.len() {
            1 => (spheres.mean_square(0) + spheres.mean_square(1) + spheres.mean_square(2)) / 3.0,
            _ => spheres.mean_square(group),
        };
        least_relative_error(&of_set.posterior, &mean_square)
    };
    posterior_samples.iter().enumerate().map(of_set).collect()
}

/// Mean of the samples, each with 1/‖draw‖², where ‖x‖² = xᵀ · `mean_square` · x is the mean
/// square radiance of the mixture x (map radiances of mean 1).
fn least_relative_error(
    posterior_samples: &[DVector<f64>],
    mean_square: &DMatrix<f64>,
) -> DVector<f64> {
    let mut mean = DVector::zeros(mean_square.nrows());
    let mut total = 0.0;
    for draw in posterior_samples {
        let share = 1.0 / (draw.dot(&(mean_square * draw)) + MIN_BRIGHTNESS * MIN_BRIGHTNESS);
        mean.axpy(share, draw, 1.0);
        total += share;
    }
    mean / total
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::discrepancy::NODES;
    use crate::brdf::environment::EnvironmentMap;
    use crate::brdf::{Atom, Dictionary};

    fn vector(values: [f64; 2]) -> DVector<f64> {
        DVector::from_row_slice(&values)
    }

    fn of_draws(posterior: Vec<DVector<f64>>) -> Vec<PosteriorSamples> {
        vec![PosteriorSamples {
            posterior,
            prior: Vec::new(),
            excess_error: 0.0,
            informed: 1,
            scale_deviation: 0.0,
            discrepancies: Vec::new(),
            budget: None,
        }]
    }

    /// No other mixture of the two has a smaller expected relative error.
    #[test]
    fn the_expected_relative_error_is_least() {
        let square = DMatrix::from_row_slice(2, 2, &[9.0, 0.6, 0.6, 0.25]);
        let posterior_samples = [0.9, 0.2, 0.5, 0.4].map(|x| vector([x, 1.0 - x]));
        let found = least_relative_error(&posterior_samples, &square);
        let norm = |x: &DVector<f64>| x.dot(&(&square * x));
        let error = |a: &DVector<f64>| -> f64 {
            let relative =
                |f: &DVector<f64>| norm(&(a - f)) / (norm(f) + MIN_BRIGHTNESS * MIN_BRIGHTNESS);
            posterior_samples.iter().map(relative).sum()
        };
        assert!((found.sum() - 1.0).abs() < 1e-12);
        for step in [-0.01, 0.01] {
            let other = &found + vector([step, -step]);
            assert!(error(&found) < error(&other));
        }
        assert!(
            found[0] < 0.4,
            "nearer to the dark posterior_samples: {found}"
        );
    }

    /// Where two mixtures have the same lobes, one is written exactly as a discrepancy from the other;
    /// where only one has light, no further apart than a table can say.
    #[test]
    fn a_mixture_is_told_as_departing_from_another() {
        let atoms = vec![
            Atom::Lambertian { albedo: 1.0 },
            Atom::Black,
            Atom::Beckmann {
                alpha: 0.05,
                eta: 1.5,
            },
        ];
        let dictionary = Arc::new(Dictionary::new("three", atoms).unwrap());
        let mixture =
            |weights: [f64; 3]| Mixture::grey(dictionary.clone(), weights.to_vec()).unwrap();
        let g = [Discrepancy::even(|_| 0.3)];
        let rewritten =
            |from, wanted| relative_to(mixture(from), &Material::new(mixture(wanted), &g));
        let darker = rewritten([0.8, 0.2, 0.0], [0.4, 0.6, 0.0]);
        for &found in darker.discrepancies[1].0.rows(0, NODES).iter() {
            assert!((found - (0.3 + 0.5f64.ln())).abs() < 1e-6, "{found}");
        }
        let other = rewritten([0.0, 0.5, 0.5], [0.5, 0.0, 0.5]);
        for &found in other.discrepancies[2].0.rows(0, NODES).iter() {
            assert!((found - 0.3).abs() <= MAX_LOG_RATIO + 1e-9, "{found}");
        }
    }

    /// A white and a grey Lambertian are as bright as 1 and 0.5: of samples that are one or
    /// the other, the estimate is (1·1 + 4·½)/(1 + 4) = 0.6.
    #[test]
    fn brightness_is_that_of_spheres_under_the_maps() {
        let grey = |albedo| Atom::Lambertian { albedo };
        let dictionary = Dictionary::new("grey", vec![grey(1.0), grey(0.5)]).unwrap();
        let maps = EnvironmentMap::all();
        let spheres = EnvironmentMatrix::new(Arc::new(dictionary), &maps, 24);
        let drawn = of_draws(vec![vector([1.0, 0.0]), vector([0.0, 1.0])]);
        let found = estimate(&spheres, &[vector([1.0, 0.0])], &drawn, &[]).unwrap();
        let found = &found.mixture.weights()[0];
        let albedo = found[0] + 0.5 * found[1];
        assert!((albedo - 0.6).abs() < 1e-3, "{albedo}");
    }
}
