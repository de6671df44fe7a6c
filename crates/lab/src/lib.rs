//! Experiments against a known truth, and the speed of the inner loops.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_core::{
    bench_priors, brdf, cells, file_system, frames, geometry, inverse, outside_file,
    radiance_image, random, simplex, statistics, transport, units, whole_file,
};

#[cfg(feature = "experiments")]
use rig_bench::plot;
use rig_bench::{calibration, capture, checksum, config, simulation};
use rig_desk::{cluster, result_table};
use rig_device::{device, radiometry};

pub mod benchmark;
#[cfg(feature = "experiments")]
pub mod evaluate;
