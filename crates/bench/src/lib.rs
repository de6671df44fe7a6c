//! The bench from a rig file to a fitted session: what is on disk, what calibrates it, how a
//! capture is planned and run, simulated or real, and how its session is fitted.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_core::{
    bench_priors, brdf, cells, file_system, frames, geometry, inverse, least_squares, outside_file,
    plausibility, progress, radiance_image, random, scores, shown, statistics, transport, units,
    whole_file,
};

use rig_device::{device, interrupt, radiometry};

pub mod beneath;
pub mod calibrating;
pub mod calibration;
pub mod capture;
pub mod catalogue;
pub mod checksum;
pub mod config;
pub mod doctor;
pub mod fault;
#[cfg(feature = "figures")]
pub mod plot;
pub mod queue;
pub mod rendering;
pub mod session;
pub mod shell_words;
pub mod simulation;
pub mod workflow;
pub mod write_queue;
