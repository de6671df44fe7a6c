//! What a fit leaves on disk: `fits/<n>/` of a session, or the folder named by
//! `rig fit --out`. Plain data with its writer and reader; nothing here fits.
//!
//! | file | content |
//! |---|---|
//! | `fit.toml` | verdict, dictionary, settings, loss, χ², termination, timings, versions, scores, warnings, remarks, the bench as refined |
//! | `weights.csv` | one row per atom: what it is, weight and standard deviation per channel |
//! | `discrepancy.csv` | the model discrepancy: ln of f over the mixture's, over (θh, θd); only where the images give evidence of one |
//! | `posterior.npy` | posterior samples: 32 rows of weights and discrepancies per channel; fits of earlier versions lack it |
//! | `table.csv` | f over (θh, θd) with its 95% interval, and which cells the data constrain |
//! | `trace.csv` | the loss after each step |
//! | `rendered_L000.exr` | the images rendered from the fit, mean and variance |
//! | `residual_L000.exr` | (captured − rendered) in standard deviations |
//!
//! [`write()`] makes a folder that appears whole or not at all; [`commit`] adds
//! the files to a session, each journalled, `fit.toml` last: a folder without it
//! is no fit.

mod budget;
pub mod coverage;
#[doc(hidden)]
pub mod example;
mod find;
mod folder;
pub mod lookup;
mod posterior;
mod refined;
mod tables;
mod verdict;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::brdf::discrepancy::{self, Discrepancy, Material};
use crate::brdf::fitted::{DISCREPANCY_FILE, WEIGHTS_FILE};
use crate::brdf::mixture::SUM_TOLERANCE;
use crate::brdf::{Atom, Brdf, BrdfError, Dictionary, Mixture};
use crate::config::fit::FitRequest;
use crate::inverse::comparison::Comparison;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::ExrError;
use crate::session::SessionError;

pub use crate::inverse::intervals::Interval;
pub use crate::scores::{ChannelScore, MetricScores, ScoreSheet};
pub use budget::{BudgetRecord, BudgetRow};
pub use find::{find, find_in_session};
pub use folder::parse;
pub use folder::{
    check_folder, commit, decode, encode, next_folder, numbers_in, read, read_images,
    read_images_in, read_in, write,
};
pub(in crate::session) use folder::{commit_numbered, numbers_of, write_files};
pub use posterior::PosteriorRecord;
pub use refined::{BenchParameter, BenchRecord};
pub use tables::AngleTable;
pub use verdict::{EXPLAINED_CHI_SQUARE, Grade, UNEXPLAINED_CHI_SQUARE, Verdict, Warning};

/// The record itself, written last: a folder without it holds no fit.
pub const FIT_FILE: &str = "fit.toml";
/// Posterior samples of a fit.
pub const POSTERIOR_FILE: &str = "posterior.npy";

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
    /// Camera paths per cell as requested: more than were traced where memory did not suffice.
    /// Optional, as is everything below that may be `None` or empty.
    pub samples_requested: Option<u64>,
    /// Whether paths were traced again in the directions in which the first fit's material
    /// reflects.
    pub adapted_paths: Option<bool>,
    /// The options that fits of all versions do not have, with their defaults: channels, model
    /// error, mask, memory (that cached paths might take, where none was stated) and job.
    #[serde(flatten)]
    pub asked: FitRequest,
    /// Session, as it was named; none for a fit in its session, and for a scene file.
    pub session: Option<String>,
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

/// How the material differs from the mixture of the weights (docs/adr/0032).
#[derive(Clone, Debug, PartialEq)]
pub struct DiscrepancyRecord {
    /// Size of its discrepancy from every mixture, in units of that of measured materials; above 0.
    pub amplitude: f64,
    /// In R, G and B.
    pub by_channel: [Discrepancy; 3],
}

