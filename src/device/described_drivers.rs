//! The drivers of described cameras.

use super::described::Driver;
use super::{command_camera, folder_camera};

/// Every driver of this kind.
pub const DRIVERS: &[Driver] = &[
    command_camera::DRIVER,
    folder_camera::DRIVER,
    #[cfg(feature = "genicam")]
    super::genicam::DRIVER,
];
