//! The material of a fit, from the folder that the fit left.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use super::discrepancy::{self, Material};
use super::{Atom, BrdfError, Dictionary, LARGEST_TEXT_BYTES, Mixture, weights};
use crate::outside_file::read_text;
use crate::outside_table::{self, Row};
use crate::shown::excerpt;

/// Weights and atoms of a fit.
pub const WEIGHTS_FILE: &str = "weights.csv";
/// Its model discrepancy; absent where there is none.
pub const DISCREPANCY_FILE: &str = "discrepancy.csv";

/// Names of the files that [`read`] reads of this folder of a fit.
pub fn files(folder: &Path) -> Vec<&'static str> {
    let has_discrepancy = folder.join(DISCREPANCY_FILE).try_exists().unwrap_or(true);
    match has_discrepancy {
        true => vec![WEIGHTS_FILE, DISCREPANCY_FILE],
        false => vec![WEIGHTS_FILE],
    }
}

/// Reads the material of a fit's folder: the mixture of `weights.csv`, whose atoms are those of
/// the file, with the model discrepancy of `discrepancy.csv` where that is there.
///
/// # Errors
/// No such file, or one that is no such table.
pub fn read(folder: &Path) -> Result<Material, BrdfError> {
    let text = |name: &str| {
        let path = folder.join(name);
        read_text(&path, LARGEST_TEXT_BYTES).map_err(|source| BrdfError::Io { path, source })
    };
    let damaged = |name: &str| {
        let path = folder.join(name);
        move |fact: String| BrdfError::File { path, fact }
    };
    let csv = text(WEIGHTS_FILE)?;
    let wrong = damaged(WEIGHTS_FILE);
    let read = atoms(&csv).and_then(|atoms| {
        let name = folder.display().to_string();
        let dictionary = Dictionary::new(name, atoms).map_err(|error| error.to_string())?;
        let weights = weights::parse(&csv, &dictionary)?;
        Mixture::new(Arc::new(dictionary), weights).map_err(|error| error.to_string())
    });
    let mixture = read.map_err(wrong)?;
    match text(DISCREPANCY_FILE) {
        Ok(csv) => {
            let by_channel = discrepancy::table::parse(&csv).map_err(damaged(DISCREPANCY_FILE))?;
            Ok(Material::new(mixture, &by_channel))
        }
        Err(BrdfError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {
            Ok(mixture.into())
        }
        Err(error) => Err(error),
    }
}

/// The atoms that the rows name, in their order.
fn atoms(csv: &str) -> Result<Vec<Atom>, String> {
    let (header, rows) = outside_table::with_header(csv)?;
    let kind = header.needed_column("kind")?;
    let parameters = ["alpha", "eta", "albedo"].map(|name| header.column(name));
    let atom = |row: &Row| {
        let kind = row.field(kind);
        let [alpha, eta, albedo] =
            parameters.map(|column| outside_table::number(row.field(column?)).ok());
        Atom::from_parts(kind, alpha, eta, albedo).ok_or_else(|| {
            let (line, kind) = (row.line, excerpt(kind));
            format!("line {line}: {kind} with these parameters is no atom")
        })
    };
    rows.iter().map(atom).collect()
}
