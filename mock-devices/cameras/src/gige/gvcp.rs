//! Packets of the GigE Vision control protocol (GVCP).
//!
//! After GigE Vision 2.0, sections 15 and 16: a command has a header of eight bytes (key,
//! flags, command, length of what follows, request id), an acknowledgement one with the
//! status in place of key and flags. All numbers are big-endian.

/// UDP port of a device.
pub const PORT: u16 = 3956;
/// First byte of every command.
const KEY: u8 = 0x42;
/// Most bytes of memory that one command may read or write.
pub const MEMORY_MAX: usize = 536;

const DISCOVERY: u16 = 0x0002;
const FORCE_IP: u16 = 0x0004;
const PACKET_RESEND: u16 = 0x0040;
const READ_REGISTERS: u16 = 0x0080;
const WRITE_REGISTERS: u16 = 0x0082;
const READ_MEMORY: u16 = 0x0084;
const WRITE_MEMORY: u16 = 0x0086;
const PENDING: u16 = 0x0089;

/// What a controller wants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Who is there.
    Discovery,
    /// A new address; this device keeps its own.
    ForceIp,
    /// Packets of a frame once more, by their first and last number.
    Resend {
        /// Of the frame.
        block: u16,
        /// First packet.
        first: u32,
        /// Last packet, itself included.
        last: u32,
    },
    /// Registers of four bytes, by address.
    ReadRegisters(Vec<u32>),
    /// Addresses and values.
    WriteRegisters(Vec<(u32, u32)>),
    /// Memory from an address on.
    ReadMemory {
        /// First byte.
        address: u32,
        /// How many.
        count: u16,
    },
    /// Memory from an address on.
    WriteMemory {
        /// First byte.
        address: u32,
        /// The new bytes.
        bytes: Vec<u8>,
    },
}

/// A command with what its acknowledgement needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The command.
    pub command: Command,
    /// Which the acknowledgement repeats.
    pub id: u16,
    /// Whether one is wanted.
    pub wants_reply: bool,
}

/// Status codes of an acknowledgement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Status {
    /// Done.
    Success = 0x0000,
    /// The command is unknown.
    NotImplemented = 0x8001,
    /// A value that the register cannot have.
    InvalidParameter = 0x8002,
    /// There is nothing at this address.
    InvalidAddress = 0x8003,
    /// The register cannot be written.
    WriteProtect = 0x8004,
    /// Another controller has the device, or nobody.
    AccessDenied = 0x8006,
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at + 4)?;
    Some(u32::from_be_bytes(four.try_into().ok()?))
}

fn half(bytes: &[u8], at: usize) -> Option<u16> {
    let two = bytes.get(at..at + 2)?;
    Some(u16::from_be_bytes(two.try_into().ok()?))
}

fn words(bytes: &[u8]) -> Option<Vec<u32>> {
    let is_whole = !bytes.is_empty() && bytes.len().is_multiple_of(4);
    let all = bytes.chunks_exact(4).filter_map(|four| word(four, 0));
    is_whole.then(|| all.collect())
}

impl Request {
    /// Reads a datagram. A command that is none, or unknown, is the status to answer with
    /// and its request id; `None` where the bytes are not GVCP.
    ///
    /// # Errors
    /// The status and the id to answer with.
    pub fn decode(bytes: &[u8]) -> Option<Result<Self, (Status, u16)>> {
        if bytes.first() != Some(&KEY) {
            return None;
        }
        let (code, length, id) = (half(bytes, 2)?, half(bytes, 4)?, half(bytes, 6)?);
        let payload = bytes.get(8..8 + usize::from(length))?;
        let command = match code {
            DISCOVERY => Some(Command::Discovery),
            FORCE_IP => Some(Command::ForceIp),
            PACKET_RESEND => resend(payload),
            READ_REGISTERS => words(payload).map(Command::ReadRegisters),
            WRITE_REGISTERS => words(payload).and_then(|words| {
                let pairs = words.chunks_exact(2).map(|pair| (pair[0], pair[1]));
                words
                    .len()
                    .is_multiple_of(2)
                    .then(|| Command::WriteRegisters(pairs.collect()))
            }),
            READ_MEMORY => word(payload, 0)
                .zip(half(payload, 6))
                .map(|(address, count)| Command::ReadMemory { address, count }),
            WRITE_MEMORY => word(payload, 0).map(|address| Command::WriteMemory {
                address,
                bytes: payload[4..].to_vec(),
            }),
            _ => return Some(Err((Status::NotImplemented, id))),
        };
        let wants_reply = bytes[1] & 1 == 1;
        Some(match command {
            Some(command) => Ok(Self {
                command,
                id,
                wants_reply,
            }),
            None => Err((Status::InvalidParameter, id)),
        })
    }

