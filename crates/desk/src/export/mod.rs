//! The fitted BRDF in files that other programs read.
//!
//! A format is one file here, which states it in its `FORMAT`, and its place in [`FORMATS`];
//! the command line, the console and Python read that list.
//!
//! Exports of simulated sessions say so inside the file, or in that note
//! where the format has no room.

mod above_horizon;
pub mod birdf;
pub mod blender;
#[cfg(feature = "figures")]
mod comparison;
mod facets;
pub mod gltf;
pub mod json;
pub mod materialx;
mod merl_file;
pub mod mitsuba;
mod model;
pub mod pbrt;
pub mod rgl;
mod spectrum;
mod tensor_file;
mod text;
mod warp;

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use above_horizon::AboveHorizon;
pub use model::{AsModel, LARGEST_ERROR, ModelFormat};

use crate::brdf::{Brdf, BrdfError, merl};
use crate::outside_file::ends_in;
use crate::parametric::FitError;
use crate::progress::Progress;
use crate::session::fit_record::FitRecord;
use crate::workflow::StatedResult;
use crate::{checksum, shown, whole_file};

/// A file format.
#[derive(Clone, Copy, Debug)]
pub struct Format {
    /// Its name on the command line, in the console and in Python.
    pub name: &'static str,
    /// What it writes, in a phrase.
    pub about: &'static str,
    /// The usual ending of its files.
    pub ending: &'static str,
    /// The file that it makes next to the one asked for.
    companion: Option<Companion>,
    writer: Writer,
}

