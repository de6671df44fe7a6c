//! What the images leave open: draws from an approximate posterior of the weights.
//!
//! Around the fit the log-likelihood is quadratic, with the information F of independent
//! halves of the paths and the score g. Noise is not all that the residual holds: model
//! error is common to neighbouring cells, and paths have heavy tails. The score's
//! covariance is therefore taken from the scores of blocks of cells, and the
//! likelihood rescaled to it in the directions in which F has information (a sandwich). The
//! prior holds that few atoms are used ([`super::sparse`]); docs/adr/0006.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rayon::prelude::*;

use super::budget::{Budget, Source};
use super::discrepancy_fit::Eliminated;
use super::normal_equations::{MIN_SCATTER, Signal, above_noise, scatter, with_eigenvalues};
use super::nuisance::{BenchCoupling, Parameter};
use super::objective::{Linearised, ScoreNoise};
use super::sparse::SparsePosterior;
use crate::brdf::discrepancy::Discrepancy;
use crate::brdf::{Atom, Dictionary};
use crate::random::{Purpose, stream};

/// Samples of one channel group, and of the prior alone.
pub struct PosteriorSamples {
    /// Posterior samples, each on the simplex.
    pub posterior: Vec<DVector<f64>>,
    /// Prior samples, each on the simplex.
    pub prior: Vec<DVector<f64>>,
    /// Relative error of the images that the mixture leaves beyond noise, 0 or more.
    pub excess_error: f64,
    /// Directions of the space of weights in which the images have more information than
    /// their noise and the paths' could feign; 0: none at all, and the posterior is the prior.
    pub informed: usize,
    /// Standard deviation of the natural logarithm of the scale common to all of f, where the
    /// images say nothing of it; 0 where the samples of the weights contain it.
    pub scale_deviation: f64,
    /// The model discrepancy of each posterior sample; empty where there is none.
    pub discrepancies: Vec<Discrepancy>,
    /// Where the posterior's spread comes from, where that is known.
    pub budget: Option<Budget>,
}

/// Atoms that a material uses a priori, on average.
const EXPECTED_ATOMS: f64 = 5.0;

/// Slope of the log prior density along the weight of black: materials absorb. A priori black
/// then has 0.39 of the weight in paper42 and 0.46 in rig26; in reference projections of
/// measured materials it has 0.35 (docs/adr/0006).
const BLACK_LOG_PRIOR_SLOPE: f64 = 6.0;

/// Steps of the chain per channel group.
const STEPS: usize = 20_000;

/// What makes the score scatter in addition to the residual, per channel group.
#[derive(Default)]
pub struct Adds<'a> {
    /// What an uncertain bench adds.
    pub bench: Option<&'a BenchCoupling>,
    /// Covariance that a surface adds which deviates from its mesh; empty where none is stated.
    pub form: &'a [DMatrix<f64>],
    /// Covariance by errors that all values have in common; empty where there are none.
    pub common: &'a [DMatrix<f64>],
    /// What capture and render make of the residual's own scatter; empty where unknown.
    pub noise: &'a [ScoreNoise],
    /// The model discrepancy; empty where there is none.
    pub discrepancy: &'a [Eliminated],
}

/// Draws `count` samples of the dictionary's weights from their posterior distribution around the
/// fitted `mixture`, for each group of channels that share weights; [`draw_prior`] adds samples
/// of the prior.
pub fn draw(
    dictionary: &Dictionary,
    mixture: &[DVector<f64>],
    pass: &Linearised,
    adds: &Adds<'_>,
    count: usize,
    seed: u64,
) -> Vec<PosteriorSamples> {
    let prior = prior_slope(dictionary);
    (0..mixture.len())
        .into_par_iter()
        .map(|group| sample_group(&mixture[group], &prior, pass, adds, group, count, seed))
        .collect()
}

