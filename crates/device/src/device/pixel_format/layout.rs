//! Where the samples of a row are among its bytes.

use std::io::Cursor;

use image::codecs::jpeg::JpegDecoder;
use image::{DynamicImage, ImageDecoder};

use super::DecodeError;

/// How samples are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layout {
    /// One byte each.
    Byte,
    /// A 16-bit word each, low byte first, low bits significant.
    Little,
    /// A 16-bit word each, high byte first.
    Big,
    /// MIPI's packing: the upper eight bits of the samples of a group, one byte
    /// each, then their `low_bits` lower ones one after the other from the least
    /// significant bit on. A group is the least that fills whole bytes.
    Packed {
        /// 2, 4 or 6.
        low_bits: usize,
    },
    /// Every first byte of two, the others being colour (YUYV).
    LumaFirst,
    /// One byte each, then half as many rows of colour (NV12).
    LumaPlane,
    /// A whole JPEG image; no rows.
    Jpeg,
}

/// Samples and bytes of a group.
const fn group(low_bits: usize) -> (usize, usize) {
    let samples = if low_bits == 4 { 2 } else { 4 };
    (samples, samples + samples * low_bits / 8)
}

impl Layout {
    /// Bytes of a row without its padding. Packed rows end with a whole group.
    pub(super) fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Byte | Self::LumaPlane => width,
            Self::Little | Self::Big => 2 * width,
            Self::LumaFirst => 2 * width.next_multiple_of(2),
            Self::Packed { low_bits } => {
                let (samples, bytes) = group(low_bits);
                width.div_ceil(samples) * bytes
            }
            Self::Jpeg => 0,
        }
    }

    /// Rows in the buffer, those of colour included.
    pub(super) fn rows_sent(self, height: usize) -> usize {
        match self {
            Self::LumaPlane => height + height.div_ceil(2),
            _ => height,
        }
    }

    /// Appends the `width` samples of a row of [`Self::row_bytes`].
    pub(super) fn decode_row(self, row: &[u8], width: usize, counts: &mut Vec<u16>) {
        let byte = |&byte: &u8| u16::from(byte);
        match self {
            Self::Byte | Self::LumaPlane => counts.extend(row.iter().map(byte)),
            Self::Little => counts.extend(words(row).map(u16::from_le_bytes)),
            Self::Big => counts.extend(words(row).map(u16::from_be_bytes)),
            Self::LumaFirst => counts.extend(row.iter().step_by(2).map(byte).take(width)),
            Self::Packed { low_bits } => {
                let (samples, bytes) = group(low_bits);
                let unpacked = row.chunks_exact(bytes).flat_map(|group| {
                    let (high, low) = group.split_at(samples);
                    let low = low
                        .iter()
                        .rev()
                        .fold(0_u32, |all, &b| all << 8 | u32::from(b));
                    high.iter().enumerate().map(move |(i, &high)| {
                        let low = low >> (i * low_bits) & ((1 << low_bits) - 1);
                        u16::from(high) << low_bits | low as u16
                    })
                });
                counts.extend(unpacked.take(width));
            }
            Self::Jpeg => {}
        }
    }
}

fn words(row: &[u8]) -> impl Iterator<Item = [u8; 2]> + '_ {
    row.chunks_exact(2).map(|pair| [pair[0], pair[1]])
}

/// The luma of a JPEG image, which must have the stream's size: nothing is
/// allocated for another one.
pub(super) fn jpeg_luma(bytes: &[u8], expected: [u32; 2]) -> Result<Vec<u16>, DecodeError> {
    let text = |error: image::ImageError| DecodeError::Jpeg(error.to_string());
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(text)?;
    let (width, height) = decoder.dimensions();
    if [width, height] != expected {
        return Err(DecodeError::Size {
            found: [width, height],
            expected,
        });
    }
    let image = DynamicImage::from_decoder(decoder).map_err(text)?;
    Ok(image.to_luma8().iter().map(|&c| u16::from(c)).collect())
}
