//! The packets of PTP over TCP/IP (CIPA DC-005): a length, a kind, and a body, all little
//! endian.

use std::io::{Error, ErrorKind, Read};

/// Bytes of length and kind together.
const HEADER: usize = 8;
/// A longer packet is refused before memory is taken, bytes.
pub const LONGEST: usize = 1 << 26;

/// A packet of the command or the event connection.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Packet {
    /// The client opens the command connection.
    InitCommandRequest {
        /// Who the client is.
        guid: [u8; 16],
        name: String,
        /// Of the protocol; 1.0 is 0x10000.
        version: u32,
    },
    /// The body accepts it.
    InitCommandAck {
        /// Number by which the event connection names this one.
        connection: u32,
        /// Who the body is.
        guid: [u8; 16],
        name: String,
        /// Of the protocol.
        version: u32,
    },
    /// The client opens the event connection.
    InitEventRequest {
        /// Number of the command connection.
        connection: u32,
    },
    /// The body accepts it.
    InitEventAck,
    /// The body refuses a connection.
    InitFail {
        /// 1 refused, 2 busy, 3 unspecified.
        reason: u32,
    },
    /// An operation.
    Request {
        /// 1: no data or data from the body; 2: data from the client.
        data_phase: u32,
        code: u16,
        transaction: u32,
        /// At most five.
        parameters: Vec<u32>,
    },
    /// How an operation ended.
    Response {
        /// 0x2001: well.
        code: u16,
        transaction: u32,
        /// At most five.
        parameters: Vec<u32>,
    },
    /// Something happened.
    Event {
        code: u16,
        /// The operation that it belongs to.
        transaction: u32,
        /// At most three.
        parameters: Vec<u32>,
    },
    /// Data of this many bytes follow.
    StartData {
        transaction: u32,
        /// Bytes of all data packets together.
        length: u64,
    },
    /// A part of the data.
    Data {
        transaction: u32,
        /// The bytes.
        payload: Vec<u8>,
    },
    /// The operation is given up.
    Cancel { transaction: u32 },
    /// The last part of the data.
    EndData {
        transaction: u32,
        /// The bytes.
        payload: Vec<u8>,
    },
    /// Is the other end there?
    Ping,
    /// It is.
    Pong,
}

impl Packet {
    /// As it is sent.
    pub fn encode(&self) -> Vec<u8> {
        let mut body = Vec::new();
        let kind: u32 = match self {
            Self::InitCommandRequest {
                guid,
                name,
                version,
            } => {
                body.extend(guid);
                put_name(&mut body, name);
                body.extend(version.to_le_bytes());
                1
            }
            Self::InitCommandAck {
                connection,
                guid,
                name,
                version,
            } => {
                body.extend(connection.to_le_bytes());
                body.extend(guid);
                put_name(&mut body, name);
                body.extend(version.to_le_bytes());
                2
            }
            Self::InitEventRequest { connection } => {
                body.extend(connection.to_le_bytes());
                3
            }
            Self::InitEventAck => 4,
            Self::InitFail { reason } => {
                body.extend(reason.to_le_bytes());
                5
            }
            Self::Request {
                data_phase,
                code,
                transaction,
                parameters,
            } => {
                body.extend(data_phase.to_le_bytes());
                put_operation(&mut body, *code, *transaction, parameters);
                6
            }
            Self::Response {
                code,
                transaction,
                parameters,
            } => {
                put_operation(&mut body, *code, *transaction, parameters);
                7
            }
            Self::Event {
                code,
                transaction,
                parameters,
            } => {
                put_operation(&mut body, *code, *transaction, parameters);
                8
            }
            Self::StartData {
                transaction,
                length,
            } => {
                body.extend(transaction.to_le_bytes());
                body.extend(length.to_le_bytes());
                9
            }
            Self::Data {
                transaction,
                payload,
            } => {
                body.extend(transaction.to_le_bytes());
                body.extend(payload);
                10
            }
            Self::Cancel { transaction } => {
                body.extend(transaction.to_le_bytes());
                11
            }
            Self::EndData {
                transaction,
                payload,
            } => {
                body.extend(transaction.to_le_bytes());
                body.extend(payload);
                12
            }
            Self::Ping => 13,
            Self::Pong => 14,
        };
        let length = (body.len() + HEADER) as u32;
        let mut bytes = length.to_le_bytes().to_vec();
        bytes.extend(kind.to_le_bytes());
        bytes.extend(body);
        bytes
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
        let mut body = vec![0; length - HEADER];
        from.read_exact(&mut body)?;
        Self::decode(kind, &body)
    }

