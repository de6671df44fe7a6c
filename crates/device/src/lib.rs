//! Cameras and light stages, and what their counts mean: drivers of real protocols, the noise of
//! a sensor, exposures planned and merged into radiance.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_core::{
    outside_file, outside_table, outside_text, progress, radiance_image, shown, statistics, units,
};

pub mod device;
pub mod interrupt;
pub mod radiometry;
