//! Curves, bands and marks over two axes, one or several panels beside each other.

use super::Figure;
use super::axis::Axis;
use super::svg::{Anchor, COLORS, INK, PALE, Svg, TEXT, text_width};

/// How the points of a series are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Joined by a line, with a disc at each.
    Points,
    /// A line alone.
    Line,
    /// A broken line alone.
    Dashed,
    /// Discs alone.
    Dots,
    /// Nothing: an entry of the legend without a sample.
    None,
}

/// One curve of a chart.
#[derive(Clone, Debug)]
pub struct Series {
    /// In the legend; series of one label are entered once.
    pub label: String,
    /// Index into the palette.
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
    /// The curves, drawn in this order.
    pub series: Vec<Series>,
}

const PANEL: [f64; 2] = [300.0, 220.0];
const LEFT: f64 = 58.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 26.0;
const BOTTOM: f64 = 44.0;

/// Panels in rows of `columns`, with one legend for all at the bottom.
pub fn charts(name: &str, columns: usize, panels: &[Chart]) -> Figure {
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let cell = [LEFT + PANEL[0] + RIGHT, TOP + PANEL[1] + BOTTOM];
    let width = columns as f64 * cell[0];
    let entries = legend(panels);
    let lines = wrap(&entries, width - 2.0 * RIGHT);
    let height = rows as f64 * cell[1] + lines.len() as f64 * 18.0 + 8.0;
    let mut svg = Svg::new(width, height);
    for (index, panel) in panels.iter().enumerate() {
        let at = [
            (index % columns) as f64 * cell[0] + LEFT,
            (index / columns) as f64 * cell[1] + TOP,
        ];
        draw(&mut svg, at, panel);
    }
    for (row, line) in lines.iter().enumerate() {
        let y = rows as f64 * cell[1] + row as f64 * 18.0 + 6.0;
        let total: f64 = line.iter().map(|s| entry_width(s)).sum();
        let mut x = 0.5 * (width - total);
        for series in line {
            sample(&mut svg, [x, y - 4.0], series);
            svg.text(
                [x + sample_width(series), y],
                Anchor::Start,
                TEXT,
                &series.label,
            );
            x += entry_width(series);
        }
    }
    Figure {
        name: name.to_owned(),
        svg: svg.finish(),
    }
}

fn legend(panels: &[Chart]) -> Vec<&Series> {
    let mut entries: Vec<&Series> = Vec::new();
    for series in panels.iter().flat_map(|p| &p.series) {
        if !series.label.is_empty() && entries.iter().all(|s| s.label != series.label) {
            entries.push(series);
        }
    }
    entries
}

fn entry_width(series: &Series) -> f64 {
    sample_width(series) + text_width(&series.label, TEXT) + 16.0
}

fn sample_width(series: &Series) -> f64 {
    match series.mark {
        Mark::None => 0.0,
        Mark::Dots => 22.0,
        _ => 30.0,
    }
}

fn wrap<'a>(entries: &[&'a Series], width: f64) -> Vec<Vec<&'a Series>> {
    let mut lines: Vec<Vec<&Series>> = Vec::new();
    let mut used = f64::INFINITY;
    for entry in entries {
        if used + entry_width(entry) > width {
            lines.push(Vec::new());
            used = 0.0;
        }
        used += entry_width(entry);
        if let Some(line) = lines.last_mut() {
            line.push(entry);
        }
    }
    lines
}

fn sample(svg: &mut Svg, [x, y]: [f64; 2], series: &Series) {
    let color = COLORS[series.color % COLORS.len()];
    let ends = [[x, y], [x + 24.0, y]];
    match series.mark {
        Mark::Points | Mark::Line => svg.path(&ends, color, 1.6, None),
        Mark::Dashed => svg.path(&ends, color, 1.6, Some("5 4")),
        Mark::Dots | Mark::None => {}
    }
    if matches!(series.mark, Mark::Points | Mark::Dots) {
        svg.disc([x + 12.0, y], 3.0, color, "none");
    }
}

fn draw(svg: &mut Svg, at: [f64; 2], panel: &Chart) {
    let [left, top] = at;
    let part = |axis: &Axis, value: f64| {
        ((value - axis.range.start) / (axis.range.end - axis.range.start)).clamp(-0.02, 1.02)
    };
    let x_of = |v: f64| left + part(&panel.x, v) * PANEL[0];
    let y_of = |v: f64| top + (1.0 - part(&panel.y, v)) * PANEL[1];
    for (position, label) in panel.x.ticks() {
        let x = x_of(*position);
        svg.line([x, top], [x, top + PANEL[1]], PALE, 0.8);
        svg.text([x, top + PANEL[1] + 15.0], Anchor::Middle, TEXT, label);
    }
    for (position, label) in panel.y.ticks() {
        let y = y_of(*position);
        svg.line([left, y], [left + PANEL[0], y], PALE, 0.8);
        svg.text([left - 6.0, y + 4.0], Anchor::End, TEXT, label);
    }
    for series in &panel.series {
        let color = COLORS[series.color % COLORS.len()];
        if series.mark == Mark::Dots {
            for &[x, low, high] in &series.interval {
                svg.line([x_of(x), y_of(low)], [x_of(x), y_of(high)], color, 1.2);
            }
        } else if !series.interval.is_empty() {
            let lower = series.interval.iter().map(|i| [x_of(i[0]), y_of(i[1])]);
            let upper = series.interval.iter().rev();
            let outline: Vec<_> = lower
                .chain(upper.map(|i| [x_of(i[0]), y_of(i[2])]))
                .collect();
            svg.area(&outline, color, 0.14);
        }
    }
    for series in &panel.series {
        let color = COLORS[series.color % COLORS.len()];
        let points: Vec<_> = series
            .points
            .iter()
            .map(|p| [x_of(p[0]), y_of(p[1])])
            .collect();
        match series.mark {
            Mark::Points | Mark::Line => svg.path(&points, color, 1.6, None),
            Mark::Dashed => svg.path(&points, color, 1.6, Some("5 4")),
            Mark::Dots | Mark::None => {}
        }
        if matches!(series.mark, Mark::Points | Mark::Dots) {
            for point in points {
                svg.disc(point, 3.0, color, "none");
            }
        }
    }
    svg.rectangle(at, PANEL, "none", INK);
    let wide = text_width(&panel.title, TEXT + 1.0) / PANEL[0];
    let title_size = (TEXT + 1.0) / wide.max(1.0);
    svg.text(
        [left + 0.5 * PANEL[0], top - 8.0],
        Anchor::Middle,
        title_size,
        &panel.title,
    );
    let middle = [left + 0.5 * PANEL[0], top + PANEL[1] + 32.0];
    svg.text(middle, Anchor::Middle, TEXT, &panel.x.label);
    let middle = [left - 42.0, top + 0.5 * PANEL[1]];
    svg.turned(middle, Anchor::Middle, TEXT, -90.0, &panel.y.label);
}
