//! Whether each calibration recovers the truth of the simulated bench, and whether its
//! stated uncertainties are right: pulls (error over stated uncertainty) of a
//! calibration that is right have a mean of 0 and a standard deviation of 1.

mod camera;
mod focus;
mod lamp;
mod lights;
mod pose;
mod response;
mod sensor;
mod white;
mod white_lights;

use std::ops::Range;

use rayon::prelude::*;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::Lab;
use crate::calibration::record::Measured;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Every calibration on many simulated benches.
pub static CALIBRATION: Experiment = Experiment {
    name: "calibration",
    shows: "What each calibration finds on simulated benches, next to the truth: mean, stated uncertainty, and mean and standard deviation of the pulls (error over stated uncertainty)",
    full: Scale::NONE,
    quick: Scale::NONE,
    cases,
    figures,
};

/// Benches with `--quick`.
const QUICK: u64 = 4;

/// Calibrates the bench of a seed.
type Calibrate = fn(u64) -> Result<Vec<Recovered>, EvaluateError>;

/// The calibrations with their benches: a further one is a line and a function here.
const CALIBRATIONS: &[(&str, u64, Calibrate)] = &[
    ("sensor", 240, sensor::sensor),
    ("sensor, bent by -1.5%", 60, sensor::bent),
    ("flat", 60, sensor::flat),
    ("lamp", 60, lamp::lamp),
    ("white", 1000, white::white),
    ("white, light by light", 240, white_lights::white_lights),
    ("lights, one sphere", 60, lights::one_sphere),
    ("lights, two spheres", 60, lights::two_spheres),
    ("camera in perspective", 60, camera::in_perspective),
    ("telecentric camera", 60, camera::through_a_telecentric_lens),
    ("focus", 60, focus::focus),
    ("pose, bowl", 20, pose::bowl_through_a_telecentric_lens),
    ("pose, corner", 20, pose::corner_in_perspective),
    ("response, Debevec-Malik", 60, response::debevec_malik),
    ("response, Robertson", 60, response::robertson_and_others),
];

/// One number that a calibration found. A quantity may occur many times on one
/// bench, as maps of pixels do.
pub(super) struct Recovered {
    /// What it is; equal ones are pooled.
    pub quantity: &'static str,
    /// Its unit; empty for ratios.
    pub unit: &'static str,
    /// The truth.
    pub truth: f64,
    /// The value found, with its stated uncertainty.
    pub found: Measured,
}

fn failed(error: impl std::fmt::Display) -> EvaluateError {
    EvaluateError::Fact(error.to_string())
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let quick = lab.settings.quick;
    let case = |&(name, benches, calibrate): &(&'static str, u64, Calibrate)| {
        let benches = if quick { QUICK } else { benches };
        Case::new(format!("{name}/{benches} benches"), move |lab: &Lab| {
            let found = (0..benches)
                .into_par_iter()
                .map(|bench| calibrate(1000 * lab.settings.seed + bench))
                .collect::<Result<Vec<_>, _>>()?;
            Ok(summaries(name, &found))
        })
    };
    Ok(CALIBRATIONS.iter().map(case).collect())
}

/// One row per quantity, in the order of their first occurrence, from what each bench gave.
/// What one bench gives shares its noise, so the standard errors are those of the benches.
fn summaries(calibration: &str, benches: &[Vec<Recovered>]) -> Vec<Row> {
    let mut quantities: Vec<&str> = Vec::new();
    for one in benches.iter().flatten() {
        if !quantities.contains(&one.quantity) {
            quantities.push(one.quantity);
        }
    }
    let row = |quantity: &str| {
        let of = |r: &&Recovered| r.quantity == quantity;
        let all: Vec<&Recovered> = benches.iter().flatten().filter(of).collect();
        let mean = |value: &dyn Fn(&Recovered) -> f64| average(all.iter().map(|r| value(r)));
        let pull = |r: &Recovered| (r.found.value - r.truth) / r.found.std;
        let of_benches = |value: &dyn Fn(&Recovered) -> f64| -> Vec<f64> {
            let of_bench = |bench: &Vec<Recovered>| average(bench.iter().filter(of).map(value));
            benches.iter().map(of_bench).collect()
        };
        let pull_mean = mean(&pull);
        let square = |r: &Recovered| (pull(r) - pull_mean).powi(2);
        let n = all.len() as f64;
        let pull_std = (mean(&square) * n / (n - 1.0).max(1.0)).sqrt();
        Row::new()
            .with("calibration", calibration)
            .with("quantity", quantity)
            .with("unit", all[0].unit)
            .with("benches", benches.len())
            .with("numbers", all.len())
            .with("true", mean(&|r| r.truth))
            .with("recovered", mean(&|r| r.found.value))
            .with(
                "rms_error",
                mean(&|r| (r.found.value - r.truth).powi(2)).sqrt(),
            )
            .with("stated_std", mean(&|r| r.found.std.powi(2)).sqrt())
            .with("pull_mean", pull_mean)
            .with("pull_mean_se", standard_error(&of_benches(&pull)))
            .with("pull_std", pull_std)
            .with(
                "pull_std_se",
                standard_error(&of_benches(&square)) / (2.0 * pull_std),
            )
    };
    quantities.into_iter().map(row).collect()
}

