//! What becomes of fits: reports and certificates, files for other programs, materials compared,
//! many sessions fitted as a batch.
//!
//! Part of `rig`, whose library re-exports these modules.

#[cfg(target_os = "linux")]
use rig_bench::catalogue;
#[cfg(feature = "reports")]
use rig_bench::queue;
use rig_bench::{fault, session, workflow};
use rig_core::{brdf, outside_file, outside_table, parametric, progress, shown, whole_file};
#[cfg(feature = "reports")]
use rig_core::{inverse, radiance_image, transport, units};
#[cfg(feature = "reports")]
use rig_device::device;
#[cfg(feature = "figures")]
use rig_setup::plot;
#[cfg(feature = "reports")]
use rig_setup::{calibration, config};
use rig_setup::{checksum, shell_words};

#[cfg(feature = "reports")]
pub mod batch;
pub mod cluster;
pub mod export;
pub mod material;
#[cfg(feature = "reports")]
pub mod report;
#[cfg(target_os = "linux")]
pub mod result_table;
