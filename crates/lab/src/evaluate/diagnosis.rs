//! How often a fit detects a defect, and how often it names the right cause.

use std::sync::Arc;

use glam::DVec3;

use super::defects::Defect;
use super::designs::Design;
use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table};
use super::intervals::{capture, material, of_class, options};
use super::lab::materials::Class;
use super::lab::samples::{BELIEVED_SEGMENTS, TRUE_SEGMENTS};
use super::lab::{Lab, Sample};
use crate::brdf::{Brdf, Dictionary};
use crate::inverse::diagnosis::Cause;
use crate::plot::Figure;
use crate::transport::Scene;

/// Rates of warnings and of the named causes.
pub static DIAGNOSIS: Experiment = Experiment {
    name: "diagnosis",
    shows: "How often a fit warns, and which cause it names, on sound captures and on captures with a defect that the fit's model does not include",
    full: Scale {
        resolution_px: 16,
        samples_per_pixel: 256,
        truth_samples_per_pixel: 512,
        lights: 2,
        materials: &["in-span", "bundled"],
        dictionary: Dictionary::DEFAULT,
        ..Scale::NONE
    },
    quick: Scale {
        resolution_px: 16,
        samples_per_pixel: 128,
        truth_samples_per_pixel: 256,
        lights: 2,
        materials: &["in-span", "bundled"],
        dictionary: Dictionary::DEFAULT,
        ..Scale::NONE
    },
    cases,
    figures: |_, _: &Table| -> Result<Vec<Figure>, EvaluateError> { Ok(Vec::new()) },
};

/// Samples, each before a camera and lamps of its own.
const SAMPLES: [&str; 3] = ["bowl", "ridge", "ball"];

/// Captures per defect and sample.
const CAPTURES: u64 = 100;
/// The same in the small version.
const QUICK_CAPTURES: u64 = 1;

/// Kinds of captures, with the cause that should be named.
const KINDS: [(&str, Option<Cause>); 7] = [
    ("sound, in span", None),
    ("sound, measured", None),
    ("second material", Some(Cause::NonUniform)),
    ("wrong depth", Some(Cause::ShapeOrPose)),
    ("wrong pose", Some(Cause::ShapeOrPose)),
    ("stray light", Some(Cause::StrayLight)),
    ("translucent", Some(Cause::Translucency)),
];

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let captures = if lab.settings.quick {
        QUICK_CAPTURES
    } else {
        CAPTURES
    };
    let mut cases = Vec::new();
    for (kind, (name, _)) in KINDS.iter().enumerate() {
        if of_class(lab, class_of(kind)).is_err() {
            continue;
        }
        for sample in SAMPLES {
            for index in 0..captures {
                let key = format!("{name}/{sample}/{index}");
                cases.push(Case::new(key, move |lab: &Lab| {
                    Ok(vec![one(lab, kind, sample, index)?])
                }));
            }
        }
    }
    Ok(cases)
}

/// What the samples of a kind are made of.
fn class_of(kind: usize) -> Class {
    match KINDS[kind].0 {
        "sound, measured" => Class::Measured,
        _ => Class::InSpan,
    }
}

fn defect(lab: &Lab, kind: usize, index: u64) -> Result<Option<Defect>, EvaluateError> {
    let sign = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
    Ok(match KINDS[kind].0 {
        "second material" => {
            let other: Arc<dyn Brdf> = material(lab, Class::InSpan, index + 3)?;
            Some(Defect::SecondMaterial(other))
        }
        "wrong depth" => Some(Defect::Depth(1.0 + 0.12 * sign as f32)),
        "wrong pose" => Some(Defect::Pose(
            DVec3::new(0.02 * sign, 0.015, 0.0),
            DVec3::new(0.02, -0.02 * sign, 0.0),
        )),
        "stray light" => Some(Defect::StrayLight(0.25)),
        "translucent" => Some(Defect::Translucent(0.6, 1.5)),
        _ => None,
    })
}

/// The true scene and the one that the fit is given.
fn scenes(lab: &Lab, sample: &str) -> Result<[Scene; 2], EvaluateError> {
    let (lights, size) = (lab.settings.lights, lab.settings.resolution_px);
    let design = match sample {
        "ridge" => Design::Ridge,
        "ball" => Design::Ball,
        _ => {
            let lights = Sample::Bowl.lights(lights);
            return Ok([
                Sample::Bowl.true_scene(size, lights.clone())?,
                Sample::Bowl.scene(size, lights)?,
            ]);
        }
    };
    Ok([
        design.scene(lights, size, TRUE_SEGMENTS)?,
        design.scene(lights, size, BELIEVED_SEGMENTS)?,
    ])
}

fn one(lab: &Lab, kind: usize, sample: &str, index: u64) -> Result<Row, EvaluateError> {
    let (name, expected) = KINDS[kind];
    let brdf = material(lab, class_of(kind), index)?;
    let defect = defect(lab, kind, index)?;
    let [truth, scene] = scenes(lab, sample)?;
    let images = capture(lab, &truth, &*brdf, defect.as_ref(), index)?;
    let options = options(lab, class_of(kind), index)?;
    let fit = lab
        .fit_with(&scene, &images, &lab.dictionary, &options)?
        .fit;
    let expected = expected.map_or("none", Cause::name);
    let chi2 = fit.comparison.reduced_chi2();
    let worst = chi2.as_flattened().iter().copied().fold(0.0, f64::max);
    let named = match fit.diagnosis.finding() {
        Some(cause) => cause.name(),
        None if fit.diagnosis.is_unexplained() => "unexplained",
        None => "none",
    };
    let mut row = Row::new()
        .with("capture", name)
        .with("sample", sample)
        .with("expected", expected)
        .with("named", named)
        .with("warned", f64::from(u8::from(named != "none")))
        .with("right", f64::from(u8::from(named == expected)))
        .with("mean_square", fit.diagnosis.mean_square)
        .with("correlation", fit.diagnosis.correlation)
        .with("largest_chi2", worst)
        .with("discrepancy", fit.discrepancy);
    for (cause, part) in Cause::ALL.into_iter().zip(fit.diagnosis.explained) {
        row = row.with(cause.name().replace(' ', "_"), part);
    }
    Ok(row)
}
