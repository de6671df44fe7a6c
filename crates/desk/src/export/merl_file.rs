//! The MERL database's table, with a note in a file of its own.

use std::path::PathBuf;

use super::{Companion, ExportError, Format, Writer, replace, summary};
use crate::brdf::merl;
use crate::session::fit_record::FitRecord;

/// The BRDF at the nodes of the database's 90 × 90 × 180 cells.
pub(super) const FORMAT: Format = Format {
    name: "merl",
    about: "MERL .binary, 90 x 90 x 180 cells, for many renderers",
    ending: "binary",
    companion: Some(Companion::Added("txt")),
    writer: Writer::OfFit(write),
};

fn write(record: &FitRecord, files: &[PathBuf]) -> Result<(), ExportError> {
    let [out, note] = files else {
        unreachable!("two files are made")
    };
    merl::write(out, &*record.material()?)?;
    let text = format!(
        "{}\nBRDF in 1/sr (cosine excluded), R, G, B, in the layout and with the scale factors of the MERL database.\nIntervals are in the fit's table.csv.\n",
        summary(record)
    );
    replace(note, text.as_bytes())
}
