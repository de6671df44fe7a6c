//! The average of two estimates of one material, by a dictionary and by a part of it.
//!
//! Both estimates explain the images about equally well and are wrong in different places:
//! the whole dictionary has lobes that the part lacks, and more freedom to be wrong where the
//! images say little. The material reported is their mean in ln f, and the square of their
//! difference Δ enters the variance: what two sound ways of reading the same images disagree on,
//! the images do not decide (docs/adr/0039). This is Bayesian model averaging (Hoeting et al.
//! 1999) with equal model probabilities, and with a variance between the models that is not
//! Δ²/4, as for two models of which one is right, but Δ², as for two of many.

use std::sync::Arc;

use nalgebra::DVector;

use super::posterior::Posterior;
use super::uncertainty::PosteriorSamples;
use crate::brdf::discrepancy::{Discrepancy, Material};
use crate::brdf::{BrdfError, Dictionary, Mixture};
use crate::random::{Purpose, stream};

/// Standard deviation along Δ that samples have in addition to the ±Δ/2 between the estimates:
/// together 1.
const DIFFERENCE_DEVIATION: f64 = 0.866;

/// Most that the estimates differ in ln f, so that one that is absurd does not decide.
const MAX_DIFFERENCE: f64 = 3.0;

/// The average of what was found with the whole dictionary and with its first atoms alone.
pub(super) fn averaged(
    whole: Posterior,
    part: Posterior,
    seed: u64,
) -> Result<Posterior, BrdfError> {
    let dictionary = whole.material.mixture.dictionary().clone();
    let part = in_whole(part, &dictionary)?;
    let [a, b] = [&whole.material, &part.material];

    // The mean of the mixtures, and by what the mean in ln f differs from it.
    let weights = [0, 1, 2].map(|c| {
        let [a, b] = [a, b].map(|material| &material.mixture.weights()[c]);
        a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect()
    });
    let mixture = Mixture::new(dictionary, weights)?;
    let mean = Material::from(mixture);
    let tables = Tables::new(a, b, &mean);
    let discrepancy = whole.discrepancy.max(part.discrepancy);
    let material = if discrepancy > 0.0 {
        Material::new(mean.mixture, &tables.mean)
    } else {
        // Of two mixtures, the mean in f: it is one, and differs little.
        mean
    };

    // Samples of both in turn, spread along the difference.
    let groups = whole.posterior_samples.len();
    let samples = whole
        .posterior_samples
        .into_iter()
        .zip(part.posterior_samples)
        .enumerate();
    let samples = samples.map(|(group, (whole, part))| {
        let mut numbers = stream(seed, Purpose::Posterior, group as u64, 3, 0);
        // Of weights shared by the channels, the middle one.
        let difference = &tables.difference[if groups == 1 { 1 } else { group }];
        let count = whole.posterior.len().min(part.posterior.len());
        let in_turn = (0..count).map(|sample| {
            let of = if sample % 2 == 0 { &whole } else { &part };
            let without = Discrepancy::none;
            let mut g = of
                .discrepancies
                .get(sample)
                .cloned()
                .unwrap_or_else(without);
            g.0.axpy(DIFFERENCE_DEVIATION * numbers.normal(), difference, 1.0);
            (of.posterior[sample].clone(), g)
        });
        let (posterior, discrepancies) = in_turn.unzip();
        PosteriorSamples {
            posterior,
            discrepancies,
            excess_error: 0.5 * (whole.excess_error + part.excess_error),
            informed: whole.informed.max(part.informed),
            ..whole
        }
    });
    Ok(Posterior {
        posterior_samples: samples.collect(),
        material,
        discrepancy,
        center: whole.center,
    })
}

/// What was found with the first atoms of `dictionary`, as of all of them.
fn in_whole(part: Posterior, dictionary: &Arc<Dictionary>) -> Result<Posterior, BrdfError> {
    let padded = |weights: &[f64]| {
        let mut weights = weights.to_vec();
        weights.resize(dictionary.len(), 0.0);
        weights
    };
    let samples = |samples: Vec<DVector<f64>>| -> Vec<DVector<f64>> {
        let padded = |x: &DVector<f64>| DVector::from_vec(padded(x.as_slice()));
        samples.iter().map(padded).collect()
    };
    let Material {
        mixture,
        discrepancies,
    } = part.material;
    let weights = mixture.weights().each_ref().map(|weights| padded(weights));
    let mixture = Mixture::new(dictionary.clone(), weights)?;
    let groups = part
        .posterior_samples
        .into_iter()
        .map(|group| PosteriorSamples {
            posterior: samples(group.posterior),
            budget: None,
            ..group
        });
    Ok(Posterior {
        posterior_samples: groups.collect(),
        material: Material {
            mixture,
            discrepancies,
        },
        discrepancy: part.discrepancy,
        center: part.center,
    })
}

