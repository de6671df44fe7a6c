//! Experiments against a known truth, and the speed of the inner loops.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_bench::capture;
#[cfg(feature = "experiments")]
use rig_bench::workflow;
use rig_core::{
    bench_priors, brdf, cells, frames, geometry, inverse, progress, random, transport, units,
    whole_file,
};
#[cfg(feature = "experiments")]
use rig_core::{file_system, outside_file, radiance_image, simplex, statistics};
#[cfg(feature = "experiments")]
use rig_desk::{cluster, result_table};
#[cfg(feature = "experiments")]
use rig_device::{device, radiometry};
use rig_setup::config;
#[cfg(feature = "experiments")]
use rig_setup::{calibration, checksum, plot, simulation};

pub mod benchmark;
pub mod design;
#[cfg(feature = "experiments")]
pub mod evaluate;
#[cfg(feature = "experiments")]
pub mod job_array;
