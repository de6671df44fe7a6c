//! `rig doctor`: everything that can be checked without moving or lighting
//! anything, each with its remedy.
//!
//! It never opens a port: opening one resets many controllers.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use jiff::Timestamp;
use rustix::fs::{Access, access};
use serde::Serialize;

use super::capture_notices::described;
use super::context::Context;
use super::error::CliError;
use super::output::{write_json, write_line};
use super::preflight::{self, Outlook};
use super::rig_choice::RigArg;
use super::{hints, sharpness};
use crate::calibration::camera::CameraValues;
use crate::calibration::directions::DirectionsValues;
use crate::calibration::fitness::Concern;
use crate::calibration::glare::GlareValues;
use crate::calibration::record::{
    FlatValues, Kind, LightsValues, ScaleValues, SensorValues, Values,
};
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, Loaded, RecordError, Seal};
use crate::capture::findings::Notice;
use crate::capture::prepare::sample_blur;
use crate::capture::reach::StageReach;
use crate::capture::records::Records;
use crate::config::stage::StageDriver;
use crate::config::{CameraDriver, Origin, ResolvedRig};
use crate::device::{DeviceError, discovery};
use crate::file_system::{self, Lack};
use crate::units::size;

/// Checks configuration, devices, permissions, disk and calibration
///
/// Nothing moves and no port is opened. Exit code 1 if a check fails; warnings don't count.
#[derive(clap::Args, Debug)]
pub struct DoctorArgs {
    #[command(flatten)]
    rig: RigArg,
    /// The checks as JSON
    #[arg(long)]
    json: bool,
}

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
enum Verdict {
    Ok,
    Warning,
    Failed,
}

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Check {
    name: &'static str,
    verdict: Verdict,
    fact: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    remedy: Option<String>,
}

#[derive(Serialize)]
struct Findings {
    verdict: Verdict,
    checks: Vec<Check>,
}

/// `rig doctor`.
pub fn run(args: &DoctorArgs, context: &Context) -> Result<(), CliError> {
    let rig = match args.rig.resolve(context) {
        Ok(rig) => rig,
        // Nothing else can be checked, so the command's own error says it all.
        Err(error) => {
            if args.json {
                let remedy = error.advice().unwrap_or_default();
                let check = Check::failed("configuration", error.fact(), remedy);
                report(vec![check], true)?;
            }
            return Err(error);
        }
    };
    let failed = report(all_checks(&rig), args.json)?;
    match failed {
        0 => Ok(()),
        1 => Err(CliError::new("1 check failed").hint(REMEDIES)),
        n => Err(CliError::new(format!("{n} checks failed")).hint(REMEDIES)),
    }
}

/// Where to look, once the checks are printed.
const REMEDIES: &str = "what to do stands after the arrow of each check above that FAILED";

/// Prints the checks and returns how many failed.
fn report(checks: Vec<Check>, json: bool) -> Result<usize, CliError> {
    let failed = |check: &&Check| check.verdict == Verdict::Failed;
    let failed = checks.iter().filter(failed).count();
    if json {
        let verdict = checks.iter().map(|check| check.verdict).max();
        let verdict = verdict.unwrap_or(Verdict::Ok);
        write_json(&Findings { verdict, checks })?;
    } else {
        checks.iter().try_for_each(print)?;
    }
    Ok(failed)
}

fn print(check: &Check) -> Result<(), CliError> {
    let verdict = match check.verdict {
        Verdict::Ok => "ok     ",
        Verdict::Warning => "warning",
        Verdict::Failed => "FAILED ",
    };
    write_line(format_args!("{verdict}  {:<14} {}", check.name, check.fact))?;
    if let Some(remedy) = &check.remedy {
        write_line(format_args!("{:24} -> {remedy}", ""))?;
    }
    Ok(())
}

impl Check {
    fn ok(name: &'static str, fact: impl Into<String>) -> Self {
        Self {
            name,
            verdict: Verdict::Ok,
            fact: fact.into(),
            remedy: None,
        }
    }

    fn warning(name: &'static str, fact: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Warning,
            remedy: Some(remedy.into()),
            ..Self::ok(name, fact)
        }
    }

    /// What a capture refuses, with the advice that it gives.
    fn refused(name: &'static str, error: &(dyn std::error::Error + 'static)) -> Self {
        let remedy = hints::for_error(error).unwrap_or_else(|| "calibrate anew".to_owned());
        Self::failed(name, error.to_string(), remedy)
    }

    fn failed(name: &'static str, fact: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Failed,
            ..Self::warning(name, fact, remedy)
        }
    }
}

