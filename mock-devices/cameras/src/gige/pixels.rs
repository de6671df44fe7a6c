//! Pixel formats (PFNC 2.1) and how counts become their bytes.

/// How counts are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    /// One byte each.
    Byte,
    /// A word of 16 bits each, low byte first.
    Word,
    /// Bits one after the other from the least significant on (`p`).
    Stream,
    /// GigE Vision's own: two pixels in three bytes, the low bits in the middle one.
    Packed,
}

/// A format on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Format {
    /// Name in the GenICam description.
    pub name: &'static str,
    pub code: u32,
    pub bits: u32,
    layout: Layout,
}

const fn format(name: &'static str, code: u32, bits: u32, layout: Layout) -> Format {
    Format {
        name,
        code,
        bits,
        layout,
    }
}

/// Every format on offer.
pub const FORMATS: [Format; 12] = [
    format("Mono8", 0x0108_0001, 8, Layout::Byte),
    format("Mono10", 0x0110_0003, 10, Layout::Word),
    format("Mono10p", 0x010a_0046, 10, Layout::Stream),
    format("Mono12", 0x0110_0005, 12, Layout::Word),
    format("Mono12Packed", 0x010c_0006, 12, Layout::Packed),
    format("Mono12p", 0x010c_0047, 12, Layout::Stream),
    format("Mono14", 0x0110_0025, 14, Layout::Word),
    format("Mono16", 0x0110_0007, 16, Layout::Word),
    format("BayerRG8", 0x0108_0009, 8, Layout::Byte),
    format("BayerRG12", 0x0110_0011, 12, Layout::Word),
    format("BayerRG12p", 0x010c_0059, 12, Layout::Stream),
    format("BayerRG16", 0x0110_002f, 16, Layout::Word),
];

/// The format of a number.
pub fn of_code(code: u32) -> Option<Format> {
    FORMATS.into_iter().find(|format| format.code == code)
}

impl Format {
    /// Bits that a pixel takes.
    pub fn bits_per_pixel(&self) -> u32 {
        self.code >> 16 & 0xff
    }

    /// Bytes of so many pixels.
    pub fn bytes(&self, pixels: usize) -> usize {
        (pixels * self.bits_per_pixel() as usize).div_ceil(8)
    }

    /// The bytes of counts of `depth` bits: lower bits are dropped where the format has fewer,
    /// and counts stay as they are where it has more.
    pub fn encode(&self, counts: &[u16], depth: u32) -> Vec<u8> {
        let shift = depth.saturating_sub(self.bits);
        let counts = counts.iter().map(|count| count >> shift);
        match self.layout {
            Layout::Byte => counts.map(|count| count as u8).collect(),
            Layout::Word => counts.flat_map(u16::to_le_bytes).collect(),
            Layout::Stream => {
                let mut bytes = Vec::new();
                let (mut held, mut filled) = (0_u32, 0);
                for count in counts {
                    held |= u32::from(count) << filled;
                    filled += self.bits;
                    while filled >= 8 {
                        bytes.push(held as u8);
                        held >>= 8;
                        filled -= 8;
                    }
                }
                if filled > 0 {
                    bytes.push(held as u8);
                }
                bytes
            }
            Layout::Packed => {
                let counts: Vec<u16> = counts.collect();
                let low = self.bits - 8;
                let mask = (1 << low) - 1;
                let pairs = counts.chunks(2).flat_map(|pair| {
                    let second = pair.get(1).copied();
                    let middle = pair[0] & mask | (second.unwrap_or(0) & mask) << 4;
                    let last = second.map(|count| (count >> low) as u8);
                    [(pair[0] >> low) as u8, middle as u8]
                        .into_iter()
                        .chain(last)
                });
                pairs.collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_stand_where_the_standards_have_them() {
        let of = |name: &str| {
            FORMATS
                .into_iter()
                .find(|format| format.name == name)
                .unwrap()
        };
        let counts = [0xabc, 0x123];
        for (name, bytes) in [
            ("Mono8", vec![0xab, 0x12]),
            ("Mono10", vec![0xaf, 0x02, 0x48, 0x00]),
            ("Mono10p", vec![0xaf, 0x22, 0x01]),
            ("Mono12", vec![0xbc, 0x0a, 0x23, 0x01]),
            ("Mono12Packed", vec![0xab, 0x3c, 0x12]),
            ("Mono12p", vec![0xbc, 0x3a, 0x12]),
            ("Mono16", vec![0xbc, 0x0a, 0x23, 0x01]),
        ] {
            assert_eq!(of(name).encode(&counts, 12), bytes, "{name}");
            assert_eq!(of(name).bytes(2), bytes.len(), "{name}");
        }
        for format in FORMATS {
            let odd = format.encode(&[1, 2, 3], 12);
            assert_eq!(odd.len(), format.bytes(3), "{}", format.name);
            assert_eq!(of_code(format.code), Some(format));
        }
    }
}
