//! The average of two estimates of one material, by a dictionary and by a part of it.
//!
//! Both estimates explain the images about equally well and are wrong in different places:
//! the whole dictionary has lobes that the part lacks, and more freedom to be wrong where the
//! images say little. The material reported is their mean in ln f, and the square of their
//! difference Δ enters the variance: what two sound ways of reading the same images disagree on,
//! the images do not decide (docs/adr/0039). This is Bayesian model averaging (Hoeting et al.
//! 1999) with equal model probabilities, and with a variance between the models that is not
//! Δ²/4, as for two models of which one is right, but Δ², as for two of many.

use nalgebra::DVector;

use super::posterior::Posterior;
use super::uncertainty::Draws;
use crate::brdf::discrepancy::{self, Discrepancy, Material};
use crate::brdf::{BrdfError, Dictionary, Mixture};
use crate::random::{Purpose, stream};

/// Standard deviation along Δ that samples have in addition to the ±Δ/2 between the estimates:
/// together 1.
const ALONG_DIFFERENCE: f64 = 0.866;

/// Most that the estimates differ in ln f, so that one that is absurd does not decide.
const LARGEST_DIFFERENCE: f64 = 3.0;

/// The average of what was found with the whole dictionary and with its first atoms alone.
pub(super) fn averaged(
    whole: Posterior,
    part: Posterior,
    seed: u64,
) -> Result<Posterior, BrdfError> {
    let dictionary = whole.material.mixture.dictionary().clone();
    let n = dictionary.len();
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
    let departs = whole.discrepancy > 0.0 || part.discrepancy > 0.0;
    let material = match departs {
        true => Material::new(mean.mixture, &tables.mean),
        // Of two mixtures, the mean in f: it is one, and differs little.
        false => mean,
    };

    // Samples of both in turn, spread along the difference.
    let Posterior { draws: of_part, .. } = part;
    let sets = whole.draws.len();
    let draws = whole.draws.into_iter().zip(of_part).enumerate();
    let draws = draws.map(|(set, (whole, part))| {
        let mut numbers = stream(seed, Purpose::Posterior, set as u64, 3, 0);
        // Of weights shared by the channels, the middle one.
        let difference = &tables.difference[if sets == 1 { 1 } else { set }];
        let count = whole.posterior.len().min(part.posterior.len());
        let mut pooled = Draws {
            posterior: Vec::with_capacity(count),
            discrepancies: Vec::with_capacity(count),
            misfit: 0.5 * (whole.misfit + part.misfit),
            informed: whole.informed.max(part.informed),
            ..whole
        };
        for sample in 0..count {
            let from = if sample % 2 == 0 {
                &whole.posterior
            } else {
                &part.posterior
            };
            let discrepancies = if sample % 2 == 0 {
                &whole.discrepancies
            } else {
                &part.discrepancies
            };
            let mut g = match discrepancies.get(sample) {
                Some(discrepancy) => discrepancy.0.clone(),
                None => DVector::zeros(discrepancy::NODES),
            };
            g.axpy(ALONG_DIFFERENCE * numbers.normal(), difference, 1.0);
            pooled.posterior.push(from[sample].clone());
            pooled.discrepancies.push(Discrepancy(g));
        }
        pooled
    });
    debug_assert!(material.mixture.weights()[0].len() == n);
    Ok(Posterior {
        draws: draws.collect(),
        material,
        discrepancy: whole.discrepancy.max(part.discrepancy),
    })
}

/// What was found with the first atoms of `dictionary`, as of all of them.
fn in_whole(
    part: Posterior,
    dictionary: &std::sync::Arc<Dictionary>,
) -> Result<Posterior, BrdfError> {
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
    let draws = part.draws.into_iter().map(|set| Draws {
        posterior: samples(set.posterior),
        prior: samples(set.prior),
        budget: None,
        ..set
    });
    Ok(Posterior {
        draws: draws.collect(),
        material: Material {
            mixture,
            discrepancies,
        },
        discrepancy: part.discrepancy,
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
        let none = || DVector::zeros(discrepancy::NODES);
        let mut mean = [none(), none(), none()];
        let mut difference = [none(), none(), none()];
        for (k, node) in discrepancy::nodes().enumerate() {
            let (h, d) = (node.theta_h_deg, node.theta_d_deg);
            let atoms = reference.mixture.dictionary().values_at(h, d);
            let [a, b, reference] = [a, b, reference].map(|material| material.at(&atoms, h, d));
            for c in 0..3 {
                if a[c] > 0.0 && b[c] > 0.0 && reference[c] > 0.0 {
                    mean[c][k] =
                        0.5 * (a[c] / reference[c]).ln() + 0.5 * (b[c] / reference[c]).ln();
                    let apart = (a[c] / b[c]).ln();
                    difference[c][k] = apart.clamp(-LARGEST_DIFFERENCE, LARGEST_DIFFERENCE);
                }
            }
        }
        Self {
            mean: mean.map(Discrepancy),
            difference,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::Atom;
    use crate::brdf::discrepancy::NODES;

    fn posterior(dictionary: &Arc<Dictionary>, weights: Vec<f64>, g: f64) -> Posterior {
        let mixture = Mixture::grey(dictionary.clone(), weights.clone()).unwrap();
        let g = Discrepancy(DVector::from_element(NODES, g));
        let set = || Draws {
            posterior: vec![DVector::from_column_slice(&weights); 400],
            prior: Vec::new(),
            misfit: 0.0,
            informed: 1,
            discrepancies: vec![g.clone(); 400],
            budget: None,
        };
        Posterior {
            draws: vec![set(), set(), set()],
            material: Material::new(mixture, std::slice::from_ref(&g)),
            discrepancy: 1.0,
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
        let f = found.material.at(&at, 30.0, 20.0);
        assert!(f.iter().all(|f| (f * pi - 0.2).abs() < 1e-6), "{f:?}");
        let set = &found.draws[2];
        let logs = set.posterior.iter().zip(&set.discrepancies).map(|(x, g)| {
            let f: f64 = x.iter().zip(&at).map(|(x, f)| x * f).sum();
            (pi * f * g.factor(30.0, 20.0)).ln()
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
