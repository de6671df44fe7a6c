//! The whole fit: trace, start, optimise, debias, say how sure.

use std::sync::Arc;

use nalgebra::DVector;

use super::bench::system::BenchLinearisation;
use super::cells::{Captured, check_count};
use super::comparison::Comparison;
use super::diagnosis::{self, Diagnosis, Examined};
use super::findings::{self, Finding, Judged};
use super::intervals::{self, Interval};
use super::objective::DiscrepancyModel;
use super::options::{FitError, FitOptions, Optimizer};
use super::posterior::{Posterior, posterior};
use super::solve::{Paths, Solution, Solved, solve};
use super::trace::{Step, Termination};
use super::uncertainty::Draws;
use crate::brdf::dictionary::Dictionary;
use crate::brdf::discrepancy::Material;
use crate::brdf::{Atom, Mixture};
use crate::progress::Progress;
use crate::transport::{Kernel, Proposal, Scene};

/// What a fit leaves.
pub struct Fit {
    /// What is reported: a mixture (weights per channel × atoms; equal vectors if shared) of the
    /// dictionary given, or of one with more atoms, and how the material departs from it. Of
    /// Gauss–Newton, of least expected error over the draws (docs/adr/0006, docs/adr/0032).
    pub material: Material,
    /// The single-bounce start of Eq. (13) in the dictionary given, per channel.
    pub start: [Vec<f64>; 3],
    /// Posterior and prior draws per channel.
    pub draws: Vec<Draws>,
    /// How much the material departs from every mixture, in units of what measured materials do
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
        intervals::table(&self.material, &self.draws, theta_h_deg, theta_d_deg)
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
/// second.
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
const QUICKER: u32 = 4;
/// Probability that a continuation of an adapted path follows the default proposal.
pub(super) const DEFENSIVE: f32 = 0.4;

/// [`fit`] on a bench that is known within what `bench` says, which widens the draws.
pub(super) fn fit_on_bench(
    scene: &Scene,
    captured: &Captured,
    dictionary: &Dictionary,
    options: &FitOptions,
    bench: Option<&BenchLinearisation>,
    progress: &dyn Progress,
) -> Result<Fit, FitError> {
    check_count(scene, captured.images.len())?;
    let dictionary = Arc::new(dictionary.clone());
    if !options.adapt_paths || options.optimizer == Optimizer::SingleBounce {
        return fit_from(scene, captured, &dictionary, None, options, bench, progress);
    }
    let mut quick = options.clone();
    quick.cache.samples_per_cell = (options.cache.samples_per_cell / QUICKER).max(2);
    let first = {
        // Its paths are gone before the others are traced.
        let paths = Paths::trace(scene, &captured.cells, &dictionary, None, &quick, progress)?;
        let objective = paths.objective(captured, &quick);
        solve(&paths, &objective, None, &quick, progress)?.solution
    };
    let mut options = options.clone();
    if let Ok(mixture) = Mixture::new(dictionary.clone(), first.weights.clone()) {
        options.cache.proposal = Proposal::resembling(&mixture, DEFENSIVE);
    }
    let first = Some(&first);
    fit_from(
        scene,
        captured,
        &dictionary,
        first,
        &options,
        bench,
        progress,
    )
}

/// [`fit`] on paths traced once, from an earlier solution for the same images or from the
/// single-bounce start.
pub(super) fn fit_from(
    scene: &Scene,
    captured: &Captured,
    dictionary: &Arc<Dictionary>,
    earlier: Option<&Solution>,
    options: &FitOptions,
    bench: Option<&BenchLinearisation>,
    progress: &dyn Progress,
) -> Result<Fit, FitError> {
    let paths = Paths::trace(
        scene,
        &captured.cells,
        dictionary,
        earlier,
        options,
        progress,
    )?;
    let objective = paths.objective(captured, options);
    let mut solved = solve(&paths, &objective, earlier, options, progress)?;
    progress.begin("uncertainty", None);
    let mut timings = std::mem::take(&mut solved.solution.timings);
    let Posterior {
        draws,
        material,
        discrepancy,
    } = timings.time("uncertainty", || {
        posterior(scene, &paths, &objective, &solved, options, bench)
    })?;
    let Solved {
        solution,
        mixture,
        pass,
        termination,
        ..
    } = solved;
    let cache = &paths.cache;
    let outlier_fraction = (0..objective.lights())
        .map(|light| objective.outlier_fraction(&pass.model, light))
        .collect();
    let departed = timings.time("images", || {
        (discrepancy > 0.0)
            .then(|| DiscrepancyModel::of_all(&objective, scene, &material, options.cache.seed))
    });
    let objective = match &departed {
        Some(model) => objective.with_discrepancy(model),
        None => objective,
    };
    let reported: Vec<_> = (0..objective.sets())
        .map(|set| DVector::from_column_slice(&material.mixture.weights()[set]))
        .collect();
    let (model, comparison) = timings.time("images", || {
        let model = objective.modelled(&reported);
        let comparison = Comparison::new(&objective, &model, &cache.strength);
        (model, comparison)
    });
    let reduced_chi2 = comparison.reduced_chi2();
    progress.begin("diagnosis", None);
    let diagnosis = timings.time("diagnosis", || {
        diagnosis::examine(&Examined {
            scene,
            objective: &objective,
            mixture: &mixture,
            material: &material,
            model: &model,
            seed: options.cache.seed,
        })
    });
    let findings = findings::find(&Judged {
        objective: &objective,
        model: &model,
        informed: draws
            .iter()
            .map(|set| (!set.posterior.is_empty()).then_some(set.informed))
            .collect(),
        black: black_weights(&material),
        reduced_chi2: &reduced_chi2,
    });
    Ok(Fit {
        findings,
        material,
        start: solution.start,
        draws,
        discrepancy,
        comparison,
        diagnosis,
        outlier_fraction,
        trace: solution.trace,
        termination,
        timings: timings.0,
        samples: [2 * cache.samples_per_half, cache.samples_requested],
        cache_size: cache.size(),
        kernel: options.kernel,
    })
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
