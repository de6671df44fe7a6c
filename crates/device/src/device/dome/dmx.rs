//! The interface of a dome on DMX512. DMX carries no answers: what the lights do is not known.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::Lit;
use super::widget::{Label, SLOTS, START, message, packet, serial_number, take_message, version};
use crate::device::DeviceError;
use crate::device::guardian::Exchange;
use crate::device::serial_line::SerialLine;
use crate::shown::nth;

/// An open interface with the addresses of its lights.
pub struct DmxPort {
    line: SerialLine,
    addresses: Vec<u16>,
    received: Mutex<Vec<u8>>,
}

impl DmxPort {
    /// Opens the port. Nothing is sent.
    pub fn open(path: &str, baud: u32, addresses: Vec<u16>) -> Result<Self, DeviceError> {
        Ok(Self {
            line: SerialLine::open(path, baud)?,
            addresses,
            received: Mutex::default(),
        })
    }

    /// The data of the interface's answer.
    fn ask(&self, label: Label, timeout: Duration) -> Result<Vec<u8>, DeviceError> {
        let mut received = self.received.lock().unwrap_or_else(PoisonError::into_inner);
        received.clear();
        let deadline = Instant::now() + timeout;
        self.line.send(&message(label, &[]))?;
        let mut reader = self.line.reader();
        let mut heard = 0;
        while let Some(bytes) = reader.bytes(deadline)? {
            heard += bytes.len();
            received.extend(bytes);
            while let Some((answered, data)) = take_message(&mut received) {
                if answered == label as u8 {
                    return Ok(data);
                }
            }
        }
        let asked = format!("message {label:?}");
        if heard == 0 {
            return Err(self.line.no_reply(&asked, timeout));
        }
        let answer = format!("{heard} bytes");
        Err(self.line.garbled(&answer, "a message of a DMX USB Pro"))
    }

    fn levels(&self, lit: Option<Lit>) -> Result<[u8; SLOTS], DeviceError> {
        let mut levels = [0; SLOTS];
        if let Some(lit) = lit {
            let first = self.addresses.get(lit.light);
            let slot = first.map(|&first| usize::from(first) + usize::from(lit.channel));
            let level = slot
                .and_then(|slot| levels.get_mut(slot.checked_sub(1)?))
                .ok_or_else(|| {
                    let light = format!("{}, channel {}", nth("light", lit.light), lit.channel);
                    self.line.refused(&light, "it has no address from 1 to 512")
                })?;
            *level = lit.level;
        }
        Ok(levels)
    }
}

impl DmxPort {
    /// The port and its errors.
    pub fn line(&self) -> &SerialLine {
        &self.line
    }

    /// Version and serial number of the interface.
    pub fn identify(&self, timeout: Duration) -> Result<String, DeviceError> {
        let garbled = |data: &[u8], expected: &str| {
            let answer = format!("{} bytes of data", data.len());
            self.line.garbled(&answer, expected)
        };
        let parameters = self.ask(Label::Parameters, timeout)?;
        let version = version(&parameters)
            .ok_or_else(|| garbled(&parameters, "the parameters of a DMX USB Pro"))?;
        let number = self.ask(Label::SerialNumber, timeout)?;
        let number = serial_number(&number)
            .ok_or_else(|| garbled(&number, "the serial number of a DMX USB Pro"))?;
        Ok(format!(
            "{version} (DMX interface {number}; lights unverified)"
        ))
    }

    /// Lights one, all others off; the interface has taken it if its port is still there.
    pub fn show(&self, lit: Option<Lit>) -> Result<(), DeviceError> {
        self.line.send(&packet(&self.levels(lit)?))?;
        self.line.check_connected()
    }

    /// What another process sends to turn all off, whatever was under way, and what confirms it.
    pub fn off_exchanges(&self) -> Vec<Exchange> {
        // Zeros fill a packet that was begun, which then has no end and is
        // dropped. The interface answers once it has taken what came before.
        let dark = packet(&[0; SLOTS]);
        let padding = vec![0; dark.len()];
        let question = message(Label::Parameters, &[]);
        vec![Exchange::new(
            &[padding, dark, question].concat(),
            &[&[START, Label::Parameters as u8]],
        )]
    }
}