/// Per channel, at the nodes of the discrepancy.
struct Tables {
    /// ln of the geometric mean of two materials over a third.
    mean: [Discrepancy; 3],
    /// ln of the first over the second.
    difference: [DVector<f64>; 3],
}

impl Tables {
    fn new(a: &Material, b: &Material, reference: &Material) -> Self {
        // Of the mixtures; the discrepancies are in logarithms already.
        let of_mixtures = |ln_factor: &dyn Fn([f64; 3]) -> f64| {
            Discrepancy::closest(|angles| {
                let atoms = reference.mixture.dictionary().values_of(angles);
                let values = [a, b, reference].map(|material| material.mixture.of_atoms(&atoms));
                [0, 1, 2].map(|c| {
                    let values = values.map(|of| of[c]);
                    match values.iter().all(|f| *f > 0.0) {
                        true => ln_factor(values),
                        false => 0.0,
                    }
                })
            })
        };
        let mut mean = of_mixtures(&|[a, b, r]| 0.5 * ((a / r).ln() + (b / r).ln()));
        let difference = of_mixtures(&|[a, b, _]| (a / b).ln());
        let [a, b] = [a, b].map(|material| &material.discrepancies);
        for (mean, (a, b)) in mean.iter_mut().zip(a.iter().zip(b)) {
            mean.0 += 0.5 * (&a.0 + &b.0);
        }
        let apart = |c: usize| &difference[c].0 + &a[c].0 - &b[c].0;
        let limited = |v: f64| v.clamp(-MAX_DIFFERENCE, MAX_DIFFERENCE);
        Self {
            mean,
            difference: [0, 1, 2].map(|c| apart(c).map(limited)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::Atom;

    fn posterior(dictionary: &Arc<Dictionary>, weights: Vec<f64>, g: f64) -> Posterior {
        let mixture = Mixture::grey(dictionary.clone(), weights.clone()).unwrap();
        let g = Discrepancy::even(|_| g);
        let group = || PosteriorSamples {
            posterior: vec![DVector::from_column_slice(&weights); 400],
            prior: Vec::new(),
            excess_error: 0.0,
            informed: 1,
            scale_deviation: 0.0,
            discrepancies: vec![g.clone(); 400],
            budget: None,
        };
        Posterior {
            posterior_samples: vec![group(), group(), group()],
            material: Material::new(mixture, std::slice::from_ref(&g)),
            discrepancy: 1.0,
            center: Vec::new(),
        }
    }

    /// Two estimates of albedo 0.4 and 0.1: their mean in ln f is 0.2, and samples spread around
    /// it with the standard deviation ln 4.
    #[test]
    fn the_mean_is_in_logarithms_and_the_difference_is_the_spread() {
        let grey = |albedo| Atom::Lambertian { albedo };
        let whole = vec![grey(0.5), Atom::Black, grey(1.0)];
        let whole = Dictionary::new("three", whole).unwrap();
        let whole = whole.averaged_with_first(2).unwrap();
        let part = Arc::new(whole.first_part().unwrap());
        let whole = Arc::new(whole);
        let half = 0.5f64.ln();
        let of_whole = posterior(&whole, vec![0.0, 0.2, 0.8], half);
        let of_part = posterior(&part, vec![0.2, 0.8], 0.0);
        let found = averaged(of_whole, of_part, 1).unwrap();
        let pi = std::f64::consts::PI;
        let at = whole.values_at(30.0, 20.0);
        let f = found.material.at(&at, 30.0, 20.0, 90.0);
        assert!(f.iter().all(|f| (f * pi - 0.2).abs() < 1e-6), "{f:?}");
        let group = &found.posterior_samples[2];
        let logs = group
            .posterior
            .iter()
            .zip(&group.discrepancies)
            .map(|(x, g)| {
                let f: f64 = x.iter().zip(&at).map(|(x, f)| x * f).sum();
                (pi * f * g.factor(30.0, 20.0, 90.0)).ln()
            });
        let logs: Vec<f64> = logs.collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let square = logs.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        let deviation = (square / logs.len() as f64).sqrt();
        // Known within four of their standard errors.
        let (middle, spread) = (0.2f64.ln(), 4f64.ln());
        assert!((mean - middle).abs() < 4.0 * spread / 20.0, "{mean}");
        assert!(
            (deviation / spread - 1.0).abs() < 4.0 / 800f64.sqrt(),
            "{deviation}"
        );
    }
}
