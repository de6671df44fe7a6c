//! A fit from the averaged images of a scene to its record.

use std::path::PathBuf;
use std::sync::Arc;

use super::cell_images::{self, Rows, Source};
use super::{FitRequest, FitWork, WorkflowError};
use crate::bench_priors::BenchPriors;
use crate::brdf::Dictionary;
use crate::cells::choose;
use crate::cells::glare::Glare;
use crate::cells::{Captured, CellOptions};
use crate::config::fit::set;
use crate::geometry::FormError;
use crate::inverse::{FitOptions, Optimizer};
use crate::plausibility;
use crate::transport::{Kernel, Scene};

/// What is fitted and how, by configuration and request together.
pub(super) struct FitPlan {
    pub dictionary: Arc<Dictionary>,
    pub options: FitOptions,
    pub mask: Option<PathBuf>,
    /// Whose work it is, if anybody's.
    pub job: Option<String>,
    /// Memory of the whole fit, MiB, if it is limited.
    pub memory_mib: Option<u64>,
    /// How well the bench is known; `None`: exactly.
    pub priors: Option<BenchPriors>,
    /// What the images are freed of.
    pub glare: Option<Glare>,
    /// Most cells, if chosen.
    cells: Option<usize>,
}

impl FitPlan {
    /// The request over `config`'s over the defaults, on a bench that is known within
    /// `uncertainty` and with a sample whose surface is known within `form_error`.
    ///
    /// # Errors
    /// A dictionary that cannot be read, a kernel that the processor lacks, choices that
    /// contradict each other.
    pub fn new(
        request: &FitRequest,
        config: Option<&FitRequest>,
        uncertainty: &BenchPriors,
        form_error: Option<FormError>,
    ) -> Result<Self, WorkflowError> {
        let mut options = FitOptions {
            form_error,
            ..FitOptions::default()
        };

        // The request over the configuration over the defaults.
        let none = FitRequest::default();
        let config = config.unwrap_or(&none);
        config.apply(&mut options);
        request.apply(&mut options);
        let dictionary = request.dictionary.as_deref();
        let dictionary = Dictionary::load(dictionary.unwrap_or(config.dictionary()))?;
        let refines_bench = request.refine_bench.or(config.refine_bench) == Some(true);
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
            job: request.job.clone(),
            memory_mib: request.memory_mib,
            priors: refines_bench.then_some(priors),
            cells: request.cells.or(config.cells),
            glare: None,
        })
    }

    /// Whether what the lens or the room adds is stated: by a record of glare, or as stray light
    /// that is refined.
    pub fn allows_stray_light(&self) -> bool {
        let stated = |priors: &BenchPriors| priors.stray_light > 0.0;
        self.glare.is_some() || self.priors.as_ref().is_some_and(stated)
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
    pub fn average<R: Rows>(
        &self,
        scene: &Scene,
        images: Vec<Source<R>>,
    ) -> Result<Captured, WorkflowError> {
        let files: Vec<String> = images.iter().map(|image| image.file.clone()).collect();
        let cells = self.cell_options();
        let captured = cell_images::average(
            scene,
            images,
            self.mask.as_deref(),
            &cells,
            self.glare.as_ref(),
        )?;
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
}
