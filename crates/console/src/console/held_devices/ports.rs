//! What the bench is built on: how its devices are opened, and who advises on their errors.

use std::fmt;
use std::time::Duration;

use crate::capture::open::Devices;
use crate::console::picture::levels::SensorLevels;
use crate::device::{Camera, CameraSettings};
use crate::fault::{Advisor, Fault};

/// Devices that were opened.
pub enum Opened {
    /// Stage and camera of a rig, with the guardian that its stage has.
    Rig(Devices),
    /// A camera without a stage.
    Camera(Box<dyn Camera>),
}

/// What a [`super::HeldDevices`] needs from whoever starts it.
pub struct BenchPorts {
    /// Opens the devices, each time that a page connects.
    pub open: Box<dyn Fn() -> Result<Opened, Fault> + Send + Sync>,
    /// Advice on errors of devices.
    pub advisor: Advisor,
    /// Black level and full well at a gain.
    pub levels: Box<dyn Fn(f64) -> SensorLevels + Send + Sync>,
    /// Settings of the camera when it is connected.
    pub settings: CameraSettings,
    /// How long the controlling page has been silent; `None` if none controls.
    pub silence: Box<dyn Fn() -> Option<Duration> + Send + Sync>,
}

impl fmt::Debug for BenchPorts {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("BenchPorts")
            .field("settings", &self.settings)
            .finish_non_exhaustive()
    }
}