/// The name of a second file.
#[derive(Clone, Copy, Debug)]
enum Companion {
    /// `a.b.ENDING` next to `a.b`.
    Added(&'static str),
    /// `a.ENDING` next to `a.b`.
    Instead(&'static str),
}

/// What a format is made of.
#[derive(Clone, Copy, Debug)]
enum Writer {
    /// Any fit, into [`Format::files`].
    OfFit(fn(&FitRecord, &[PathBuf]) -> Result<(), ExportError>),
    /// Any material, as the nearest of a program's own model.
    AsModel(ModelFormat),
    /// A fitted session: it also states what was measured, and by whom.
    OfSession(fn(&StatedResult, &Path) -> Result<(), ExportError>),
}

/// All formats.
pub const FORMATS: &[Format] = &[
    json::FORMAT,
    merl_file::FORMAT,
    rgl::FORMAT,
    rgl::SPECTRAL_FORMAT,
    mitsuba::FORMAT,
    pbrt::FORMAT,
    materialx::FORMAT,
    blender::FORMAT,
    gltf::FORMAT,
    birdf::FORMAT,
];

impl ModelFormat {
    /// Its row among the formats.
    pub const fn format(self) -> Format {
        match self {
            Self::OpenPbr => materialx::FORMAT,
            Self::Blender => blender::FORMAT,
            Self::Gltf => gltf::FORMAT,
        }
    }
}

impl Format {
    /// The format of this name.
    pub fn named(name: &str) -> Option<Self> {
        FORMATS.iter().copied().find(|format| format.name == name)
    }

    /// Whether [`export`] writes it; [`export_session`] writes all.
    pub fn needs_no_session(&self) -> bool {
        !matches!(self.writer, Writer::OfSession(_))
    }

    /// What its file of a sample is usually called. Formats that others read as JSON say which
    /// they are, so that `json` of the same sample stays.
    pub fn usual_name(&self, sample: &str) -> String {
        match self.writer {
            Writer::OfSession(_) => format!("{sample}.{}.{}", self.name, self.ending),
            _ => format!("{sample}.{}", self.ending),
        }
    }

    /// The files that are made where `out` was asked for: that first, then what belongs to it.
    pub fn files(&self, out: &Path) -> Vec<PathBuf> {
        let companion = match self.companion {
            Some(Companion::Added(ending)) => Some(with_ending_added(out, ending)),
            Some(Companion::Instead(ending)) => Some(out.with_extension(ending)),
            None => None,
        };
        [out.to_owned()].into_iter().chain(companion).collect()
    }
}

/// The picture beside a material of another program's model.
const PICTURE: Option<Companion> = if cfg!(feature = "figures") {
    Some(Companion::Added("png"))
} else {
    None
};

/// A file format of [`table`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableFormat {
    /// The MERL database's `.binary`, 90 × 90 × 180 cells.
    Merl,
    /// RGL's `.bsdf` in RGB.
    Rgl,
}

impl TableFormat {
    /// The format that a file's ending stands for.
    pub fn of(path: &Path) -> Option<Self> {
        let known = [("binary", Self::Merl), ("bsdf", Self::Rgl)];
        let found = known.into_iter().find(|(ending, _)| ends_in(path, ending));
        found.map(|(_, format)| format)
    }
}

/// Writes any BRDF, called `name`, as a table. A file of the name `out` is replaced, whole or
/// not at all. Of an RGL file (by its name), MERL's nodes within 1.1° of the horizon take the
/// values there.
///
/// # Errors
/// The system's error.
pub fn table(
    brdf: &dyn Brdf,
    name: &str,
    format: TableFormat,
    out: &Path,
) -> Result<(), ExportError> {
    match format {
        TableFormat::Merl if TableFormat::of(Path::new(name)) == Some(TableFormat::Rgl) => {
            Ok(merl::write(out, &AboveHorizon(brdf))?)
        }
        TableFormat::Merl => Ok(merl::write(out, brdf)?),
        TableFormat::Rgl => {
            let description = format!("{name}, by rig {}", env!("CARGO_PKG_VERSION"));
            replace(out, &rgl::to_bytes(brdf, rgl::Channels::Rgb, &description))
        }
    }
}

/// Why nothing was exported.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ExportError {
    /// The fit's atoms make no BRDF, or the table could not be written.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// No model comes near.
    #[error("nothing to export: {0}")]
    Model(#[from] FitError),
    /// The picture.
    #[cfg(feature = "figures")]
    #[error(transparent)]
    Picture(#[from] crate::plot::PlotError),
    #[error("the images constrain no cell of the fit's table: there is no measured value to write")]
    NothingConstrained,
    /// The format states more than a fit knows.
    #[error("format {format} needs the session of the fit")]
    NeedsSession { format: &'static str },
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
}

/// The note in exports of simulated sessions.
pub const SIMULATED_NOTE: &str =
    "SIMULATED: made from images of a simulated bench; no physical sample was measured";

/// What an export left.
#[derive(Debug)]
pub struct Exported {
    /// The files made, the one asked for first.
    pub files: Vec<PathBuf>,
    /// How a program's own model holds the material, where that is the format.
    pub model: Option<AsModel>,
}

/// Writes the fit as `out`. A file of that name is replaced, whole or not at all.
///
/// # Errors
/// An unusable fit, a format that needs the fit's session, or the system's error.
pub fn export(record: &FitRecord, format: &Format, out: &Path) -> Result<Exported, ExportError> {
    export_as(record, None, false, &(), format, out)
}

/// [`export`] with what matters in files of other programs' models, as [`Subject`] has it: the
/// material's name and whether the closest is sought.
///
/// # Errors
/// As there.
pub fn export_as(
    record: &FitRecord,
    name: Option<&str>,
    closest: bool,
    progress: &dyn Progress,
    format: &Format,
    out: &Path,
) -> Result<Exported, ExportError> {
    let files = format.files(out);
    match format.writer {
        Writer::OfFit(write) => write(record, &files)?,
        Writer::AsModel(model) => {
            let (material, description) = (record.material()?, summary(record));
            let subject = Subject {
                brdf: &*material,
                description: &description,
                simulated: record.simulated,
                name,
                closest,
                progress,
                out,
            };
            return subject.export(model);
        }
        Writer::OfSession(_) => {
            return Err(ExportError::NeedsSession {
                format: format.name,
            });
        }
    }
    Ok(Exported { files, model: None })
}

/// Writes the fit of a session as `out`, as [`export`] does, in any format.
///
/// # Errors
/// As there.
pub fn export_session(
    result: &StatedResult,
    format: &Format,
    out: &Path,
) -> Result<Exported, ExportError> {
    match format.writer {
        Writer::OfSession(write) => {
            write(result, out)?;
            Ok(Exported {
                files: format.files(out),
                model: None,
            })
        }
        _ => export(&result.record, format, out),
    }
}

/// A material that becomes another program's.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// The material.
    pub brdf: &'a dyn Brdf,
    /// Where it comes from, in a sentence that the file will hold.
    pub description: &'a str,
    /// Whether it was measured on a simulated bench.
    pub simulated: bool,
    /// What the material is called; if `None` as the file without its ending.
    pub name: Option<&'a str>,
    /// Whether layers and tints that gain little are kept.
    pub closest: bool,
    /// Shows how far the search for the nearest is.
    pub progress: &'a dyn Progress,
    /// The file to write.
    pub out: &'a Path,
}

impl Subject<'_> {
    /// Writes the nearest material of a program's model, and next to it the picture that
    /// compares both, `FILE.png`.
    ///
    /// # Errors
    /// A BRDF that no model comes near, or the system's error.
    pub fn export(&self, format: ModelFormat) -> Result<Exported, ExportError> {
        let model = AsModel::of(self.brdf, format, self.closest, self.progress)?;
        let bytes = match format {
            ModelFormat::OpenPbr => materialx::to_xml(&model, self).into_bytes(),
            ModelFormat::Blender => blender::to_script(&model, self).into_bytes(),
            ModelFormat::Gltf => gltf::to_glb(&model, self),
        };
        let files = format.format().files(self.out);
        #[cfg(feature = "figures")]
        replace(&files[1], &comparison::to_png(&model)?)?;
        replace(self.out, &bytes)?;
        Ok(Exported {
            files,
            model: Some(model),
        })
    }

    fn called(&self) -> &OsStr {
        let of_file = || self.out.file_stem().unwrap_or_default();
        self.name.map_or_else(of_file, OsStr::new)
    }

    /// The material's name, for programs that take any text.
    fn name(&self) -> String {
        shown::escaped(&self.called().to_string_lossy()).into_owned()
    }

    /// The same of letters, digits and underscores; where that is another name, with a mark
    /// that tells it from others.
    fn identifier(&self) -> String {
        let stem = self.called();
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        let mut name: String = stem.to_string_lossy().chars().map(plain).collect();
        if !name.starts_with(|first: char| first.is_ascii_alphabetic()) {
            name.insert_str(0, "material_");
        }
        if stem != name.as_str() {
            let mark = checksum::sha256_hex(stem.as_encoded_bytes());
            name = format!("{name}_{}", &mark[..8]);
        }
        name
    }

    /// What the file says of itself: where it comes from, and what it lost.
    fn lines(&self, model: &AsModel) -> Vec<String> {
        let mut lines = vec![shown::line(self.description)];
        lines.extend(model.statements());
        lines
    }
}

/// `a.b` with `c` gives `a.b.c`.
fn with_ending_added(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    PathBuf::from(name)
}

/// Where the values come from, in two sentences; formats that hold text hold this.
fn summary(record: &FitRecord) -> String {
    let share = record.table.constrained_share() * 100.0;
    let note = if record.simulated {
        format!("{SIMULATED_NOTE}. ")
    } else {
        String::new()
    };
    let discrepancy = match record.discrepancy {
        Some(_) => ", with a model discrepancy",
        None => "",
    };
    note + &format!(
        "Mixture of the dictionary {}{discrepancy}, rig {}: the images constrain {share:.0}% of the (half angle, difference angle) cells, and the other values are the dictionary's.",
        shown::line(&record.dictionary),
        env!("CARGO_PKG_VERSION"),
    )
}

fn replace(path: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    whole_file::replace(path, |out| out.write_all(bytes)).map_err(|source| ExportError::Io {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests;
