//! The report's figures as inline SVG, drawn by `plotters`.
//!
//! Colours are written as placeholders that [`finish`] turns into CSS
//! variables, so that one figure serves light, dark and print. Coordinates are
//! in quarters of a CSS pixel, because the SVG backend rounds to whole numbers.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::images::{self, Picture};

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

/// One axis: its range, where its ticks stand and what they say.
#[derive(Clone, Debug)]
pub struct Axis {
    range: Range<f64>,
    ticks: Vec<(f64, String)>,
    label: String,
}

impl Axis {
    /// Linear, with about five round ticks.
    pub fn linear(range: Range<f64>, label: &str) -> Self {
        let span = (range.end - range.start).max(f64::MIN_POSITIVE);
        let power = 10f64.powf((span / 5.0).log10().floor());
        let step = [1.0, 2.0, 2.5, 5.0, 10.0]
            .map(|factor| factor * power)
            .into_iter()
            .find(|step| span / step <= 6.0)
            .unwrap_or(span);
        Self::with_step(range, step, label)
    }

    /// Linear, with a tick at every multiple of `step`.
    pub fn with_step(range: Range<f64>, step: f64, label: &str) -> Self {
        let number = |value: f64| {
            let digits = (2.0 - step.log10()).clamp(0.0, 12.0) as i32;
            let scale = 10f64.powi(digits);
            format!("{}", (value * scale).round() / scale).replace('-', "−")
        };
        let ticks = multiples(&range, step).map(|value| (value, number(value)));
        Self {
            ticks: ticks.collect(),
            range,
            label: label.to_owned(),
        }
    }

    /// Logarithmic: the range is in powers of ten, and so is what is plotted.
    pub fn decades(range: Range<f64>, label: &str) -> Self {
        let step = ((range.end - range.start) / 6.0).ceil().max(1.0);
        let whole = multiples(&range, step);
        let mut ticks: Vec<_> = whole
            .map(|value| (value, power_of_ten(value.round() as i32)))
            .collect();
        if ticks.len() < 3 {
            // Less than two decades: 1, 2 and 5 of each, as plain numbers.
            let exponents = range.start.floor() as i32..=range.end.ceil() as i32;
            let fine = exponents.flat_map(|n| [1.0, 2.0, 5.0].map(|digit| (digit, n)));
            ticks = fine
                .map(|(digit, n)| (f64::log10(digit) + f64::from(n), plain(digit, n)))
                .filter(|(position, _)| range.contains(position) || *position == range.end)
                .collect();
        }
        Self {
            ticks,
            range,
            label: label.to_owned(),
        }
    }

    /// Half angles on the square-root scale of the MERL tables, which shows a
    /// narrow highlight; positions are [`Self::half_angle`].
    pub fn half_angles(label: &str) -> Self {
        let ticks = [0.0, 2.0, 10.0, 25.0, 45.0, 90.0];
        Self {
            ticks: ticks
                .map(|deg| (Self::half_angle(deg), format!("{deg}°")))
                .into(),
            range: 0.0..1.0,
            label: label.to_owned(),
        }
    }

    /// The position 0..=1 of a half angle in degrees on [`Self::half_angles`].
    pub fn half_angle(theta_h_deg: f64) -> f64 {
        (theta_h_deg.max(0.0) / 90.0).sqrt()
    }

