//! Pictures, and rows of them.

use base64::Engine;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::canvas::{Figure, INK, TEXT_PX, draw, fitting_style, units};

/// 8-bit sRGB with opacity; row 0 is the top.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    /// R, G, B, opacity.
    pub pixels: Vec<[u8; 4]>,
}

impl Picture {
    /// From a function of column and row.
    pub fn from_fn(width: usize, height: usize, pixel: impl Fn(usize, usize) -> [u8; 4]) -> Self {
        let at = |index: usize| pixel(index % width.max(1), index / width.max(1));
        Self {
            width,
            height,
            pixels: (0..width * height).map(at).collect(),
        }
    }

    /// Opaque pixels, `width` to a row.
    pub fn opaque(width: usize, pixels: impl IntoIterator<Item = [u8; 3]>) -> Self {
        let pixels: Vec<_> = pixels.into_iter().map(|[r, g, b]| [r, g, b, 255]).collect();
        Self {
            width,
            height: pixels.len() / width.max(1),
            pixels,
        }
    }

    /// A PNG in a `data:` address. An empty picture gives an empty address.
    pub fn data_uri(&self) -> String {
        let mut png = Vec::new();
        let encoder =
            PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive);
        let (width, height) = (self.width as u32, self.height as u32);
        let is_transparent = self.pixels.iter().any(|pixel| pixel[3] != 255);
        let written = if is_transparent {
            let bytes = self.pixels.as_flattened();
            encoder.write_image(bytes, width, height, ExtendedColorType::Rgba8)
        } else {
            let rgb = self.pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]);
            let bytes: Vec<u8> = rgb.collect();
            encoder.write_image(&bytes, width, height, ExtendedColorType::Rgb8)
        };
        match written {
            Ok(()) => png_data_uri(&png),
            Err(_) => String::new(),
        }
    }
}

/// A PNG file as a `data:` address.
pub fn png_data_uri(png: &[u8]) -> String {
    let text = base64::engine::general_purpose::STANDARD.encode(png);
    format!("data:image/png;base64,{text}")
}

/// A square picture with an optional smaller one in its lower right corner.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Below it.
    pub caption: String,
    /// The picture.
    pub picture: Picture,
    /// The smaller one.
    pub inset: Option<Picture>,
}

/// Rows of pictures `side_px` CSS pixels wide, every row with a title at its left and the
/// columns with titles above.
pub fn pictures(
    name: &str,
    side_px: f64,
    columns: &[String],
    rows: &[(String, Vec<Tile>)],
) -> Figure {
    const GAP_PX: f64 = 10.0;
    let left_px = match rows.iter().all(|(title, _)| title.is_empty()) {
        true => GAP_PX,
        false => 28.0,
    };
    let top_px = if columns.is_empty() { GAP_PX } else { 28.0 };
    let cell_px = [side_px + GAP_PX, side_px + 26.0];
    let across = rows.iter().map(|(_, row)| row.len()).max().unwrap_or(0);
    let size_px = [
        left_px + across as f64 * cell_px[0],
        top_px + rows.len() as f64 * cell_px[1] + 4.0,
    ];
    let room_px = side_px + 0.6 * GAP_PX;
    let style = |text: &str| fitting_style(text, room_px, INK, HPos::Center, VPos::Center);
    let at = |x_px: f64, y_px: f64| (units(x_px), units(y_px));
    draw(name, size_px, |root, images| {
        for (index, title) in columns.iter().enumerate() {
            let middle_px = left_px + index as f64 * cell_px[0] + 0.5 * side_px;
            let above = at(middle_px, top_px - TEXT_PX);
            root.draw(&Text::new(title.as_str(), above, style(title)))?;
        }
        for (index, (title, row)) in rows.iter().enumerate() {
            let y_px = top_px + index as f64 * cell_px[1];
            let turned = style(title).transform(FontTransform::Rotate270);
            let left = at(0.5 * left_px, y_px + 0.5 * side_px);
            root.draw(&Text::new(title.as_str(), left, turned))?;
            for (column, tile) in row.iter().enumerate() {
                let x_px = left_px + column as f64 * cell_px[0];
                images.put(at(x_px, y_px), at(side_px, side_px), &tile.picture);
                if let Some(inset) = &tile.inset {
                    let inset_px = 0.36 * side_px;
                    let corner_px = [x_px, y_px].map(|v| v + side_px - inset_px);
                    let corner = at(corner_px[0], corner_px[1]);
                    images.put(corner, at(inset_px, inset_px), inset);
                    let opposite = at(x_px + side_px, y_px + side_px);
                    root.draw(&Rectangle::new([corner, opposite], WHITE.stroke_width(4)))?;
                }
                let below = at(x_px + 0.5 * side_px, y_px + side_px + TEXT_PX);
                root.draw(&Text::new(
                    tile.caption.as_str(),
                    below,
                    style(&tile.caption),
                ))?;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_comes_back_from_its_address() {
        let picture = Picture::from_fn(3, 2, |x, y| {
            [
                x as u8 * 100,
                y as u8 * 200,
                7,
                if x == 2 { 0 } else { 255 },
            ]
        });
        let uri = picture.data_uri();
        let text = uri.strip_prefix("data:image/png;base64,").unwrap();
        let png = base64::engine::general_purpose::STANDARD
            .decode(text)
            .unwrap();
        let back = image::load_from_memory(&png).unwrap().to_rgba8();
        assert_eq!((back.width(), back.height()), (3, 2));
        assert_eq!(back.as_raw().as_slice(), picture.pixels.as_flattened());
    }
}
