//! The report's figures as inline SVG, drawn by `plotters`.
//!
//! Colours are written as placeholders that [`finish`] turns into CSS
//! variables, so that one figure serves light, dark and print. Coordinates are
//! in quarters of a CSS pixel, because the SVG backend rounds to whole numbers.

mod bars;
mod heat_map;
mod polar;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub use crate::plot::axis::{Axis, power_of_ten};
pub use bars::{BarRow, bars};
pub use heat_map::{HeatMap, heat_map};
pub use polar::{Lobe, polar};

/// Why a figure could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("figure: {0}")]
pub struct PlotError(String);

impl<E: std::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for PlotError {
    fn from(error: DrawingAreaErrorKind<E>) -> Self {
        Self(error.to_string())
    }
}

/// Drawing units per CSS pixel.
const UNITS: i32 = 4;
const FONT_PX: i32 = 13;

const TEXT: RGBColor = RGBColor(1, 0, 0);
pub(super) const MUTED: RGBColor = RGBColor(2, 0, 0);
const GRID: RGBColor = RGBColor(3, 0, 0);
/// Placeholders of the channels' colours.
pub const CHANNELS: [RGBColor; 3] = [RGBColor(4, 0, 0), RGBColor(5, 0, 0), RGBColor(6, 0, 0)];
/// Placeholder of the colour for what belongs to no channel.
pub const ACCENT: RGBColor = RGBColor(7, 0, 0);

const PLACEHOLDERS: [(&str, &str); 7] = [
    ("#010000", "var(--ink)"),
    ("#020000", "var(--muted)"),
    ("#030000", "var(--grid)"),
    ("#040000", "var(--channel-r)"),
    ("#050000", "var(--channel-g)"),
    ("#060000", "var(--channel-b)"),
    ("#070000", "var(--accent)"),
];

/// Makes the SVG follow the page's width and colours. Inside HTML it needs no
/// namespace.
fn finish(svg: &str, title: &str) -> String {
    let body = svg.split_once(">\n").map_or("", |(_, body)| body);
    let view_box = svg
        .split_once("viewBox=\"")
        .and_then(|(_, rest)| rest.split_once('"'))
        .map_or("", |(view_box, _)| view_box);
    let mut out =
        format!("<svg viewBox=\"{view_box}\" role=\"img\" aria-label=\"{title}\">\n{body}");
    for (placeholder, variable) in PLACEHOLDERS {
        out = out.replace(placeholder, variable);
    }
    out
}

fn draw<F>(size_px: (i32, i32), title: &str, paint: F) -> Result<String, PlotError>
where
    F: FnOnce(&DrawingArea<SVGBackend, Shift>) -> Result<(), PlotError>,
{
    let mut svg = String::new();
    {
        let size = ((size_px.0 * UNITS) as u32, (size_px.1 * UNITS) as u32);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        paint(&root)?;
        root.present()?;
    }
    Ok(finish(&svg, title))
}

fn text_style(color: RGBColor, h_pos: HPos, v_pos: VPos) -> TextStyle<'static> {
    // The backend divides by 1.24 what it calls a size.
    let size = f64::from(FONT_PX * UNITS) * 1.24;
    ("sans-serif", size)
        .into_font()
        .color(&color)
        .pos(Pos::new(h_pos, v_pos))
}

fn stroke(color: RGBColor, width_px: f64) -> ShapeStyle {
    color.stroke_width((width_px * f64::from(UNITS)).round() as u32)
}

/// A broken line, as the truth is drawn.
fn dashes<I: Iterator<Item = (f64, f64)> + Clone>(
    points: I,
    style: ShapeStyle,
) -> DashedLineSeries<I, i32> {
    DashedLineSeries::new(points, 6 * UNITS, 5 * UNITS, style)
}

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>;

/// Lines, ticks and labels of both axes, on a grid if wanted. An axis without a
/// label at the bottom is left out.
fn draw_axes(chart: &mut Chart, x: &Axis, y: &Axis, grid: bool) -> Result<(), PlotError> {
    let mut mesh = chart.configure_mesh();
    mesh.axis_style(stroke(MUTED, 1.0))
        .bold_line_style(stroke(GRID, 1.0))
        .light_line_style(TRANSPARENT)
        .label_style(text_style(MUTED, HPos::Center, VPos::Center))
        .axis_desc_style(text_style(MUTED, HPos::Center, VPos::Center))
        .set_all_tick_mark_size(4 * UNITS)
        .x_desc(x.label.as_str())
        .y_desc(y.label.as_str());
    if !grid {
        mesh.disable_mesh();
    }
    if x.label.is_empty() {
        mesh.disable_x_axis();
    }
    mesh.draw()?;
    Ok(())
}

/// A curve.
#[derive(Clone, Debug)]
pub struct Line {
    /// Points in the axes' units (powers of ten on logarithmic axes).
    pub points: Vec<(f64, f64)>,
    /// A placeholder such as one of [`CHANNELS`].
    pub color: RGBColor,
    /// Broken, as the truth is drawn.
    pub dashed: bool,
}

/// The area between two curves.
#[derive(Clone, Debug)]
pub struct Band {
    /// (x, lower, upper).
    pub points: Vec<(f64, f64, f64)>,
    /// A placeholder such as one of [`CHANNELS`].
    pub color: RGBColor,
}

fn band_outline(band: &Band) -> Vec<(f64, f64)> {
    let lower = band.points.iter().map(|(x, low, _)| (*x, *low));
    let upper = band.points.iter().rev().map(|(x, _, high)| (*x, *high));
    lower.chain(upper).collect()
}

/// Curves and bands over two axes.
pub fn chart(
    title: &str,
    size_px: (i32, i32),
    x: &Axis,
    y: &Axis,
    bands: &[Band],
    lines: &[Line],
) -> Result<String, PlotError> {
    let inside = |(px, py): (f64, f64)| (px, py.clamp(y.range.start, y.range.end));
    draw(size_px, title, |root| {
        let mut chart = ChartBuilder::on(root)
            .margin(8 * UNITS)
            .margin_right(16 * UNITS)
            .x_label_area_size(40 * UNITS)
            .y_label_area_size(52 * UNITS)
            .build_cartesian_2d(x.clone(), y.clone())?;
        draw_axes(&mut chart, x, y, true)?;
        for band in bands {
            let outline: Vec<_> = band_outline(band).into_iter().map(inside).collect();
            chart.draw_series([Polygon::new(outline, band.color.mix(0.16))])?;
        }
        for line in lines {
            let points = line.points.iter().copied().map(inside);
            if line.dashed {
                chart.draw_series(dashes(points, stroke(line.color, 1.5)))?;
            } else {
                chart.draw_series(LineSeries::new(points, stroke(line.color, 1.75)))?;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_follows_the_page() {
        let line = Line {
            points: vec![(0.0, 0.0), (1.0, 5.0)],
            color: CHANNELS[1],
            dashed: false,
        };
        let (x, y) = (
            Axis::linear(0.0..1.0, "step"),
            Axis::decades(-1.0..2.0, "loss"),
        );
        let svg = chart("loss", (320, 200), &x, &y, &[], &[line]).unwrap();
        assert!(svg.starts_with("<svg viewBox=\"0 0 1280 800\""));
        assert!(svg.contains("var(--channel-g)") && svg.contains("10⁻¹") && svg.contains("step"));
        assert!(!svg.contains("http") && !svg.contains("#050000"));
    }
}
