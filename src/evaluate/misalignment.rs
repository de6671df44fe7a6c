//! What an inexactly known bench costs, and what refining it gives back.

use super::experiment::{Case, EvaluateError, Experiment, Row, Scale, Table, quantile};
use super::lab::capture::average;
use super::lab::{Lab, Material, Sample, misaligned};
use crate::brdf::score::environment_error_up_to_factor;
use crate::inverse::bench::Parameter;
use crate::inverse::{Fit, FitError, FitOptions, RefineOptions, fit, refine_bench};
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::random::{Purpose, stream};
use crate::simulation::photograph::Photographer;
use crate::transport::{RenderOptions, render};

/// Captures on benches that differ from their description, fitted on the true bench, on
/// the described one, and with the bench refined.
pub static MISALIGNMENT: Experiment = Experiment {
    name: "misalignment",
    shows: "Error on a bench whose lights are off by 0.5°, intensities by 2%, pose by 0.6% of the sample's width and 0.3°: with the bench known, as described, and refined",
    full: Scale {
        lights: 4,
        materials: &[
            "in-span:01",
            "in-span:06",
            "in-span:11",
            "in-span:16",
            "nbrdf:blue-acrylic",
            "nbrdf:red-plastic",
            "nbrdf:pvc",
            "synthetic:cream-satin",
        ],
        ..Scale::SINGLE_IMAGE
    },
    quick: Scale {
        lights: 2,
        materials: &["nbrdf:blue-acrylic"],
        ..Scale::QUICK_IMAGE
    },
    cases,
    figures,
};

const SHAPES: [Sample; 3] = [Sample::Bowl, Sample::ConcaveCorner, Sample::Designed];
/// Paths of the true images over those of other experiments, and their scrambles. Where the
/// truth's noise is as large as the fit's, its rare bright paths count for less, as they state a
/// large variance: images that seem darker than they are took 1% from the albedo.
const TRUTH_FACTOR: u32 = 4;
const TRUTH_SCRAMBLES: u32 = 32;
/// Benches per shape and material.
const BENCHES: u64 = 3;
/// Fits with paths of their own whose errors are averaged in squares: a single one is more or
/// less lucky with its paths, by a factor of two or more.
const PATHS: u64 = 3;

fn cases(lab: &Lab) -> Result<Vec<Case>, EvaluateError> {
    let mut cases = Vec::new();
    for material in &lab.materials {
        for sample in SHAPES {
            for bench in 0..BENCHES {
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
    number: u64,
) -> Result<Vec<Row>, EvaluateError> {
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
        bit_depth: 12,
        full_well_e: 10_000.0,
        read_noise_e: 2.4,
        exposures: 4,
        frames: 1,
        seed: key(2).bits(),
    };
    let rendered = render(&true_scene, &*material.brdf, &render_options);
    let captured = (0..)
        .zip(&rendered)
        .map(|(light, image)| photographer.take(image, light))
        .collect::<Result<Vec<_>, _>>()?;

    let captured = average(&described, &captured, &lab.dictionary)?;
    let options = lab.fit_options();
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
    let mut row = Row::new()
        .with("material", material.name.as_str())
        .with("class", material.class.name())
        .with("shape", sample.name())
        .with("bench", number);
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
            // Apart from what intensities that are all off by the same factor make of the albedo.
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
        .with("held", estimate.held.join("; "));
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
    let panel = |sample: Sample| {
        let points = |column: &str| -> Vec<[f64; 2]> {
            let rows = table
                .rows
                .iter()
                .filter(|r| r.text("shape") == sample.name());
            rows.filter_map(|r| Some([r.number("known")?, r.number(column)?]))
                .map(|point| point.map(|e| e.max(1e-4).log10()))
                .collect()
        };
        let median = |column: &str| {
            quantile(
                &table.figures(column, |r| r.text("shape") == sample.name()),
                0.5,
            )
        };
        Chart {
            title: format!(
                "{}: medians {:.2} and {:.2} times the known bench's",
                sample.name(),
                median("unrefined_over_known"),
                median("refined_over_known")
            ),
            x: Axis::decades(-3.0..0.0, "environment error, bench known"),
            y: Axis::decades(-3.0..0.0, "environment error"),
            series: vec![
                Series::new("", 7, Mark::Line, vec![[-3.0, -3.0], [0.0, 0.0]]),
                Series::new("as described", 1, Mark::Dots, points("unrefined")),
                Series::new("refined", 0, Mark::Dots, points("refined")),
            ],
        }
    };
    Ok(vec![charts("misalignment", 3, &SHAPES.map(panel))])
}
