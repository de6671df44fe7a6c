//! Standard requests and the descriptors that answer them (USB 2.0, §9.4 to 9.6).

use super::{Descriptors, Setup, Stall};

const GET_STATUS: u8 = 0;
const GET_DESCRIPTOR: u8 = 6;
const GET_CONFIGURATION: u8 = 8;
const GET_INTERFACE: u8 = 10;

/// What a device's driver is chosen by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Identity {
    /// Class, subclass and protocol.
    pub class: [u8; 3],
    pub vendor: u16,
    pub product: u16,
    /// The device's release, in binary-coded decimals.
    pub release: u16,
}

impl Identity {
    /// A device whose interfaces say what they are, under the kernel's own vendor
    /// number, for test gadgets.
    pub(super) fn gadget(product: u16) -> Self {
        Self {
            class: [0xef, 2, 1],
            vendor: 0x1d6b,
            product,
            release: 0x0100,
        }
    }
}

impl Descriptors {
    /// From the interfaces' descriptors; strings are maker, product and serial
    /// number.
    pub(super) fn new(identity: Identity, strings: [&str; 3], interfaces: &[Vec<u8>]) -> Self {
        let mut device = vec![18, 1, 0, 2];
        device.extend(identity.class);
        device.push(64);
        for word in [identity.vendor, identity.product, identity.release] {
            device.extend(u16::to_le_bytes(word));
        }
        device.extend([1, 2, 3, 1]);
        let body: Vec<u8> = interfaces.concat();
        let mut configuration = vec![9, 2];
        configuration.extend((9 + body.len() as u16).to_le_bytes());
        configuration.extend([2, 1, 0, 0x80, 250]);
        configuration.extend(body);
        Self {
            device,
            configuration,
            strings: strings.map(str::to_owned),
        }
    }

    /// Answers a standard request.
    pub(super) fn answer(&self, setup: Setup) -> Result<Vec<u8>, Stall> {
        let to_host = setup.request_type & 0x80 != 0;
        match (setup.request, to_host) {
            (GET_STATUS, true) => Ok(vec![0, 0]),
            (GET_DESCRIPTOR, true) => self.descriptor(setup.value),
            (GET_CONFIGURATION, true) => Ok(vec![1]),
            (GET_INTERFACE, true) => Ok(vec![0]),
            (_, true) => Err(Stall),
            // Address, configuration, interface: there is one of each.
            (_, false) => Ok(Vec::new()),
        }
    }

    fn descriptor(&self, value: u16) -> Result<Vec<u8>, Stall> {
        let [index, kind] = value.to_le_bytes();
        match (kind, index) {
            (1, _) => Ok(self.device.clone()),
            (2, _) => Ok(self.configuration.clone()),
            (3, 0) => Ok(vec![4, 3, 0x09, 0x04]),
            (3, index) => {
                let text = self.strings.get(usize::from(index) - 1).ok_or(Stall)?;
                let letters: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
                Ok([&[2 + letters.len() as u8, 3], &letters[..]].concat())
            }
            _ => Err(Stall),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptors_state_their_own_lengths() {
        let descriptors = Descriptors::new(
            Identity::gadget(1),
            ["maker", "product", "S1"],
            &[vec![3, 0x24, 0]],
        );
        let ask = |value| {
            descriptors.answer(Setup {
                request_type: 0x80,
                request: GET_DESCRIPTOR,
                value,
                index: 0,
                length: 255,
            })
        };
        assert_eq!(ask(0x0100).unwrap().len(), 18);
        let configuration = ask(0x0200).unwrap();
        assert_eq!(configuration[2..4], [12, 0]);
        assert_eq!(configuration.len(), 12);
        assert_eq!(ask(0x0303).unwrap(), [6, 3, b'S', 0, b'1', 0]);
        assert_eq!(ask(0x0304), Err(Stall));
        assert_eq!(ask(0x0600), Err(Stall));
    }
}
