//! How accurate one image is: every material on every concave shape under one light, and on
//! the bowl under four, next to what the dictionary can reach.

use std::sync::Arc;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::samples::directional;
use super::lab::{Lab, Material, Sample, of_materials};
use crate::brdf::Dictionary;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::transport::Light;

/// The concave shapes and numbers of lights.
const SETTINGS: [(Sample, usize); 4] = [
    (Sample::ConcaveCorner, 1),
    (Sample::Bowl, 1),
    (Sample::Designed, 1),
    (Sample::Bowl, 4),
];

/// Errors of all materials, sorted, and their ratios to the reference projection.
pub static ACCURACY: Experiment = Experiment {
    name: "accuracy",
    shows: "environment error of every material from one image of the concave shapes and from four of the bowl, next to the reference projection and the floor of the same dictionary",
    full: Scale {
        materials: &["bundled", "in-span"],
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        dictionary: Dictionary::DEFAULT,
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        materials: &["nbrdf:pvc", "in-span:01"],
        dictionary: Dictionary::DEFAULT,
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let name = |(sample, lights): (Sample, usize)| format!("{}/{lights}", sample.name());
    Ok(of_materials(lab, &SETTINGS, name, one))
}

/// One alone stands where a plan has it in front of a bowl: 45° from the camera.
fn lights_of(sample: Sample, count: usize) -> Vec<Light> {
    match (sample, count) {
        (Sample::Bowl, 1) => vec![directional(45.0, 20.0)],
        _ => sample.lights(count),
    }
}

fn one(
    lab: &Lab,
    material: &Arc<Material>,
    (sample, lights): (Sample, usize),
) -> Result<Vec<Row>, EvaluateError> {
    let under = lights_of(sample, lights);
    let captured = lab.capture(sample, &under, &*material.brdf)?;
    let estimate = lab.fit(sample, &under, &captured, material)?;
    let start = lab.score(&estimate.start, &*material.brdf);
    let row = material
        .row(sample)
        .with("lights", lights)
        .with("paths_per_pixel", estimate.fit.samples[0])
        .with("reduced_chi2", estimate.mean_reduced_chi2())
        .with("start_error", start.environment);
    Ok(vec![
        row.and(lab.score_row(&estimate.fit.material, material)?),
    ])
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    // In the dictionary's span the projection is exact, so the error itself is shown.
    let in_span = panel(
        table,
        "in the dictionary's span",
        "environment_error",
        "environment error (relative)",
        true,
    );
    let outside = panel(
        table,
        "outside the span",
        "ratio_to_reference",
        "environment error / reference projection's",
        false,
    );
    Ok(vec![charts("accuracy", 2, &[in_span, outside])])
}

/// A figure of all materials of a class per setting, in ascending order.
fn panel(table: &Table, title: &str, column: &str, label: &str, in_span: bool) -> Chart {
    let of = |sample: Sample, lights: usize| {
        let mut values = table.figures(column, |row| {
            (row.text("class") == "in-span") == in_span
                && row.text("shape") == sample.name()
                && row.number("lights") == Some(lights as f64)
        });
        values.sort_by(f64::total_cmp);
        values
    };
    let mut all = Vec::new();
    let series = SETTINGS
        .iter()
        .enumerate()
        .map(|(color, &(sample, lights))| {
            let values = of(sample, lights);
            all.extend_from_slice(&values);
            let last = (values.len().max(2) - 1) as f64;
            let points = values
                .iter()
                .enumerate()
                .map(|(i, v)| [100.0 * i as f64 / last, v.max(1e-4).log10()]);
            let name = match lights {
                1 => sample.name().to_owned(),
                n => format!("{}, {n} lights", sample.name()),
            };
            Series::new(&name, color, Mark::Points, points.collect())
        })
        .collect();
    let (low, high) = if all.is_empty() {
        (0.01, 1.0)
    } else {
        (quantile(&all, 0.0).max(1e-4), quantile(&all, 1.0).max(2e-4))
    };
    Chart {
        title: title.to_owned(),
        x: Axis::linear(-3.0..103.0, "materials, in ascending order (%)"),
        y: Axis::decades(low.log10() - 0.1..high.log10() + 0.1, label),
        series,
    }
}
