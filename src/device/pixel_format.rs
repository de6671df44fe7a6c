//! Raw pixel formats of Video4Linux and their decoding to counts.
//!
//! Uncompressed, one sample per pixel: monochrome or Bayer, 8 bits in a byte or
//! 10 to 16 bits in a 16-bit word, low bits significant (the kernel's
//! `userspace-api/media/v4l/pixfmt-{yuv-luma,srggb8,srggb10,srggb12,srggb14,srggb16}`).
//! Packed formats (`Y10P`, `pBAA`, …) are not read.

use super::Mosaic;

/// A raw format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelFormat {
    /// The kernel's four-character code; for big-endian words the last byte has bit 7 set.
    pub fourcc: [u8; 4],
    /// Significant bits of a sample.
    pub bits: u32,
    /// Colour filters.
    pub mosaic: Mosaic,
    word: Word,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    Byte,
    Little,
    Big,
}

const fn format(fourcc: &[u8; 4], bits: u32, mosaic: Mosaic) -> PixelFormat {
    PixelFormat {
        fourcc: *fourcc,
        bits,
        mosaic,
        word: if bits == 8 { Word::Byte } else { Word::Little },
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
        fourcc: [b'Y', b'1', b'6', b' ' | 0x80],
        bits: 16,
        mosaic: Mosaic::None,
        word: Word::Big,
    },
    format(b"RGGB", 8, Mosaic::Rggb),
    format(b"GRBG", 8, Mosaic::Grbg),
    format(b"GBRG", 8, Mosaic::Gbrg),
    format(b"BA81", 8, Mosaic::Bggr),
    format(b"RG10", 10, Mosaic::Rggb),
    format(b"BA10", 10, Mosaic::Grbg),
    format(b"GB10", 10, Mosaic::Gbrg),
    format(b"BG10", 10, Mosaic::Bggr),
    format(b"RG12", 12, Mosaic::Rggb),
    format(b"BA12", 12, Mosaic::Grbg),
    format(b"GB12", 12, Mosaic::Gbrg),
    format(b"BG12", 12, Mosaic::Bggr),
    format(b"RG14", 14, Mosaic::Rggb),
    format(b"GR14", 14, Mosaic::Grbg),
    format(b"GB14", 14, Mosaic::Gbrg),
    format(b"BG14", 14, Mosaic::Bggr),
    format(b"RG16", 16, Mosaic::Rggb),
    format(b"GR16", 16, Mosaic::Grbg),
    format(b"GB16", 16, Mosaic::Gbrg),
    format(b"BYR2", 16, Mosaic::Bggr),
];

/// The format of a four-character code.
pub fn of_fourcc(fourcc: [u8; 4]) -> Option<PixelFormat> {
    FORMATS
        .iter()
        .copied()
        .find(|format| format.fourcc == fourcc)
}

/// A buffer that is not an image of its format.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Too few bytes.
    #[error("{bytes} bytes, but {width} × {height} pixels in rows of {stride} bytes need {needed}")]
    Short {
        /// Bytes there.
        bytes: usize,
        /// Bytes needed.
        needed: usize,
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes from one row to the next.
        stride: usize,
    },
    /// Bits set above the significant ones: the samples are not where the
    /// format says, often shifted to the top of the word.
    #[error("pixel ({x}, {y}) is {value}, more than {bits} bits")]
    TooLarge {
        /// Column.
        x: u32,
        /// Row.
        y: u32,
        /// Its value.
        value: u16,
        /// Significant bits of the format.
        bits: u32,
    },
}

impl PixelFormat {
    /// The code as text, as cameras' documentation writes it.
    pub fn name(&self) -> String {
        let [a, b, c, d] = self.fourcc.map(|byte| (byte & 0x7f) as char);
        let big = if self.word == Word::Big { "-BE" } else { "" };
        format!("{a}{b}{c}{d}").trim_end().to_owned() + big
    }

    /// Bytes per sample.
    pub fn sample_bytes(&self) -> usize {
        match self.word {
            Word::Byte => 1,
            Word::Little | Word::Big => 2,
        }
    }

