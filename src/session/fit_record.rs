//! What a fit leaves on disk: `fits/<n>/` of a session, or the folder named by
//! `rig fit --out`. Plain data with its writer and reader; nothing here fits.
//!
//! | file | content |
//! |---|---|
//! | `fit.toml` | verdict, dictionary, settings, loss, χ², termination, timings, versions, scores, warnings, remarks, the bench as refined |
//! | `weights.csv` | one row per atom: what it is, weight and standard deviation per channel |
//! | `discrepancy.csv` | by what f is more than the mixture's, over (θh, θd); only where the images ask for it |
//! | `table.csv` | f over (θh, θd) with its 95% interval, and which cells the data constrain |
//! | `trace.csv` | the loss after each step |
//! | `rendered_L000.exr` | the images rendered from the fit, mean and variance |
//! | `residual_L000.exr` | (captured − rendered) in standard deviations |
//!
//! [`write`] makes a folder that appears whole or not at all; [`commit`] adds
//! the files to a session, each journalled, `fit.toml` last: a folder without it
//! is no fit.

mod bench;
mod budget;
mod folder;
mod tables;
mod verdict;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::brdf::discrepancy::{self, Discrepancy, Material};
use crate::brdf::mixture::SUM_TOLERANCE;
use crate::brdf::{Atom, Brdf, BrdfError, Dictionary, Mixture};
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::ExrError;
use crate::session::SessionError;

pub use bench::{BenchParameter, BenchRecord};
pub use budget::{BudgetRecord, BudgetRow};
pub use folder::parse;
pub use folder::{
    check_folder, commit, encode, next_folder, numbers_in, read, read_images, read_images_in,
    read_in, write,
};
pub use tables::{AngleCell, AngleTable};
pub use verdict::{EXPLAINED_CHI_SQUARE, Grade, UNEXPLAINED_CHI_SQUARE, Verdict, Warning};

/// The record itself, written last: a folder without it holds no fit.
pub const FIT_FILE: &str = "fit.toml";
const DISCREPANCY_FILE: &str = "discrepancy.csv";
/// Its name in fits of versions before 0.2.
const FORMER_DISCREPANCY_FILE: &str = "discrepancy.csv";

/// Version of the folder's layout; a reader refuses any other.
pub const FORMAT: u32 = 1;

/// One element of the dictionary.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AtomRecord {
    /// Position in the dictionary, from 0.
    pub index: usize,
    /// See [`Atom::kind`].
    pub kind: String,
    /// Width of its lobe (Walter et al. 2007), where it has one.
    pub alpha: Option<f64>,
    /// Index of refraction relative to air, where it has one.
    pub eta: Option<f64>,
    /// Diffuse albedo, where it has one.
    pub albedo: Option<f64>,
}

impl AtomRecord {
    /// The record of a dictionary's atom.
    pub fn new(index: usize, atom: &Atom) -> Self {
        Self {
            index,
            kind: atom.kind().to_owned(),
            alpha: atom.alpha(),
            eta: atom.eta(),
            albedo: atom.albedo(),
        }
    }

    /// The atom; `None` if a parameter is missing or the kind is not known.
    pub fn atom(&self) -> Option<Atom> {
        Atom::from_parts(&self.kind, self.alpha, self.eta, self.albedo)
    }

    /// A short name for tables and plots, such as `GGX α 0.05, η 1.5`.
    pub fn label(&self) -> String {
        match (self.alpha, self.eta, self.albedo) {
            (Some(alpha), Some(eta), _) if self.kind == "ggx" => format!("GGX α {alpha}, η {eta}"),
            (Some(alpha), Some(eta), _) => {
                format!("{} α {alpha}, η {eta}", capitalised(&self.kind))
            }
            (None, Some(eta), _) => format!("{} η {eta}", capitalised(&self.kind)),
            (_, _, Some(albedo)) => format!("{} ρ {albedo}", capitalised(&self.kind)),
            _ => capitalised(&self.kind),
        }
    }
}

fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    letters
        .next()
        .map(|first| first.to_uppercase().chain(letters).collect())
        .unwrap_or_default()
}

