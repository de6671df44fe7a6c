//! The error budget: a table of shares, and bars beside it.

use serde::Serialize;

use crate::plot::svg::{Anchor, COLORS, INK, Svg, TEXT};
use crate::session::fit_record::BudgetRecord;

/// Rows for the template.
#[derive(Serialize)]
pub struct BudgetView {
    sources: Vec<String>,
    rows: Vec<BudgetRowView>,
    svg: String,
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
    pub fn of(record: &BudgetRecord) -> Self {
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
        Self {
            sources: record.sources.clone(),
            rows: rows.collect(),
            svg: bars(record),
        }
    }
}

fn angles(theta_h_deg: f64, theta_d_deg: f64) -> String {
    format!("{theta_h_deg:.0}°, {theta_d_deg:.0}°")
}

/// A bar per row, as long as its relative deviation, divided by the shares of variance.
fn bars(record: &BudgetRecord) -> String {
    const LEFT: f64 = 70.0;
    const LONG: f64 = 480.0;
    const STEP: f64 = 24.0;
    let rows = record.row.len() as f64;
    let widest = record
        .row
        .iter()
        .map(|r| r.relative_std)
        .fold(1e-12, f64::max);
    let legend = record.sources.len().div_ceil(4) as f64;
    let mut svg = Svg::new(LEFT + LONG + 70.0, STEP * (rows + legend) + 16.0);
    for (index, row) in record.row.iter().enumerate() {
        let y = 4.0 + STEP * index as f64;
        let label = angles(row.theta_h_deg, row.theta_d_deg);
        svg.text([LEFT - 6.0, y + 13.0], Anchor::End, TEXT, &label);
        let mut x = LEFT;
        for (source, share) in row.share.iter().enumerate() {
            let width = LONG * row.relative_std / widest * share;
            svg.rectangle(
                [x, y],
                [width, 17.0],
                COLORS[source % COLORS.len()],
                "#ffffff",
            );
            x += width;
        }
        let total = format!("{:.2} %", 100.0 * row.relative_std);
        svg.text([x + 5.0, y + 13.0], Anchor::Start, TEXT, &total);
    }
    for (source, name) in record.sources.iter().enumerate() {
        let x = LEFT + (source % 4) as f64 * 130.0;
        let y = STEP * rows + 8.0 + STEP * (source / 4) as f64;
        svg.rectangle([x, y], [11.0, 11.0], COLORS[source % COLORS.len()], INK);
        svg.text([x + 16.0, y + 10.0], Anchor::Start, TEXT, name);
    }
    svg.finish()
}
