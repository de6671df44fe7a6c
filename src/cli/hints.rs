//! Advice for typed errors. The library states facts; here is what to do about them.

use std::error::Error;

use crate::device::DeviceError;

/// The advice for the first error in the chain that has some.
pub fn for_error(error: &(dyn Error + 'static)) -> Option<String> {
    let mut link = Some(error);
    while let Some(error) = link {
        if let Some(hint) = for_one(error) {
            return Some(hint);
        }
        link = error.source();
    }
    None
}

fn for_one(error: &(dyn Error + 'static)) -> Option<String> {
    if let Some(error) = error.downcast_ref::<DeviceError>() {
        return Some(for_device(error));
    }
    if let Some(error) = error.downcast_ref::<std::io::Error>() {
        return for_io(error).map(str::to_owned);
    }
    None
}

fn for_device(error: &DeviceError) -> String {
    use DeviceError::*;
    match error {
        NotFound { .. } => "run `rig devices` to see what is connected; name ports by /dev/serial/by-id, which survives replugging".into(),
        PermissionDenied { device } => format!(
            "add yourself to the group that owns {device} (`sudo usermod -aG dialout,video $USER`), then log in again; `rig doctor` checks it"
        ),
        Busy { device } => format!("`fuser -v {device}` names the process that holds it; end that one first"),
        NoReply { .. } => "check power, cable and baud rate; `rig devices` shows whether the port is still there".into(),
        Garbled { .. } => "check the baud rate and that the port belongs to this device (`rig devices`)".into(),
        Refused { .. } => "check the firmware's settings against the rig file; `rig stage status` asks the device".into(),
        Alarm { .. } => "find out what the stage hit or lost, then `rig stage home`".into(),
        NotHomed { .. } => "run `rig stage home` first".into(),
        OutOfReach { .. } => "choose fewer or other lights, or correct the limits in the rig file's [stage] table".into(),
        NotApplied { .. } => "the device has another range or step; `rig camera info` and `rig stage status` show what it accepts".into(),
        Disconnected { .. } => "check the cable and the USB hub's power, then `rig doctor`; an interrupted capture continues with `rig capture --resume`".into(),
        Io { .. } => "run `rig doctor`".into(),
    }
}

fn for_io(error: &std::io::Error) -> Option<&'static str> {
    use std::io::ErrorKind::*;
    match error.kind() {
        NotFound => Some("check the path's spelling and the folder the command runs in"),
        PermissionDenied => Some("check who owns the file and the folder, and their permissions"),
        StorageFull => Some(
            "free some space or choose another folder with --out; nothing already written is lost",
        ),
        ReadOnlyFilesystem => Some("choose a folder that can be written"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("capture failed")]
    struct Wrapper(#[source] DeviceError);

    #[test]
    fn the_hint_is_found_behind_a_wrapper() {
        let error = Wrapper(DeviceError::NotHomed {
            device: "arm".into(),
            since: "a reset".into(),
        });
        assert!(for_error(&error).unwrap().contains("rig stage home"));
    }

    #[test]
    fn unknown_errors_have_none() {
        assert_eq!(for_error(&std::fmt::Error), None);
    }
}
