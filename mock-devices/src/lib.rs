//! A simulated bench on which `rig`'s production drivers are tested.
//!
//! The crate knows nothing of `rig`: simulated firmware answers bytes on a
//! pseudo-terminal of Linux, a sensor turns radiance into raw counts, a bench holds the
//! true stage position and lamp state, and the radiance of the scene comes from
//! whoever implements [`RadianceSource`].

pub mod bench;
pub mod camera;
pub mod clock;
#[cfg(target_os = "linux")]
pub mod dmx;
pub mod failing;
pub mod glare;
#[cfg(target_os = "linux")]
pub mod grbl;
pub mod motion;
#[cfg(target_os = "linux")]
pub mod proxy;
pub mod sensor;
#[cfg(target_os = "linux")]
pub mod zaber;

#[cfg(target_os = "linux")]
mod pty;
pub mod random;

use std::sync::Arc;

/// The light that falls on the scene at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Illumination {
    /// True azimuth of the lamp in the stage's axes, radians.
    pub azimuth_rad: f64,
    /// True elevation of the lamp in the stage's axes, radians.
    pub elevation_rad: f64,
    /// Azimuth and elevation to which the lamp was sent, degrees: the same at every
    /// visit, whatever the stage's errors make of it.
    pub sent_to_deg: [f64; 2],
    /// Relative power of the lamp's channels, 0 = off, 1 = nominal.
    pub channels: [f64; 3],
}

/// What the camera looks at.
pub trait RadianceSource: Send + Sync {
    /// Width and height of the image, pixels: the sensor's own grid.
    fn resolution_px(&self) -> [u32; 2];
    /// Mean radiance over each sensor pixel's footprint, row by row from the
    /// top, W/(m² sr) in the sensor's band. Light of the room (ambient) included.
    fn radiance(&self, illumination: &Illumination) -> Arc<Vec<f32>>;
}
