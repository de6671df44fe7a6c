//! The end of a USB cable that leads to simulated firmware on a pseudo-terminal.

use std::fs::File;
use std::io::{Read, Write};
use std::path::PathBuf;

use rustix::fs::{Mode, OFlags, open};

/// Open while the host raises DTR, so that a board that resets when its port is
/// opened does so as on a real cable.
#[derive(Debug)]
pub(super) struct FirmwarePort {
    path: PathBuf,
    port: Option<File>,
}

impl FirmwarePort {
    pub(super) fn new(path: PathBuf) -> Self {
        Self { path, port: None }
    }

    pub(super) fn set_dtr(&mut self, is_up: bool) {
        if !is_up {
            self.port = None;
        } else if self.port.is_none() {
            let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
            let port = open(&self.path, flags, Mode::empty());
            self.port = port.ok().map(File::from);
        }
    }

    pub(super) fn write(&mut self, data: &[u8]) {
        if let Some(port) = &mut self.port {
            let _ = port.write_all(data);
        }
    }

    /// What the firmware has said, at most so many bytes.
    pub(super) fn read(&mut self, most: usize) -> Option<Vec<u8>> {
        let mut bytes = vec![0; most];
        match self.port.as_mut()?.read(&mut bytes) {
            Ok(count) if count > 0 => {
                bytes.truncate(count);
                Some(bytes)
            }
            _ => None,
        }
    }
}
