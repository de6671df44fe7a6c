//! Calibrations as figures.

use glam::DVec3;

use super::lamp::LampFit;
use super::mirror_sphere::light::{FoundLight, tangents};
use super::record::{ResponseCurve, ResponseValues};
use super::sensor::{Exposed, SensorFit, TransferPoint};
use super::stage_directions::StageFit;
use crate::config::geometry::GeometryConfig;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::units::StageAngles;

/// The photon transfer curve with its fit, and the deviation of counts from
/// proportionality.
pub fn photon_transfer(fit: &SensorFit) -> Figure {
    let values = &fit.values;
    let point = |p: &&TransferPoint| [p.signal_dn, p.variance_dn2];
    let error_bar = |p: &&TransferPoint| {
        let (v, s) = (p.variance_dn2, p.variance_std_dn2);
        [p.signal_dn, v - s, v + s]
    };
    let top_dn = fit.curve.iter().map(|p| p.signal_dn).fold(1.0, f64::max);
    let top_dn2 = fit.curve.iter().map(|p| p.variance_dn2).fold(1.0, f64::max);
    // Shorter error bars would be invisible.
    let seen = |p: &&TransferPoint| p.variance_std_dn2 > 1e-3 * top_dn2;
    let of = |fitted: bool| fit.curve.iter().filter(move |p| p.fitted == fitted);
    let dots = |label: &str, color: usize, fitted: bool| {
        Series::new(
            label,
            color,
            Mark::Dots,
            of(fitted).map(|p| point(&p)).collect(),
        )
        .within(of(fitted).filter(seen).map(|p| error_bar(&p)).collect())
    };
    let line = |x: f64| [x, fit.variance_at_zero_dn2 + values.gain_dn_per_e.value * x];
    let label = format!(
        "K = {:.4} ± {:.4} DN/e⁻",
        values.gain_dn_per_e.value, values.gain_dn_per_e.std
    );
    let end = ((1.1 * top_dn2 - fit.variance_at_zero_dn2) / values.gain_dn_per_e.value).min(top_dn);
    let transfer = Chart {
        title: "Photon transfer".to_owned(),
        x: Axis::linear(0.0..1.05 * top_dn, "signal above black (DN)"),
        y: Axis::linear(0.0..1.15 * top_dn2, "temporal variance (DN²)"),
        series: vec![
            Series::new(&label, 0, Mark::Line, vec![line(0.0), line(end)]),
            dots("in the fit", 1, true),
            dots("not in the fit", 2, false),
        ],
    };
    let counted = deviations(fit, |p| p.counted_dn);
    let corrected = deviations(fit, |p| p.signal_dn);
    let all = counted.iter().chain(&corrected);
    let widest = all.map(|p| p[1].abs()).fold(0.5, f64::max);
    let linearity = Chart {
        title: "Linearity".to_owned(),
        x: Axis::linear(0.0..1.05 * top_dn, "signal above black (DN)"),
        y: Axis::linear(-1.2 * widest..1.2 * widest, "deviation from the mean (%)"),
        series: vec![
            Series::new("", 0, Mark::Line, vec![[0.0, 0.0], [1.05 * top_dn, 0.0]]),
            Series::new("counts over exposure", 3, Mark::Points, counted),
            Series::new("corrected", 1, Mark::Dots, corrected),
        ],
    };
    charts("photon-transfer", 2, &[transfer, linearity])
}

/// Signal over exposure less its mean over the fitted flats, percent, up to
/// saturation; from a twentieth of it, below which black level and noise rule.
fn deviations(fit: &SensorFit, signal_dn: fn(&TransferPoint) -> f64) -> Vec<[f64; 2]> {
    let values = &fit.values;
    let usable_dn = values.saturation_dn - values.black_level_dn.value;
    let dark_dn_s = values.dark_current_e_s.value * values.gain_dn_per_e.value;
    let flats: Vec<(&TransferPoint, f64)> = fit
        .curve
        .iter()
        .filter(|p| p.exposed == Exposed::Flat)
        .filter(|p| (0.05..1.0).contains(&(p.counted_dn / usable_dn)))
        .map(|p| (p, signal_dn(p) / p.exposure_s - dark_dn_s))
        .collect();
    let fitted: Vec<f64> = flats
        .iter()
        .filter(|(p, _)| p.fitted)
        .map(|f| f.1)
        .collect();
    let mean = fitted.iter().sum::<f64>() / fitted.len().max(1) as f64;
    flats
        .iter()
        .map(|(p, rate)| [p.counted_dn, 100.0 * (rate / mean - 1.0)])
        .collect()
}

