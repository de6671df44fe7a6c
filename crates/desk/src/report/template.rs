//! From the report's input to the values of its template.

use minijinja::value::Value;
use minijinja::{Environment, UndefinedBehavior, context};

use super::budget::budget_view;
use super::summary::{percent, score_rows, short, tiles, verdict_view};
use super::value::{value, values};
use super::{
    FitInput, LightInput, ReportError, ReportInput, SphereInput, ValidationInput, figures,
};
use crate::brdf::sphere::GreyCard;
use crate::plot::colors::diverging;
use crate::plot::radiance as images;
use crate::plot::{Picture, png_data_uri};
use crate::radiance_image::RadianceImage;
use crate::session::fit_record::{BenchRecord, EXPLAINED_CHI_SQUARE};

/// The refined bench; rows have name, correction with its standard deviation, the one
/// before, and unit.
fn bench_view(bench: &BenchRecord) -> Value {
    let rows = bench.parameter.iter().map(|p| {
        [
            p.name.clone(),
            format!("{:.4} ± {:.4}", p.value + 0.0, p.deviation).replace('-', "−"),
            short(p.prior_deviation),
            p.unit.clone(),
        ]
    });
    context! {
        rounds => bench.rounds,
        settled => bench.settled,
        fixed => value(&bench.held),
        rows => value(rows.collect::<Vec<_>>()),
    }
}

pub(super) fn render(input: &ReportInput) -> Result<String, ReportError> {
    let record = input.fit.as_ref().map(|fit| &fit.record);
    let fit = input
        .fit
        .as_ref()
        .map(|fit| fit_view(fit, input))
        .transpose()?;
    let lights = input.lights.iter().enumerate();
    let page = context! {
        sample => &input.sample,
        session => &input.session,
        captured => &input.captured,
        simulated => input.simulated,
        incomplete => value(&input.incomplete),
        light_count => input.lights.len(),
        verdict => verdict_view(record),
        tiles => tiles(record),
        warnings => value(record.map(|record| &record.warnings)),
        remarks => value(record.map(|record| &record.remarks)),
        truth => value(input.truth.as_ref().map(|truth| &truth.name)),
        spheres => values(&input.spheres, sphere_view),
        scores => score_rows(record),
        lights => values(lights, |(n, light)| light_view(n, light, input)),
        residual_bar => figures::residual_bar(),
        residual_range => images::RESIDUAL_RANGE as u32,
        validation => value(input.validation.as_ref().map(validation_view)),
        fit => value(fit),
        provenance => values(&input.provenance, |group| context! {
            title => &group.title,
            entries => value(&group.entries),
        }),
    };
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.add_template("report.html", include_str!("report.html.j2"))?;
    Ok(environment.get_template("report.html")?.render(page)?)
}

/// Table and pictures of what was predicted.
fn validation_view(validation: &ValidationInput) -> Value {
    let record = &validation.record;
    let (headings, rows) = record.headed_table();
    let image = |light: usize| record.images.get(light).map_or("", String::as_str);
    context! {
        number => validation.number,
        division => record.division(),
        made => &record.made_utc,
        dictionary => &record.dictionary,
        verdict => record.verdict.sentence(),
        posterior_samples => record.posterior_samples,
        has_neighbours => headings.contains(&"neighbours"),
        headings,
        rows,
        pictures => values(&validation.pictures, |(light, png)| context! {
            light => light + 1,
            image => image(*light),
            uri => png_data_uri(png),
        }),
    }
}

/// Spheres are shown in the exposure that makes the grey one grey; the difference is in per cent
/// of the truth's brightest parts.
fn sphere_view(sphere: &SphereInput) -> Value {
    const DIFFERENCE_RANGE: f32 = 0.2;
    let white = images::white_level(&sphere.grey) / GreyCard::REFLECTANCE;
    let uri = |image: &RadianceImage| images::tone_mapped(image, white).data_uri();
    let difference = |truth: &RadianceImage| {
        let brightest = images::white_level(truth);
        let estimate = &sphere.estimate;
        let pixel = |x: usize, y: usize| {
            let at = y * estimate.width + x;
            match (estimate.mean.get(at), truth.mean.get(at)) {
                (Some(a), Some(b)) if estimate.valid[at] => {
                    let sum: f32 = (0..3).map(|c| a[c] - b[c]).sum();
                    let [r, g, b] = diverging(sum / 3.0 / brightest / DIFFERENCE_RANGE);
                    [r, g, b, 255]
                }
                _ => [0; 4],
            }
        };
        Picture::from_fn(estimate.width, estimate.height, pixel).data_uri()
    };
    context! {
        map => &sphere.map,
        grey => uri(&sphere.grey),
        estimate => uri(&sphere.estimate),
        truth => value(sphere.truth.as_ref().map(uri)),
        difference => value(sphere.truth.as_ref().map(difference)),
        difference_percent => (DIFFERENCE_RANGE * 100.0) as u32,
    }
}

