//! Scene files, parsed once into valid types, and the reader that rig files share.
//!
//! Unknown keys are refused, every value is checked where it is read, and every
//! error says file, line, key, value and what may stand there.

mod build;
mod document;
mod error;
pub mod mesh;
pub mod reader;
pub mod reflectance;
pub mod scene;
pub mod shape;
mod slip;
pub mod uncertainty;
pub mod view;

use std::path::Path;

use crate::outside_file;

pub use build::{BuildError, load_bodies};
pub use error::ConfigError;
pub use slip::Slip;

/// Rig and scene files are small; anything larger is another file.
const LARGEST_FILE_BYTES: u64 = 256 << 10;

/// The text of a rig or scene file, at most 256 KiB in any encoding of text.
pub fn read_text(path: &Path) -> Result<String, ConfigError> {
    outside_file::read_text(path, LARGEST_FILE_BYTES).map_err(|source| ConfigError::Read {
        file: path.to_owned(),
        source,
    })
}