fn all_checks(rig: &ResolvedRig) -> Vec<Check> {
    let mut checks = vec![configuration(rig), camera(rig), stage(rig)];
    checks.extend(watchdog(rig));
    checks.extend(lamp_report(rig));
    let sessions = Path::new(crate::session::layout::SESSIONS_FOLDER);
    let place = match sessions.is_dir() {
        true => sessions,
        false => Path::new("."),
    };
    checks.extend(folder(rig, place));
    let library = Library::of_rig(rig);
    checks.extend(calibrations(rig, &library));
    let view = verdict_on("view", preflight::outlook(&rig.config));
    let is_in_view = view.verdict != Verdict::Failed;
    checks.push(view);
    checks.push(light_paths(rig));
    checks.push(depth_of_field(rig, &library, is_in_view));
    checks
}

/// A check of the geometry: of what the camera sees, and of where light can come from.
fn verdict_on(name: &'static str, outlook: Result<Outlook, CliError>) -> Check {
    match outlook {
        Err(error) => {
            let remedy = error
                .advice()
                .unwrap_or("correct [geometry] in the rig file");
            Check::failed(name, error.fact(), remedy)
        }
        Ok(Outlook {
            fact,
            concern: None,
        }) => Check::ok(name, fact),
        Ok(Outlook {
            fact,
            concern: Some(concern),
        }) if concern.is_fatal => Check::failed(name, fact, concern.remedy),
        Ok(Outlook {
            fact,
            concern: Some(concern),
        }) => Check::warning(name, fact, concern.remedy),
    }
}

/// Whether the camera's body stands in the way of the lights.
fn light_paths(rig: &ResolvedRig) -> Check {
    let reach = StageReach::of_rig(&rig.config).map_err(CliError::from);
    let body = rig.config.geometry.camera_body;
    verdict_on(
        "light paths",
        reach.map(|reach| preflight::light_paths(&reach, body)),
    )
}

fn depth_of_field(rig: &ResolvedRig, library: &Library, is_in_view: bool) -> Check {
    let name = "depth of field";
    let named = rig.config.calibration.focus.as_deref();
    // A record that cannot be read has its own line.
    let focus = library.load::<FocusValues>(named).unwrap_or_default();
    let focus = focus.as_ref().map(|loaded| &loaded.record.values);
    let limit_px = rig.config.capture.blur_limit_px;
    match sample_blur(&rig.config, focus).map_err(CliError::from) {
        Err(error) => Check::warning(
            name,
            error.fact(),
            error.advice().unwrap_or("correct [geometry.sample]"),
        ),
        Ok(None) if is_in_view => Check::ok(name, "unlimited: no aperture is stated"),
        Ok(None) => Check::ok(name, "not checked: the camera doesn't see the sample"),
        Ok(Some(found)) if found.worst.disc_px > limit_px => {
            let concern = sharpness::concern(&found, limit_px);
            let fact = concern.strip_prefix("depth of field: ").unwrap_or(&concern);
            Check::warning(name, fact, sharpness::REMEDY)
        }
        Ok(Some(found)) => Check::ok(name, sharpness::ends(&found)),
    }
}

fn configuration(rig: &ResolvedRig) -> Check {
    let why = match rig.origin {
        Origin::Argument => "named by --rig",
        Origin::Environment => "named by RIG_CONFIG",
        Origin::WorkingFolder => "found in the working folder",
        Origin::Fallback => "the simulated rig stands in, because none is configured",
    };
    let check = Check::ok("configuration", format!("{} is valid ({why})", rig.file));
    let connected = discovery::usb_devices(Path::new("/"));
    if rig.config.is_simulated() && !connected.is_empty() {
        return Check::warning(
            "configuration",
            format!(
                "{}; connected but unused: {}",
                check.fact,
                connected.join(", ")
            ),
            "to use them, write a rig file (rig-configs/grbl-arm-v4l2.toml is a start) and name it with --rig",
        );
    }
    check
}

