//! What becomes of fits: reports and certificates, files for other programs, materials compared,
//! many sessions fitted as a batch.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_core::{brdf, inverse, outside_file, outside_table, parametric, radiance_image, random, shown, transport, units, whole_file};

use rig_device::{device};
use rig_bench::{calibration, catalogue, checksum, fault, session, shell_words, workflow};
#[cfg(feature = "figures")]
use rig_bench::plot;

pub mod material;
pub mod export;
#[cfg(feature = "reports")]
pub mod report;
#[cfg(feature = "reports")]
pub mod batch;
pub mod cluster;
pub mod result_table;
