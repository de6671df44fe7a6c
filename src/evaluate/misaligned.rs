//! A bench that is not exactly as described: what that costs, and what refining it returns.

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::{Lab, Material, Sample};
use super::misalignment::{self, Misalignment, judge};
use crate::inverse::RefineOptions;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// Known, unrefined and refined benches.
pub static MISALIGNMENT: Experiment = Experiment {
    name: "misalignment",
    shows: "Error with an exactly known bench, with one described wrongly (lights 0.5°, intensities 2%, pose 0.3° and 0.6% of the sample's width), and with that bench refined",
    full: Scale {
        lights: 4,
        materials: &["bundled", "synthetic", "in-span"],
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        lights: 2,
        materials: &["synthetic:cream-satin"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 3] = [Sample::ConcaveCorner, Sample::Bowl, Sample::Designed];

/// 0.3 mm on a sample 50 mm wide.
const BENCH: Misalignment = Misalignment {
    light_deg: 0.5,
    intensity: 0.02,
    rotation_deg: 0.3,
    translation_mm: 0.012,
};

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let benches: u64 = if lab.settings.quick { 1 } else { 4 };
    let mut cases = Vec::new();
    for material in &lab.materials {
        for sample in SHAPES {
            for bench in 0..benches {
                let material = material.clone();
                let key = format!("{}/{}/{bench}", material.name, sample.name());
                cases.push(Case::new(key, move |lab: &Lab| {
                    one(lab, sample, &material, bench)
                }));
            }
        }
    }
    Ok(cases)
}

fn one(
    lab: &Lab,
    sample: Sample,
    material: &Material,
    bench: u64,
) -> Result<Vec<Row>, EvaluateError> {
    let lights = sample.lights(lab.settings.lights);
    let resolution = lab.settings.resolution_px;
    let settings = misalignment::Settings {
        dictionary: lab.dictionary.clone(),
        fit: lab.fit_options(),
        refine: RefineOptions::default(),
        true_samples: lab.settings.truth_samples_per_pixel,
        sphere_px: lab.settings.sphere_px,
    };
    let case = misalignment::Case {
        described: &sample.scene(resolution, lights.clone())?,
        fine: &sample.true_scene(resolution, lights)?,
        material: &*material.brdf,
        misalignment: BENCH,
        priors: BENCH.priors(),
        seed: lab.settings.seed.wrapping_mul(1000).wrapping_add(bench),
    };
    let outcome = judge(&case, &settings)?;
    Ok(vec![
        Row::new()
            .with("material", material.name.as_str())
            .with("class", material.class.name())
            .with("shape", sample.name())
            .with("bench", bench)
            .with("environment_error_known", outcome.known)
            .with("environment_error_unrefined", outcome.unrefined)
            .with("environment_error_refined", outcome.refined)
            .with("unrefined_over_known", outcome.unrefined / outcome.known)
            .with("refined_over_known", outcome.refined / outcome.known),
    ])
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let ticks = (0..SHAPES.len()).map(|i| (i as f64, SHAPES[i].name().to_owned()));
    let (mut series, mut medians) = (Vec::new(), Vec::new());
    for (color, (column, label)) in [
        ("environment_error_known", "known bench"),
        ("environment_error_unrefined", "described bench"),
        ("environment_error_refined", "refined bench"),
    ]
    .into_iter()
    .enumerate()
    {
        let mut points = Vec::new();
        for (i, sample) in SHAPES.iter().enumerate() {
            let errors = table.figures(column, |row| row.text("shape") == sample.name());
            let at = i as f64 + 0.24 * (color as f64 - 1.0);
            let log = |error: f64| error.max(1e-4).log10();
            points.extend(errors.iter().map(|&e| [at, log(e)]));
            let median = log(quantile(&errors, 0.5));
            let line = vec![[at - 0.1, median], [at + 0.1, median]];
            medians.push(Series::new("", 7, Mark::Line, line));
        }
        series.push(Series::new(label, color, Mark::Dots, points));
    }
    series.extend(medians);
    Ok(vec![charts(
        "misalignment",
        1,
        &[Chart {
            title: "every material and bench; lines are medians".to_owned(),
            x: Axis::with_ticks(-0.5..2.5, ticks.collect(), "shape of the sample"),
            y: Axis::decades(-3.0..1.0, "environment error (relative)"),
            series,
        }],
    )])
}
