//! Horizontal bars.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::axis::Axis;
use super::canvas::{Figure, INK, draw, draw_axes, palette, stroke, text_style, text_width, units};

/// One bar, of one part or of several end to end.
#[derive(Clone, Debug)]
pub struct Bar {
    /// Length and colour (an index into the palette) of each part.
    pub parts: Vec<(f64, usize)>,
    /// Standard deviation of the length, drawn as a line.
    pub deviation: Option<f64>,
    /// Behind the bar; may be empty.
    pub note: String,
}

/// The bars of one label.
#[derive(Clone, Debug)]
pub struct BarRow {
    /// At the left.
    pub label: String,
    /// The bars, one below the other.
    pub bars: Vec<Bar>,
}

/// Rows of bars `row_px` CSS pixels high, their labels at the left.
pub fn bars(name: &str, x: &Axis, row_px: f64, rows: &[BarRow]) -> Figure {
    let labels = rows.iter().map(|row| text_width(&row.label));
    let label_px = labels.fold(50.0, f64::max) + 16.0;
    let size_px = [640.0, row_px * rows.len() as f64 + 56.0];
    draw(name, size_px, |root, _| {
        let y = Axis::bare(rows.len() as f64..0.0);
        let mut plot = ChartBuilder::on(root)
            .margin(units(8.0))
            .margin_right(units(16.0))
            .x_label_area_size(units(40.0))
            .y_label_area_size(units(label_px))
            .build_cartesian_2d(x.clone(), y.clone())?;
        draw_axes(&mut plot, [x, &y], true)?;
        let mut texts = Vec::new();
        for (index, row) in rows.iter().enumerate() {
            let height = 0.72 / row.bars.len().max(1) as f64;
            for (n, bar) in row.bars.iter().enumerate() {
                let top = index as f64 + 0.14 + n as f64 * height;
                let middle = top + 0.5 * height;
                let mut end = 0.0;
                for &(length, color) in &bar.parts {
                    let corners = [
                        (end, top + 0.06 * height),
                        (end + length, top + 0.94 * height),
                    ];
                    let style = palette(color).mix(0.8).filled();
                    plot.draw_series([Rectangle::new(corners, style)])?;
                    end += length;
                }
                if let Some(deviation) = bar.deviation {
                    let line = [
                        (x.inside(end - deviation), middle),
                        (x.inside(end + deviation), middle),
                    ];
                    plot.draw_series(LineSeries::new(line, stroke(INK, 1.0)))?;
                }
                let (right, y) = plot.backend_coord(&(end, middle));
                texts.push((bar.note.clone(), (right + units(6.0), y), HPos::Left));
            }
            let (left, y) = plot.backend_coord(&(x.range.start, index as f64 + 0.5));
            texts.push((row.label.clone(), (left - units(8.0), y), HPos::Right));
        }
        for (text, at, side) in texts {
            root.draw(&Text::new(text, at, text_style(INK, side, VPos::Center)))?;
        }
        Ok(())
    })
}
