//! The whole fit: trace, start, optimise, debias, say how sure.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::DVector;

use super::bench::system::{BenchLinearisation, Model};
use super::diagnosis::{self, Diagnosis};
use super::exponentiated_gradient::ExponentiatedGradient;
use super::gauss_newton::GaussNewton;
use super::objective::{Channels, Linearised, Objective};
use super::refine::{Refine, refine};
use super::ridge::Ridge;
use super::simplex::SimplexError;
use super::trace::{Observer, Step, Termination};
use super::uncertainty::{self, Draws};
use crate::brdf::dictionary::Dictionary;
use crate::radiance_image::RadianceImage;
use crate::transport::cache::CacheError;
use crate::transport::{Cache, CacheOptions, DirectMatrix, Kernel, Scene};

/// Which optimiser.
#[derive(Clone, Debug, PartialEq)]
pub enum Optimizer {
    /// Gauss–Newton on the simplex.
    GaussNewton(GaussNewton),
    /// The paper's exponentiated gradient with Adam steps.
    ExponentiatedGradient(ExponentiatedGradient),
    /// The convex baseline of Eq. 13: the least squares that takes all light as reflected
    /// once.
    SingleBounce,
}

impl Optimizer {
    /// Name as on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Optimizer::GaussNewton(_) => "gauss-newton",
            Optimizer::ExponentiatedGradient(_) => "exponentiated-gradient",
            Optimizer::SingleBounce => "single-bounce",
        }
    }
}

/// Everything that a fit can be told.
#[derive(Clone, Debug)]
pub struct FitOptions {
    /// Paths: samples per pixel, longest path, seed, memory.
    pub cache: CacheOptions,
    /// Direct reflection: square root of the samples per pixel, 1..=64.
    pub direct_strata: u32,
    /// How the weights are found.
    pub optimizer: Optimizer,
    /// Weights of their own per channel, or shared.
    pub channels: Channels,
    /// Relative error of the model that the weighting allows for, 0..=1.
    pub model_error: f64,
    /// Rounds of residual weights, 1..=10.
    pub rounds: usize,
    /// Draws from the posterior, 0..=10 000.
    pub draws: usize,
    /// Paths and atoms beyond the first fit.
    pub refine: Refine,
    /// Instructions to use.
    pub kernel: Kernel,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            cache: CacheOptions::default(),
            direct_strata: 16,
            optimizer: Optimizer::GaussNewton(GaussNewton::default()),
            channels: Channels::Separate,
            model_error: 0.02,
            rounds: 3,
            draws: 200,
            refine: Refine::default(),
            kernel: Kernel::detect(),
        }
    }
}

/// What a fit leaves.
pub struct Fit {
    /// The dictionary that the weights belong to: the one given, or with more atoms.
    pub dictionary: Arc<Dictionary>,
    /// Light that the sample reflects once, per atom of the dictionary.
    pub(super) direct: Arc<DirectMatrix>,
    /// Weights per channel × atoms; equal vectors if shared.
    pub weights: [Vec<f64>; 3],
    /// The single-bounce start of Eq. (13) in the dictionary given, per channel.
    pub start: [Vec<f64>; 3],
    /// Posterior and prior draws per channel.
    pub draws: Vec<Draws>,
    /// Modelled radiance with the render's variance, one image per light.
    pub rendered: Vec<RadianceImage>,
    /// (captured − model)/σ of capture, render and model error, 0 where not compared, one image per light.
    pub residual: Vec<RadianceImage>,
    /// Mean squared residual in standard deviations per light and channel.
    pub reduced_chi2: Vec<[f64; 3]>,
    /// What the residual looks like.
    pub diagnosis: Diagnosis,
    /// Part of each light's values that were believed less, as isolated outliers.
    pub doubted: Vec<f64>,
    /// Loss at every evaluated point, with the seconds since the start.
    pub trace: Vec<(f64, Step)>,
    /// Why the last round ended.
    pub termination: Termination,
    /// Seconds by stage.
    pub timings: Vec<(&'static str, f64)>,
    /// Paths per pixel that were traced, and asked for.
    pub samples: [u32; 2],
    /// Records and bytes of the cache.
    pub cache_size: (usize, usize),
    /// The kernel that evaluated.
    pub kernel: Kernel,
}

/// Why a fit failed.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// Numbers of images and lights differ.
    #[error("{images} images for {lights} lights of the scene")]
    ImageCount {
        /// Images given.
        images: usize,
        /// Lights of the scene.
        lights: usize,
    },
    /// An image does not have the camera's size.
    #[error(
        "image {image} is {width} × {height}; the scene's camera has {expected_width} × {expected_height}"
    )]
    ImageSize {
        /// Index of the image.
        image: usize,
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
        /// The camera's width.
        expected_width: usize,
        /// The camera's height.
        expected_height: usize,
    },
    /// Nothing to compare.
    #[error("no pixel of image {image} is valid and wholly on the sample")]
    NothingToCompare {
        /// Index of the image.
        image: usize,
    },
    /// The paths.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// The quadratic programme.
    #[error(transparent)]
    Simplex(#[from] SimplexError),
}

