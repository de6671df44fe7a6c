//! Whole captures of two lights through the camera, undisturbed and with faults in the middle.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mock_cameras::gige::GigeFaults;
use rig::capture::open::Devices;
use rig::capture::prepare::{CaptureRequest, Lights, prepare};
use rig::capture::{CaptureError, Outcome};
use rig::config::ResolvedRig;
use rig::device::DeviceError;
use rig::device::retake::Retakes;
use rig::interrupt::Interrupt;
use rig::radiance_image::{RadianceImage, exr};
use rig::session::{Session, verify};

use crate::camera_support::{assert_same_within_noise, documented_faults};
use crate::stand::Stand;

/// Captures two lights; the session's folder and how it ended.
fn capture(
    rig: &ResolvedRig,
    folder: &Path,
    devices: Devices,
) -> (PathBuf, Result<Outcome, CaptureError>) {
    let request = CaptureRequest::new(Lights::Count(2), folder.to_str().unwrap());
    let prepared = prepare(rig, &request, &mut |_| ()).unwrap();
    let job = prepared.begin(devices, &mut |_| ()).unwrap();
    let root = job.root().to_owned();
    (root, job.run(&mut (), Interrupt::new()))
}

fn images(root: &Path) -> Vec<RadianceImage> {
    let mut folders = vec![root.to_owned()];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "exr") {
                found.push(path);
            }
        }
    }
    found.sort();
    let read = |path: &PathBuf| exr::read(path).unwrap().image;
    found.iter().map(read).collect()
}

#[test]
fn a_capture_through_the_network_equals_one_in_memory() {
    let stand = Stand::new(51);
    let began = Instant::now();
    let (root, ended) = capture(
        &stand.rig,
        &stand.folder.path().join("gige"),
        stand.devices(),
    );
    println!("over the network: {:.1} s", began.elapsed().as_secs_f64());
    assert_eq!(ended.unwrap(), Outcome::Complete);
    assert!(!stand.is_lit());
    // A busy machine may lose packets of a frame; nothing else goes wrong.
    let retakes = retakes(&root);
    println!("taken again: {retakes}");
    assert!(
        retakes.late + retakes.wrong_size + retakes.reconnected == 0,
        "{retakes:?}"
    );
    let began = Instant::now();
    let memory = captured_in_memory(52);
    println!("in memory: {:.1} s", began.elapsed().as_secs_f64());
    assert_same_within_noise(&images(&root), &memory);
}

/// The images of the camera in memory, with noise of its own, on a bench of its own.
fn captured_in_memory(last: u8) -> Vec<RadianceImage> {
    let stand = Stand::new(last);
    let stage = Box::new(stand.bench.open_stage().unwrap());
    let camera = Box::new(stand.bench.open_camera(stand.scene.clone()));
    let folder = stand.folder.path().join("memory");
    let (root, ended) = capture(&stand.rig, &folder, Devices::new(stage, camera));
    assert_eq!(ended.unwrap(), Outcome::Complete);
    images(&root)
}

/// What the sidecars report that was taken again.
fn retakes(root: &Path) -> Retakes {
    let session = Session::open(root).unwrap();
    let mut all = Retakes::default();
    for entry in session.frames() {
        let (_, sidecar) = session.read_frame(&entry).unwrap();
        all.add(sidecar.time.retakes);
    }
    all
}

type Fault = fn(&GigeFaults);
type Check = fn(&Retakes) -> bool;

/// Faults that pass, and what the sidecars report.
const PASSING: [(&str, Fault, Check); 7] = [
    (
        "packets lost",
        |faults| faults.now().lost_per_thousand = 30,
        |_| true,
    ),
    (
        "frame of the wrong size",
        |faults| faults.now().halved = 2,
        |retakes| retakes.damaged + retakes.wrong_size >= 2,
    ),
    (
        "frame of another pixel format",
        |faults| faults.now().other_format = 2,
        |retakes| retakes.damaged == 2,
    ),
    (
        "frame late (an older one)",
        |faults| faults.now().late = 2,
        |retakes| retakes.late == 2,
    ),
    (
        "no frame",
        |faults| faults.now().silent = 1,
        |retakes| retakes.missing == 1,
    ),
    (
        "control lost in a pause",
        |faults| faults.now().forgets_controller = true,
        |retakes| retakes.reconnected == 1,
    ),
    (
        GONE,
        |faults| faults.now().is_gone = true,
        |retakes| retakes.reconnected == 1,
    ),
];