fn light_view(position: usize, light: &LightInput, input: &ReportInput) -> Value {
    let fit = input.fit.as_ref();
    let rendered = fit.and_then(|fit| fit.images.rendered.get(position));
    let residual = fit.and_then(|fit| fit.images.residual.get(position));
    let captured = light.captured.as_ref();
    // Captured and rendered images share one exposure.
    let bright = captured
        .map(|captured| captured.bright)
        .or(rendered.map(images::white_level))
        .unwrap_or(1.0);
    let white = images::white_of(input.diffuser, bright);
    let uri = |image: &RadianceImage| images::white_balanced(image, white).data_uri();
    let mut whites = white.map(|white| short(f64::from(white))).to_vec();
    whites.dedup();
    let place = light.place.map(|place| {
        // Adding zero turns −0 into 0.
        let (azimuth, elevation) = (place.azimuth_deg + 0.0, place.elevation_deg + 0.0);
        format!("azimuth {azimuth:.1}°, elevation {elevation:.1}°").replace('-', "−")
    });
    let size = captured
        .map(|captured| captured.size_px)
        .or(rendered.map(|image| [image.width, image.height]))
        .map(|[width, height]| format!("{width} × {height} pixels"));
    let channels = || (0..).zip(["red", "green", "blue"]);
    let residuals = residual
        .into_iter()
        .flat_map(|image| channels().map(move |(channel, name)| (image, channel, name)));
    let quality = captured.map(|captured| &captured.signal_to_noise);
    let whole = |ratios: [f64; 3]| ratios.map(|x| format!("{x:.0}"));
    let unusable = captured.map(|captured| {
        let [width, height] = captured.size_px;
        let share = captured.unusable as f64 / (width * height).max(1) as f64;
        format!("{} ({:.1}%)", captured.unusable, share * 100.0)
    });
    let chi_square = fit.and_then(|fit| fit.record.reduced_chi_square.get(position));
    context! {
        name => light.index + 1,
        place => value(place),
        captured => value(captured.map(|captured| uri(&captured.picture))),
        rendered => value(rendered.map(uri)),
        residuals => values(residuals, |(image, channel, name)| context! {
            name,
            uri => images::residual(image, channel).data_uri(),
        }),
        white => whites.join(", "),
        size => size.unwrap_or_default(),
        exposures => value(exposures(light)),
        snr => value(quality.map(|quality| whole(quality.median))),
        snr_low => value(quality.map(|quality| whole(quality.low))),
        unusable => value(unusable),
        chi_square => values(chi_square.into_iter().flatten(), |value| context! {
            text => format!("{value:.2}"),
            bad => *value > EXPLAINED_CHI_SQUARE,
        }),
    }
}

/// One line per lamp channel: `0.50 ms × 8`, `4.00 ms × 2`.
fn exposures(light: &LightInput) -> Vec<Vec<String>> {
    let mut lamps: Vec<_> = light.exposures.iter().map(|e| e.lamp).collect();
    lamps.sort();
    lamps.dedup();
    let line = |lamp: &Option<(u8, &str)>| {
        let name = lamp.map(|(_, colour)| format!("{colour}:"));
        let entries = light.exposures.iter().filter(|e| e.lamp == *lamp);
        let entries = entries.map(|e| format!("{} ms × {}", short(e.exposure.0 * 1e3), e.frames));
        name.into_iter().chain(entries).collect()
    };
    lamps.iter().map(line).collect()
}

fn fit_view(fit: &FitInput, input: &ReportInput) -> Result<Value, ReportError> {
    let record = &fit.record;
    let truth = input.truth.as_ref().map(|truth| &*truth.brdf);
    let figure = |(caption, svg): (String, String)| context! { caption, svg };
    let polar = figures::polar_plots(&*fit.estimate, truth, &record.table)?;
    let captions = figures::POLAR_THETA_I_DEG.map(|angle| format!("light at θi = {angle}°"));
    let slices = figures::slices(&record.table, truth)?.into_iter();
    let slices = slices.map(|(angle, svg)| (format!("θd = {angle}°"), svg));
    let (bars, hidden_atoms) = figures::weight_bars(record)?;
    let timings = record.timings.iter();
    let timings = timings.map(|timing| (&timing.stage, format!("{:.2} s", timing.seconds)));
    Ok(context! {
        name => &fit.name,
        dictionary => &record.dictionary,
        atoms => record.atoms.len(),
        polar => values(std::iter::zip(captions, polar), figure),
        slices => values(slices, figure),
        maps => value(figures::table_maps(&record.table)?),
        constrained_percent => percent(record.table.constrained_share()),
        bars,
        hidden_atoms,
        has_discrepancy => record.discrepancy.is_some(),
        hidden_below_percent => figures::SHOWN_WEIGHT * 100.0,
        trace => value(figures::trace_plot(&record.trace)?),
        loss => short(record.loss),
        steps => record.trace.last().map_or(0, |point| point.step),
        termination => &record.termination,
        timings => value(timings.collect::<Vec<_>>()),
        bench => value(record.bench.as_ref().map(bench_view)),
        budget => value(record.budget.as_ref().map(budget_view).transpose()?),
    })
}
