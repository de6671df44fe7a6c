//! How much error a sensor adds: bit depth, full well, number of exposures.

use std::sync::Arc;

use super::experiment::{Case, EvaluateError, Experiment, Medians, Row, Scale, Table, doublings};
use super::lab::capture::photograph;
use super::lab::{Lab, Material, Sample, of_materials};
use crate::plot::{Axis, Chart, Figure, charts};
use crate::simulation::photograph::Photographer;

/// One image through sensors from poor to good.
pub static NOISE: Experiment = Experiment {
    name: "noise",
    shows: "Error from one image taken by sensors of several bit depths and full wells, with one exposure (the brightest 2% clip) or a bracket, over the error from the noise-free image",
    full: Scale::FULL_SIZE,
    quick: Scale {
        materials: &["nbrdf:pvc", "synthetic:cream-satin"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 3] = [Sample::Sphere, Sample::Bowl, Sample::Designed];

/// Name, bits, full well e⁻, read noise e⁻.
const SENSORS: [(&str, u32, f64, f64); 4] = [
    ("8 bit, 10 000 e⁻", 8, 10_000.0, 8.0),
    ("10 bit, 10 000 e⁻", 10, 10_000.0, 8.0),
    ("12 bit, 10 000 e⁻", 12, 10_000.0, 2.4),
    ("12 bit, 30 000 e⁻", 12, 30_000.0, 5.0),
];
const EXPOSURES: [u32; 3] = [1, 2, 4];

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    Ok(of_materials(lab, &SHAPES, |s| s.name().to_owned(), one))
}

/// One truth through every sensor.
fn one(lab: &Lab, material: &Arc<Material>, sample: Sample) -> Result<Vec<Row>, EvaluateError> {
    let lights = sample.lights(1);
    let captured = lab.capture(sample, &lights, &*material.brdf)?;
    let scene = sample.scene(lab.settings.resolution_px, lights)?;
    let row = |sensor: &str, exposures: u32| {
        Row::new()
            .with("material", material.name.as_str())
            .with("shape", sample.name())
            .with("sensor", sensor)
            .with("exposures", exposures)
    };
    let clean = lab.fit_scene(&scene, &captured, material)?;
    let noise_free = lab.score(&clean.fit.material, &*material.brdf).environment;
    let mut rows = vec![row("noise-free", 0).and(lab.score_row(&clean.fit.material, material)?)];
    for (name, bit_depth, full_well_e, read_noise_e) in SENSORS {
        for exposures in EXPOSURES {
            let photographer = Photographer {
                bit_depth,
                full_well_e,
                read_noise_e,
                exposures,
                frames: 1,
                seed: lab.settings.seed,
            };
            let taken = photograph(&photographer, &captured)?;
            let estimate = lab.fit_scene(&scene, &taken, material)?;
            let scores = lab.score_row(&estimate.fit.material, material)?;
            let ratio = scores.number("environment_error").map(|e| e / noise_free);
            rows.push(
                row(name, exposures)
                    .and(scores)
                    .with("over_noise_free", ratio),
            );
        }
    }
    Ok(rows)
}

fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let exposures = EXPOSURES.map(f64::from);
    let x = doublings(&exposures, "exposures, each 4 times the one before");
    let ratios = Medians {
        table,
        column: "over_noise_free",
        x_column: "exposures",
        x: &exposures,
        position: f64::log2,
    };
    let panel = |sample: Sample| {
        let series = SENSORS.iter().enumerate().map(|(color, (sensor, ..))| {
            ratios.series(sensor, color, |row| {
                row.text("shape") == sample.name() && row.text("sensor") == *sensor
            })
        });
        Chart {
            title: format!("{}, median over materials", sample.name()),
            x: x.clone(),
            y: Axis::decades(-0.5..1.0, "error / error without noise"),
            series: series.collect(),
        }
    };
    Ok(vec![charts("noise", 3, &SHAPES.map(panel))])
}