fn camera(rig: &ResolvedRig) -> Check {
    match &rig.config.camera.driver {
        CameraDriver::Simulated => Check::ok("camera", "simulated"),
        CameraDriver::V4l { .. } if !cfg!(feature = "v4l") => Check::failed(
            "camera",
            "this program was built without Video4Linux",
            "build it with the feature `v4l`",
        ),
        CameraDriver::V4l { device, .. } => device_file("camera", device, "/dev/v4l/by-id"),
        CameraDriver::Described { driver, setting } => match (driver.ready)(setting) {
            Ok(source) => Check::ok("camera", source),
            Err(error) => {
                let remedy = hints::for_error(&error).unwrap_or_default();
                Check::failed("camera", error.to_string(), remedy)
            }
        },
    }
}

fn stage(rig: &ResolvedRig) -> Check {
    let stage = &rig.config.stage;
    match stage.port() {
        None => Check::ok("stage", stage.driver_name()),
        Some(_) if !cfg!(feature = "serial") => Check::failed(
            "stage",
            "this program was built without serial ports",
            "build it with the feature `serial`",
        ),
        Some(port) => device_file("stage", port, "/dev/serial/by-id"),
    }
}

/// Whether a device file exists, may be opened, is free, and has a lasting name.
fn device_file(name: &'static str, path: &str, lasting: &str) -> Check {
    let file = Path::new(path);
    if let Some(error) = DeviceError::of_address(path) {
        let remedy = hints::for_error(&error).unwrap_or_default();
        return Check::failed(name, error.to_string(), remedy);
    }
    if !file.exists() {
        return Check::failed(
            name,
            format!("{path} does not exist"),
            "check the cable and the rig file; `rig devices` lists what is connected",
        );
    }
    if let Err(error) = access(file, Access::READ_OK | Access::WRITE_OK) {
        return Check::failed(
            name,
            format!("{path}: {}", std::io::Error::from(error)),
            "add yourself to the group that owns it (`sudo usermod -aG dialout,video $USER`) and log in again",
        );
    }
    if let Some(holder) = discovery::holder(file) {
        return Check::failed(
            name,
            format!("{path} is in use by {holder}"),
            "end that process first",
        );
    }
    if !path.starts_with(lasting) {
        return Check::warning(
            name,
            format!("{path} can be opened, but its name changes with the order of plugging in"),
            format!("name it by its link in {lasting}"),
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
    Some(Check::warning(
        "watchdog",
        format!("{fact}: the lamp stays on if the computer or the cable fails"),
        "fit a hardware emergency stop, and don't leave a capture alone with a lamp that can do harm",
    ))
}

/// A lamp whose state nothing reports: that it is off is sent and not verified.
fn lamp_report(rig: &ResolvedRig) -> Option<Check> {
    let who = match &rig.config.stage.driver {
        StageDriver::Manual(_) => "an operator switches the lamp",
        StageDriver::Dome(_) => "a DMX interface does not report its lights",
        _ => return None,
    };
    Some(Check::warning(
        "lamp off",
        format!("sent, not verified: {who}"),
        "look at the lamp before you reach into the bench",
    ))
}

/// Free space and speed of the disk that will hold the sessions, and what its file system
/// can do.
fn folder(rig: &ResolvedRig, folder: &Path) -> Vec<Check> {
    if let Err(error) = access(folder, Access::WRITE_OK) {
        return vec![Check::failed(
            "folder",
            format!(
                "the folder {} cannot be written: {}",
                folder.display(),
                std::io::Error::from(error)
            ),
            "run in another folder, or give `rig capture` one with --out",
        )];
    }
    let reserve = rig.config.capture.disk_reserve_bytes;
    let space = match file_system::free_bytes(folder) {
        Ok(u64::MAX) => Check::warning(
            "disk space",
            "the file system does not say how much is free",
            "see to it that there is enough: a capture cannot stop before the disk is full",
        ),
        Ok(free) => {
            let fact = format!("{} free, {} stay reserved", size(free), size(reserve));
            if free <= reserve {
                let remedy = "free some space, or lower capture.disk_reserve_mb in the rig file";
                Check::failed("disk space", fact, remedy)
            } else {
                Check::ok("disk space", fact)
            }
        }
        Err(error) => Check::failed("disk space", error.to_string(), "run in another folder"),
    };
    let speed = match write_rate_bytes_s(folder) {
        Ok(rate) => Check::ok("disk speed", format!("{}/s written and synced", size(rate))),
        Err(error) => Check::failed("disk speed", error.to_string(), "run in another folder"),
    };
    let mut checks = vec![file_system_of(folder), space, speed];
    checks.extend(files(folder));
    checks
}

/// Whether the files of a capture can be made, where the file system says.
fn files(folder: &Path) -> Option<Check> {
    /// Of a capture of one light.
    const FEW: u64 = 100;
    let free = file_system::free_files(folder).ok()??;
    let fact = format!("{free} more can be made");
    Some(match free {
        ..FEW => Check::failed(
            "files",
            fact,
            "remove some files there (`df -i` counts them), or give `rig capture` another disk with --out",
        ),
        _ => Check::ok("files", fact),
    })
}

/// Whether a session can be written as it should be: tried with a file that goes again.
fn file_system_of(folder: &Path) -> Check {
    let name = "file system";
    match file_system::probe(folder) {
        Err(error) => {
            let remedy = hints::for_error(&error).unwrap_or_else(|| {
                "run in another folder, or give `rig capture` one with --out".to_owned()
            });
            let fact = format!("no session can be kept in {}: {error}", folder.display());
            Check::failed(name, fact, remedy)
        }
        Ok(lacks) if lacks.is_empty() => Check::ok(
            name,
            "locks, confirms what is on the medium, and replaces files",
        ),
        Ok(lacks) => {
            let lacks: Vec<String> = lacks.iter().map(Lack::to_string).collect();
            Check::warning(
                name,
                format!("that of {} {}", folder.display(), lacks.join("; it ")),
                "sessions work there with that; for all of it, put them on a local disk (`rig capture --out`)",
            )
        }
    }
}

/// Writes and syncs a few megabytes as a capture would.
fn write_rate_bytes_s(folder: &Path) -> std::io::Result<u64> {
    const BLOCKS: usize = 8;
    let block = vec![0x5a; 1 << 20];
    // Closed before it is removed, which not every file system does with an open one.
    let file = tempfile::Builder::new()
        .prefix(".rig-speed-")
        .suffix(file_system::PART)
        .tempfile_in(folder)?;
    let (mut file, path) = file.into_parts();
    // Else another program might take it for what a killed one has left.
    let _ = file.try_lock();
    let start = Instant::now();
    for _ in 0..BLOCKS {
        file.write_all(&block)?;
    }
    file_system::sync_file(&file, &path)?;
    let rate = (BLOCKS * block.len()) as f64 / start.elapsed().as_secs_f64().max(1e-9);
    drop(file);
    path.close()?;
    Ok(rate as u64)
}

/// What a kind of record is called, and what its lack means.
fn named(kind: Kind) -> (&'static str, &'static str) {
    match kind {
        Kind::Sensor => ("sensor", "a capture needs it"),
        Kind::Flat => ("flat", "without it every pixel counts as equally sensitive"),
        Kind::Scale => (
            "scale",
            "without it radiances are relative, per unit irradiance",
        ),
        Kind::Lights => (
            "lights",
            "without it the rig file's irradiance_w_m2 is used",
        ),
        Kind::Directions => (
            "directions",
            "without it the rig file's light directions are used",
        ),
        Kind::Response => (
            "response",
            "without it counts are taken as proportional to light",
        ),
        Kind::Focus => (
            "focus",
            "without it the rig file's point spread, focus and aperture are used",
        ),
        Kind::Pose => ("pose", "without it the sample lies as the rig file states"),
        Kind::Glare => ("glare", "without it the lens is taken to scatter no light"),
        Kind::Camera => ("lens", "without it the lens is as the rig file states"),
        Kind::Lamp => ("lamp", "without it nobody knows how long it must warm up"),
    }
}

/// The records of the bench, judged as a capture judges them.
fn calibrations(rig: &ResolvedRig, library: &Library) -> Vec<Check> {
    let (ids, gain) = (&rig.config.calibration, rig.config.camera.gain);
    let mut checks = vec![
        record::<SensorValues>(rig, library.load_for(ids.sensor.as_deref(), gain), library),
        record::<FlatValues>(rig, library.load_for(ids.flat.as_deref(), gain), library),
        record::<ScaleValues>(rig, library.load_for(ids.scale.as_deref(), gain), library),
        record::<LightsValues>(rig, library.load(ids.lights.as_deref()), library),
        record::<DirectionsValues>(rig, library.load(ids.directions.as_deref()), library),
        record::<CameraValues>(rig, library.load(ids.camera.as_deref()), library),
        record::<FocusValues>(rig, library.load(ids.focus.as_deref()), library),
    ];
    let glare = library.load::<GlareValues>(ids.glare.as_deref());
    // A simulated lens may have none.
    if !rig.config.is_simulated() || !matches!(glare, Ok(None)) {
        checks.push(record::<GlareValues>(rig, glare, library));
    }
    // A record that cannot be used has its own line.
    let Ok(records) = Records::load(library, &rig.config) else {
        return checks;
    };
    if let Err(error) = records.noise(&rig.config) {
        checks[0] = Check::refused(named(Kind::Sensor).0, &error);
    }
    records.check(&rig.config, Timestamp::now(), &mut |notice| {
        if let Notice::WarmUp { .. } = notice {
            let (fact, remedy) = described(&notice);
            let name = named(Kind::Lamp).0;
            checks.push(Check::warning(name, fact, remedy.unwrap_or_default()));
        }
    });
    checks
}

fn record<V: Values>(
    rig: &ResolvedRig,
    loaded: Result<Option<Loaded<V>>, RecordError>,
    library: &Library,
) -> Check {
    let (name, without) = named(V::KIND);
    let loaded = match loaded {
        Err(error) => return Check::refused(name, &error),
        Ok(None) => {
            let fact = format!("no record in {}: {without}", library.place());
            let remedy = format!("run `rig calibrate {}`", V::KIND.command());
            return Check::warning(name, fact, remedy);
        }
        Ok(Some(loaded)) => loaded,
    };
    let serial = rig.config.camera.serial.as_deref().unwrap_or_default();
    let is_simulated = rig.config.is_simulated();
    let concerns = loaded.concerns_on(is_simulated, serial, &rig.config.camera, Timestamp::now());
    match concerns.into_iter().next() {
        Some(Concern::Other(error)) => return Check::refused(name, &error),
        Some(concern) => {
            let fact = concern.to_string();
            let kind = V::KIND;
            let (_, remedy) = described(&Notice::Record { kind, concern });
            return Check::warning(name, fact, remedy.unwrap_or_default());
        }
        None => {}
    }
    let unsealed = match loaded.seal {
        Seal::Missing => "; it has no checksum, so a change would not be noticed",
        _ => "",
    };
    let record = &loaded.record;
    let fact = format!("record {} of {}{unsealed}", record.id, record.date);
    Check::ok(name, fact)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RigConfig;

    #[test]
    fn the_watchdog_is_that_of_the_protocol() {
        let check = |text: &str| {
            let config = RigConfig::parse("rig.toml", Path::new(""), text).unwrap();
            watchdog(&ResolvedRig {
                config,
                origin: Origin::Argument,
                file: "rig.toml".to_owned(),
                folder: None,
            })
        };
        let dmx = include_str!("../../rig-configs/dmx-dome-v4l2.toml");
        for (text, verdict, fact) in [
            (
                include_str!("../../rig-configs/grbl-arm-v4l2.toml"),
                Verdict::Warning,
                "stock GRBL has none",
            ),
            (
                include_str!("../../rig-configs/zaber-gantry-v4l2.toml"),
                Verdict::Warning,
                "Zaber's protocol has none",
            ),
            (dmx, Verdict::Warning, "a DMX interface has none"),
        ] {
            let check = check(text).unwrap();
            assert_eq!(check.verdict, verdict, "{fact}");
            assert!(check.fact.starts_with(fact), "{}", check.fact);
        }
        assert!(check(crate::config::BUILT_IN[0].1).is_none());
    }

    #[test]
    fn a_device_file_is_missing_then_unlasting_then_in_use() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ttyUSB0");
        let name = path.display().to_string();
        let verdict = |lasting: &str| device_file("stage", &name, lasting);
        assert!(verdict("/dev").fact.contains("does not exist"));
        let network = device_file("stage", "bench:23", "/dev");
        assert!(
            network
                .remedy
                .is_some_and(|remedy| remedy.contains("tcp:bench:23"))
        );
        std::fs::write(&path, "").unwrap();
        assert_eq!(verdict("/dev/serial/by-id").verdict, Verdict::Warning);
        assert_eq!(verdict("/").verdict, Verdict::Ok);
        let open = std::fs::File::open(&path).unwrap();
        let fact = verdict("/").fact;
        assert!(
            fact.contains(&format!("in use by process {}", std::process::id())),
            "{fact}"
        );
        drop(open);
    }
}
