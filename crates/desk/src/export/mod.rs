//! The fitted BRDF in files that other programs read.
//!
//! | format | file | exactness |
//! |---|---|---|
//! | `json` | dictionary, weights, model discrepancy, (θh, θd) table with intervals | exact |
//! | `merl` | MERL `.binary`, 90 × 90 × 180 cells, with a note in a file of its own | the BRDF at the cells' nodes |
//! | `rgl` | RGL `.bsdf` in RGB, for Mitsuba 3's `measured` | at its nodes; see [`rgl`] |
//! | `rgl-spectral` | the same with spectra, for pbrt-v4 and spectral Mitsuba | likewise; the spectra are an assumption |
//! | `mitsuba` | scene fragment for Mitsuba 3 in an RGB variant | the mixture exactly; a model discrepancy is left out |
//! | [`birdf`] | universal BRDF JSON of the European BRDF projects | the constrained cells, with intervals |
//! | `pbrt` | material for pbrt-v4 and the `rgl-spectral` file it refers to | as that file |
//! | `openpbr` | OpenPBR in MaterialX | the nearest of that model, with its loss stated |
//! | `blender` | script for Blender's Principled BSDF | likewise |
//! | `gltf` | sphere in binary glTF | likewise |
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
pub mod mitsuba;
mod model;
pub mod pbrt;
pub mod rgl;
mod spectrum;
mod tensor_file;
mod text;
mod warp;

use std::path::{Path, PathBuf};

use above_horizon::AboveHorizon;
pub use model::{AsModel, LARGEST_ERROR, ModelFormat};

use crate::brdf::{Brdf, BrdfError, merl};
use crate::outside_file::ends_in;
use crate::parametric::FitError;
use crate::session::fit_record::FitRecord;
use crate::{checksum, shown, whole_file};

/// A file format of [`export`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Everything, for programs.
    Json,
    /// The MERL database's `.binary`.
    Merl,
    /// RGL's `.bsdf` in RGB.
    Rgl,
    /// RGL's `.bsdf` with spectra.
    RglSpectral,
    /// A scene fragment for Mitsuba 3.
    Mitsuba,
    /// A material for pbrt-v4, with its `.bsdf`.
    Pbrt,
    /// A material in another program's own model.
    Model(ModelFormat),
}

impl Format {
    /// All formats by their names on the command line, in the console and in Python.
    pub const ALL: [(&str, Self); 9] = [
        ("json", Self::Json),
        ("merl", Self::Merl),
        ("rgl", Self::Rgl),
        ("rgl-spectral", Self::RglSpectral),
        ("mitsuba", Self::Mitsuba),
        ("pbrt", Self::Pbrt),
        ("openpbr", Self::Model(ModelFormat::OpenPbr)),
        ("blender", Self::Model(ModelFormat::Blender)),
        ("gltf", Self::Model(ModelFormat::Gltf)),
    ];

    /// The format of this name.
    pub fn named(name: &str) -> Option<Self> {
        let found = Self::ALL.into_iter().find(|(known, _)| *known == name);
        found.map(|(_, format)| format)
    }

