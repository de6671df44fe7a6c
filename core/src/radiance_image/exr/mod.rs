//! Radiance images as OpenEXR files: channels `R`, `G`, `B`, their variances
//! `var.R`, `var.G`, `var.B`, and `mask` (1 where a pixel is valid), 32-bit
//! floats, compressed without loss. Files of other programs may hold several images, as parts or
//! as layers; their display window is the image, of which the data window holds the pixels.

mod layers;
mod planes;
mod rows;
mod window;
mod write;

use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use super::RadianceImage;

pub use rows::ExrRows;
pub use write::{encode, encode_rows, write, write_rows};

/// The radiance image of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct RadianceFile {
    /// The image. Without variances in the file they are 0 here; without a mask
    /// every finite pixel is valid. Pixels that are not finite are invalid and 0.
    pub image: RadianceImage,
    /// Whether the file has the three variance channels.
    pub has_variance: bool,
}

/// A radiance image that cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ExrError {
    /// The system refuses.
    #[error("{file}: {source}")]
    Io {
        file: PathBuf,
        source: std::io::Error,
    },
    #[error("{file} is not a readable OpenEXR file: {problem}")]
    Format { file: PathBuf, problem: String },
    #[error("{file} is {found}, not OpenEXR, which is read")]
    OtherKind { file: PathBuf, found: OtherKind },
    /// The file ends before its image does.
    #[error("{file} is cut short: it has {bytes} bytes, but its image needs at least {needed}")]
    CutShort {
        file: PathBuf,
        bytes: u64,
        /// The least length that its header and its table of blocks need.
        needed: u64,
    },
    #[error("{file} is {width} x {height} pixels; the camera's image is {} x {}", expected[0], expected[1])]
    OtherSize {
        file: PathBuf,
        width: usize,
        height: usize,
        /// The camera's pixels per row, and rows.
        expected: [usize; 2],
    },
    #[error(
        "{file} declares {width} x {height} pixels in {channels} channels, which its {bytes} bytes cannot hold (at most {MOST_PER_BYTE} pixels for each, and {MOST_PIXELS} in all)"
    )]
    Size {
        file: PathBuf,
        /// Declared pixels per row.
        width: usize,
        height: usize,
        channels: usize,
        bytes: u64,
    },
    /// Channels from which no radiance can be had.
    #[error("{file} has the channels {found}, but {wanted} are needed")]
    Channels {
        file: PathBuf,
        /// Those in the file, joined by commas.
        found: String,
        wanted: &'static str,
    },
    /// Several images, and nothing says which one is meant.
    #[error("{file} holds {count} images: {known}")]
    Layers {
        file: PathBuf,
        count: usize,
        /// Their names, joined by commas.
        known: String,
    },
    #[error("{file} holds no image named {layer:?}; it holds {}", if known.is_empty() { "none" } else { known })]
    NoSuchLayer {
        file: PathBuf,
        layer: String,
        /// The names that it has, joined by commas.
        known: String,
    },
    #[error(
        "{file}: none of its pixels (data window {} x {} at {}, {}) lies in its image (display window {} x {} at {}, {})",
        data[0], data[1], data[2], data[3], display[0], display[1], display[2], display[3]
    )]
    Windows {
        file: PathBuf,
        /// Width, height, left and top of the data window.
        data: [i64; 4],
        /// Width, height, left and top of the display window.
        display: [i64; 4],
    },
    #[error("{file} is an OpenEXR file of a kind that is not read: {what}")]
    Kind { file: PathBuf, what: String },
    /// An image whose parts differ in size.
    #[error(
        "{file}: {width} x {height} pixels, but {mean} means, {variance} variances and {valid} mask values"
    )]
    Inconsistent {
        file: PathBuf,
        width: usize,
        height: usize,
        mean: usize,
        variance: usize,
        valid: usize,
    },
}

