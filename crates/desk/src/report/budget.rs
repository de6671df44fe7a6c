//! The error budget: a table of shares, and the same as bars.

use minijinja::context;
use minijinja::value::Value;

use super::value::values;
use crate::plot::{Axis, Bar, BarRow, PlotError, bars, page_color};
use crate::session::fit_record::BudgetRecord;

/// The table and the bars.
pub(super) fn budget_view(record: &BudgetRecord) -> Result<Value, PlotError> {
    Ok(context! {
        sources => values(record.sources.iter().enumerate(), |(n, name)| context! {
            name,
            color => page_color(n),
        }),
        rows => values(&record.row, |row| context! {
            angles => angles(row.theta_h_deg, row.theta_d_deg),
            value => format!("{:.3e}", row.value).replace('-', "−"),
            relative_std => format!("{:.2}%", 100.0 * row.relative_std),
            shares => values(&row.share, |s| format!("{:.1}%", 100.0 * s).into()),
        }),
        svg => figure(record)?,
    })
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
                    note: format!("{:.2}%", 100.0 * row.relative_std),
                }],
            }
        })
        .collect();
    let x = Axis::linear(0.0..1.14 * longest, "standard deviation, % of f");
    bars("budget", &x, 26.0, &rows).inline("error budget")
}
