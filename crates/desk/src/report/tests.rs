use glam::Vec3;

use super::*;
use crate::brdf::discrepancy::Discrepancy;
use crate::brdf::sphere::GreyCard;
use crate::brdf::{Brdf, Dictionary, Mixture};
use crate::session::fit_record::{
    AngleTable, BudgetRecord, BudgetRow, ChannelScore, DiscrepancyRecord, FitSettings, Grade,
    Interval, MetricScores, ScoreSheet, Timing, TracePoint, Warning,
};
use rig_core::random::{Purpose, stream};

const WIDTH: usize = 48;

/// A lit bowl, roughly: smooth shading inside a disc, and its noise.
fn bowl(light: u64, noise: f64) -> RadianceImage {
    let mut image = RadianceImage::new(WIDTH, WIDTH);
    for pixel in 0..WIDTH * WIDTH {
        let x = (pixel % WIDTH) as f64 / WIDTH as f64 * 2.2 - 1.1;
        let y = (pixel / WIDTH) as f64 / WIDTH as f64 * 2.2 - 1.1;
        let inside = x * x + y * y < 1.0;
        let shade = if inside {
            0.15 + 0.1 * (x * (1.0 + light as f64 * 0.4) - y)
        } else {
            0.0
        };
        let spark = (-40.0 * ((x - 0.3).powi(2) + (y + 0.2 * light as f64).powi(2))).exp();
        let mut numbers = stream(5, Purpose::Experiment, light, pixel as u64, 0);
        for (c, tint) in [0.9, 0.55, 0.3].into_iter().enumerate() {
            let mean = if inside {
                shade * tint + 0.5 * spark
            } else {
                0.0
            };
            let sigma = noise * (0.002 + 0.01 * mean);
            image.mean[pixel][c] = (mean + sigma * numbers.normal()) as f32;
            image.variance[pixel][c] = (sigma * sigma) as f32;
        }
        image.valid[pixel] = pixel % 977 != 3;
    }
    image
}

fn residual(light: u64) -> RadianceImage {
    let mut image = RadianceImage::new(WIDTH, WIDTH);
    for (pixel, value) in image.mean.iter_mut().enumerate() {
        let mut numbers = stream(6, Purpose::Experiment, light, pixel as u64, 0);
        *value = [0.0; 3].map(|_: f32| numbers.normal() as f32);
        let (x, y) = (pixel % WIDTH, pixel / WIDTH);
        image.valid[pixel] = x.abs_diff(24).pow(2) + y.abs_diff(24).pow(2) < 22 * 22;
    }
    image
}

fn sphere(brdf: &dyn Brdf) -> RadianceImage {
    let mut image = RadianceImage::new(96, 96);
    for pixel in 0..96 * 96 {
        let x = (pixel % 96) as f32 / 47.5 - 1.0;
        let y = 1.0 - (pixel / 96) as f32 / 47.5;
        image.valid[pixel] = x * x + y * y < 1.0;
        if !image.valid[pixel] {
            continue;
        }
        let normal = Vec3::new(x, y, (1.0 - x * x - y * y).sqrt());
        let frame = glam::Quat::from_rotation_arc(normal, Vec3::Z);
        for to_light in [Vec3::new(0.5, 0.6, 0.6), Vec3::new(-0.8, 0.1, 0.5)] {
            let local = frame * to_light.normalize();
            let value = brdf.eval(local, frame * Vec3::Z);
            (0..3).for_each(|c| image.mean[pixel][c] += value[c] * local.z.max(0.0));
        }
    }
    image
}

fn mixture(shift: f64) -> Mixture {
    let dictionary = Dictionary::paper42();
    let channel = |gloss: f64, matte: f64| {
        let mut weights = vec![0.0; dictionary.len()];
        (weights[32], weights[12], weights[38]) = (gloss + shift, 0.04, 0.02 - shift / 4.0);
        weights[40] = matte - shift;
        weights[41] = 1.0 - weights.iter().sum::<f64>();
        weights
    };
    let weights = [channel(0.22, 0.5), channel(0.2, 0.21), channel(0.19, 0.08)];
    Mixture::new(Arc::new(dictionary.clone()), weights).unwrap()
}

