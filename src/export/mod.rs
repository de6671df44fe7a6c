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
//!
//! Exports of simulated sessions say so inside the file, or in that note
//! where the format has no room.

mod above_horizon;
pub mod birdf;
mod facets;
pub mod json;
pub mod mitsuba;
pub mod pbrt;
pub mod rgl;
mod spectrum;
mod tensor_file;
mod warp;

use std::path::{Path, PathBuf};

use above_horizon::AboveHorizon;

use crate::brdf::{Brdf, BrdfError, merl};
use crate::session::fit_record::FitRecord;
use crate::whole_file;

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
}

impl Format {
    /// The usual ending of its files.
    pub fn ending(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Merl => "binary",
            Self::Rgl | Self::RglSpectral => "bsdf",
            Self::Mitsuba => "xml",
            Self::Pbrt => "pbrt",
        }
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
        match path.extension()?.to_str()? {
            "binary" => Some(Self::Merl),
            "bsdf" => Some(Self::Rgl),
            _ => None,
        }
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

/// Writes the fit as `out` and returns the files made, `out` first. A file of
/// that name is replaced, whole or not at all.
///
/// # Errors
/// An unusable fit, or the system's error.
pub fn export(record: &FitRecord, format: Format, out: &Path) -> Result<Vec<PathBuf>, ExportError> {
    match format {
        Format::Json => {
            let text = json::to_json(record);
            replace(out, text.as_bytes())?;
            Ok(vec![out.to_owned()])
        }
        Format::Mitsuba => {
            let note = record.discrepancy.as_ref().map(|discrepancy| {
                format!(
                    "This is the mixture alone. The fitted BRDF differs from it by a model discrepancy, {:.1} times the usual one of measured materials, which RGL and MERL exports include.",
                    discrepancy.amplitude
                )
            });
            let text = mitsuba::to_xml(&record.mixture()?, record.simulated, note.as_deref());
            replace(out, text.as_bytes())?;
            Ok(vec![out.to_owned()])
        }
        Format::Merl => {
            merl::write(out, &*record.material()?)?;
            let mut name = out.as_os_str().to_owned();
            name.push(".txt");
            let note = PathBuf::from(name);
            replace(&note, merl_note(record).as_bytes())?;
            Ok(vec![out.to_owned(), note])
        }
        Format::Rgl | Format::RglSpectral => {
            replace(out, &rgl_bytes(record, format == Format::RglSpectral)?)?;
            Ok(vec![out.to_owned()])
        }
        Format::Pbrt => {
            let bsdf = out.with_extension("spectral.bsdf");
            replace(&bsdf, &rgl_bytes(record, true)?)?;
            let name = bsdf.file_name().unwrap_or_default().to_string_lossy();
            replace(out, pbrt::to_text(&name, record.simulated).as_bytes())?;
            Ok(vec![out.to_owned(), bsdf])
        }
    }
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
        record.dictionary,
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
