//! Section 5: how many independent constraints one image puts on the weights.

use std::sync::Arc;

use nalgebra::DVector;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::capture::average;
use super::lab::{Lab, Material, Sample, of_materials};
use crate::inverse::Channels;
use crate::inverse::objective::Objective;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::radiance_image::RadianceImage;
use crate::transport::{Cache, DirectMatrix};

/// Spectrum of the Fisher information per shape.
pub static RANK: Experiment = Experiment {
    name: "rank",
    shows: "Section 5: spectrum of the information that one image of each shape with 1% noise gives on the weights, and the number of directions it determines",
    full: Scale {
        materials: &["bundled", "synthetic"],
        azimuths: 9,
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        samples_per_pixel: 1024,
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

/// Relative noise of the images, of which the objective's weights are made.
const NOISE: f64 = 0.01;
/// A direction is determined where its standard deviation is below this (weights sum to 1).
const DETERMINED: f64 = 0.1;

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    Ok(of_materials(
        lab,
        &Sample::ALL,
        |s| s.name().to_owned(),
        one,
    ))
}

fn one(lab: &Lab, material: &Arc<Material>, sample: Sample) -> Result<Vec<Row>, EvaluateError> {
    let weights = lab.cells().reference_projection(&*material.brdf)?;
    let information = information(lab, sample, &weights.weights()[1])?;
    let row = Row::new()
        .with("material", material.name.as_str())
        .with("shape", sample.name());
    Ok(spectrum(&information, row))
}

/// sym(J_Aᵀ W J_B) of the green channel at `weights`, in the directions that keep their
/// sum, W from [`NOISE`] alone.
fn information(
    lab: &Lab,
    sample: Sample,
    weights: &[f64],
) -> Result<nalgebra::DMatrix<f64>, EvaluateError> {
    let scene = sample.scene(lab.settings.resolution_px, sample.lights(1))?;
    let options = lab.fit_options();
    let (strata, seed) = (options.direct_strata, options.cache.seed);
    let resolution = lab.settings.resolution_px;
    let blank = RadianceImage::new(resolution, resolution);
    let captured = average(&scene, std::slice::from_ref(&blank), &lab.dictionary)?;
    let direct = DirectMatrix::new(&scene, &captured.cells, &lab.dictionary, strata, seed);
    let cache = Cache::trace(&scene, &captured.cells, &lab.dictionary, &options.cache)?;
    let objective = Objective::new(
        &cache,
        &direct,
        &captured,
        Channels::Shared,
        lab.kernel,
        NOISE,
    );
    let mixture = [DVector::from_column_slice(weights)];
    let dark = objective.linearise(&mixture, &objective.weights(None));
    // The weights that the render's own variance would shrink: noise alone.
    let mut model = dark.model;
    let values = model.iter_mut().flatten().flatten();
    values.for_each(|modelled| modelled.variance = 0.0);
    let pass = objective.linearise(&mixture, &objective.weights(Some(&model)));
    let n = weights.len();
    let centring =
        nalgebra::DMatrix::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - 1.0 / n as f64);
    // Shared weights sum three equal channels.
    Ok(&centring * &pass.information[0] * &centring / 3.0)
}

fn spectrum(information: &nalgebra::DMatrix<f64>, row: Row) -> Vec<Row> {
    let mut values: Vec<f64> = information
        .symmetric_eigenvalues()
        .iter()
        .copied()
        .collect();
    values.sort_by(|a, b| b.total_cmp(a));
    // Independent halves leave noise of either sign: what is no larger than the most
    // negative eigenvalue is not resolved.
    let noise = values.iter().copied().fold(0.0, f64::min).abs();
    let determined = values
        .iter()
        .filter(|&&v| v > noise && v > DETERMINED.powi(-2))
        .count();
    values
        .iter()
        .enumerate()
        .map(|(index, &value)| {
            row.clone()
                .with("index", index + 1)
                .with("eigenvalue", value)
                .with("resolved", u32::from(value > noise))
                .with("determined_directions", determined)
        })
        .collect()
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let mut series = Vec::new();
    for (color, sample) in Sample::ALL.iter().enumerate() {
        let of = |row: &Row| row.text("shape") == sample.name();
        let counts = table.figures("determined_directions", |row| {
            of(row) && row.number("index") == Some(1.0)
        });
        let median = quantile(&counts, 0.5);
        let points = table
            .numbers("index")
            .into_iter()
            .map(|index| {
                let values = table.figures("eigenvalue", |row| {
                    of(row) && row.number("index") == Some(index)
                });
                // Deviations of the weights along the direction.
                [index, -0.5 * quantile(&values, 0.5).max(1e-30).log10()]
            })
            .filter(|[_, y]| *y < 6.0)
            .collect();
        let label = format!("{}: {median} determined", sample.name());
        series.push(Series::new(&label, color, Mark::Points, points));
    }
    let limit = DETERMINED.log10();
    series.push(Series::new(
        "limit",
        7,
        Mark::Dashed,
        vec![[0.0, limit], [43.0, limit]],
    ));
    Ok(vec![charts(
        "rank",
        1,
        &[Chart {
            title: "median over materials".to_owned(),
            x: Axis::linear(0.0..43.0, "direction, best determined first"),
            y: Axis::decades(-4.0..6.0, "standard deviation of the weights"),
            series,
        }],
    )])
}