    /// The datagram of it.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = Vec::new();
        let code = match &self.command {
            Command::Discovery => DISCOVERY,
            Command::ForceIp => FORCE_IP,
            Command::Resend { block, first, last } => {
                payload.extend([0, 0]);
                payload.extend(block.to_be_bytes());
                payload.extend(first.to_be_bytes());
                payload.extend(last.to_be_bytes());
                PACKET_RESEND
            }
            Command::ReadRegisters(addresses) => {
                payload.extend(addresses.iter().flat_map(|a| a.to_be_bytes()));
                READ_REGISTERS
            }
            Command::WriteRegisters(pairs) => {
                for (address, value) in pairs {
                    payload.extend(address.to_be_bytes());
                    payload.extend(value.to_be_bytes());
                }
                WRITE_REGISTERS
            }
            Command::ReadMemory { address, count } => {
                payload.extend(address.to_be_bytes());
                payload.extend([0, 0]);
                payload.extend(count.to_be_bytes());
                READ_MEMORY
            }
            Command::WriteMemory { address, bytes } => {
                payload.extend(address.to_be_bytes());
                payload.extend(bytes);
                WRITE_MEMORY
            }
        };
        let mut bytes = vec![KEY, u8::from(self.wants_reply)];
        bytes.extend(code.to_be_bytes());
        bytes.extend((payload.len() as u16).to_be_bytes());
        bytes.extend(self.id.to_be_bytes());
        bytes.extend(payload);
        bytes
    }
}

fn resend(payload: &[u8]) -> Option<Command> {
    Some(Command::Resend {
        block: half(payload, 2)?,
        first: word(payload, 4)? & 0x00ff_ffff,
        last: word(payload, 8)? & 0x00ff_ffff,
    })
}

fn acknowledgement(status: Status, code: u16, id: u16, payload: &[u8]) -> Vec<u8> {
    let mut bytes = (status as u16).to_be_bytes().to_vec();
    bytes.extend(code.to_be_bytes());
    bytes.extend((payload.len() as u16).to_be_bytes());
    bytes.extend(id.to_be_bytes());
    bytes.extend(payload);
    bytes
}

/// Answer to a command that was carried out, with what it reads.
pub fn done(request: &Request, payload: &[u8]) -> Vec<u8> {
    acknowledgement(
        Status::Success,
        code_of(&request.command) + 1,
        request.id,
        payload,
    )
}

/// Answer to a command that was refused.
pub fn refused(request: &Request, status: Status) -> Vec<u8> {
    acknowledgement(status, code_of(&request.command) + 1, request.id, &[])
}

/// Answer to a command that could not be read.
pub fn unreadable(status: Status, id: u16) -> Vec<u8> {
    acknowledgement(status, 0, id, &[])
}

/// The answer takes up to so many milliseconds more.
pub fn pending(id: u16, ms: u16) -> Vec<u8> {
    let [high, low] = ms.to_be_bytes();
    acknowledgement(Status::Success, PENDING, id, &[0, 0, high, low])
}

fn code_of(command: &Command) -> u16 {
    match command {
        Command::Discovery => DISCOVERY,
        Command::ForceIp => FORCE_IP,
        Command::Resend { .. } => PACKET_RESEND,
        Command::ReadRegisters(_) => READ_REGISTERS,
        Command::WriteRegisters(_) => WRITE_REGISTERS,
        Command::ReadMemory { .. } => READ_MEMORY,
        Command::WriteMemory { .. } => WRITE_MEMORY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn commands() -> impl Strategy<Value = Command> {
        prop_oneof![
            Just(Command::Discovery),
            Just(Command::ForceIp),
            (any::<u16>(), 0_u32..1 << 24, 0_u32..1 << 24)
                .prop_map(|(block, first, last)| Command::Resend { block, first, last }),
            proptest::collection::vec(any::<u32>(), 1..9).prop_map(Command::ReadRegisters),
            proptest::collection::vec(any::<(u32, u32)>(), 1..9).prop_map(Command::WriteRegisters),
            any::<(u32, u16)>().prop_map(|(address, count)| Command::ReadMemory { address, count }),
            (
                any::<u32>(),
                proptest::collection::vec(any::<u8>(), 0..MEMORY_MAX)
            )
                .prop_map(|(address, bytes)| Command::WriteMemory { address, bytes }),
        ]
    }

    proptest! {
        #[test]
        fn commands_survive_the_wire(command in commands(), id: u16, wants_reply: bool) {
            let request = Request { command, id, wants_reply };
            prop_assert_eq!(Request::decode(&request.encode()), Some(Ok(request)));
        }

        #[test]
        fn no_datagram_panics(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let _ = Request::decode(&bytes);
        }

        #[test]
        fn a_cut_command_is_none(command in commands(), cut in 1_usize..8) {
            let bytes = Request { command, id: 7, wants_reply: true }.encode();
            prop_assert_eq!(Request::decode(&bytes[..bytes.len() - cut.min(bytes.len())]), None);
        }
    }

    #[test]
    fn the_bytes_are_those_of_the_standard() {
        let read = Request {
            command: Command::ReadRegisters(vec![0x0a00]),
            id: 0x1234,
            wants_reply: true,
        };
        let sent = [0x42, 1, 0, 0x80, 0, 4, 0x12, 0x34, 0, 0, 0x0a, 0];
        assert_eq!(read.encode(), sent);
        let answer = [0, 0, 0, 0x81, 0, 4, 0x12, 0x34, 0, 0, 0, 2];
        assert_eq!(done(&read, &[0, 0, 0, 2]), answer);
        let denied = [0x80, 0x06, 0, 0x81, 0, 0, 0x12, 0x34];
        assert_eq!(refused(&read, Status::AccessDenied), denied);
        assert_eq!(pending(1, 500)[2..4], [0, 0x89]);
        let unknown = [0x42, 1, 0, 0x99, 0, 0, 0, 5];
        let refusal = Some(Err((Status::NotImplemented, 5)));
        assert_eq!(Request::decode(&unknown), refusal);
    }
}
