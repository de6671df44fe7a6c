//! The fit's CSV files: weights, the (θh, θd) table, the trace.

use std::fmt::Write;
use std::path::Path;

use nalgebra::DVector;

use super::{AtomRecord, FitRecord, FitRecordError, TracePoint, out_of_range};
use crate::brdf::discrepancy::{self, Discrepancy};
use crate::shown::excerpt;

/// f over a grid of half and difference angles (Rusinkiewicz), at φd = 90°:
/// there both cosines equal cos θh · cos θd, so that every cell exists.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AngleTable {
    /// Half angles, degrees in 0..=90, strictly increasing.
    pub theta_h_deg: Vec<f64>,
    /// Difference angles, degrees in 0..=90, strictly increasing.
    pub theta_d_deg: Vec<f64>,
    /// `theta_h_deg.len() * theta_d_deg.len()` cells, θd fastest.
    pub cells: Vec<AngleCell>,
}

/// One cell of an [`AngleTable`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleCell {
    /// The estimate per channel, 1/sr.
    pub value: [f64; 3],
    /// Lower end of its 95% interval, 1/sr.
    pub lower: [f64; 3],
    /// Upper end of its 95% interval, 1/sr.
    pub upper: [f64; 3],
    /// Whether the images say anything about this cell.
    pub constrained: bool,
}

impl AngleTable {
    /// The cell of the i-th half angle and the j-th difference angle.
    pub fn cell(&self, i: usize, j: usize) -> Option<&AngleCell> {
        if j < self.theta_d_deg.len() {
            self.cells.get(i * self.theta_d_deg.len() + j)
        } else {
            None
        }
    }

    /// Share of the cells that the data constrain, 0..=1; 0 for an empty table.
    pub fn constrained_share(&self) -> f64 {
        let count = self.cells.iter().filter(|cell| cell.constrained).count();
        count as f64 / self.cells.len().max(1) as f64
    }

    pub(super) fn check(&self, path: &Path) -> Result<(), FitRecordError> {
        for (key, angles) in [
            ("theta_h_deg", &self.theta_h_deg),
            ("theta_d_deg", &self.theta_d_deg),
        ] {
            if let Some(bad) = angles.iter().find(|x| !(0.0..=90.0).contains(*x)) {
                return Err(out_of_range(path, key, bad, "0 to 90"));
            }
            if let Some(pair) = angles.windows(2).find(|pair| pair[0] >= pair[1]) {
                let value = format!("{} after {}", pair[1], pair[0]);
                return Err(out_of_range(path, key, value, "increasing angles"));
            }
        }
        let expected = self.theta_h_deg.len() * self.theta_d_deg.len();
        if self.cells.len() != expected {
            let allowed = format!("{expected}, one for each pair of angles");
            return Err(out_of_range(
                path,
                "number of cells",
                self.cells.len(),
                &allowed,
            ));
        }
        let values = self.cells.iter().flat_map(|cell| {
            [
                ("f", cell.value),
                ("lower", cell.lower),
                ("upper", cell.upper),
            ]
        });
        for (key, channels) in values {
            if let Some(bad) = channels.iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
                return Err(out_of_range(path, key, bad, "0 or more, finite"));
            }
        }
        Ok(())
    }
}

const WEIGHT_COLUMNS: [&str; 11] = [
    "atom", "kind", "alpha", "eta", "albedo", "weight_r", "weight_g", "weight_b", "sd_r", "sd_g",
    "sd_b",
];
const TABLE_COLUMNS: [&str; 12] = [
    "theta_h_deg",
    "theta_d_deg",
    "f_r",
    "f_g",
    "f_b",
    "lower_r",
    "lower_g",
    "lower_b",
    "upper_r",
    "upper_g",
    "upper_b",
    "constrained",
];
const DISCREPANCY_COLUMNS: [&str; 5] = [
    "theta_h_deg",
    "theta_d_deg",
    "ln_factor_r",
    "ln_factor_g",
    "ln_factor_b",
];
const TRACE_COLUMNS: [&str; 3] = ["step", "loss", "seconds"];

fn optional(value: Option<f64>) -> String {
    value.map(|x| format!("{x:?}")).unwrap_or_default()
}

