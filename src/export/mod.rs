//! The fitted BRDF in files that other programs read.
//!
//! | format | file | exactness |
//! |---|---|---|
//! | `json` | dictionary, weights, (θh, θd) table with intervals | exact |
//! | `merl` | MERL `.binary`, 90 × 90 × 180 cells, with a note beside it | the BRDF at the cells' nodes |
//! | `mitsuba` | scene fragment for Mitsuba 3 in an RGB variant | exact |
//!
//! There is no pbrt-v4 format: its `mix` material takes one amount for all
//! channels, its `conductor` has no factor per channel, and its `measured`
//! reads spectral files, so that nothing would be exact; load the MERL table
//! with a converter instead.
//!
//! Exports of simulated sessions say so inside the file, or in the note beside
//! it where the format has no room.

pub mod json;
pub mod mitsuba;

use std::path::{Path, PathBuf};

use crate::brdf::{BrdfError, merl};
use crate::session::fit_record::FitRecord;
use crate::whole_file;

/// A file format of [`export`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Everything, for programs.
    Json,
    /// The MERL database's `.binary`.
    Merl,
    /// A scene fragment for Mitsuba 3.
    Mitsuba,
}

/// Why nothing was exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The fit's atoms make no BRDF, or the table could not be written.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

/// What an export of a simulated session says.
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
            let text = mitsuba::to_xml(&record.mixture()?, record.simulated);
            replace(out, text.as_bytes())?;
            Ok(vec![out.to_owned()])
        }
        Format::Merl => {
            merl::write(out, &record.mixture()?)?;
            let mut name = out.as_os_str().to_owned();
            name.push(".txt");
            let note = PathBuf::from(name);
            replace(&note, merl_note(record).as_bytes())?;
            Ok(vec![out.to_owned(), note])
        }
    }
}

/// A MERL file has no room for text, so this stands beside it.
fn merl_note(record: &FitRecord) -> String {
    let share = record.table.constrained_share() * 100.0;
    let mut note = String::new();
    if record.simulated {
        note = format!("{SIMULATED_NOTE}.\n");
    }
    note + &format!(
        "BRDF in 1/sr (cosine excluded), R, G, B, in the layout and with the scale factors of the MERL database.\n\
         A mixture of the dictionary {}; the images constrain {share:.0}% of the (half angle, difference angle) cells,\n\
         and the other values are the dictionary's. Intervals are in the fit's table.csv.\n\
         rig {}\n",
        record.dictionary,
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
