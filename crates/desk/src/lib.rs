//! What becomes of fits: reports and certificates, files for other programs, materials compared,
//! many sessions fitted as a batch.
//!
//! Part of `rig`, whose library re-exports these modules.

use rig_core::{
    brdf, inverse, outside_file, outside_table, parametric, radiance_image, shown, transport,
    units, whole_file,
};

#[cfg(feature = "figures")]
use rig_bench::plot;
use rig_bench::{calibration, catalogue, checksum, fault, queue, session, shell_words, workflow};
use rig_device::device;

#[cfg(feature = "reports")]
pub mod batch;
pub mod cluster;
pub mod export;
pub mod material;
#[cfg(feature = "reports")]
pub mod report;
pub mod result_table;