/// Images that are met in the place of OpenEXR files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OtherKind {
    /// May hold radiance.
    #[error("{0}")]
    Radiance(&'static str),
    /// Holds what a camera or a program shows.
    #[error("{0}")]
    Frame(&'static str),
}

impl OtherKind {
    /// By a file's first bytes.
    pub fn of(start: &[u8]) -> Option<Self> {
        const KNOWN: [(&[u8], OtherKind); 11] = [
            (
                b"#?RADIANCE",
                OtherKind::Radiance("a Radiance HDR image (RGBE)"),
            ),
            (
                b"#?RGBE",
                OtherKind::Radiance("a Radiance HDR image (RGBE)"),
            ),
            (b"PF\n", OtherKind::Radiance("a PFM image")),
            (b"Pf\n", OtherKind::Radiance("a PFM image")),
            (b"PF4\n", OtherKind::Radiance("a PFM image")),
            (b"II*\0", OtherKind::Radiance("a TIFF image")),
            (b"MM\0*", OtherKind::Radiance("a TIFF image")),
            (b"\x93NUMPY", OtherKind::Radiance("a NumPy array")),
            (b"\x89PNG", OtherKind::Frame("a PNG image")),
            (b"\xff\xd8\xff", OtherKind::Frame("a JPEG image")),
            (b"BM", OtherKind::Frame("a BMP image")),
        ];
        let known = KNOWN.iter().find(|(magic, _)| start.starts_with(magic));
        known.map(|(_, kind)| *kind)
    }
}

const COLOURS: [&str; 3] = ["R", "G", "B"];
const VARIANCES: [&str; 3] = ["var.R", "var.G", "var.B"];
const MASK: &str = "mask";

/// Most bytes that one byte becomes: by Deflate, and more than by the other methods.
const MAX_EXPANSION: u64 = 1032;
/// Most pixels that a byte stands for where the image's size is not known in advance: above the 37 of a
/// black image with variance and mask as [`write()`] writes it.
const MOST_PER_BYTE: u64 = 64;
/// Images up to this many pixels may be better compressed than that: a few dozen megabytes.
const SMALL_PIXELS: u64 = 1 << 20;
/// Most pixels of an image whose size is not known in advance.
const MOST_PIXELS: u64 = 1 << 28;
/// Largest file, bytes: that many pixels of seven floats.
const MOST_BYTES: u64 = 7 << 30;

/// Reads a radiance image. An image with `Y` instead of `R`, `G`, `B` is grey; other channels
/// are ignored. A file of several images needs the name of one after a colon, `image.exr:C`.
/// The image is the file's display window: pixels of the data window beyond it are cut off, and
/// what the data window leaves out is invalid.
///
/// # Errors
/// The file cannot be read, is damaged or cut short, declares more than it can hold, lacks
/// channels, or holds several images.
pub fn read(path: &Path) -> Result<RadianceFile, ExrError> {
    whole(ExrRows::open(path, None)?)
}

/// [`read`] for an image of this width and height; the size is compared before
/// anything is decoded.
///
/// # Errors
/// As [`read`]; another size.
pub fn read_sized(path: &Path, size: [usize; 2]) -> Result<RadianceFile, ExrError> {
    whole(ExrRows::open(path, Some(size))?)
}

/// As [`read`], or [`read_sized`] where a size is given, of a file that is open at its
/// beginning; `path` is for messages.
///
/// # Errors
/// As [`read_sized`].
pub fn read_opened(
    file: std::fs::File,
    path: &Path,
    size: Option<[usize; 2]>,
) -> Result<RadianceFile, ExrError> {
    whole(ExrRows::of_file(file, path, size)?)
}

/// Reads a radiance image from a file's bytes; `path` is for messages.
///
/// # Errors
/// As [`read`].
pub fn decode(bytes: &[u8], path: &Path) -> Result<RadianceFile, ExrError> {
    whole(ExrRows::of_bytes(bytes, path, None)?)
}

/// [`decode`] for an image of this width and height.
///
/// # Errors
/// As [`read_sized`].
pub fn decode_sized(bytes: &[u8], path: &Path, size: [usize; 2]) -> Result<RadianceFile, ExrError> {
    whole(ExrRows::of_bytes(bytes, path, Some(size))?)
}

/// Whether a file declares an image that can be read, of this size where one is expected,
/// and is long enough for it: without decoding, in milliseconds.
///
/// # Errors
/// As [`read_sized`], but for what only decoding shows.
pub fn check(path: &Path, size: Option<[usize; 2]>) -> Result<(), ExrError> {
    ExrRows::open(path, size).map(drop)
}

fn whole<R: Read + Seek>(mut rows: ExrRows<R>) -> Result<RadianceFile, ExrError> {
    Ok(RadianceFile {
        image: rows.next_rows(usize::MAX)?,
        has_variance: rows.has_variance(),
    })
}

fn io_error(path: &Path, source: std::io::Error) -> ExrError {
    ExrError::Io {
        file: path.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests;
