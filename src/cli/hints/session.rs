//! Advice on captures, sessions, fits and calibration records.

use super::{EXPLAINED, for_device, for_exr, for_io};
use crate::calibration::RecordError;
use crate::capture::CaptureError;
use crate::radiometry::exposure::PlanError;
#[cfg(feature = "reports")]
use crate::report::load::LoadError;
use crate::session::SessionError;
use crate::session::archive::ArchiveError;
use crate::session::fit_record::FitRecordError;

const FOR_NO_MORE_FILES: &str = "remove some files there, of any size (`df -i` counts them), or choose another disk with --out; nothing that was journalled is lost";

pub(super) fn for_session(error: &SessionError) -> Option<String> {
    use SessionError::*;
    Some(match error {
        Exists { .. } => "nothing was overwritten; choose another folder or name".into(),
        NotASession { .. } => "name the session's own folder, the one with session.toml in it; `rig catalogue DIR` lists those of a folder".into(),
        DiskFull { .. } => {
            "nothing that was journalled is lost; free some space and try again".into()
        }
        NoMoreFiles { .. } => FOR_NO_MORE_FILES.into(),
        OverQuota { .. } => {
            "nothing that was journalled is lost; remove some of your files there (`quota` lists what counts), or use another disk, and try again".into()
        }
        // Of other sources than the system, it means that the path is no regular file.
        Io { source, .. } if source.raw_os_error().is_some() || source.kind() != std::io::ErrorKind::InvalidInput => return for_io(source),
        Link { .. } => {
            "put a copy of what it leads to in the link's place, so that the session holds its own files: `rig session verify` then checks them".into()
        }
        NotCaptured { .. } => "`rig capture --resume SESSION` captures the rest; then fit".into(),
        Value { .. } => "the plan was changed since it was written: restore session.toml from a backup, or start a new session".into(),
        Io { .. } | Checksum { .. } | Length { .. } | Missing { .. } | Malformed { .. } | CorruptJournal { .. } => {
            "the session was changed or damaged: `rig session verify` lists every such file; restore them from a backup".into()
        }
        Locked { .. } => "wait until the other capture has ended, or end it".into(),
        SampleName { .. } => "choose a name such as `red-plastic_01`".into(),
        FrameTaken { .. } => "start a new session, or `rig capture --resume` this one".into(),
    })
}

pub(super) fn for_archive(error: &ArchiveError) -> Option<String> {
    use ArchiveError::*;
    match error {
        Session(error) => for_session(error),
        Refused { .. } => Some("it was damaged, changed or made by another program: copy it again, or let `rig session pack` make it anew; a folder needs no unpacking".into()),
        Unpackable { .. } => Some("copy the session's folder itself".into()),
        Inside { .. } => Some("choose a place outside the session with --out".into()),
        Io { source, .. } => for_io(source),
    }
}

pub(super) fn for_capture(error: &CaptureError) -> Option<String> {
    use CaptureError::*;
    Some(match error {
        Device(error) => for_device(error),
        Session(error) => return for_session(error),
        Exposure(PlanError::OutOfRange { .. }) => EXPLAINED.into(),
        Exposure(PlanError::TooBright { .. }) => "dim the lamp or close the aperture, or lower capture.shortest_ms in the rig file if the camera can do less".into(),
        LightOutOfReach { .. } => "choose fewer or other lights, or correct the limits in the rig file's [stage] table".into(),
        LightBlocked { .. } => "take a direction that is free (`--lights N` plans only such), or correct [geometry.camera] body in the rig file; leave `body` out where the light comes through the lens or a beam splitter".into(),
        TooManyLights { reachable: 0, .. } => "correct [geometry.camera] body, or the limits in the rig file's [stage] table".into(),
        TooManyLights { reachable, .. } => format!("ask for at most {reachable}, or `--lights all`"),
        Empty { .. } => "ask for at least one light, e.g. `--lights 4`".into(),
        NotEnoughSpace { .. } => "free some space, choose another disk with --out, or ask for fewer lights".into(),
        NotEnoughFiles { .. } => FOR_NO_MORE_FILES.into(),
        LowDisk { .. } => "nothing that was journalled is lost; free some space".into(),
        LampDrift { .. } => "let the lamp warm up (capture.lamp_warm_up_s in the rig file) and check its supply; if it doesn't come back to what it was, start a new session".into(),
        LightMoved { .. } | NotAsBefore { .. } => "resume once more, which homes the stage again; `rig stage repeatability` shows how well it finds its switches; if the sample was touched or the stage repeats no better, start a new session".into(),
        TooHot { .. } => "let it cool down (the lamp is off) and resume; improve the cooling, or correct the [limits] in a new session's rig file".into(),
        OtherCamera { .. } => "connect the camera that the session was begun with, or start a new session".into(),
        ExposureNotApplied { .. } => "raise camera.settings_latency_frames in the rig file; check that the camera is in manual mode and the lamp doesn't flicker".into(),
        NoLight { .. } => "check the lamp's power and cable, the lens cap, and that the stage points at the sample".into(),
        AllSaturated { .. } => "dim the lamp or close the aperture; a camera that ignores its exposure does the same: compare `rig camera grab` at two exposures".into(),
        OtherFrame { .. } => "the session was changed since it was captured; start a new one".into(),
        NotStopped { .. } => "use the emergency stop and look whether the lamp is on; check the stage's cable and power".into(),
        Interrupted | StoppedNow => "`rig capture --resume SESSION` continues it".into(),
        Choice { .. } | Merge { .. } | Thread(_) | WorkerGone { .. } => return None,
    })
}

#[cfg(feature = "reports")]
pub(super) fn for_loading(error: &LoadError) -> Option<String> {
    use LoadError::*;
    match error {
        Session(error) => for_session(error),
        Fit(error) => for_fit_record(error),
        Brdf(error) => super::for_brdf(error),
        Image(error) => for_exr(error),
        Sidecar { .. } => Some("`rig session verify` lists every damaged file".into()),
        // `rig report` says what to do.
        OtherSession { .. } => None,
        NoSuchFit { .. } => {
            Some("`rig fit SESSION` makes one; without --fit the newest is taken".into())
        }
    }
}

pub(super) fn for_fit_record(error: &FitRecordError) -> Option<String> {
    use FitRecordError::*;
    match error {
        Io { source, .. } => for_io(source),
        Exists { .. } => Some("nothing was overwritten; choose another folder".into()),
        NoFit { .. } => Some(
            "give the folder that `rig fit --out` wrote, or a session that `rig fit` has fitted"
                .into(),
        ),
        Syntax { .. } | Table { .. } | Value { .. } => {
            Some("the fit was changed by hand or damaged; fit again".into())
        }
        NotVouchedFor { .. } => Some("`rig fit SESSION` makes a fit that is journalled".into()),
        Session(error) => for_session(error),
        Image(error) => for_exr(error),
    }
}

pub(super) fn for_record(error: &RecordError) -> String {
    use RecordError::*;
    match error {
        Io { .. } => "check the path and the permissions of the calibration folder".into(),
        NotFound { .. } => "correct the id in the rig file's [calibration] table, or remove it to use the newest record".into(),
        Syntax { .. } | Invalid { .. } | Checksum { .. } => {
            "the record was changed or damaged: restore it from a backup, or calibrate anew and remove it".into()
        }
        Mismatch { kind, .. } => format!(
            "run `rig calibrate {}` with this device at these settings, or name a record that belongs to them in the rig file's [calibration] table",
            kind.command()
        ),
        Exists { .. } => "give the new record another id".into(),
    }
}
