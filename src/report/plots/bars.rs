//! Horizontal bars per channel.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::Axis;
use super::{CHANNELS, PlotError, TEXT, UNITS, draw, draw_axes, stroke, text_style};

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
        let y = Axis::bare(rows.len() as f64..0.0);
        let mut chart = ChartBuilder::on(root)
            .margin(8 * UNITS)
            .margin_right(16 * UNITS)
            .x_label_area_size(40 * UNITS)
            .y_label_area_size(140 * UNITS)
            .build_cartesian_2d(x.clone(), y.clone())?;
        draw_axes(&mut chart, &x, &y, true)?;
        for (index, row) in rows.iter().enumerate() {
            for (channel, color) in CHANNELS.into_iter().enumerate() {
                let top = index as f64 + 0.14 + 0.24 * channel as f64;
                let middle = top + 0.12;
                let value = row.value[channel];
                let bar = [(0.0, top + 0.02), (value, top + 0.22)];
                chart.draw_series([Rectangle::new(bar, color.mix(0.75).filled())])?;
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
