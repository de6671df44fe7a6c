//! What a fit leaves on disk: `fits/<n>/` of a session, or the folder named by
//! `rig fit --out`. Plain data with its writer and reader; nothing here fits.
//!
//! | file | content |
//! |---|---|
//! | `fit.toml` | dictionary, settings, loss, χ², termination, timings, versions, scores, warnings |
//! | `weights.csv` | one row per atom: what it is, weight and standard deviation per channel |
//! | `table.csv` | f over (θh, θd) with its 95% interval, and which cells the data constrain |
//! | `trace.csv` | the loss after each step |
//! | `rendered_L000.exr` | the images rendered from the fit, mean and variance |
//! | `residual_L000.exr` | (captured − rendered) in standard deviations |
//!
//! [`write`] makes a folder that appears whole or not at all; [`commit`] adds
//! the files to a session, each journalled, `fit.toml` last: a folder without it
//! is no fit.

mod tables;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::brdf::mixture::SUM_TOLERANCE;
use crate::brdf::{Atom, BrdfError, Dictionary, Mixture};
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::{self, ExrError};
use crate::session::layout::FITS_FOLDER;
use crate::session::{SessionError, SessionWriter};

pub use tables::{AngleCell, AngleTable};

/// Version of the folder's layout; a reader refuses any other.
pub const FORMAT: u32 = 1;
const FIT_FILE: &str = "fit.toml";

/// One element of the dictionary.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AtomRecord {
    /// Position in the dictionary, from 0.
    pub index: usize,
    /// `ggx`, `lambertian` or `black`.
    pub kind: String,
    /// GGX width (Walter et al. 2007), where it has one.
    pub alpha: Option<f64>,
    /// Index of refraction relative to air, where it has one.
    pub eta: Option<f64>,
    /// Diffuse albedo, where it has one.
    pub albedo: Option<f64>,
}

impl AtomRecord {
    /// The record of a dictionary's atom.
    pub fn new(index: usize, atom: &Atom) -> Self {
        let (kind, alpha, eta, albedo) = match *atom {
            Atom::Ggx { alpha, eta } => ("ggx", Some(alpha), Some(eta), None),
            Atom::Lambertian { albedo } => ("lambertian", None, None, Some(albedo)),
            Atom::Black => ("black", None, None, None),
        };
        Self {
            index,
            kind: kind.to_owned(),
            alpha,
            eta,
            albedo,
        }
    }

    /// The atom; `None` if a parameter is missing or the kind is not known.
    pub fn atom(&self) -> Option<Atom> {
        match self.kind.as_str() {
            "ggx" => Some(Atom::Ggx {
                alpha: self.alpha?,
                eta: self.eta?,
            }),
            "lambertian" => Some(Atom::Lambertian {
                albedo: self.albedo?,
            }),
            "black" => Some(Atom::Black),
            _ => None,
        }
    }

