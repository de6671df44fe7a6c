//! The rounds: fit the weights on the bench as it is believed, see how the images change
//! with the bench, step, repeat; and the fit in full at the refined bench.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::derivatives::{AVERAGED, DerivativeImages, DerivativeOptions};
use super::parameters::{Nuisance, Parameter};
use super::spectrum::Spectrum;
use super::system::{BenchLinearisation, Columns};
use crate::bench_priors::BenchPriors;
use crate::brdf::dictionary::Dictionary;
use crate::brdf::mixture::Mixture;
use crate::cells::{Captured, check_count};
use crate::inverse::fit::{DEFENSIVE, Fit, fit_on_bench};
use crate::inverse::gauss_newton::GaussNewton;
use crate::inverse::normal_equations::MIN_SCATTER;
use crate::inverse::objective::{Linearised, Modelled, Objective, ResidualWeights};
use crate::inverse::options::{FitError, FitOptions, Optimizer};
use crate::inverse::solve::{Paths, Solution, solve};
use crate::progress::Progress;
use crate::random::{Purpose, stream};
use crate::transport::{Proposal, Scene};

/// How a bench is refined.
#[derive(Clone, Debug, PartialEq)]
pub struct RefineOptions {
    /// Most rounds, 2..=20; the first does not know the scatter of the scores.
    pub rounds: usize,
    /// Paths per cell of a round's fit over those of the final fit, 1..=64, as far as they fit
    /// into its memory. The difference between the intensities' common scale and albedo is lost in the
    /// noise of fewer. The first round has a quarter, the second half of them.
    pub times_paths: u32,
    /// Direct reflection of a round: square root of the samples per cell, 1..=64. Noise of
    /// theirs that moves the highlights moves the bench.
    pub direct_strata: u32,
    /// The same of the derivatives, 1..=64. Differences by the same points on two benches are
    /// smooth where values are not, and each round takes some thirty of them.
    pub derivative_strata: u32,
    /// Paths per cell, both halves together, on each differing bench, of the derivatives that
    /// say how well the bench is known and how much it leaves open; at least 2. The rounds use
    /// those of direct reflection alone (docs/adr/0009).
    pub derivative_samples: u32,
    /// Longest path of the derivatives, in surface reflections.
    pub derivative_reflections: u32,
    /// Done when a step is shorter than this, in posterior deviations.
    pub settled: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            rounds: 8,
            times_paths: 3,
            direct_strata: 16,
            derivative_strata: 6,
            derivative_samples: 128,
            derivative_reflections: 6,
            settled: 0.3,
        }
    }
}

/// The round from which on all paths are traced, and like ones: benches of two rounds can be
/// compared. Those before have a half of them, a quarter and so on.
const FIRST_FULL_ROUND: usize = 3;

/// Mean square of a refused bench over that of the best, up to which it did not lead far off.
const MAX_CHI_SQUARE_RATIO: f64 = 1.25;

/// A refined parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimated {
    /// Which.
    pub parameter: Parameter,
    /// Difference from the description, in the parameter's unit.
    pub value: f64,
    /// Standard deviation of what is left open, which can be above the prior's (docs/adr/0009).
    pub deviation: f64,
    /// Standard deviation before the images.
    pub prior_deviation: f64,
}

/// A bench as refined.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchEstimate {
    /// All parameters that were not taken as exactly known.
    pub parameters: Vec<Estimated>,
    /// Directions that the images leave open, by name: fixed at the prior.
    pub fixed: Vec<String>,
    /// Rounds that were taken.
    pub rounds: usize,
    /// Whether the last step was short, and not because longer parts of it led far off.
    pub settled: bool,
    /// Mean squared residual over its deviation, the stated error of the model included, on
    /// the described bench and on the refined one.
    pub reduced_chi2: [f64; 2],
}

/// A refined bench, and the images as they compare with it.
pub struct RefinedBench {
    /// The scene in the frame of the sample where it truly is.
    pub scene: Scene,
    /// The bench.
    pub estimate: BenchEstimate,
    /// The captured images without stray light.
    captured: Captured,
    /// How much of the material's uncertainty the bench leaves open.
    linearisation: Option<BenchLinearisation>,
    seconds: f64,
}

impl RefinedBench {
    /// Fits the weights of `dictionary` on this bench; the samples know what it leaves open.
    pub fn fit(
        &self,
        dictionary: &Dictionary,
        options: &FitOptions,
        progress: &dyn Progress,
    ) -> Result<Fit, FitError> {
        let bench = self.linearisation.as_ref();
        let (scene, captured) = (&self.scene, &self.captured);
        let mut fit = fit_on_bench(scene, captured, dictionary, options, bench, progress)?;
        fit.timings.insert(0, ("refine bench", self.seconds));
        Ok(fit)
    }
}

