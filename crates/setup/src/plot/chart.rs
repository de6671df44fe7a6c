//! Curves, bands and marks over two axes; one panel, or several with a common legend.

use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::axis::Axis;
use super::canvas::{
    Area, DrawError, Figure, INK, Plot, dashes, draw, draw_axes, draw_title, palette, stroke,
    text_style, text_width, units,
};

/// How the points of a series are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Joined by a line, with a disc at each.
    Points,
    /// A line alone.
    Line,
    /// A dashed line alone.
    Dashed,
    /// Discs alone.
    Dots,
    /// Nothing but the interval; in a legend, a filled box.
    Band,
    /// Nothing but the interval; in a legend, text alone.
    None,
}

/// One curve of a chart.
#[derive(Clone, Debug)]
pub struct Series {
    /// In the legend; series of one label are entered once.
    pub label: String,
    /// Index into the palette: blue, red, green, and five more.
    pub color: usize,
    /// How it is drawn.
    pub mark: Mark,
    /// Points in the axes' units (powers of ten on logarithmic axes).
    pub points: Vec<[f64; 2]>,
    /// (x, lower, upper): a band around the curve; for dots, error bars.
    pub interval: Vec<[f64; 3]>,
}

impl Series {
    /// Without an interval.
    pub fn new(label: &str, color: usize, mark: Mark, points: Vec<[f64; 2]>) -> Self {
        Self {
            label: label.to_owned(),
            color,
            mark,
            points,
            interval: Vec::new(),
        }
    }

    /// With an interval.
    #[must_use]
    pub fn within(mut self, interval: Vec<[f64; 3]>) -> Self {
        self.interval = interval;
        self
    }
}

/// One panel.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Above it; may be empty.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// The curves, drawn in this order; what is outside the axes is drawn at their ends.
    pub series: Vec<Series>,
}

/// A panel with its title and the labels of its axes, CSS pixels.
const PANEL_PX: [f64; 2] = [390.0, 306.0];
/// Height of a line of the legend.
const LINE_PX: f64 = 20.0;

/// One chart without a legend, for a page that has its own.
pub fn chart(name: &str, size_px: [f64; 2], panel: &Chart) -> Figure {
    draw(name, size_px, |root, _| draw_chart(root, panel))
}

/// Panels in rows of `columns`, with one legend for all at the bottom.
pub fn charts(name: &str, columns: usize, panels: &[Chart]) -> Figure {
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let [width_px, panels_px] = [columns as f64 * PANEL_PX[0], rows as f64 * PANEL_PX[1]];
    let legend = Legend::new(entries(panels), width_px);
    let size_px = [width_px, panels_px + legend.height_px()];
    draw(name, size_px, |root, _| {
        let (upper, lower) = root.split_vertically(units(panels_px));
        for (area, panel) in upper.split_evenly((rows, columns)).iter().zip(panels) {
            draw_chart(area, panel)?;
        }
        legend.draw(&lower)
    })
}

/// What the curves are, in lines below the panels.
pub(super) struct Legend<'a> {
    lines: Vec<Vec<&'a Series>>,
    width_px: f64,
}

impl<'a> Legend<'a> {
    /// Of these series, in a figure this wide.
    pub fn new(series: Vec<&'a Series>, width_px: f64) -> Self {
        Self {
            lines: wrap(&series, width_px - 32.0),
            width_px,
        }
    }

    pub fn height_px(&self) -> f64 {
        LINE_PX * self.lines.len() as f64 + 8.0
    }

    pub fn draw(&self, area: &Area) -> Result<(), DrawError> {
        for (row, line) in self.lines.iter().enumerate() {
            let total_px: f64 = line.iter().map(|series| entry_width(series)).sum();
            let mut x_px = 0.5 * (self.width_px - total_px);
            for series in line {
                draw_entry(area, [x_px, LINE_PX * (row as f64 + 0.5)], series)?;
                x_px += entry_width(series);
            }
        }
        Ok(())
    }
}

/// The series of the legend.
fn entries(panels: &[Chart]) -> Vec<&Series> {
    let mut entries: Vec<&Series> = Vec::new();
    for series in panels.iter().flat_map(|p| &p.series) {
        if !series.label.is_empty() && entries.iter().all(|s| s.label != series.label) {
            entries.push(series);
        }
    }
    entries
}

fn entry_width(series: &Series) -> f64 {
    sample_width(series) + text_width(&series.label) + 18.0
}

fn sample_width(series: &Series) -> f64 {
    match series.mark {
        Mark::None => 0.0,
        Mark::Dots => 20.0,
        _ => 32.0,
    }
}

fn wrap<'a>(entries: &[&'a Series], width_px: f64) -> Vec<Vec<&'a Series>> {
    let mut lines: Vec<Vec<&Series>> = Vec::new();
    let mut used_px = f64::INFINITY;
    for entry in entries {
        if used_px + entry_width(entry) > width_px {
            lines.push(Vec::new());
            used_px = 0.0;
        }
        used_px += entry_width(entry);
        if let Some(line) = lines.last_mut() {
            line.push(entry);
        }
    }
    lines
}

