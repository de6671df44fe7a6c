//! Figures: charts, bars, heat maps, polar plots, rows of pictures, images next to each other.
//!
//! `plotters` draws them; a [`Figure`] is then used as an SVG file or the same as PNG
//! (dark on white, in an embedded font, so that it looks alike on any machine), or inside
//! an HTML page, whose colours and width it follows.

pub mod axis;
pub mod colors;
pub mod radiance;

mod bars;
mod canvas;
mod chart;
mod comparison;
mod heat_map;
mod picture;
mod polar;

pub use axis::Axis;
pub use bars::{Bar, BarRow, bars};
pub use canvas::{Figure, NEUTRAL, page_color};
pub use chart::{Chart, Mark, Series, chart, charts};
pub use comparison::{comparison, scale_of};
pub use heat_map::{HeatMap, HeatMaps, heat_maps};
pub use picture::{Picture, Tile, pictures, png_data_uri};
pub use polar::{Lobe, PolarPanel, polar, polars};

/// Why a figure could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("figure {name}: {fact}")]
pub struct PlotError {
    /// The figure.
    pub name: String,
    /// What is wrong.
    pub fact: String,
}