/// Refines the bench within `priors` by the captured image of each light of `scene`, which is
/// the bench as described, with the weights of `dictionary` free to follow. `options` are
/// those of the fit that is to come. `progress` hears what begins.
pub fn refine_bench(
    scene: &Scene,
    captured: &Captured,
    dictionary: &Arc<Dictionary>,
    options: &FitOptions,
    priors: &BenchPriors,
    refine: &RefineOptions,
    progress: &dyn Progress,
) -> Result<RefinedBench, FitError> {
    check_count(scene, captured.images.len())?;
    // Where a part of the dictionary makes an estimate of its own, it does for the bench.
    let part = dictionary.first_part().map(Arc::new);
    let dictionary = part.as_ref().unwrap_or(dictionary);
    let clock = std::time::Instant::now();
    let bench = Nuisance::new(scene, priors);
    let mut rounds = Rounds {
        bench: &bench,
        captured,
        dictionary,
        options,
        refine,
        before: None,
        followed: None,
    };
    let mut values = DVector::zeros(bench.parameters().len());
    let mut best: Option<Best> = None;
    let (mut first_chi2, mut taken, mut settled) = (f64::NAN, 0, false);
    while taken < refine.rounds && !bench.parameters().is_empty() && !settled {
        taken += 1;
        progress.begin(&format!("refining the bench, round {taken}"), None);
        let round = rounds.take(&values, taken, 0)?;
        if first_chi2.is_nan() {
            first_chi2 = round.chi2;
        }
        let prior_loss = round.spectrum.prior_loss(&values);
        let lengths = round.spectrum.values.as_slice();
        log::debug!(
            "nuisance parameters, round {taken}: chi2 {}, prior loss {prior_loss}, values {:?}, lengths {lengths:?}",
            round.chi2,
            values.as_slice()
        );
        match best {
            Some(ref mut best)
                if best.round >= FIRST_FULL_ROUND
                    && round
                        .image
                        .is_worse_than(&best.image, prior_loss - best.prior_loss) =>
            {
                log::debug!("the step was too long");
                // Too far: a quarter of the way from where it was better.
                best.step *= 0.25;
                values = &best.values + &best.step;
                if best.spectrum.length(&best.step) < refine.settled {
                    // Where it led far off, it is short only because it was refused.
                    settled = round.chi2 < MAX_CHI_SQUARE_RATIO * best.chi2;
                    break;
                }
            }
            _ => {
                let step = round.spectrum.step(&values, &round.score);
                settled = taken > 1 && round.spectrum.length(&step) < refine.settled;
                let next = &values + &step;
                best = Some(Best {
                    round: taken,
                    values: std::mem::replace(&mut values, next),
                    step,
                    prior_loss,
                    image: round.image,
                    chi2: round.chi2,
                    spectrum: round.spectrum,
                });
            }
        }
    }
    if let (false, Some(best)) = (settled, &best) {
        // Nothing has been seen of where the last step led.
        values.copy_from(&best.values);
    }
    let refined = bench.scene(&values);
    let without_stray_light = bench.without_stray_light(captured, &values);
    let mut estimate = BenchEstimate {
        parameters: Vec::new(),
        fixed: Vec::new(),
        rounds: taken,
        settled,
        reduced_chi2: [first_chi2; 2],
    };
    let mut linearisation = None;
    if best.is_some() {
        progress.begin("what the refined bench leaves open", None);
        let samples = (refine.derivative_samples / 2).max(1);
        let last = rounds.take(&values, taken.max(FIRST_FULL_ROUND) + 1, samples)?;
        let known = last.spectrum.sandwich(&last.response);
        let deviations = known.deviations();
        estimate.reduced_chi2[1] = last.chi2;
        estimate.fixed = last.spectrum.fixed(&bench);
        estimate.parameters = (0..bench.parameters().len())
            .map(|k| Estimated {
                parameter: bench.parameters()[k],
                value: values[k],
                deviation: deviations[k],
                prior_deviation: bench.prior_deviation(k),
            })
            .collect();
        linearisation = Some(BenchLinearisation {
            bench,
            derivatives: last.derivatives,
            spectrum: known,
            scale_is_open: last.scale_is_open,
        });
    }
    Ok(RefinedBench {
        scene: refined,
        estimate,
        captured: without_stray_light,
        linearisation,
        seconds: clock.elapsed().as_secs_f64(),
    })
}

