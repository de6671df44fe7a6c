//! Fig. 2 and Section 5: how well one image of each shape determines a material.

use std::sync::Arc;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::{Lab, Material, Sample, of_materials};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// One image per shape and material.
pub static SHAPES: Experiment = Experiment {
    name: "shapes",
    shows: "Fig. 2: error of the BRDF recovered from one image of each shape, next to the reference projection and the floor of the dictionary",
    full: Scale::SINGLE_IMAGE,
    quick: Scale::QUICK_IMAGE,
    cases,
    figures,
};

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    Ok(of_materials(
        lab,
        &Sample::ALL,
        |s| s.name().to_owned(),
        one,
    ))
}

fn one(lab: &Lab, material: &Arc<Material>, sample: Sample) -> Result<Vec<Row>, EvaluateError> {
    let estimate = lab.measure(sample, 1, material)?;
    let row = material.row(sample);
    let start = lab.score(&estimate.start, &*material.brdf);
    Ok(vec![
        row.and(lab.score_row(&estimate.fit.material, material)?)
            .with("environment_error_single_bounce", start.environment)
            .with("reduced_chi2", estimate.mean_reduced_chi2()),
    ])
}

/// One dot per material and shape, medians as lines.
fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let columns = [
        ("environment_error", "estimate"),
        ("reference_projection", "reference projection"),
        ("floor", "floor"),
    ];
    let shapes = Sample::ALL.map(Sample::name);
    let ticks = |at: &dyn Fn(usize) -> f64| {
        let name = |(i, name): (usize, &&str)| (at(i), name.replace(" corner", ""));
        shapes.iter().enumerate().map(name).collect::<Vec<_>>()
    };
    let x = Axis::with_ticks(-0.5..4.5, ticks(&|i| i as f64), "shape of the sample");
    let panels: Vec<Chart> = table
        .texts("class")
        .into_iter()
        .map(|class| {
            let mut series = Vec::new();
            let mut medians = Vec::new();
            for (color, (column, label)) in columns.into_iter().enumerate() {
                let offset = 0.24 * (color as f64 - 1.0);
                let mut dots = Vec::new();
                for (i, shape) in shapes.iter().enumerate() {
                    let errors = table.figures(column, |row| {
                        row.text("class") == class && row.text("shape") == *shape
                    });
                    let at = i as f64 + offset;
                    dots.extend(errors.iter().map(|e| [at, e.max(1e-4).log10()]));
                    let median = quantile(&errors, 0.5).max(1e-4).log10();
                    let line = vec![[at - 0.1, median], [at + 0.1, median]];
                    medians.push(Series::new("", 7, Mark::Line, line));
                }
                series.push(Series::new(label, color, Mark::Dots, dots));
            }
            series.extend(medians);
            Chart {
                title: format!("{class} materials"),
                x: x.clone(),
                y: Axis::decades(-3.0..1.0, "environment error (relative)"),
                series,
            }
        })
        .collect();
    Ok(vec![charts("shapes", 2, &panels)])
}