/// Draws as many weights from the prior as each channel group has from its posterior, by chains
/// that begin around `mixture`.
pub fn draw_prior(
    posterior_samples: &mut [PosteriorSamples],
    dictionary: &Dictionary,
    mixture: &[DVector<f64>],
    seed: u64,
) {
    let n = dictionary.len();
    let slope = prior_slope(dictionary);
    let groups = posterior_samples.par_iter_mut().enumerate();
    groups.for_each(|(group, samples)| {
        let (flat, count) = (DMatrix::zeros(n, n), samples.posterior.len());
        samples.prior = chain(
            flat,
            slope.clone(),
            &mixture[group],
            count,
            seed,
            [group, 1],
        );
    });
}

/// `count` samples of a Gaussian likelihood and the prior on the simplex, by the numbers of a
/// channel group for a purpose.
fn chain(
    h: DMatrix<f64>,
    b: DVector<f64>,
    start: &DVector<f64>,
    count: usize,
    seed: u64,
    [group, purpose]: [usize; 2],
) -> Vec<DVector<f64>> {
    if count == 0 {
        return Vec::new();
    }
    let mut numbers = stream(seed, Purpose::Posterior, group as u64, purpose as u64, 0);
    let expected = EXPECTED_ATOMS.min(0.5 * b.len() as f64);
    SparsePosterior::new(h, b, expected).draw(start, count, STEPS, &mut numbers)
}

/// Slope of the log prior density along each weight, in addition to the prior of [`super::sparse`].
fn prior_slope(dictionary: &Dictionary) -> DVector<f64> {
    let slope = |atom: &Atom| match atom {
        Atom::Black => BLACK_LOG_PRIOR_SLOPE,
        _ => 0.0,
    };
    DVector::from_iterator(dictionary.len(), dictionary.atoms().iter().map(slope))
}

fn sample_group(
    mixture: &DVector<f64>,
    prior: &DVector<f64>,
    pass: &Linearised,
    adds: &Adds<'_>,
    group: usize,
    count: usize,
    seed: u64,
) -> PosteriorSamples {
    let Likelihood {
        h,
        b,
        informed,
        budget,
    } = adjusted_likelihood(mixture, pass, adds, group);
    let posterior = chain(h, b + prior, mixture, count, seed, [group, 0]);
    let mut numbers = stream(seed, Purpose::Posterior, group as u64, 2, 0);
    let discrepancies = adds
        .discrepancy
        .get(group)
        .map_or_else(Vec::new, |discrepancy| {
            let posterior_samples = posterior.iter();
            posterior_samples
                .map(|x| discrepancy.draw(&(x - mixture), &mut numbers))
                .collect()
        });
    PosteriorSamples {
        prior: Vec::new(),
        excess_error: 0.0,
        informed,
        scale_deviation: 0.0,
        discrepancies,
        posterior,
        budget,
    }
}

/// Quadratic log-likelihood −½ xᵀHx + bᵀx.
struct Likelihood {
    h: DMatrix<f64>,
    b: DVector<f64>,
    /// Rank of `h`: directions in which the images exceed noise.
    informed: usize,
    /// What makes the score scatter, where the noise is known.
    budget: Option<Budget>,
}

