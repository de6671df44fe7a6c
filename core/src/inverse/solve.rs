//! From images to weights: trace the paths, start, optimise in rounds.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::DVector;

use super::objective::{Linearised, Objective, ResidualWeights};
use super::options::{FitError, FitOptions, Optimizer};
use super::ridge::Ridge;
use super::trace::{Observer, Step, Termination};
use crate::brdf::dictionary::Dictionary;
use crate::cells::Captured;
use crate::progress::Progress;
use crate::transport::{Cache, Cells, DirectMatrix, Guide, Scene};

/// Weights, what they were found with, and how; a later solution of the same images can
/// go on from it.
#[derive(Clone)]
pub(super) struct Solution {
    pub dictionary: Arc<Dictionary>,
    /// Light that the sample reflects once, per atom of the dictionary.
    pub direct: Arc<DirectMatrix>,
    /// What leads paths to the lamps' light.
    pub guide: Option<Arc<Guide>>,
    /// Weights per channel × atoms; equal vectors if shared.
    pub weights: [Vec<f64>; 3],
    /// The first single-bounce start, per channel.
    pub start: [Vec<f64>; 3],
    /// Loss at every evaluated point, with the seconds since the start.
    pub trace: Vec<(f64, Step)>,
    /// Seconds by stage.
    pub timings: Timings,
}

/// A solution with what says how sure it is.
pub(super) struct Solved {
    pub solution: Solution,
    /// The weights per channel group.
    pub mixture: Vec<DVector<f64>>,
    /// The pass at them.
    pub pass: Linearised,
    pub residual_weights: ResidualWeights,
    /// Why the last round ended.
    pub termination: Termination,
}

/// Seconds by stage, in the order in which the stages first ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Timings(pub Vec<(&'static str, f64)>);

impl Timings {
    /// Runs a stage and adds its time.
    pub fn time<T>(&mut self, name: &'static str, stage: impl FnOnce() -> T) -> T {
        let clock = Instant::now();
        let result = stage();
        self.add(name, clock.elapsed().as_secs_f64());
        result
    }

    /// Adds those of another run.
    pub fn join(&mut self, others: &Self) {
        for &(name, seconds) in &others.0 {
            self.add(name, seconds);
        }
    }

    fn add(&mut self, name: &'static str, seconds: f64) {
        match self.0.iter_mut().find(|(known, _)| *known == name) {
            Some((_, total)) => *total += seconds,
            None => self.0.push((name, seconds)),
        }
    }

    fn total(&self) -> f64 {
        self.0.iter().map(|(_, seconds)| seconds).sum()
    }
}

/// What light does in the scene: the linear part and the paths.
#[derive(Clone)]
pub(super) struct Paths {
    pub dictionary: Arc<Dictionary>,
    pub direct: Arc<DirectMatrix>,
    pub cache: Cache,
    guide: Option<Arc<Guide>>,
    timings: Timings,
}

impl Paths {
    /// Traces the scene; what guides the paths is taken from an earlier solution, direct
    /// reflection from one with the same dictionary.
    pub fn trace(
        scene: &Scene,
        cells: &Cells,
        dictionary: &Arc<Dictionary>,
        earlier: Option<&Solution>,
        options: &FitOptions,
        progress: &dyn Progress,
    ) -> Result<Self, FitError> {
        let mut timings = earlier.map_or_else(Timings::default, |e| e.timings.clone());
        progress.begin("direct reflection", None);
        let direct = timings.time("direct", || match earlier {
            Some(earlier) if Arc::ptr_eq(&earlier.dictionary, dictionary) => earlier.direct.clone(),
            _ => {
                let (strata, seed) = (options.direct_strata, options.cache.seed);
                Arc::new(DirectMatrix::new(scene, cells, dictionary, strata, seed))
            }
        });
        progress.begin("tracing paths", None);
        let how = &options.cache;
        let (cache, guide) = timings.time("trace", || {
            let guide = match earlier {
                Some(earlier) => earlier.guide.clone(),
                None => how.steering.guide(scene, how.seed),
            };
            let cache =
                Cache::trace_guided(scene, cells, dictionary, how, guide.clone(), progress)?;
            Ok::<_, FitError>((cache, guide))
        })?;
        Ok(Self {
            dictionary: dictionary.clone(),
            direct,
            cache,
            guide,
            timings,
        })
    }

    /// The same paths for a dictionary of the first atoms, or of all.
    pub fn of(&self, dictionary: &Arc<Dictionary>) -> Self {
        if Arc::ptr_eq(&self.dictionary, dictionary) {
            return self.clone();
        }
        Self {
            dictionary: dictionary.clone(),
            direct: Arc::new(self.direct.of_first(dictionary.len())),
            cache: self.cache.of_first(dictionary),
            guide: self.guide.clone(),
            // Those of all atoms have the time.
            timings: Timings::default(),
        }
    }

    /// Compares the images with the light that these paths carry.
    pub fn objective<'a>(&'a self, captured: &'a Captured, options: &FitOptions) -> Objective<'a> {
        Objective::new(
            &self.cache,
            &self.direct,
            captured,
            options.channels,
            options.kernel,
            options.model_error,
        )
    }
}

