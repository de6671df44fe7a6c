//! The rounds: fit the weights on the bench as it is believed, see how the images change
//! with the bench, step, repeat; then fit in full at the refined bench.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::derivatives::{DerivativeImages, DerivativeOptions};
use super::parameters::{Bench, BenchPriors, Parameter};
use super::spectrum::Spectrum;
use super::system::{BenchLinearisation, Model, Normal};
use crate::brdf::dictionary::Dictionary;
use crate::brdf::mixture::Mixture;
use crate::inverse::fit::{Fit, FitError, FitOptions, fit_on_bench};
use crate::inverse::gauss_newton::GaussNewton;
use crate::inverse::objective::{Linearised, Objective};
use crate::inverse::ridge::Ridge;
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::transport::{Cache, DirectMatrix, Proposal, Scene};

/// How a bench is refined.
#[derive(Clone, Debug, PartialEq)]
pub struct RefineOptions {
    /// Most rounds, 2..=20; the first does not know how far the scores can be trusted.
    pub rounds: usize,
    /// Paths per pixel of a round's fit, at least 2; never more than the final fit's.
    pub samples_per_pixel: u32,
    /// Direct reflection of a round's fit: square root of the samples per pixel, 1..=64.
    pub direct_strata: u32,
    /// Paths per pixel, both halves together, on each differing bench, at least 2.
    pub derivative_samples: u32,
    /// Longest path of the derivatives, in surface reflections.
    pub derivative_reflections: u32,
    /// Done when a step is shorter than this, in posterior deviations.
    pub settled: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            rounds: 5,
            samples_per_pixel: 64,
            direct_strata: 8,
            derivative_samples: 16,
            derivative_reflections: 6,
            settled: 0.3,
        }
    }
}

/// A refined parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimated {
    /// Which.
    pub parameter: Parameter,
    /// Difference from the description, in the parameter's unit.
    pub value: f64,
    /// Posterior standard deviation.
    pub deviation: f64,
    /// Standard deviation before the images.
    pub prior_deviation: f64,
}

/// A bench as refined.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchEstimate {
    /// All parameters that were not taken as exactly known.
    pub parameters: Vec<Estimated>,
    /// What the images do not tell, by name: held at the prior.
    pub held: Vec<String>,
    /// Rounds that were taken.
    pub rounds: usize,
    /// Whether the last step was short.
    pub settled: bool,
    /// Mean squared residual on the described bench, and on the refined one.
    pub reduced_chi2: [f64; 2],
}

/// A fit on a refined bench.
pub struct RefinedFit {
    /// The fit; its draws know what the bench leaves open.
    pub fit: Fit,
    /// The scene that was fitted, in the frame of the sample where it truly is.
    pub scene: Scene,
    /// The bench.
    pub estimate: BenchEstimate,
}

