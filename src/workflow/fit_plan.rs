//! A fit from the averaged images of a scene to its record.

use std::io::{Read, Seek};
use std::path::PathBuf;
use std::sync::Arc;

use super::cell_images::{self, Source};
use super::notice::{Notice, Observer};
use super::{FitRequest, FitWork, WorkflowError, coarse_facets, fit_memory, summary, warnings};
use crate::brdf::{Brdf, Dictionary};
use crate::config::process;
use crate::geometry::FormError;
use crate::inverse::cells::choose;
use crate::inverse::exponentiated_gradient::ExponentiatedGradient;
use crate::inverse::{
    BenchPriors, Captured, CellOptions, FitOptions, Optimizer, RefineOptions, fit_with_progress,
    plausibility, refine_bench,
};
use crate::session::fit_record::{BenchRecord, FitImages, FitRecord};
use crate::transport::{Kernel, RenderOptions, Scene, truncation_remainder};

/// What is fitted and how, by configuration and request together.
pub(super) struct FitPlan {
    pub dictionary: Arc<Dictionary>,
    pub options: FitOptions,
    pub mask: Option<PathBuf>,
    /// Memory of the whole fit, MiB, if it is limited.
    pub memory_mib: Option<u64>,
    /// How well the bench is known; `None`: exactly.
    priors: Option<BenchPriors>,
    /// Most cells, if chosen.
    cells: Option<usize>,
}

/// Paths per pixel that the estimate of the truncated light takes.
const TRUNCATION_SAMPLES: u32 = 32;

impl FitPlan {
    /// The request over `config`'s choices over the defaults, on a bench that is known within
    /// `uncertainty` and with a sample whose surface is known within `form_error`.
    ///
    /// # Errors
    /// A dictionary that cannot be read, a kernel that the processor lacks, choices that
    /// contradict each other.
    pub fn new(
        request: &FitRequest,
        config: Option<&process::FitConfig>,
        uncertainty: &BenchPriors,
        form_error: Option<FormError>,
    ) -> Result<Self, WorkflowError> {
        let mut options = FitOptions {
            form_error,
            ..FitOptions::default()
        };

        // The configuration over the defaults.
        let mut dictionary = Dictionary::DEFAULT;
        let mut refines_bench = false;
        if let Some(config) = config {
            dictionary = &config.dictionary;
            refines_bench = config.refine_bench;
            options.cache.samples_per_cell = config.samples_per_pixel;
            options.cache.max_reflections = config.max_reflections.max(2);
            options.cache.seed = config.seed;
            if config.optimizer == process::Optimizer::ExponentiatedGradient {
                options.optimizer =
                    Optimizer::ExponentiatedGradient(ExponentiatedGradient::default());
            }
        }

        // The request over both.
        let dictionary = Dictionary::load(request.dictionary.as_deref().unwrap_or(dictionary))?;
        let refines_bench = request.refine_bench.unwrap_or(refines_bench);
        set(&mut options.optimizer, &request.optimizer);
        set(
            &mut options.cache.samples_per_cell,
            &request.samples_per_cell,
        );
        set(&mut options.cache.max_reflections, &request.max_reflections);
        set(&mut options.cache.seed, &request.seed);
        set(&mut options.channels, &request.channels);
        set(&mut options.model_error, &request.model_error);
        set(&mut options.adapt_paths, &request.adapt_paths);
        set(&mut options.kernel, &request.kernel);
        if matches!(options.optimizer, Optimizer::ExponentiatedGradient(_)) {
            options.rounds = 1;
        }

        if !Kernel::available().contains(&options.kernel) {
            return Err(WorkflowError::Kernel(options.kernel));
        }
        if !refines_bench && !request.uncertainty.is_empty() {
            return Err(WorkflowError::UnusedUncertainty);
        }
        let mut priors = uncertainty.clone();
        for deviation in &request.uncertainty {
            deviation.apply(&mut priors);
        }
        Ok(Self {
            dictionary: Arc::new(dictionary),
            options,
            mask: request.mask.clone(),
            memory_mib: request.memory_mib,
            priors: refines_bench.then_some(priors),
            cells: request.cells,
        })
    }

    /// How much there is to do for so many cells under so many lights.
    pub fn work(&self, cells: usize, lights: usize) -> FitWork {
        FitWork {
            cells,
            lights,
            paths_per_cell: self.options.cache.samples_per_cell,
            refines_bench: self.priors.is_some(),
        }
    }

    /// The cells of a scene whose images are yet to be captured.
    pub fn cells_of(&self, scene: &Scene) -> usize {
        choose(scene, &self.cell_options()).cells.len()
    }

