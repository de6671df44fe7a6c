//! Rig and scene files, parsed once into valid types.
//!
//! Unknown keys are refused, every value is checked where it is read, and every
//! error says file, line, key, value and what may stand there.

pub mod build;
pub mod camera;
mod document;
mod error;
pub mod geometry;
pub mod limits;
pub mod mesh;
pub mod process;
pub mod reader;
pub mod reflectance;
mod resolve;
mod rig;
pub mod scene;
pub mod shape;
pub mod simulation;
mod slip;
pub mod stage;
pub mod uncertainty;
pub mod view;

use std::path::Path;

use crate::outside_file;

pub use camera::{CameraConfig, CameraDriver};
pub use error::ConfigError;
pub use resolve::{BUILT_IN, Origin, ResolvedRig, Surroundings, resolve_rig};
pub use rig::RigConfig;
pub use slip::Slip;

/// Rig and scene files are small; anything larger is another file.
const LARGEST_FILE_BYTES: u64 = 256 << 10;

fn read_text(path: &Path) -> Result<String, ConfigError> {
    outside_file::read_text(path, LARGEST_FILE_BYTES).map_err(|source| ConfigError::Read {
        file: path.to_owned(),
        source,
    })
}
