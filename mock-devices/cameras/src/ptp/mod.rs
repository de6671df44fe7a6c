//! A still camera behind PTP/IP (ISO 15740 over TCP, CIPA DC-005): the `gphoto2` program is
//! its client, as with a real body on a network.
//!
//! The sensor, the lamp and the stage are those of the simulated bench; the body has a list
//! of shutter speeds, sensitivities and apertures, and hands over raw files.

pub mod body;
pub mod dataset;
pub mod dng;
pub mod faults;
pub mod packet;
pub mod server;

pub use body::{Body, BodyConfig};
pub use faults::BodyFaults;
pub use server::PtpServer;
