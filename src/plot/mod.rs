//! Figures for print: SVG text, and the same figure as PNG.
//!
//! The PNG is rasterised from the SVG with an embedded font, so that both look alike
//! on any machine.

pub mod axis;
pub mod svg;

mod chart;
mod pictures;

use std::sync::{Arc, LazyLock};

use resvg::{tiny_skia, usvg};

pub use axis::Axis;
pub use chart::{Chart, Mark, Series, charts};
pub use pictures::{HeatMap, HeatScale, Picture, color, heat_maps, pictures};

/// Why a figure could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("figure {name}: {fact}")]
pub struct PlotError {
    /// The figure.
    pub name: String,
    /// What is wrong.
    pub fact: String,
}

/// A finished figure.
#[derive(Clone, Debug)]
pub struct Figure {
    /// File name without ending.
    pub name: String,
    /// The drawing.
    pub svg: String,
}

/// Name of the embedded font, see data/fonts/NOTICE.md.
pub const FONT: &str = "DejaVu Sans";

/// Pixels of the PNG per unit of the drawing.
const PNG_SCALE: f32 = 2.5;

static FONTS: LazyLock<Arc<usvg::fontdb::Database>> = LazyLock::new(|| {
    let mut fonts = usvg::fontdb::Database::new();
    fonts.load_font_data(include_bytes!("../../data/fonts/DejaVuSans.ttf").to_vec());
    fonts.set_sans_serif_family(FONT);
    Arc::new(fonts)
});

impl Figure {
    /// The drawing rasterised on white.
    pub fn png(&self) -> Result<Vec<u8>, PlotError> {
        let failed = |fact: String| PlotError {
            name: self.name.clone(),
            fact,
        };
        let options = usvg::Options {
            fontdb: FONTS.clone(),
            font_family: FONT.to_owned(),
            ..usvg::Options::default()
        };
        let tree = usvg::Tree::from_str(&self.svg, &options).map_err(|e| failed(e.to_string()))?;
        let size = tree
            .size()
            .to_int_size()
            .scale_by(PNG_SCALE)
            .ok_or_else(|| failed("no size".to_owned()))?;
        let mut pixels = tiny_skia::Pixmap::new(size.width(), size.height())
            .ok_or_else(|| failed("too large".to_owned()))?;
        pixels.fill(tiny_skia::Color::WHITE);
        let scale = tiny_skia::Transform::from_scale(PNG_SCALE, PNG_SCALE);
        resvg::render(&tree, scale, &mut pixels.as_mut());
        pixels.encode_png().map_err(|e| failed(e.to_string()))
    }
}