/// Where the loss was least.
struct Best {
    round: usize,
    values: DVector<f64>,
    step: DVector<f64>,
    prior_loss: f64,
    image: Compared,
    chi2: f64,
    spectrum: Spectrum,
}

/// What the rounds share.
struct Rounds<'a> {
    bench: &'a Nuisance,
    captured: &'a Captured,
    dictionary: &'a Arc<Dictionary>,
    options: &'a FitOptions,
    refine: &'a RefineOptions,
    /// Solution of the round before, whose weights the next one starts with.
    before: Option<Solution>,
    /// The material whose directions the paths take, and how well it explained the images: the
    /// round before's until all paths are traced, unless it explained them worse; then the same,
    /// so that benches are compared with like paths.
    followed: Option<(Mixture, f64)>,
}

/// What one round says.
struct Round {
    spectrum: Spectrum,
    score: DVector<f64>,
    /// How the score answers to the bench.
    response: DMatrix<f64>,
    /// Whether the images say nothing of the intensities' common scale.
    scale_is_open: bool,
    derivatives: DerivativeImages,
    image: Compared,
    /// Mean squared residual over its deviation, the stated error of the model included.
    chi2: f64,
}

/// How the images compare with the model of one bench, so that two benches can be compared
/// by the same values and the same weights.
struct Compared {
    /// Squared residuals less the render's variance, `[light][cell][channel]`.
    squares: Vec<Vec<[f64; 3]>>,
    residual_weights: ResidualWeights,
}

impl Compared {
    fn new(
        objective: &Objective<'_>,
        pass: &Linearised,
        residual_weights: ResidualWeights,
    ) -> Self {
        let squares = pass.model.iter().enumerate().map(|(light, image)| {
            let square = |(cell, values): (usize, &[Modelled; 3])| {
                let [target, _] = objective.captured(light, cell);
                std::array::from_fn(|c| {
                    (target[c] - values[c].value()).powi(2) - values[c].variance
                })
            };
            image.iter().enumerate().map(square).collect()
        });
        Self {
            squares: squares.collect(),
            residual_weights,
        }
    }

    /// The squares weighed and summed.
    fn sum(&self, weights: &ResidualWeights) -> f64 {
        let squares = self.squares.iter().flatten().flatten();
        let weights = weights.iter().flatten().flatten();
        squares.zip(weights).map(|(square, w)| w * square).sum()
    }

    /// Whether this fits worse than `before` beyond three deviations of the difference, with
    /// `prior` as what the prior's part of the loss gained. Weighed as before: a bench that
    /// explains less makes weights of its own under which nothing looks wrong.
    fn is_worse_than(&self, before: &Self, prior: f64) -> bool {
        let (mut sum, mut square) = (2.0 * prior, 0.0);
        for light in 0..self.squares.len() {
            for cell in 0..self.squares[light].len() {
                for c in 0..3 {
                    if self.residual_weights[light][cell][c] <= 0.0 {
                        continue;
                    }
                    let change = self.squares[light][cell][c] - before.squares[light][cell][c];
                    let change = before.residual_weights[light][cell][c] * change;
                    sum += change;
                    square += change * change;
                }
            }
        }
        sum > 3.0 * square.sqrt()
    }
}

