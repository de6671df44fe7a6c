//! What the figures of several experiments have in common.

use std::ops::Range;

use super::{Row, Table, quantile, spread};
use crate::plot::{Axis, Chart, Mark, Series};

/// Figures below this are drawn as this, on logarithmic axes.
const SMALLEST: f64 = 1e-6;

/// An axis on which equal steps are doublings, with a tick at each of the ascending
/// `values`; positions are their log2.
pub fn doublings(values: &[f64], label: &str) -> Axis {
    let last = values.last().copied().unwrap_or(1.0).log2();
    let ticks = values.iter().map(|n| (n.log2(), format!("{n}")));
    Axis::with_ticks(-0.15..last + 0.15, ticks.collect(), label)
}

/// Medians of a column over `x`, log10, with their 95% intervals as a band.
pub struct Medians<'a> {
    /// The rows.
    pub table: &'a Table,
    /// The column.
    pub column: &'a str,
    /// The column with the values of `x`.
    pub x_column: &'a str,
    /// The values of `x`.
    pub x: &'a [f64],
    /// Where they are on the axis.
    pub position: fn(f64) -> f64,
}

impl Medians<'_> {
    /// The curve of the rows that `keep` chooses.
    pub fn series(&self, label: &str, color: usize, keep: impl Fn(&Row) -> bool) -> Series {
        let (mut points, mut band) = (Vec::new(), Vec::new());
        for &x in self.x {
            let chosen = |row: &Row| keep(row) && row.number(self.x_column) == Some(x);
            if let Some(found) = spread(&self.table.figures(self.column, chosen)) {
                let at = (self.position)(x);
                let [low, high] = found.median_95.map(log);
                points.push([at, log(found.median)]);
                band.push([at, low, high]);
            }
        }
        Series::new(label, color, Mark::Points, points).within(band)
    }
}

/// One figure of every row against another, both log10, with a line where they are equal.
pub struct Scatter<'a> {
    /// The rows.
    pub table: &'a Table,
    /// Powers of ten that both axes show.
    pub decades: Range<f64>,
    /// Column and label of the horizontal axis.
    pub x: (&'a str, &'a str),
    /// Label of the vertical axis.
    pub y_label: &'a str,
    /// Label, colour and column of each series.
    pub series: &'a [(&'a str, usize, &'a str)],
}

impl Scatter<'_> {
    /// The panel of the rows of one shape.
    pub fn panel(&self, title: String, shape: &str) -> Chart {
        let Range { start, end } = self.decades;
        let mut series = vec![Series::new(
            "",
            7,
            Mark::Line,
            vec![[start, start], [end, end]],
        )];
        for &(label, color, column) in self.series {
            let rows = self.table.rows.iter().filter(|r| r.text("shape") == shape);
            let points = rows.filter_map(|r| Some([r.number(self.x.0)?, r.number(column)?]));
            let points = points.map(|point| point.map(|e| e.max(1e-4).log10()));
            series.push(Series::new(label, color, Mark::Dots, points.collect()));
        }
        Chart {
            title,
            x: Axis::decades(self.decades.clone(), self.x.1),
            y: Axis::decades(self.decades.clone(), self.y_label),
            series,
        }
    }

    /// Median of a column over the rows of one shape.
    pub fn median(&self, column: &str, shape: &str) -> f64 {
        quantile(
            &self.table.figures(column, |r| r.text("shape") == shape),
            0.5,
        )
    }
}

fn log(value: f64) -> f64 {
    value.max(SMALLEST).log10()
}
