//! Pixel formats of Video4Linux and their decoding to counts.
//!
//! After the kernel's `userspace-api/media/v4l` pages `pixfmt-yuv-luma`,
//! `pixfmt-packed-yuv`, `pixfmt-yuv-planar`, `pixfmt-srggb8` … `pixfmt-srggb16`
//! and the packed `pixfmt-srggb10p`, `12p`, `14p`. Decoding is a pure function
//! of a buffer, its size and its stride.

mod layout;
#[cfg(test)]
mod tests;

use super::Mosaic;
use layout::Layout;

/// A format that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelFormat {
    /// The kernel's four-character code; for big-endian words the last byte has bit 7 set.
    pub fourcc: [u8; 4],
    /// Significant bits of a sample.
    pub bits: u32,
    /// Colour filters.
    pub mosaic: Mosaic,
    /// What its counts are worth.
    pub fidelity: Fidelity,
    layout: Layout,
}

/// What [`fourcc_of_name`] takes, in words.
pub const FORMAT_NAME: &str = "a code of four characters such as \"Y12\" or \"RG16\", with \"-BE\" behind for big-endian words";

/// The kernel's code of a format by the name that its tools print: four characters,
/// shorter ones filled with blanks, and `-BE` behind for big-endian words.
pub fn fourcc_of_name(name: &str) -> Option<[u8; 4]> {
    let (name, is_big) = match name.strip_suffix("-BE") {
        Some(name) => (name, true),
        None => (name, false),
    };
    let mut code: [u8; 4] = format!("{name:<4}").as_bytes().try_into().ok()?;
    if is_big {
        code[3] |= 0x80;
    }
    (name.is_ascii() && !name.is_empty()).then_some(code)
}

/// What a format's counts are worth, worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fidelity {
    /// Compressed, or luma of a colour image: for focusing and framing alone.
    Preview,
    /// Uncompressed luma. Monochrome cameras that speak YUYV deliver their counts
    /// so, but cameras may bend and scale them: linear only if calibrated.
    Luma,
    /// The sensor's counts.
    Raw,
}

const fn format(fourcc: &[u8; 4], bits: u32, mosaic: Mosaic) -> PixelFormat {
    PixelFormat {
        fourcc: *fourcc,
        bits,
        mosaic,
        fidelity: Fidelity::Raw,
        layout: if bits == 8 {
            Layout::Byte
        } else {
            Layout::Little
        },
    }
}

const fn packed(fourcc: &[u8; 4], bits: u32, mosaic: Mosaic) -> PixelFormat {
    PixelFormat {
        layout: Layout::Packed {
            low_bits: bits as usize - 8,
        },
        ..format(fourcc, bits, mosaic)
    }
}

const fn luma(fourcc: &[u8; 4], layout: Layout, fidelity: Fidelity) -> PixelFormat {
    PixelFormat {
        layout,
        fidelity,
        ..format(fourcc, 8, Mosaic::None)
    }
}

/// Every format that can be read.
pub const FORMATS: &[PixelFormat] = &[
    format(b"GREY", 8, Mosaic::None),
    format(b"Y10 ", 10, Mosaic::None),
    format(b"Y12 ", 12, Mosaic::None),
    format(b"Y14 ", 14, Mosaic::None),
    format(b"Y16 ", 16, Mosaic::None),
    PixelFormat {
        layout: Layout::Big,
        ..format(&[b'Y', b'1', b'6', b' ' | 0x80], 16, Mosaic::None)
    },
    packed(b"Y10P", 10, Mosaic::None),
    packed(b"Y12P", 12, Mosaic::None),
    packed(b"Y14P", 14, Mosaic::None),
    format(b"RGGB", 8, Mosaic::Rggb),
    format(b"GRBG", 8, Mosaic::Grbg),
    format(b"GBRG", 8, Mosaic::Gbrg),
    format(b"BA81", 8, Mosaic::Bggr),
    format(b"RG10", 10, Mosaic::Rggb),
    format(b"BA10", 10, Mosaic::Grbg),
    format(b"GB10", 10, Mosaic::Gbrg),
    format(b"BG10", 10, Mosaic::Bggr),
    packed(b"pRAA", 10, Mosaic::Rggb),
    packed(b"pgAA", 10, Mosaic::Grbg),
    packed(b"pGAA", 10, Mosaic::Gbrg),
    packed(b"pBAA", 10, Mosaic::Bggr),
    format(b"RG12", 12, Mosaic::Rggb),
    format(b"BA12", 12, Mosaic::Grbg),
    format(b"GB12", 12, Mosaic::Gbrg),
    format(b"BG12", 12, Mosaic::Bggr),
    packed(b"pRCC", 12, Mosaic::Rggb),
    packed(b"pgCC", 12, Mosaic::Grbg),
    packed(b"pGCC", 12, Mosaic::Gbrg),
    packed(b"pBCC", 12, Mosaic::Bggr),
    format(b"RG14", 14, Mosaic::Rggb),
    format(b"GR14", 14, Mosaic::Grbg),
    format(b"GB14", 14, Mosaic::Gbrg),
    format(b"BG14", 14, Mosaic::Bggr),
    packed(b"pREE", 14, Mosaic::Rggb),
    packed(b"pgEE", 14, Mosaic::Grbg),
    packed(b"pGEE", 14, Mosaic::Gbrg),
    packed(b"pBEE", 14, Mosaic::Bggr),
    format(b"RG16", 16, Mosaic::Rggb),
    format(b"GR16", 16, Mosaic::Grbg),
    format(b"GB16", 16, Mosaic::Gbrg),
    format(b"BYR2", 16, Mosaic::Bggr),
    luma(b"YUYV", Layout::LumaFirst, Fidelity::Luma),
    luma(b"NV12", Layout::LumaPlane, Fidelity::Preview),
    luma(b"MJPG", Layout::Jpeg, Fidelity::Preview),
];