/// How the fit was run. Fits of earlier versions lack what is marked as optional.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FitSettings {
    /// `gauss-newton`, `exponentiated-gradient` or `single-bounce`.
    pub optimizer: String,
    /// Camera paths per cell, as traced.
    pub samples_per_pixel: u64,
    /// Camera paths per cell that were asked for: more than were traced where memory did not
    /// suffice. Optional, as is all below that has `None` or nothing.
    pub samples_requested: Option<u64>,
    /// Memory that cached paths might take, MiB.
    pub memory_mib: Option<u64>,
    /// Whether paths were traced again where the first fit's material sends light.
    pub adapted_paths: Option<bool>,
    /// One set of weights for all channels.
    pub shared_weights: Option<bool>,
    /// Relative error of the model that the weighting allowed for.
    pub model_error: Option<f64>,
    /// Mask of the compared pixels, as it was named.
    pub mask: Option<String>,
    /// Scene file, as it was named; none for a session.
    pub scene: Option<String>,
    /// Images, as they were named, in the lights' order; none for a session.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub images: Vec<String>,
    /// Longest path in surface reflections; 1 = direct only.
    pub max_reflections: u32,
    /// Seed of all random streams. At most 2⁶³ − 1, which TOML can hold.
    pub seed: u64,
    /// `portable`, `avx2` or `avx512`: results are bit-identical per kernel.
    pub kernel: String,
}

/// The loss after one step of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TracePoint {
    /// Step number; 0 is the start.
    pub step: u64,
    /// The objective, dimensionless.
    pub loss: f64,
    /// Since the optimiser began, seconds.
    pub seconds: f64,
}

/// Wall time of one stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// What was done, e.g. `trace`.
    pub stage: String,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// One error, by channel and over all three.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelScore {
    /// R, G, B; relative, dimensionless.
    pub channels: [f64; 3],
    /// Over all channels together.
    pub overall: f64,
}

/// One metric for the estimate and for what it is to be measured against.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetricScores {
    /// The fit.
    pub estimate: ChannelScore,
    /// The simplex weights that minimise the squared cube-root error to the truth.
    pub reference_projection: ChannelScore,
    /// The least value of this metric that any weights on the simplex reach.
    pub floor: ChannelScore,
    /// The single-bounce least-squares start of the fit (Eq. 13 of the paper).
    pub single_bounce_start: Option<ChannelScore>,
}

/// The fit beside the truth, where the truth is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoreSheet {
    /// Name of the true material.
    pub truth: String,
    /// Sphere under environment maps: mean over the maps of ‖a − b‖₂ / ‖b‖₂.
    pub environment_error: MetricScores,
    /// ‖cos θi (f − f̂)‖ / ‖cos θi f‖ over the table's cells.
    pub brdf_error: MetricScores,
    /// The same cells, mean |∛a − ∛b| over mean ∛b with a = cos θi f.
    pub brdf_cube_root_error: Option<MetricScores>,
}

/// How the material departs from the mixture of the weights (docs/adr/0032).
#[derive(Clone, Debug, PartialEq)]
pub struct DiscrepancyRecord {
    /// How much it departs from every mixture, in units of what measured materials do; above 0.
    pub amplitude: f64,
    /// In R, G and B.
    pub by_channel: [Discrepancy; 3],
}

