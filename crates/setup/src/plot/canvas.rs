//! What every figure is drawn on: the SVG back end of `plotters`.
//!
//! Colours are written as placeholders, which become fixed colours in a file and CSS
//! variables in a page. Coordinates are in quarters of a CSS pixel, because the back end
//! rounds to whole numbers.

use std::fmt::Write;
use std::sync::{Arc, LazyLock};

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use resvg::{tiny_skia, usvg};

use super::{Axis, Picture, PlotError};

/// A part of a figure that can be drawn on.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Two axes and what is drawn over them.
pub(super) type Plot<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>;
/// What the back end reports.
pub(super) type DrawError = DrawingAreaErrorKind<std::io::Error>;

/// Drawing units per CSS pixel.
pub(super) const UNITS: f64 = 4.0;
/// Size of text, CSS pixels.
pub(super) const TEXT_PX: f64 = 12.0;

/// Text.
pub(super) const INK: RGBColor = RGBColor(1, 0, 0);
/// Axes and what they carry.
pub(super) const MUTED: RGBColor = RGBColor(2, 0, 0);
/// Grids.
pub(super) const GRID: RGBColor = RGBColor(3, 0, 0);
const PALETTE_START: u8 = 16;

/// Placeholder, colour in files, colour in pages. The palette is Okabe and Ito's, distinct
/// also without full colour vision; black last. Pages have variables of their own for
/// blue, red and green, which stand for the channels.
const COLORS: [(RGBColor, &str, &str); 12] = [
    (INK, "#1a1a1a", "var(--ink)"),
    (MUTED, "#4d4d4d", "var(--muted)"),
    (GRID, "#dedede", "var(--grid)"),
    (palette(0), "#0072b2", "var(--channel-b)"),
    (palette(1), "#d55e00", "var(--channel-r)"),
    (palette(2), "#009e73", "var(--channel-g)"),
    (palette(3), "#cc79a7", "#cc79a7"),
    (palette(4), "#e69f00", "#e69f00"),
    (palette(5), "#56b4e9", "#56b4e9"),
    (palette(6), "#8c6d1f", "#a58a3d"),
    (palette(7), "#000000", "var(--ink)"),
    (palette(NEUTRAL), "#a6a6a6", "var(--muted)"),
];

/// In place of an index into the palette: grey, for what does not count.
pub const NEUTRAL: usize = usize::MAX;

/// Placeholder of a colour of the palette.
pub(super) const fn palette(index: usize) -> RGBColor {
    let entry = if index == NEUTRAL { 8 } else { index % 8 };
    RGBColor(PALETTE_START + entry as u8, 0, 0)
}

/// The colour that an entry of the palette has in a page, as CSS.
pub fn page_color(index: usize) -> &'static str {
    COLORS[3 + index % 8].2
}

/// Name of the embedded font, see data/fonts/NOTICE.md.
const FONT: &str = "DejaVu Sans";

/// Pixels of the PNG per CSS pixel of the figure.
const PNG_SCALE: f32 = 2.5;

static FONTS: LazyLock<Arc<usvg::fontdb::Database>> = LazyLock::new(|| {
    let mut fonts = usvg::fontdb::Database::new();
    fonts.load_font_data(include_bytes!("../../../../data/fonts/DejaVuSans.ttf").to_vec());
    fonts.set_sans_serif_family(FONT);
    Arc::new(fonts)
});

/// A finished figure, or why it could not be drawn: the error comes where it is used.
#[derive(Clone, Debug)]
pub struct Figure {
    /// File name without ending.
    pub name: String,
    /// Width and height, drawing units.
    size: (u32, u32),
    elements: Result<String, String>,
}