/// The format of a four-character code.
pub fn of_fourcc(fourcc: [u8; 4]) -> Option<PixelFormat> {
    FORMATS
        .iter()
        .copied()
        .find(|format| format.fourcc == fourcc)
}

/// The format to use of those offered: of the best fidelity, and then the
/// smallest that holds `bits` where they are known, else the deepest. Between
/// equals the unpacked one comes first. None for preview unless `preview`.
pub fn best_of(offered: &[[u8; 4]], bits: Option<u32>, preview: bool) -> Option<PixelFormat> {
    let rank = |format: &&PixelFormat| {
        let depth = match bits {
            Some(bits) if format.bits >= bits => (true, 16 - format.bits),
            Some(_) => (false, format.bits),
            None => (true, format.bits),
        };
        let packed = matches!(format.layout, Layout::Packed { .. });
        (format.fidelity, depth, !packed)
    };
    FORMATS
        .iter()
        .filter(|format| offered.contains(&format.fourcc))
        .filter(|format| preview || format.fidelity > Fidelity::Preview)
        .max_by_key(rank)
        .copied()
}

/// A buffer that is not an image of its format.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum DecodeError {
    /// Too few bytes.
    #[error("{bytes} bytes, but {width} × {height} pixels in rows of {stride} bytes need {needed}")]
    Short {
        bytes: usize,
        needed: usize,
        width: u32,
        height: u32,
        stride: usize,
    },
    /// Bits set above the significant ones: the samples are not where the
    /// format says, often shifted to the top of the word.
    #[error("pixel ({x}, {y}) is {value}, more than {bits} bits")]
    TooLarge {
        x: u32,
        y: u32,
        value: u16,
        bits: u32,
    },
    /// A compressed image of another size than the stream's.
    #[error(
        "an image of {} × {} pixels in a stream of {} × {}",
        found[0], found[1], expected[0], expected[1]
    )]
    Size {
        /// Width and height in the image.
        found: [u32; 2],
        /// Width and height of the stream.
        expected: [u32; 2],
    },
    /// A compressed image that cannot be read.
    #[error("a damaged JPEG image: {0}")]
    Jpeg(String),
}

impl PixelFormat {
    /// The code as text, as cameras' documentation writes it.
    pub fn name(&self) -> String {
        let [a, b, c, d] = self.fourcc.map(|byte| (byte & 0x7f) as char);
        let big = if self.layout == Layout::Big {
            "-BE"
        } else {
            ""
        };
        format!("{a}{b}{c}{d}").trim_end().to_owned() + big
    }

    /// Counts row by row from a buffer whose rows begin `stride` bytes apart
    /// (0: without gaps).
    ///
    /// # Errors
    /// If `bytes` (those that the driver reports as used) hold no whole image.
    pub fn decode(
        &self,
        bytes: &[u8],
        width: u32,
        height: u32,
        stride: u32,
    ) -> Result<Vec<u16>, DecodeError> {
        if self.layout == Layout::Jpeg {
            return layout::jpeg_luma(bytes, [width, height]);
        }
        let row_bytes = self.layout.row_bytes(width as usize);
        let stride = if stride == 0 {
            row_bytes
        } else {
            stride as usize
        };
        let rows = self.layout.rows_sent(height as usize);
        let needed = rows
            .saturating_sub(1)
            .saturating_mul(stride)
            .saturating_add(row_bytes);
        if bytes.len() < needed || stride < row_bytes {
            return Err(DecodeError::Short {
                bytes: bytes.len(),
                needed,
                width,
                height,
                stride,
            });
        }
        let mut counts = Vec::with_capacity(width as usize * height as usize);
        for row in 0..height as usize {
            let row_bytes = &bytes[row * stride..][..row_bytes];
            self.layout
                .decode_row(row_bytes, width as usize, &mut counts);
        }
        let largest = ((1_u32 << self.bits) - 1) as u16;
        match counts.iter().position(|&count| count > largest) {
            None => Ok(counts),
            Some(place) => Err(DecodeError::TooLarge {
                x: place as u32 % width,
                y: place as u32 / width,
                value: counts[place],
                bits: self.bits,
            }),
        }
    }
}
