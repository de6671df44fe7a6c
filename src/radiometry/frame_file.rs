//! Frames as files of 8 or 16 bits: PNG, TIFF, JPEG.

use std::io::Cursor;
use std::ops::Range;

use image::{DynamicImage, ImageFormat, ImageReader, Limits};

use crate::shown::{MESSAGE, shortened};

/// Counts of a frame, DN.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameFile {
    /// Pixels per row.
    pub width: usize,
    /// Rows; row 0 is the top.
    pub height: usize,
    /// Bits of a count in the file, 8 or 16.
    pub bits: u32,
    /// One plane (grey) or three (red, green, blue), row by row each.
    pub planes: Vec<Vec<u16>>,
}

impl FrameFile {
    /// The part within these columns and rows; `None` where it is empty or leaves the frame.
    pub fn part(&self, columns: Range<usize>, rows: Range<usize>) -> Option<Self> {
        let inside = columns.end <= self.width && rows.end <= self.height;
        if !inside || columns.is_empty() || rows.is_empty() {
            return None;
        }
        let cut = |plane: &Vec<u16>| {
            let lines = rows.clone().map(|y| y * self.width);
            lines
                .flat_map(|at| &plane[at + columns.start..at + columns.end])
                .copied()
                .collect()
        };
        Some(Self {
            width: columns.len(),
            height: rows.len(),
            bits: self.bits,
            planes: self.planes.iter().map(cut).collect(),
        })
    }
}

/// A frame that cannot be used; says what is wrong with it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct FrameFileError(String);

/// Deflate shrinks at most 1032-fold; a larger declared size is a lie.
const MAX_COMPRESSION: u64 = 1032;
/// More than any sensor has.
const MOST_PIXELS: u64 = 1 << 28;

const KNOWN: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Jpeg];

/// Decodes a PNG, TIFF or JPEG, whichever its first bytes say it is; as [`decode_png`].
///
/// # Errors
/// Another format, damaged, larger than its bytes can hold, or with alpha or palette.
pub fn decode(bytes: &[u8]) -> Result<FrameFile, FrameFileError> {
    match image::guess_format(bytes) {
        Ok(format) if KNOWN.contains(&format) => decode_as(bytes, format),
        _ => Err(FrameFileError("it is neither PNG nor TIFF nor JPEG".into())),
    }
}

/// Decodes a PNG. Alpha channels are refused: they say that this is a picture
/// and not a frame.
///
/// # Errors
/// No PNG, damaged, larger than its bytes can hold, or with alpha or palette.
pub fn decode_png(bytes: &[u8]) -> Result<FrameFile, FrameFileError> {
    decode_as(bytes, ImageFormat::Png)
}

/// A picture of any colours, PNG, TIFF or JPEG, as it is; of `size` (pixels per row, rows) where
/// that is known.
///
/// # Errors
/// Another format or size, damaged, or larger than its bytes can hold.
pub fn picture(bytes: &[u8], size: Option<[usize; 2]>) -> Result<DynamicImage, FrameFileError> {
    match image::guess_format(bytes) {
        Ok(format) if KNOWN.contains(&format) => picture_as(bytes, format, size),
        _ => Err(FrameFileError("it is neither PNG nor TIFF nor JPEG".into())),
    }
}

