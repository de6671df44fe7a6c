//! The bench in a browser: one server, its jobs, its pages.
//!
//! Part of `rig`, whose library re-exports this module.

use rig_core::{brdf, file_system, geometry, radiance_image, shown, transport, units};

use rig_bench::plot;
use rig_bench::{
    beneath, calibration, capture, catalogue, checksum, config, fault, queue, session, shell_words,
    workflow,
};
use rig_desk::{export, report};
use rig_device::{device, radiometry};

pub mod console;
