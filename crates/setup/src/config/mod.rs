//! Rig files, parsed once into valid types: the bench's half of [`rig_core::config`],
//! whose reader, errors and scene files it shares and re-exports.

mod build;
pub mod calibration_light;
pub mod camera;
#[cfg(target_os = "linux")]
pub mod draft;
pub mod fit;
pub mod geometry;
pub mod lab;
pub mod limits;
pub mod process;
mod resolve;
mod rig;
pub mod scene_concern;
pub mod simulation;
pub mod stage;

pub use camera::{CameraConfig, CameraDriver};
pub use resolve::{
    BUILT_IN, Origin, REHEARSAL, RIG_FILE, ResolvedRig, Surroundings, is_rehearsal, resolve_rig,
};
pub use rig::RigConfig;
pub use rig_core::config::*;