/// Fits the weights of `dictionary` to one captured image per light of the scene.
/// `stage` is told what begins.
pub fn fit(
    scene: &Scene,
    captured: &[RadianceImage],
    dictionary: &Dictionary,
    options: &FitOptions,
    stage: &mut dyn FnMut(&str),
) -> Result<Fit, FitError> {
    fit_on_bench(scene, captured, dictionary, options, None, stage)
}

/// A first fit that only tells later paths where to go has this many times fewer.
const QUICKER: u32 = 4;

/// [`fit`] on a bench that is known within what `bench` says, which widens the draws.
pub(super) fn fit_on_bench(
    scene: &Scene,
    captured: &[RadianceImage],
    dictionary: &Dictionary,
    options: &FitOptions,
    bench: Option<&BenchLinearisation>,
    stage: &mut dyn FnMut(&str),
) -> Result<Fit, FitError> {
    check(scene, captured)?;
    let dictionary = Arc::new(dictionary.clone());
    if options.refine == Refine::NONE || options.optimizer == Optimizer::SingleBounce {
        return fit_from(scene, captured, &dictionary, None, options, bench, stage);
    }
    let mut quick = FitOptions {
        draws: 0,
        ..options.clone()
    };
    quick.cache.samples_per_pixel = (options.cache.samples_per_pixel / QUICKER).max(2);
    let first = fit_from(scene, captured, &dictionary, None, &quick, bench, stage)?;
    refine(scene, captured, first, options, bench, stage)
}

/// [`fit`] without refinement, from the weights of an earlier fit of the same images or
/// from the single-bounce start.
pub(super) fn fit_from(
    scene: &Scene,
    captured: &[RadianceImage],
    dictionary: &Arc<Dictionary>,
    earlier: Option<&Fit>,
    options: &FitOptions,
    bench: Option<&BenchLinearisation>,
    stage: &mut dyn FnMut(&str),
) -> Result<Fit, FitError> {
    let clock = Instant::now();
    let mut timings = Vec::new();
    let mut mark = clock;
    let mut lap = |name: &'static str, timings: &mut Vec<(&'static str, f64)>| {
        timings.push((name, mark.elapsed().as_secs_f64()));
        mark = Instant::now();
    };

    stage("direct reflection");
    let direct = match earlier {
        Some(fit) if Arc::ptr_eq(&fit.dictionary, dictionary) => fit.direct.clone(),
        _ => {
            let (strata, seed) = (options.direct_strata, options.cache.seed);
            Arc::new(DirectMatrix::new(scene, dictionary, strata, seed))
        }
    };
    lap("direct", &mut timings);
    stage("tracing paths");
    let cache = Cache::trace(scene, dictionary, &options.cache)?;
    lap("trace", &mut timings);

    let objective = Objective::new(
        &cache,
        &direct,
        captured,
        None,
        options.channels,
        options.kernel,
        options.model_error,
    );
    for (image, frame) in captured.iter().enumerate() {
        if !(0..frame.mean.len()).any(|p| objective.is_compared(image, p)) {
            return Err(FitError::NothingToCompare { image });
        }
    }
    stage("optimising");
    let mut residual_weights = objective.weights(None);
    let mut mixture = Vec::new();
    for quadratic in objective.single_bounce(&residual_weights) {
        mixture.push(quadratic.minimise()?.x);
    }
    let start = mixture.clone();
    if let Some(fit) = earlier {
        for (mixture, from) in mixture.iter_mut().zip(fit.weights_in(dictionary)) {
            *mixture = DVector::from_vec(from);
        }
        let pass = objective.linearise(&mixture, &residual_weights);
        residual_weights = objective.weights_after(&pass);
    }
    lap("start", &mut timings);

    let mut recorder = Recorder {
        clock,
        trace: Vec::new(),
    };
    let (mut pass, mut termination);
    let mut ridge = Ridge::first(&objective);
    let mut round = 0;
    loop {
        (pass, termination) = match &options.optimizer {
            Optimizer::GaussNewton(method) => method.minimise(
                &objective,
                &residual_weights,
                &ridge,
                &mut mixture,
                &mut recorder,
            )?,
            Optimizer::ExponentiatedGradient(method) => method.minimise(
                &objective,
                &residual_weights,
                &ridge,
                &mut mixture,
                &mut recorder,
            ),
            Optimizer::SingleBounce => {
                for (w, quadratic) in mixture
                    .iter_mut()
                    .zip(objective.single_bounce(&residual_weights))
                {
                    *w = quadratic.minimise()?.x;
                }
                let pass = objective.linearise(&mixture, &residual_weights);
                recorder.step(&Step::of(&pass.quadratics, "single-bounce"));
                (pass, Termination::Converged)
            }
        };
        round += 1;
        if round >= options.rounds {
            break;
        }
        residual_weights = objective.weights_after(&pass);
        tracing::debug!(unexplained = ?pass.unexplained, "round");
        ridge = Ridge::after(&pass);
    }
    lap("optimise", &mut timings);
    stage("uncertainty");
    let model = Model {
        objective: &objective,
        cache: &cache,
        direct: &direct,
        kernel: options.kernel,
    };
    let coupling = bench.map(|b| b.coupling(&model, &residual_weights, &mixture));
    let noise = match options.draws {
        0 => Vec::new(),
        _ => objective.score_noise(&mixture, &residual_weights, &pass.model),
    };
    let mut draws = uncertainty::draw(
        &mixture,
        &pass,
        coupling.as_ref(),
        &noise,
        options.draws,
        options.cache.seed,
    )?;
    for (draws, misfit) in draws.iter_mut().zip(objective.misfit(&pass.model)) {
        draws.misfit = misfit;
    }
    lap("uncertainty", &mut timings);
    stage("diagnosis");
    let diagnosis = diagnosis::examine(scene, dictionary, &objective, &cache, &mixture, &pass);
    let doubted = (0..captured.len())
        .map(|light| objective.doubted(&pass.model, light))
        .collect();
    lap("diagnosis", &mut timings);

    let per_channel = |sets: &[DVector<f64>]| -> [Vec<f64>; 3] {
        std::array::from_fn(|c| sets[c.min(sets.len() - 1)].iter().copied().collect())
    };
    let (rendered, residual, reduced_chi2) = images(&objective, &pass, captured, &cache);
    Ok(Fit {
        dictionary: dictionary.clone(),
        direct: direct.clone(),
        weights: per_channel(&mixture),
        start: per_channel(&start),
        draws,
        rendered,
        residual,
        reduced_chi2,
        diagnosis,
        doubted,
        trace: recorder.trace,
        termination,
        timings,
        samples: [2 * cache.samples_per_half, cache.samples_requested],
        cache_size: cache.size(),
        kernel: options.kernel,
    })
}