const GONE: &str = "camera gone and back";

#[test]
fn what_passes_is_taken_again_and_counted() {
    let expected = captured_in_memory(53);
    for (name, fault, is_expected) in PASSING {
        let stand = Stand::new(54);
        let faults = stand.device.faults();
        let injected = faults.clone();
        stand.scene.after(30, move || fault(&injected));
        let devices = stand.devices();
        let bench = stand.bench.bench().clone();
        let is_gone = name == GONE;
        let plugged_in = std::thread::spawn(move || {
            while is_gone && !faults.now().is_gone {
                std::thread::sleep(Duration::from_millis(5));
            }
            // The lamp goes off once the frame's time-out and that of a command are over.
            let mut is_lit = false;
            if is_gone {
                std::thread::sleep(Duration::from_secs(12));
                is_lit = bench.lamp_drive() != [0.0; 3];
            }
            faults.now().is_gone = false;
            is_lit
        });
        let (root, ended) = capture(&stand.rig, &stand.folder.path().join("s"), devices);
        assert_eq!(ended.unwrap(), Outcome::Complete, "{name}");
        assert!(stand.scene.has_acted(), "{name}");
        assert!(!plugged_in.join().unwrap(), "{name}: lit while it was away");
        assert!(!stand.is_lit(), "{name}");
        let mut retakes = retakes(&root);
        // On a busy machine.
        assert!(
            retakes.damaged <= 4 && retakes.dropped <= 4,
            "{name}: {retakes:?}"
        );
        println!("{name}: {retakes}");
        retakes.dropped = 0;
        assert!(is_expected(&retakes), "{name}: {retakes:?}");
        assert_same_within_noise(&images(&root), &expected);
    }
}

type IsEnd = fn(&CaptureError) -> bool;

/// Faults that stay, and the error that they end with.
const LASTING: [(&str, Fault, IsEnd); 4] = [
    (
        "no frame for good",
        |faults| faults.now().silent = u32::MAX,
        |error| matches!(error, CaptureError::Device(DeviceError::NoReply { .. })),
    ),
    (
        "frames of the wrong size for good",
        |faults| faults.now().halved = u32::MAX,
        |error| matches!(error, CaptureError::Device(DeviceError::BadFrame { .. })),
    ),
    (
        "exposure ignored",
        |faults| faults.now().ignores_exposure = true,
        |error| matches!(error, CaptureError::Device(DeviceError::NotApplied { .. })),
    ),
    (
        "exposure confirmed and ignored",
        |faults| faults.now().stuck_exposure_us = Some(700.0),
        |error| matches!(error, CaptureError::ExposureNotApplied { .. }),
    ),
];

#[test]
fn what_stays_ends_with_the_lamp_off_and_the_frames_kept() {
    for (name, fault, is_expected) in LASTING {
        let stand = Stand::new(55);
        let faults = stand.device.faults();
        stand.scene.after(40, move || fault(&faults));
        let (root, ended) = capture(&stand.rig, &stand.folder.path().join("s"), stand.devices());
        let error = ended.unwrap_err();
        assert!(is_expected(&error), "{name}: {error}");
        assert!(!stand.is_lit(), "{name}");
        assert!(verify::verify(&root).unwrap().is_intact(), "{name}");
        assert!(Session::open(&root).unwrap().frames().count() > 0, "{name}");
    }
}

/// Each row of the documents' table is a case here, in `driver.rs` or in `program.rs`.
#[test]
fn the_table_in_the_docs_has_these_rows() {
    let mut rows: Vec<&str> = documented_faults("GenICam cameras").collect();
    let passing = PASSING.iter().map(|(name, ..)| *name);
    let mut cases: Vec<&str> = passing
        .chain(LASTING.iter().map(|(name, ..)| *name))
        .chain([
            "frame after its time-out",
            "another program controls it",
            "no permission (USB3 Vision)",
            "another camera, size, pixel format or exposure range",
            "the program is killed (`kill -9`)",
            "the program is suspended (Ctrl-Z) for longer than the heartbeat time-out",
            "libaravis is not installed",
        ])
        .collect();
    rows.sort_unstable();
    cases.sort_unstable();
    assert_eq!(rows, cases);
}
