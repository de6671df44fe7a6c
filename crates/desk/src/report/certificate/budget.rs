//! The budget of a certificate in the form of the GUM: for each source its standard
//! uncertainty, sensitivity and contribution, whose squares add to the square of the total.
//!
//! The fit propagates every source to f itself (posterior samples, as in the GUM's first
//! supplement), so a source's uncertainty is stated in the unit of the result, as a part of
//! f, and every sensitivity is 1.

use crate::catalogue::reproducibility::Reproducibility;
use crate::session::fit_record::{AngleTable, BudgetRecord};

/// How a source's uncertainty is known (GUM 4.2, 4.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evaluation {
    /// From the scatter of repeated observations.
    A,
    /// From anything else.
    B,
}

impl Evaluation {
    /// Its letter.
    pub fn letter(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }

    /// Of a source of the fit's budget, by its name.
    fn of(source: &str) -> Self {
        match source {
            "capture noise" | "render noise" => Self::A,
            _ => Self::B,
        }
    }
}

/// One source.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Its name.
    pub name: String,
    /// How it is known.
    pub evaluation: Evaluation,
    /// By column: contribution to the standard uncertainty of f, over f. Sensitivity 1: it is
    /// also the source's own standard uncertainty in the unit of the result.
    pub contribution: Vec<f64>,
}

/// One pair of angles: a column of the budget.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Half angle, degrees.
    pub theta_h_deg: f64,
    /// Difference angle, degrees.
    pub theta_d_deg: f64,
    /// f, mean over the channels, 1/sr.
    pub value: f64,
    /// Combined standard uncertainty of f over f.
    pub combined: f64,
    /// Expanded uncertainty over f: half the 95% interval's width, mean over the channels;
    /// `None` where the fit has no table.
    pub expanded: Option<f64>,
    /// Whether the images constrain it.
    pub constrained: bool,
}

impl Column {
    /// The interval's half-width over the standard uncertainty; 2 where the posterior is
    /// Gaussian.
    pub fn coverage_factor(&self) -> Option<f64> {
        (self.combined > 0.0).then_some(self.expanded? / self.combined)
    }
}

/// The whole budget.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// The pairs of angles.
    pub columns: Vec<Column>,
    /// The sources.
    pub sources: Vec<Source>,
}

