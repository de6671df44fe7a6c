//! By how much BRDFs differ from a reference, over half and difference angle.

use super::Named;
use crate::brdf::HalfDifference;
use crate::plot::colors::diverging;
use crate::plot::{Axis, Figure, HeatMap, HeatMaps, Picture, heat_maps};
use crate::session::fit_record::lookup::SMALLEST;

/// The scale's ends: a quarter and four times, powers of two.
const RANGE: f64 = 2.0;
/// Pixels a side of a map.
const SIDE_PX: usize = 240;

/// f of each but the last over f of the last, at φd = 90° and as the mean of the channels;
/// hatched where the images of either do not constrain it.
pub fn difference(all: &[Named]) -> Figure {
    let Some((reference, others)) = all.split_last() else {
        return heat_maps("difference", &maps(&[], ""));
    };
    let drawn: Vec<HeatMap> = others
        .iter()
        .map(|named| HeatMap {
            title: named.label.clone(),
            picture: map(named, reference),
        })
        .collect();
    heat_maps("difference", &maps(&drawn, &reference.label))
}

fn maps<'a>(drawn: &'a [HeatMap], reference: &str) -> HeatMaps<'a> {
    let ticks = [
        (-2.0, "1/4"),
        (-1.0, "1/2"),
        (0.0, "1"),
        (1.0, "2"),
        (2.0, "4"),
    ];
    let ticks = ticks.map(|(at, text)| (at, text.to_owned()));
    HeatMaps {
        columns: drawn.len().min(3),
        cell_px: [300.0, 280.0],
        x: Axis::half_angles("half angle θh"),
        y: Axis::with_step(0.0..90.0, 15.0, "difference angle θd / °"),
        scale: Axis::with_ticks(
            -RANGE..RANGE,
            ticks.into(),
            &format!("f over f of {reference}"),
        ),
        colors: |part| diverging(2.0 * part - 1.0),
        maps: drawn,
    }
}

fn map(named: &Named, reference: &Named) -> Picture {
    Picture::from_fn(SIDE_PX, SIDE_PX, |x, y| {
        let across = (x as f64 + 0.5) / SIDE_PX as f64;
        let theta_h_deg = 90.0 * across * across;
        let theta_d_deg = 90.0 * (1.0 - (y as f64 + 0.5) / SIDE_PX as f64);
        let is_constrained = |named: &Named| named.is_constrained(theta_h_deg, theta_d_deg);
        if !(is_constrained(named) && is_constrained(reference)) {
            let shade = if (x + y) % 8 < 2 { 140 } else { 196 };
            return [shade, shade, shade, 255];
        }
        let (to_light, to_viewer) = HalfDifference {
            theta_h_rad: theta_h_deg.to_radians(),
            theta_d_rad: theta_d_deg.to_radians(),
            phi_d_rad: std::f64::consts::FRAC_PI_2,
        }
        .to_directions();
        let mean = |named: &Named| {
            let f = named.brdf.eval(to_light.as_vec3(), to_viewer.as_vec3());
            (f.iter().map(|&f| f64::from(f)).sum::<f64>() / 3.0).max(SMALLEST)
        };
        let ratio = (mean(named) / mean(reference)).log2();
        let [r, g, b] = diverging((ratio / RANGE) as f32);
        [r, g, b, 255]
    })
}
