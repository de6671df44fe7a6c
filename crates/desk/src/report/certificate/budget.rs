//! The budget of a certificate in the form of the GUM: for each source its standard
//! uncertainty, sensitivity and contribution, whose squares add to the square of the total.
//!
//! The fit propagates every source to f itself (posterior samples, as in the GUM's first
//! supplement), so a source's uncertainty is stated in the unit of the result, as a part of
//! f, and every sensitivity is 1.

use crate::brdf::{Brdf, HalfDifference};
use crate::catalogue::reproducibility::Reproducibility;
use crate::session::fit_record::{AngleTable, BudgetRecord, Interval};

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

impl Source {
    /// Whether the fit allowed for it; what it took as exactly known contributes nothing
    /// anywhere.
    pub fn is_evaluated(&self) -> bool {
        self.contribution.iter().any(|part| *part > 0.0)
    }
}

/// One pair of angles: a column of the budget.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Column {
    pub theta_h_deg: f64,
    pub theta_d_deg: f64,
    /// f, mean over the channels, 1/sr.
    pub value: f64,
    /// f of each channel at these very angles with its interval, 1/sr, and whether the images
    /// constrain it; `None` where the fit has no table.
    pub channels: Option<Interval>,
    /// Combined standard uncertainty of f over f.
    pub combined: f64,
    /// Expanded uncertainty over f: half the 95% interval's width, mean over the channels;
    /// `None` where the fit has no table.
    pub expanded: Option<f64>,
}

impl Column {
    /// The interval's half-width over the standard uncertainty; 2 where the posterior is
    /// Gaussian.
    pub fn coverage_factor(&self) -> Option<f64> {
        (self.combined > 0.0).then_some(self.expanded? / self.combined)
    }

    /// Expanded uncertainty of one channel over its f.
    pub fn expanded_of(&self, channel: usize) -> Option<f64> {
        self.channels.map(|found| half_width(&found, channel))
    }

    /// Whether the images constrain it.
    pub fn is_constrained(&self) -> bool {
        self.channels.is_some_and(|found| found.constrained)
    }

    /// Adds a relative standard uncertainty that is independent of the others; the intervals
    /// widen in proportion.
    fn widen(&mut self, std: f64) {
        let factor = self.coverage_factor().unwrap_or(2.0);
        if let Some(width) = &mut self.expanded {
            let widened = width.hypot(factor * std);
            let scale = if *width > 0.0 { widened / *width } else { 1.0 };
            *width = widened;
            if let Some(found) = &mut self.channels {
                for c in 0..3 {
                    let value = found.value[c];
                    found.lower[c] = value + scale * (found.lower[c] - value);
                    found.upper[c] = value + scale * (found.upper[c] - value);
                }
            }
        }
        self.combined = self.combined.hypot(std);
    }
}

/// Half the interval's width over f.
fn half_width(found: &Interval, channel: usize) -> f64 {
    let width = found.upper[channel] - found.lower[channel];
    0.5 * width / found.value[channel].max(f64::MIN_POSITIVE)
}

/// f and its interval at any angles: the material there, with an interval as wide, relatively,
/// as the table has it around them.
fn at(material: &dyn Brdf, table: &AngleTable, angles_deg: [f64; 2]) -> Option<Interval> {
    let [theta_h_deg, theta_d_deg] = angles_deg;
    let (to_light, to_viewer) = HalfDifference {
        theta_h_rad: theta_h_deg.to_radians(),
        theta_d_rad: theta_d_deg.to_radians(),
        phi_d_rad: std::f64::consts::FRAC_PI_2,
    }
    .to_directions();
    let value = material.eval(to_light.as_vec3(), to_viewer.as_vec3());
    let value = value.map(f64::from);
    let mut found = Interval {
        value,
        lower: value,
        upper: value,
        constrained: table.is_constrained(theta_h_deg, theta_d_deg),
    };
    for c in 0..3 {
        let [low, high] = table.relative_interval(angles_deg, c)?;
        found.lower[c] *= 10f64.powf(low);
        found.upper[c] *= 10f64.powf(high);
    }
    Some(found)
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
    /// From a fit's budget, material and table, and, where known, the scatter between sessions of the
    /// sample: what varies beyond that which the fit states, a contribution of type A.
    pub fn new(
        record: &BudgetRecord,
        material: &dyn Brdf,
        table: &AngleTable,
        reproducibility: Option<&Reproducibility>,
    ) -> Self {
        // The fit's own sources.
        let mut columns: Vec<Column> = record
            .row
            .iter()
            .map(|row| {
                let channels = at(material, table, [row.theta_h_deg, row.theta_d_deg]);
                let mean = |found| (0..3).map(|c| half_width(&found, c)).sum::<f64>() / 3.0;
                Column {
                    theta_h_deg: row.theta_h_deg,
                    theta_d_deg: row.theta_d_deg,
                    value: row.value,
                    channels,
                    combined: row.relative_std,
                    expanded: channels.map(mean),
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
                column.widen(*std);
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
    use crate::brdf::source;
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

    fn material() -> Box<dyn Brdf> {
        source::load("lambertian:0.5").unwrap()
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
        let budget = Budget::new(&record(), &*material(), &table(), None);
        assert_squares_add(&budget);
        assert_eq!(budget.columns[0].combined, 0.04);
        // Half of 0.10 over 0.4, and that over 0.04.
        let factor = budget.columns[0].coverage_factor().unwrap();
        assert!((factor - 0.125 / 0.04).abs() < 1e-9, "{factor}");
        // The material at the column's own angles, with the interval of the cells around.
        let found = budget.columns[1].channels.unwrap();
        let f = 0.5 / std::f64::consts::PI;
        for (of, part) in [(found.value, 1.0), (found.lower, 0.9), (found.upper, 1.15)] {
            assert!((of[2] - part * f).abs() < 1e-6, "{found:?}");
        }
        assert!(budget.sources.iter().all(Source::is_evaluated));
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
        let budget = Budget::new(&record(), &*material(), &table(), Some(&scatter));
        assert_squares_add(&budget);
        assert!((budget.columns[0].combined - 0.05).abs() < 1e-12, "3, 4, 5");
        // The interval widens in proportion, where it is known.
        let widened = budget.columns[0].expanded.unwrap();
        assert!((widened - 0.125 * 1.25).abs() < 1e-9, "{widened}");
        let of_green = budget.columns[0].expanded_of(1).unwrap();
        assert!((of_green - widened).abs() < 1e-6, "{of_green}");
        assert_eq!(budget.columns[1].combined, 0.1);
        assert_eq!(budget.sources[3].name, "reproducibility over 3 sessions");
    }
}