/// Finds the weights, from those of an earlier solution or from the single-bounce start.
pub(super) fn solve(
    paths: &Paths,
    objective: &Objective<'_>,
    earlier: Option<&Solution>,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Solved, FitError> {
    for image in 0..objective.lights() {
        if !objective.compares_any(image) {
            return Err(FitError::NothingToCompare { image });
        }
    }
    progress.begin("optimising", None);
    let mut timings = paths.timings.clone();
    let mut recorder = Recorder {
        clock: Instant::now(),
        before_s: timings.total(),
        progress,
        trace: earlier.map_or_else(Vec::new, |e| e.trace.clone()),
    };
    let (mut mixture, start, mut residual_weights) =
        timings.time("start", || begin(paths, objective, earlier))?;
    let mut ridge = Ridge::first(objective);
    let mut round = 0;
    let (pass, termination) = timings.time("optimise", || {
        loop {
            let ended = match &options.optimizer {
                Optimizer::GaussNewton(method) => method.minimise(
                    objective,
                    &residual_weights,
                    &ridge,
                    &mut mixture,
                    &mut recorder,
                )?,
                Optimizer::ExponentiatedGradient(method) => method.minimise(
                    objective,
                    &residual_weights,
                    &ridge,
                    &mut mixture,
                    &mut recorder,
                ),
                Optimizer::SingleBounce => {
                    let quadratics = objective.single_bounce(&residual_weights);
                    for (w, quadratic) in mixture.iter_mut().zip(quadratics) {
                        *w = quadratic.minimise()?.x;
                    }
                    let pass = objective.linearise(&mixture, &residual_weights);
                    recorder.step(&Step::of(&pass.quadratics, "single-bounce"));
                    (pass, Termination::Converged)
                }
            };
            round += 1;
            if round >= options.rounds {
                return Ok::<_, FitError>(ended);
            }
            let (pass, _) = ended;
            residual_weights = objective.weights_after(&pass);
            log::debug!("unexplained after a round: {:?}", pass.unexplained);
            ridge = Ridge::after(&pass);
        }
    })?;
    let solution = Solution {
        dictionary: paths.dictionary.clone(),
        direct: paths.direct.clone(),
        guide: paths.guide.clone(),
        weights: per_channel(&mixture),
        start,
        trace: recorder.trace,
        timings,
    };
    Ok(Solved {
        solution,
        mixture,
        pass,
        residual_weights,
        termination,
    })
}

/// First weights, the single-bounce start that they or their predecessors came from, and
/// what each residual weighs.
#[expect(clippy::type_complexity, reason = "three parts of one start")]
fn begin(
    paths: &Paths,
    objective: &Objective<'_>,
    earlier: Option<&Solution>,
) -> Result<(Vec<DVector<f64>>, [Vec<f64>; 3], ResidualWeights), FitError> {
    let residual_weights = objective.weights(None);
    let n = objective.atoms();
    let even = vec![DVector::from_element(n, 1.0 / n as f64); objective.groups()];
    let even = objective.modelled(&even);
    let Some(earlier) = earlier else {
        let quadratics = objective.single_bounce(&residual_weights);
        let mixture = quadratics.iter().map(|q| Ok(q.minimise()?.x));
        let mixture = mixture.collect::<Result<Vec<_>, FitError>>()?;
        let start = per_channel(&mixture);
        return Ok((mixture, start, objective.first_weights(None, &even)));
    };
    let embedded = earlier.weights_in(&paths.dictionary).map(DVector::from_vec);
    let mixture: Vec<_> = embedded.into_iter().take(objective.groups()).collect();
    let pass = objective.linearise(&mixture, &residual_weights);
    Ok((
        mixture,
        earlier.start.clone(),
        objective.first_weights(Some(&pass), &even),
    ))
}

impl Solution {
    /// The weights in a dictionary that holds the active atoms.
    fn weights_in(&self, dictionary: &Dictionary) -> [Vec<f64>; 3] {
        self.weights.each_ref().map(|weights| {
            let mut embedded = vec![0.0; dictionary.len()];
            for (atom, weight) in self.dictionary.atoms().iter().zip(weights) {
                if let Some(place) = dictionary.atoms().iter().position(|a| a == atom) {
                    embedded[place] += weight;
                }
            }
            let sum: f64 = embedded.iter().sum();
            embedded.iter_mut().for_each(|w| *w /= sum);
            embedded
        })
    }
}

/// Weights of the sets as those of R, G and B.
pub(super) fn per_channel(groups: &[DVector<f64>]) -> [Vec<f64>; 3] {
    std::array::from_fn(|c| groups[c.min(groups.len() - 1)].iter().copied().collect())
}

struct Recorder<'a> {
    clock: Instant,
    /// Seconds that went by before.
    before_s: f64,
    progress: &'a dyn Progress,
    trace: Vec<(f64, Step)>,
}

impl Observer for Recorder<'_> {
    fn step(&mut self, step: &Step) {
        self.progress.pulse();
        let elapsed_s = self.before_s + self.clock.elapsed().as_secs_f64();
        self.trace.push((elapsed_s, step.clone()));
    }
}
