//! Cameras and USB devices of the simulated bench behind their real protocols, on which `rig`'s
//! production drivers are tested. Only tests link this crate: the program's own simulated bench
//! is in [`mock_devices`].

pub mod gige;
pub mod ptp;
pub mod usb;