    /// A short name for tables and plots, such as `GGX α 0.05, η 1.5`.
    pub fn label(&self) -> String {
        match (self.alpha, self.eta, self.albedo) {
            (Some(alpha), Some(eta), _) => {
                format!("{} α {alpha}, η {eta}", self.kind.to_uppercase())
            }
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

/// How the fit was run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitSettings {
    /// `gauss-newton` or `exponentiated-gradient`.
    pub optimizer: String,
    /// Camera paths per pixel.
    pub samples_per_pixel: u64,
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

/// A reason not to trust the fit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// The fact.
    pub what: String,
    /// Its most likely cause.
    pub likely_cause: String,
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
    /// χ² per degree of freedom, per light and channel.
    pub reduced_chi_square: Vec<[f64; 3]>,
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
    /// Reasons not to trust the fit; empty if none were found.
    pub warnings: Vec<Warning>,
}

impl FitRecord {
    /// The fitted BRDF.
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

/// The images of a fit, one of each per light.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitImages {
    /// Rendered from the estimate: mean and variance, unit of the captured images.
    pub rendered: Vec<RadianceImage>,
    /// `mean` holds (captured − rendered) in standard deviations; `variance` is unused.
    pub residual: Vec<RadianceImage>,
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
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// An image that cannot be read or written.
    #[error(transparent)]
    Image(#[from] ExrError),
}

/// The part of the record that is `fit.toml`.
#[derive(Serialize, Deserialize)]
struct FitToml {
    format: u32,
    simulated: bool,
    dictionary: String,
    loss: f64,
    termination: String,
    reduced_chi_square: Vec<[f64; 3]>,
    settings: FitSettings,
    #[serde(default)]
    versions: BTreeMap<String, String>,
    #[serde(default)]
    timing: Vec<Timing>,
    #[serde(default)]
    warning: Vec<Warning>,
    score: Option<ScoreSheet>,
}

/// The fit's files by name, `fit.toml` last.
///
/// # Errors
/// A value out of its range; `folder` is only named in the message.
pub fn encode(
    folder: &Path,
    record: &FitRecord,
    images: &FitImages,
) -> Result<Vec<(String, Vec<u8>)>, FitRecordError> {
    check(folder, record)?;
    let mut files = Vec::new();
    for (kind, series) in [
        ("rendered", &images.rendered),
        ("residual", &images.residual),
    ] {
        for (light, image) in series.iter().enumerate() {
            let name = image_name(kind, light);
            let bytes = exr::encode(image, &folder.join(&name))?;
            files.push((name, bytes));
        }
    }
    for (name, text) in [
        ("weights.csv", tables::weights_to_csv(record)),
        ("table.csv", tables::table_to_csv(&record.table)),
        ("trace.csv", tables::trace_to_csv(&record.trace)),
        (FIT_FILE, to_toml(record)),
    ] {
        files.push((name.to_owned(), text.into_bytes()));
    }
    Ok(files)
}

/// Adds a fit to a session under the next free number and returns its folder.
/// Every file is journalled; `fit.toml`, the last one, makes the fit count.
///
/// # Errors
/// A value out of its range (nothing is written then), or the session's error.
pub fn commit(
    session: &mut SessionWriter,
    record: &FitRecord,
    images: &FitImages,
) -> Result<PathBuf, FitRecordError> {
    let folder = next_folder(session.root());
    let files = encode(&folder, record, images)?;
    let number = folder.file_name().unwrap_or_default().to_string_lossy();
    for (name, bytes) in files {
        session.commit_file(&format!("{FITS_FOLDER}/{number}/{name}"), &bytes)?;
    }
    Ok(folder)
}

/// Writes a fit's folder outside a session. `folder` must not exist, or be
/// empty. It appears whole or not at all.
///
/// # Errors
/// [`FitRecordError::Exists`], a value out of its range (nothing is written
/// then), or the system's error.
pub fn write(folder: &Path, record: &FitRecord, images: &FitImages) -> Result<(), FitRecordError> {
    let files = encode(folder, record, images)?;
    let io = |path: &Path| {
        let path = path.to_path_buf();
        move |source| FitRecordError::Io { path, source }
    };
    let occupied = std::fs::read_dir(folder).is_ok_and(|mut inside| inside.next().is_some());
    if occupied || folder.is_file() {
        return Err(FitRecordError::Exists {
            path: folder.to_path_buf(),
        });
    }
    let parent = match folder.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(parent).map_err(io(parent))?;
    let partial = tempfile::Builder::new()
        .prefix(".fit-partial-")
        .tempdir_in(parent)
        .map_err(io(parent))?;
    for (name, bytes) in files {
        let path = partial.path().join(name);
        let written = File::create(&path).and_then(|mut file| {
            file.write_all(&bytes)?;
            file.sync_all()
        });
        written.map_err(io(&path))?;
    }
    sync_folder(partial.path()).map_err(io(partial.path()))?;
    make_readable(partial.path()).map_err(io(partial.path()))?;
    // An empty folder may be replaced by the rename; a filled one may not.
    std::fs::rename(partial.path(), folder).map_err(io(folder))?;
    let _ = partial.keep(); // Renamed: nothing is left to remove.
    sync_folder(parent).map_err(io(parent))
}

/// A temporary folder is private to its owner; a result is not.
fn make_readable(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755))
}

fn sync_folder(folder: &Path) -> std::io::Result<()> {
    File::open(folder)?.sync_all()
}

fn image_name(kind: &str, light: usize) -> String {
    format!("{kind}_L{light:03}.exr")
}

/// Reads a fit's folder, without its images.
///
/// # Errors
/// Names the file and the key or column that is missing or wrong.
pub fn read(folder: &Path) -> Result<FitRecord, FitRecordError> {
    let text = |name: &str| {
        let path = folder.join(name);
        match std::fs::read_to_string(&path) {
            Ok(text) => Ok((path, text)),
            Err(source) => Err(FitRecordError::Io { path, source }),
        }
    };
    let (toml_path, toml_text) = text(FIT_FILE)?;
    let toml = from_toml(&toml_path, &toml_text)?;
    let (path, csv) = text("weights.csv")?;
    let (atoms, weights, weight_deviations) = tables::weights_from_csv(&path, &csv)?;
    let (path, csv) = text("table.csv")?;
    let table = tables::table_from_csv(&path, &csv)?;
    let (path, csv) = text("trace.csv")?;
    let trace = tables::trace_from_csv(&path, &csv)?;
    let record = FitRecord {
        simulated: toml.simulated,
        dictionary: toml.dictionary,
        atoms,
        weights,
        weight_deviations,
        settings: toml.settings,
        loss: toml.loss,
        reduced_chi_square: toml.reduced_chi_square,
        termination: toml.termination,
        trace,
        timings: toml.timing,
        versions: toml.versions,
        score: toml.score,
        table,
        warnings: toml.warning,
    };
    check(folder, &record)?;
    Ok(record)
}

/// Reads the images of a fit, as many lights as there are files.
///
/// # Errors
/// An image that is there but cannot be read.
pub fn read_images(folder: &Path) -> Result<FitImages, FitRecordError> {
    let series = |kind: &str| {
        (0..)
            .map(|light| folder.join(image_name(kind, light)))
            .take_while(|path| path.exists())
            .map(|path| exr::read(&path).map(|file| file.image))
            .collect::<Result<Vec<_>, _>>()
    };
    Ok(FitImages {
        rendered: series("rendered")?,
        residual: series("residual")?,
    })
}

/// The fits of a session by number, lowest first: its folders `fits/<n>`.
pub fn list(session: &Path) -> Vec<(u32, PathBuf)> {
    let mut found = numbered(session);
    found.retain(|(_, path)| path.join(FIT_FILE).exists());
    found
}

fn numbered(session: &Path) -> Vec<(u32, PathBuf)> {
    let mut found: Vec<_> = std::fs::read_dir(session.join(FITS_FOLDER))
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| Some((entry.file_name().to_str()?.parse().ok()?, entry.path())))
        .collect();
    found.sort();
    found
}

