//! The error budget: a table of shares, and the same as bars.

use serde::Serialize;

use crate::plot::{Axis, Bar, BarRow, PlotError, bars, page_color};
use crate::session::fit_record::BudgetRecord;

/// Rows for the template.
#[derive(Serialize)]
pub struct BudgetView {
    sources: Vec<SourceView>,
    rows: Vec<BudgetRowView>,
    svg: String,
}

#[derive(Serialize)]
struct SourceView {
    name: String,
    color: &'static str,
}

#[derive(Serialize)]
struct BudgetRowView {
    angles: String,
    value: String,
    relative_std: String,
    shares: Vec<String>,
}

impl BudgetView {
    /// Of a fit's record.
    ///
    /// # Errors
    /// The bars could not be drawn.
    pub fn of(record: &BudgetRecord) -> Result<Self, PlotError> {
        let rows = record.row.iter().map(|row| BudgetRowView {
            angles: angles(row.theta_h_deg, row.theta_d_deg),
            value: format!("{:.3e}", row.value).replace('-', "−"),
            relative_std: format!("{:.2} %", 100.0 * row.relative_std),
            shares: row
                .share
                .iter()
                .map(|s| format!("{:.1} %", 100.0 * s))
                .collect(),
        });
        let sources = record
            .sources
            .iter()
            .enumerate()
            .map(|(n, name)| SourceView {
                name: name.clone(),
                color: page_color(n),
            });
        Ok(Self {
            sources: sources.collect(),
            rows: rows.collect(),
            svg: figure(record)?,
        })
    }
}

fn angles(theta_h_deg: f64, theta_d_deg: f64) -> String {
    format!("{theta_h_deg:.0}°, {theta_d_deg:.0}°")
}

/// A bar per row, as long as its relative deviation, divided by the shares of variance.
fn figure(record: &BudgetRecord) -> Result<String, PlotError> {
    let longest = record.row.iter().map(|row| row.relative_std);
    let longest = 100.0 * longest.fold(1e-12, f64::max);
    let rows: Vec<BarRow> = record
        .row
        .iter()
        .map(|row| {
            let parts = row.share.iter().enumerate();
            let parts = parts.map(|(n, share)| (100.0 * row.relative_std * share, n));
            BarRow {
                label: angles(row.theta_h_deg, row.theta_d_deg),
                bars: vec![Bar {
                    parts: parts.collect(),
                    deviation: None,
                    note: format!("{:.2} %", 100.0 * row.relative_std),
                }],
            }
        })
        .collect();
    let x = Axis::linear(0.0..1.14 * longest, "standard deviation, % of f");
    bars("budget", &x, [26.0, 70.0], &rows).inline("error budget")
}
