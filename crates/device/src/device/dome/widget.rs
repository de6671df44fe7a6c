//! Messages of a DMX512 interface that is framed like Enttec's DMX USB Pro
//! (`dmx_usb_pro_api_spec.pdf`): 0x7e, label, length (two bytes, low first),
//! data, 0xe7. Pure functions.

/// Starts a message.
pub(super) const START: u8 = 0x7e;
/// Ends a message.
/// The last byte of every message.
pub const END: u8 = 0xe7;
/// Longest data of a message: 512 slots, the start code and some.
const LONGEST_DATA: usize = 600;
/// Slots of a DMX512 universe.
pub const SLOTS: usize = 512;

/// What a message is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Label {
    /// The interface's parameters; its firmware version is the first two bytes.
    Parameters = 3,
    /// A DMX512 packet, sent again and again until the next.
    SendPacket = 6,
    /// The interface's serial number: four bytes, two decimal digits each.
    SerialNumber = 10,
}

/// A message to the interface.
pub fn message(label: Label, data: &[u8]) -> Vec<u8> {
    let mut message = vec![START, label as u8];
    message.extend((data.len() as u16).to_le_bytes());
    message.extend(data);
    message.push(END);
    message
}

/// A packet of all slots: the start code 0, then their levels.
pub fn packet(levels: &[u8; SLOTS]) -> Vec<u8> {
    let mut data = vec![0];
    data.extend(levels);
    message(Label::SendPacket, &data)
}

/// Takes the first whole message off the front of what was received, as its
/// label and data; bytes before it that belong to none are dropped.
pub fn take_message(received: &mut Vec<u8>) -> Option<(u8, Vec<u8>)> {
    loop {
        let start = received.iter().position(|&byte| byte == START);
        received.drain(..start.unwrap_or(received.len()));
        let &[_, label, low, high, ref rest @ ..] = &received[..] else {
            return None;
        };
        let length = usize::from(u16::from_le_bytes([low, high]));
        let end = rest.get(length).copied();
        if length <= LONGEST_DATA && end.is_none() {
            return None; // not all there yet
        }
        if length <= LONGEST_DATA && end == Some(END) {
            let data = rest[..length].to_vec();
            received.drain(..length + 5);
            return Some((label, data));
        }
        // That byte started nothing.
        received.drain(..1);
    }
}

/// The version in the answer to [`Label::Parameters`].
pub fn version(data: &[u8]) -> Option<String> {
    let [low, high, ..] = data else { return None };
    Some(format!("{high}.{low}"))
}

/// The number in the answer to [`Label::SerialNumber`].
pub fn serial_number(data: &[u8]) -> Option<String> {
    let bytes: &[u8; 4] = data.try_into().ok()?;
    Some(
        bytes
            .iter()
            .rev()
            .map(|byte| format!("{byte:02x}"))
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn messages_have_the_published_form() {
        assert_eq!(message(Label::SerialNumber, &[]), [0x7e, 10, 0, 0, 0xe7]);
        let mut levels = [0; SLOTS];
        levels[511] = 9;
        let packet = packet(&levels);
        // 513 bytes of data: 0x0201.
        assert_eq!(packet[..6], [0x7e, 6, 0x01, 0x02, 0, 0]);
        assert_eq!(packet[516..], [9, 0xe7]);
        assert_eq!(version(&[44, 1, 9, 1, 40]), Some("1.44".to_owned()));
        assert_eq!(
            serial_number(&[0x78, 0x56, 0x34, 0x12]),
            Some("12345678".to_owned())
        );
    }

    proptest! {
        /// Whatever noise comes before, in however many pieces, the message is found.
        #[test]
        fn messages_are_found_in_noise(
            noise in proptest::collection::vec(0..0x7e_u8, 0..20),
            data in proptest::collection::vec(any::<u8>(), 0..40),
            cut in 0..60usize,
        ) {
            let mut bytes = noise;
            bytes.extend(message(Label::Parameters, &data));
            bytes.extend(message(Label::SerialNumber, &[1, 2, 3, 4]));
            let later = bytes.split_off(cut.min(bytes.len()));
            let mut received = bytes;
            let mut found = Vec::new();
            found.extend(std::iter::from_fn(|| take_message(&mut received)));
            received.extend(later);
            found.extend(std::iter::from_fn(|| take_message(&mut received)));
            prop_assert_eq!(found, vec![(3, data), (10, vec![1, 2, 3, 4])]);
            prop_assert!(received.is_empty());
        }

        #[test]
        fn any_bytes_end_without_panic(mut bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut count = 0;
            while take_message(&mut bytes).is_some() {
                count += 1;
            }
            prop_assert!(count <= 40);
        }
    }
}
