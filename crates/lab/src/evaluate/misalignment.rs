//! How much error an inexactly known bench adds, and how much of it refining the bench removes.

use std::sync::Arc;

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Scatter, Table};
use super::lab::capture::{SENSOR, average, photograph};
use super::lab::{Lab, Material, Sample, misaligned, of_materials};
use crate::brdf::Dictionary;
use crate::brdf::score::environment_error_up_to_factor;
use crate::inverse::nuisance::Parameter;
use crate::inverse::{Fit, FitError, FitOptions, RefineOptions, fit, refine_bench};
use crate::plot::{Figure, charts};
use crate::random::{Purpose, stream};
use crate::simulation::photograph::Photographer;
use crate::transport::{RenderOptions, render};

/// Captures on benches that differ from their description, fitted on the true bench, on
/// the described one, and with the bench refined.
pub static MISALIGNMENT: Experiment = Experiment {
    name: "misalignment",
    shows: "Error on a bench whose lights are off by 0.5°, intensities by 2%, pose by 0.6% of the sample's width and 0.3°: with the bench known, as described, and refined",
    full: Scale {
        samples_per_pixel: 256,
        truth_samples_per_pixel: 1024,
        lights: 4,
        materials: &[
            "in-span:01",
            "in-span:11",
            "nbrdf:red-plastic",
            "nbrdf:pvc",
            "synthetic:cream-satin",
        ],
        dictionary: Dictionary::DEFAULT,
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        lights: 2,
        materials: &["nbrdf:blue-acrylic"],
        dictionary: Dictionary::DEFAULT,
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 3] = [Sample::Bowl, Sample::ConcaveCorner, Sample::Designed];
/// Paths of the true images over those of other experiments, and their scrambles. With as much
/// noise in the truth as in the fit, rare bright paths are down-weighted for their large
/// variance, and the images' apparent darkening took 1% from the albedo.
const TRUTH_FACTOR: u32 = 4;
const TRUTH_SCRAMBLES: u32 = 32;
/// Benches per shape and material.
const BENCHES: u64 = 2;
/// Fits with independent paths whose squared errors are averaged: a single fit's error varies
/// by a factor of two or more with its paths.
const PATHS: u64 = 2;

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let variants: Vec<(Sample, u64)> = SHAPES
        .into_iter()
        .flat_map(|sample| (0..BENCHES).map(move |bench| (sample, bench)))
        .collect();
    let name = |(sample, bench): (Sample, u64)| format!("{}/{bench}", sample.name());
    Ok(of_materials(lab, &variants, name, one))
}

