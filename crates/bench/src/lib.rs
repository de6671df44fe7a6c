//! The bench at work, from a rig file to a fitted session: how it is examined and calibrated,
//! how a capture is planned and run, simulated or real, what is on disk, how it is fitted.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_core::{
    bench_priors, brdf, cells, file_system, geometry, inverse, outside_file, plausibility,
    progress, radiance_image, random, scores, shown, statistics, transport, units, whole_file,
};

use rig_device::{device, interrupt, radiometry};
#[cfg(feature = "figures")]
use rig_setup::plot;
use rig_setup::{calibration, checksum, config, simulation};

#[cfg(target_os = "linux")]
pub mod beneath;
#[cfg(target_os = "linux")]
pub mod calibrating;
#[cfg(target_os = "linux")]
pub mod capture;
#[cfg(target_os = "linux")]
pub mod catalogue;
#[cfg(target_os = "linux")]
pub mod doctor;
pub mod fault;
#[cfg(target_os = "linux")]
pub mod queue;
pub mod rendering;
pub mod session;
pub mod workflow;
#[cfg(target_os = "linux")]
pub mod write_queue;
