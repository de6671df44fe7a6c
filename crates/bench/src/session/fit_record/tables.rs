//! The fit's CSV files: weights, the (θh, θd) table, the trace.

use std::path::Path;

use csv::{DeserializeErrorKind, ErrorKind, ReaderBuilder, StringRecord, Trim, Writer};
use serde::de::DeserializeOwned;

use super::{AtomRecord, FitRecord, FitRecordError, TracePoint, out_of_range};
use crate::inverse::Fit;
use crate::inverse::intervals::{self, Interval};
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
    pub cells: Vec<Interval>,
}

impl AngleTable {
    /// Of a fit, at 46 half angles, dense near 0, and 31 difference angles.
    pub fn of(fit: &Fit) -> Self {
        let theta_h_deg: Vec<f64> = (0..=45)
            .map(|i| 90.0 * (f64::from(i) / 45.0).powi(2))
            .collect();
        let theta_d_deg: Vec<f64> = (0..=30).map(|j| 3.0 * f64::from(j)).collect();
        let cells = intervals::table(
            &fit.material,
            &fit.posterior_samples,
            &theta_h_deg,
            &theta_d_deg,
            90.0,
        );
        Self {
            theta_h_deg,
            theta_d_deg,
            cells,
        }
    }

    /// The cell of the i-th half angle and the j-th difference angle.
    pub fn cell(&self, i: usize, j: usize) -> Option<&Interval> {
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
const TRACE_COLUMNS: [&str; 3] = ["step", "loss", "seconds"];

/// A table of comma-separated values; numbers are written so that they are read back exactly.
fn to_csv(columns: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut writer = Writer::from_writer(Vec::new());
    let header = columns.iter().map(|&name| name.to_owned()).collect();
    for row in std::iter::once(header).chain(rows) {
        writer
            .write_record(row)
            .expect("rows as long as the header, written to memory");
    }
    let bytes = writer.into_inner().expect("written to memory");
    String::from_utf8(bytes).expect("made of texts")
}

fn exact(value: &f64) -> String {
    format!("{value:?}")
}

pub(super) fn weights_to_csv(record: &FitRecord) -> String {
    let rows = record.atoms.iter().enumerate().map(|(row, atom)| {
        let parameters = [&atom.alpha, &atom.eta, &atom.albedo];
        let parameters = parameters.map(|value| value.as_ref().map_or(String::new(), exact));
        let values = record.weights.iter().chain(&record.weight_deviations);
        let mut cells = vec![atom.index.to_string(), atom.kind.clone()];
        cells.extend(parameters);
        cells.extend(values.map(|values| exact(&values[row])));
        cells
    });
    to_csv(&WEIGHT_COLUMNS, rows)
}

pub(super) fn table_to_csv(table: &AngleTable) -> String {
    let columns = table.theta_d_deg.len();
    let rows = table.cells.iter().enumerate().map(|(k, cell)| {
        let values = [cell.value, cell.lower, cell.upper];
        let mut cells = vec![
            exact(&table.theta_h_deg[k / columns]),
            exact(&table.theta_d_deg[k % columns]),
        ];
        cells.extend(values.as_flattened().iter().map(exact));
        cells.push(cell.constrained.to_string());
        cells
    });
    to_csv(&TABLE_COLUMNS, rows)
}

pub(super) fn trace_to_csv(trace: &[TracePoint]) -> String {
    let rows = trace.iter().map(|point| {
        let seconds = exact(&point.seconds);
        vec![point.step.to_string(), exact(&point.loss), seconds]
    });
    to_csv(&TRACE_COLUMNS, rows)
}

/// A file that is being read, for errors.
struct Source<'a> {
    path: &'a Path,
    columns: &'a [&'a str],
}

