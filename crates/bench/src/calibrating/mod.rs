//! Calibrations from beginning to end: each takes what it is to measure by (the bench itself,
//! or images), measures, and keeps what it found as a record. Nothing here prints or
//! asks; who does so is an [`Attendant`].
//!
//! | file | what it measures |
//! |---|---|
//! | `sensor`, `flat` | the sensor by photon transfer; pixels and scale under an even light |
//! | `lamp` | how the lamp warms up, drifts and flickers |
//! | `response` | the response of a camera that is not linear |
//! | `camera` | the lens |
//! | `glare` | the light that the lens scatters |
//! | `place` | where records and their figures go |

mod camera;
mod error;
mod flat;
mod glare;
mod lamp;
mod place;
mod response;
mod sensor;

pub use camera::{CameraRequest, MeasuredCamera};
pub use error::CalibratingError;
pub use flat::{FlatRequest, MeasuredFlat};
pub use glare::{CardRequest, MeasuredGlare};
pub use lamp::{LampRequest, MeasuredLamp};
pub use place::{Kept, Place};
pub use response::{MeasuredResponse, ResponseRequest};
pub use sensor::{MeasuredSensor, SensorRequest};

use crate::calibration::procedure::ProcedureOptions;
use crate::config::CameraConfig;

/// The person at a bench that is calibrated, and who is shown how far the work is.
pub trait Attendant {
    /// Covers or uncovers the light, or the lens of a camera without shutter; whether that was
    /// done.
    fn cover(&self, cover: bool) -> bool;

    /// Switches the even light and leaves the room as it is; whether that was done.
    fn switch(&self, on: bool) -> bool;

    /// So many steps are done.
    fn progress(&self, done: u64, of: u64);
}

/// How frames of an even light are taken with this camera.
fn procedure_options(camera: &CameraConfig, frames: u32) -> ProcedureOptions {
    ProcedureOptions {
        gain: camera.gain,
        frames,
        discard: camera.settings_latency_frames + 1,
        ..ProcedureOptions::default()
    }
}

/// Steps of work, counted for an attendant.
fn counted<'a>(attendant: &'a dyn Attendant, of: u32) -> impl FnMut() + 'a {
    let mut done = 0;
    move || {
        done += 1;
        attendant.progress(done, u64::from(of));
    }
}

#[cfg(test)]
mod tests;