fn one(
    lab: &Lab,
    material: &Arc<Material>,
    (sample, number): (Sample, u64),
) -> Result<Vec<Row>, EvaluateError> {
    // The described bench, and a true one that differs from it.
    let settings = &lab.settings;
    let (resolution_px, lights) = (settings.resolution_px, sample.lights(settings.lights));
    let described = sample.scene(resolution_px, lights.clone())?;
    let fine = sample.true_scene(resolution_px, lights)?;
    let bench = misaligned::bench(&described);
    let key = |what| stream(settings.seed, Purpose::BenchPerturbation, number, 0, what);
    let truth = misaligned::draw(&bench, &mut key(0));

    // Truth, photographed: another mesh, other paths, the noise of a 12-bit bracket.
    let true_scene = misaligned::bench(&fine).scene(&truth);
    let render_options = lab.truth_options(&true_scene, &*material.brdf);
    let render_options = RenderOptions {
        seed: key(1).bits(),
        samples_per_pixel: TRUTH_FACTOR * render_options.samples_per_pixel,
        scrambles: Some(TRUTH_SCRAMBLES),
        ..render_options
    };
    let photographer = Photographer {
        seed: key(2).bits(),
        ..SENSOR
    };
    let rendered = render(&true_scene, &*material.brdf, &render_options);
    let captured = photograph(&photographer, &rendered)?;

    // Fits on the true bench, on the described one, and on the refined one.
    let captured = average(&described, &captured, &lab.dictionary)?;
    let options = lab.fit_options_for(material);
    let refined = refine_bench(
        &described,
        &captured,
        &lab.dictionary,
        &options,
        &misaligned::priors(),
        &RefineOptions::default(),
        &(),
    )?;
    let estimate = &refined.estimate;
    let mut row = material.row(sample).with("bench", number);
    let known = bench.scene(&truth);
    let plain = |scene, options: &_| fit(scene, &captured, &lab.dictionary, options);
    type Fitted<'a> = &'a dyn Fn(&FitOptions) -> Result<Fit, FitError>;
    let fits: [(&str, Fitted<'_>); 3] = [
        ("known", &|options| plain(&known, options)),
        ("unrefined", &|options| plain(&described, options)),
        ("refined", &|options| {
            refined.fit(&lab.dictionary, options, &())
        }),
    ];
    // Their errors, also up to a common factor of the albedo.
    let mut errors = [0.0; 3];
    for ((name, fitted), error) in fits.iter().zip(&mut errors) {
        let (mut square, mut square_apart, mut factor) = (0.0, 0.0, 0.0);
        for paths in 0..PATHS {
            let mut options = options.clone();
            options.cache.seed = options.cache.seed.wrapping_add(paths << 32);
            let material_found = fitted(&options)?.material;
            square += lab
                .score(&material_found, &*material.brdf)
                .environment
                .powi(2);
            // Without the error of the albedo that a common factor of all intensities causes.
            let (maps, sphere_px) = (lab.maps(), settings.sphere_px);
            let apart =
                environment_error_up_to_factor(&material_found, &*material.brdf, maps, sphere_px);
            square_apart += apart.error.powi(2);
            factor += apart.factor;
        }
        let n = PATHS as f64;
        *error = (square / n).sqrt();
        row = row
            .with(*name, *error)
            .with(format!("{name}_up_to_factor"), (square_apart / n).sqrt())
            .with(format!("{name}_factor"), factor / n);
    }
    let [known, unrefined, refined] = errors;
    row = row
        .with("unrefined_over_known", unrefined / known)
        .with("refined_over_known", refined / known)
        .with("rounds", estimate.rounds)
        .with("held", estimate.fixed.join("; "));
    // Root mean squares by kind: errors before and after in prior deviations, and after in
    // stated deviations.
    type Belongs = fn(&Parameter) -> bool;
    let kinds: [(&str, Belongs); 4] = [
        ("lights", |p| {
            matches!(p, Parameter::LightAzimuth(_) | Parameter::LightElevation(_))
        }),
        ("intensities", |p| matches!(p, Parameter::Intensity(_))),
        ("rotation", |p| matches!(p, Parameter::Rotation(_))),
        ("translation", |p| matches!(p, Parameter::Translation(_))),
    ];
    for (kind, is_member) in kinds {
        let members: Vec<_> = estimate
            .parameters
            .iter()
            .zip(truth.iter())
            .filter(|(p, _)| is_member(&p.parameter))
            .collect();
        let rms = |of: &dyn Fn(f64, f64, f64, f64) -> f64| {
            let squares = members
                .iter()
                .map(|(p, truth)| of(p.value, **truth, p.deviation, p.prior_deviation).powi(2));
            (squares.sum::<f64>() / members.len().max(1) as f64).sqrt()
        };
        row = row
            .with(
                format!("{kind}_before"),
                rms(&|_, truth, _, prior| truth / prior),
            )
            .with(
                format!("{kind}_after"),
                rms(&|value, truth, _, prior| (value - truth) / prior),
            )
            .with(
                format!("{kind}_z"),
                rms(&|value, truth, sigma, _| (value - truth) / sigma),
            );
    }
    Ok(vec![row])
}

/// Known against refined and unrefined, one panel per shape; the line is equality.
fn figures(_: &Lab, table: &Table) -> Result<Vec<Figure>, EvaluateError> {
    let scatter = Scatter {
        table,
        decades: -3.0..0.0,
        x: ("known", "environment error, bench known"),
        y_label: "environment error",
        series: &[("as described", 1, "unrefined"), ("refined", 0, "refined")],
    };
    let panels = SHAPES.map(Sample::name).map(|shape| {
        let [unrefined, refined] = ["unrefined_over_known", "refined_over_known"]
            .map(|column| scatter.median(column, shape));
        let title =
            format!("{shape}: medians {unrefined:.2} and {refined:.2} times the known bench's");
        scatter.panel(title, shape)
    });
    Ok(vec![charts("misalignment", 3, &panels)])
}