/// Fits the weights of `dictionary` and the bench within `priors` to one captured
/// image per light of `scene`, which is the bench as described. `stage` is told what
/// begins.
pub fn refine_bench(
    scene: &Scene,
    captured: &[RadianceImage],
    dictionary: &Arc<Dictionary>,
    options: &FitOptions,
    priors: &BenchPriors,
    refine: &RefineOptions,
    stage: &mut dyn FnMut(&str),
) -> Result<RefinedFit, FitError> {
    crate::inverse::fit::check(scene, captured)?;
    let clock = std::time::Instant::now();
    let bench = Bench::new(scene, priors);
    let mut rounds = Rounds {
        bench: &bench,
        captured,
        dictionary,
        options,
        refine,
        mixture: None,
    };
    let mut values = DVector::zeros(bench.parameters().len());
    let mut best: Option<Best> = None;
    let (mut first_chi2, mut taken, mut settled) = (f64::NAN, 0, false);
    while taken < refine.rounds && !bench.parameters().is_empty() && !settled {
        taken += 1;
        stage(&format!("refining the bench, round {taken}"));
        let round = rounds.take(&values, taken)?;
        if first_chi2.is_nan() {
            first_chi2 = round.chi2;
        }
        // The prior counts once, against as many residuals as there are.
        let loss = round.chi2 + 2.0 * round.spectrum.prior_loss(&values) / round.count;
        let lengths = round.spectrum.values.as_slice();
        tracing::debug!(taken, loss, chi2 = round.chi2, values = ?values.as_slice(), ?lengths, "bench round");
        match best {
            Some(ref mut best) if loss > best.loss + WORSE * best.loss.abs() + round.scatter() => {
                // Too far: a quarter of the way from where it was better.
                best.step *= 0.25;
                values = &best.values + &best.step;
                settled = best.spectrum.length(&best.step) < refine.settled;
            }
            _ => {
                let step = round.spectrum.step(&values, &round.score, &round.noise);
                settled = taken > 1 && round.spectrum.length(&step) < refine.settled;
                let next = &values + &step;
                best = Some(Best {
                    values: std::mem::replace(&mut values, next),
                    step,
                    loss,
                    chi2: round.chi2,
                    spectrum: round.spectrum,
                    derivatives: round.derivatives,
                });
            }
        }
    }
    let refining = clock.elapsed().as_secs_f64();
    let refined = bench.scene(&values);
    let without_stray_light = bench.without_stray_light(captured, &values);
    let last_chi2 = best.as_ref().map_or(f64::NAN, |best| best.chi2);
    let linearisation = best.map(|best| BenchLinearisation {
        bench,
        derivatives: best.derivatives,
        spectrum: best.spectrum,
    });
    let mut fit = fit_on_bench(
        &refined,
        &without_stray_light,
        dictionary,
        options,
        linearisation.as_ref(),
        stage,
    )?;
    fit.timings.insert(0, ("refine bench", refining));
    let mut estimate = BenchEstimate {
        parameters: Vec::new(),
        held: Vec::new(),
        rounds: taken,
        settled,
        reduced_chi2: [first_chi2, last_chi2],
    };
    if let Some(BenchLinearisation {
        bench, spectrum, ..
    }) = &linearisation
    {
        let deviations = spectrum.deviations();
        estimate.held = spectrum.held(bench);
        estimate.parameters = (0..bench.parameters().len())
            .map(|k| Estimated {
                parameter: bench.parameters()[k],
                value: values[k],
                deviation: deviations[k],
                prior_deviation: bench.prior_deviation(k),
            })
            .collect();
    }
    Ok(RefinedFit {
        fit,
        scene: refined,
        estimate,
    })
}

/// A loss that grew by a smaller fraction is within what masks change from round to round.
const WORSE: f64 = 0.01;

/// Where the loss was least.
struct Best {
    values: DVector<f64>,
    step: DVector<f64>,
    loss: f64,
    chi2: f64,
    spectrum: Spectrum,
    derivatives: DerivativeImages,
}

/// What the rounds share.
struct Rounds<'a> {
    bench: &'a Bench,
    captured: &'a [RadianceImage],
    dictionary: &'a Arc<Dictionary>,
    options: &'a FitOptions,
    refine: &'a RefineOptions,
    /// Weights of the round before.
    mixture: Option<Vec<DVector<f64>>>,
}

/// What one round says.
struct Round {
    spectrum: Spectrum,
    score: DVector<f64>,
    noise: DMatrix<f64>,
    derivatives: DerivativeImages,
    /// Mean squared residual, and of how many.
    chi2: f64,
    count: f64,
}

impl Round {
    /// Three deviations of a mean of products of independent residuals, whose halves
    /// each have twice the variance of their mean.
    fn scatter(&self) -> f64 {
        6.0 / self.count.sqrt()
    }
}

