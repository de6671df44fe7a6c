//! The packets of PTP over TCP/IP (CIPA DC-005): a length, a kind, and a body, all little
//! endian.

use std::io::{Error, ErrorKind, Read};

use super::dataset::Dataset;

/// Bytes of length and kind together.
const HEADER: usize = 8;
/// A longer packet is refused before memory is taken, bytes.
pub const LONGEST: usize = 1 << 26;

/// Kinds of packets and what is in their bodies.
#[allow(missing_docs)]
pub mod kind {
    /// The client opens the command connection: its GUID, name, version of the protocol.
    pub const INIT_COMMAND_REQUEST: u32 = 1;
    /// Number of the connection, the body's GUID, name, version of the protocol.
    pub const INIT_COMMAND_ACK: u32 = 2;
    /// The client opens the event connection: number of the command connection.
    pub const INIT_EVENT_REQUEST: u32 = 3;
    pub const INIT_EVENT_ACK: u32 = 4;
    /// 1 refused, 2 busy, 3 unspecified.
    pub const INIT_FAIL: u32 = 5;
    /// An operation: 2 with data from the client, else 1; code, transaction, up to five
    /// parameters.
    pub const REQUEST: u32 = 6;
    /// How an operation ended: code, transaction, up to five parameters.
    pub const RESPONSE: u32 = 7;
    /// Code, transaction, up to three parameters.
    pub const EVENT: u32 = 8;
    /// Transaction, bytes of all data packets together.
    pub const START_DATA: u32 = 9;
    /// Transaction, a part of the data.
    pub const DATA: u32 = 10;
    /// Transaction, the last part of the data.
    pub const END_DATA: u32 = 12;
    /// Is the other end there?
    pub const PING: u32 = 13;
    pub const PONG: u32 = 14;
}

/// A packet of the command or the event connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// One of [`kind`], or 11, with which a client gives an operation up.
    pub kind: u32,
    /// As its kind has it.
    pub body: Vec<u8>,
}

impl Packet {
    /// Of this kind and body.
    pub fn new(kind: u32, body: Dataset) -> Self {
        let Dataset(body) = body;
        Self { kind, body }
    }

    /// As it is sent.
    pub fn encode(&self) -> Vec<u8> {
        let length = (HEADER + self.body.len()) as u32;
        let header = Dataset::default().u32(length).u32(self.kind);
        [header.0, self.body.clone()].concat()
    }

    /// The next packet of a connection.
    ///
    /// # Errors
    /// The connection's own, `UnexpectedEof` at its end, and `InvalidData` for bytes that
    /// are no packet.
    pub fn read(from: &mut impl Read) -> Result<Self, Error> {
        let mut header = [0; HEADER];
        from.read_exact(&mut header)?;
        let mut fields = Fields(&header);
        let (length, kind) = (fields.u32()? as usize, fields.u32()?);
        if !(HEADER..=LONGEST).contains(&length) {
            return Err(invalid("length"));
        }
        if !(kind::INIT_COMMAND_REQUEST..=kind::PONG).contains(&kind) {
            return Err(invalid("kind"));
        }
        let mut body = vec![0; length - HEADER];
        from.read_exact(&mut body)?;
        Ok(Self { kind, body })
    }

    /// What is in its body.
    pub fn fields(&self) -> Fields<'_> {
        Fields(&self.body)
    }
}

fn invalid(what: &str) -> Error {
    let fact = format!("a packet whose {what} is wrong");
    Error::new(ErrorKind::InvalidData, fact)
}

/// What of a body has not been read. Each field is an error where the body has ended.
#[allow(missing_docs)]
pub struct Fields<'a>(&'a [u8]);

#[allow(missing_docs)]
impl<'a> Fields<'a> {
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let (first, rest) = self.0.split_first_chunk().ok_or_else(|| invalid("end"))?;
        self.0 = rest;
        Ok(*first)
    }

    pub fn u16(&mut self) -> Result<u16, Error> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Result<u32, Error> {
        self.array().map(u32::from_le_bytes)
    }

    /// Up to five numbers, to the end of the body.
    pub fn parameters(mut self) -> Result<Vec<u32>, Error> {
        if self.0.len() > 20 {
            return Err(invalid("end"));
        }
        let mut values = Vec::new();
        while !self.0.is_empty() {
            values.push(self.u32()?);
        }
        Ok(values)
    }

    pub fn rest(self) -> &'a [u8] {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;

    fn any_packet() -> impl Strategy<Value = Packet> {
        (1_u32..=14, vec(any::<u8>(), 0..300)).prop_map(|(kind, body)| Packet { kind, body })
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_read(packets in vec(any_packet(), 1..5)) {
            let bytes: Vec<u8> = packets.iter().flat_map(Packet::encode).collect();
            let mut stream = bytes.as_slice();
            for packet in packets {
                prop_assert_eq!(Packet::read(&mut stream).unwrap(), packet);
            }
            prop_assert!(stream.is_empty());
        }

        #[test]
        fn a_packet_that_is_cut_is_an_error(packet in any_packet(), part in 0.0..1.0_f64) {
            let bytes = packet.encode();
            let cut = (part * bytes.len() as f64) as usize;
            prop_assert!(Packet::read(&mut &bytes[..cut]).is_err());
        }

        #[test]
        fn any_bytes_are_a_packet_or_an_error(bytes in vec(any::<u8>(), 0..400)) {
            if let Ok(packet) = Packet::read(&mut bytes.as_slice()) {
                prop_assert!(bytes.starts_with(&packet.encode()));
            }
        }

        #[test]
        fn parameters_are_whole_and_at_most_five(values in vec(any::<u32>(), 0..8), cut in 0_usize..4) {
            let data = values.iter().fold(Dataset::default(), |data, value| data.u32(*value));
            let kept = data.0.len() - cut.min(data.0.len());
            let read = Fields(&data.0[..kept]).parameters();
            prop_assert_eq!(read.is_ok(), kept % 4 == 0 && kept <= 20);
        }
    }

    #[test]
    fn a_length_beyond_all_measure_takes_no_memory() {
        let bytes = Dataset::default().u32(u32::MAX).u32(kind::DATA).0;
        let error = Packet::read(&mut bytes.as_slice()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidData);
    }
}
