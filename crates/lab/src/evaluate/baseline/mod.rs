//! An outside method under the same scores: linear reconstruction from few samples (Nielsen,
//! Jensen and Ramamoorthi 2015), learned from the embedded materials without the tested one.

mod components;
mod directions;

use std::sync::{Arc, OnceLock};

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::{Lab, Material};
use crate::brdf::TabulatedBrdf;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::random::{Purpose, stream};
use components::Components;
pub(super) use components::Training;
pub(super) use directions::{LEAST_COSINE, Pair};
use directions::{best_lights, best_pairs, candidates, sphere_pairs};

/// Errors of all materials, sorted, for every kind of measurement.
pub static BASELINE: Experiment = Experiment {
    name: "baseline",
    shows: "the method of Nielsen, Jensen and Ramamoorthi (2015), learned without the tested material: environment error from 1, 2, 5 and 20 directions and from one and two images of a sphere",
    full: Scale {
        resolution_px: 64,
        sphere_px: 128,
        azimuths: 9,
        materials: &["bundled"],
        ..Scale::NONE
    },
    quick: Scale {
        resolution_px: 16,
        sphere_px: 24,
        azimuths: 3,
        materials: &["nbrdf:pvc"],
        ..Scale::NONE
    },
    cases,
    figures,
};

/// Nodes of the training's tables in θh, θd, φd.
const SHAPE: [usize; 3] = [90, 90, 20];
/// Those of the small version.
const QUICK_SHAPE: [usize; 3] = [30, 30, 6];

/// η as published, for 300 training columns (100 materials).
const PUBLISHED_RIDGE: f64 = 40.0;
/// See [`PUBLISHED_RIDGE`].
const PUBLISHED_COLUMNS: f64 = 300.0;

/// Standard deviation of every measured value, relative to it.
const NOISE: f64 = 0.01;

/// What is measured.
#[derive(Clone, Copy)]
enum Samples {
    Directions(usize),
    SphereImages(usize),
    /// All candidate directions: what the components themselves can describe.
    Candidates,
}

/// In the order of the table.
const VARIANTS: [Samples; 7] = [
    Samples::Directions(1),
    Samples::Directions(2),
    Samples::Directions(5),
    Samples::Directions(20),
    Samples::SphereImages(1),
    Samples::SphereImages(2),
    Samples::Candidates,
];

impl Samples {
    fn name(self) -> String {
        let counted = |n: usize, what: &str| match n {
            1 => format!("1 {what}"),
            n => format!("{n} {what}s"),
        };
        match self {
            Samples::Directions(n) => counted(n, "direction"),
            Samples::SphereImages(n) => counted(n, "sphere image"),
            Samples::Candidates => "all directions".to_owned(),
        }
    }
}

/// One case for each material, for its components serve all measurements.
fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let training = Arc::new(OnceLock::new());
    let case = |material: &Arc<Material>| {
        let (training, material) = (training.clone(), material.clone());
        Case::new(material.name.clone(), move |lab: &Lab| {
            let shape = table_shape(lab);
            let training = training.get_or_init(|| Training::embedded(shape));
            one(lab, training, shape, &material)
        })
    };
    Ok(lab.materials.iter().map(case).collect())
}

/// Nodes of the tables of a run.
pub(super) fn table_shape(lab: &Lab) -> [usize; 3] {
    match lab.settings.quick {
        true => QUICK_SHAPE,
        false => SHAPE,
    }
}

/// Prior and noise weigh as published: the coefficients' variance is one over the number of
/// columns, so η grows with it.
fn ridge(components: &Components<'_>) -> f64 {
    PUBLISHED_RIDGE * components.columns() as f64 / PUBLISHED_COLUMNS
}

/// What the method makes of values of f (1/sr) at pairs of directions, having learned from all
/// materials but this one.
pub(super) fn linear(
    training: &Training,
    material: &Material,
    pairs: &[Pair],
    values: &[[f64; 3]],
) -> Result<TabulatedBrdf, EvaluateError> {
    let components = training.without(&material.name);
    let at = components.rows(pairs);
    Ok(components.reconstruct(&at, values, ridge(&components))?)
}