    /// No ticks, no label.
    fn bare(range: Range<f64>) -> Self {
        Self {
            range,
            ticks: Vec::new(),
            label: String::new(),
        }
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let part = (value - self.range.start) / (self.range.end - self.range.start);
        limit.0 + (part * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.iter().map(|(position, _)| *position).collect()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, position: &f64) -> String {
        let tick = self.ticks.iter().find(|(at, _)| at == position);
        tick.map_or_else(String::new, |(_, text)| text.clone())
    }
}

/// The multiples of `step` in `range`, at most a hundred.
fn multiples(range: &Range<f64>, step: f64) -> impl Iterator<Item = f64> + use<> {
    let first = (range.start / step - 1e-9).ceil() as i64;
    let last = (range.end / step + 1e-9).floor() as i64;
    (first..=last.min(first.saturating_add(100))).map(move |n| n as f64 * step)
}

/// digit · 10ⁿ as a number where that is short.
fn plain(digit: f64, exponent: i32) -> String {
    if (-4..5).contains(&exponent) {
        let digits = (-exponent).max(0) as usize;
        format!("{:.digits$}", digit * 10f64.powi(exponent))
    } else {
        format!("{digit}·{}", power_of_ten(exponent))
    }
}

/// `10⁻³` and the like.
pub fn power_of_ten(exponent: i32) -> String {
    let digits = exponent.to_string();
    let raised = digits.chars().map(|c| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        digit => char::from_u32('⁰' as u32 + digit as u32 - '0' as u32).unwrap_or(digit),
    });
    std::iter::once("10".to_owned())
        .chain(raised.map(String::from))
        .collect()
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
        let label = text_style(MUTED, HPos::Center, VPos::Center);
        chart
            .configure_mesh()
            .axis_style(stroke(MUTED, 1.0))
            .bold_line_style(stroke(GRID, 1.0))
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", FONT_PX * UNITS * 5 / 4, &MUTED))
            .axis_desc_style(label)
            .set_all_tick_mark_size(4 * UNITS)
            .x_desc(x.label.as_str())
            .y_desc(y.label.as_str())
            .draw()?;
        for band in bands {
            let outline: Vec<_> = band_outline(band).into_iter().map(inside).collect();
            chart.draw_series([Polygon::new(outline, band.color.mix(0.16))])?;
        }
        for line in lines {
            let points = line.points.iter().copied().map(inside);
            let style = stroke(line.color, 1.75);
            if line.dashed {
                chart.draw_series(DashedLineSeries::new(
                    points,
                    6 * UNITS as u32,
                    5 * UNITS as u32,
                    style,
                ))?;
            } else {
                chart.draw_series(LineSeries::new(points, style))?;
            }
        }
        Ok(())
    })
}

/// One channel of a polar plot: angle from the normal in degrees (negative on
/// the light's side) and log10 of the value; the band likewise.
#[derive(Clone, Debug)]
pub struct Lobe {
    /// A placeholder such as one of [`CHANNELS`].
    pub color: RGBColor,
    /// (angle in degrees, log10 f).
    pub estimate: Vec<(f64, f64)>,
    /// (angle in degrees, log10 lower, log10 upper).
    pub band: Vec<(f64, f64, f64)>,
    /// (angle in degrees, log10 f), where the truth is known.
    pub truth: Option<Vec<(f64, f64)>>,
}

