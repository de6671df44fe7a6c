//! What `rig fit`, `rig capture` and `rig demo` share: from a session's merged images
//! to a fit on disk and a report.

use std::collections::BTreeMap;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::bench_records::BenchRecords;
use super::cell_images::{self, Source};
use super::fit_progress::{FitProgress, Work};
use super::session_images::{CapturedSession, captured_session, measured_pose};
use super::warnings::{self, warnings};
use super::{CliError, Context, facets, fit_memory, hints, lamp_drift, preflight};
use crate::brdf::{Brdf, Dictionary, Mixture};
use crate::config::uncertainty::Deviation;
use crate::config::{RigConfig, process};
use crate::geometry::FormError;
use crate::inverse::bench::{BenchEstimate, with_sample_at};
use crate::inverse::cells::{BUDGET, choose};
use crate::inverse::exponentiated_gradient::ExponentiatedGradient;
use crate::inverse::gauss_newton::GaussNewton;
use crate::inverse::{
    BenchPriors, Captured, CellOptions, Channels, Fit, FitOptions, Optimizer, RefineOptions,
    budget, fit_with_progress, intervals, plausibility, refine_bench, variance_shares,
};
use crate::progress::Progress;
use crate::report;
use crate::session::commit::SystemDisk;
use crate::session::fit_record::{
    self, AngleCell, AngleTable, AtomRecord, BenchParameter, BenchRecord, BudgetRecord, BudgetRow,
    DiscrepancyRecord, FitImages, FitRecord, FitSettings, Grade, Timing, TracePoint, Warning,
};
use crate::session::{SessionWriter, layout};
use crate::transport::{Kernel, RenderOptions, Scene, truncation_remainder};
use crate::units::StageAngles;

/// Choices of a fit that the command line may take over from the configuration.
#[derive(clap::Args, Debug, Clone, Default)]
pub struct FitArgs {
    /// rig26 (the default), paper42, or a dictionary file
    #[arg(long, value_name = "D")]
    pub dictionary: Option<String>,
    /// How the weights are found
    #[arg(long, value_enum)]
    pub optimizer: Option<OptimizerArg>,
    /// Light paths per cell, 2 to 65536
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=65_536))]
    pub spp: Option<u32>,
    /// Longest path in surface reflections, 2 to 64
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..=64))]
    pub max_reflections: Option<u32>,
    /// Seed of the light paths
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// One set of weights for all colour channels
    #[arg(long)]
    pub shared_weights: bool,
    /// Relative error of the model that the weighting allows for, 0 to 1
    #[arg(long, value_name = "T", default_value_t = 0.02, value_parser = fraction)]
    pub model_error: f64,
    /// PNG of the images' size: only pixels that are white in it are compared
    #[arg(long, value_name = "PNG")]
    pub mask: Option<PathBuf>,
    /// Most cells of the images that are compared, 64 to 100000 (default 2500): squares of pixels,
    /// single ones where a highlight can be and large ones where the scene is smooth
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(*BUDGET.start() as u64..=*BUDGET.end() as u64))]
    pub cells: Option<u64>,
    /// Memory that the whole fit may take, MiB: fewer paths are traced if it does not suffice, and
    /// a fit that is too large for it is refused. By default, what the cells need and 512 MiB for
    /// paths, as far as the machine has them free
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(16..=1_048_576))]
    pub memory: Option<u64>,
    /// Which instructions evaluate the paths; portable gives the same numbers anywhere
    #[arg(long, value_enum)]
    pub kernel: Option<KernelArg>,
    /// Refine light directions, intensities and the sample's pose with the weights,
    /// within the uncertainty that the rig or scene file states
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub refine_bench: Option<bool>,
    /// A deviation of the [uncertainty] table, such as light_deg=0.5; more than one may be given
    #[arg(long, value_name = "KEY=VALUE")]
    pub uncertainty: Vec<Deviation>,
}

/// `--optimizer`.
#[derive(clap::ValueEnum, Debug, Clone, Copy, PartialEq, Eq)]
pub enum OptimizerArg {
    /// Gauss-Newton steps on the simplex
    GaussNewton,
    /// Exponentiated gradient with Adam steps, as in the paper
    ExponentiatedGradient,
    /// The convex least squares that takes all light as reflected once; a baseline
    SingleBounce,
}

