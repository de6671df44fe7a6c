//! Which body: those that are detected, and the one that the rig file means.

use super::body_choice::BodyChoice;
use super::program::{self, GPHOTO2, Gphoto};
use super::raw_file::{RAW_IDENTIFY, UNPROCESSED_RAW};
use super::serial;
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

/// A body that was found, and what it reports of itself.
#[derive(Debug)]
pub(super) struct Body {
    pub(super) gphoto: Gphoto,
    /// Names of all its settings, whole paths.
    pub(super) names: Vec<String>,
    /// Its serial numbers, the printed one first.
    pub(super) serials: Vec<String>,
    /// Whether it is the one that is wanted; where it is not known, its raw files tell.
    pub(super) is_proven: bool,
}

impl Body {
    fn at(port: &str, workplace: &Workplace) -> Result<Self, DeviceError> {
        let port = port.to_owned();
        let gphoto = Gphoto { port };
        let names = gphoto.names(workplace)?;
        let of_body = |name: &&String| {
            let name = name.rsplit('/').next().unwrap_or_default();
            name.ends_with("serialnumber") && !name.contains("lens")
        };
        let mut asked: Vec<&str> = names.iter().filter(of_body).map(String::as_str).collect();
        // The printed one first.
        asked.sort_by_key(|name| !name.ends_with("/eosserialnumber"));
        let serials = match asked.as_slice() {
            [] => Vec::new(),
            asked => gphoto.get(workplace, asked)?,
        };
        let serials = serials.into_iter().map(|setting| setting.current);
        Ok(Self {
            serials: serials.filter(|serial| !serial.is_empty()).collect(),
            gphoto,
            names,
            is_proven: true,
        })
    }
}

/// The body that the rig file means: of these serial numbers, any where there are none.
pub(super) fn find(
    choice: &BodyChoice,
    wanted: &[String],
    workplace: &Workplace,
) -> Result<Body, DeviceError> {
    let ports: Vec<String> = match &choice.port {
        Some(port) => vec![port.clone()],
        None => {
            let detected = program::detect(workplace)?;
            detected.into_iter().map(|(_, port)| port).collect()
        }
    };
    if let ([port], true) = (ports.as_slice(), wanted.is_empty()) {
        return Body::at(port, workplace);
    }
    if wanted.is_empty() && !ports.is_empty() {
        return Err(DeviceError::WrongKind {
            device: "port = any".to_owned(),
            wanted: "single camera",
            why: format!("gphoto2 detects {} of them", ports.len()),
        });
    }
    let mut held = None;
    for port in &ports {
        match Body::at(port, workplace) {
            Ok(body) if serial::is_any(&body.serials, wanted) => return Ok(body),
            // Another one's, or a number that only its files state.
            Ok(body) if ports.len() == 1 => {
                return Ok(Body {
                    is_proven: false,
                    ..body
                });
            }
            Ok(_) => {}
            Err(error) => held = Some(error),
        }
    }
    Err(held.unwrap_or_else(|| DeviceError::Disconnected {
        device: match wanted.first() {
            Some(serial) => format!("the still camera {serial}"),
            None => "the still camera".to_owned(),
        },
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
