//! A serial port of FTDI's own class of devices, an FT232H as `ftdi_sio` knows
//! it, which leads to simulated firmware on a pseudo-terminal.
//!
//! After FTDI's data sheet of the FT232H and the requests listed in the header of
//! the Linux driver: every packet to the host begins with two bytes of status.

use std::path::PathBuf;

use super::descriptors::Identity;
use super::firmware_port::FirmwarePort;
use super::{Descriptors, Setup, Stall, UsbDevice};

const IDENTITY: Identity = Identity {
    class: [0, 0, 0],
    vendor: 0x0403,
    product: 0x6014,
    release: 0x0900,
};

const RESET: u8 = 0;
const SET_MODEM_CONTROL: u8 = 1;
const SET_FLOW_CONTROL: u8 = 2;
const SET_BAUD_RATE: u8 = 3;
const SET_DATA: u8 = 4;
const GET_MODEM_STATUS: u8 = 5;
const SET_EVENT_CHARACTER: u8 = 6;
const SET_ERROR_CHARACTER: u8 = 7;
const SET_LATENCY: u8 = 9;
const GET_LATENCY: u8 = 10;

/// DTR, and that this request is about it.
const DTR: u16 = 1;
const DTR_IS_SET: u16 = 0x100;

/// CTS, DSR and carrier are there; the transmitter is empty.
const STATUS: [u8; 2] = [0xb1, 0x60];
const PACKET: usize = 512;
const DATA_IN: u8 = 0x81;
const DATA_OUT: u8 = 0x02;

/// The port.
#[derive(Debug)]
pub struct UsbFtdi {
    descriptors: Descriptors,
    firmware: FirmwarePort,
    latency_ms: u8,
}

impl UsbFtdi {
    /// A port with this serial number that leads to the firmware at `firmware`.
    pub fn new(serial: &str, firmware: PathBuf) -> Self {
        let interface = vec![
            9, 4, 0, 0, 2, 0xff, 0xff, 0xff, 0, // of the vendor's own class
            7, 5, DATA_IN, 2, 0, 2, 0, //
            7, 5, DATA_OUT, 2, 0, 2, 0,
        ];
        let strings = ["mock-devices", "Simulated FTDI port", serial];
        Self {
            descriptors: Descriptors::new(IDENTITY, strings, &[interface]),
            firmware: FirmwarePort::new(firmware),
            latency_ms: 16,
        }
    }
}

impl UsbDevice for UsbFtdi {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, setup: Setup, _: &[u8]) -> Result<Vec<u8>, Stall> {
        match setup.request {
            SET_MODEM_CONTROL => {
                if setup.value & DTR_IS_SET != 0 {
                    self.firmware.set_dtr(setup.value & DTR != 0);
                }
                Ok(Vec::new())
            }
            SET_LATENCY => {
                self.latency_ms = setup.value as u8;
                Ok(Vec::new())
            }
            GET_LATENCY => Ok(vec![self.latency_ms]),
            GET_MODEM_STATUS => Ok(STATUS.to_vec()),
            RESET | SET_FLOW_CONTROL | SET_BAUD_RATE | SET_DATA | SET_EVENT_CHARACTER
            | SET_ERROR_CHARACTER => Ok(Vec::new()),
            // It has no EEPROM.
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
        let most = most.min(PACKET).checked_sub(STATUS.len())?;
        let said = self.firmware.read(most)?;
        Some([&STATUS[..], &said].concat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mock_devices::bench::{Bench, BenchConfig};
    use mock_devices::clock::Clock;
    use mock_devices::grbl::{GrblConfig, GrblSimulator};

    #[test]
    fn packets_begin_with_the_status_and_dtr_opens_the_port() {
        let bench = Bench::new(BenchConfig::default(), Clock::real_time());
        let config = GrblConfig {
            reset_on_open: false,
            ..GrblConfig::default()
        };
        let firmware = GrblSimulator::spawn(config, bench).unwrap();
        let mut port = UsbFtdi::new("S1", firmware.path().to_owned());
        let request = |port: &mut UsbFtdi, request, value| {
            port.control(
                Setup {
                    request_type: 0x40,
                    request,
                    value,
                    index: 0,
                    length: 0,
                },
                &[],
            )
        };
        // RTS alone says nothing of DTR.
        request(&mut port, SET_MODEM_CONTROL, 0x202).unwrap();
        port.take(2, b"?");
        assert_eq!(port.give(1, 512), None);
        request(&mut port, SET_MODEM_CONTROL, 0x101).unwrap();
        let mut heard = Vec::new();
        for _ in 0..400 {
            port.take(2, b"?");
            std::thread::sleep(std::time::Duration::from_millis(10));
            if let Some(packet) = port.give(1, 512) {
                assert_eq!(packet[..2], STATUS);
                heard.extend_from_slice(&packet[2..]);
            }
            if heard.contains(&b'>') {
                break;
            }
        }
        assert!(heard.starts_with(b"<"), "{}", heard.escape_ascii());
        request(&mut port, SET_LATENCY, 1).unwrap();
        assert_eq!(request(&mut port, GET_LATENCY, 0), Ok(vec![1]));
        assert_eq!(request(&mut port, 0x90, 0), Err(Stall));
        request(&mut port, SET_MODEM_CONTROL, 0x100).unwrap();
        assert_eq!(port.give(1, 512), None);
    }
}