    fn decode(kind: u32, body: &[u8]) -> Result<Self, Error> {
        let mut fields = Fields(body);
        let packet = match kind {
            1 => Self::InitCommandRequest {
                guid: fields.array()?,
                name: fields.name()?,
                version: fields.u32()?,
            },
            2 => Self::InitCommandAck {
                connection: fields.u32()?,
                guid: fields.array()?,
                name: fields.name()?,
                version: fields.u32()?,
            },
            3 => Self::InitEventRequest {
                connection: fields.u32()?,
            },
            4 => Self::InitEventAck,
            5 => Self::InitFail {
                reason: fields.u32()?,
            },
            6 => Self::Request {
                data_phase: fields.u32()?,
                code: fields.u16()?,
                transaction: fields.u32()?,
                parameters: fields.parameters(5)?,
            },
            7 => Self::Response {
                code: fields.u16()?,
                transaction: fields.u32()?,
                parameters: fields.parameters(5)?,
            },
            8 => Self::Event {
                code: fields.u16()?,
                transaction: fields.u32()?,
                parameters: fields.parameters(3)?,
            },
            9 => Self::StartData {
                transaction: fields.u32()?,
                length: u64::from_le_bytes(fields.array()?),
            },
            10 => Self::Data {
                transaction: fields.u32()?,
                payload: fields.rest(),
            },
            11 => Self::Cancel {
                transaction: fields.u32()?,
            },
            12 => Self::EndData {
                transaction: fields.u32()?,
                payload: fields.rest(),
            },
            13 => Self::Ping,
            14 => Self::Pong,
            _ => return Err(invalid("kind")),
        };
        match fields.0 {
            [] => Ok(packet),
            _ => Err(invalid("end")),
        }
    }
}

fn invalid(what: &str) -> Error {
    Error::new(
        ErrorKind::InvalidData,
        format!("a packet whose {what} is wrong"),
    )
}

fn put_name(body: &mut Vec<u8>, name: &str) {
    let units = name.encode_utf16().chain([0]);
    body.extend(units.flat_map(u16::to_le_bytes));
}

fn put_operation(body: &mut Vec<u8>, code: u16, transaction: u32, parameters: &[u32]) {
    body.extend(code.to_le_bytes());
    body.extend(transaction.to_le_bytes());
    body.extend(parameters.iter().flat_map(|value| value.to_le_bytes()));
}

/// What of a body has not been read.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let (first, rest) = self.0.split_first_chunk().ok_or_else(|| invalid("end"))?;
        self.0 = rest;
        Ok(*first)
    }

    fn u16(&mut self) -> Result<u16, Error> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, Error> {
        self.array().map(u32::from_le_bytes)
    }

    /// UTF-16 up to a zero.
    fn name(&mut self) -> Result<String, Error> {
        let mut units = Vec::new();
        loop {
            match self.u16()? {
                0 => break,
                unit => units.push(unit),
            }
        }
        String::from_utf16(&units).map_err(|_| invalid("name"))
    }

    fn parameters(&mut self, most: usize) -> Result<Vec<u32>, Error> {
        let mut values = Vec::new();
        while !self.0.is_empty() && values.len() < most {
            values.push(self.u32()?);
        }
        Ok(values)
    }

    fn rest(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0).to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_packet() -> impl Strategy<Value = Packet> {
        let name = "[a-zA-Z0-9 äλ😀]{0,20}";
        let parameters = |most| proptest::collection::vec(any::<u32>(), 0..=most);
        let bytes = || proptest::collection::vec(any::<u8>(), 0..300);
        prop_oneof![
            (any::<[u8; 16]>(), name, any::<u32>()).prop_map(|(guid, name, version)| {
                Packet::InitCommandRequest {
                    guid,
                    name,
                    version,
                }
            }),
            (any::<u32>(), any::<[u8; 16]>(), name, any::<u32>()).prop_map(
                |(connection, guid, name, version)| Packet::InitCommandAck {
                    connection,
                    guid,
                    name,
                    version
                }
            ),
            any::<u32>().prop_map(|connection| Packet::InitEventRequest { connection }),
            any::<u32>().prop_map(|reason| Packet::InitFail { reason }),
            (any::<u32>(), any::<u16>(), any::<u32>(), parameters(5)).prop_map(
                |(data_phase, code, transaction, parameters)| Packet::Request {
                    data_phase,
                    code,
                    transaction,
                    parameters
                }
            ),
            (any::<u16>(), any::<u32>(), parameters(5)).prop_map(
                |(code, transaction, parameters)| Packet::Response {
                    code,
                    transaction,
                    parameters
                }
            ),
            (any::<u16>(), any::<u32>(), parameters(3)).prop_map(
                |(code, transaction, parameters)| Packet::Event {
                    code,
                    transaction,
                    parameters
                }
            ),
            (any::<u32>(), any::<u64>()).prop_map(|(transaction, length)| Packet::StartData {
                transaction,
                length
            }),
            (any::<u32>(), bytes()).prop_map(|(transaction, payload)| Packet::Data {
                transaction,
                payload
            }),
            (any::<u32>(), bytes()).prop_map(|(transaction, payload)| Packet::EndData {
                transaction,
                payload
            }),
            any::<u32>().prop_map(|transaction| Packet::Cancel { transaction }),
            Just(Packet::InitEventAck),
            Just(Packet::Ping),
            Just(Packet::Pong),
        ]
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_read(packets in proptest::collection::vec(any_packet(), 1..5)) {
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
        fn any_bytes_are_a_packet_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            if let Ok(packet) = Packet::read(&mut bytes.as_slice()) {
                let again = packet.encode();
                prop_assert_eq!(Packet::read(&mut again.as_slice()).unwrap(), packet);
            }
        }
    }

    #[test]
    fn a_length_beyond_all_measure_takes_no_memory() {
        let mut bytes = u32::MAX.to_le_bytes().to_vec();
        bytes.extend(10_u32.to_le_bytes());
        let error = Packet::read(&mut bytes.as_slice()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidData);
    }
}
