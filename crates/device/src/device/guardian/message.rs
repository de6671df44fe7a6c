//! What a program says to its guardian: nine bytes each, so that a message is
//! there as a whole or not at all. Times are of the clock that both share.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Bytes of a message.
pub(super) const LENGTH: usize = 9;
/// What the guardian answers to [`Message::Ping`].
pub(super) const PONG: u8 = b'!';

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Message {
    /// The next sign of life comes before this time.
    Until(Duration),
    /// The lamp is off and the stage stands: nothing need be said any more.
    Rest,
    /// Is anybody there?
    Ping,
    /// Something may have been sent to the stage after the guardian acted.
    Again,
    /// The stage is safe and the program ends.
    Dismissed,
}

impl Message {
    pub(super) fn to_bytes(self) -> [u8; LENGTH] {
        let (tag, time) = match self {
            Self::Until(time) => (b'u', time),
            Self::Rest => (b'r', Duration::ZERO),
            Self::Ping => (b'?', Duration::ZERO),
            Self::Again => (b'a', Duration::ZERO),
            Self::Dismissed => (b'.', Duration::ZERO),
        };
        let mut bytes = [tag; LENGTH];
        let nanoseconds = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        bytes[1..].copy_from_slice(&nanoseconds.to_le_bytes());
        bytes
    }

    pub(super) fn from_bytes(bytes: [u8; LENGTH]) -> Option<Self> {
        let [tag, time @ ..] = bytes;
        match tag {
            b'u' => Some(Self::Until(Duration::from_nanos(u64::from_le_bytes(time)))),
            b'r' => Some(Self::Rest),
            b'?' => Some(Self::Ping),
            b'a' => Some(Self::Again),
            b'.' => Some(Self::Dismissed),
            _ => None,
        }
    }
}

/// Time since some moment before both processes began.
pub(super) fn now() -> Duration {
    let time = clock_gettime(ClockId::Monotonic);
    Duration::new(
        u64::try_from(time.tv_sec).unwrap_or(0),
        u32::try_from(time.tv_nsec).unwrap_or(0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_survive_the_socket() {
        for message in [
            Message::Until(Duration::from_nanos(1 << 40)),
            Message::Rest,
            Message::Ping,
            Message::Again,
            Message::Dismissed,
        ] {
            assert_eq!(Message::from_bytes(message.to_bytes()), Some(message));
        }
        assert_eq!(Message::from_bytes([0; LENGTH]), None);
    }
}