impl Rounds<'_> {
    fn take(&mut self, values: &DVector<f64>, round: usize) -> Result<Round, FitError> {
        let (options, refine) = (self.options, self.refine);
        let scene = self.bench.scene(values);
        let captured = self.bench.without_stray_light(self.captured, values);
        let mut paths = options.cache.clone();
        paths.samples_per_pixel = paths.samples_per_pixel.min(refine.samples_per_pixel);
        let strata = options.direct_strata.min(refine.direct_strata);
        let direct = DirectMatrix::new(&scene, self.dictionary, strata, paths.seed);
        let cache = Cache::trace(&scene, self.dictionary, &paths)?;
        let objective = Objective::new(
            &cache,
            &direct,
            &captured,
            None,
            options.channels,
            options.kernel,
            options.model_error,
        );
        let pixels = scene.camera.pixels();
        let mut count = 0usize;
        let mut wanted = vec![false; pixels];
        for image in 0..captured.len() {
            let before = count;
            for (pixel, wanted) in wanted.iter_mut().enumerate() {
                let compared = objective.is_compared(image, pixel);
                *wanted |= compared;
                count += 3 * usize::from(compared);
            }
            if count == before {
                return Err(FitError::NothingToCompare { image });
            }
        }
        let (mixture, residual_weights, pass) = self.weights(&objective)?;
        let per_channel =
            std::array::from_fn(|c| mixture[c.min(mixture.len() - 1)].iter().copied().collect());
        // The simplex programme keeps the sum to rounding.
        let material = Mixture::new(self.dictionary.clone(), per_channel)
            .map_err(|_| crate::inverse::simplex::SimplexError::NotConvex)?;
        let derivatives = DerivativeImages::trace(
            self.bench,
            values,
            &material,
            &wanted,
            &DerivativeOptions {
                samples_per_half: (refine.derivative_samples / 2).max(1),
                max_reflections: paths.max_reflections.min(refine.derivative_reflections),
                seed: stream(paths.seed, Purpose::BenchDerivative, round as u64, 0, 0).bits(),
                proposal: Proposal::resembling(&material, 0.3),
                average_px: (scene.camera.resolution_px[0] + 12) / 24,
            },
        );
        let model = Model {
            objective: &objective,
            cache: &cache,
            direct: &direct,
            kernel: options.kernel,
        };
        let normal = Normal::new(
            &model,
            self.bench,
            &derivatives,
            &residual_weights,
            &mixture,
        );
        let reduced = normal.reduced(&pass.information, &mixture);
        let loss: f64 = pass.quadratics.iter().map(|q| q.c).sum();
        let spectrum = Spectrum::new(self.bench, &reduced.information);
        self.mixture = Some(mixture);
        Ok(Round {
            // At first the scores scatter because the bench is off, not by noise.
            spectrum: if round == 1 {
                spectrum
            } else {
                spectrum.widened(&reduced.block_scores)
            },
            score: reduced.score,
            noise: reduced.noise,
            derivatives,
            chi2: 2.0 * loss / count as f64,
            count: count as f64,
        })
    }

    /// The weights on the bench as it is believed now, from those of the round before.
    #[expect(clippy::type_complexity, reason = "three results of one optimisation")]
    fn weights(
        &self,
        objective: &Objective<'_>,
    ) -> Result<(Vec<DVector<f64>>, Vec<Vec<[f64; 3]>>, Linearised), FitError> {
        let mut residual_weights = objective.weights(None);
        let mut mixture = match &self.mixture {
            Some(mixture) => mixture.clone(),
            None => objective
                .single_bounce(&residual_weights)
                .iter()
                .map(|quadratic| Ok(quadratic.minimise()?.x))
                .collect::<Result<_, FitError>>()?,
        };
        let method = GaussNewton::default();
        let ridge = Ridge::first(objective);
        let (pass, _) =
            method.minimise(objective, &residual_weights, &ridge, &mut mixture, &mut ())?;
        let ridge = Ridge::after(&pass);
        residual_weights = objective.weights_after(&pass);
        let (pass, _) =
            method.minimise(objective, &residual_weights, &ridge, &mut mixture, &mut ())?;
        Ok((mixture, residual_weights, pass))
    }
}
