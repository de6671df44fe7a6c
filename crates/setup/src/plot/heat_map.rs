//! Values over two axes as colours.

use plotters::prelude::*;

use super::axis::Axis;
use super::canvas::{
    Area, DrawError, Figure, Images, MUTED, Plot, draw, draw_axes, draw_title, stroke, units,
};
use super::colors::sequential;
use super::picture::Picture;

/// One map.
#[derive(Clone, Debug)]
pub struct HeatMap {
    /// Above it; may be empty.
    pub title: String,
    /// Row 0 is the top; stretched over the axes.
    pub picture: Picture,
}

impl HeatMap {
    /// Cells `width` to a row in [`sequential`]'s colours, from the lowest to the highest
    /// value of `range`; NaN is left white.
    pub fn new(title: String, width: usize, values: &[f64], range: &std::ops::Range<f64>) -> Self {
        let color = |value: f64| match value.is_nan() {
            true => [255; 3],
            false => sequential(((value - range.start) / (range.end - range.start)) as f32),
        };
        let picture = Picture::opaque(width, values.iter().map(|&value| color(value)));
        Self { title, picture }
    }
}

/// Maps over the same axes with a common scale at their right.
pub struct HeatMaps<'a> {
    /// Maps in a row.
    pub columns: usize,
    /// Width and height of a map, CSS pixels.
    pub cell_px: [f64; 2],
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis, upwards.
    pub y: Axis,
    /// The scale of the colours.
    pub scale: Axis,
    /// The colours from the scale's start to its end, 0..=1.
    pub colors: fn(f32) -> [u8; 3],
    /// The maps.
    pub maps: &'a [HeatMap],
}

const LEFT_PX: f64 = 66.0;
const BOTTOM_PX: f64 = 40.0;
const GAP_PX: f64 = 22.0;
const SCALE_PX: f64 = 12.0;

/// Draws maps.
pub fn heat_maps(name: &str, all: &HeatMaps) -> Figure {
    let columns = all.columns.clamp(1, all.maps.len().max(1));
    let rows = all.maps.len().div_ceil(columns).max(1);
    let top_px = match all.maps.iter().all(|map| map.title.is_empty()) {
        true => 8.0,
        false => 26.0,
    };
    let [width_px, height_px] = all.cell_px;
    let row_px = top_px + height_px + BOTTOM_PX;
    // The vertical axis stands at the first column only.
    let column_ends: Vec<i32> = (1..=columns)
        .map(|n| units(LEFT_PX + n as f64 * (width_px + GAP_PX)))
        .collect();
    let row_ends: Vec<i32> = (1..rows).map(|n| units(n as f64 * row_px)).collect();
    let maps_px = LEFT_PX + columns as f64 * (width_px + GAP_PX);
    let size_px = [maps_px + LEFT_PX + SCALE_PX + 8.0, rows as f64 * row_px];
    draw(name, size_px, |root, images| {
        let areas = root.split_by_breakpoints(&column_ends, &row_ends);
        let bare = Axis::bare(all.y.range.clone());
        for (index, map) in all.maps.iter().enumerate() {
            let column = index % columns;
            let area = &areas[index / columns * (columns + 1) + column];
            let (y, left_px) = if column == 0 {
                (&all.y, LEFT_PX)
            } else {
                (&bare, 0.0)
            };
            let margins_px = [top_px, GAP_PX, left_px];
            let plot = over(area, margins_px, [&all.x, y], images, &map.picture)?;
            draw_title(area, &plot, &map.title)?;
        }
        let colors = (0..128).map(|n| (all.colors)(1.0 - n as f32 / 127.0));
        let margins_px = [top_px, 8.0, LEFT_PX];
        let bar = Picture::opaque(1, colors);
        let axes = [&Axis::bare(0.0..1.0), &all.scale];
        over(&areas[columns], margins_px, axes, images, &bar).map(drop)
    })
}

/// A picture over two axes; the margins are those above, at the right, and at the left,
/// where the labels are.
fn over<'a, 'b>(
    area: &'a Area<'b>,
    [top_px, right_px, left_px]: [f64; 3],
    [x, y]: [&Axis; 2],
    images: &mut Images,
    picture: &Picture,
) -> Result<Plot<'a, 'b>, DrawError> {
    let mut plot = ChartBuilder::on(area)
        .margin_top(units(top_px))
        .margin_right(units(right_px))
        .margin_left(units(left_px.min(8.0)))
        .x_label_area_size(units(BOTTOM_PX))
        .y_label_area_size(units((left_px - 8.0).max(0.0)))
        .build_cartesian_2d(x.clone(), y.clone())?;
    let (x_range, y_range) = plot.plotting_area().get_pixel_range();
    let size = (x_range.end - x_range.start, y_range.end - y_range.start);
    images.put((x_range.start, y_range.start), size, picture);
    draw_axes(&mut plot, [x, y], false)?;
    let ([left, right], [low, high]) = ([x.range.start, x.range.end], [y.range.start, y.range.end]);
    let frame = [
        (left, low),
        (right, low),
        (right, high),
        (left, high),
        (left, low),
    ];
    plot.draw_series([PathElement::new(frame, stroke(MUTED, 1.0))])?;
    Ok(plot)
}
