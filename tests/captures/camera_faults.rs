//! The camera's rows of the fault matrix (docs/faults.md), each scripted on the
//! simulated camera in the middle of a capture.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::camera_support::documented_faults;
use crate::capture_support::*;
use mock_devices::bench::{Bench as MockBench, BenchConfig};
use mock_devices::camera::{CameraConfig, CameraFaults, Failures, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};
use rig::capture::{CaptureError, Outcome};
use rig::device::retake::Retakes;
use rig::device::simulated_camera::SimulatedCamera;
use rig::device::{Camera, CameraSettings, DeviceError, FrameKey, LampChannel, LampState, Mosaic};
use rig::session::faults::UnsyncedDisk;
use rig::session::{Session, SessionWriter, Sidecar};
use rig::units::Seconds;

type Fault = fn(&mut Failures);

/// A grey wedge under the lamp of the bench in memory; at one of its frames
/// something goes wrong.
struct Wedge {
    bench: Bench,
    faults: Mutex<Option<(u32, Fault, CameraFaults)>>,
    frames: AtomicU32,
}

impl RadianceSource for Wedge {
    fn resolution_px(&self) -> [u32; 2] {
        [SIZE, SIZE]
    }

    fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
        let frame = self.frames.fetch_add(1, Ordering::Relaxed);
        if let Some((at, fault, faults)) = &*self.faults.lock().unwrap()
            && frame == *at
        {
            fault(&mut faults.now());
        }
        let power = match self.bench.world().lamp {
            LampState::Off => 0.0,
            LampState::On(LampChannel(channel)) => [0.4, 0.12][usize::from(channel)],
        };
        let pixels = SIZE * SIZE;
        let radiance = |pixel: u32| 2e-5 + power * (pixel + 1) as f32 / pixels as f32;
        Arc::new((0..pixels).map(radiance).collect())
    }
}

/// A camera with the calibration's noise and no flaws of single pixels. With a
/// fault it goes wrong at this frame that shows the scene.
fn camera(bench: &Bench, fault: Option<(u32, Fault)>) -> SimulatedCamera {
    let sensor = SensorConfig {
        dark_current_e_s: 1.0,
        dsnu_e_s: 0.0,
        offset_dsnu_e: 0.0,
        prnu: 0.0,
        read_noise_e: 2.5,
        gain_dn_per_e: 0.4,
        hot_fraction: 0.0,
        ..SensorConfig::typical([SIZE, SIZE], 1)
    };
    let config = CameraConfig {
        exposure_range_s: [1e-4, 1.0],
        exposure_step_s: 1e-4,
        ..CameraConfig::default()
    };
    let wedge = Arc::new(Wedge {
        bench: bench.clone(),
        faults: Mutex::default(),
        frames: AtomicU32::new(0),
    });
    let stand = MockBench::new(BenchConfig::default(), Clock::instant());
    let mock = MockCamera::new(config, stand, SensorModel::new(sensor), wedge.clone());
    let faults = mock.faults();
    if let Some((at, fault)) = fault {
        *wedge.faults.lock().unwrap() = Some((at, fault, faults));
    }
    SimulatedCamera::new(mock, "M-1".into(), Mosaic::None)
}

type Frames = BTreeMap<FrameKey, (Vec<u16>, Sidecar)>;

fn frames(root: &Path) -> Frames {
    let session = Session::open(root).unwrap();
    let read = |entry| {
        let (frame, sidecar) = session.read_frame(&entry).unwrap();
        (entry.key, (frame.counts, sidecar))
    };
    session.frames().map(read).collect()
}

/// What the sidecars say went wrong.
fn retakes(frames: &Frames) -> Retakes {
    let mut all = Retakes::default();
    for (_, sidecar) in frames.values() {
        all.add(sidecar.time.retakes);
    }
    all
}

fn assert_same_frames(name: &str, found: &Frames, expected: &Frames) {
    assert!(found.keys().eq(expected.keys()), "{name}");
    for (key, (counts, sidecar)) in found {
        let (expected_counts, expected) = &expected[key];
        assert!(counts == expected_counts, "{name}: {key:?}");
        assert_eq!(sidecar.applied, expected.applied, "{name}: {key:?}");
    }
}

fn undisturbed() -> Frames {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::new();
    let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
    let root = session.root().to_owned();
    let (result, heard) = capture_with_camera(&bench, Box::new(camera(&bench, None)), session);
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert_eq!(heard.warnings, [""; 0]);
    let frames = frames(&root);
    assert!(retakes(&frames).is_none());
    frames
}