/// The lamp's level over time with its fit, and its flicker by exposure.
pub fn lamp(fit: &LampFit) -> Figure {
    let minutes = |s: f64| s / 60.0;
    let measured = fit
        .levels
        .iter()
        .map(|l| [minutes(l.time_s), 100.0 * l.level]);
    let fitted = fit
        .levels
        .iter()
        .map(|l| [minutes(l.time_s), 100.0 * fit.level(l.time_s)]);
    let (measured, fitted): (Vec<_>, Vec<_>) = (measured.collect(), fitted.collect());
    let range = |index: usize, points: &[[f64; 2]]| {
        let low = points
            .iter()
            .map(|p| p[index])
            .fold(f64::INFINITY, f64::min);
        let high = points
            .iter()
            .map(|p| p[index])
            .fold(f64::NEG_INFINITY, f64::max);
        let margin = 0.05 * (high - low).max(1e-3);
        low - margin..high + margin
    };
    let warm_up = fit.values.warm_up_time_s / 60.0;
    let y = range(1, &measured);
    let series = vec![
        Series::new("measured", 1, Mark::Dots, measured.clone()),
        Series::new("fit", 0, Mark::Line, fitted),
        Series::new(
            &format!("warm after {warm_up:.1} min"),
            3,
            Mark::Dashed,
            vec![[warm_up, y.start], [warm_up, y.end]],
        ),
    ];
    let level = Chart {
        title: "Level after switching on".to_owned(),
        x: Axis::linear(range(0, &measured), "time (min)"),
        y: Axis::linear(y, "level, warm = 100 (%)"),
        series,
    };
    let flicker: Vec<[f64; 2]> = fit
        .values
        .flicker
        .iter()
        .map(|f| [(1e3 * f.exposure_s).log10(), 100.0 * f.relative.value])
        .collect();
    let highest = flicker.iter().map(|p| p[1]).fold(0.1, f64::max);
    let x = range(0, &flicker);
    let flicker = Chart {
        title: "Flicker".to_owned(),
        x: Axis::decades(x.start - 0.1..x.end + 0.1, "exposure (ms)"),
        y: Axis::linear(0.0..1.2 * highest, "between frames, less noise (%)"),
        series: vec![Series::new("flicker", 2, Mark::Points, flicker)],
    };
    charts("lamp", 2, &[level, flicker])
}

/// Counts over exposures, and the relative uncertainty of the exposure.
pub fn response(values: &ResponseValues) -> Figure {
    let labels: &[(&str, usize)] = match values.channels.len() {
        1 => &[("grey", 0)],
        _ => &[("red", 1), ("green", 2), ("blue", 0)],
    };
    let curves = || values.channels.iter().zip(labels);
    let decades = |ln: f64| ln / std::f64::consts::LN_10;
    // Black and white counts stand for all exposures beyond.
    let seen = |curve: &ResponseCurve| usize::from(curve.darkest).clamp(2, 128)..251;
    let ends = values.channels.iter().flat_map(|c| {
        let ends = [c.ln_exposure[seen(c).start], c.ln_exposure[seen(c).end - 1]];
        ends.map(decades)
    });
    let low = ends.clone().fold(0.0, f64::min);
    let high = ends.fold(0.0, f64::max);
    let counts = curves().map(|(curve, (label, color))| {
        let at = |z: usize| [decades(curve.ln_exposure[z]), z as f64];
        Series::new(label, *color, Mark::Line, seen(curve).map(at).collect())
    });
    let stated = curves().map(|(curve, (label, color))| {
        let at = |z: usize| [z as f64, 100.0 * curve.ln_std[z]];
        Series::new(label, *color, Mark::Line, seen(curve).map(at).collect())
    });
    let all = values.channels.iter().flat_map(|c| &c.ln_std[seen(c)]);
    let widest = 100.0 * all.copied().fold(1e-4, f64::max);
    let panels = [
        Chart {
            title: "Response".to_owned(),
            x: Axis::decades(low - 0.1..high + 0.1, "exposure, count 128 = 1"),
            y: Axis::with_step(0.0..256.0, 64.0, "count (DN)"),
            series: counts.collect(),
        },
        Chart {
            title: "Uncertainty".to_owned(),
            x: Axis::with_step(0.0..256.0, 64.0, "count (DN)"),
            y: Axis::linear(0.0..1.1 * widest, "of the exposure (%)"),
            series: stated.collect(),
        },
    ];
    charts("response", 2, &panels)
}

/// Directions of the lights against the rig file, and against the fitted stage.
pub fn light_directions(
    geometry: &GeometryConfig,
    angles: &[StageAngles],
    found: &[FoundLight],
    stage: Option<&StageFit>,
) -> Figure {
    let configured = |angles: StageAngles| geometry.sample_from_stage.direction(angles.to_light());
    let panel = |title: &str, expected: &dyn Fn(StageAngles) -> DVec3| {
        let series = ["azimuth, along the arc", "elevation"].map(|label| label.to_owned());
        let mut widest: f64 = 0.02;
        let series = [0, 1].map(|axis| {
            let mut points = Vec::new();
            let mut bars = Vec::new();
            for (light, (&angles, found)) in (1_u32..).zip(angles.iter().zip(found)) {
                let off = found.to_light - expected(angles);
                let degrees = tangents(found.to_light)[axis].dot(off).to_degrees();
                let std = found.covariance()[(axis, axis)].sqrt().to_degrees();
                widest = widest.max(degrees.abs() + std);
                points.push([f64::from(light), degrees]);
                bars.push([f64::from(light), degrees - std, degrees + std]);
            }
            Series::new(&series[axis], axis, Mark::Dots, points).within(bars)
        });
        Chart {
            title: title.to_owned(),
            x: Axis::linear(0.5..found.len() as f64 + 0.5, "light"),
            y: Axis::linear(-1.1 * widest..1.1 * widest, "measured less expected (deg)"),
            series: series.to_vec(),
        }
    };
    let mut panels = vec![panel("Against the rig file", &configured)];
    if let Some(stage) = stage {
        panels.push(panel("Against the fitted stage", &|a| stage.to_light(a)));
    }
    charts("light-directions", 2, &panels)
}
