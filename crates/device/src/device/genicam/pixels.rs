//! Pixel formats of GenICam cameras (PFNC 2.1) and their decoding to counts.

use crate::device::Mosaic;
use crate::device::retake::FrameFault;

/// How the samples of a frame are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    /// One byte each.
    Byte,
    /// A word of 16 bits each, low byte first, low bits significant.
    Word,
    /// One after the other from the least significant bit on, across pixels and rows (`p`).
    Stream,
    /// GigE Vision's own packing: two samples in three bytes, the low bits of both in the
    /// middle one (`Packed`).
    Packed,
}

/// A format that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelFormat {
    /// Its name in the camera's description.
    pub name: &'static str,
    /// Its number.
    pub code: u32,
    /// Significant bits of a sample.
    pub bits: u32,
    /// Colour filters.
    pub mosaic: Mosaic,
    layout: Layout,
}

const fn format(name: &'static str, code: u32, bits: u32, mosaic: Mosaic) -> PixelFormat {
    let layout = match code >> 16 & 0xff {
        8 => Layout::Byte,
        16 => Layout::Word,
        _ => match name.as_bytes()[name.len() - 1] {
            b'p' => Layout::Stream,
            _ => Layout::Packed,
        },
    };
    PixelFormat {
        name,
        code,
        bits,
        mosaic,
        layout,
    }
}

/// Every format that can be read; among equals the first is taken.
pub const FORMATS: &[PixelFormat] = &[
    format("Mono8", 0x0108_0001, 8, Mosaic::None),
    format("Mono10", 0x0110_0003, 10, Mosaic::None),
    format("Mono10p", 0x010a_0046, 10, Mosaic::None),
    format("Mono10Packed", 0x010c_0004, 10, Mosaic::None),
    format("Mono12", 0x0110_0005, 12, Mosaic::None),
    format("Mono12p", 0x010c_0047, 12, Mosaic::None),
    format("Mono12Packed", 0x010c_0006, 12, Mosaic::None),
    format("Mono14", 0x0110_0025, 14, Mosaic::None),
    format("Mono16", 0x0110_0007, 16, Mosaic::None),
    format("BayerGR8", 0x0108_0008, 8, Mosaic::Grbg),
    format("BayerRG8", 0x0108_0009, 8, Mosaic::Rggb),
    format("BayerGB8", 0x0108_000a, 8, Mosaic::Gbrg),
    format("BayerBG8", 0x0108_000b, 8, Mosaic::Bggr),
    format("BayerGR10", 0x0110_000c, 10, Mosaic::Grbg),
    format("BayerRG10", 0x0110_000d, 10, Mosaic::Rggb),
    format("BayerGB10", 0x0110_000e, 10, Mosaic::Gbrg),
    format("BayerBG10", 0x0110_000f, 10, Mosaic::Bggr),
    format("BayerBG10p", 0x010a_0052, 10, Mosaic::Bggr),
    format("BayerGB10p", 0x010a_0054, 10, Mosaic::Gbrg),
    format("BayerGR10p", 0x010a_0056, 10, Mosaic::Grbg),
    format("BayerRG10p", 0x010a_0058, 10, Mosaic::Rggb),
    format("BayerGR12", 0x0110_0010, 12, Mosaic::Grbg),
    format("BayerRG12", 0x0110_0011, 12, Mosaic::Rggb),
    format("BayerGB12", 0x0110_0012, 12, Mosaic::Gbrg),
    format("BayerBG12", 0x0110_0013, 12, Mosaic::Bggr),
    format("BayerBG12p", 0x010c_0053, 12, Mosaic::Bggr),
    format("BayerGB12p", 0x010c_0055, 12, Mosaic::Gbrg),
    format("BayerGR12p", 0x010c_0057, 12, Mosaic::Grbg),
    format("BayerRG12p", 0x010c_0059, 12, Mosaic::Rggb),
    format("BayerGR12Packed", 0x010c_002a, 12, Mosaic::Grbg),
    format("BayerRG12Packed", 0x010c_002b, 12, Mosaic::Rggb),
    format("BayerGB12Packed", 0x010c_002c, 12, Mosaic::Gbrg),
    format("BayerBG12Packed", 0x010c_002d, 12, Mosaic::Bggr),
    format("BayerGR16", 0x0110_002e, 16, Mosaic::Grbg),
    format("BayerRG16", 0x0110_002f, 16, Mosaic::Rggb),
    format("BayerGB16", 0x0110_0030, 16, Mosaic::Gbrg),
    format("BayerBG16", 0x0110_0031, 16, Mosaic::Bggr),
];

