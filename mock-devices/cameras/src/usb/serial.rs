//! A serial port of the Communications Device Class (CDC 1.2, PSTN subclass,
//! abstract control model), which leads to simulated firmware on a
//! pseudo-terminal.

use std::path::PathBuf;

use super::descriptors::Identity;
use super::firmware_port::FirmwarePort;
use super::{Descriptors, Setup, Stall, UsbDevice};

const SET_LINE_CODING: u8 = 0x20;
const GET_LINE_CODING: u8 = 0x21;
const SET_CONTROL_LINE_STATE: u8 = 0x22;
const DTR: u16 = 1;
const DATA_IN: u8 = 0x81;
const DATA_OUT: u8 = 0x01;
const NOTIFY_IN: u8 = 0x82;

/// The port.
#[derive(Debug)]
pub struct UsbSerial {
    descriptors: Descriptors,
    firmware: FirmwarePort,
    /// Rate (bit/s, little-endian), stop bits, parity, data bits.
    line_coding: [u8; 7],
}

impl UsbSerial {
    /// A port with this serial number that leads to the firmware at `firmware`.
    pub fn new(serial: &str, firmware: PathBuf) -> Self {
        let control = vec![
            8, 11, 0, 2, 2, 2, 1, 0, // both interfaces are one function
            9, 4, 0, 0, 1, 2, 2, 1, 0, // communications, abstract control
            5, 0x24, 0, 0x10, 0x01, // class version 1.1
            5, 0x24, 1, 0, 1, // no call management
            4, 0x24, 2, 2, // line coding and state
            5, 0x24, 6, 0, 1, // interface 1 carries the data
            7, 5, NOTIFY_IN, 3, 8, 0, 10,
        ];
        let data = vec![
            9, 4, 1, 0, 2, 0x0a, 0, 0, 0, //
            7, 5, DATA_IN, 2, 0, 2, 0, //
            7, 5, DATA_OUT, 2, 0, 2, 0,
        ];
        let strings = ["mock-devices", "Simulated serial port", serial];
        Self {
            descriptors: Descriptors::new(Identity::gadget(0x0e02), strings, &[control, data]),
            firmware: FirmwarePort::new(firmware),
            line_coding: [0, 0xc2, 1, 0, 0, 0, 8],
        }
    }
}

impl UsbDevice for UsbSerial {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        match setup.request {
            SET_LINE_CODING => {
                self.line_coding = data.try_into().map_err(|_| Stall)?;
                Ok(Vec::new())
            }
            GET_LINE_CODING => Ok(self.line_coding.to_vec()),
            SET_CONTROL_LINE_STATE => {
                self.firmware.set_dtr(setup.value & DTR != 0);
                Ok(Vec::new())
            }
            _ => Err(Stall),
        }
    }

    fn take(&mut self, _: u8, data: &[u8]) {
        self.firmware.write(data);
    }

    fn give(&mut self, endpoint: u8, most: usize) -> Option<Vec<u8>> {
        if endpoint | 0x80 != DATA_IN {
            return None;
        }
        self.firmware.read(most.min(512))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mock_devices::bench::{Bench, BenchConfig};
    use mock_devices::clock::Clock;
    use mock_devices::grbl::{GrblConfig, GrblSimulator};

    #[test]
    fn the_firmware_is_reached_while_dtr_is_up() {
        let bench = Bench::new(BenchConfig::default(), Clock::real_time());
        let config = GrblConfig {
            reset_on_open: false,
            ..GrblConfig::default()
        };
        let firmware = GrblSimulator::spawn(config, bench).unwrap();
        let mut serial = UsbSerial::new("S1", firmware.path().to_owned());
        let line_state = |serial: &mut UsbSerial, value| {
            let setup = Setup {
                request_type: 0x21,
                request: SET_CONTROL_LINE_STATE,
                value,
                index: 0,
                length: 0,
            };
            serial.control(setup, &[]).unwrap();
        };
        serial.take(1, b"?");
        assert_eq!(serial.give(1, 64), None);
        line_state(&mut serial, 3);
        let mut heard = Vec::new();
        for _ in 0..400 {
            serial.take(1, b"?");
            std::thread::sleep(std::time::Duration::from_millis(10));
            heard.extend(serial.give(1, 512).unwrap_or_default());
            if heard.contains(&b'>') {
                break;
            }
        }
        assert!(heard.starts_with(b"<"), "{}", heard.escape_ascii());
        // Notifications come from another endpoint, which has none.
        assert_eq!(serial.give(2, 64), None);
        line_state(&mut serial, 0);
        assert_eq!(serial.give(1, 64), None);
    }
}