/// Everything that a fit leaves, but its images.
#[derive(Clone, Debug, PartialEq)]
pub struct FitRecord {
    /// The images come from a simulated bench.
    pub simulated: bool,
    /// Name of the dictionary.
    pub dictionary: String,
    /// Its N atoms, in order.
    pub atoms: Vec<AtomRecord>,
    /// Per channel R, G, B: N weights, each ≥ 0, that sum to 1. Not identifiable
    /// one by one: different weights can give the same BRDF.
    pub weights: [Vec<f64>; 3],
    /// Standard deviation of each weight, same shape.
    pub weight_deviations: [Vec<f64>; 3],
    /// How it was run.
    pub settings: FitSettings,
    /// Final value of the objective, dimensionless.
    pub loss: f64,
    /// χ² per degree of freedom, per light and channel; isolated outliers count in it as they
    /// did in the fit.
    pub reduced_chi_square: Vec<[f64; 3]>,
    /// Light that paths longer than the longest followed would bring, over all light, per
    /// light; empty where it was not estimated.
    pub truncation_remainder: Vec<f64>,
    /// Part of the compared values that counted for less, as isolated outliers, per light.
    pub outlier_fraction: Vec<f64>,
    /// How the material departs from the mixture of the weights; `None` where the images do
    /// not ask for it.
    pub discrepancy: Option<DiscrepancyRecord>,
    /// Why the optimiser stopped, in words.
    pub termination: String,
    /// The way there.
    pub trace: Vec<TracePoint>,
    /// Wall time by stage.
    pub timings: Vec<Timing>,
    /// Versions of the program and of what it ran on, by name.
    pub versions: BTreeMap<String, String>,
    /// The fit beside the truth; `None` where no truth is known.
    pub score: Option<ScoreSheet>,
    /// The BRDF with its interval over (θh, θd).
    pub table: AngleTable,
    /// Reasons not to trust the fit, or not in everything, the gravest first; empty if none
    /// were found.
    pub warnings: Vec<Warning>,
    /// What to know of how the fit was made that speaks neither for nor against it.
    pub remarks: Vec<String>,
    /// The bench as refined; `None` where it was taken as exactly known.
    pub bench: Option<BenchRecord>,
    /// Where the interval comes from; `None` without draws.
    pub budget: Option<BudgetRecord>,
}

impl FitRecord {
    /// The fitted BRDF.
    ///
    /// # Errors
    /// As of [`FitRecord::mixture`].
    pub fn material(&self) -> Result<Arc<dyn Brdf>, BrdfError> {
        let mixture = self.mixture()?;
        Ok(match &self.discrepancy {
            None => Arc::new(mixture),
            Some(discrepancy) => Arc::new(Material::new(mixture, &discrepancy.by_channel)),
        })
    }

    /// The mixture of the weights: the one closest to the fitted BRDF where that departs from all.
    ///
    /// # Errors
    /// Atoms that the program doesn't know or whose parameters are out of range.
    pub fn mixture(&self) -> Result<Mixture, BrdfError> {
        let atoms: Option<Vec<Atom>> = self.atoms.iter().map(AtomRecord::atom).collect();
        let atoms = atoms.ok_or_else(|| BrdfError::Dictionary {
            name: self.dictionary.clone(),
            fact: "an atom is neither a complete ggx nor lambertian nor black".to_owned(),
        })?;
        let dictionary = Dictionary::new(self.dictionary.clone(), atoms)?;
        Mixture::new(Arc::new(dictionary), self.weights.clone())
    }

    /// The worst reduced χ² of all lights and channels; `None` without any.
    pub fn worst_reduced_chi_square(&self) -> Option<f64> {
        self.reduced_chi_square
            .iter()
            .flatten()
            .copied()
            .reduce(f64::max)
    }
}

/// The images of a fit, one of each per light, as pictures of at most 512 pixels a side.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitImages {
    /// Rendered from the estimate: mean and variance, unit of the captured images.
    pub rendered: Vec<RadianceImage>,
    /// `mean` holds (captured − rendered) in standard deviations; `variance` is unused.
    pub residual: Vec<RadianceImage>,
    /// Table of the compared cells, comma-separated; empty where read from a folder.
    pub cells_csv: String,
}

/// What can be wrong with a fit's folder; facts only.
#[derive(Debug, thiserror::Error)]
pub enum FitRecordError {
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The folder is there already and not empty.
    #[error("{} exists and is not empty", path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
    },
    /// A text file that does not parse.
    #[error("{}, line {line}: {key}: {fact}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The key or column concerned.
        key: String,
        /// What is wrong.
        fact: String,
    },
    /// A value out of its range.
    #[error("{}: {key} is {value}, allowed is {allowed}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key or column.
        key: String,
        /// What stands there.
        value: String,
        /// What may stand there.
        allowed: String,
    },
    /// A file in a session that no journal record names.
    #[error("{} is not in the session's journal", path.display())]
    NotVouchedFor {
        /// The file.
        path: PathBuf,
    },
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// An image that cannot be read or written.
    #[error(transparent)]
    Image(#[from] ExrError),
}

