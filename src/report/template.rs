//! From the report's input to the values of its template.

use serde::Serialize;

use super::budget::BudgetView;
use super::images::{self, Picture};
use super::summary::{
    ScoreRow, Tile, VerdictView, percent, score_rows, short, tiles, verdict_view,
};
use super::{FitInput, LightInput, ReportError, ReportInput, SphereInput, figures};
use crate::radiance_image::RadianceImage;
use crate::session::fit_record::{BenchRecord, EXPLAINED_CHI_SQUARE, Warning};

#[derive(Serialize)]
struct Page<'a> {
    sample: &'a str,
    session: &'a str,
    captured: &'a str,
    simulated: bool,
    incomplete: &'a Option<String>,
    light_count: usize,
    verdict: VerdictView,
    tiles: Vec<Tile>,
    warnings: &'a [Warning],
    remarks: &'a [String],
    truth: Option<&'a str>,
    spheres: Vec<SphereView>,
    scores: Vec<ScoreRow>,
    lights: Vec<LightView>,
    residual_bar: String,
    residual_range: u32,
    fit: Option<FitView>,
    provenance: Vec<GroupView<'a>>,
}

#[derive(Serialize)]
struct SphereView {
    map: String,
    estimate: String,
    truth: Option<String>,
    difference: Option<String>,
    difference_percent: u32,
}

#[derive(Serialize)]
struct LightView {
    name: String,
    place: Option<String>,
    captured: Option<String>,
    rendered: Option<String>,
    residuals: Vec<Named>,
    white: String,
    size: String,
    exposures: Vec<Vec<String>>,
    snr: Option<[String; 3]>,
    snr_low: Option<[String; 3]>,
    unusable: Option<String>,
    chi_square: Option<Vec<Judged>>,
}

#[derive(Serialize)]
struct Named {
    name: &'static str,
    uri: String,
}

#[derive(Serialize)]
struct Judged {
    text: String,
    bad: bool,
}

#[derive(Serialize)]
struct FitView {
    name: String,
    dictionary: String,
    atoms: usize,
    polar: Vec<Figure>,
    slices: Vec<Figure>,
    maps: Option<[String; 2]>,
    constrained_percent: String,
    bars: String,
    hidden_atoms: usize,
    departs: bool,
    hidden_below_percent: f64,
    trace: Option<String>,
    loss: String,
    steps: u64,
    termination: String,
    timings: Vec<(String, String)>,
    bench: Option<BenchView>,
    budget: Option<BudgetView>,
}

/// The bench as refined.
#[derive(Serialize)]
struct BenchView {
    /// Name, difference with its deviation, deviation before, unit.
    rows: Vec<[String; 4]>,
    held: Vec<String>,
    rounds: u32,
    settled: bool,
}

impl BenchView {
    fn of(bench: &BenchRecord) -> Self {
        Self {
            rounds: bench.rounds,
            settled: bench.settled,
            held: bench.held.clone(),
            rows: bench
                .parameter
                .iter()
                .map(|p| {
                    [
                        p.name.clone(),
                        format!("{:.4} ± {:.4}", p.value + 0.0, p.deviation).replace('-', "−"),
                        short(p.prior_deviation),
                        p.unit.clone(),
                    ]
                })
                .collect(),
        }
    }
}

#[derive(Serialize)]
struct Figure {
    caption: String,
    svg: String,
}

#[derive(Serialize)]
struct GroupView<'a> {
    title: &'a str,
    entries: &'a [(String, String)],
}

pub(super) fn render(input: &ReportInput) -> Result<String, ReportError> {
    let record = input.fit.as_ref().map(|fit| &fit.record);
    let fit = input
        .fit
        .as_ref()
        .map(|fit| fit_view(fit, input))
        .transpose()?;
    let page = Page {
        sample: &input.sample,
        session: &input.session,
        captured: &input.captured,
        simulated: input.simulated,
        incomplete: &input.incomplete,
        light_count: input.lights.len(),
        verdict: verdict_view(record),
        tiles: tiles(record),
        warnings: record.map_or(&[], |record| &record.warnings),
        remarks: record.map_or(&[], |record| &record.remarks),
        truth: input.truth.as_ref().map(|truth| truth.name.as_str()),
        spheres: input.spheres.iter().map(sphere_view).collect(),
        scores: score_rows(record),
        lights: (0..input.lights.len())
            .map(|n| light_view(n, &input.lights[n], input.fit.as_ref()))
            .collect(),
        residual_bar: figures::residual_bar(),
        residual_range: images::RESIDUAL_RANGE as u32,
        fit,
        provenance: input
            .provenance
            .iter()
            .map(|group| GroupView {
                title: &group.title,
                entries: &group.entries,
            })
            .collect(),
    };
    let mut environment = minijinja::Environment::new();
    environment.set_undefined_behavior(minijinja::UndefinedBehavior::Strict);
    environment.add_template("report.html", include_str!("report.html.j2"))?;
    Ok(environment
        .get_template("report.html")?
        .render(minijinja::value::Serde(&page))?)
}

