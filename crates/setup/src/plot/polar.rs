//! f in the plane of incidence, over a half disc.

use std::ops::Range;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::axis::{Axis, power_of_ten};
use super::canvas::{
    Area, DrawError, Figure, GRID, INK, MUTED, dashes, draw, palette, stroke, text_style, units,
};
use super::chart::{Legend, Series};

/// One channel of a polar plot: angle from the normal in degrees (negative on
/// the light's side) and log10 of the value; the band likewise.
#[derive(Clone, Debug)]
pub struct Lobe {
    /// Index into the palette.
    pub color: usize,
    /// (angle in degrees, log10 f).
    pub estimate: Vec<(f64, f64)>,
    /// (angle in degrees, log10 lower, log10 upper).
    pub band: Vec<(f64, f64, f64)>,
    /// (angle in degrees, log10 f), where the truth is known.
    pub truth: Option<Vec<(f64, f64)>>,
}

/// f in the plane of incidence over a half disc, radius logarithmic over
/// `decades` (powers of ten). The light comes from the left at `theta_i_deg`.
pub fn polar(name: &str, theta_i_deg: f64, decades: Range<f64>, lobes: &[Lobe]) -> Figure {
    draw(name, PANEL_PX, |root, _| {
        draw_half_disc(root, theta_i_deg, &decades, lobes)
    })
}

/// One of several half discs.
#[derive(Clone, Debug)]
pub struct PolarPanel {
    /// Above it.
    pub title: String,
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// The curves.
    pub lobes: Vec<Lobe>,
}

/// A half disc, CSS pixels.
const PANEL_PX: [f64; 2] = [352.0, 224.0];
const TITLE_PX: f64 = 24.0;
/// Below all discs: what the radius is.
const NOTE_PX: f64 = 22.0;

/// Half discs in rows of `columns`, all on the same scale of the radius, with a legend at
/// the bottom.
pub fn polars(
    name: &str,
    columns: usize,
    decades: Range<f64>,
    panels: &[PolarPanel],
    legend: &[Series],
) -> Figure {
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let row_px = PANEL_PX[1] + TITLE_PX;
    let [width_px, panels_px] = [columns as f64 * PANEL_PX[0], rows as f64 * row_px];
    let legend = Legend::new(legend.iter().collect(), width_px);
    let size_px = [width_px, panels_px + NOTE_PX + legend.height_px()];
    draw(name, size_px, |root, _| {
        let (upper, lower) = root.split_vertically(units(panels_px));
        for (area, panel) in upper.split_evenly((rows, columns)).iter().zip(panels) {
            let (title, disc) = area.split_vertically(units(TITLE_PX));
            let style = text_style(INK, HPos::Center, VPos::Center);
            let middle = (units(0.5 * PANEL_PX[0]), units(0.6 * TITLE_PX));
            title.draw(&Text::new(panel.title.clone(), middle, style))?;
            draw_half_disc(&disc, panel.theta_i_deg, &decades, &panel.lobes)?;
        }
        let (note, lower) = lower.split_vertically(units(NOTE_PX));
        let style = text_style(MUTED, HPos::Center, VPos::Center);
        let middle = (units(0.5 * width_px), units(0.4 * NOTE_PX));
        let text = "angle from the normal; radius: f in 1/sr, logarithmic; arrow: the light";
        note.draw(&Text::new(text, middle, style))?;
        legend.draw(&lower)
    })
}

fn draw_half_disc(
    root: &Area,
    theta_i_deg: f64,
    decades: &Range<f64>,
    lobes: &[Lobe],
) -> Result<(), DrawError> {
    let radius = |log_value: f64| {
        ((log_value - decades.start) / (decades.end - decades.start)).clamp(0.0, 1.0)
    };
    let rim = |angle_deg: f64, r: f64| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        (r * sin, r * cos)
    };
    let at = |(angle_deg, log_value): (f64, f64)| rim(angle_deg, radius(log_value));
    let mut plot = ChartBuilder::on(root)
        .margin(units(2.0))
        .build_cartesian_2d(Axis::bare(-1.2..1.2), Axis::bare(-0.26..1.26))?;
    // The grid: arcs with their values, spokes with their angles.
    let arc = |r: f64| (-90..=90).step_by(3).map(move |deg| rim(f64::from(deg), r));
    let exponents = (decades.start.ceil() as i32)..=(decades.end.floor() as i32);
    let stride = ((decades.end - decades.start) / 5.0).ceil().max(1.0) as usize;
    for exponent in exponents.step_by(stride) {
        let r = radius(f64::from(exponent));
        if r > 0.0 {
            plot.draw_series(LineSeries::new(arc(r), stroke(GRID, 1.0)))?;
        }
        let style = text_style(MUTED, HPos::Center, VPos::Top);
        for x in if r > 0.0 { vec![r, -r] } else { vec![r] } {
            let text = power_of_ten(exponent);
            plot.draw_series([Text::new(text, (x, -0.04), style.clone())])?;
        }
    }
    for angle_deg in [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0f64] {
        let spoke = [(0.0, 0.0), rim(angle_deg, 1.0)];
        plot.draw_series(LineSeries::new(spoke, stroke(GRID, 1.0)))?;
        if angle_deg.abs() < 90.0 {
            let text = format!("{angle_deg}°").replace('-', "−");
            let style = text_style(MUTED, HPos::Center, VPos::Center);
            plot.draw_series([Text::new(text, rim(angle_deg, 1.13), style)])?;
        }
    }
    // The bands below all curves.
    for lobe in lobes {
        let lower = lobe.band.iter().map(|(angle, low, _)| at((*angle, *low)));
        let upper = lobe.band.iter().rev();
        let upper = upper.map(|(angle, _, high)| at((*angle, *high)));
        let outline: Vec<_> = lower.chain(upper).collect();
        if !outline.is_empty() {
            plot.draw_series([Polygon::new(outline, palette(lobe.color).mix(0.15))])?;
        }
    }
    for lobe in lobes {
        let color = palette(lobe.color);
        let points = lobe.estimate.iter().copied().map(at);
        plot.draw_series(LineSeries::new(points, stroke(color, 1.6)))?;
        if let Some(truth) = &lobe.truth {
            plot.draw_series(dashes(truth.iter().copied().map(at), color))?;
        }
    }
    // The incoming light: an arrow that ends at the surface.
    let (tail, tip) = (rim(-theta_i_deg, 0.96), rim(-theta_i_deg, 0.02));
    plot.draw_series(LineSeries::new([tail, tip], stroke(INK, 1.5)))?;
    for side in [-22.0, 22.0] {
        let (dx, dy) = rim(-theta_i_deg + side, 0.07);
        let barb = [(tip.0 + dx, tip.1 + dy), tip];
        plot.draw_series(LineSeries::new(barb, stroke(INK, 1.5)))?;
    }
    Ok(())
}