/// A sample of the series, and its label.
fn draw_entry(area: &Area, [x_px, y_px]: [f64; 2], series: &Series) -> Result<(), DrawError> {
    let color = palette(series.color);
    let at = |offset_px: f64| (units(x_px + offset_px), units(y_px));
    let ends = [at(0.0), at(26.0)];
    match series.mark {
        Mark::Points | Mark::Line => area.draw(&PathElement::new(ends, stroke(color, 1.6)))?,
        Mark::Dashed => area.draw(&DashedPathElement::new(
            ends,
            units(6.0),
            units(5.0),
            stroke(color, 1.5),
        ))?,
        Mark::Band => {
            let corners = [
                (at(0.0).0, units(y_px - 6.0)),
                (ends[1].0, units(y_px + 6.0)),
            ];
            area.draw(&Rectangle::new(corners, color.mix(0.25).filled()))?;
        }
        Mark::Dots | Mark::None => {}
    }
    let disc_px = match series.mark {
        Mark::Points => Some(13.0),
        Mark::Dots => Some(10.0),
        _ => None,
    };
    if let Some(disc_px) = disc_px {
        area.draw(&Circle::new(at(disc_px), units(3.0), color.filled()))?;
    }
    let style = text_style(INK, HPos::Left, VPos::Center);
    area.draw(&Text::new(
        series.label.clone(),
        at(sample_width(series)),
        style,
    ))
}

fn draw_chart(area: &Area, panel: &Chart) -> Result<(), DrawError> {
    let top_px = if panel.title.is_empty() { 8.0 } else { 26.0 };
    let mut plot = ChartBuilder::on(area)
        .margin(units(8.0))
        .margin_top(units(top_px))
        .margin_right(units(16.0))
        .x_label_area_size(units(40.0))
        .y_label_area_size(units((panel.y.tick_width() + 26.0).max(58.0)))
        .build_cartesian_2d(panel.x.clone(), panel.y.clone())?;
    draw_axes(&mut plot, [&panel.x, &panel.y], true)?;
    // Bands and error bars are below all curves.
    for series in &panel.series {
        draw_interval(&mut plot, panel, series)?;
    }
    for series in &panel.series {
        draw_points(&mut plot, panel, series)?;
    }
    draw_title(area, &plot, &panel.title)
}

fn draw_interval(plot: &mut Plot, panel: &Chart, series: &Series) -> Result<(), DrawError> {
    let color = palette(series.color);
    let at = |x: f64, y: f64| (panel.x.inside(x), panel.y.inside(y));
    if series.mark == Mark::Dots {
        let bars = series.interval.iter().map(|&[x, low, high]| {
            PathElement::new(vec![at(x, low), at(x, high)], stroke(color, 1.2))
        });
        plot.draw_series(bars)?;
    } else if !series.interval.is_empty() {
        let lower = series.interval.iter().map(|&[x, low, _]| at(x, low));
        let upper = series.interval.iter().rev();
        let outline: Vec<_> = lower
            .chain(upper.map(|&[x, _, high]| at(x, high)))
            .collect();
        plot.draw_series([Polygon::new(outline, color.mix(0.15))])?;
    }
    Ok(())
}

fn draw_points(plot: &mut Plot, panel: &Chart, series: &Series) -> Result<(), DrawError> {
    // Of an entry of the legend alone.
    if series.points.is_empty() {
        return Ok(());
    }
    let color = palette(series.color);
    let points = series.points.iter();
    let points = points.map(|&[x, y]| (panel.x.inside(x), panel.y.inside(y)));
    match series.mark {
        Mark::Points | Mark::Line => {
            plot.draw_series(LineSeries::new(points.clone(), stroke(color, 1.6)))?;
        }
        Mark::Dashed => {
            plot.draw_series(dashes(points.clone(), color))?;
        }
        Mark::Dots | Mark::Band | Mark::None => {}
    }
    if matches!(series.mark, Mark::Points | Mark::Dots) {
        plot.draw_series(points.map(|at| Circle::new(at, units(3.0), color.filled())))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_takes_the_colours_of_file_and_page() {
        let line = Series::new("a < b", 2, Mark::Line, vec![[0.0, 0.0], [1.0, 5.0]]);
        let panel = Chart {
            title: "loss".to_owned(),
            x: Axis::linear(0.0..1.0, "step"),
            y: Axis::decades(-1.0..2.0, "loss"),
            series: vec![line],
        };
        let page = chart("loss", [320.0, 200.0], &panel)
            .inline("loss")
            .unwrap();
        assert!(page.starts_with("<svg viewBox=\"0 0 1280 800\""));
        assert!(page.contains("var(--channel-g)") && page.contains("10⁻¹"));
        assert!(page.contains("step") && !page.contains("http"));
        let file = charts("loss", 1, std::slice::from_ref(&panel));
        let svg = file.svg().unwrap();
        assert!(svg.contains("#009e73") && svg.contains("a &lt; b"));
        assert!(!svg.contains("var(") && !svg.contains("#120000"));
        assert!(file.png().unwrap().starts_with(b"\x89PNG"));
    }
}