/// f in the plane of incidence over a half disc, radius logarithmic over
/// `decades` (powers of ten). The light comes from the left at `theta_i_deg`.
pub fn polar(
    title: &str,
    theta_i_deg: f64,
    decades: Range<f64>,
    lobes: &[Lobe],
) -> Result<String, PlotError> {
    let radius = |log_value: f64| {
        ((log_value - decades.start) / (decades.end - decades.start)).clamp(0.0, 1.0)
    };
    let at = |(angle_deg, log_value): (f64, f64)| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        (radius(log_value) * sin, radius(log_value) * cos)
    };
    let rim = |angle_deg: f64, r: f64| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        (r * sin, r * cos)
    };
    draw((360, 228), title, |root| {
        let mut chart = ChartBuilder::on(root)
            .margin(2 * UNITS)
            .build_cartesian_2d(-1.2..1.2, -0.26..1.26)?;
        let arc = |r: f64| (-90..=90).step_by(3).map(move |deg| rim(f64::from(deg), r));
        let exponents = (decades.start.ceil() as i32)..=(decades.end.floor() as i32);
        let stride = ((decades.end - decades.start) / 5.0).ceil().max(1.0) as usize;
        for exponent in exponents.step_by(stride) {
            let r = radius(f64::from(exponent));
            if r > 0.0 {
                chart.draw_series(LineSeries::new(arc(r), stroke(GRID, 1.0)))?;
            }
            let style = text_style(MUTED, HPos::Center, VPos::Top);
            for x in if r > 0.0 { vec![r, -r] } else { vec![r] } {
                let text = power_of_ten(exponent);
                chart.draw_series([Text::new(text, (x, -0.04), style.clone())])?;
            }
        }
        for angle_deg in [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0f64] {
            let spoke = [(0.0, 0.0), rim(angle_deg, 1.0)];
            chart.draw_series(LineSeries::new(spoke, stroke(GRID, 1.0)))?;
            if angle_deg.abs() < 90.0 {
                let text = format!("{angle_deg}°").replace('-', "−");
                let style = text_style(MUTED, HPos::Center, VPos::Center);
                chart.draw_series([Text::new(text, rim(angle_deg, 1.13), style)])?;
            }
        }
        for lobe in lobes {
            let lower = lobe.band.iter().map(|(angle, low, _)| at((*angle, *low)));
            let upper = lobe
                .band
                .iter()
                .rev()
                .map(|(angle, _, high)| at((*angle, *high)));
            let outline: Vec<_> = lower.chain(upper).collect();
            if !outline.is_empty() {
                chart.draw_series([Polygon::new(outline, lobe.color.mix(0.16))])?;
            }
        }
        for lobe in lobes {
            let points = lobe.estimate.iter().copied().map(at);
            chart.draw_series(LineSeries::new(points, stroke(lobe.color, 1.75)))?;
            if let Some(truth) = &lobe.truth {
                let points = truth.iter().copied().map(at);
                let style = stroke(lobe.color, 1.5);
                chart.draw_series(DashedLineSeries::new(
                    points,
                    6 * UNITS as u32,
                    5 * UNITS as u32,
                    style,
                ))?;
            }
        }
        // The incoming light: an arrow that ends at the surface.
        let (tail, tip) = (rim(-theta_i_deg, 0.96), rim(-theta_i_deg, 0.02));
        chart.draw_series(LineSeries::new([tail, tip], stroke(TEXT, 1.5)))?;
        let barb = |side: f64| {
            let (dx, dy) = rim(-theta_i_deg + side, 0.07);
            [(tip.0 + dx, tip.1 + dy), tip]
        };
        for side in [-22.0, 22.0] {
            chart.draw_series(LineSeries::new(barb(side), stroke(TEXT, 1.5)))?;
        }
        Ok(())
    })
}

/// One row of [`bars`].
#[derive(Clone, Debug)]
pub struct BarRow {
    /// What stands at the left.
    pub label: String,
    /// R, G, B.
    pub value: [f64; 3],
    /// Standard deviation of each.
    pub deviation: [f64; 3],
}

/// Horizontal bars, three per row, with their standard deviations.
pub fn bars(title: &str, rows: &[BarRow]) -> Result<String, PlotError> {
    let row_px = 34;
    let height_px = row_px * rows.len() as i32 + 56;
    let most = rows
        .iter()
        .flat_map(|row| (0..3).map(|c| row.value[c] + row.deviation[c]))
        .fold(0.05, f64::max);
    let x = Axis::linear(0.0..(most * 1.04).min(1.1), "weight");
    draw((640, height_px), title, |root| {
        let count = rows.len() as f64;
        let mut chart = ChartBuilder::on(root)
            .margin(8 * UNITS)
            .margin_right(16 * UNITS)
            .x_label_area_size(40 * UNITS)
            .y_label_area_size(140 * UNITS)
            .build_cartesian_2d(x.clone(), Axis::bare(count..0.0))?;
        chart
            .configure_mesh()
            .axis_style(stroke(MUTED, 1.0))
            .bold_line_style(stroke(GRID, 1.0))
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", FONT_PX * UNITS * 5 / 4, &MUTED))
            .axis_desc_style(text_style(MUTED, HPos::Center, VPos::Center))
            .set_all_tick_mark_size(4 * UNITS)
            .x_desc(x.label.as_str())
            .draw()?;
        for (index, row) in rows.iter().enumerate() {
            for channel in 0..3 {
                let top = index as f64 + 0.14 + 0.24 * channel as f64;
                let middle = top + 0.12;
                let value = row.value[channel];
                let bar = [(0.0, top + 0.02), (value, top + 0.22)];
                chart.draw_series([Rectangle::new(bar, CHANNELS[channel].mix(0.75).filled())])?;
                let low = (value - row.deviation[channel]).max(0.0);
                let high = (value + row.deviation[channel]).min(x.range.end);
                let whisker = [(low, middle), (high, middle)];
                chart.draw_series(LineSeries::new(whisker, stroke(TEXT, 1.0)))?;
            }
        }
        let left = chart.plotting_area().get_pixel_range().0.start;
        for (index, row) in rows.iter().enumerate() {
            let (_, y) = chart.backend_coord(&(0.0, index as f64 + 0.5));
            let style = text_style(TEXT, HPos::Right, VPos::Center);
            root.draw(&Text::new(row.label.clone(), (left - 8 * UNITS, y), style))?;
        }
        Ok(())
    })
}