/// The format to use of those offered, by name: the smallest of these filters that holds
/// `bits`; among equals the first of the table.
pub fn best_of(offered: &[String], bits: u32, mosaic: Mosaic) -> Option<PixelFormat> {
    FORMATS
        .iter()
        .filter(|format| format.mosaic == mosaic && format.bits >= bits)
        .filter(|format| offered.iter().any(|name| name == format.name))
        .min_by_key(|format| format.bits)
        .copied()
}

impl PixelFormat {
    /// Counts row by row from the bytes of a frame.
    ///
    /// # Errors
    /// There are too few bytes, or a count has more than `bits` bits.
    pub fn decode(&self, bytes: &[u8], pixels: usize, bits: u32) -> Result<Vec<u16>, FrameFault> {
        let needed = (pixels * (self.code >> 16 & 0xff) as usize).div_ceil(8);
        if bytes.len() < needed {
            return Err(FrameFault::Undecodable(format!(
                "{} bytes, but {pixels} pixels of {} need {needed}",
                bytes.len(),
                self.name
            )));
        }
        let bytes = &bytes[..needed];
        let counts: Vec<u16> = match self.layout {
            Layout::Byte => bytes.iter().map(|&byte| u16::from(byte)).collect(),
            Layout::Word => {
                let words = bytes.chunks_exact(2);
                words
                    .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
                    .collect()
            }
            Layout::Stream => {
                let mask = (1_u32 << self.bits) - 1;
                let sample = |pixel: usize| {
                    let first = pixel * self.bits as usize;
                    let three = (0..3).map(|i| bytes.get(first / 8 + i).copied().unwrap_or(0));
                    let word = three
                        .rev()
                        .fold(0, |word, byte| word << 8 | u32::from(byte));
                    (word >> (first % 8) & mask) as u16
                };
                (0..pixels).map(sample).collect()
            }
            Layout::Packed => {
                let low = self.bits - 8;
                let mask = (1_u16 << low) - 1;
                let sample = |pixel: usize| {
                    let three = &bytes[pixel / 2 * 3..];
                    let is_first = pixel.is_multiple_of(2);
                    let high = if is_first { three[0] } else { three[2] };
                    let shift = if is_first { 0 } else { 4 };
                    u16::from(high) << low | u16::from(three[1]) >> shift & mask
                };
                (0..pixels).map(sample).collect()
            }
        };
        match counts.iter().find(|&&count| u32::from(count) >> bits != 0) {
            None => Ok(counts),
            Some(count) => Err(FrameFault::Undecodable(format!(
                "a count is {count}, more than {bits} bits"
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mock_cameras::gige::pixels::FORMATS as SENT;

    #[test]
    fn every_format_that_the_simulated_camera_sends_is_read() {
        for sent in SENT {
            let format = FORMATS.iter().find(|format| format.name == sent.name);
            let format = format.unwrap_or_else(|| panic!("{}", sent.name));
            assert_eq!((format.code, format.bits), (sent.code, sent.bits));
            let largest = ((1_u32 << sent.bits) - 1) as u16;
            let counts = [1, largest, 0x5a & largest, 0, largest, 0xa3 & largest, 7];
            let bytes = sent.encode(&counts, sent.bits);
            let read = format.decode(&bytes, counts.len(), format.bits);
            assert_eq!(read.unwrap(), counts, "{}", sent.name);
            let short = format.decode(&bytes[1..], counts.len(), format.bits);
            assert!(matches!(short, Err(FrameFault::Undecodable(_))));
        }
        let shifted = FORMATS[4].decode(&[0, 0xf0], 1, 12);
        assert!(matches!(shifted, Err(FrameFault::Undecodable(_))));
    }

    #[test]
    fn the_smallest_format_of_the_filters_is_taken() {
        let all: Vec<String> = SENT.iter().map(|sent| sent.name.to_owned()).collect();
        let best = |bits, mosaic| best_of(&all, bits, mosaic).map(|format| format.name);
        assert_eq!(best(8, Mosaic::None), Some("Mono8"));
        assert_eq!(best(11, Mosaic::None), Some("Mono12"));
        assert_eq!(best(12, Mosaic::Rggb), Some("BayerRG12"));
        assert_eq!(best(14, Mosaic::Rggb), Some("BayerRG16"));
        assert_eq!(best(8, Mosaic::Bggr), None);
        assert_eq!(
            best_of(&all[4..6], 12, Mosaic::None).map(|f| f.name),
            Some("Mono12p")
        );
    }
}
