//! What a bench is, before anything is measured with it: its rig file, its calibration
//! records and how they are computed, the figures of both, and the simulated world that a
//! simulated bench photographs.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_core::{
    bench_priors, brdf, cells, frames, geometry, inverse, least_squares, outside_file,
    radiance_image, random, shown, statistics, transport, units, whole_file,
};
use rig_device::{device, radiometry};

pub mod calibration;
pub mod checksum;
pub mod config;
#[cfg(feature = "figures")]
pub mod plot;
pub mod shell_words;
pub mod simulation;