impl Budget {
    /// From a fit's budget and table, and, where known, the scatter between sessions of the
    /// sample: what varies beyond that which the fit states, a contribution of type A.
    pub fn new(
        record: &BudgetRecord,
        table: &AngleTable,
        reproducibility: Option<&Reproducibility>,
    ) -> Self {
        // The fit's own sources.
        let mut columns: Vec<Column> = record
            .row
            .iter()
            .map(|row| {
                let cell = table.nearest(row.theta_h_deg, row.theta_d_deg);
                let half_width = cell.map(|cell| {
                    let relative = (0..3).map(|c| {
                        0.5 * (cell.upper[c] - cell.lower[c]) / cell.value[c].max(f64::MIN_POSITIVE)
                    });
                    relative.sum::<f64>() / 3.0
                });
                Column {
                    theta_h_deg: row.theta_h_deg,
                    theta_d_deg: row.theta_d_deg,
                    value: row.value,
                    combined: row.relative_std,
                    expanded: half_width,
                    constrained: cell.is_some_and(|cell| cell.constrained),
                }
            })
            .collect();
        let source = |(n, name): (usize, &String)| Source {
            name: name.clone(),
            evaluation: Evaluation::of(name),
            contribution: record
                .row
                .iter()
                .map(|row| row.share[n].sqrt() * row.relative_std)
                .collect(),
        };
        let mut sources: Vec<Source> = record.sources.iter().enumerate().map(source).collect();
        // The scatter between sessions, independent of them.
        if let Some(scatter) = reproducibility {
            let at = |column: &Column| {
                let angles = |theta_h_deg, theta_d_deg| [theta_h_deg, theta_d_deg];
                let of_column = angles(column.theta_h_deg, column.theta_d_deg);
                let mut rows = scatter.row.iter();
                let found = rows.find(|row| angles(row.theta_h_deg, row.theta_d_deg) == of_column);
                found.map_or(0.0, |row| row.between_relative_std)
            };
            let contribution: Vec<f64> = columns.iter().map(at).collect();
            for (column, std) in columns.iter_mut().zip(&contribution) {
                let factor = column.coverage_factor().unwrap_or(2.0);
                column.expanded = column.expanded.map(|width| width.hypot(factor * std));
                column.combined = column.combined.hypot(*std);
            }
            sources.push(Source {
                name: format!("reproducibility over {} sessions", scatter.sessions.len()),
                evaluation: Evaluation::A,
                contribution,
            });
        }
        Self { columns, sources }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::reproducibility::Repeat;
    use crate::session::fit_record::{BudgetRow, Interval};

    fn record() -> BudgetRecord {
        let row = |theta_h_deg: f64, relative_std: f64| BudgetRow {
            theta_h_deg,
            theta_d_deg: 10.0,
            value: 0.4,
            relative_std,
            share: vec![0.25, 0.6, 0.15],
        };
        BudgetRecord {
            sources: ["capture noise", "pose", "model"].map(str::to_owned).into(),
            row: vec![row(0.0, 0.04), row(15.0, 0.1)],
        }
    }

    fn table() -> AngleTable {
        let cell = Interval {
            value: [0.4; 3],
            lower: [0.36; 3],
            upper: [0.46; 3],
            constrained: true,
        };
        AngleTable {
            theta_h_deg: vec![0.0, 15.0],
            theta_d_deg: vec![9.0, 12.0],
            cells: vec![cell; 4],
        }
    }

    fn assert_squares_add(budget: &Budget) {
        for (n, column) in budget.columns.iter().enumerate() {
            let squares = budget.sources.iter().map(|s| s.contribution[n].powi(2));
            let total = squares.sum::<f64>().sqrt();
            assert!((total / column.combined - 1.0).abs() < 1e-12, "{column:?}");
        }
    }

    #[test]
    fn squares_of_contributions_add_to_the_total() {
        let budget = Budget::new(&record(), &table(), None);
        assert_squares_add(&budget);
        assert_eq!(budget.columns[0].combined, 0.04);
        // Half of 0.10 over 0.4, and that over 0.04.
        let factor = budget.columns[0].coverage_factor().unwrap();
        assert!((factor - 0.125 / 0.04).abs() < 1e-9, "{factor}");
        assert_eq!(budget.sources[0].evaluation.letter(), "A");
        assert_eq!(budget.sources[1].evaluation.letter(), "B");
    }

    #[test]
    fn scatter_between_sessions_is_one_more_source() {
        // Three sessions whose fits state no uncertainty: all of their spread is between them.
        let repeat = |(session, value): (&str, f64)| Repeat {
            session: session.to_owned(),
            budget: BudgetRecord {
                sources: Vec::new(),
                row: vec![BudgetRow {
                    theta_h_deg: 0.0,
                    theta_d_deg: 10.0,
                    value,
                    relative_std: 0.0,
                    share: Vec::new(),
                }],
            },
        };
        let repeats = [("a", 0.97), ("b", 1.0), ("c", 1.03)].map(repeat);
        let scatter = Reproducibility::of("cup", &repeats).unwrap();
        let budget = Budget::new(&record(), &table(), Some(&scatter));
        assert_squares_add(&budget);
        assert!((budget.columns[0].combined - 0.05).abs() < 1e-12, "3, 4, 5");
        // The interval widens in proportion, where it is known.
        let widened = budget.columns[0].expanded.unwrap();
        assert!((widened - 0.125 * 1.25).abs() < 1e-9, "{widened}");
        assert_eq!(budget.columns[1].combined, 0.1);
        assert_eq!(budget.sources[3].name, "reproducibility over 3 sessions");
    }
}