/// The likelihood whose score scatters as the blocks' does, and, where the `noise` is known,
/// what makes it scatter.
fn adjusted_likelihood(
    mixture: &DVector<f64>,
    pass: &Linearised,
    adds: &Adds<'_>,
    group: usize,
) -> Likelihood {
    let quadratic = &pass.quadratics[group];
    let (information, scores, score) = match adds.discrepancy.get(group) {
        Some(d) => (
            d.information.clone(),
            &d.block_scores,
            d.total_score.clone(),
        ),
        None => {
            let scores = &pass.block_scores[group];
            let information = Signal::new(&pass.information[group], &quadratic.h).information;
            let none = DVector::zeros(mixture.len());
            (
                information,
                scores,
                scores.iter().fold(none, |sum, s| sum + s),
            )
        }
    };
    let eigen = SymmetricEigen::new(information);
    let largest = eigen.eigenvalues.max();
    let kept: Vec<usize> = (0..mixture.len())
        .filter(|&k| eigen.eigenvalues[k] > (1e-7 * largest).max(1.0))
        .collect();
    if kept.is_empty() {
        return Likelihood {
            h: DMatrix::zeros(mixture.len(), mixture.len()),
            b: DVector::zeros(mixture.len()),
            informed: 0,
            budget: None,
        };
    }
    let vectors = eigen.eigenvectors.select_columns(&kept);
    let scales = DVector::from_iterator(
        kept.len(),
        kept.iter().map(|&k| eigen.eigenvalues[k].sqrt()),
    );
    let root = &vectors * DMatrix::from_diagonal(&scales);
    let inverse = &vectors * DMatrix::from_diagonal(&scales.map(|s| 1.0 / s));

    // Covariance of the score where F has unit eigenvalues.
    let mut scatter = scatter(&inverse, scores);
    // The fit has made the residuals smaller than the errors.
    let blocks = scores.len() as f64;
    scatter *= blocks / (blocks - 0.5 * kept.len() as f64).max(1.0);
    let least = match adds.discrepancy {
        [] => 1.0,
        _ => MIN_SCATTER,
    };
    let mut scatter = with_eigenvalues(scatter, |v| v.max(least));
    let whitened = |m: &DMatrix<f64>| inverse.tr_mul(m) * &inverse;
    if let Some(bench) = adds.bench {
        scatter += above_noise(whitened(&bench.covariance(group)));
    }
    let form = adds.form.get(group).map(whitened);
    if let Some(form) = &form {
        scatter += form;
    }
    let common = adds.common.get(group).map(whitened);
    if let Some(common) = &common {
        scatter += common;
    }
    let budget = adds.noise.get(group).map(|noise| {
        let mut known = vec![
            (Source::CaptureNoise, whitened(&noise.captured)),
            (Source::RenderNoise, whitened(&noise.rendered)),
        ];
        known.extend(form.map(|form| (Source::Mesh, form)));
        known.extend(common.map(|common| (Source::Intensities, common)));
        let of = |source: Source| {
            move |parameter: Parameter| match parameter {
                Parameter::Rotation(_) | Parameter::Translation(_) => source == Source::Pose,
                Parameter::LightAzimuth(_) | Parameter::LightElevation(_) => {
                    source == Source::LightDirections
                }
                Parameter::Intensity(_) | Parameter::StrayLight(_) => source == Source::Intensities,
            }
        };
        for source in [Source::Pose, Source::LightDirections, Source::Intensities] {
            if let Some(bench) = adds.bench {
                known.push((
                    source,
                    above_noise(whitened(&bench.part(group, of(source)))),
                ));
            }
        }
        Budget::new(&root, &scatter, &known)
    });
    let weight = with_eigenvalues(scatter, |v| 1.0 / v);
    let h = &root * &weight * root.transpose();
    // The likelihood's own score, which the fit's prior and share of noise leave nonzero.
    let b = &h * mixture + &root * (&weight * inverse.tr_mul(&score));
    Likelihood {
        h,
        b,
        informed: kept.len(),
        budget,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean weight of black in prior samples, against the sum over the sizes of sets with and
    /// without it (0.394, 0.463), each with the mean of exp(slope · x) over Beta(1, k − 1).
    #[test]
    fn materials_absorb_a_priori() {
        for (dictionary, expected) in [(Dictionary::paper42(), 0.394), (Dictionary::rig26(), 0.463)]
        {
            let n = dictionary.len();
            let black = |a: &Atom| *a == Atom::Black;
            let black = dictionary.atoms().iter().position(black).unwrap();
            let slope = prior_slope(&dictionary);
            assert_eq!(slope.sum(), BLACK_LOG_PRIOR_SLOPE, "only black");
            let prior = SparsePosterior::new(DMatrix::zeros(n, n), slope, EXPECTED_ATOMS);
            let mut numbers = stream(6, Purpose::Posterior, 0, 0, 0);
            let start = DVector::from_element(n, 1.0 / n as f64);
            let posterior_samples = prior.draw(&start, 20_000, 100_000, &mut numbers);
            let mean = posterior_samples.iter().map(|x| x[black]).sum::<f64>()
                / posterior_samples.len() as f64;
            assert!(
                (mean - expected).abs() < 0.03,
                "{}: {mean}",
                dictionary.name()
            );
        }
    }
}
