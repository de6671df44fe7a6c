//! The material of a fit, from the folder that the fit left.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use super::discrepancy::{self, Discrepancy, Material};
use super::{Atom, BrdfError, Dictionary, LARGEST_TEXT_BYTES, Mixture, weights};
use crate::outside_file::read_text;
use crate::outside_table::{self, Row};
use crate::shown::excerpt;

/// Weights and atoms of a fit.
pub const WEIGHTS_FILE: &str = "weights.csv";
/// Its model discrepancy; absent where there is none.
pub const DISCREPANCY_FILE: &str = "discrepancy.csv";
/// Columns of ln of the factor without cos 2φd, of R, G and B.
const LN_FACTOR: [&str; 3] = ["ln_factor_r", "ln_factor_g", "ln_factor_b"];
/// Those by cos 2φd.
const BY_COS_2PHI: [&str; 3] = ["by_cos_2phi_r", "by_cos_2phi_g", "by_cos_2phi_b"];

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
            let by_channel = discrepancies(&csv).map_err(damaged(DISCREPANCY_FILE))?;
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

/// The values at the nodes, which the rows name in order.
fn discrepancies(csv: &str) -> Result<[Discrepancy; 3], String> {
    let (header, rows) = outside_table::with_header(csv)?;
    // Fits of before have a table without φd.
    let earlier = header.column(BY_COS_2PHI[0]).is_none();
    let nodes: Vec<[f64; 2]> = match earlier {
        true => Discrepancy::earlier_nodes().collect(),
        false => discrepancy::nodes()
            .map(|node| [node.theta_h_deg, node.theta_d_deg])
            .collect(),
    };
    let by_azimuth = if earlier { &[][..] } else { &BY_COS_2PHI };
    let names = ["theta_h_deg", "theta_d_deg"].iter().chain(&LN_FACTOR);
    let columns = names
        .chain(by_azimuth)
        .map(|name| header.needed_column(name));
    let columns = columns.collect::<Result<Vec<usize>, _>>()?;
    if rows.len() != nodes.len() {
        let (found, nodes) = (rows.len(), nodes.len());
        return Err(format!(
            "{found} rows, one for each of {nodes} nodes are needed"
        ));
    }
    let mut values = vec![Vec::with_capacity(nodes.len()); columns.len()];
    for (row, node) in rows.iter().zip(&nodes) {
        for (values, column) in values.iter_mut().zip(&columns) {
            let value = outside_table::number(row.field(*column))
                .map_err(|error| format!("line {}: {error}", row.line))?;
            values.push(value);
        }
        let found = [0, 1].map(|k| values[k].last().copied().unwrap_or(f64::NAN));
        if found != *node {
            let ([h, d], line) = (found, row.line);
            return Err(format!(
                "line {line}: {h}, {d} is not the node that belongs there"
            ));
        }
    }
    let by_channel = [2, 3, 4].map(|c| {
        let slopes = values.get(c + 3).map_or(&[][..], Vec::as_slice);
        Discrepancy::from_values(&[&values[c], slopes].concat())
    });
    match by_channel {
        [Some(r), Some(g), Some(b)] => Ok([r, g, b]),
        _ => Err("the nodes are not those of a fit".to_owned()),
    }
}