impl Figure {
    fn elements(
        &self,
        color: impl Fn(&(RGBColor, &'static str, &'static str)) -> &'static str,
    ) -> Result<String, PlotError> {
        let mut elements = self.elements.clone().map_err(|fact| self.error(fact))?;
        for entry in &COLORS {
            let RGBColor(r, g, b) = entry.0;
            elements = elements.replace(&format!("#{r:02X}{g:02X}{b:02X}"), color(entry));
        }
        Ok(elements)
    }

    fn error(&self, fact: String) -> PlotError {
        PlotError {
            name: self.name.clone(),
            fact,
        }
    }

    /// The text of an SVG file.
    ///
    /// # Errors
    /// The figure could not be drawn.
    pub fn svg(&self) -> Result<String, PlotError> {
        let elements = self.elements(|entry| entry.1)?;
        let (width, height) = self.size;
        let [width_px, height_px] = [width, height].map(|side| f64::from(side) / UNITS);
        Ok(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width_px}\" height=\"{height_px}\" \
             viewBox=\"0 0 {width} {height}\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n{elements}</svg>\n"
        ))
    }

    /// An element of an HTML page, with `title` read aloud in place of the figure. It
    /// takes the page's width, and its colours from the page's CSS variables.
    ///
    /// # Errors
    /// The figure could not be drawn.
    pub fn inline(&self, title: &str) -> Result<String, PlotError> {
        let elements = self.elements(|entry| entry.2)?;
        let (width, height) = self.size;
        Ok(format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\">\n{elements}</svg>\n"
        ))
    }

    /// A PNG file, dark on white.
    ///
    /// # Errors
    /// The figure could not be drawn.
    pub fn png(&self) -> Result<Vec<u8>, PlotError> {
        let options = usvg::Options {
            fontdb: FONTS.clone(),
            font_family: FONT.to_owned(),
            ..usvg::Options::default()
        };
        let tree = usvg::Tree::from_str(&self.svg()?, &options);
        let tree = tree.map_err(|error| self.error(error.to_string()))?;
        let size = tree.size().to_int_size().scale_by(PNG_SCALE);
        let size = size.ok_or_else(|| self.error("no size".to_owned()))?;
        let mut pixels = tiny_skia::Pixmap::new(size.width(), size.height())
            .ok_or_else(|| self.error("too large".to_owned()))?;
        pixels.fill(tiny_skia::Color::WHITE);
        let scale = tiny_skia::Transform::from_scale(PNG_SCALE, PNG_SCALE);
        resvg::render(&tree, scale, &mut pixels.as_mut());
        let png = pixels.encode_png();
        png.map_err(|error| self.error(error.to_string()))
    }
}

/// The pictures of a figure. They are put behind everything else: the back end draws no
/// pictures in a build without its own codecs.
#[derive(Default)]
pub(super) struct Images(String);

impl Images {
    /// Stretches a picture over a rectangle (drawing units from the figure's corner)
    /// without smoothing.
    pub fn put(&mut self, (x, y): (i32, i32), (width, height): (i32, i32), picture: &Picture) {
        // Writing to a string cannot fail.
        let _ = writeln!(
            self.0,
            "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\" \
             image-rendering=\"optimizeSpeed\" style=\"image-rendering:pixelated\" href=\"{}\"/>",
            picture.data_uri()
        );
    }
}

/// Draws a figure of a size in CSS pixels.
pub(super) fn draw(
    name: &str,
    size_px: [f64; 2],
    paint: impl FnOnce(&Area, &mut Images) -> Result<(), DrawError>,
) -> Figure {
    let size = (units(size_px[0]) as u32, units(size_px[1]) as u32);
    let mut svg = String::new();
    let mut images = Images::default();
    let painted = {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        paint(&root, &mut images).and_then(|()| root.present())
    };
    // The root element is written anew by each use.
    let elements = svg.split_once(">\n").map_or("", |(_, rest)| rest);
    let elements = elements.trim_end().trim_end_matches("</svg>");
    Figure {
        name: name.to_owned(),
        size,
        elements: painted
            .map(|()| format!("{}{elements}", images.0))
            .map_err(|error| error.to_string()),
    }
}

