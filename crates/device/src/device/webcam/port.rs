//! What a driver needs of a library for webcams, and its controls as a port.

use std::cell::RefCell;
use std::io;
use std::time::Instant;

use super::super::DeviceError;
use super::super::controls::{ControlInfo, ControlPort};
use crate::units::Seconds;

/// A webcam behind a library. It stays on one thread, and its calls may block for ever.
pub trait Webcam: Sized + 'static {
    /// Opens the camera at this address for frames in `YUYV`, at the fastest rate at which the
    /// longest exposure fits between two frames.
    fn open(address: &str, resolution_px: [u32; 2], longest: Seconds) -> Result<Self, DeviceError>;
    /// Where the camera with this serial number may be now.
    fn addresses(serial: &str) -> Vec<String>;
    /// Model as the camera reports it.
    fn model(&self) -> String;
    /// Serial number of its USB device, if it has one.
    fn serial(&self) -> Option<String>;
    /// The control with this Video4Linux id and its value; `None` if there is none.
    fn control(&self, id: u32) -> io::Result<Option<ControlInfo>>;
    /// Sets a control; whether the value was taken shows when it is read.
    fn set_control(&mut self, id: u32, value: i64) -> io::Result<()>;
    /// Waits for the next frame. After an error the stream begins anew.
    fn next_frame(&mut self) -> io::Result<Frame>;
}

/// A buffer as the library returns it.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// When its exposure had ended, by its time stamp.
    pub ended: Option<Instant>,
}

/// The controls of a webcam, for what sets them.
pub struct Port<'a, W>(RefCell<&'a mut W>);

impl<'a, W> Port<'a, W> {
    /// Those of this webcam.
    pub fn new(webcam: &'a mut W) -> Self {
        Self(RefCell::new(webcam))
    }
}

impl<W: Webcam> ControlPort for Port<'_, W> {
    fn query(&self, id: u32) -> io::Result<Option<ControlInfo>> {
        self.0.borrow().control(id)
    }

    fn query_after(&self, _: u32) -> io::Result<Option<ControlInfo>> {
        Err(io::ErrorKind::Unsupported.into())
    }

    fn get(&self, id: u32) -> io::Result<i64> {
        let control = self.0.borrow().control(id)?;
        control
            .and_then(|control| control.value)
            .ok_or_else(|| io::ErrorKind::Unsupported.into())
    }

    fn set(&self, id: u32, value: i64) -> io::Result<()> {
        self.0.borrow_mut().set_control(id, value)
    }
}
