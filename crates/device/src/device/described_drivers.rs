//! The drivers of described cameras.

use super::described::Driver;
use super::{command_camera, folder_camera, gphoto2};

/// Every driver of this kind.
pub const DRIVERS: &[Driver] = &[
    command_camera::DRIVER,
    folder_camera::DRIVER,
    gphoto2::DRIVER,
    #[cfg(feature = "genicam")]
    super::genicam::DRIVER,
    #[cfg(feature = "webcam")]
    super::webcam::DRIVER,
];
