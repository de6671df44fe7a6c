//! A page of SVG that is written element by element.

use std::fmt::Write;

use base64::Engine;
use image::ImageEncoder;

/// Where a text stands relative to its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Begins there.
    Start,
    /// Centred.
    Middle,
    /// Ends there.
    End,
}

/// Text size of a figure, units.
pub const TEXT: f64 = 11.0;
/// Colour of text and frames.
pub const INK: &str = "#1a1a1a";
/// Colour of grids.
pub const PALE: &str = "#dedede";

/// Okabe and Ito's colours, distinct also without full colour vision; black last.
pub const COLORS: [&str; 8] = [
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D1F", "#000000",
];

/// A drawing in progress; units are CSS pixels, y downwards.
pub struct Svg {
    width: f64,
    height: f64,
    body: String,
}

impl Svg {
    /// An empty page.
    pub fn new(width: f64, height: f64) -> Self {
        Self {
            width,
            height,
            body: String::new(),
        }
    }

    /// Any element.
    fn element(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.body, "{element}");
    }

    /// A straight line.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], color: &str, width: f64) {
        self.path(&[from, to], color, width, None);
    }

    /// A polyline of two points or more, of fewer nothing; `dash` as in `stroke-dasharray`.
    pub fn path(&mut self, points: &[[f64; 2]], color: &str, width: f64, dash: Option<&str>) {
        if points.len() < 2 {
            return;
        }
        let dash = dash.map_or(String::new(), |d| format!(" stroke-dasharray=\"{d}\""));
        let points = list(points);
        self.element(format_args!(
            "<polyline points=\"{points}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\" stroke-linejoin=\"round\"{dash}/>"
        ));
    }

    /// A filled polygon.
    pub fn area(&mut self, points: &[[f64; 2]], color: &str, opacity: f64) {
        let points = list(points);
        self.element(format_args!(
            "<polygon points=\"{points}\" fill=\"{color}\" fill-opacity=\"{opacity}\"/>"
        ));
    }

    /// A rectangle; `fill` may be `none`.
    pub fn rectangle(&mut self, at: [f64; 2], size: [f64; 2], fill: &str, stroke: &str) {
        let [x, y] = at.map(round);
        let [w, h] = size.map(round);
        self.element(format_args!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" fill=\"{fill}\" stroke=\"{stroke}\"/>"
        ));
    }

    /// A disc.
    pub fn disc(&mut self, at: [f64; 2], radius: f64, fill: &str, stroke: &str) {
        let [x, y] = at.map(round);
        self.element(format_args!(
            "<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" fill=\"{fill}\" stroke=\"{stroke}\"/>"
        ));
    }

    /// One line of text, its baseline at `at`.
    pub fn text(&mut self, at: [f64; 2], anchor: Anchor, size: f64, text: &str) {
        self.turned(at, anchor, size, 0.0, text);
    }

    /// Text turned by degrees clockwise about its point.
    pub fn turned(&mut self, at: [f64; 2], anchor: Anchor, size: f64, degrees: f64, text: &str) {
        let [x, y] = at.map(round);
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let turn = if degrees == 0.0 {
            String::new()
        } else {
            format!(" transform=\"rotate({degrees} {x} {y})\"")
        };
        let text = escaped(text);
        self.element(format_args!(
            "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"{INK}\"{turn}>{text}</text>"
        ));
    }

    /// Pixels, row 0 at the top, stretched over a rectangle without smoothing.
    pub fn image(&mut self, at: [f64; 2], size: [f64; 2], width: usize, pixels: &[[u8; 3]]) {
        let height = pixels.len() / width.max(1);
        let mut png = Vec::new();
        // Encoding pixels of a matching size into memory cannot fail.
        let encoded = image::codecs::png::PngEncoder::new(&mut png).write_image(
            pixels.as_flattened(),
            width as u32,
            height as u32,
            image::ExtendedColorType::Rgb8,
        );
        debug_assert!(encoded.is_ok());
        let data = base64::engine::general_purpose::STANDARD.encode(png);
        let [x, y] = at.map(round);
        let [w, h] = size.map(round);
        self.element(format_args!(
            "<image x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" preserveAspectRatio=\"none\" image-rendering=\"optimizeSpeed\" style=\"image-rendering:pixelated\" href=\"data:image/png;base64,{data}\"/>"
        ));
    }

    /// The page.
    pub fn finish(self) -> String {
        let (w, h) = (self.width, self.height);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" font-family=\"{}, sans-serif\">\n<rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>\n{}</svg>\n",
            super::FONT,
            self.body
        )
    }
}

/// About how wide a text is, units.
pub fn text_width(text: &str, size: f64) -> f64 {
    0.55 * size * text.chars().count() as f64
}

fn round(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

fn list(points: &[[f64; 2]]) -> String {
    let mut list = String::new();
    for [x, y] in points.iter().map(|p| p.map(round)) {
        let _ = write!(list, "{x},{y} ");
    }
    list.truncate(list.trim_end().len());
    list
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
