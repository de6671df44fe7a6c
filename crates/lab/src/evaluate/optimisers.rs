//! Loss against work: Gauss–Newton, the paper's exponentiated gradient, and the
//! single-bounce start.

use std::sync::Arc;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::{Lab, Material, Sample, of_materials};
use crate::inverse::exponentiated_gradient::ExponentiatedGradient;
use crate::inverse::gauss_newton::GaussNewton;
use crate::inverse::{FitOptions, Optimizer};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};

/// One objective and one start, several optimisers.
pub static OPTIMISERS: Experiment = Experiment {
    name: "optimisers",
    shows: "Loss against passes over the paths and seconds, one objective and one start (the single-bounce solution) for all: Gauss–Newton, and exponentiated gradient at three rates",
    full: Scale {
        resolution_px: 48,
        materials: &["bundled", "synthetic", "in-span"],
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        samples_per_pixel: 128,
        materials: &["nbrdf:pvc", "synthetic:cream-satin"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 3] = [Sample::ConcaveCorner, Sample::Bowl, Sample::Designed];

/// Passes of the exponentiated gradient.
const PASSES: usize = 300;

fn methods() -> Vec<(String, Optimizer)> {
    let mut methods = vec![(
        "Gauss–Newton".to_owned(),
        Optimizer::GaussNewton(GaussNewton::default()),
    )];
    for rate in [0.03, 0.1, 0.3] {
        let method = ExponentiatedGradient {
            rate,
            max_steps: PASSES,
            ..ExponentiatedGradient::default()
        };
        methods.push((
            format!("exponentiated gradient, rate {rate}"),
            Optimizer::ExponentiatedGradient(method),
        ));
    }
    methods
}

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    Ok(of_materials(lab, &SHAPES, |s| s.name().to_owned(), compare))
}

/// All methods on one image, one after the other, so that their times compare.
fn compare(lab: &Lab, material: &Arc<Material>, sample: Sample) -> Result<Vec<Row>, EvaluateError> {
    let lights = sample.lights(1);
    let captured = lab.capture(sample, &lights, &*material.brdf)?;
    let scene = sample.scene(lab.settings.resolution_px, lights)?;
    let mut rows = Vec::new();
    for (name, optimizer) in methods() {
        let options = FitOptions {
            optimizer,
            rounds: 1,
            // One loss for all, on the same paths.
            adapt_paths: false,
            // Where the optimisers themselves end.
            posterior_samples: 0,
            ..lab.fit_options_for(material)
        };
        let estimate = lab.fit_with(&scene, &captured, &lab.dictionary, &options)?;
        let error = lab
            .score(&estimate.fit.material, &*material.brdf)
            .environment;
        let start = lab.score(&estimate.start, &*material.brdf).environment;
        let trace = &estimate.fit.trace;
        let begin = trace.first().map_or(0.0, |(seconds, _)| *seconds);
        let mut best = f64::INFINITY;
        for (pass, (seconds, step)) in trace.iter().enumerate() {
            best = best.min(step.loss.iter().sum());
            rows.push(
                Row::new()
                    .with("material", material.name.as_str())
                    .with("shape", sample.name())
                    .with("optimiser", name.as_str())
                    .with("pass", pass + 1)
                    .with("seconds", seconds - begin)
                    .with("best_loss", best)
                    .with("final_environment_error", error)
                    .with("start_environment_error", start),
            );
        }
    }
    Ok(rows)
}

/// Per shape: how far the loss still is above the lowest one that any method found, over
/// what it was at the common start; and the errors where the methods end.
fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    // Loss over passes, a panel per shape.
    let materials = table.texts("material");
    let mut panels = Vec::new();
    for sample in SHAPES {
        let losses = |material: &str, optimiser: &str| {
            table.figures("best_loss", |row| {
                row.text("shape") == sample.name()
                    && row.text("material") == material
                    && (optimiser.is_empty() || row.text("optimiser") == optimiser)
            })
        };
        let mut series = Vec::new();
        for (color, (name, _)) in methods().iter().enumerate() {
            let mut points = Vec::new();
            for step in 0..=16 {
                let pass = 2f64.powf(0.5 * f64::from(step)).round();
                let gaps: Vec<f64> = materials
                    .iter()
                    .filter_map(|material| {
                        let all = losses(material, "");
                        let lowest = all.iter().copied().fold(f64::INFINITY, f64::min);
                        let highest = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                        let own = losses(material, name);
                        let at = own.get((pass as usize).min(own.len()).checked_sub(1)?)?;
                        Some((at - lowest) / (highest - lowest))
                    })
                    .collect();
                let gap = quantile(&gaps, 0.5);
                if gap.is_finite() {
                    points.push([pass.log10(), gap.max(1e-5).log10()]);
                }
            }
            series.push(Series::new(name, color, Mark::Line, points));
        }
        panels.push(Chart {
            title: format!("{}, median over materials", sample.name()),
            x: Axis::decades(0.0..2.5, "passes over the paths"),
            y: Axis::decades(-5.0..0.1, "excess loss / excess of the start"),
            series,
        });
    }
    // Where the optimisers end.
    let ticks = (0..SHAPES.len()).map(|i| (i as f64, SHAPES[i].name().to_owned()));
    let mut series = Vec::new();
    for (color, (name, _)) in methods().iter().enumerate() {
        let mut points = Vec::new();
        for (i, sample) in SHAPES.iter().enumerate() {
            let errors = table.figures("final_environment_error", |row| {
                row.text("shape") == sample.name()
                    && row.text("optimiser") == name
                    && row.number("pass") == Some(1.0)
            });
            let x = i as f64 + 0.15 * (color as f64 - 1.5);
            points.extend(errors.iter().map(|e| [x, e.max(1e-4).log10()]));
        }
        series.push(Series::new(name, color, Mark::Dots, points));
    }
    panels.push(Chart {
        title: "where they end, every material".to_owned(),
        x: Axis::with_ticks(-0.5..2.5, ticks.collect(), "shape of the sample"),
        y: Axis::decades(-2.5..1.0, "environment error (relative)"),
        series,
    });
    Ok(vec![charts("optimisers", 2, &panels)])
}