impl Rounds<'_> {
    /// Fits the weights on the bench at `values`, and sees how the images change with it: by
    /// direct reflection, and by way of other surfaces with so many paths per cell and half.
    fn take(
        &mut self,
        values: &DVector<f64>,
        round: usize,
        samples_per_half: u32,
    ) -> Result<Round, FitError> {
        let (options, refine) = (self.options, self.refine);
        let scene = self.bench.scene(values);
        let captured = self.bench.without_stray_light(self.captured, values);
        let mut options = FitOptions {
            optimizer: Optimizer::GaussNewton(GaussNewton::default()),
            direct_strata: options.direct_strata.min(refine.direct_strata),
            ..options.clone()
        };
        if let Some((material, _)) = &self.followed {
            options.cache.proposal = Proposal::resembling(material, DEFENSIVE);
        }
        let early = FIRST_FULL_ROUND.saturating_sub(round);
        let all_paths = options
            .cache
            .samples_per_cell
            .saturating_mul(refine.times_paths);
        options.cache.samples_per_cell = (all_paths >> early).max(8);
        let quiet = &();
        let paths = Paths::trace(
            &scene,
            &self.captured.cells,
            self.dictionary,
            None,
            &options,
            quiet,
        )?;
        let objective = paths.objective(&captured, &options);
        let compared = |image: usize| {
            let cells = 0..captured.len();
            cells
                .filter(|&cell| objective.is_compared(image, cell))
                .count()
        };
        let count: usize = (0..objective.lights())
            .map(|image| 3 * compared(image))
            .sum();
        let wanted = objective.compared_pixels();
        let before = self.before.as_ref();
        let solved = solve(&paths, &objective, before, &options, quiet)?;
        let (mixture, residual_weights) = (solved.mixture, solved.residual_weights);
        let per_channel =
            std::array::from_fn(|c| mixture[c.min(mixture.len() - 1)].iter().copied().collect());
        // The simplex programme keeps the sum to rounding.
        let material = Mixture::new(self.dictionary.clone(), per_channel)
            .map_err(|_| crate::simplex::SimplexError::NotConvex)?;
        let derivatives = self.derivatives(values, &material, &wanted, samples_per_half, round);
        let instruments = Columns {
            bench: self.bench,
            derivatives: &derivatives,
        };
        let reduced = instruments.reduced(
            &objective,
            &residual_weights,
            &mixture,
            &solved.pass.information,
        );
        let spectrum = Spectrum::new(self.bench, &reduced.information);
        self.before = Some(solved.solution);
        let image = Compared::new(&objective, &solved.pass, residual_weights);
        let chi2 = image.sum(&objective.weights(Some(&solved.pass.model))) / count as f64;
        // Where lamps are believed too dark all weights end up white: nothing to follow.
        let worst = self
            .followed
            .as_ref()
            .map_or(f64::INFINITY, |f| f.1.max(1.0));
        if early > 0 && chi2 < worst {
            self.followed = Some((material.clone(), chi2));
        }
        Ok(Round {
            // At first the scores scatter because the bench is off, not by noise.
            spectrum: if round == 1 {
                spectrum
            } else {
                spectrum.widened(&reduced.block_scores, MIN_SCATTER)
            },
            score: reduced.score,
            response: reduced.response,
            scale_is_open: reduced.scale_is_open,
            derivatives,
            chi2,
            image,
        })
    }

    /// How the images of `material` change with the bench around `values`.
    fn derivatives(
        &self,
        values: &DVector<f64>,
        material: &Mixture,
        wanted: &[bool],
        samples_per_half: u32,
        round: usize,
    ) -> DerivativeImages {
        let (paths, refine) = (&self.options.cache, self.refine);
        let options = DerivativeOptions {
            samples_per_half,
            max_reflections: paths.max_reflections.min(refine.derivative_reflections),
            seed: stream(paths.seed, Purpose::BenchDerivative, round as u64, 0, 0).bits(),
            proposal: Proposal::resembling(material, 0.3),
            steering: paths.steering,
            direct_strata: refine.derivative_strata,
            average: AVERAGED,
        };
        let cells = &self.captured.cells;
        DerivativeImages::trace(self.bench, values, cells, material, wanted, &options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn compared(squares: [f64; 3], weights: [f64; 3]) -> Compared {
        // Many cells alike, so that the scatter of their sum is small.
        Compared {
            squares: vec![vec![squares; 100]],
            residual_weights: vec![vec![weights; 100]],
        }
    }

    /// By the weights of before: those of a bench that explains less would hide it.
    #[test]
    fn a_bench_is_judged_by_the_weights_of_the_one_before() {
        let before = compared([1.0; 3], [1.0; 3]);
        let far_off = compared([9.0; 3], [0.01; 3]);
        assert!(far_off.is_worse_than(&before, 0.0));
        assert!(!before.is_worse_than(&far_off, 0.0));
        assert!(!before.is_worse_than(&before, 0.0));
        assert!(before.is_worse_than(&before, 0.1));
        // What is not compared under both says nothing.
        let blind = compared([9.0, 1.0, 1.0], [0.0, 1.0, 1.0]);
        assert!(!blind.is_worse_than(&before, 0.0));
    }

    #[test]
    fn a_change_within_its_scatter_is_not_worse() {
        let before = compared([1.0; 3], [1.0; 3]);
        let mut after = compared([1.0; 3], [1.0; 3]);
        for (k, squares) in after.squares[0].iter_mut().enumerate() {
            squares[0] = if k % 2 == 0 { 5.1 } else { -3.0 };
        }
        assert!(!after.is_worse_than(&before, 0.0));
    }
}