impl Source<'_> {
    fn error(&self, line: u64, key: &str, fact: String) -> FitRecordError {
        FitRecordError::Syntax {
            path: self.path.to_path_buf(),
            line: line as usize,
            key: key.to_owned(),
            fact,
        }
    }

    /// A cell that is not what its column needs.
    fn unfit(&self, line: u64, record: &StringRecord, kind: &ErrorKind) -> FitRecordError {
        let error = match kind {
            ErrorKind::Deserialize { err, .. } => Some(err),
            _ => None,
        };
        let field = error.and_then(|error| error.field()).unwrap_or_default() as usize;
        let wanted = match error.map(|error| error.kind()) {
            Some(DeserializeErrorKind::ParseFloat(_)) => "a number",
            Some(DeserializeErrorKind::ParseBool(_)) => "true or false",
            _ => "a whole number",
        };
        let text = excerpt(record.get(field).unwrap_or_default());
        let key = self.columns.get(field).unwrap_or(&"row");
        self.error(line, key, format!("{text:?} is not {wanted}"))
    }

    /// The rows with their lines, whose cells have the columns' order.
    fn rows<T: DeserializeOwned>(&self, csv: &str) -> Result<Vec<(u64, T)>, FitRecordError> {
        let mut reader = ReaderBuilder::new()
            .trim(Trim::All)
            .flexible(true)
            .from_reader(csv.as_bytes());
        let unreadable = |error: csv::Error| self.error(1, "table", error.to_string());
        let header = reader.headers().map_err(unreadable)?;
        let at = |(k, name): (usize, &&str)| header.get(k) == Some(*name);
        if let Some(missing) = (0..).zip(self.columns).position(|column| !at(column)) {
            let fact = format!("column {} is not this one", missing + 1);
            return Err(self.error(1, self.columns[missing], fact));
        }
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record.map_err(unreadable)?;
            let line = record.position().map_or(0, |position| position.line());
            if record.len() != self.columns.len() {
                let fact = format!(
                    "{} cells, the header has {}",
                    record.len(),
                    self.columns.len()
                );
                return Err(self.error(line, "row", fact));
            }
            let row = record.deserialize(None);
            let row = row.map_err(|error| self.unfit(line, &record, error.kind()));
            rows.push((line, row?));
        }
        Ok(rows)
    }
}

type Weights = (Vec<AtomRecord>, [Vec<f64>; 3], [Vec<f64>; 3]);

/// Index, kind, parameters, weights and deviations of an atom.
type WeightRow = (usize, String, [Option<f64>; 3], [f64; 3], [f64; 3]);

pub(super) fn weights_from_csv(path: &Path, csv: &str) -> Result<Weights, FitRecordError> {
    let columns = &WEIGHT_COLUMNS;
    let (mut atoms, mut weights, mut deviations): Weights = Default::default();
    for (_, row) in (Source { path, columns }).rows::<WeightRow>(csv)? {
        let (index, kind, [alpha, eta, albedo], weight, deviation) = row;
        atoms.push(AtomRecord {
            index,
            kind,
            alpha,
            eta,
            albedo,
        });
        for channel in 0..3 {
            weights[channel].push(weight[channel]);
            deviations[channel].push(deviation[channel]);
        }
    }
    Ok((atoms, weights, deviations))
}

pub(super) fn table_from_csv(path: &Path, csv: &str) -> Result<AngleTable, FitRecordError> {
    let columns = &TABLE_COLUMNS;
    let source = Source { path, columns };
    let mut table = AngleTable::default();
    for (line, row) in source.rows::<([f64; 2], [[f64; 3]; 3], bool)>(csv)? {
        let ([theta_h_deg, theta_d_deg], [value, lower, upper], constrained) = row;
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
            return Err(source.error(line, "theta_d_deg", fact));
        }
        table.cells.push(Interval {
            value,
            lower,
            upper,
            constrained,
        });
    }
    Ok(table)
}

pub(super) fn trace_from_csv(path: &Path, csv: &str) -> Result<Vec<TracePoint>, FitRecordError> {
    let columns = &TRACE_COLUMNS;
    let rows = (Source { path, columns }).rows::<TracePoint>(csv)?;
    Ok(rows.into_iter().map(|(_, point)| point).collect())
}