fn table(brdf: &dyn Brdf) -> AngleTable {
    let theta_h_deg: Vec<f64> = (0..31).map(|n| f64::from(n).powi(2) / 10.0).collect();
    let theta_d_deg: Vec<f64> = (0..19).map(|n| f64::from(n) * 5.0).collect();
    let mut cells = Vec::new();
    for &h in &theta_h_deg {
        for &d in &theta_d_deg {
            let (to_light, to_viewer) = figures::directions_at(h, d.min(89.0));
            let value = brdf.eval(to_light, to_viewer).map(f64::from);
            let spread = 0.03 + 0.3 * (h / 90.0).powi(2) + 0.2 * (d / 90.0).powi(4);
            cells.push(Interval {
                value,
                lower: value.map(|f| f * (1.0 - spread)),
                upper: value.map(|f| f * (1.0 + spread)),
                constrained: h < 70.0 - d / 3.0 && d < 82.0,
            });
        }
    }
    AngleTable {
        theta_h_deg,
        theta_d_deg,
        cells,
    }
}

fn record(estimate: &Mixture) -> FitRecord {
    let score = |overall: f64| ChannelScore {
        channels: [overall * 0.9, overall, overall * 1.2],
        overall,
    };
    let metric = |own: f64| MetricScores {
        estimate: score(own),
        reference_projection: score(own * 0.9),
        floor: score(own * 0.75),
        single_bounce_start: Some(score(own * 7.0)),
    };
    FitRecord {
        simulated: true,
        weight_deviations: estimate
            .weights()
            .clone()
            .map(|w| w.iter().map(|w| w * 0.1).collect()),
        settings: FitSettings {
            optimizer: "gauss-newton".to_owned(),
            samples_per_pixel: 256,
            max_reflections: 16,
            seed: 1,
            kernel: "portable".to_owned(),
            ..FitSettings::default()
        },
        loss: 1.043,
        reduced_chi_square: vec![[1.02, 0.98, 1.04], [1.01, 1.0, 0.97]],
        truncation_remainder: vec![2e-4, 1e-4],
        outlier_fraction: vec![0.0, 0.01],
        discrepancy: Some(DiscrepancyRecord {
            amplitude: 0.4,
            by_channel: [0; 3].map(|_| Discrepancy::none()),
        }),
        termination: "the predicted decrease of the loss fell below 1e-4 of it".to_owned(),
        trace: [41.0, 3.2, 1.3, 1.06, 1.045, 1.043]
            .into_iter()
            .enumerate()
            .map(|(n, loss)| TracePoint {
                step: n as u64,
                loss,
                seconds: 0.3 * n as f64,
            })
            .collect(),
        timings: [("trace paths", 2.1), ("start", 0.2), ("optimise", 1.8)]
            .map(|(stage, seconds)| Timing {
                stage: stage.to_owned(),
                seconds,
            })
            .into(),
        score: Some(ScoreSheet {
            truth: "paper white".to_owned(),
            environment_error: metric(0.048),
            brdf_error: metric(0.11),
            brdf_cube_root_error: Some(metric(0.062)),
            plain: None,
        }),
        table: table(estimate),
        budget: Some(BudgetRecord {
            sources: ["noise", "paths", "model", "prior"]
                .map(str::to_owned)
                .into(),
            row: [(5.0, 10.0, 0.02), (40.0, 45.0, 0.008), (70.0, 10.0, 0.05)]
                .map(|(theta_h_deg, theta_d_deg, relative_std)| BudgetRow {
                    theta_h_deg,
                    theta_d_deg,
                    value: 0.12,
                    relative_std,
                    share: vec![0.4, 0.1, 0.3, 0.2],
                })
                .into(),
        }),
        ..FitRecord::of_mixture(estimate)
    }
}

