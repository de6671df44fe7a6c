//! Simulated USB devices for the kernel's own drivers: a camera for `uvcvideo`,
//! serial ports for `cdc_acm` and `ftdi_sio`.
//!
//! They are plugged into the kernel's virtual host controller (`vhci-hcd`),
//! which takes one end of a socket pair and speaks the USB/IP protocol over it
//! (kernel documentation, `usb/usbip_protocol`). Needs that module and root.

pub mod camera;
pub mod ftdi;
pub mod serial;

mod descriptors;
mod firmware_port;
mod vhci;

pub use vhci::Plugged;

/// A control request's first eight bytes (USB 2.0, §9.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// Direction, kind and recipient.
    pub request_type: u8,
    /// What is asked.
    pub request: u8,
    /// Its parameter.
    pub value: u16,
    /// Interface or endpoint, and entity.
    pub index: u16,
    /// Most bytes of data.
    pub length: u16,
}

impl Setup {
    fn parse(bytes: &[u8; 8]) -> Self {
        let word = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        Self {
            request_type: bytes[0],
            request: bytes[1],
            value: word(2),
            index: word(4),
            length: word(6),
        }
    }
}

/// The device refuses a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;

/// What is plugged in.
pub trait UsbDevice: Send + 'static {
    /// What it reports of itself.
    fn descriptors(&self) -> &Descriptors;
    /// Answers a request of its class.
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall>;
    /// Takes bytes from the host.
    fn take(&mut self, endpoint: u8, data: &[u8]);
    /// Bytes for the host, at most so many; `None`: nothing yet.
    fn give(&mut self, endpoint: u8, most: usize) -> Option<Vec<u8>>;
}

/// What a device says of itself.
#[derive(Clone, Debug)]
pub struct Descriptors {
    device: Vec<u8>,
    configuration: Vec<u8>,
    strings: [String; 3],
}