/// CSS pixels in drawing units.
pub(super) fn units(px: f64) -> i32 {
    (px * UNITS).round() as i32
}

/// About how wide a text is, CSS pixels.
pub(super) fn text_width(text: &str) -> f64 {
    0.55 * TEXT_PX * text.chars().count() as f64
}

/// Text of the usual size, placed by the given sides of its box.
pub(super) fn text_style(color: RGBColor, h_pos: HPos, v_pos: VPos) -> TextStyle<'static> {
    fitting_style("", f64::INFINITY, color, h_pos, v_pos)
}

/// [`text_style`], smaller where the text would be longer than `room_px`.
pub(super) fn fitting_style(
    text: &str,
    room_px: f64,
    color: RGBColor,
    h_pos: HPos,
    v_pos: VPos,
) -> TextStyle<'static> {
    let size_px = TEXT_PX / (text_width(text) / room_px).max(1.0);
    // The back end divides what it calls a size by 1.24.
    ("DejaVu Sans, sans-serif", size_px * UNITS * 1.24)
        .into_font()
        .color(&color)
        .pos(Pos::new(h_pos, v_pos))
}

pub(super) fn stroke(color: RGBColor, width_px: f64) -> ShapeStyle {
    color.stroke_width(units(width_px) as u32)
}

/// A dashed line.
pub(super) fn dashes<I: Iterator<Item = (f64, f64)> + Clone>(
    points: I,
    color: RGBColor,
) -> DashedLineSeries<I, i32> {
    DashedLineSeries::new(points, units(6.0), units(5.0), stroke(color, 1.5))
}

/// Lines, ticks and labels of both axes, on a grid if wanted. An axis without ticks and
/// label is left out.
pub(super) fn draw_axes(plot: &mut Plot, [x, y]: [&Axis; 2], grid: bool) -> Result<(), DrawError> {
    let (width, height) = plot.plotting_area().dim_in_pixel();
    let desc = |axis: &Axis, room: u32| {
        // A label may reach into the margins a little.
        let room_px = f64::from(room) / UNITS + 24.0;
        fitting_style(&axis.label, room_px, MUTED, HPos::Center, VPos::Center)
    };
    // One style serves both labels: that of the one with less room.
    let crowded =
        text_width(&x.label) / f64::from(width) > text_width(&y.label) / f64::from(height);
    let desc = if crowded {
        desc(x, width)
    } else {
        desc(y, height)
    };
    let mut mesh = plot.configure_mesh();
    mesh.axis_style(stroke(MUTED, 1.0))
        .bold_line_style(stroke(GRID, 1.0))
        .light_line_style(TRANSPARENT)
        .label_style(text_style(MUTED, HPos::Center, VPos::Center))
        .axis_desc_style(desc)
        .set_all_tick_mark_size(units(4.0))
        .x_desc(x.label.as_str())
        .y_desc(y.label.as_str());
    if !grid {
        mesh.disable_mesh();
    }
    if x.is_bare() {
        mesh.disable_x_axis();
    }
    if y.is_bare() {
        mesh.disable_y_axis();
    }
    mesh.draw()
}

/// A line of text in the middle above the plot, in the margin of `area`.
pub(super) fn draw_title(area: &Area, plot: &Plot, title: &str) -> Result<(), DrawError> {
    if title.is_empty() {
        return Ok(());
    }
    let (x_range, y_range) = plot.plotting_area().get_pixel_range();
    let (left, top) = area.get_base_pixel();
    let room_px = f64::from(x_range.end - x_range.start) / UNITS + 12.0;
    let style = fitting_style(title, room_px, INK, HPos::Center, VPos::Bottom);
    let middle = (x_range.start + x_range.end) / 2 - left;
    area.draw(&Text::new(
        title.to_owned(),
        (middle, y_range.start - top - units(6.0)),
        style,
    ))
}