/// A whole session of two lights, as [`load`] would give it.
pub(super) fn synthetic() -> ReportInput {
    let (estimate, truth) = (mixture(0.0), mixture(0.03));
    let exposure = |ms: f64, frames| ExposureInput {
        lamp: None,
        exposure: Seconds(ms / 1e3),
        frames,
    };
    let light = |index: u32| LightInput {
        index,
        place: Some(StageAngles::new(-30.0 * f64::from(index), 85.0)),
        exposures: vec![exposure(0.5, 1), exposure(4.0, 2), exposure(32.0, 8)],
        captured: Some(CapturedInput::of(&bowl(index.into(), 1.0))),
    };
    ReportInput {
        diffuser: None,
        sample: "red-plastic <bowl> & co".to_owned(),
        session: "20261121T023400Z_red-plastic_0f3a9c".to_owned(),
        captured: "2026-11-21 02:34 UTC".to_owned(),
        simulated: true,
        incomplete: None,
        lights: vec![light(0), light(1)],
        fit: Some(FitInput {
            name: "0".to_owned(),
            record: record(&estimate),
            images: FitImages {
                rendered: vec![bowl(0, 0.1), bowl(1, 0.1)],
                residual: vec![residual(0), residual(1)],
                cells_csv: String::new(),
            },
            estimate: Arc::new(estimate.clone()),
        }),
        validation: Some(ValidationInput {
            number: 3,
            record: crate::session::validation::example(),
            pictures: vec![(1, b"png".to_vec())],
        }),
        spheres: ["studio", "sunset"]
            .map(|map| SphereInput {
                map: map.to_owned(),
                grey: sphere(&GreyCard),
                estimate: sphere(&estimate),
                truth: Some(sphere(&truth)),
            })
            .into(),
        truth: Some(Truth {
            name: "paper white".to_owned(),
            brdf: Arc::new(truth),
        }),
        provenance: vec![ProvenanceGroup {
            title: "Program".to_owned(),
            entries: vec![
                ("rig".to_owned(), "0.1.0".to_owned()),
                (
                    "configuration".to_owned(),
                    "[camera]\ndriver = \"simulated\"".to_owned(),
                ),
            ],
        }],
    }
}

