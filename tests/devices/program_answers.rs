//! What a camera's program reports with each frame, through whole captures: the rows of
//! "A program that answers" in docs/faults.md. The answers' own form is tested in
//! `command_camera`, and by the program in `tests/outside/programs/answers`.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex};

use crate::camera_support::documented_faults;
use crate::capture_support::*;
use rig::capture::{CaptureError, Outcome};
use rig::device::described::{DescribedCamera, FrameSource, Taken, Wanted};
use rig::device::retake::{FrameFault, Retakes};
use rig::device::*;
use rig::session::faults::UnsyncedDisk;
use rig::session::{Session, SessionRecord, SessionWriter, Sidecar};
use rig::units::Seconds;

/// Every exposure is longer than requested by this, less than the rig file's step of 0.1 ms:
/// at the shortest exposures that is far beyond what a capture accepts unseen.
const LONGER_S: f64 = 4e-5;
const SERIAL: &str = "A 3";
/// The frame at which something goes wrong, from 1.
const AT: u32 = 9;

type Answer = Result<Stated, AnswerFault>;
type Wrong = fn(Stated) -> Answer;

/// From this frame on, so many frames are answered thus.
#[derive(Clone, Copy)]
struct Fault(u32, u32, Wrong);

/// The camera of the bench in memory, which reports what each frame had.
#[derive(Clone)]
struct Answering {
    camera: Arc<Mutex<(Box<dyn Camera>, u32)>>,
    fault: Option<Fault>,
}

impl FrameSource for Answering {
    const SENT: &'static str = "a request for a frame";

    fn name(&self) -> String {
        "./photo".to_owned()
    }

    fn take(&self, wanted: &Wanted) -> Result<Taken, DeviceError> {
        let (camera, taken) = &mut *self.camera.lock().unwrap();
        let exposure = Seconds(wanted.settings.exposure.0 + LONGER_S);
        let gain = wanted.settings.gain;
        camera.configure(CameraSettings { exposure, gain })?;
        let key = |repeat| FrameKey {
            light: 0,
            exposure: 0,
            repeat,
            kind: FrameKind::Light,
        };
        // The bench in memory has its settings two frames late.
        for _ in 0..2 {
            camera.grab(key(*taken))?;
        }
        let frame = camera.grab(key(*taken))?;
        *taken += 1;
        let stated = Stated {
            exposure: Some(exposure),
            gain: Some(gain),
            serial: Some(SERIAL.to_owned()),
            sensor_c: Some(30.0 + 0.01 * f64::from(*taken)),
        };
        let answer = match self.fault {
            Some(Fault(from, frames, wrong))
                if (from..from.saturating_add(frames)).contains(taken) =>
            {
                wrong(stated)
            }
            _ => Ok(stated),
        };
        match answer {
            Ok(stated) => Ok(Taken { frame, stated }),
            Err(fault) => Err(DeviceError::Answer {
                program: self.name(),
                fault,
            }),
        }
    }
}

/// Without a serial number in the rig file.
fn info() -> CameraInfo {
    CameraInfo {
        serial: String::new(),
        ..camera_info()
    }
}

fn record_of_it() -> SessionRecord {
    let mut record = record();
    record.versions.camera = info();
    // A frame that is requested with its settings has no older ones.
    record.plan.settings_latency_frames = 0;
    record
}

fn capture_it(
    fault: Option<Fault>,
    session: SessionWriter,
) -> (Bench, Result<Outcome, CaptureError>, Vec<String>) {
    let bench = Bench::new();
    let camera = Arc::new(Mutex::new((camera_in_memory(&bench), 0)));
    let source = Answering { camera, fault };
    let camera = DescribedCamera::new(source, info(), Seconds(20.0));
    let (result, heard) = capture_with_camera(&bench, Box::new(camera), session);
    (bench, result, heard.warnings)
}

fn begin(parent: &Path) -> SessionWriter {
    create_from(Arc::new(UnsyncedDisk), parent, &record_of_it()).unwrap()
}

fn sidecars(root: &Path) -> Vec<Sidecar> {
    let session = Session::open(root).unwrap();
    let read = |entry| session.read_frame(&entry).unwrap().1;
    session.frames().map(read).collect()
}

fn assert_as_reported(name: &str, sidecars: &[Sidecar]) {
    assert!(!sidecars.is_empty(), "{name}");
    for sidecar in sidecars {
        let (is, wanted) = (sidecar.applied.exposure.0, sidecar.requested.exposure.0);
        assert!((is - wanted - LONGER_S).abs() < 1e-9, "{name}: {sidecar:?}");
        assert_eq!(sidecar.camera_serial, SERIAL, "{name}");
        let sensor_c = sidecar.time.sensor_c.unwrap();
        assert!((30.0..31.5).contains(&sensor_c), "{name}: {sensor_c}");
    }
}