/// Everything that a fit leaves, but its images. Serialised, it is `fit.toml` without its format
/// and verdict: what is in tables of its own is left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct FitRecord {
    /// The images come from a simulated bench.
    #[serde(skip_serializing)]
    pub simulated: bool,
    pub dictionary: String,
    /// Final value of the objective, dimensionless.
    pub loss: f64,
    /// Why the optimiser stopped, in words.
    pub termination: String,
    /// What to know of how the fit was made that is neither for nor against it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// χ² per degree of freedom, per light and channel; isolated outliers count in it as they
    /// did in the fit.
    pub reduced_chi_square: Vec<[f64; 3]>,
    /// Light of paths longer than the longest that was followed, over all light, per light;
    /// empty where it was not estimated.
    #[serde(default)]
    pub truncation_remainder: Vec<f64>,
    /// Outlier fraction: part of the compared values that counted for less, per light.
    #[serde(default)]
    pub outlier_fraction: Vec<f64>,
    /// Model discrepancy: how the material differs from the mixture of the weights; `None`
    /// where the images give no evidence of any.
    #[serde(default, with = "amplitude")]
    pub discrepancy: Option<DiscrepancyRecord>,
    /// Posterior samples; `None` where none were drawn, and in fits of earlier versions.
    #[serde(
        default,
        rename = "posterior_samples",
        skip_serializing_if = "Option::is_none",
        with = "count"
    )]
    pub posterior: Option<PosteriorRecord>,
    pub settings: FitSettings,
    /// Versions of the program and of what it ran on, by name.
    #[serde(default)]
    pub versions: BTreeMap<String, String>,
    /// Wall time by stage.
    #[serde(default, rename = "timing")]
    pub timings: Vec<Timing>,
    /// Reasons not to trust the fit, or not in everything, the gravest first; empty if none
    /// were found.
    #[serde(default, rename = "warning")]
    pub warnings: Vec<Warning>,
    /// The fit compared with the truth; `None` where no truth is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub score: Option<ScoreSheet>,
    /// The nuisance parameters as refined; `None` where the bench was taken as exactly known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchRecord>,
    /// Where the interval comes from; `None` without posterior samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget: Option<BudgetRecord>,
    /// Its N atoms, in order.
    #[serde(skip)]
    pub atoms: Vec<AtomRecord>,
    /// Per channel R, G, B: N weights, each ≥ 0, that sum to 1. Not identifiable
    /// one by one: different weights can give the same BRDF.
    #[serde(skip)]
    pub weights: [Vec<f64>; 3],
    /// Standard deviation of each weight, same shape.
    #[serde(skip)]
    pub weight_deviations: [Vec<f64>; 3],
    /// The optimiser's steps.
    #[serde(skip)]
    pub trace: Vec<TracePoint>,
    /// The BRDF with its interval over (θh, θd).
    #[serde(skip)]
    pub table: AngleTable,
}

/// A discrepancy as `fit.toml` has it: its amplitude, 0 for none. Its table is a file.
mod amplitude {
    use serde::{Deserialize, Deserializer, Serializer};

    use super::{Discrepancy, DiscrepancyRecord};

    pub fn serialize<S: Serializer>(
        discrepancy: &Option<DiscrepancyRecord>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(discrepancy.as_ref().map_or(0.0, |d| d.amplitude))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<DiscrepancyRecord>, D::Error> {
        let amplitude = f64::deserialize(deserializer)?;
        Ok((amplitude != 0.0).then(|| DiscrepancyRecord {
            amplitude,
            by_channel: std::array::from_fn(|_| Discrepancy(Default::default())),
        }))
    }
}

/// Posterior samples as `fit.toml` has them: their number. Their values are a file.
mod count {
    use serde::{Deserialize, Deserializer, Serializer};

    use super::PosteriorRecord;

    pub fn serialize<S: Serializer>(
        posterior: &Option<PosteriorRecord>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_u64(posterior.as_ref().map_or(0, |p| p.samples.len() as u64))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<PosteriorRecord>, D::Error> {
        let count = u32::deserialize(deserializer)?;
        Ok((count != 0).then(PosteriorRecord::default))
    }
}

impl FitRecord {
    /// Of a mixture of which nothing else is known.
    pub fn of_mixture(mixture: &Mixture) -> Self {
        let dictionary = mixture.dictionary();
        let atoms = dictionary.atoms().iter().enumerate();
        Self {
            simulated: false,
            dictionary: dictionary.name().to_owned(),
            atoms: atoms.map(|(i, atom)| AtomRecord::new(i, atom)).collect(),
            weights: mixture.weights().clone(),
            weight_deviations: [(); 3].map(|()| vec![0.0; dictionary.len()]),
            settings: FitSettings::default(),
            loss: 0.0,
            reduced_chi_square: Vec::new(),
            truncation_remainder: Vec::new(),
            outlier_fraction: Vec::new(),
            discrepancy: None,
            posterior: None,
            termination: String::new(),
            trace: Vec::new(),
            timings: Vec::new(),
            versions: BTreeMap::new(),
            score: None,
            table: AngleTable::default(),
            warnings: Vec::new(),
            remarks: Vec::new(),
            bench: None,
            budget: None,
        }
    }