fn average(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), x| (sum + x, n + 1.0));
    sum / n
}

/// Of the mean of independent values.
fn standard_error(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = average(values.iter().copied());
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    (squares / (n - 1.0) / n).sqrt()
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let rows = &table.rows;
    // A number under every row would be one black bar.
    let step = match rows.len() {
        0..=15 => 1,
        count => 5 * count.div_ceil(50),
    };
    let numbers = (1..=rows.len())
        .filter(|row| row % step == 0)
        .map(|row| (row as f64, row.to_string()));
    let x = Axis::with_ticks(
        0.5..rows.len() as f64 + 0.5,
        numbers.collect(),
        "row of the table",
    );
    let panel = |title: &str, column: &str, expected: f64, range: Range<f64>| {
        let number = |row: &Row, column: &str| row.number(column).unwrap_or(f64::NAN);
        let points: Vec<[f64; 3]> = (1..)
            .map(f64::from)
            .zip(rows)
            .map(|(at, row)| {
                let se = number(row, &format!("{column}_se"));
                [at, number(row, column), se]
            })
            .filter(|point| point.iter().all(|x| x.is_finite()))
            .collect();
        let end = rows.len() as f64 + 0.5;
        let line = vec![[0.5, expected], [end, expected]];
        // What is beyond is drawn at the edge.
        let inside = |y: f64| y.clamp(range.start, range.end);
        let dots = points.iter().map(|&[x, y, _]| [x, inside(y)]).collect();
        let bars = points
            .iter()
            .map(|&[x, y, se]| [x, inside(y - se), inside(y + se)])
            .filter(|[_, low, high]| high - low > 1e-3);
        Chart {
            title: title.to_owned(),
            x: x.clone(),
            y: Axis::linear(range.clone(), "pulls"),
            series: vec![
                Series::new("of a calibration that is right", 0, Mark::Line, line),
                Series::new("found, ± one standard error", 1, Mark::Dots, dots)
                    .within(bars.collect()),
            ],
        }
    };
    Ok(vec![charts(
        "pulls",
        1,
        &[
            panel("Mean pull", "pull_mean", 0.0, -2.0..2.0),
            panel("Spread of pulls", "pull_std", 1.0, 0.0..2.0),
        ],
    )])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_pools_what_has_one_name() {
        let one = |quantity, truth, value| Recovered {
            quantity,
            unit: "DN",
            truth,
            found: Measured { value, std: 0.5 },
        };
        let rows = summaries(
            "x",
            &[
                vec![one("a", 1.0, 1.5), one("b", 0.0, 0.0)],
                vec![one("a", 3.0, 2.0), one("b", 0.0, 0.0)],
            ],
        );
        assert_eq!(rows.len(), 2);
        let number = |column| rows[0].number(column).unwrap();
        assert_eq!(rows[0].text("quantity"), "a");
        assert_eq!(number("true"), 2.0);
        assert_eq!(number("recovered"), 1.75);
        // Pulls of 1 and -2.
        assert_eq!(number("pull_mean"), -0.5);
        assert!((number("pull_std") - 4.5f64.sqrt()).abs() < 1e-12);
        assert!((number("rms_error") - 0.625f64.sqrt()).abs() < 1e-12);
        assert!((number("pull_mean_se") - 1.5).abs() < 1e-12);
        // Both squares are 2.25: no scatter.
        assert_eq!(number("pull_std_se"), 0.0);
    }

    /// Seconds each without optimisation; the same photographs are tested with their
    /// calibrations.
    const SLOW: [&str; 4] = ["lights", "camera", "telecentric", "pose"];

    /// Calibrations run, and no pull of a bench is out of all bounds: 6 standard
    /// deviations.
    #[test]
    fn each_calibration_recovers_the_truth_of_a_bench() {
        for (name, _, calibrate) in CALIBRATIONS {
            if SLOW.iter().any(|slow| name.starts_with(slow)) {
                continue;
            }
            let found = calibrate(5).unwrap();
            assert!(!found.is_empty(), "{name}");
            for r in found {
                let pull = (r.found.value - r.truth) / r.found.std;
                assert!(pull.abs() < 6.0, "{name}, {}: {pull}", r.quantity);
            }
        }
    }
}
