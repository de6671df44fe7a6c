//! The options of a fit, as the library's request.

use std::path::PathBuf;

use crate::brdf::Dictionary;
use crate::cells::{BUDGET, DEFAULT_CELLS};
use crate::config::uncertainty::Deviation;
use crate::inverse::exponentiated_gradient::ExponentiatedGradient;
use crate::inverse::gauss_newton::GaussNewton;
use crate::inverse::{Channels, FitOptions, Optimizer};
use crate::transport::{CacheOptions, Kernel};
use crate::workflow::FitRequest;

/// Choices of a fit that take precedence over the configuration.
#[derive(clap::Args, Debug)]
pub struct FitArgs {
    #[arg(long, value_name = "D", help = dictionary_help())]
    dictionary: Option<String>,
    /// How the weights are found
    #[arg(long, value_enum)]
    optimizer: Option<OptimizerArg>,
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=65_536), help = spp_help())]
    spp: Option<u32>,
    /// Longest path in surface reflections, 2 to 64
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..=64))]
    max_reflections: Option<u32>,
    /// Seed of the light paths
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    seed: Option<u64>,
    /// The same weights for all colour channels
    #[arg(long)]
    shared_weights: bool,
    #[arg(long, value_name = "T", value_parser = fraction, help = model_error_help())]
    model_error: Option<f64>,
    /// PNG of the images' size: only pixels that are white in it are compared
    #[arg(long, value_name = "PNG")]
    mask: Option<PathBuf>,
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(*BUDGET.start() as u64..=*BUDGET.end() as u64), help = cells_help())]
    cells: Option<u64>,
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(16..=1_048_576), help = memory_help())]
    memory: Option<u64>,
    /// Which instructions evaluate the paths; portable gives the same numbers anywhere
    #[arg(long, value_enum)]
    kernel: Option<KernelArg>,
    /// Refine light directions, intensities and the sample's pose with the weights,
    /// within the uncertainty that the rig or scene file states
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    refine_bench: Option<bool>,
    /// A deviation of the [uncertainty] table, such as light_deg=0.5; more than one may be given
    #[arg(long, value_name = "KEY=VALUE")]
    uncertainty: Vec<Deviation>,
}

fn dictionary_help() -> String {
    let others = Dictionary::NAMES
        .iter()
        .filter(|name| **name != Dictionary::DEFAULT);
    let others: Vec<&str> = others.copied().collect();
    format!(
        "{} (the default), {}, or a dictionary file",
        Dictionary::DEFAULT,
        others.join(", ")
    )
}

fn spp_help() -> String {
    let default = CacheOptions::default().samples_per_cell;
    format!("Light paths per cell, 2 to 65536 (default {default})")
}

fn model_error_help() -> String {
    let default = FitOptions::default().model_error;
    format!("Relative error of the model that the weighting allows for, 0 to 1 (default {default})")
}

fn cells_help() -> String {
    format!(
        "Most cells of the images that are compared, {} to {} (default {DEFAULT_CELLS}): squares of pixels, single ones where a highlight can be and large ones where the scene is smooth",
        BUDGET.start(),
        BUDGET.end()
    )
}

fn memory_help() -> String {
    let default_mib = CacheOptions::default().max_bytes >> 20;
    format!(
        "Memory that the whole fit may take, MiB: fewer paths are traced if it does not suffice, and a fit that is too large for it is refused. By default, what the cells need and {default_mib} MiB for paths, as far as the machine has them free"
    )
}

fn fraction(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err("not in 0 to 1".to_owned())
    }
}

/// `--optimizer`.
#[derive(clap::ValueEnum, Debug, Clone, Copy, PartialEq, Eq)]
enum OptimizerArg {
    /// Gauss-Newton steps on the simplex
    GaussNewton,
    /// Exponentiated gradient with Adam steps, as in the paper
    ExponentiatedGradient,
    /// Convex least squares on direct reflection alone; a baseline
    SingleBounce,
}

/// `--kernel`.
#[derive(clap::ValueEnum, Debug, Clone, Copy, PartialEq, Eq)]
enum KernelArg {
    /// Plain Rust, the same numbers on every machine
    Portable,
    /// AVX2
    Avx2,
    /// AVX-512
    Avx512,
    /// The fastest this machine has
    Auto,
}

impl FitArgs {
    /// The library's request.
    pub fn request(&self) -> FitRequest {
        FitRequest {
            dictionary: self.dictionary.clone(),
            optimizer: self.optimizer.map(|optimizer| match optimizer {
                OptimizerArg::GaussNewton => Optimizer::GaussNewton(GaussNewton::default()),
                OptimizerArg::ExponentiatedGradient => {
                    Optimizer::ExponentiatedGradient(ExponentiatedGradient::default())
                }
                OptimizerArg::SingleBounce => Optimizer::SingleBounce,
            }),
            samples_per_cell: self.spp,
            max_reflections: self.max_reflections,
            seed: self.seed,
            channels: self.shared_weights.then_some(Channels::Shared),
            model_error: self.model_error,
            mask: self.mask.clone(),
            cells: self.cells.map(|cells| cells as usize),
            memory_mib: self.memory,
            kernel: self.kernel.and_then(|kernel| match kernel {
                KernelArg::Portable => Some(Kernel::Portable),
                KernelArg::Avx2 => Some(Kernel::Avx2),
                KernelArg::Avx512 => Some(Kernel::Avx512),
                KernelArg::Auto => None,
            }),
            refine_bench: self.refine_bench,
            uncertainty: self.uncertainty.clone(),
            pose: None,
            job: None,
        }
    }
}