#[test]
fn sidecars_state_what_the_program_reported() {
    let parent = tempfile::tempdir().unwrap();
    let session = begin(parent.path());
    let root = session.root().to_owned();
    let (bench, result, warnings) = capture_it(None, session);
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert_eq!(warnings, [""; 0]);
    assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0));
    let sidecars = sidecars(&root);
    assert_as_reported("undisturbed", &sidecars);
    // Several exposures were compared with each other: they are what was reported.
    let ratios: Vec<f64> = sidecars.iter().filter_map(|s| s.exposure_ratio).collect();
    assert!(!ratios.is_empty());
    for ratio in ratios {
        assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
    }
}

fn other_exposure(stated: Stated) -> Answer {
    let exposure = Some(Seconds(0.333));
    Ok(Stated { exposure, ..stated })
}

fn other_gain(stated: Stated) -> Answer {
    let gain = Some(2.0);
    Ok(Stated { gain, ..stated })
}

fn other_serial(stated: Stated) -> Answer {
    let serial = Some("B 7".to_owned());
    Ok(Stated { serial, ..stated })
}

fn malformed(_: Stated) -> Answer {
    Err(AnswerFault::Malformed("EOF".to_owned()))
}

#[test]
fn an_answer_that_is_wrong_for_a_while_costs_frames_alone() {
    for (name, wrong) in [
        ("another exposure", other_exposure as Wrong),
        ("another gain", other_gain),
    ] {
        let parent = tempfile::tempdir().unwrap();
        let session = begin(parent.path());
        let root = session.root().to_owned();
        let (bench, result, warnings) = capture_it(Some(Fault(AT, 3, wrong)), session);
        assert_eq!(result.unwrap(), Outcome::Complete, "{name}");
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0), "{name}");
        let sidecars = sidecars(&root);
        assert_as_reported(name, &sidecars);
        let mut retakes = Retakes::default();
        sidecars
            .iter()
            .for_each(|sidecar| retakes.add(sidecar.time.retakes));
        let wanted = Retakes {
            exposure_ignored: 3,
            ..Retakes::default()
        };
        assert_eq!(retakes, wanted, "{name}");
        assert_eq!(warnings.len(), 1, "{name}: {warnings:?}");
    }
}

type Check = fn(&CaptureError) -> bool;

fn is_of_settings(error: &CaptureError) -> bool {
    let CaptureError::Device(DeviceError::BadFrame { fault, .. }) = error else {
        return false;
    };
    matches!(fault, FrameFault::Settings { .. })
}

/// Answers that stay wrong, and the error that they end with.
const LASTING: [(&str, Wrong, Check); 4] = [
    (
        "another exposure than requested, beyond `step_ms`",
        other_exposure,
        is_of_settings,
    ),
    (
        "another gain than requested, beyond 1%",
        other_gain,
        is_of_settings,
    ),
    ("another serial number", other_serial, |error| {
        matches!(error, CaptureError::Device(DeviceError::OtherCamera { .. }))
    }),
    (
        "malformed JSON, an unknown key, a number out of range",
        malformed,
        |error| matches!(error, CaptureError::Device(DeviceError::Answer { .. })),
    ),
];

#[test]
fn an_answer_that_stays_wrong_ends_with_the_lamp_off_and_a_session_that_resumes() {
    for (name, wrong, is_expected) in LASTING {
        let parent = tempfile::tempdir().unwrap();
        let session = begin(parent.path());
        let root = session.root().to_owned();
        let (bench, result, _) = capture_it(Some(Fault(AT, u32::MAX, wrong)), session);
        let error = result.unwrap_err();
        assert!(is_expected(&error), "{name}: {error}");
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 1), "{name}");
        let kept = sidecars(&root);
        assert_as_reported(name, &kept);
        let session = SessionWriter::resume(Arc::new(UnsyncedDisk), &root).unwrap();
        let (_, result, _) = capture_it(None, session);
        assert_eq!(result.unwrap(), Outcome::Complete, "{name}");
        let whole = sidecars(&root);
        assert_eq!(&whole[..kept.len()], kept, "{name}: no frame is lost");
        assert_as_reported(name, &whole);
    }
}

const ON_RESUME: &str = "another serial number when a session is resumed";

#[test]
fn a_session_is_not_resumed_with_another_camera() {
    let parent = tempfile::tempdir().unwrap();
    let session = begin(parent.path());
    let root = session.root().to_owned();
    let (_, result, _) = capture_it(Some(Fault(AT, u32::MAX, malformed)), session);
    assert!(result.is_err());
    let kept = sidecars(&root);
    let session = SessionWriter::resume(Arc::new(UnsyncedDisk), &root).unwrap();
    let (bench, result, _) = capture_it(Some(Fault(1, u32::MAX, other_serial)), session);
    let error = result.unwrap_err();
    let is_other = matches!(
        &error,
        CaptureError::OtherCamera { what: "serial number", found, expected }
            if (found.as_str(), expected.as_str()) == ("B 7", SERIAL)
    );
    assert!(is_other, "{error}");
    assert_eq!(bench.world().lamp, LampState::Off);
    assert_eq!(sidecars(&root), kept);
}

#[test]
fn the_table_in_the_docs_has_these_rows() {
    let rows: BTreeSet<&str> = documented_faults("A program that answers").collect();
    let cases = LASTING.iter().map(|(name, ..)| *name).chain([ON_RESUME]);
    assert_eq!(rows, cases.collect());
}