/// Every element is closed in the order in which it was opened.
fn assert_well_formed(html: &str) {
    const VOID: [&str; 4] = ["meta", "img", "br", "link"];
    let mut open: Vec<&str> = Vec::new();
    let mut rest = html.strip_prefix("<!DOCTYPE html>").expect("a doctype");
    while let Some(at) = rest.find('<') {
        rest = &rest[at + 1..];
        let end = rest.find('>').expect("a tag ends");
        let tag = &rest[..end];
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes in <{tag}>");
        rest = &rest[end + 1..];
        let name = tag
            .split([' ', '\n', '/'])
            .find(|word| !word.is_empty())
            .unwrap_or(tag);
        if tag.starts_with('/') {
            assert_eq!(
                open.pop(),
                Some(name),
                "near {}",
                &rest[..rest.len().min(80)]
            );
        } else if !VOID.contains(&name) && !tag.ends_with('/') {
            open.push(name);
        }
        if name == "style" && !tag.starts_with('/') {
            rest = &rest[rest.find("</style>").expect("the style ends")..];
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

fn page(input: &ReportInput) -> String {
    let html = render(input).unwrap();
    assert_well_formed(&html);
    for external in ["http:", "https:", "<script", "<link", "@import", "url("] {
        assert!(!html.contains(external), "{external} in the page");
    }
    html
}

/// To look at the page: `RIG_SAMPLE_REPORT=page.html cargo test --lib report`.
#[test]
fn a_whole_session_has_every_section() {
    let html = page(&synthetic());
    if let Some(path) = std::env::var_os("RIG_SAMPLE_REPORT") {
        std::fs::write(path, &html).unwrap();
    }
    for id in [
        "verdict",
        "spheres",
        "score",
        "validation",
        "images",
        "exposure",
        "brdf",
        "weights",
        "optimisation",
        "budget",
        "provenance",
    ] {
        assert!(html.contains(&format!("id=\"{id}\"")), "section {id}");
    }
    assert!(
        html.contains("red-plastic &lt;bowl&gt; &amp; co"),
        "text is escaped"
    );
    assert!(html.contains("class=\"watermark\"") && html.contains("SIMULATED"));
    assert!(html.contains("The fit explains the images"));
    assert!(
        html.contains("4.80%") && html.contains("3.60%"),
        "score and floor"
    );
    for exposure in ["0.500 ms × 1", "4.00 ms × 2", "32.0 ms × 8"] {
        assert!(html.contains(exposure), "{exposure}");
    }
    assert!(html.contains("azimuth −30.0°, elevation 85.0°"));
    // Two lights of five images, two maps of four spheres, two heat maps of two
    // pictures, the colour bar twice, and a prediction.
    assert_eq!(
        html.matches("data:image/png;base64,").count(),
        10 + 8 + 4 + 2 + 1
    );
    // Polar plots, slices, maps, weights, loss and budget.
    assert_eq!(html.matches("<svg").count(), 3 + 3 + 2 + 1 + 1 + 1);
    assert!(html.contains("0.80%") && html.contains("40.0%"), "budget");
    let predicted = [
        "light 1 (derived&#x2f;radiance_L000.exr) was fitted",
        "<figcaption>light 2",
        ">11.5%<",
        "95.1%",
    ];
    assert!(predicted.iter().all(|part| html.contains(part)) && !html.contains("neighbours"));
    assert!(html.len() < 2_000_000, "{} bytes", html.len());
}

#[test]
fn without_truth_the_page_says_so() {
    let mut input = synthetic();
    input.truth = None;
    input.simulated = false;
    for sphere in &mut input.spheres {
        sphere.truth = None;
    }
    input.fit.as_mut().unwrap().record.score = None;
    let html = page(&input);
    assert!(html.contains("The true material is not known"));
    assert!(html.contains("No truth is known for this sample"));
    assert!(!html.contains("SIMULATED") && !html.contains("Dictionary floor"));
}

#[test]
fn without_a_fit_the_page_says_so() {
    let mut input = synthetic();
    input.fit = None;
    input.spheres.clear();
    input.incomplete = Some("2 of 4 lights are finished".to_owned());
    input.lights[1].captured = None;
    input.lights[1].exposures.clear();
    let html = page(&input);
    assert!(html.contains("No fit yet") && html.contains("nothing to score"));
    assert!(html.contains("2 of 4 lights are finished"));
    assert!(html.contains("No merged image of this light"));
    input.lights.clear();
    input.provenance.clear();
    assert!(page(&input).contains("The session has no lights"));
}

#[test]
fn a_bad_fit_never_looks_like_a_good_one() {
    let mut bad = synthetic();
    // Its fit of a part of the lights has a verdict of its own.
    bad.validation = None;
    let record = &mut bad.fit.as_mut().unwrap().record;
    record.reduced_chi_square[1] = [7.5, 1.0, 1.0];
    let html = page(&bad);
    assert!(html.contains("The fit is not to be trusted") && html.contains("7.50 !"));
    assert!(!html.contains("The fit explains the images"));

    let mut doubtful = synthetic();
    doubtful
        .fit
        .as_mut()
        .unwrap()
        .record
        .warnings
        .push(Warning {
            what: "Residuals follow the rim".to_owned(),
            likely_cause: "the pose is off".to_owned(),
            grade: Grade::Reservation,
        });
    let html = page(&doubtful);
    assert!(html.contains("with reservations") && html.contains("Most likely: the pose is off."));
}

/// A remark is on the page and changes no verdict.
#[test]
fn a_remark_is_no_warning() {
    let mut remarked = synthetic();
    let record = &mut remarked.fit.as_mut().unwrap().record;
    record.remarks.push("48 of 64 paths were traced".to_owned());
    let html = page(&remarked);
    assert!(html.contains("The fit explains the images"));
    assert!(html.contains("<li>48 of 64 paths were traced.</li>"));
}

#[test]
fn an_empty_fit_still_makes_a_page() {
    let mut input = synthetic();
    let fit = input.fit.as_mut().unwrap();
    fit.images = FitImages::default();
    fit.record.table = AngleTable::default();
    fit.record.trace.clear();
    fit.record.reduced_chi_square.clear();
    fit.record.timings.clear();
    let html = page(&input);
    assert!(html.contains("The fit left no (θh, θd) table") && html.contains("recorded no trace"));
    assert!(html.contains("cannot be judged"));
}
