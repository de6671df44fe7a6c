//! How often the 95% intervals of fits like this one were found to hold the truth
//! (docs/measurements/intervals.md). What states an uncertainty to others states this too.

use super::FitRecord;
use crate::brdf::Dictionary;

/// Coverage that the intervals state.
pub const STATED: f64 = 0.95;

/// Coverage that was measured over simulated captures whose truth is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredCoverage {
    /// What was captured, in words.
    pub class: &'static str,
    /// Captures, each of its own material and bench.
    pub captures: u32,
    /// Share of the captures whose interval holds the truth: the median cell of (θh, θd).
    pub median_cell: f64,
    /// ... of the worst tenth of the cells.
    pub worst_decile: f64,
    /// ... of the worst cell.
    pub worst_cell: f64,
}

/// Of the default dictionary, materials that no mixture of it is: what a sample is of which
/// nothing else is known.
const KNOWN: MeasuredCoverage = MeasuredCoverage {
    class: "measured materials on a known bench",
    captures: 200,
    median_cell: 0.88,
    worst_decile: 0.825,
    worst_cell: 0.75,
};
const REFINED: MeasuredCoverage = MeasuredCoverage {
    class: "measured materials on a refined bench",
    captures: 100,
    median_cell: 0.87,
    worst_decile: 0.80,
    worst_cell: 0.71,
};

impl MeasuredCoverage {
    /// Of fits like this one; `None` where it was not measured: with another dictionary than
    /// the default one.
    pub fn of(record: &FitRecord) -> Option<Self> {
        if record.dictionary != Dictionary::DEFAULT {
            return None;
        }
        Some(match record.bench {
            Some(_) => REFINED,
            None => KNOWN,
        })
    }

    /// Whether the median cell holds the truth as often as is stated.
    pub fn is_reached(&self) -> bool {
        self.median_cell >= STATED
    }
}

/// One sentence for readers of the intervals: what is stated, and what was measured.
pub fn statement(record: &FitRecord) -> String {
    let percent = |share: f64| format!("{:.1}%", 100.0 * share);
    match MeasuredCoverage::of(record) {
        Some(found) => format!(
            "The stated coverage of {} is {}: in {} simulated captures of {}, the intervals held the truth in {} of the captures (median cell), {} (worst tenth of the cells) and {} (worst cell).",
            percent(STATED),
            if found.is_reached() { "met" } else { "not met" },
            found.captures,
            found.class,
            percent(found.median_cell),
            percent(found.worst_decile),
            percent(found.worst_cell),
        ),
        None => format!(
            "The stated coverage of {} is not shown: how often the intervals hold the truth with the dictionary {} was not measured.",
            percent(STATED),
            record.dictionary
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::example::fit as sample;

    /// The figures are those of the document in which they were measured.
    #[test]
    fn coverage_is_what_was_measured() {
        let document = include_str!("../../../../../docs/measurements/intervals.md");
        let table = document.split("With `paper42` alone").next().unwrap();
        for (found, row) in [
            (KNOWN, "| measured | known |"),
            (REFINED, "| measured | refined (100 captures) |"),
        ] {
            let row = table.lines().find(|line| line.starts_with(row)).unwrap();
            let cells: Vec<f64> = row
                .split('|')
                .filter_map(|cell| cell.trim().strip_suffix('%')?.parse().ok())
                .collect();
            let figures = [found.median_cell, found.worst_decile, found.worst_cell];
            for (figure, cell) in figures.iter().zip(cells) {
                assert!((100.0 * figure - cell).abs() < 1e-9, "{row}: {figure}");
            }
        }
        assert!(table.contains("200 captures of each class"));
    }

    #[test]
    fn what_is_not_met_or_not_measured_is_said() {
        let mut record = sample();
        record.dictionary = Dictionary::DEFAULT.to_owned();
        assert!(statement(&record).contains("87.0% of the captures"));
        assert!(statement(&record).starts_with("The stated coverage of 95.0% is not met: "));
        record.bench = None;
        assert!(statement(&record).contains("75.0% (worst cell)"));
        record.dictionary = "other".to_owned();
        assert!(statement(&record).contains("not measured"));
    }
}
