//! Which body: those that are detected, and the one that the rig file means.

use super::body_choice::BodyChoice;
use super::program::{self, GPHOTO2, Gphoto};
use super::raw_file::{RAW_IDENTIFY, UNPROCESSED_RAW};
use crate::device::DeviceError;
use crate::device::command_camera::{Workplace, program as program_file};
use crate::device::described::FoundCamera;

/// Fails where a program that does the work cannot be run.
pub(super) fn programs_are_there() -> Result<(), DeviceError> {
    for program in [GPHOTO2, UNPROCESSED_RAW, RAW_IDENTIFY] {
        if let Some(fault) = program_file::fault(program) {
            let program = program.to_owned();
            return Err(DeviceError::Program { program, fault });
        }
    }
    Ok(())
}

/// The bodies that gphoto2 detects on USB, without opening any.
pub(super) fn detected() -> Result<Vec<FoundCamera>, DeviceError> {
    if program_file::fault(GPHOTO2).is_some() {
        return Ok(Vec::new());
    }
    let bodies = program::detect(&Workplace::new(None)?)?;
    let found = bodies.into_iter().map(|(model, port)| FoundCamera {
        address: format!("port={port}"),
        model,
        serial: String::new(),
        problem: None,
    });
    Ok(found.collect())
}

/// The body that the rig file means.
pub(super) fn find(
    choice: &BodyChoice,
    serial: &str,
    workplace: &Workplace,
) -> Result<Gphoto, DeviceError> {
    let at = |port: &str| Gphoto {
        port: port.to_owned(),
    };
    let serial_at = |port: &str| -> Result<String, DeviceError> {
        let setting = at(port).get(workplace, &["serialnumber"])?;
        Ok(setting
            .into_iter()
            .next()
            .map_or(String::new(), |setting| setting.current))
    };
    if let Some(port) = &choice.port {
        if !serial.is_empty() {
            let is = serial_at(port)?;
            if is != serial {
                return Err(DeviceError::OtherCamera {
                    device: port.clone(),
                    is,
                    wanted: serial.to_owned(),
                });
            }
        }
        return Ok(at(port));
    }
    let detected = program::detect(workplace)?;
    if serial.is_empty() {
        return match detected.as_slice() {
            [(_, port)] => Ok(at(port)),
            [] => Err(DeviceError::Disconnected {
                device: "the still camera".to_owned(),
            }),
            several => Err(DeviceError::WrongKind {
                device: "port = any".to_owned(),
                wanted: "single camera",
                why: format!("gphoto2 detects {} of them", several.len()),
            }),
        };
    }
    let mut held = None;
    for (_, port) in &detected {
        match serial_at(port) {
            Ok(found) if found == serial => return Ok(at(port)),
            Ok(_) => {}
            Err(error) => held = Some(error),
        }
    }
    Err(held.unwrap_or(DeviceError::Disconnected {
        device: format!("the still camera {serial}"),
    }))
}

/// Fails where a setting is another than the one that was set.
pub(super) fn must_be(device: &str, what: &str, is: &str, wanted: &str) -> Result<(), DeviceError> {
    if is == wanted {
        return Ok(());
    }
    Err(DeviceError::NotApplied {
        device: device.to_owned(),
        what: what.to_owned(),
        is: is.to_owned(),
        wanted: wanted.to_owned(),
    })
}