/// The folder for the next fit of a session, one above the highest number in
/// use, finished or not; not yet made.
pub fn next_folder(session: &Path) -> PathBuf {
    let number = numbered(session).last().map_or(0, |(number, _)| number + 1);
    session.join(FITS_FOLDER).join(number.to_string())
}

fn to_toml(record: &FitRecord) -> String {
    let toml = FitToml {
        format: FORMAT,
        simulated: record.simulated,
        dictionary: record.dictionary.clone(),
        loss: record.loss,
        termination: record.termination.clone(),
        reduced_chi_square: record.reduced_chi_square.clone(),
        settings: record.settings.clone(),
        versions: record.versions.clone(),
        timing: record.timings.clone(),
        warning: record.warnings.clone(),
        score: record.score.clone(),
    };
    toml::to_string(&toml).expect("plain data with string keys is always TOML")
}

fn from_toml(path: &Path, text: &str) -> Result<FitToml, FitRecordError> {
    let toml: FitToml = toml::from_str(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start.min(text.len()));
        let before = text.get(..at).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let content = text.lines().nth(line - 1).unwrap_or_default();
        let key = match content.split_once('=') {
            Some((key, _)) => key.trim(),
            None => content.trim(),
        };
        FitRecordError::Syntax {
            path: path.to_path_buf(),
            line,
            key: if key.is_empty() { "document" } else { key }.to_owned(),
            fact: error.message().lines().collect::<Vec<_>>().join(" "),
        }
    })?;
    if toml.format == FORMAT {
        Ok(toml)
    } else {
        Err(out_of_range(
            path,
            "format",
            toml.format,
            &FORMAT.to_string(),
        ))
    }
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
