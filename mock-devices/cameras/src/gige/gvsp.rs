//! Packets of the GigE Vision stream protocol (GVSP): a leader, the image, a trailer.
//!
//! After GigE Vision 2.0, section 24, with the header of eight bytes: status, number of the
//! frame (1 to 65 535, 0 being none), format of the packet and its number within the frame.

/// Bytes of the headers of IP, UDP and GVSP, which a packet's size includes.
const HEADERS: usize = 20 + 8 + 8;

/// An image as it goes on the wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Number of the frame.
    pub block: u16,
    /// Start of the exposure, in the device's ticks.
    pub timestamp: u64,
    /// Number of the pixel format.
    pub pixel_format: u32,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// The image.
    pub bytes: Vec<u8>,
}

fn packet(block: u16, format: u8, number: u32, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0, 0];
    bytes.extend(block.to_be_bytes());
    bytes.extend((u32::from(format) << 24 | number & 0x00ff_ffff).to_be_bytes());
    bytes.extend(payload);
    bytes
}

impl Image {
    /// The datagrams of it, none larger than `packet_bytes` with its headers of IP and UDP.
    pub fn packets(&self, packet_bytes: usize) -> Vec<Vec<u8>> {
        // Payload type 1 is an image.
        let mut leader = vec![0, 0, 0, 1];
        leader.extend(self.timestamp.to_be_bytes());
        let [width, height] = self.size_px;
        for value in [self.pixel_format, width, height, 0, 0, 0] {
            leader.extend(value.to_be_bytes());
        }
        let mut trailer = vec![0, 0, 0, 1];
        trailer.extend(height.to_be_bytes());
        let most = packet_bytes.saturating_sub(HEADERS).max(1);
        let parts = self.bytes.chunks(most);
        let last = parts.len() as u32 + 1;
        let mut packets = vec![packet(self.block, 1, 0, &leader)];
        packets.extend(
            (1..)
                .zip(parts)
                .map(|(n, part)| packet(self.block, 3, n, part)),
        );
        packets.push(packet(self.block, 2, last, &trailer));
        packets
    }
}

/// A packet of `packet_bytes` by which the controller finds out how large packets may be.
pub fn test_packet(packet_bytes: usize) -> Vec<u8> {
    vec![0; packet_bytes.saturating_sub(20 + 8)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_parts_are_the_image(
            bytes in proptest::collection::vec(any::<u8>(), 1..5000),
            packet_bytes in 37_usize..2000,
        ) {
            let image = Image {
                block: 513,
                timestamp: 0x0102_0304_0506_0708,
                pixel_format: 0x0108_0001,
                size_px: [3, 7],
                bytes,
            };
            let packets = image.packets(packet_bytes);
            let (leader, rest) = packets.split_first().unwrap();
            let (trailer, parts) = rest.split_last().unwrap();
            for (number, part) in (0..).zip(&packets) {
                prop_assert_eq!(&part[..4], &[0, 0, 2, 1]);
                prop_assert_eq!(&part[5..8], &u32::to_be_bytes(number)[1..]);
                prop_assert!(number == 0 || part.len() + 28 <= packet_bytes.max(52));
            }
            prop_assert_eq!((leader[4], trailer[4], leader.len()), (1, 2, 8 + 36));
            prop_assert_eq!(&leader[12..20], &[1, 2, 3, 4, 5, 6, 7, 8]);
            prop_assert_eq!(&leader[20..32], &[1, 8, 0, 1, 0, 0, 0, 3, 0, 0, 0, 7]);
            let joined: Vec<u8> = parts.iter().flat_map(|part| part[8..].to_vec()).collect();
            prop_assert_eq!(joined, image.bytes);
        }
    }
}
