//! A raw frame as a small picture.

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError};

use super::peaking::sharp_blocks;
use crate::device::{CameraInfo, RawFrame};
use crate::radiometry::framing::saturation_dn;
use crate::radiometry::mosaic::Mosaic;

/// The picture is at most so wide and high, pixels.
pub const LARGEST_PX: usize = 1024;

/// Of 100: marks of single blocks stay visible.
const QUALITY: u8 = 85;

/// A saturated block, by the parity of its place.
const SATURATED: [[u8; 3]; 2] = [[255; 3], [255, 40, 40]];
/// A block of zeros, likewise.
const ZERO: [[u8; 3]; 2] = [[0; 3], [30, 60, 200]];
/// A block in which an edge is sharp.
const SHARP: [u8; 3] = [40, 230, 70];

/// How the counts of a frame are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Significant bits of a count, 1 to 16.
    pub bit_depth: u32,
    /// Colour filters.
    pub mosaic: Mosaic,
}

impl From<&CameraInfo> for Counts {
    fn from(camera: &CameraInfo) -> Self {
        Self {
            bit_depth: camera.bit_depth,
            mosaic: camera.mosaic,
        }
    }
}

/// What is marked in a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Marks {
    /// Saturated blocks are chequered white and red, blocks of zeros blue and black.
    pub limits: bool,
    /// Blocks with sharp edges are green.
    pub peaking: bool,
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
#[error("a picture of {width} × {height} pixels could not be encoded: {source}")]
pub struct PictureError {
    width: usize,
    height: usize,
    source: ImageError,
}

/// 8-bit pixels, and how many sensor pixels each stands for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Quantised {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Sensor pixels on each side of a pixel of the picture.
    pub block: usize,
    /// R, G, B; row 0 is the top.
    pub pixels: Vec<[u8; 3]>,
}

/// The frame as a JPEG for the eye; see [`quantised`].
///
/// # Errors
/// A frame without pixels.
pub fn jpeg(frame: &RawFrame, counts: Counts, marks: Marks) -> Result<Vec<u8>, PictureError> {
    let picture = quantised(frame, counts, marks);
    let (width, height) = (picture.width, picture.height);
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, QUALITY)
        .write_image(
            picture.pixels.as_flattened(),
            width as u32,
            height as u32,
            ExtendedColorType::Rgb8,
        )
        .map_err(|source| PictureError {
            width,
            height,
            source,
        })?;
    Ok(bytes)
}

/// Blocks of pixels are averaged until the picture is small enough, over whole cells of
/// colour filters; shown is the square root of the counts. Marks go over it: saturation
/// before zeros before sharp edges.
pub fn quantised(frame: &RawFrame, counts: Counts, marks: Marks) -> Quantised {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let mut block = width.max(height).div_ceil(LARGEST_PX).max(1);
    if counts.mosaic != Mosaic::None {
        block = block.next_multiple_of(2);
    }
    let (columns, rows) = (width.div_ceil(block), height.div_ceil(block));
    let saturation = saturation_dn(counts.bit_depth);
    let sharp = marks
        .peaking
        .then(|| sharp_blocks(frame, counts.mosaic, block));
    let mut pixels = Vec::with_capacity(columns * rows);
    for row in 0..rows {
        for column in 0..columns {
            let (mut sum, mut pixels_in, mut largest) = (0_u64, 0_u64, 0);
            for y in row * block..((row + 1) * block).min(height) {
                let x_end = ((column + 1) * block).min(width);
                for &dn in &frame.counts[y * width + column * block..y * width + x_end] {
                    sum += u64::from(dn);
                    pixels_in += 1;
                    largest = largest.max(dn);
                }
            }
            let parity = (row + column) % 2;
            let is_sharp = || {
                let sharp = sharp.as_ref();
                sharp.is_some_and(|sharp| sharp[row * columns + column])
            };
            pixels.push(match largest {
                dn if marks.limits && dn >= saturation => SATURATED[parity],
                0 if marks.limits => ZERO[parity],
                _ if is_sharp() => SHARP,
                _ => {
                    let part = sum as f64 / pixels_in as f64 / f64::from(saturation);
                    [(255.0 * part.min(1.0).sqrt()).round() as u8; 3]
                }
            });
        }
    }
    Quantised {
        width: columns,
        height: rows,
        block,
        pixels,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Marks = Marks {
        limits: true,
        peaking: false,
    };

    fn counts(mosaic: Mosaic) -> Counts {
        Counts {
            bit_depth: 12,
            mosaic,
        }
    }

    fn frame(width: u32, height: u32, counts: Vec<u16>) -> RawFrame {
        RawFrame::new(width, height, counts)
    }

    #[test]
    fn saturated_and_zero_pixels_are_marked_and_the_rest_is_grey() {
        let frame = frame(4, 1, vec![4095, 4095, 1024, 0]);
        let marked = quantised(&frame, counts(Mosaic::None), LIMITS).pixels;
        assert_eq!(marked, [SATURATED[0], SATURATED[1], [128; 3], ZERO[1]]);
        let plain = Marks {
            limits: false,
            peaking: false,
        };
        let plain = quantised(&frame, counts(Mosaic::None), plain).pixels;
        assert_eq!(plain, [[255; 3], [255; 3], [128; 3], [0; 3]]);
    }

    #[test]
    fn large_frames_are_averaged_and_one_saturated_pixel_still_shows() {
        let mut dn = vec![1024; 2050 * 1026];
        dn[1025 * 2050 + 2049] = 4095;
        let frame = frame(2050, 1026, dn);
        for mosaic in [Mosaic::None, Mosaic::Rggb] {
            let picture = quantised(&frame, counts(mosaic), LIMITS);
            assert!(picture.width <= 1024 && picture.height <= 1024 && picture.width > 500);
            assert_eq!(picture.pixels[0], [128; 3]);
            let last = *picture.pixels.last().unwrap();
            assert!(SATURATED.contains(&last), "{last:?}");
        }
    }

    /// A cell of colour filters is one block, however small the frame is.
    #[test]
    fn colours_are_averaged_together() {
        let bayer = frame(2, 2, vec![0, 4094, 0, 4094]);
        let picture = quantised(&bayer, counts(Mosaic::Rggb), LIMITS);
        assert_eq!((picture.width, picture.height, picture.block), (1, 1, 2));
        assert_eq!(picture.pixels, [[180; 3]]);
    }

    #[test]
    fn the_jpeg_has_the_size_and_the_brightness_of_the_picture() {
        let frame = frame(64, 48, vec![1024; 64 * 48]);
        let bytes = jpeg(&frame, counts(Mosaic::None), LIMITS).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (64, 48));
        let [r, ..] = picture.get_pixel(32, 24).0;
        assert!(r.abs_diff(128) <= 2, "{r}");
        let empty = RawFrame {
            width: 0,
            height: 0,
            counts: Vec::new(),
            ..frame
        };
        assert!(jpeg(&empty, counts(Mosaic::None), LIMITS).is_err());
    }
}
