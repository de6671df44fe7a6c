//! The model discrepancy as a table of comma-separated values, `discrepancy.csv` of a fit: a row
//! for each node with its angles, ln of the factor without cos 2φd and by it.

use super::{Discrepancy, nodes};
use crate::outside_table;

const ANGLES: [&str; 2] = ["theta_h_deg", "theta_d_deg"];
/// ln of the factor without cos 2φd, of R, G and B.
const LN_FACTOR: [&str; 3] = ["ln_factor_r", "ln_factor_g", "ln_factor_b"];
/// Its part by cos 2φd; tables of fits of before have none, and fewer nodes.
const BY_COS_2PHI: [&str; 3] = ["by_cos_2phi_r", "by_cos_2phi_g", "by_cos_2phi_b"];

/// The table of R, G and B; numbers are written so that they are read back exactly.
pub fn text(by_channel: &[Discrepancy; 3]) -> String {
    let header = [&ANGLES[..], &LN_FACTOR, &BY_COS_2PHI].concat().join(",");
    let rows = nodes().enumerate().map(|(k, node)| {
        let parts = [0, 1].map(|part| by_channel.each_ref().map(|d| d.at_node(k)[part]));
        let angles = [node.theta_h_deg, node.theta_d_deg];
        let numbers = angles.iter().chain(parts.as_flattened());
        let fields: Vec<String> = numbers.map(|number| format!("{number:?}")).collect();
        fields.join(",")
    });
    let lines = std::iter::once(header).chain(rows);
    lines.map(|line| line + "\n").collect()
}

/// Reads a table, whose rows name the nodes in order.
///
/// # Errors
/// In words, with line and column: a column that is not there, a row that is no node's, a field
/// that is no number.
pub fn parse(csv: &str) -> Result<[Discrepancy; 3], String> {
    let (header, rows) = outside_table::with_header(csv)?;
    let earlier = header.column(BY_COS_2PHI[0]).is_none();
    let (nodes, by_azimuth): (Vec<[f64; 2]>, _) = match earlier {
        true => (Discrepancy::earlier_nodes().collect(), &[][..]),
        false => {
            let nodes = nodes().map(|node| [node.theta_h_deg, node.theta_d_deg]);
            (nodes.collect(), &BY_COS_2PHI[..])
        }
    };
    let names = [&ANGLES[..], &LN_FACTOR, by_azimuth].concat();
    let columns = names.iter().map(|name| header.needed_column(name));
    let columns = columns.collect::<Result<Vec<usize>, _>>()?;
    if rows.len() != nodes.len() {
        let (found, nodes) = (rows.len(), nodes.len());
        return Err(format!(
            "{found} rows, one for each of {nodes} nodes are needed"
        ));
    }
    let mut values = vec![Vec::with_capacity(nodes.len()); columns.len()];
    for (row, node) in rows.iter().zip(&nodes) {
        let line = row.line;
        for ((values, column), name) in values.iter_mut().zip(&columns).zip(&names) {
            let value = outside_table::number(row.field(*column))
                .map_err(|error| format!("line {line}: {name}: {error}"))?;
            values.push(value);
        }
        let found = [0, 1].map(|k| values[k].last().copied().unwrap_or(f64::NAN));
        if found != *node {
            let [names, found, wanted] = [
                ANGLES.map(str::to_owned),
                found.map(|a| a.to_string()),
                node.map(|a| a.to_string()),
            ]
            .map(|pair| pair.join(", "));
            return Err(format!(
                "line {line}: {names}: {found} where {wanted} belong"
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