/// Faults that pass, and what the sidecars say of them.
const PASSING: [(&str, Fault, Retakes); 8] = [
    (
        "frames dropped",
        |camera| camera.lost = 3,
        Retakes { dropped: 3, ..NONE },
    ),
    (
        "frame damaged",
        |camera| camera.corrupt = 2,
        Retakes { damaged: 2, ..NONE },
    ),
    (
        "frame short",
        |camera| camera.truncated = 1,
        Retakes {
            wrong_size: 1,
            ..NONE
        },
    ),
    (
        "frame of the wrong size",
        |camera| camera.resized = 3,
        Retakes {
            wrong_size: 3,
            ..NONE
        },
    ),
    (
        "frame late",
        |camera| camera.late = 2,
        Retakes { late: 2, ..NONE },
    ),
    (
        "no frame",
        |camera| camera.stalled = 1,
        Retakes { missing: 1, ..NONE },
    ),
    (
        "exposure ignored",
        |camera| camera.ignored_settings = 1,
        Retakes {
            exposure_ignored: 1,
            ..NONE
        },
    ),
    (
        GONE_AND_BACK,
        |camera| camera.is_disconnected = true,
        Retakes {
            reconnected: 1,
            ..NONE
        },
    ),
];

const GONE_AND_BACK: &str = "camera gone and back";

const NONE: Retakes = Retakes {
    dropped: 0,
    damaged: 0,
    wrong_size: 0,
    late: 0,
    missing: 0,
    exposure_ignored: 0,
    reconnected: 0,
};

/// The frame of the scene at which things go wrong: in the first light's bracket.
const AT: u32 = 20;

#[test]
fn what_passes_is_taken_again_counted_and_told() {
    let expected = undisturbed();
    for (name, fault, wanted) in PASSING {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::new();
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let mut camera = camera(&bench, Some((AT, fault)));
        let faults = camera.faults();
        let done = Arc::new(AtomicU32::new(0));
        let replugged = (name == GONE_AND_BACK).then(|| {
            camera.wait_for_return(Seconds(60.0));
            let (bench, done) = (bench.clone(), done.clone());
            std::thread::spawn(move || {
                // The warning comes when the lamp is about to go off.
                while !faults.now().is_disconnected && done.load(Ordering::Relaxed) == 0 {
                    std::thread::sleep(Duration::from_millis(2));
                }
                std::thread::sleep(Duration::from_millis(100));
                let lamp = bench.world().lamp;
                *faults.now() = Failures::default();
                lamp
            })
        });
        let (result, heard) = capture_with_camera(&bench, Box::new(camera), session);
        done.store(1, Ordering::Relaxed);
        assert_eq!(result.unwrap(), Outcome::Complete, "{name}");
        if let Some(thread) = replugged {
            assert_eq!(thread.join().unwrap(), LampState::Off, "while it is away");
        }
        let found = frames(&root);
        assert_eq!(retakes(&found), wanted, "{name}");
        assert_same_frames(name, &found, &expected);
        let told = |text: &&String| text.contains(&wanted.to_string());
        assert_eq!(
            heard.warnings.iter().filter(told).count(),
            1,
            "{name}: {:?}",
            heard.warnings
        );
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 0), "{name}");
    }
}

type Check = fn(&CaptureError) -> bool;

/// Faults that stay, and the error that they end with.
const LASTING: [(&str, Fault, Check); 4] = [
    (
        "frames damaged for good",
        |camera| camera.corrupt = u32::MAX,
        |error| matches!(error, CaptureError::Device(DeviceError::BadFrame { .. })),
    ),
    (
        "no frame for good",
        |camera| camera.stalled = u32::MAX,
        |error| matches!(error, CaptureError::Device(DeviceError::NoReply { .. })),
    ),
    (
        "exposure ignored for good",
        |camera| camera.ignored_settings = u32::MAX,
        |error| matches!(error, CaptureError::ExposureNotApplied { .. }),
    ),
    (
        "camera gone for good",
        |camera| camera.is_disconnected = true,
        |error| {
            matches!(
                error,
                CaptureError::Device(DeviceError::Disconnected { .. })
            )
        },
    ),
];

