//! Calibration records: what was measured of a bench, by whom, when, and how
//! well. One immutable TOML file per calibration, in
//! `calibration/<rig>/<kind>/<id>.toml`.

mod built_in;
pub mod camera;
pub mod depth_of_field;
pub mod directions;
#[cfg(feature = "figures")]
pub mod figures;
pub mod fitness;
pub mod flat;
pub mod glare;
pub mod lamp;
pub mod lamp_watch;
mod library;
pub mod measurement;
pub mod mirror_sphere;
pub mod noise;
pub mod pixel_map;
pub mod pose;
pub mod procedure;
pub mod record;
pub mod rotation;
mod seal;
pub mod sensor;
pub mod slanted_edge;
pub mod stage_directions;
pub mod status;
pub mod white;
pub mod white_lights;

pub use library::{Library, Loaded, RecordError, parse as parse_record, record_in};
pub use seal::Seal;
