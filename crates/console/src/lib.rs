//! The bench in a browser: one server, its jobs, its pages.
//!
//! Part of `rig`, whose library re-exports this module.

use rig_core::{brdf, file_system, geometry, radiance_image, shown, transport, units};

use rig_bench::{beneath, calibrating, capture, catalogue, fault, queue, session, workflow};
use rig_desk::{export, report};
use rig_device::{device, interrupt, radiometry};
use rig_setup::{calibration, checksum, config, plot, shell_words};

pub mod console;