#[test]
fn what_stays_ends_with_the_lamp_off_and_a_session_that_resumes() {
    let expected = undisturbed();
    for (name, fault, is_expected) in LASTING {
        let parent = tempfile::tempdir().unwrap();
        let bench = Bench::new();
        let session = create(Arc::new(UnsyncedDisk), parent.path()).unwrap();
        let root = session.root().to_owned();
        let mut broken = camera(&bench, Some((AT, fault)));
        broken.wait_for_return(Seconds(0.1));
        let (result, _) = capture_with_camera(&bench, Box::new(broken), session);
        let error = result.unwrap_err();
        assert!(is_expected(&error), "{name}: {error}");
        assert_eq!(bench.lamp_and_stops(), (LampState::Off, 1), "{name}");
        let kept = frames(&root);
        assert!(!kept.is_empty(), "{name}");
        for (key, (counts, _)) in &kept {
            assert!(*counts == expected[key].0, "{name}: {key:?}");
        }
        let session = SessionWriter::resume(Arc::new(UnsyncedDisk), &root).unwrap();
        let bench = Bench::new();
        let (result, _) = capture_with_camera(&bench, Box::new(camera(&bench, None)), session);
        assert_eq!(result.unwrap(), Outcome::Complete, "{name}");
        assert_same_frames(name, &frames(&root), &expected);
    }
}

const FROM_THE_START: &str = "exposure ignored from the start";

/// A capture that needs one exposure alone, so that no two frames of a light
/// differ in theirs: a camera that stays at `stuck_s` whatever it confirms.
fn one_exposure(stuck_s: Option<f64>) -> (Result<Outcome, CaptureError>, Vec<String>, Frames) {
    let parent = tempfile::tempdir().unwrap();
    let bench = Bench::new();
    let mut record = record();
    let exposure = &mut record.plan.exposure;
    exposure.longest_s = exposure.pilot_s;
    exposure.dark_snr = 1.0;
    let session = create_from(Arc::new(UnsyncedDisk), parent.path(), &record).unwrap();
    let root = session.root().to_owned();
    let mut camera = camera(&bench, None);
    if let Some(stuck_s) = stuck_s {
        let settings = CameraSettings::new(Seconds(stuck_s), 1.0);
        camera.configure(settings).unwrap();
        let faults = camera.faults();
        faults.now().ignored_settings = u32::MAX;
    }
    let (result, heard) = capture_with_camera(&bench, Box::new(camera), session);
    assert_eq!(bench.world().lamp, LampState::Off);
    (result, heard.warnings, frames(&root))
}

#[test]
fn a_camera_that_never_obeys_is_found_where_one_exposure_is_enough() {
    let (result, warnings, frames) = one_exposure(None);
    assert_eq!(result.unwrap(), Outcome::Complete);
    assert_eq!(warnings, [""; 0]);
    let of_bracket = frames.values().filter(|(_, sidecar)| !sidecar.pilot);
    let exposures: BTreeSet<u64> = of_bracket
        .map(|(_, sidecar)| sidecar.applied.exposure.0.to_bits())
        .collect();
    assert_eq!(exposures.len(), 1, "this test is of one exposure");
    // One frame per light at another exposure.
    let others = frames.values().filter(|(_, sidecar)| {
        sidecar.pilot && !exposures.contains(&sidecar.applied.exposure.0.to_bits())
    });
    assert_eq!(others.count(), record().plan.lights.len());
    for stuck_s in [0.005, 0.01, 0.014] {
        let (result, ..) = one_exposure(Some(stuck_s));
        assert!(
            matches!(result, Err(CaptureError::ExposureNotApplied { .. })),
            "{FROM_THE_START}, {stuck_s} s: {result:?}"
        );
    }
    // Far too long: nothing but saturation.
    let (result, ..) = one_exposure(Some(1.0));
    assert!(
        matches!(
            result,
            Err(CaptureError::AllSaturated { .. } | CaptureError::ExposureNotApplied { .. })
        ),
        "{result:?}"
    );
}

#[test]
fn the_table_in_the_docs_has_these_rows() {
    let rows: BTreeSet<&str> = documented_faults("Camera").collect();
    let passing = PASSING.iter().map(|(name, ..)| *name);
    let cases: BTreeSet<&str> = passing
        .chain(LASTING.iter().map(|(name, ..)| *name))
        .chain([FROM_THE_START])
        .collect();
    assert_eq!(rows, cases);
}
