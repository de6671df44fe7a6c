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
pub mod process;
pub mod reader;
pub mod reflectance;
mod resolve;
mod rig;
pub mod scene;
pub mod shape;
pub mod simulation;
pub mod stage;
pub mod uncertainty;
pub mod view;

use std::path::Path;

pub use camera::{CameraConfig, CameraDriver};
pub use error::ConfigError;
pub use resolve::{BUILT_IN, Origin, ResolvedRig, Surroundings, resolve_rig};
pub use rig::RigConfig;

/// Rig and scene files are small; anything larger is another file.
const LARGEST_FILE_BYTES: u64 = 256 << 10;

fn read_text(path: &Path) -> Result<String, ConfigError> {
    let read = || {
        let length = std::fs::metadata(path)?.len();
        if length > LARGEST_FILE_BYTES {
            let fact = format!("{length} bytes, but at most {LARGEST_FILE_BYTES} are read");
            return Err(std::io::Error::other(fact));
        }
        std::fs::read_to_string(path)
    };
    read().map_err(|source| ConfigError::Read {
        file: path.to_owned(),
        source,
    })
}