    /// The fitted BRDF.
    ///
    /// # Errors
    /// As of [`FitRecord::mixture`].
    pub fn material(&self) -> Result<Arc<dyn Brdf>, BrdfError> {
        let fitted = self.fitted()?;
        Ok(match &self.discrepancy {
            None => Arc::new(fitted.mixture),
            Some(_) => Arc::new(fitted),
        })
    }

    /// The same as its mixture and the discrepancy from it.
    ///
    /// # Errors
    /// As of [`FitRecord::mixture`].
    pub fn fitted(&self) -> Result<Material, BrdfError> {
        let mixture = self.mixture()?;
        Ok(match &self.discrepancy {
            None => mixture.into(),
            Some(discrepancy) => Material::new(mixture, &discrepancy.by_channel),
        })
    }

    /// The mixture of the weights: the closest one where the fitted BRDF differs from all.
    ///
    /// # Errors
    /// Atoms that the program doesn't know or whose parameters are out of range.
    pub fn mixture(&self) -> Result<Mixture, BrdfError> {
        Mixture::new(self.dictionary()?, self.weights.clone())
    }

    fn dictionary(&self) -> Result<Arc<Dictionary>, BrdfError> {
        let atoms: Option<Vec<Atom>> = self.atoms.iter().map(AtomRecord::atom).collect();
        let atoms = atoms.ok_or_else(|| BrdfError::Dictionary {
            name: self.dictionary.clone(),
            fact: "an atom is of an unknown kind or lacks a parameter".to_owned(),
        })?;
        let dictionary = Dictionary::new(self.dictionary.clone(), atoms)?;
        Ok(Arc::new(dictionary))
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

impl From<&Comparison> for FitImages {
    fn from(comparison: &Comparison) -> Self {
        Self {
            rendered: comparison.rendered(),
            residual: comparison.residual(),
            cells_csv: comparison.to_csv(),
        }
    }
}

/// What can be wrong with a fit's folder; facts only.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum FitRecordError {
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    /// The folder is there already and not empty.
    #[error("{} exists and is not empty", path.display())]
    Exists { path: PathBuf },
    #[error("{} holds no fit (no fit.toml, no fits/)", folder.display())]
    NoFit { folder: PathBuf },
    /// A text file that does not parse.
    #[error("{}, line {line}: {key}: {fact}", path.display())]
    Syntax {
        path: PathBuf,
        /// From 1.
        line: usize,
        key: String,
        fact: String,
    },
    /// A table that does not parse, with line and column.
    #[error("{}: {fact}", path.display())]
    Table { path: PathBuf, fact: String },
    /// A value out of its range.
    #[error("{}: {key} is {value}, allowed is {allowed}", path.display())]
    Value {
        path: PathBuf,
        key: String,
        value: String,
        allowed: String,
    },
    /// A file in a session that no journal record names.
    #[error("{} is not in the session's journal", path.display())]
    NotVouchedFor { path: PathBuf },
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// An image that cannot be read or written.
    #[error(transparent)]
    Image(#[from] ExrError),
}

pub(in crate::session) fn out_of_range(
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
    let csv = folder.join(WEIGHTS_FILE);

    // fit.toml.
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

    if let Some(posterior) = &record.posterior {
        posterior.check(&folder.join(POSTERIOR_FILE), record.atoms.len())?;
    }

    // The model discrepancy and its table.
    if let Some(discrepancy) = &record.discrepancy {
        let amplitude = discrepancy.amplitude;
        if !(amplitude.is_finite() && amplitude > 0.0) {
            let allowed = "above 0, finite; 0 without discrepancy.csv";
            return Err(out_of_range(&toml, "discrepancy", amplitude, allowed));
        }
        let csv = folder.join(DISCREPANCY_FILE);
        for (discrepancy, channel) in discrepancy.by_channel.iter().zip(["r", "g", "b"]) {
            let (rows, nodes) = (discrepancy.0.len() / 2, discrepancy::NODES);
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

    // Atoms and weights.
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
