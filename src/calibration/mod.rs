//! Calibration records: what was measured of a bench, by whom, when, and how
//! well. One immutable TOML file per calibration, in
//! `calibration/<rig>/<kind>/<id>.toml`.

mod built_in;
mod library;
pub mod record;

pub use library::{Library, Loaded, RecordError};