fn picture_as(
    bytes: &[u8],
    format: ImageFormat,
    size: Option<[usize; 2]>,
) -> Result<DynamicImage, FrameFileError> {
    let error = |problem: image::ImageError| {
        FrameFileError(shortened(&problem.to_string(), MESSAGE).into_owned())
    };
    // The size is compared before anything is decoded.
    let reader = ImageReader::with_format(Cursor::new(bytes), format);
    let (width, height) = reader.into_dimensions().map_err(error)?;
    if let Some([wanted_width, wanted_height]) = size
        && [width as usize, height as usize] != [wanted_width, wanted_height]
    {
        return Err(FrameFileError(format!(
            "it is {width} x {height} pixels; {wanted_width} x {wanted_height} are needed"
        )));
    }
    if u64::from(width) * u64::from(height) > MOST_PIXELS {
        return Err(FrameFileError(format!(
            "it declares {width} x {height} pixels; at most {MOST_PIXELS} are read"
        )));
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some((bytes.len() as u64) * MAX_COMPRESSION + (1 << 16));
    reader.limits(limits);
    reader.decode().map_err(error)
}

fn decode_as(bytes: &[u8], format: ImageFormat) -> Result<FrameFile, FrameFileError> {
    let image = picture_as(bytes, format, None)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let deinterleave = |samples: Vec<u16>| -> Vec<Vec<u16>> {
        (0..3)
            .map(|c| samples.iter().skip(c).step_by(3).copied().collect())
            .collect()
    };
    let widen = |samples: Vec<u8>| samples.into_iter().map(u16::from).collect::<Vec<u16>>();
    let (bits, planes) = match image {
        DynamicImage::ImageLuma8(grey) => (8, vec![widen(grey.into_raw())]),
        DynamicImage::ImageLuma16(grey) => (16, vec![grey.into_raw()]),
        DynamicImage::ImageRgb8(rgb) => (8, deinterleave(widen(rgb.into_raw()))),
        DynamicImage::ImageRgb16(rgb) => (16, deinterleave(rgb.into_raw())),
        other => {
            return Err(FrameFileError(format!(
                "its pixels are {:?}; grey or RGB of 8 or 16 bits are read",
                other.color()
            )));
        }
    };
    Ok(FrameFile {
        width,
        height,
        bits,
        planes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{any, prop_assert_eq, proptest};

    fn png(image: DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    fn grey(width: u32, height: u32) -> Vec<u8> {
        let counts = (0..width * height)
            .map(|p| (p * 977 % 4096) as u16)
            .collect();
        png(DynamicImage::ImageLuma16(
            image::ImageBuffer::from_raw(width, height, counts).unwrap(),
        ))
    }

    #[test]
    fn counts_come_back_as_they_were() {
        let frame = decode_png(&grey(7, 5)).unwrap();
        assert_eq!((frame.width, frame.height, frame.bits), (7, 5, 16));
        assert_eq!(
            frame.planes,
            vec![(0..35).map(|p| p * 977 % 4096).collect::<Vec<u16>>()]
        );
        let rgb = image::RgbImage::from_raw(2, 1, vec![1, 2, 3, 4, 5, 6]).unwrap();
        let frame = decode_png(&png(DynamicImage::ImageRgb8(rgb))).unwrap();
        assert_eq!(frame.planes, [[1, 4], [2, 5], [3, 6]]);
        assert_eq!(frame.bits, 8);
        let alpha = image::RgbaImage::new(2, 2);
        assert!(decode_png(&png(DynamicImage::ImageRgba8(alpha))).is_err());
    }

    #[test]
    fn a_part_holds_its_own_pixels() {
        let frame = decode_png(&grey(7, 5)).unwrap();
        let part = frame.part(2..4, 1..5).unwrap();
        assert_eq!((part.width, part.height), (2, 4));
        let expected = [9, 10, 16, 17, 23, 24, 30, 31].map(|p| p * 977 % 4096);
        assert_eq!(part.planes, [expected]);
        assert_eq!(frame.part(0..7, 0..5).unwrap(), frame);
        for (columns, rows) in [(5..8, 0..5), (0..7, 3..6), (2..2, 0..5)] {
            assert_eq!(frame.part(columns, rows), None);
        }
    }

    #[test]
    fn other_formats_are_told_by_their_first_bytes() {
        let image = DynamicImage::ImageRgb8(
            image::RgbImage::from_raw(8, 8, [[90u8, 120, 200]; 64].concat()).unwrap(),
        );
        for format in [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Jpeg] {
            let mut bytes = Cursor::new(Vec::new());
            image.write_to(&mut bytes, format).unwrap();
            let frame = decode(&bytes.into_inner()).unwrap();
            assert_eq!((frame.width, frame.height, frame.bits), (8, 8, 8));
            for (plane, value) in frame.planes.iter().zip([90, 120, 200]) {
                // JPEG keeps an even colour to a count or two.
                assert!(
                    plane.iter().all(|&z: &u16| z.abs_diff(value) <= 2),
                    "{format:?}"
                );
            }
        }
        assert!(decode(b"GIF89a and so on").is_err());
        assert!(decode(&[]).is_err());
    }

    proptest! {
        /// Checksums make most damage an error; none may be a panic.
        #[test]
        fn damaged_files_never_panic(
            changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..8),
            keep in any::<proptest::sample::Index>(),
            cut in any::<bool>(),
        ) {
            let mut bytes = grey(13, 9);
            for (at, value) in changes {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            if cut {
                bytes.truncate(keep.index(bytes.len()));
            }
            if let Ok(frame) = decode_png(&bytes) {
                for plane in &frame.planes {
                    prop_assert_eq!(plane.len(), frame.width * frame.height);
                }
            }
        }
    }
}
