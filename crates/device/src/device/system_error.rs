//! The system's errors of Video4Linux devices, by what they mean for a camera.

use std::io;

use super::DeviceError;

/// ENODEV: a USB cable that is pulled shows as this.
const NO_SUCH_DEVICE: i32 = 19;
/// EBUSY.
const BUSY: i32 = 16;
/// ENOSPC: of a stream it speaks of the bus, not of a disk.
const NO_BANDWIDTH: i32 = 28;

/// What an error of the system means for this device.
pub(super) fn device_error(device: &str, error: io::Error) -> DeviceError {
    let device = device.to_owned();
    match (error.raw_os_error(), error.kind()) {
        (Some(NO_SUCH_DEVICE), _) => DeviceError::Disconnected { device },
        (Some(BUSY), _) => DeviceError::Busy { device },
        (_, io::ErrorKind::NotFound) => DeviceError::NotFound { device },
        (_, io::ErrorKind::PermissionDenied) => DeviceError::PermissionDenied { device },
        _ => DeviceError::Io {
            device,
            source: error,
        },
    }
}

/// The same of a stream that does not start or breaks off.
pub(super) fn stream_error(
    device: &str,
    [width, height]: [u32; 2],
    error: io::Error,
) -> DeviceError {
    match error.raw_os_error() {
        Some(NO_BANDWIDTH) => DeviceError::NoBandwidth {
            device: device.to_owned(),
            width,
            height,
        },
        _ => device_error(device, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_system_become_facts() {
        let number = io::Error::from_raw_os_error;
        let gone = device_error("x", number(19));
        assert!(matches!(gone, DeviceError::Disconnected { .. }));
        let full = stream_error("x", [640, 480], number(28));
        assert!(matches!(full, DeviceError::NoBandwidth { .. }), "{full}");
        let gone = stream_error("x", [640, 480], number(19));
        assert!(matches!(gone, DeviceError::Disconnected { .. }));
        let busy = device_error("x", number(16));
        assert!(matches!(busy, DeviceError::Busy { .. }));
    }
}