    fn cell_options(&self) -> CellOptions {
        // A bench that is not refined counts as exactly known.
        let known = self.priors.as_ref().unwrap_or(&BenchPriors::EXACT);
        let mut options = CellOptions::new(&self.dictionary, known);
        set(&mut options.budget, &self.cells);
        options
    }

    /// The images averaged over the cells that are compared, once it is certain that they can be
    /// the scene's.
    ///
    /// # Errors
    /// An image or a mask that cannot be read, images that do not belong to the scene.
    pub fn average<R: Read + Seek>(
        &self,
        scene: &Scene,
        images: Vec<Source<R>>,
    ) -> Result<Captured, WorkflowError> {
        let files: Vec<String> = images.iter().map(|image| image.file.clone()).collect();
        let cells = self.cell_options();
        let captured = cell_images::average(scene, images, self.mask.as_deref(), &cells)?;
        tracing::info!(
            cells = captured.len(),
            outlying_pixels = captured.outliers,
            "images averaged"
        );
        let known = |priors: &BenchPriors| priors.intensity.hypot(priors.common_intensity);
        let log_std = self.priors.as_ref().map_or(0.0, known);
        match plausibility::check(scene, &captured, &self.dictionary, log_std) {
            Ok(()) => Ok(captured),
            Err(source) => Err(WorkflowError::Implausible {
                file: source.image().map(|image| files[image].clone()),
                source,
            }),
        }
    }

    /// Fits and describes the result. `truth`: name and BRDF, where known.
    ///
    /// # Errors
    /// Too little memory, or equations without a solution.
    pub fn run(
        &self,
        scene: &Scene,
        captured: &Captured,
        simulated: bool,
        truth: Option<(&str, &dyn Brdf)>,
        observer: &dyn Observer,
    ) -> Result<(FitRecord, FitImages), WorkflowError> {
        let mut remarks: Vec<String> = scene.remarks().iter().map(ToString::to_string).collect();
        let mut remark = |text: String| {
            observer.notice(Notice::Remark(&text));
            remarks.push(text);
        };
        if let Some(coarse) = coarse_facets(scene, self.dictionary.atoms()) {
            remark(coarse);
        }
        let size = [captured.len(), captured.images.len()];
        observer.notice(Notice::Work(self.work(size[0], size[1])));

        // The fit, on a refined bench where that was asked for.
        let dictionary = &self.dictionary;
        let (atoms, refines_bench) = (dictionary.len(), self.priors.is_some());
        let options =
            &fit_memory::bounded(&self.options, size, atoms, refines_bench, self.memory_mib)?;
        let (fit, bench) = match &self.priors {
            None => (
                fit_with_progress(scene, captured, dictionary, options, observer)?,
                None,
            ),
            Some(priors) => {
                let how = RefineOptions::default();
                let refined =
                    refine_bench(scene, captured, dictionary, options, priors, &how, observer)?;
                let fit = refined.fit(dictionary, options, observer)?;
                (fit, Some(refined.estimate))
            }
        };
        if fit.samples[0] < fit.samples[1] {
            remark(format!(
                "{} of {} paths per cell were traced: more do not fit into the memory given",
                fit.samples[0], fit.samples[1]
            ));
        }

        // What it comes to.
        observer.begin("scoring", None);
        let mut record = summary::of_fit(self, &fit, simulated, truth)?;
        observer.begin("longer paths", None);
        let paths = RenderOptions {
            max_reflections: self.options.cache.max_reflections,
            seed: self.options.cache.seed,
            ..RenderOptions::default()
        };
        let remainder = truncation_remainder(scene, &fit.material, &paths, TRUNCATION_SAMPLES);
        record.truncation_remainder = remainder.iter().map(|r| r.share).collect();
        record.warnings = warnings::of_fit(&fit, &record);
        record.remarks = remarks;
        record.bench = bench.as_ref().map(BenchRecord::from);
        if fit.discrepancy > 0.0 {
            observer.notice(Notice::Discrepancy {
                dictionary: &record.dictionary,
                amplitude: fit.discrepancy,
            });
        }
        let images = FitImages {
            rendered: fit.comparison.rendered(),
            residual: fit.comparison.residual(),
            cells_csv: fit.comparison.to_csv(),
        };
        Ok((record, images))
    }
}

/// Replaces `value` where something else was chosen.
fn set<T: Clone>(value: &mut T, chosen: &Option<T>) {
    if let Some(chosen) = chosen {
        value.clone_from(chosen);
    }
}