impl Fit {
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

pub(super) fn check(scene: &Scene, captured: &[RadianceImage]) -> Result<(), FitError> {
    if captured.len() != scene.lights.len() || captured.is_empty() {
        return Err(FitError::ImageCount {
            images: captured.len(),
            lights: scene.lights.len(),
        });
    }
    let [expected_width, expected_height] = scene.camera.resolution_px;
    for (image, c) in captured.iter().enumerate() {
        if [c.width, c.height] != scene.camera.resolution_px {
            return Err(FitError::ImageSize {
                image,
                width: c.width,
                height: c.height,
                expected_width,
                expected_height,
            });
        }
    }
    Ok(())
}

struct Recorder {
    clock: Instant,
    trace: Vec<(f64, Step)>,
}

impl Observer for Recorder {
    fn step(&mut self, step: &Step) {
        self.trace
            .push((self.clock.elapsed().as_secs_f64(), step.clone()));
    }
}

/// Re-rendered images, residuals in standard deviations, and their mean squares.
fn images(
    objective: &Objective<'_>,
    pass: &Linearised,
    captured: &[RadianceImage],
    cache: &Cache,
) -> (Vec<RadianceImage>, Vec<RadianceImage>, Vec<[f64; 3]>) {
    let mut rendered = Vec::new();
    let mut residual = Vec::new();
    let mut reduced = Vec::new();
    for (light, image) in captured.iter().enumerate() {
        let mut model = RadianceImage::new(image.width, image.height);
        let mut deviation = model.clone();
        let (mut chi2, mut count) = ([0.0; 3], 0usize);
        for p in 0..image.mean.len() {
            let compared = objective.is_compared(light, p);
            let [target, variance] = objective.captured(light, p);
            deviation.valid[p] = compared;
            count += usize::from(compared);
            for c in 0..3 {
                let strength = cache.strength[light][c];
                let [value, noise] = pass.model[light][p][c];
                model.mean[p][c] = (value * strength) as f32;
                model.variance[p][c] = (noise * strength * strength) as f32;
                let sigma =
                    (noise + variance[c] + (objective.model_error() * value).powi(2)).sqrt();
                if compared && sigma > 0.0 {
                    let z = (target[c] - value) / sigma;
                    deviation.mean[p][c] = z as f32;
                    chi2[c] += z * z;
                }
            }
        }
        rendered.push(model);
        residual.push(deviation);
        reduced.push(chi2.map(|c| c / count.max(1) as f64));
    }
    (rendered, residual, reduced)
}
