//! Fig. 4: what more lights add, for each shape.

use std::sync::Arc;

use super::experiment::{
    Case, EvaluateError, Experiment, Row, Scale, Spread, Table, doublings, quantile, spread,
};
use super::lab::{Lab, Material, Sample, of_materials};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Five shapes, 1 to 16 lights.
pub static LIGHT_COUNT: Experiment = Experiment {
    name: "light-count",
    shows: "Fig. 4: error against the number of lights for the five shapes, mean and median over the materials with 95% confidence, the floor as a line",
    full: Scale {
        lights: 16,
        ..Scale::FULL_SIZE
    },
    quick: Scale {
        lights: 4,
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let counts = (0..7).map(|k| 1usize << k);
    let counts = counts.filter(|&n| n <= lab.settings.lights);
    let variants: Vec<(Sample, usize)> = Sample::ALL
        .into_iter()
        .flat_map(|sample| counts.clone().map(move |n| (sample, n)))
        .collect();
    let name = |(sample, lights): (Sample, usize)| format!("{}/{lights}", sample.name());
    Ok(of_materials(lab, &variants, name, one))
}

fn one(
    lab: &Lab,
    material: &Arc<Material>,
    (sample, lights): (Sample, usize),
) -> Result<Vec<Row>, EvaluateError> {
    let estimate = lab.measure(sample, lights, material)?;
    let row = material
        .row(sample)
        .with("lights", lights)
        .with("paths_per_pixel", estimate.fit.samples[0]);
    Ok(vec![
        row.and(lab.score_row(&estimate.fit.material, material)?),
    ])
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let counts = table.numbers("lights");
    let last = counts.last().copied().unwrap_or(1.0).log2();
    let x = doublings(&counts, "number of lights");
    // Curves of the shapes, and levels of the dictionary.
    let panel = |title: &str, of: fn(&Spread) -> (f64, [f64; 2])| {
        let mut series: Vec<Series> = Sample::ALL
            .iter()
            .enumerate()
            .map(|(color, sample)| {
                let at = |n: f64| {
                    let errors = table.figures("environment_error", |row| {
                        row.text("shape") == sample.name() && row.number("lights") == Some(n)
                    });
                    spread(&errors).map(|s| of(&s))
                };
                let found: Vec<_> = counts.iter().filter_map(|&n| Some((n, at(n)?))).collect();
                let points = found.iter().map(|(n, (v, _))| [n.log2(), v.log10()]);
                let band = found
                    .iter()
                    .map(|(n, (_, [low, high]))| [n.log2(), low.log10(), high.log10()]);
                Series::new(sample.name(), color, Mark::Points, points.collect())
                    .within(band.collect())
            })
            .collect();
        for (column, label, color) in [
            ("reference_projection", "reference projection", 6),
            ("floor", "floor", 7),
        ] {
            // Of the materials, each once.
            let per_material: Vec<f64> = table
                .texts("material")
                .iter()
                .filter_map(|name| {
                    table
                        .rows
                        .iter()
                        .find(|row| row.text("material") == *name)?
                        .number(column)
                })
                .collect();
            if let Some(s) = spread(&per_material) {
                let level = of(&s).0.max(1e-4).log10();
                let line = vec![[-0.15, level], [last + 0.15, level]];
                series.push(Series::new(label, color, Mark::Dashed, line));
            }
        }
        Chart {
            title: title.to_owned(),
            x: x.clone(),
            y: Axis::decades(range(table), "environment error (relative)"),
            series,
        }
    };
    Ok(vec![charts(
        "light-count",
        2,
        &[
            panel("mean over materials", |s| (s.mean, s.mean_95)),
            panel("median over materials", |s| (s.median, s.median_95)),
        ],
    )])
}

/// Half a decade beyond what is typical.
fn range(table: &Table) -> std::ops::Range<f64> {
    let all = table.figures("environment_error", |_| true);
    let low = quantile(&table.figures("floor", |_| true), 0.5).max(1e-3);
    let low = low.min(quantile(&all, 0.05).max(1e-3)).log10();
    (low - 0.3)..(quantile(&all, 0.98).log10() + 0.2)
}