pub(super) fn weights_to_csv(record: &FitRecord) -> String {
    let mut csv = WEIGHT_COLUMNS.join(",") + "\n";
    for (row, atom) in record.atoms.iter().enumerate() {
        let kind: String = atom
            .kind
            .chars()
            .filter(|c| !",\n\r".contains(*c))
            .collect();
        let (alpha, eta, albedo) = (
            optional(atom.alpha),
            optional(atom.eta),
            optional(atom.albedo),
        );
        let _ = write!(csv, "{},{kind},{alpha},{eta},{albedo}", atom.index);
        for values in record.weights.iter().chain(&record.weight_deviations) {
            let _ = write!(csv, ",{:?}", values[row]);
        }
        csv.push('\n');
    }
    csv
}

pub(super) fn table_to_csv(table: &AngleTable) -> String {
    let mut csv = TABLE_COLUMNS.join(",") + "\n";
    for (i, theta_h_deg) in table.theta_h_deg.iter().enumerate() {
        for (j, theta_d_deg) in table.theta_d_deg.iter().enumerate() {
            let Some(cell) = table.cell(i, j) else {
                continue;
            };
            let _ = write!(csv, "{theta_h_deg:?},{theta_d_deg:?}");
            for value in [cell.value, cell.lower, cell.upper].as_flattened() {
                let _ = write!(csv, ",{value:?}");
            }
            let _ = writeln!(csv, ",{}", cell.constrained);
        }
    }
    csv
}

pub(super) fn discrepancy_to_csv(discrepancies: &[Discrepancy; 3]) -> String {
    let mut csv = DISCREPANCY_COLUMNS.join(",") + "\n";
    for (k, node) in discrepancy::nodes().enumerate() {
        let _ = write!(csv, "{:?},{:?}", node.theta_h_deg, node.theta_d_deg);
        for discrepancy in discrepancies {
            let _ = write!(csv, ",{:?}", discrepancy.0[k]);
        }
        csv.push('\n');
    }
    csv
}

pub(super) fn trace_to_csv(trace: &[TracePoint]) -> String {
    let mut csv = TRACE_COLUMNS.join(",") + "\n";
    for point in trace {
        let _ = writeln!(csv, "{},{:?},{:?}", point.step, point.loss, point.seconds);
    }
    csv
}

/// One line of a CSV file, its cells found by the column's name.
struct Row<'a> {
    path: &'a Path,
    line: usize,
    header: &'a [&'a str],
    cells: Vec<&'a str>,
}

impl Row<'_> {
    fn error(&self, column: &str, fact: String) -> FitRecordError {
        FitRecordError::Syntax {
            path: self.path.to_path_buf(),
            line: self.line,
            key: column.to_owned(),
            fact,
        }
    }

    fn text(&self, column: &str) -> Result<&str, FitRecordError> {
        let at = self.header.iter().position(|name| *name == column);
        at.and_then(|at| self.cells.get(at))
            .copied()
            .ok_or_else(|| self.error(column, "the column is missing".to_owned()))
    }

    fn get<T: std::str::FromStr>(&self, column: &str) -> Result<T, FitRecordError> {
        let text = self.text(column)?;
        text.parse().map_err(|_| {
            let wanted = std::any::type_name::<T>();
            let wanted = match wanted {
                "f64" => "a number",
                "bool" => "true or false",
                _ => "a whole number",
            };
            self.error(column, format!("{:?} is not {wanted}", excerpt(text)))
        })
    }

    fn optional(&self, column: &str) -> Result<Option<f64>, FitRecordError> {
        match self.text(column)? {
            "" => Ok(None),
            _ => self.get(column).map(Some),
        }
    }

    fn channels(&self, prefix: &str) -> Result<[f64; 3], FitRecordError> {
        let channel = |name: &str| self.get(&format!("{prefix}_{name}"));
        Ok([channel("r")?, channel("g")?, channel("b")?])
    }
}

fn each_row<'a>(
    path: &'a Path,
    csv: &'a str,
    columns: &[&str],
    mut use_row: impl FnMut(Row) -> Result<(), FitRecordError>,
) -> Result<(), FitRecordError> {
    let mut lines = csv.lines();
    let header: Vec<_> = lines
        .next()
        .unwrap_or_default()
        .split(',')
        .map(str::trim)
        .collect();
    let row = |line, cells| Row {
        path,
        line,
        header: &header,
        cells,
    };
    if let Some(missing) = columns.iter().find(|column| !header.contains(column)) {
        return Err(row(1, Vec::new()).error(missing, "the column is missing".to_owned()));
    }
    for (index, text) in lines
        .enumerate()
        .filter(|(_, text)| !text.trim().is_empty())
    {
        let row = row(index + 2, text.split(',').map(str::trim).collect());
        if row.cells.len() != header.len() {
            let fact = format!("{} cells, the header has {}", row.cells.len(), header.len());
            return Err(row.error("row", fact));
        }
        use_row(row)?;
    }
    Ok(())
}

