//! The drivers of described cameras.

use super::described::Driver;

/// Every driver of this kind, also those that this build lacks: sessions captured with them can
/// be read and fitted.
pub const DRIVERS: &[Driver] = &[
    #[cfg(target_os = "linux")]
    super::command_camera::DRIVER,
    #[cfg(target_os = "linux")]
    super::folder_camera::DRIVER,
    #[cfg(target_os = "linux")]
    super::gphoto2::DRIVER,
    #[cfg(feature = "genicam")]
    super::genicam::DRIVER,
    #[cfg(feature = "webcam")]
    super::webcam::DRIVER,
    // Those that are lacking, with the keys that they have in rig files.
    #[cfg(not(target_os = "linux"))]
    lacking("command", "command"),
    #[cfg(not(target_os = "linux"))]
    lacking("folder", "folder"),
    #[cfg(not(target_os = "linux"))]
    lacking("gphoto2", "body"),
    #[cfg(not(feature = "genicam"))]
    lacking("genicam", "device"),
    #[cfg(not(feature = "webcam"))]
    lacking("webcam", "device"),
];

/// A driver by its name in rig files, whose cameras this build cannot open.
#[allow(dead_code, reason = "a build may have all drivers")]
const fn lacking(name: &'static str, key: &'static str) -> Driver {
    use super::DeviceError::WithoutDriver;
    Driver {
        name,
        offer: "",
        only_practice: false,
        key,
        allowed: "one or more characters",
        is_path: false,
        accepts: |text| !text.is_empty(),
        ready: |_| Err(WithoutDriver),
        open: |_, _| Err(WithoutDriver),
        find: super::described::find_none,
    }
}
