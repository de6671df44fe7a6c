//! What may be chosen for a fit.

use std::path::PathBuf;

use crate::config::uncertainty::Deviation;
use crate::inverse::{Channels, Optimizer};
use crate::transport::Kernel;

/// Choices for a fit. What is `None` is as the rig file's `[fit]` table has it (a session), else
/// as in [`FitOptions::default`](crate::inverse::FitOptions).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitRequest {
    /// Name of a built-in dictionary ([`Dictionary::NAMES`](crate::brdf::Dictionary::NAMES)), or
    /// the path of a dictionary file.
    pub dictionary: Option<String>,
    /// How the weights are found.
    pub optimizer: Option<Optimizer>,
    /// Light paths per cell, 2..=65 536.
    pub samples_per_cell: Option<u32>,
    /// Longest path in surface reflections, 2..=64.
    pub max_reflections: Option<u32>,
    /// Seed of the light paths, at most 2⁶³ − 1.
    pub seed: Option<u64>,
    /// Weights of their own for each colour channel, or shared.
    pub channels: Option<Channels>,
    /// Relative error of the model that the weighting allows for, 0..=1.
    pub model_error: Option<f64>,
    /// PNG of the images' size: only pixels that are white in it are compared.
    pub mask: Option<PathBuf>,
    /// Most cells of the images that are compared, within
    /// [`BUDGET`](crate::cells::BUDGET).
    pub cells: Option<usize>,
    /// Memory that the whole fit may take, MiB. `None`: what the cells need and
    /// [`CacheOptions::max_bytes`](crate::transport::CacheOptions) for paths, as far as the
    /// machine has them free.
    pub memory_mib: Option<u64>,
    /// Which instructions evaluate the paths.
    pub kernel: Option<Kernel>,
    /// Whether light directions, intensities and the sample's pose are refined with the weights,
    /// within their stated uncertainty.
    pub refine_bench: Option<bool>,
    /// Deviations in place of those of the rig or scene file and of calibration records.
    pub uncertainty: Vec<Deviation>,
    /// Record of the sample's pose in place of the session's copy; of no use for images of a
    /// scene file.
    pub pose: Option<PathBuf>,
    /// Whose work the fit is, as its record is to state it: a job that is repeated finds its fit
    /// by that.
    pub job: Option<String>,
}
