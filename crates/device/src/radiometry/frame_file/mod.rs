//! Frames as files of counts: PNG, TIFF, JPEG.
//!
//! Pixels stay in the file's order. An orientation that a camera has stated is for showing a
//! picture upright; the sensor has not been turned, and neither is its calibration.

mod other;
mod png;
mod tiff;

use std::io::Cursor;
use std::ops::Range;

use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::shown::{MESSAGE, shortened};

/// Counts of a frame, DN.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameFile {
    /// Pixels per row.
    pub width: usize,
    /// Rows; row 0 is the top.
    pub height: usize,
    /// Bits of a count in the file, 8 to 16.
    pub bits: u32,
    /// One plane (grey) or three (red, green, blue), row by row each.
    pub planes: Vec<Vec<u16>>,
    /// How its counts follow the light, as far as the file states it.
    pub tone: Tone,
}

/// How counts follow the light, as far as a file states it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// Nothing is stated.
    Unstated,
    /// A PNG's counts are those of sRGB or of another gamma.
    Gamma,
    /// JPEG, which is made for the eye: by the camera's tone curve, and with loss.
    Jpeg,
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
            planes: self.planes.iter().map(cut).collect(),
            ..*self
        })
    }
}

/// Why a frame cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum FrameFileError {
    #[error("it is neither PNG nor TIFF nor JPEG{}", .0.map(|kind| format!(", but {kind}")).unwrap_or_default())]
    Format(Option<&'static str>),
    /// The counts of a camera's sensor in its maker's own format.
    #[error("it is a camera's raw file ({0})")]
    CameraRaw(&'static str),
    #[error("it has {0}; frames have grey or RGB samples of 8 to 16 bits")]
    Samples(String),
    #[error("its compression ({0}) is not read")]
    Compression(String),
    /// Several images in one file.
    #[error("it has {count} {what} ({sizes}), and a frame is one")]
    Pages {
        count: usize,
        what: &'static str,
        sizes: String,
    },
    #[error("it is {} x {} pixels; {} x {} are needed", found[0], found[1], needed[0], needed[1])]
    Size {
        /// Pixels per row, and rows.
        found: [usize; 2],
        needed: [usize; 2],
    },
    /// More pixels than any sensor has.
    #[error("it declares {} x {} pixels; at most {MOST_PIXELS} are read", .0[0], .0[1])]
    TooLarge([usize; 2]),
    /// Its decoder's error.
    #[error("{0}")]
    Damaged(String),
}

impl FrameFileError {
    fn damaged(error: impl std::fmt::Display) -> Self {
        Self::Damaged(shortened(&error.to_string(), MESSAGE).into_owned())
    }
}

/// Deflate shrinks at most 1032-fold; a larger declared size is a lie.
const MAX_COMPRESSION: u64 = 1032;
/// More than any sensor has.
const MOST_PIXELS: u64 = 1 << 28;

const KNOWN: [ImageFormat; 3] = [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Jpeg];

/// Most bytes that a decoder may allocate for a file.
fn most_bytes(file: &[u8]) -> u64 {
    file.len() as u64 * MAX_COMPRESSION + (1 << 16)
}

/// Decodes a PNG, TIFF or JPEG, recognised by its first bytes: grey or RGB of 8 to 16 bits.
///
/// # Errors
/// Another format, damaged, larger than its bytes can hold, or other pixels than counts: with
/// alpha or palette, of floating point, several pages.
pub fn decode(bytes: &[u8]) -> Result<FrameFile, FrameFileError> {
    decode_sized(bytes, None)
}

/// [`decode`] for a frame of this size (pixels per row, rows) where one is known; it is compared
/// before anything is decoded.
///
/// # Errors
/// As [`decode`]; another size.
pub fn decode_sized(bytes: &[u8], size: Option<[usize; 2]>) -> Result<FrameFile, FrameFileError> {
    match format(bytes)? {
        ImageFormat::Png => png::decode(bytes, size),
        ImageFormat::Tiff => tiff::decode(bytes, size),
        _ => decode_jpeg(bytes, size),
    }
}

/// A picture of any colours, PNG, TIFF or JPEG, as it is; of `size` (pixels per row, rows) where
/// that is known.
///
/// # Errors
/// Another format or size, damaged, several pages, or larger than its bytes can hold.
pub fn picture(bytes: &[u8], size: Option<[usize; 2]>) -> Result<DynamicImage, FrameFileError> {
    let format = format(bytes)?;
    if format == ImageFormat::Tiff {
        match tiff::decode(bytes, size) {
            Ok(frame) => return as_picture(frame),
            // Alpha and the like, which do no harm to a picture.
            Err(FrameFileError::Samples(_)) => {}
            Err(error) => return Err(error),
        }
    }
    picture_as(bytes, format, size)
}

fn format(bytes: &[u8]) -> Result<ImageFormat, FrameFileError> {
    if let Some(kind) = other::camera_raw(bytes) {
        return Err(FrameFileError::CameraRaw(kind));
    }
    match image::guess_format(bytes) {
        Ok(format) if KNOWN.contains(&format) => Ok(format),
        // `guess_format` does not know BigTIFF.
        _ if matches!(bytes, [b'I', b'I', 43, 0, ..] | [b'M', b'M', 0, 43, ..]) => {
            Ok(ImageFormat::Tiff)
        }
        _ => Err(FrameFileError::Format(other::kind(bytes))),
    }
}

/// Compares a declared size with the needed one, and with what a sensor can have.
fn check_size(found: [usize; 2], needed: Option<[usize; 2]>) -> Result<(), FrameFileError> {
    if let Some(needed) = needed.filter(|needed| *needed != found) {
        return Err(FrameFileError::Size { found, needed });
    }
    match found[0] as u64 * found[1] as u64 <= MOST_PIXELS {
        true => Ok(()),
        false => Err(FrameFileError::TooLarge(found)),
    }
}

fn as_picture(frame: FrameFile) -> Result<DynamicImage, FrameFileError> {
    let (width, height) = (frame.width as u32, frame.height as u32);
    let samples: Vec<u16> = match &frame.planes[..] {
        [grey] => grey.clone(),
        planes => (0..frame.width * frame.height)
            .flat_map(|pixel| planes.iter().map(move |plane| plane[pixel]))
            .collect(),
    };
    // A picture of 12 bits fills the range of one of 16.
    let shift = if frame.bits > 8 { 16 - frame.bits } else { 0 };
    let bytes = || samples.iter().map(|&count| count as u8).collect();
    let words = || samples.iter().map(|&count| count << shift).collect();
    let made = match (frame.planes.len(), frame.bits) {
        (1, 8) => image::GrayImage::from_raw(width, height, bytes()).map(DynamicImage::from),
        (1, _) => {
            image::ImageBuffer::from_raw(width, height, words()).map(DynamicImage::ImageLuma16)
        }
        (_, 8) => image::RgbImage::from_raw(width, height, bytes()).map(DynamicImage::from),
        _ => image::ImageBuffer::from_raw(width, height, words()).map(DynamicImage::ImageRgb16),
    };
    made.ok_or_else(|| FrameFileError::damaged("its planes have no one size"))
}

fn picture_as(
    bytes: &[u8],
    format: ImageFormat,
    size: Option<[usize; 2]>,
) -> Result<DynamicImage, FrameFileError> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(most_bytes(bytes));
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(FrameFileError::damaged)?;
    let (width, height) = decoder.dimensions();
    check_size([width as usize, height as usize], size)?;
    DynamicImage::from_decoder(decoder).map_err(FrameFileError::damaged)
}

