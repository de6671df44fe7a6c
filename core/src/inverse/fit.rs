//! The whole fit: trace, start, optimise, debias, say how sure.

use std::sync::Arc;

use nalgebra::DVector;

use super::average::averaged;
use super::comparison::Comparison;
use super::diagnosis::{self, Diagnosis, Examined};
use super::findings::{self, Finding, Judged};
use super::intervals::{self, Interval};
use super::nuisance::system::BenchLinearisation;
use super::objective::DiscrepancyModel;
use super::options::{FitError, FitOptions, Optimizer};
use super::posterior::{Posterior, posterior};
use super::solve::{Paths, Solution, Solved, solve};
use super::trace::{Step, Termination};
use super::uncertainty::{self, PosteriorSamples};
use super::unexplained::Seen;
use crate::brdf::dictionary::Dictionary;
use crate::brdf::discrepancy::{Material, Prior};
use crate::brdf::projection::ProjectionError;
use crate::brdf::{Atom, Mixture};
use crate::cells::{Captured, check_count};
use crate::progress::Progress;
use crate::transport::{Kernel, Proposal, Scene};

/// What a fit leaves.
pub struct Fit {
    /// What is reported: a mixture (weights per channel × atoms; equal vectors if shared) of the
    /// dictionary given, or of one with more atoms, and the discrepancy from it. Of
    /// Gauss–Newton, of least expected error over the samples (docs/adr/0006, docs/adr/0032).
    pub material: Material,
    /// The single-bounce start of Eq. (13) in the dictionary given, per channel.
    pub start: [Vec<f64>; 3],
    /// Posterior and prior samples per channel.
    pub posterior_samples: Vec<PosteriorSamples>,
    /// Amplitude of the model discrepancy, in units of that of measured materials
    /// (docs/adr/0032); 0 where the images do not ask for it.
    pub discrepancy: f64,
    /// How the material's images compare with those captured.
    pub comparison: Comparison,
    /// What the residual looks like.
    pub diagnosis: Diagnosis,
    /// What else speaks against the fit.
    pub findings: Vec<Finding>,
    /// Part of each light's values that were believed less, as isolated outliers.
    pub outlier_fraction: Vec<f64>,
    /// Loss at every evaluated point, with the seconds since the start.
    pub trace: Vec<(f64, Step)>,
    /// Why the last round ended.
    pub termination: Termination,
    /// Seconds by stage.
    pub timings: Vec<(&'static str, f64)>,
    /// Paths per cell that were traced, and asked for.
    pub samples: [u32; 2],
    /// Records and bytes of the cache.
    pub cache_size: (usize, usize),
    /// The kernel that evaluated.
    pub kernel: Kernel,
}

impl Fit {
    /// The BRDF found and its 95% interval, at one half and one difference angle (degrees, 0 to
    /// 90), for light and viewer at right angles to the plane of the half vector (φd = 90°).
    ///
    /// ```
    /// # let (scene, captured) = rig_core::example::captured_bowl();
    /// use rig_core::{Dictionary, FitOptions, fit};
    ///
    /// let found = fit(&scene, &captured, &Dictionary::load("paper42")?, &FitOptions::default())?;
    /// let f = found.interval(15.0, 10.0);
    /// println!("{:.4} 1/sr, between {:.4} and {:.4}", f.value[0], f.lower[0], f.upper[0]);
    /// assert!(f.lower[0] <= f.value[0] && f.value[0] <= f.upper[0]);
    /// # Ok::<_, Box<dyn std::error::Error>>(())
    /// ```
    pub fn interval(&self, theta_h_deg: f64, theta_d_deg: f64) -> Interval {
        self.intervals(&[theta_h_deg], &[theta_d_deg])[0]
    }

    /// [`Fit::interval`] on a grid of angles (degrees), the difference angle varying fastest.
    pub fn intervals(&self, theta_h_deg: &[f64], theta_d_deg: &[f64]) -> Vec<Interval> {
        self.intervals_at(theta_h_deg, theta_d_deg, 90.0)
    }

