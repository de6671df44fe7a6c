//! The rig file, its camera and its stage.

use std::path::Path;

use rustix::fs::{Access, access};

use super::{Check, Trouble};
use crate::config::stage::StageDriver;
use crate::config::{CameraDriver, Origin, ResolvedRig};
use crate::device::{DeviceError, discovery};

pub(super) fn checks(rig: &ResolvedRig) -> Vec<Check> {
    let mut checks = vec![configuration(rig), camera(rig), stage(rig)];
    checks.extend(watchdog(rig));
    checks.extend(lamp_report(rig));
    checks
}

fn configuration(rig: &ResolvedRig) -> Check {
    let why = match rig.origin {
        Origin::Argument => "named by --rig",
        Origin::Environment => "named by RIG_CONFIG",
        Origin::WorkingFolder => "found in the working folder",
        Origin::Fallback => "the simulated rig stands in, because none is configured",
    };
    let name = "configuration";
    let fact = format!("{} is valid ({why})", rig.file);
    let connected = discovery::usb_devices(Path::new("/"));
    if rig.config.is_simulated() && !connected.is_empty() {
        let fact = format!("{fact}; connected but unused: {}", connected.join(", "));
        return Check::warning(name, fact, Trouble::Unused);
    }
    Check::ok(name, fact)
}

fn camera(rig: &ResolvedRig) -> Check {
    let name = "camera";
    match &rig.config.camera.driver {
        CameraDriver::Simulated => Check::ok(name, "simulated"),
        CameraDriver::V4l { .. } if !cfg!(feature = "v4l") => Check::failed(
            name,
            "this program was built without Video4Linux",
            Trouble::WithoutFeature("v4l"),
        ),
        CameraDriver::V4l { device, .. } => device_file(name, device, "/dev/v4l/by-id"),
        CameraDriver::Described { driver, setting } => match (driver.ready)(setting) {
            Ok(source) => Check::ok(name, source),
            Err(error) => Check::refused(name, error),
        },
    }
}

fn stage(rig: &ResolvedRig) -> Check {
    let (name, stage) = ("stage", &rig.config.stage);
    match stage.port() {
        None => Check::ok(name, stage.driver_name()),
        Some(_) if !cfg!(feature = "serial") => Check::failed(
            name,
            "this program was built without serial ports",
            Trouble::WithoutFeature("serial"),
        ),
        Some(port) => device_file(name, port, "/dev/serial/by-id"),
    }
}

/// Whether a device file exists, may be opened, is free, and has a lasting name.
fn device_file(name: &'static str, path: &str, lasting: &'static str) -> Check {
    let file = Path::new(path);
    if let Some(error) = DeviceError::of_address(path) {
        return Check::refused(name, error);
    }
    let failed = |fact: String, trouble| Check::failed(name, fact, trouble);
    if !file.exists() {
        return failed(format!("{path} does not exist"), Trouble::NoDeviceFile);
    }
    if let Err(error) = access(file, Access::READ_OK | Access::WRITE_OK) {
        let error = std::io::Error::from(error);
        return failed(format!("{path}: {error}"), Trouble::NoAccess);
    }
    if let Some(holder) = discovery::holder(file) {
        return failed(format!("{path} is in use by {holder}"), Trouble::InUse);
    }
    if !path.starts_with(lasting) {
        return Check::warning(
            name,
            format!("{path} can be opened, but its name changes with the order of plugging in"),
            Trouble::NameChanges { lasting },
        );
    }
    Check::ok(name, format!("{path} can be opened"))
}

/// What turns the lamp off when the computer or the cable fails: the firmware
/// alone can. Which one it is shows when the stage is opened, not before.
fn watchdog(rig: &ResolvedRig) -> Option<Check> {
    let fact = match &rig.config.stage.driver {
        StageDriver::Simulated(_) | StageDriver::Manual(_) => return None,
        StageDriver::Grbl(_) => "stock GRBL has none",
        StageDriver::Zaber(_) => "Zaber's protocol has none",
        StageDriver::Dome(_) => "a DMX interface has none and repeats its last packet",
    };
    let fact = format!("{fact}: the lamp stays on if the computer or the cable fails");
    Some(Check::warning("watchdog", fact, Trouble::NoWatchdog))
}

/// A lamp whose state nothing reports: that it is off is sent and not verified.
fn lamp_report(rig: &ResolvedRig) -> Option<Check> {
    let who = match &rig.config.stage.driver {
        StageDriver::Manual(_) => "an operator switches the lamp",
        StageDriver::Dome(_) => "a DMX interface does not report its lights",
        _ => return None,
    };
    let fact = format!("sent, not verified: {who}");
    Some(Check::warning("lamp off", fact, Trouble::LampNotReported))
}

#[cfg(test)]
mod tests {
    use super::super::Verdict;
    use super::*;
    use crate::config::{BUILT_IN, RigConfig};

    #[test]
    fn the_watchdog_is_that_of_the_protocol() {
        let check = |file: &str| {
            let (_, text) = BUILT_IN.iter().find(|(name, _)| *name == file).unwrap();
            watchdog(&ResolvedRig {
                config: RigConfig::parse("rig.toml", Path::new(""), text).unwrap(),
                origin: Origin::Argument,
                file: "rig.toml".to_owned(),
                folder: None,
            })
        };
        for (file, fact) in [
            ("grbl-arm-v4l2", "stock GRBL has none"),
            ("zaber-gantry-v4l2", "Zaber's protocol has none"),
            ("dmx-dome-v4l2", "a DMX interface has none"),
        ] {
            let check = check(file).unwrap();
            assert_eq!(check.verdict, Verdict::Warning, "{fact}");
            assert!(check.fact.starts_with(fact), "{}", check.fact);
        }
        assert!(check("simulated").is_none());
    }

    #[test]
    fn a_device_file_is_missing_then_unlasting_then_in_use() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ttyUSB0");
        let name = path.display().to_string();
        let check = |lasting| device_file("stage", &name, lasting);
        assert!(check("/dev").fact.contains("does not exist"));
        let network = device_file("stage", "bench:23", "/dev");
        assert!(
            matches!(network.trouble, Some(Trouble::Error(_))),
            "{network:?}"
        );
        std::fs::write(&path, "").unwrap();
        assert_eq!(check("/dev/serial/by-id").verdict, Verdict::Warning);
        assert_eq!(check("/").verdict, Verdict::Ok);
        let open = std::fs::File::open(&path).unwrap();
        let fact = check("/").fact;
        let holder = format!("in use by process {}", std::process::id());
        assert!(fact.contains(&holder), "{fact}");
        drop(open);
    }
}