fn one(
    lab: &Lab,
    training: &Training,
    shape: [usize; 3],
    material: &Material,
) -> Result<Vec<Row>, EvaluateError> {
    let truth = &*material.brdf;
    let components = training.without(&material.name);
    let ridge = ridge(&components);
    let table = TabulatedBrdf::from_brdf(shape, truth);
    let table_error = lab.score(&table, truth).environment;
    let mut rows = Vec::new();
    for (variant, samples) in VARIANTS.into_iter().enumerate() {
        let measured = measurement(&components, samples, ridge, lab);
        let values = noisy_values(lab, variant, material, &measured.pairs);
        let at = components.rows(&measured.pairs);
        let estimate = components.reconstruct(&at, &values, ridge)?;
        let unscaled = components.reconstruct(&at, &values, PUBLISHED_RIDGE)?;
        let row = Row::new()
            .with("material", material.name.as_str())
            .with("class", material.class.name())
            .with("samples", samples.name())
            .with("observations", values.len())
            .with("components", components.fitted(values.len()))
            .with("condition_number", measured.condition_number)
            .with("lights_deg", measured.lights_deg)
            .with("ridge", ridge)
            .and(lab.score_row(&estimate, material)?)
            .with(
                "environment_error_ridge_40",
                lab.score(&unscaled, truth).environment,
            )
            .with("table_error", table_error);
        rows.push(row);
    }
    Ok(rows)
}

/// Pairs of directions with what chose them.
struct Measurement {
    pairs: Vec<Pair>,
    /// Of single directions alone.
    condition_number: Option<f64>,
    /// Angles between light and camera; empty for single directions.
    lights_deg: String,
}

fn measurement(
    components: &Components<'_>,
    samples: Samples,
    ridge: f64,
    lab: &Lab,
) -> Measurement {
    match samples {
        Samples::Directions(count) => {
            let choice = best_pairs(components, count, lab.settings.seed);
            Measurement {
                pairs: choice.chosen,
                condition_number: Some(choice.condition_number),
                lights_deg: String::new(),
            }
        }
        Samples::SphereImages(images) => {
            let choice = best_lights(components, images, ridge);
            let size = lab.settings.resolution_px;
            let image = |&angle: &f64| sphere_pairs(size, angle);
            let shown: Vec<String> = choice.angles_deg.iter().map(f64::to_string).collect();
            Measurement {
                pairs: choice.angles_deg.iter().flat_map(image).collect(),
                condition_number: None,
                lights_deg: shown.join(" "),
            }
        }
        Samples::Candidates => Measurement {
            pairs: candidates(),
            condition_number: None,
            lights_deg: String::new(),
        },
    }
}

/// The material's f at `pairs`, each channel with noise of its own.
fn noisy_values(lab: &Lab, variant: usize, material: &Material, pairs: &[Pair]) -> Vec<[f64; 3]> {
    let value = |(at, &(to_light, to_viewer)): (usize, &Pair)| {
        let (variant, at) = (variant as u64, at as u64);
        let mut numbers = stream(lab.settings.seed, Purpose::Experiment, 2, variant, at);
        let f = material.brdf.eval(to_light, to_viewer);
        f.map(|f| (f64::from(f) * (1.0 + NOISE * numbers.normal())).max(0.0))
    };
    pairs.iter().enumerate().map(value).collect()
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let mut all = Vec::new();
    let mut series = Vec::new();
    for (color, samples) in VARIANTS.into_iter().enumerate() {
        let name = samples.name();
        let mut errors = table.figures("environment_error", |row| row.text("samples") == name);
        errors.sort_by(f64::total_cmp);
        all.extend_from_slice(&errors);
        let last = (errors.len().max(2) - 1) as f64;
        let points = errors
            .iter()
            .enumerate()
            .map(|(i, e)| [100.0 * i as f64 / last, e.max(1e-4).log10()]);
        series.push(Series::new(&name, color, Mark::Points, points.collect()));
    }
    let decade = |p: f64| quantile(&all, p).max(1e-4).log10();
    let shown = Chart {
        title: "learned without the material".to_owned(),
        x: Axis::linear(-3.0..103.0, "materials, in ascending order (%)"),
        y: Axis::decades(
            decade(0.0) - 0.1..decade(1.0) + 0.1,
            "environment error (relative)",
        ),
        series,
    };
    Ok(vec![charts("baseline", 1, &[shown])])
}
