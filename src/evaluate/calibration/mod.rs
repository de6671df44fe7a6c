//! Whether each calibration finds what is true on the simulated bench, and how
//! well its stated uncertainties hold: pulls (error over stated uncertainty) of a
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

use rayon::prelude::*;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::lab::Lab;
use crate::calibration::record::Measured;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Every calibration on many simulated benches.
pub static CALIBRATION: Experiment = Experiment {
    name: "calibration",
    shows: "What each calibration finds on simulated benches beside what is true there: mean, stated uncertainty, and mean and standard deviation of the pulls (error over stated uncertainty)",
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
    /// What is true.
    pub truth: f64,
    /// What was found, with its stated uncertainty.
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
            let found: Vec<Recovered> = found.into_iter().flatten().collect();
            Ok(summaries(name, benches, &found))
        })
    };
    Ok(CALIBRATIONS.iter().map(case).collect())
}

/// One row per quantity, in the order of their first occurrence.
fn summaries(calibration: &str, benches: u64, found: &[Recovered]) -> Vec<Row> {
    let mut quantities: Vec<&str> = Vec::new();
    for one in found {
        if !quantities.contains(&one.quantity) {
            quantities.push(one.quantity);
        }
    }
    let row = |quantity: &str| {
        let of: Vec<&Recovered> = found.iter().filter(|r| r.quantity == quantity).collect();
        let n = of.len() as f64;
        let mean = |value: &dyn Fn(&Recovered) -> f64| of.iter().map(|r| value(r)).sum::<f64>() / n;
        let pull = |r: &Recovered| (r.found.value - r.truth) / r.found.std;
        let pull_mean = mean(&pull);
        let about = |r: &Recovered, power: i32| (pull(r) - pull_mean).powi(power);
        let variance = mean(&|r| about(r, 2)) * n / (n - 1.0).max(1.0);
        let pull_std = variance.sqrt();
        // Of a standard deviation of normal numbers.
        let pull_std_se = pull_std / (2.0 * (n - 1.0).max(1.0)).sqrt();
        Row::new()
            .with("calibration", calibration)
            .with("quantity", quantity)
            .with("unit", of[0].unit)
            .with("benches", benches)
            .with("numbers", of.len())
            .with("true", mean(&|r| r.truth))
            .with("recovered", mean(&|r| r.found.value))
            .with(
                "rms_error",
                mean(&|r| (r.found.value - r.truth).powi(2)).sqrt(),
            )
            .with("stated_std", mean(&|r| r.found.std.powi(2)).sqrt())
            .with("pull_mean", pull_mean)
            .with("pull_mean_se", pull_std / n.sqrt())
            .with("pull_std", pull_std)
            .with("pull_std_se", pull_std_se)
    };
    quantities.into_iter().map(row).collect()
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let rows = &table.rows;
    let numbers = (1..=rows.len()).map(|row| (row as f64, row.to_string()));
    let x = Axis::with_ticks(
        0.5..rows.len() as f64 + 0.5,
        numbers.collect(),
        "row of the table",
    );
    let panel = |title: &str, column: &str, expected: f64, y: Axis| {
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
        let dots = points.iter().map(|&[x, y, _]| [x, y]).collect();
        let bars = points.iter().map(|&[x, y, se]| [x, y - se, y + se]);
        Chart {
            title: title.to_owned(),
            x: x.clone(),
            y,
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
            panel(
                "Mean pull",
                "pull_mean",
                0.0,
                Axis::linear(-1.5..1.5, "mean"),
            ),
            panel(
                "Spread of pulls",
                "pull_std",
                1.0,
                Axis::linear(0.0..2.0, "standard deviation"),
            ),
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
            2,
            &[one("a", 1.0, 1.5), one("b", 0.0, 0.0), one("a", 3.0, 2.0)],
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
    }

    /// Every calibration runs, and no pull of a few benches is out of all bounds:
    /// 6 standard deviations.
    #[test]
    fn each_calibration_recovers_the_truth_of_a_bench() {
        for (name, _, calibrate) in CALIBRATIONS {
            let found = calibrate(5).unwrap();
            assert!(!found.is_empty(), "{name}");
            for r in found {
                let pull = (r.found.value - r.truth) / r.found.std;
                assert!(pull.abs() < 6.0, "{name}, {}: {pull}", r.quantity);
            }
        }
    }
}