fn decode_jpeg(bytes: &[u8], size: Option<[usize; 2]>) -> Result<FrameFile, FrameFileError> {
    let reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Jpeg);
    let decoder = reader.into_decoder().map_err(FrameFileError::damaged)?;
    if decoder.original_color_type() == ExtendedColorType::Cmyk8 {
        return Err(FrameFileError::Samples("4 samples per pixel (CMYK)".into()));
    }
    let image = picture_as(bytes, ImageFormat::Jpeg, size)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let planes = match image {
        DynamicImage::ImageLuma8(grey) => planes(grey.into_raw(), 1),
        other => planes(other.into_rgb8().into_raw(), 3),
    };
    Ok(FrameFile {
        width,
        height,
        bits: 8,
        planes,
        tone: Tone::Jpeg,
    })
}

/// Interleaved samples as planes of counts.
fn planes<T: Into<u16> + Copy>(samples: Vec<T>, channels: usize) -> Vec<Vec<u16>> {
    let plane = |channel: usize| {
        let values = samples.iter().skip(channel).step_by(channels);
        values.map(|&value| value.into()).collect()
    };
    (0..channels).map(plane).collect()
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
        let frame = decode(&grey(7, 5)).unwrap();
        assert_eq!((frame.width, frame.height, frame.bits), (7, 5, 16));
        assert_eq!(
            frame.planes,
            vec![(0..35).map(|p| p * 977 % 4096).collect::<Vec<u16>>()]
        );
        let rgb = image::RgbImage::from_raw(2, 1, vec![1, 2, 3, 4, 5, 6]).unwrap();
        let frame = decode(&png(DynamicImage::ImageRgb8(rgb))).unwrap();
        assert_eq!(frame.planes, [[1, 4], [2, 5], [3, 6]]);
        assert_eq!(frame.bits, 8);
        let alpha = image::RgbaImage::new(2, 2);
        assert!(decode(&png(DynamicImage::ImageRgba8(alpha))).is_err());
    }

    #[test]
    fn a_part_holds_its_own_pixels() {
        let frame = decode(&grey(7, 5)).unwrap();
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
    fn other_formats_are_recognised_by_their_first_bytes() {
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
            if let Ok(frame) = decode(&bytes) {
                for plane in &frame.planes {
                    prop_assert_eq!(plane.len(), frame.width * frame.height);
                }
            }
        }
    }
}