    /// Counts row by row from a buffer whose rows begin `stride` bytes apart
    /// (0: without gaps).
    pub fn decode(
        &self,
        bytes: &[u8],
        width: u32,
        height: u32,
        stride: u32,
    ) -> Result<Vec<u16>, DecodeError> {
        let row_bytes = width as usize * self.sample_bytes();
        let stride = if stride == 0 {
            row_bytes
        } else {
            stride as usize
        };
        let rows_before_last = (height as usize).saturating_sub(1);
        let needed = rows_before_last
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
            let row = &bytes[row * stride..][..row_bytes];
            match self.word {
                Word::Byte => counts.extend(row.iter().map(|&byte| u16::from(byte))),
                Word::Little => counts.extend(words(row).map(u16::from_le_bytes)),
                Word::Big => counts.extend(words(row).map(u16::from_be_bytes)),
            }
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

fn words(row: &[u8]) -> impl Iterator<Item = [u8; 2]> + '_ {
    row.chunks_exact(2).map(|pair| [pair[0], pair[1]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(name: &[u8; 4]) -> PixelFormat {
        of_fourcc(*name).unwrap()
    }

    #[test]
    fn codes_are_unique_and_named() {
        for (i, format) in FORMATS.iter().enumerate() {
            assert!(FORMATS[i + 1..].iter().all(|f| f.fourcc != format.fourcc));
            assert_eq!(of_fourcc(format.fourcc), Some(*format));
        }
        assert_eq!(of(b"Y16 ").name(), "Y16");
        assert_eq!(of(&[b'Y', b'1', b'6', 0xa0]).name(), "Y16-BE");
        assert_eq!(of_fourcc(*b"YUYV"), None);
        assert_eq!(of_fourcc(*b"MJPG"), None);
    }

    #[test]
    fn rows_are_taken_at_their_stride_and_words_in_their_order() {
        let bytes = [1, 2, 9, 9, 3, 4];
        assert_eq!(of(b"GREY").decode(&bytes, 2, 2, 4), Ok(vec![1, 2, 3, 4]));
        assert_eq!(
            of(b"GREY").decode(&bytes, 3, 2, 0),
            Ok(vec![1, 2, 9, 9, 3, 4])
        );
        let bytes = [0x34, 0x02, 0xff, 0x03];
        assert_eq!(of(b"Y10 ").decode(&bytes, 2, 1, 4), Ok(vec![0x234, 0x3ff]));
        assert_eq!(of(b"RG16").decode(&bytes, 1, 2, 2), Ok(vec![0x234, 0x3ff]));
        let big = of(&[b'Y', b'1', b'6', 0xa0]);
        assert_eq!(big.decode(&bytes, 2, 1, 4), Ok(vec![0x3402, 0xff03]));
    }

    #[test]
    fn short_buffers_and_stray_bits_are_told() {
        let short = of(b"Y12 ").decode(&[0; 10], 3, 2, 6).unwrap_err();
        assert_eq!(
            short.to_string(),
            "10 bytes, but 3 × 2 pixels in rows of 6 bytes need 12"
        );
        assert!(matches!(
            of(b"Y12 ").decode(&[0; 100], 3, 2, 4),
            Err(DecodeError::Short { .. })
        ));
        let mut bytes = [0; 12];
        bytes[9] = 0x10;
        assert_eq!(
            of(b"BG12").decode(&bytes, 3, 2, 6).unwrap_err().to_string(),
            "pixel (1, 1) is 4096, more than 12 bits"
        );
    }

    proptest! {
        #[test]
        fn any_buffer_and_any_size_end_without_panic(
            bytes in proptest::collection::vec(any::<u8>(), 0..64),
            width in 0..9_u32,
            height in 0..9_u32,
            stride in prop_oneof![0..20_u32, Just(u32::MAX)],
            index in 0..FORMATS.len(),
        ) {
            if let Ok(counts) = FORMATS[index].decode(&bytes, width, height, stride) {
                prop_assert_eq!(counts.len(), (width * height) as usize);
            }
        }

        #[test]
        fn what_was_encoded_is_decoded(
            counts in proptest::collection::vec(0..4096_u16, 12),
            gap in 0..5_usize,
        ) {
            let mut bytes = Vec::new();
            for row in counts.chunks(4) {
                bytes.extend(row.iter().flat_map(|count| count.to_le_bytes()));
                bytes.extend(std::iter::repeat_n(0xee, gap));
            }
            let decoded = of(b"Y12 ").decode(&bytes, 4, 3, 8 + gap as u32);
            prop_assert_eq!(decoded, Ok(counts));
        }
    }
}