type Weights = (Vec<AtomRecord>, [Vec<f64>; 3], [Vec<f64>; 3]);

pub(super) fn weights_from_csv(path: &Path, csv: &str) -> Result<Weights, FitRecordError> {
    let (mut atoms, mut weights, mut deviations): Weights = Default::default();
    each_row(path, csv, &WEIGHT_COLUMNS, |row| {
        atoms.push(AtomRecord {
            index: row.get("atom")?,
            kind: row.text("kind")?.to_owned(),
            alpha: row.optional("alpha")?,
            eta: row.optional("eta")?,
            albedo: row.optional("albedo")?,
        });
        let (weight, deviation) = (row.channels("weight")?, row.channels("sd")?);
        for channel in 0..3 {
            weights[channel].push(weight[channel]);
            deviations[channel].push(deviation[channel]);
        }
        Ok(())
    })?;
    Ok((atoms, weights, deviations))
}

pub(super) fn table_from_csv(path: &Path, csv: &str) -> Result<AngleTable, FitRecordError> {
    let mut table = AngleTable::default();
    each_row(path, csv, &TABLE_COLUMNS, |row| {
        let theta_h_deg: f64 = row.get("theta_h_deg")?;
        let theta_d_deg: f64 = row.get("theta_d_deg")?;
        if table.theta_h_deg.last() != Some(&theta_h_deg) {
            table.theta_h_deg.push(theta_h_deg);
        }
        // The first half angle's rows name the difference angles; the others repeat them.
        if table.theta_h_deg.len() == 1 {
            table.theta_d_deg.push(theta_d_deg);
        }
        let at = table.cells.len() % table.theta_d_deg.len();
        let first_of_row =
            table.cells.len() == (table.theta_h_deg.len() - 1) * table.theta_d_deg.len();
        if table.theta_d_deg[at] != theta_d_deg || (at == 0) != first_of_row {
            let fact = format!("{theta_d_deg} breaks the grid of the rows above");
            return Err(row.error("theta_d_deg", fact));
        }
        table.cells.push(AngleCell {
            value: row.channels("f")?,
            lower: row.channels("lower")?,
            upper: row.channels("upper")?,
            constrained: row.get("constrained")?,
        });
        Ok(())
    })?;
    Ok(table)
}

pub(super) fn discrepancy_from_csv(
    path: &Path,
    csv: &str,
) -> Result<[Discrepancy; 3], FitRecordError> {
    let mut nodes = discrepancy::nodes();
    let mut by_channel: [Vec<f64>; 3] = Default::default();
    each_row(path, csv, &DISCREPANCY_COLUMNS, |row| {
        let angles: [f64; 2] = [row.get("theta_h_deg")?, row.get("theta_d_deg")?];
        let node = nodes.next();
        if node.is_none_or(|n| [n.theta_h_deg, n.theta_d_deg] != angles) {
            let wanted = node.map_or_else(
                || "no further row".to_owned(),
                |n| format!("{}, {}", n.theta_h_deg, n.theta_d_deg),
            );
            let fact = format!("{}, {} where {wanted} belongs", angles[0], angles[1]);
            return Err(row.error("theta_h_deg, theta_d_deg", fact));
        }
        for (values, value) in by_channel.iter_mut().zip(row.channels("ln_factor")?) {
            values.push(value);
        }
        Ok(())
    })?;
    Ok(by_channel.map(|values| Discrepancy(DVector::from_vec(values))))
}

pub(super) fn trace_from_csv(path: &Path, csv: &str) -> Result<Vec<TracePoint>, FitRecordError> {
    let mut trace = Vec::new();
    each_row(path, csv, &TRACE_COLUMNS, |row| {
        trace.push(TracePoint {
            step: row.get("step")?,
            loss: row.get("loss")?,
            seconds: row.get("seconds")?,
        });
        Ok(())
    })?;
    Ok(trace)
}