fn out_of_range(
    path: &Path,
    key: impl Into<String>,
    value: impl ToString,
    allowed: &str,
) -> FitRecordError {
    FitRecordError::Value {
        path: path.to_path_buf(),
        key: key.into(),
        value: value.to_string(),
        allowed: allowed.to_owned(),
    }
}

/// Ranges and shapes, checked before writing and after reading.
fn check(folder: &Path, record: &FitRecord) -> Result<(), FitRecordError> {
    let toml = folder.join(FIT_FILE);
    let csv = folder.join("weights.csv");
    if !record.loss.is_finite() {
        return Err(out_of_range(&toml, "loss", record.loss, "a finite number"));
    }
    if i64::try_from(record.settings.seed).is_err() {
        let seed = record.settings.seed;
        return Err(out_of_range(&toml, "settings.seed", seed, "0 to 2^63 - 1"));
    }
    for (light, chi2) in record.reduced_chi_square.iter().enumerate() {
        if let Some(bad) = chi2.iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
            let key = format!("reduced_chi_square[{light}]");
            return Err(out_of_range(&toml, key, bad, "0 or more, finite"));
        }
    }
    if let Some((key, value)) = record.bench.as_ref().and_then(BenchRecord::bad_value) {
        let allowed = "a finite number, of deviations 0 or more";
        return Err(out_of_range(&toml, key, value, allowed));
    }
    if let Some((key, value)) = record.budget.as_ref().and_then(BudgetRecord::bad_value) {
        let allowed = "a share per source that sum to 1, and a deviation of 0 or more";
        return Err(out_of_range(&toml, key, value, allowed));
    }
    if let Some(discrepancy) = &record.discrepancy {
        let amplitude = discrepancy.amplitude;
        if !(amplitude.is_finite() && amplitude > 0.0) {
            let allowed = "above 0, finite; 0 without discrepancy.csv";
            return Err(out_of_range(&toml, "discrepancy", amplitude, allowed));
        }
        let csv = folder.join(DISCREPANCY_FILE);
        for (discrepancy, channel) in discrepancy.by_channel.iter().zip(["r", "g", "b"]) {
            let (rows, nodes) = (discrepancy.0.len(), discrepancy::NODES);
            if rows != nodes {
                return Err(out_of_range(
                    &csv,
                    "number of rows",
                    rows,
                    &nodes.to_string(),
                ));
            }
            // What measured materials have stays well within.
            if let Some(bad) = discrepancy.0.iter().find(|g| !(-50.0..=50.0).contains(*g)) {
                return Err(out_of_range(
                    &csv,
                    format!("ln_factor_{channel}"),
                    bad,
                    "-50 to 50",
                ));
            }
        }
    }
    let atoms = record.atoms.len();
    for (row, atom) in record.atoms.iter().enumerate() {
        if atom.index != row {
            return Err(out_of_range(
                &csv,
                "atom",
                atom.index,
                &format!("{row} in this row"),
            ));
        }
    }
    for (channel, name) in ["r", "g", "b"].iter().enumerate() {
        let (weights, deviations) = (&record.weights[channel], &record.weight_deviations[channel]);
        for (key, values) in [("weight", weights), ("sd", deviations)] {
            let key = format!("{key}_{name}");
            if values.len() != atoms {
                let allowed = format!("one value for each of the {atoms} atoms");
                return Err(out_of_range(
                    &csv,
                    key,
                    format!("{} values", values.len()),
                    &allowed,
                ));
            }
            if let Some(bad) = values.iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
                return Err(out_of_range(&csv, key, bad, "0 or more, finite"));
            }
        }
        let sum: f64 = weights.iter().sum();
        if (sum - 1.0).abs() > SUM_TOLERANCE {
            let key = format!("sum of weight_{name}");
            return Err(out_of_range(&csv, key, sum, "1 within 1e-6"));
        }
    }
    record.table.check(&folder.join("table.csv"))
}

#[cfg(test)]
mod tests;
