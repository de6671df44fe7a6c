//! Calibration records: what was measured of a bench, by whom, when, and how
//! well. One immutable TOML file per calibration, in
//! `calibration/<rig>/<kind>/<id>.toml`.

mod built_in;
pub mod flat;
mod library;
pub mod noise;
pub mod procedure;
pub mod record;
pub mod sensor;

pub use library::{Library, Loaded, RecordError, record_in};