    /// The usual ending of its files.
    pub const fn ending(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Merl => "binary",
            Self::Rgl | Self::RglSpectral => "bsdf",
            Self::Mitsuba => "xml",
            Self::Pbrt => "pbrt",
            Self::Model(format) => format.ending(),
        }
    }

    /// The files that [`export`] makes where `out` was asked for: that first, then what
    /// belongs to it.
    pub fn files(self, out: &Path) -> Vec<PathBuf> {
        let mut files = vec![out.to_owned()];
        match self {
            Self::Merl => files.push(with_ending_added(out, "txt")),
            Self::Pbrt => files.push(out.with_extension("spectral.bsdf")),
            #[cfg(feature = "figures")]
            Self::Model(_) => files.push(with_ending_added(out, "png")),
            _ => {}
        }
        files
    }
}

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
    /// No cell of the table is constrained by the images: nothing was measured.
    #[error("the images constrain no cell of the fit's table: there is no measured value to write")]
    NothingConstrained,
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
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
/// An unusable fit, or the system's error.
pub fn export(record: &FitRecord, format: Format, out: &Path) -> Result<Exported, ExportError> {
    let files = format.files(out);
    match format {
        Format::Json => replace(out, json::to_json(record).as_bytes())?,
        Format::Mitsuba => {
            let note = record.discrepancy.as_ref().map(|discrepancy| {
                format!(
                    "This is the mixture alone. The fitted BRDF differs from it by a model discrepancy, {:.1} times the usual one of measured materials, which RGL and MERL exports include.",
                    discrepancy.amplitude
                )
            });
            let text = mitsuba::to_xml(&record.mixture()?, record.simulated, note.as_deref());
            replace(out, text.as_bytes())?;
        }
        Format::Merl => {
            merl::write(out, &*record.material()?)?;
            replace(&files[1], merl_note(record).as_bytes())?;
        }
        Format::Rgl | Format::RglSpectral => {
            replace(out, &rgl_bytes(record, format == Format::RglSpectral)?)?;
        }
        Format::Pbrt => {
            let bsdf = &files[1];
            replace(bsdf, &rgl_bytes(record, true)?)?;
            let name = bsdf.file_name().unwrap_or_default().to_string_lossy();
            replace(out, pbrt::to_text(&name, record.simulated).as_bytes())?;
        }
        Format::Model(format) => {
            let (material, description) = (record.material()?, summary(record));
            let subject = Subject {
                brdf: &*material,
                description: &description,
                simulated: record.simulated,
                out,
            };
            return subject.export(format);
        }
    }
    Ok(Exported { files, model: None })
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
    /// The file to write; the material has its name.
    pub out: &'a Path,
}

impl Subject<'_> {
    /// Writes the nearest material of a program's model, and next to it the picture that
    /// compares both, `FILE.png`.
    ///
    /// # Errors
    /// A BRDF that no model comes near, or the system's error.
    pub fn export(&self, format: ModelFormat) -> Result<Exported, ExportError> {
        let model = AsModel::of(self.brdf, format)?;
        let bytes = match format {
            ModelFormat::OpenPbr => materialx::to_xml(&model, self).into_bytes(),
            ModelFormat::Blender => blender::to_script(&model, self).into_bytes(),
            ModelFormat::Gltf => gltf::to_glb(&model, self),
        };
        let files = Format::Model(format).files(self.out);
        #[cfg(feature = "figures")]
        replace(&files[1], &comparison::to_png(&model)?)?;
        replace(self.out, &bytes)?;
        Ok(Exported {
            files,
            model: Some(model),
        })
    }

    /// The file's name without its ending, for programs that take any text.
    fn name(&self) -> String {
        let stem = self.out.file_stem().unwrap_or_default().to_string_lossy();
        shown::escaped(&stem).into_owned()
    }

    /// The same of letters, digits and underscores; where that is another name, with a mark
    /// that tells it from those of other files.
    fn identifier(&self) -> String {
        let stem = self.out.file_stem().unwrap_or_default();
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

fn rgl_bytes(record: &FitRecord, spectral: bool) -> Result<Vec<u8>, ExportError> {
    let mut text = summary(record);
    let channels = if spectral {
        text += " Spectra are an assumption: smooth ones whose colour under D65 is the RGB value.";
        rgl::Channels::Spectral
    } else {
        rgl::Channels::Rgb
    };
    Ok(rgl::to_bytes(&*record.material()?, channels, &text))
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

/// A MERL file has no room for text, so this is written next to it.
fn merl_note(record: &FitRecord) -> String {
    format!(
        "{}\nBRDF in 1/sr (cosine excluded), R, G, B, in the layout and with the scale factors of the MERL database.\nIntervals are in the fit's table.csv.\n",
        summary(record)
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