/// `--kernel`.
#[derive(clap::ValueEnum, Debug, Clone, Copy, PartialEq, Eq)]
pub enum KernelArg {
    /// Plain Rust, the same numbers on every machine
    Portable,
    /// AVX2
    Avx2,
    /// AVX-512
    Avx512,
    /// The fastest this machine has
    Auto,
}

impl KernelArg {
    /// The kernel; an error if this machine lacks it.
    fn kernel(self) -> Result<Kernel, CliError> {
        let kernel = match self {
            KernelArg::Portable => Kernel::Portable,
            KernelArg::Avx2 => Kernel::Avx2,
            KernelArg::Avx512 => Kernel::Avx512,
            KernelArg::Auto => Kernel::detect(),
        };
        if Kernel::available().contains(&kernel) {
            return Ok(kernel);
        }
        let fact = format!("this processor lacks what kernel {kernel} needs");
        Err(CliError::new(fact).hint("`--kernel auto` takes the fastest that it has"))
    }
}

fn fraction(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err("not in 0 to 1".to_owned())
    }
}

/// What is fitted and how, from configuration and command line together.
pub struct FitPlan {
    dictionary: Arc<Dictionary>,
    options: FitOptions,
    mask: Option<PathBuf>,
    /// How well the bench is known; `None`: exactly.
    priors: Option<BenchPriors>,
    /// Most cells, if that was said.
    cells: Option<usize>,
    /// Memory of the whole fit, MiB, if that was said.
    memory_mib: Option<u64>,
}

impl FitPlan {
    /// The command line over `config`'s defaults, on a bench that is known within
    /// `uncertainty` and with a sample whose surface is known within `form_error`.
    pub fn new(
        args: &FitArgs,
        config: Option<&process::FitConfig>,
        uncertainty: &BenchPriors,
        form_error: Option<FormError>,
    ) -> Result<Self, CliError> {
        let name = args
            .dictionary
            .as_deref()
            .or(config.map(|c| c.dictionary.as_str()));
        let dictionary = Dictionary::load(name.unwrap_or(Dictionary::DEFAULT))?;
        let mut options = FitOptions {
            model_error: args.model_error,
            channels: if args.shared_weights {
                Channels::Shared
            } else {
                Channels::Separate
            },
            form_error,
            ..FitOptions::default()
        };
        if let Some(config) = config {
            options.cache.samples_per_cell = config.samples_per_pixel;
            options.cache.max_reflections = config.max_reflections.max(2);
            options.cache.seed = config.seed;
        }
        let exponentiated = match args.optimizer {
            Some(optimizer) => optimizer == OptimizerArg::ExponentiatedGradient,
            None => {
                config.is_some_and(|c| c.optimizer == process::Optimizer::ExponentiatedGradient)
            }
        };
        options.optimizer = if args.optimizer == Some(OptimizerArg::SingleBounce) {
            Optimizer::SingleBounce
        } else if exponentiated {
            options.rounds = 1;
            Optimizer::ExponentiatedGradient(ExponentiatedGradient::default())
        } else {
            Optimizer::GaussNewton(GaussNewton::default())
        };
        let cache = &mut options.cache;
        cache.samples_per_cell = args.spp.unwrap_or(cache.samples_per_cell);
        cache.max_reflections = args.max_reflections.unwrap_or(cache.max_reflections);
        cache.seed = args.seed.unwrap_or(cache.seed);
        if let Some(kernel) = args.kernel {
            options.kernel = kernel.kernel()?;
        }
        let refine = args
            .refine_bench
            .unwrap_or(config.is_some_and(|c| c.refine_bench));
        if !refine && !args.uncertainty.is_empty() {
            return Err(CliError::new(
                "--uncertainty says how well the bench is known, but the bench is not refined",
            )
            .hint("add --refine-bench, or leave --uncertainty out"));
        }
        let mut priors = uncertainty.clone();
        args.uncertainty.iter().for_each(|d| d.apply(&mut priors));
        Ok(Self {
            dictionary: Arc::new(dictionary),
            options,
            mask: args.mask.clone(),
            priors: refine.then_some(priors),
            cells: args.cells.map(|cells| cells as usize),
            memory_mib: args.memory,
        })
    }