/// A picture over two axes with a colour bar at its right.
pub struct HeatMap<'a> {
    /// Read aloud in place of the figure.
    pub title: &'a str,
    /// Row 0 is the top; stretched over the axes.
    pub picture: &'a Picture,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis, upwards.
    pub y: Axis,
    /// Colours of the bar, lowest first.
    pub bar_colors: &'a [[u8; 3]],
    /// The bar's axis.
    pub bar: Axis,
}

/// Draws a [`HeatMap`]. The picture is embedded as a PNG.
pub fn heat_map(map: &HeatMap) -> Result<String, PlotError> {
    let mut frames = Vec::new();
    let svg = draw((500, 350), map.title, |root| {
        let (main, side) = root.split_horizontally(404 * UNITS);
        for (area, x, y, label_px) in [
            (&main, Some(&map.x), &map.y, 52),
            (&side, None, &map.bar, 58),
        ] {
            let bare = Axis::bare(0.0..1.0);
            let x = x.unwrap_or(&bare);
            let mut chart = ChartBuilder::on(area)
                .margin(8 * UNITS)
                .x_label_area_size(40 * UNITS)
                .y_label_area_size(label_px * UNITS)
                .build_cartesian_2d(x.clone(), y.clone())?;
            let (x_px, y_px) = chart.plotting_area().get_pixel_range();
            frames.push((x_px, y_px));
            let mut mesh = chart.configure_mesh();
            mesh.disable_mesh()
                .axis_style(stroke(MUTED, 1.0))
                .label_style(("sans-serif", FONT_PX * UNITS * 5 / 4, &MUTED))
                .axis_desc_style(text_style(MUTED, HPos::Center, VPos::Center))
                .set_all_tick_mark_size(4 * UNITS)
                .x_desc(x.label.as_str())
                .y_desc(y.label.as_str());
            if x.label.is_empty() {
                mesh.disable_x_axis();
            }
            mesh.draw()?;
        }
        Ok(())
    })?;
    // The SVG backend draws no pictures in a build without fonts and codecs, so
    // they are put in behind what it drew.
    let bar = Picture::column(map.bar_colors);
    let images: String = frames
        .iter()
        .zip([map.picture, &bar])
        .map(|((x, y), picture)| {
            format!(
                "<image x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\" \
                 class=\"pixels\" href=\"{}\"/>\n",
                x.start,
                y.start,
                x.end - x.start,
                y.end - y.start,
                images::data_uri(picture),
            )
        })
        .collect();
    let (head, body) = svg.split_once(">\n").unwrap_or((&svg, ""));
    Ok(format!("{head}>\n{images}{body}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let texts = |axis: &Axis| {
            axis.ticks
                .iter()
                .map(|(_, text)| text.clone())
                .collect::<Vec<_>>()
        };
        assert_eq!(
            texts(&Axis::linear(0.0..0.87, "x")),
            ["0", "0.2", "0.4", "0.6", "0.8"]
        );
        assert_eq!(
            texts(&Axis::linear(-0.001..0.001, "x")),
            ["−0.001", "−0.0005", "0", "0.0005", "0.001"]
        );
        assert_eq!(
            texts(&Axis::decades(-1.5..0.0, "y")),
            ["0.05", "0.1", "0.2", "0.5", "1"]
        );
        assert_eq!(
            texts(&Axis::decades(-2.5..1.0, "y")),
            ["10⁻²", "10⁻¹", "10⁰", "10¹"]
        );
        assert_eq!(power_of_ten(-12), "10⁻¹²");
    }

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
