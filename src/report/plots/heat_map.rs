//! A picture over two axes, with its colour bar.

use plotters::prelude::*;

use super::Axis;
use super::{PlotError, UNITS, draw, draw_axes};
use crate::report::images::{self, Picture};

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
            draw_axes(&mut chart, x, y, false)?;
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