/// Spheres are shown on the truth's exposure; the difference in per cent of white.
fn sphere_view(sphere: &SphereInput) -> SphereView {
    const DIFFERENCE_RANGE: f32 = 0.2;
    let white = images::white_level(sphere.truth.as_ref().unwrap_or(&sphere.estimate));
    let uri = |image: &RadianceImage| images::data_uri(&images::tone_mapped(image, white));
    let difference = |truth: &RadianceImage| {
        let estimate = &sphere.estimate;
        images::data_uri(&Picture::from_fn(
            estimate.width,
            estimate.height,
            |x, y| {
                let at = y * estimate.width + x;
                match (estimate.mean.get(at), truth.mean.get(at)) {
                    (Some(a), Some(b)) if estimate.valid[at] => {
                        let sum: f32 = (0..3).map(|c| a[c] - b[c]).sum();
                        let [r, g, b] = images::diverging(sum / 3.0 / white / DIFFERENCE_RANGE);
                        [r, g, b, 255]
                    }
                    _ => [0; 4],
                }
            },
        ))
    };
    SphereView {
        map: sphere.map.clone(),
        estimate: uri(&sphere.estimate),
        truth: sphere.truth.as_ref().map(uri),
        difference: sphere.truth.as_ref().map(difference),
        difference_percent: (DIFFERENCE_RANGE * 100.0) as u32,
    }
}

fn light_view(position: usize, light: &LightInput, fit: Option<&FitInput>) -> LightView {
    let rendered = fit.and_then(|fit| fit.images.rendered.get(position));
    let residual = fit.and_then(|fit| fit.images.residual.get(position));
    let captured = light.captured.as_ref();
    let white = captured
        .map(|captured| captured.white)
        .or(rendered.map(images::white_level))
        .unwrap_or(1.0);
    let uri = |image: &RadianceImage| images::data_uri(&images::tone_mapped(image, white));
    let names = ["red", "green", "blue"];
    let named = |channel: usize, image: &RadianceImage| Named {
        name: names[channel],
        uri: images::data_uri(&images::residual(image, channel)),
    };
    let quality = captured.map(|captured| &captured.signal_to_noise);
    let chi_square = fit.and_then(|fit| fit.record.reduced_chi_square.get(position));
    LightView {
        name: format!("L{:03}", light.index),
        place: light.place.map(|place| {
            // Adding zero turns −0 into 0.
            let (azimuth, elevation) = (place.azimuth_deg + 0.0, place.elevation_deg + 0.0);
            format!("azimuth {azimuth:.1}°, elevation {elevation:.1}°").replace('-', "−")
        }),
        captured: captured.map(|captured| uri(&captured.picture)),
        rendered: rendered.map(uri),
        residuals: residual.map_or(Vec::new(), |image| {
            (0..3).map(|c| named(c, image)).collect()
        }),
        white: short(f64::from(white)),
        size: captured
            .map(|captured| captured.size_px)
            .or(rendered.map(|image| [image.width, image.height]))
            .map_or(String::new(), |[width, height]| {
                format!("{width} × {height} pixels")
            }),
        exposures: exposures(light),
        snr: quality.map(|quality| quality.median.map(|x| format!("{x:.0}"))),
        snr_low: quality.map(|quality| quality.low.map(|x| format!("{x:.0}"))),
        unusable: captured.map(|captured| {
            let [width, height] = captured.size_px;
            let share = captured.unusable as f64 / (width * height).max(1) as f64;
            format!("{} ({:.1} %)", captured.unusable, share * 100.0)
        }),
        chi_square: chi_square.map(|values| {
            let judge = |value: &f64| Judged {
                text: format!("{value:.2}"),
                bad: *value > EXPLAINED_CHI_SQUARE,
            };
            values.iter().map(judge).collect()
        }),
    }
}

/// One line per lamp channel: `0.50 ms × 8`, `4.00 ms × 2`.
fn exposures(light: &LightInput) -> Vec<Vec<String>> {
    let mut channels: Vec<Option<u8>> = light.exposures.iter().map(|e| e.lamp_channel).collect();
    channels.sort();
    channels.dedup();
    let line = |channel: &Option<u8>| {
        let name = channel.map(|channel| format!("lamp {channel}:"));
        let entries = light
            .exposures
            .iter()
            .filter(|e| e.lamp_channel == *channel);
        let entries = entries.map(|e| format!("{} ms × {}", short(e.exposure.0 * 1e3), e.frames));
        name.into_iter().chain(entries).collect()
    };
    channels.iter().map(line).collect()
}

fn fit_view(fit: &FitInput, input: &ReportInput) -> Result<FitView, ReportError> {
    let record = &fit.record;
    let truth = input.truth.as_ref().map(|truth| &*truth.brdf);
    let polar = figures::polar_plots(&*fit.estimate, truth, &record.table)?;
    let captions = figures::POLAR_THETA_I_DEG.map(|angle| format!("light at θi = {angle}°"));
    let (bars, hidden_atoms) = figures::weight_bars(record)?;
    Ok(FitView {
        name: fit.name.clone(),
        dictionary: record.dictionary.clone(),
        atoms: record.atoms.len(),
        polar: std::iter::zip(captions, polar)
            .map(|(caption, svg)| Figure { caption, svg })
            .collect(),
        slices: figures::slices(&record.table, truth)?
            .into_iter()
            .map(|(angle, svg)| Figure {
                caption: format!("θd = {angle}°"),
                svg,
            })
            .collect(),
        maps: figures::table_maps(&record.table)?,
        constrained_percent: percent(record.table.constrained_share()),
        bars,
        hidden_atoms,
        departs: record.discrepancy.is_some(),
        hidden_below_percent: figures::SHOWN_WEIGHT * 100.0,
        trace: figures::trace_plot(&record.trace)?,
        loss: short(record.loss),
        steps: record.trace.last().map_or(0, |point| point.step),
        termination: record.termination.clone(),
        timings: record
            .timings
            .iter()
            .map(|timing| (timing.stage.clone(), format!("{:.2} s", timing.seconds)))
            .collect(),
        bench: record.bench.as_ref().map(BenchView::of),
        budget: record.budget.as_ref().map(BudgetView::of),
    })
}