    /// The options with the room that cached paths may take, or why no fit of so many cells under
    /// so many lights finds enough memory.
    fn bounded(&self, cells_and_lights: [usize; 2]) -> Result<FitOptions, CliError> {
        let (atoms, refines) = (self.dictionary.len(), self.priors.is_some());
        fit_memory::bounded(
            &self.options,
            cells_and_lights,
            atoms,
            refines,
            self.memory_mib,
        )
    }

    /// How much there is to do for so many cells under so many lights.
    pub(super) fn work(&self, cells: usize, lights: usize) -> Work {
        Work {
            cells,
            lights,
            paths_per_cell: self.options.cache.samples_per_cell,
            refines_bench: self.priors.is_some(),
        }
    }

    /// The cells of a scene whose images are yet to be captured.
    pub(super) fn cells_of(&self, scene: &Scene) -> usize {
        choose(scene, &self.cell_options()).cells.len()
    }

    fn cell_options(&self) -> CellOptions {
        // A bench that is not refined counts as exactly known.
        let known = self.priors.as_ref().unwrap_or(&BenchPriors::EXACT);
        let options = CellOptions::new(&self.dictionary, known);
        CellOptions {
            budget: self.cells.unwrap_or(options.budget),
            ..options
        }
    }

    /// The images averaged over the cells that are compared.
    pub(super) fn average<R: Read + Seek>(
        &self,
        scene: &Scene,
        images: Vec<cell_images::Source<R>>,
    ) -> Result<Captured, CliError> {
        let cells = self.cell_options();
        let captured = cell_images::average(scene, images, self.mask.as_deref(), &cells)?;
        tracing::info!(
            cells = captured.len(),
            outlying_pixels = captured.outliers,
            "images averaged"
        );
        Ok(captured)
    }

    /// Refuses images that cannot be those of the scene; `file` names the one of a light.
    pub(super) fn check_images(
        &self,
        scene: &Scene,
        captured: &Captured,
        file: impl Fn(usize) -> String,
    ) -> Result<(), CliError> {
        let known = |priors: &BenchPriors| priors.intensity.hypot(priors.common_intensity);
        let log_std = self.priors.as_ref().map_or(0.0, known);
        plausibility::check(scene, captured, &self.dictionary, log_std).map_err(|error| {
            let fact = match error.image() {
                Some(image) => format!("{}: {error}", file(image)),
                None => error.to_string(),
            };
            CliError::new(fact).hint(hints::for_implausible(&error))
        })
    }

    /// Fits and describes the result. `truth`: name and BRDF, where known.
    pub fn run(
        &self,
        scene: &Scene,
        captured: &Captured,
        simulated: bool,
        truth: Option<(&str, &dyn Brdf)>,
        context: &Context,
    ) -> Result<(FitRecord, FitImages), CliError> {
        let mut remarks: Vec<String> = scene.remarks().iter().map(ToString::to_string).collect();
        let mut remark = |text: String| {
            context.warn(&text);
            remarks.push(text);
        };
        if let Some(coarse) = facets::coarse(scene, self.dictionary.atoms()) {
            remark(coarse);
        }
        let work = self.work(captured.len(), captured.images.len());
        tracing::info!("{work}");
        let progress = FitProgress::new(context, self.priors.is_some());
        let (dictionary, options) = (
            &self.dictionary,
            &self.bounded([captured.len(), captured.images.len()])?,
        );
        let (fit, bench) = match &self.priors {
            None => (
                fit_with_progress(scene, captured, dictionary, options, &progress)?,
                None,
            ),
            Some(priors) => {
                let how = RefineOptions::default();
                let refined = refine_bench(
                    scene, captured, dictionary, options, priors, &how, &progress,
                )?;
                let fit = refined.fit(dictionary, options, &progress)?;
                (fit, Some(refined.estimate))
            }
        };
        if fit.samples[0] < fit.samples[1] {
            remark(format!(
                "{} of {} paths per cell were traced: more do not fit into the memory given",
                fit.samples[0], fit.samples[1]
            ));
        }
        progress.begin("scoring", None);
        let mut record = self.describe(&fit, simulated, truth)?;
        progress.begin("longer paths", None);
        let paths = RenderOptions {
            max_reflections: self.options.cache.max_reflections,
            seed: self.options.cache.seed,
            ..RenderOptions::default()
        };
        let remainder = truncation_remainder(scene, &fit.material, &paths, TRUNCATION_SAMPLES);
        record.truncation_remainder = remainder.iter().map(|r| r.share).collect();
        record.warnings = warnings(&fit, &record);
        record.remarks = remarks;
        record.bench = bench.as_ref().map(bench_record);
        progress.finish();
        if fit.discrepancy > 0.0 {
            context.note(format!(
                "the material departs from every mixture of {}, {:.1} times as much as measured materials usually do; its f in table.csv and in exports to merl, rgl and pbrt allows for it, weights and an export to mitsuba are the closest mixture",
                record.dictionary, fit.discrepancy
            ));
        }
        Ok((
            record,
            FitImages {
                rendered: fit.comparison.rendered(),
                residual: fit.comparison.residual(),
                cells_csv: fit.comparison.to_csv(),
            },
        ))
    }

