//! Calibrations from beginning to end: each takes what it is to measure by (the bench itself,
//! or images), measures, and keeps what it found as a record. Nothing here prints or
//! asks; who does so is an [`Attendant`].
//!
//! | file | what it measures |
//! |---|---|
//! | `sensor`, `flat` | the sensor by photon transfer; pixels and scale under an even light |
//! | `lamp` | how the lamp warms up, drifts and flickers |
//! | `response` | the response of a camera that is not linear |
//! | `camera`, `focus` | the lens, and how sharp it is |
//! | `glare` | the light that the lens scatters |
//! | `lights`, `white` | where the lights are, and how strong |
//! | `pose` | where the sample lies, and whether it is the same in every direction |
//! | `placing`, `trial` | whether the target lies before the camera; records until they are accepted |
//! | `place` | where records and their figures go |

mod camera;
mod error;
mod flat;
mod focus;
mod glare;
mod lamp;
mod lights;
mod place;
pub mod placing;
mod pose;
mod response;
mod sensor;
pub mod trial;
mod white;

pub use camera::{CameraRequest, MeasuredCamera};
pub use error::CalibratingError;
pub use flat::{FlatRequest, MeasuredFlat};
pub use focus::{EdgesRequest, MeasuredFocus};
pub use glare::{CardRequest, MeasuredGlare};
pub use lamp::{LampRequest, MeasuredLamp};
pub use lights::{MeasuredLights, SpheresRequest};
pub use place::{Kept, Place};
pub use pose::{MeasuredPose, PoseRequest, TurnedSession, compare_turns};
pub use response::{MeasuredResponse, ResponseRequest};
pub use sensor::{MeasuredSensor, SensorRequest};
pub use white::{MeasuredWhite, WhiteRequest};

use std::path::Path;

use crate::calibration::procedure::ProcedureOptions;
use crate::capture::remote_operator::RemoteOperator;
use crate::capture::{HandWork, Progress};
use crate::config::CameraConfig;
use crate::radiance_image::{RadianceImage, exr};
use crate::workflow::{SessionImages, session_images};

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

/// Asked, and informed, through the program that reads the events.
impl Attendant for RemoteOperator {
    fn cover(&self, cover: bool) -> bool {
        self.has_done(match cover {
            true => HandWork::Cover,
            false => HandWork::Uncover,
        })
    }

    fn switch(&self, on: bool) -> bool {
        self.has_done(match on {
            true => HandWork::LightOn,
            false => HandWork::LightOff,
        })
    }

    fn progress(&self, done: u64, of: u64) {
        let done = done as f64 / of.max(1) as f64;
        self.report(&Progress::Calibrating { done });
    }
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

/// A session that was captured on the rig whose record is to be made.
fn session_of(root: &Path, rig: &str) -> Result<SessionImages, CalibratingError> {
    let session = session_images(root)?;
    if session.config.name == rig {
        return Ok(session);
    }
    Err(CalibratingError::OtherRig {
        session: root.to_owned(),
        of: session.config.name,
        rig: rig.to_owned(),
    })
}

/// A radiance image, or that of one light of a session.
///
/// # Errors
/// A file that cannot be read, a session of another rig or without that light.
pub fn image_of(path: &Path, light: usize, rig: &str) -> Result<RadianceImage, CalibratingError> {
    if !path.is_dir() {
        return Ok(exr::read(path)?.image);
    }
    let captured = session_of(path, rig)?.captured;
    let lights = captured.len();
    let image = captured.into_iter().nth(light);
    image.ok_or_else(|| CalibratingError::NoLight {
        session: path.to_owned(),
        lights,
        light,
    })
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