    /// [`Fit::intervals`] at another azimuth φd of the light about the half vector (degrees; 0 is
    /// the plane of incidence); values of 0 where it lies below the horizon there.
    pub fn intervals_at(
        &self,
        theta_h_deg: &[f64],
        theta_d_deg: &[f64],
        phi_d_deg: f64,
    ) -> Vec<Interval> {
        intervals::table(
            &self.material,
            &self.posterior_samples,
            theta_h_deg,
            theta_d_deg,
            phi_d_deg,
        )
    }
}

/// Fits the weights of `dictionary` to the captured image of each light of the scene.
pub fn fit(
    scene: &Scene,
    captured: &Captured,
    dictionary: &Dictionary,
    options: &FitOptions,
) -> Result<Fit, FitError> {
    fit_with_progress(scene, captured, dictionary, options, &())
}

/// [`fit`]; `progress` receives its phases, without a number of steps. Direct reflection,
/// paths and optimisation come twice: a first solution by fewer paths guides those of the
/// second. Where two estimates are averaged, optimisation comes once more each time.
pub fn fit_with_progress(
    scene: &Scene,
    captured: &Captured,
    dictionary: &Dictionary,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit, FitError> {
    fit_on_bench(scene, captured, dictionary, options, None, progress)
}

/// The first solution, which only guides later paths, has this many times fewer of them.
const PRELIMINARY_DIVISOR: u32 = 4;
/// Probability that a continuation of an adapted path follows the default proposal.
pub(super) const DEFENSIVE: f32 = 0.4;

/// [`fit`] on a bench that is known within what `bench` says, which widens the samples.
pub(super) fn fit_on_bench(
    scene: &Scene,
    captured: &Captured,
    dictionary: &Dictionary,
    options: &FitOptions,
    bench: Option<&BenchLinearisation>,
    progress: &dyn Progress,
) -> Result<Fit, FitError> {
    check_count(scene, captured.images.len())?;
    // An estimate by all atoms, and maybe one by the first of them, both on the same paths, which a
    // first solution guides.
    let dictionaries: Vec<_> = std::iter::once(dictionary.clone())
        .chain(options.second_estimate(dictionary))
        .map(Arc::new)
        .collect();
    let mut options = options.clone();
    let first = match options.adapt_paths && options.optimizer != Optimizer::SingleBounce {
        true => preliminary(scene, captured, &dictionaries, &options, progress)?,
        false => Vec::new(),
    };
    if let Some(whole) = first.first()
        && let Ok(mixture) = Mixture::new(dictionaries[0].clone(), whole.weights.clone())
    {
        options.cache.proposal = Proposal::resembling(&mixture, DEFENSIVE);
    }
    let (cells, options) = (&captured.cells, &options);
    let paths = Paths::trace(
        scene,
        cells,
        &dictionaries[0],
        first.first(),
        options,
        progress,
    )?;
    let find = |(k, dictionary): (usize, &Arc<Dictionary>)| {
        let paths = paths.of(dictionary);
        find(
            scene,
            captured,
            &paths,
            first.get(k),
            options,
            bench,
            progress,
        )
    };
    let found: Result<Vec<_>, FitError> = dictionaries.iter().enumerate().map(find).collect();
    let mut found = found?.into_iter();
    let Some((solved, mut posterior)) = found.next() else {
        unreachable!("one dictionary at least");
    };
    let mut timings = solved.solution.timings;
    if let Some((solved_by_part, of_part)) = found.next() {
        timings.join(&solved_by_part.solution.timings);
        let seed = options.cache.seed;
        posterior = averaged(posterior, of_part, seed).map_err(ProjectionError::from)?;
    }
    timings.time("uncertainty", || {
        let (seed, center) = (options.cache.seed, &posterior.center);
        uncertainty::draw_prior(
            &mut posterior.posterior_samples,
            &dictionaries[0],
            center,
            seed,
        );
    });
    let objective = paths.objective(captured, options);
    let albedo = timings.time("uncertainty", || {
        let seed = options.cache.seed;
        let weights = &solved.residual_weights;
        let seen = || Seen::new(scene, &objective, &solved.pass.model, weights, seed);
        posterior.be_physical(seen, seed)
    });
    let Posterior {
        posterior_samples,
        material,
        discrepancy,
        ..
    } = posterior;

    // Its images.
    let cache = &paths.cache;
    let outlier_fraction = (0..objective.lights())
        .map(|light| objective.outlier_fraction(&solved.pass.model, light))
        .collect();
    let prior = Prior::without(&options.left_out);
    let with_discrepancy = timings.time("images", || {
        (discrepancy > 0.0).then(|| {
            DiscrepancyModel::of_all(&objective, scene, &material, &prior, options.cache.seed)
        })
    });
    let objective = match &with_discrepancy {
        Some(model) => objective.with_discrepancy(model),
        None => objective,
    };
    let reported: Vec<_> = (0..objective.groups())
        .map(|group| DVector::from_column_slice(&material.mixture.weights()[group]))
        .collect();
    let (model, comparison) = timings.time("images", || {
        let model = objective.modelled(&reported);
        let comparison = Comparison::new(&objective, &model, &cache.strength);
        (model, comparison)
    });
    let reduced_chi2 = comparison.reduced_chi2();

    // What speaks against it.
    progress.begin("diagnosis", None);
    let diagnosis = timings.time("diagnosis", || {
        diagnosis::examine(&Examined {
            scene,
            objective: &objective,
            mixture: &solved.mixture,
            material: &material,
            model: &model,
            seed: options.cache.seed,
        })
    });
    let findings = findings::find(&Judged {
        objective: &objective,
        model: &model,
        informed: posterior_samples
            .iter()
            .map(|group| (!group.posterior.is_empty()).then_some(group.informed))
            .collect(),
        stray_light: &solved.pass.stray_light,
        black: black_weights(&material),
        albedo,
        reduced_chi2: &reduced_chi2,
    });
    Ok(Fit {
        findings,
        material,
        start: solved.solution.start,
        posterior_samples,
        discrepancy,
        comparison,
        diagnosis,
        outlier_fraction,
        trace: solved.solution.trace,
        termination: solved.termination,
        timings: timings.0,
        samples: [2 * cache.samples_per_half, cache.samples_requested],
        cache_size: cache.size(),
        kernel: options.kernel,
    })
}

/// First solutions by fewer paths, one by each dictionary: the first and parts of it.
fn preliminary(
    scene: &Scene,
    captured: &Captured,
    dictionaries: &[Arc<Dictionary>],
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Vec<Solution>, FitError> {
    let mut quick = options.clone();
    quick.cache.samples_per_cell = (options.cache.samples_per_cell / PRELIMINARY_DIVISOR).max(2);
    let (cells, whole) = (&captured.cells, &dictionaries[0]);
    let paths = Paths::trace(scene, cells, whole, None, &quick, progress)?;
    let solution = |dictionary| {
        let paths = paths.of(dictionary);
        let objective = paths.objective(captured, &quick);
        Ok(solve(&paths, &objective, None, &quick, progress)?.solution)
    };
    dictionaries.iter().map(solution).collect()
}

/// Estimates the material by the dictionary of these paths, from a first solution if there is one.
fn find(
    scene: &Scene,
    captured: &Captured,
    paths: &Paths,
    first: Option<&Solution>,
    options: &FitOptions,
    bench: Option<&BenchLinearisation>,
    progress: &dyn Progress,
) -> Result<(Solved, Posterior), FitError> {
    let objective = paths.objective(captured, options);
    let mut solved = solve(paths, &objective, first, options, progress)?;
    progress.begin("uncertainty", None);
    let mut timings = std::mem::take(&mut solved.solution.timings);
    let posterior = timings.time("uncertainty", || {
        posterior(scene, paths, &objective, &solved, options, bench)
    })?;
    solved.solution.timings = timings;
    Ok((solved, posterior))
}

/// Weight of the atom that reflects nothing, per channel.
fn black_weights(material: &Material) -> [Option<f64>; 3] {
    let mixture = &material.mixture;
    let atoms = mixture.dictionary().atoms();
    let black = atoms.iter().position(|atom| *atom == Atom::Black);
    mixture
        .weights()
        .each_ref()
        .map(|weights| Some(weights[black?]))
}