    fn describe(
        &self,
        fit: &Fit,
        simulated: bool,
        truth: Option<(&str, &dyn Brdf)>,
    ) -> Result<FitRecord, CliError> {
        let dictionary = fit.material.mixture.dictionary();
        let mut timings = fit.timings.clone();
        let clock = std::time::Instant::now();
        let score = match truth {
            Some((name, brdf)) => {
                let start = Mixture::new(self.dictionary.clone(), fit.start.clone())?;
                Some(crate::evaluate::score(
                    name,
                    brdf,
                    &self.dictionary,
                    &fit.material,
                    &start,
                    SCORE_SPHERE_PX,
                )?)
            }
            None => None,
        };
        timings.push(("score", clock.elapsed().as_secs_f64()));
        let theta_h_deg: Vec<f64> = (0..=45)
            .map(|i| 90.0 * (f64::from(i) / 45.0).powi(2))
            .collect();
        let theta_d_deg: Vec<f64> = (0..=30).map(|j| 3.0 * f64::from(j)).collect();
        let cells = intervals::table(&fit.material, &fit.draws, &theta_h_deg, &theta_d_deg)
            .into_iter()
            .map(|i| AngleCell {
                value: i.value,
                lower: i.lower,
                upper: i.upper,
                constrained: i.constrained,
            })
            .collect();
        let options = &self.options;
        Ok(FitRecord {
            simulated,
            dictionary: dictionary.name().to_owned(),
            atoms: dictionary
                .atoms()
                .iter()
                .enumerate()
                .map(|(i, a)| AtomRecord::new(i, a))
                .collect(),
            weights: fit.material.mixture.weights().clone(),
            weight_deviations: intervals::weight_deviations(&fit.draws, dictionary.len()),
            settings: FitSettings {
                optimizer: options.optimizer.name().to_owned(),
                samples_per_pixel: u64::from(fit.samples[0]),
                samples_requested: Some(u64::from(fit.samples[1])),
                memory_mib: self
                    .memory_mib
                    .or(Some((options.cache.max_bytes >> 20) as u64)),
                adapted_paths: Some(options.adapt_paths),
                shared_weights: Some(options.channels == Channels::Shared),
                model_error: Some(options.model_error),
                mask: self.mask.as_ref().map(|path| path.display().to_string()),
                scene: None,
                images: Vec::new(),
                max_reflections: options.cache.max_reflections,
                seed: options.cache.seed,
                kernel: fit.kernel.to_string(),
            },
            loss: fit
                .trace
                .last()
                .map_or(0.0, |(_, step)| step.loss.iter().sum()),
            reduced_chi_square: fit.comparison.reduced_chi2(),
            truncation_remainder: Vec::new(),
            outlier_fraction: fit.outlier_fraction.clone(),
            discrepancy: (fit.discrepancy > 0.0).then(|| DiscrepancyRecord {
                amplitude: fit.discrepancy,
                by_channel: fit.material.discrepancies.clone(),
            }),
            termination: fit.termination.to_string(),
            trace: fit
                .trace
                .iter()
                .enumerate()
                .map(|(step, (seconds, point))| TracePoint {
                    step: step as u64,
                    loss: point.loss.iter().sum(),
                    seconds: *seconds,
                })
                .collect(),
            timings: timings
                .iter()
                .map(|(stage, seconds)| Timing {
                    stage: (*stage).to_owned(),
                    seconds: *seconds,
                })
                .collect(),
            versions: BTreeMap::from([("rig".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
            score,
            table: AngleTable {
                theta_h_deg,
                theta_d_deg,
                cells,
            },
            warnings: Vec::new(),
            remarks: Vec::new(),
            bench: None,
            budget: budget_record(fit),
        })
    }
}

/// Half and difference angles of the error budget, degrees.
const BUDGET_AT_DEG: [[f64; 2]; 8] = [
    [0.0, 10.0],
    [5.0, 10.0],
    [15.0, 10.0],
    [40.0, 10.0],
    [0.0, 50.0],
    [5.0, 50.0],
    [15.0, 50.0],
    [40.0, 50.0],
];

/// Where the interval comes from, at a few angles; `None` without draws.
fn budget_record(fit: &Fit) -> Option<BudgetRecord> {
    let row = |[theta_h_deg, theta_d_deg]: [f64; 2]| {
        let cell = variance_shares::at(&fit.material, &fit.draws, theta_h_deg, theta_d_deg)?;
        let total: f64 = cell.relative_variance.iter().sum();
        let share = cell.relative_variance.iter();
        Some(BudgetRow {
            theta_h_deg,
            theta_d_deg,
            value: cell.value,
            relative_std: total.sqrt(),
            share: share
                .map(|v| if total > 0.0 { v / total } else { 0.0 })
                .collect(),
        })
    };
    let row: Vec<BudgetRow> = BUDGET_AT_DEG.into_iter().filter_map(row).collect();
    (!row.is_empty()).then(|| BudgetRecord {
        sources: budget::Source::ALL.map(|s| s.name().to_owned()).to_vec(),
        row,
    })
}

/// The refined bench in the units in which it is shown.
fn bench_record(bench: &BenchEstimate) -> BenchRecord {
    let [residual_described, residual_refined] = bench.reduced_chi2;
    BenchRecord {
        rounds: bench.rounds as u32,
        settled: bench.settled,
        residual_described,
        residual_refined,
        held: bench.held.clone(),
        parameter: bench
            .parameters
            .iter()
            .map(|estimated| {
                let (unit, scale) = estimated.parameter.shown_in();
                BenchParameter {
                    name: estimated.parameter.to_string(),
                    unit: unit.to_owned(),
                    value: estimated.value * scale,
                    deviation: estimated.deviation * scale,
                    prior_deviation: estimated.prior_deviation * scale,
                }
            })
            .collect(),
    }
}

/// Pixels per side of the spheres of the environment error, as the score is defined.
const SCORE_SPHERE_PX: usize = crate::brdf::score::SPHERE_SIZE;

/// Paths per looked-at pixel that the truncation's estimate takes.
const TRUNCATION_SAMPLES: u32 = 32;

const SCALE_AS_DESCRIBED: &str = "no record of the irradiance: the BRDF's scale, its albedo, is as good as irradiance_w_m2 in the rig file";

/// Fits a session's merged images into its next `fits/<n>` and returns that folder;
/// `pose` is a record of where the sample lies.
pub fn fit_session(
    root: &Path,
    args: &FitArgs,
    pose: Option<&Path>,
    context: &Context,
) -> Result<PathBuf, CliError> {
    // Before a fit that may take hours, and let go of until it is there.
    SessionWriter::open(Arc::new(SystemDisk), root)?.check_writable(layout::FITS_FOLDER)?;
    let captured = captured_session(root)?;
    let images = captured.image_rows(root)?;
    let CapturedSession {
        session,
        config,
        mut places,
    } = captured;
    let record = session.record();
    let records = BenchRecords::load(root)?;
    let is_scale_described = !config.is_simulated() && !records.has_irradiance();
    if is_scale_described {
        context.note(format_args!(
            "{SCALE_AS_DESCRIBED}; `rig calibrate white` measures it, and where it is unknown \
             --refine-bench --uncertainty common_intensity=1 says so"
        ));
    }
    let mut bench = records.apply(&config, &mut places, context);
    let mut scene = bench.scene(&places, context)?;
    let mut uncertainty = bench.priors;
    if let Some(pose) = measured_pose(root, pose)? {
        let [rotation_rad, translation_mm] = pose.pose();
        scene = with_sample_at(scene, rotation_rad, translation_mm);
        uncertainty.pose_covariance = Some(pose.covariance_rad_mm());
    }
    let drift = session.lamp_drift()?;
    uncertainty.intensity = match uncertainty.intensity {
        known if known > 0.0 => known.hypot(drift.of_intensities()),
        exact => exact,
    };
    let form_error = config.geometry.sample.form_error;
    let plan = FitPlan::new(args, Some(&config.fit), &uncertainty, form_error)?;
    let file = |light: usize| {
        root.join(layout::radiance_file(light as u32))
            .display()
            .to_string()
    };
    preflight::check_scene(&scene, preflight::Keys::rig(&config), context)?;
    let sources = images.into_iter().enumerate().map(|(light, rows)| Source {
        rows,
        file: file(light),
        mean_of_unstated: None,
    });
    let captured = plan.average(&scene, sources.collect())?;
    plan.check_images(&scene, &captured, file)?;
    let truth = match &config.simulation {
        Some(simulation) => Some(simulation.material.load()?),
        None => None,
    };
    let name = record
        .true_material
        .as_deref()
        .unwrap_or("simulated material");
    let truth = truth.as_ref().map(|brdf| (name, &**brdf));
    let (mut fit, images) = plan.run(&scene, &captured, record.simulated, truth, context)?;
    if is_scale_described {
        fit.remarks.push(SCALE_AS_DESCRIBED.to_owned());
    }
    fit.warnings
        .extend(session.journal().suspicion().map(|what| Warning {
            what,
            likely_cause: "an axis that slipped or was blocked: the fit takes the lights to be where they were asked for; capture anew".to_owned(),
            grade: Grade::Reservation,
        }));
    if let Some(remark) = lamp_drift::remark(&drift) {
        context.warn(&remark);
        fit.remarks.push(remark);
    }
    let mut writer = SessionWriter::open(Arc::new(SystemDisk), root)?;
    let folder = fit_record::commit(&mut writer, &fit, &images)?;
    writer.refresh_manifest()?;
    warnings::tell(&fit, context);
    Ok(folder)
}

/// Writes the session's report and returns its path.
pub fn report_session(root: &Path) -> Result<PathBuf, CliError> {
    let html = report::render(&report::load::load(root, None)?)?;
    let mut session = SessionWriter::open(Arc::new(SystemDisk), root)?;
    session.commit_file(layout::REPORT_FILE, html.as_bytes())?;
    session.refresh_manifest()?;
    Ok(root.join(layout::REPORT_FILE))
}

/// How much a fit with the defaults will have to do, of images under these lights.
pub fn work_of(config: &RigConfig, lights: &[StageAngles]) -> Result<Work, CliError> {
    let form_error = config.geometry.sample.form_error;
    let uncertainty = &config.uncertainty;
    let plan = FitPlan::new(&default_args(), Some(&config.fit), uncertainty, form_error)?;
    let scene = config.geometry.scene(lights)?;
    Ok(plan.work(plan.cells_of(&scene), lights.len()))
}

fn default_args() -> FitArgs {
    FitArgs {
        model_error: 0.02,
        ..FitArgs::default()
    }
}

/// Fits a captured session and reports it.
pub fn fit_and_report(root: &Path, context: &Context) -> Result<(), CliError> {
    let folder = fit_session(root, &default_args(), None, context)?;
    context.note(format!("fit: {}", folder.display()));
    let report = report_session(root)?;
    context.note(format!("report: {}", report.display()));
    Ok(())
}
