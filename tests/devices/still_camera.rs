//! Still cameras: the driver, Debian's own `gphoto2` and LibRaw's programs, and a simulated
//! body behind PTP/IP that looks at the simulated bench.

use crate::small_bench;

use std::collections::BTreeSet;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::camera_support::{assert_same_within_noise, documented_faults};
use mock_cameras::ptp::faults::Faults;
use mock_cameras::ptp::{Body, BodyConfig, PtpServer};
use mock_devices::camera::{CameraConfig, SimulatedCamera};
use mock_devices::sensor::SensorModel;
use mock_devices::{Illumination, RadianceSource};
use rig::capture::open::Devices;
use rig::capture::prepare::{CaptureRequest, Lights, prepare};
use rig::config::{ResolvedRig, Surroundings, resolve_rig};
use rig::device::described::Description;
use rig::device::retake::{Retakes, grab_right};
use rig::device::simulated::SimulatedBench;
use rig::device::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, FrameKind, Mosaic, gphoto2,
};
use rig::interrupt::Interrupt;
use rig::radiance_image::{RadianceImage, exr};
use rig::units::Seconds;

const SERIAL: &str = "SIM-0001";
const KEY: FrameKey = FrameKey::new(0, 0, 0, FrameKind::Light);

/// Of the frames of a still camera: none has older settings.
fn at_once(config: &CameraConfig) -> CameraConfig {
    CameraConfig {
        settings_latency_frames: 0,
        has_shutter: false,
        noise_seed: config.noise_seed + 1,
        ..config.clone()
    }
}

/// A body that looks at this scene, on the bench's clock and under its lamp.
fn body_at(
    bench: &SimulatedBench,
    scene: Arc<dyn RadianceSource>,
    config: BodyConfig,
) -> PtpServer {
    let camera = SimulatedCamera::new(
        at_once(&bench.config().camera),
        bench.bench().clone(),
        SensorModel::new(bench.config().sensor.clone()),
        scene,
    );
    PtpServer::start(Body::new(config, camera)).unwrap()
}

fn body_config() -> BodyConfig {
    BodyConfig {
        serial: SERIAL.to_owned(),
        ..BodyConfig::default()
    }
}

fn description(rig: &ResolvedRig, timeout_s: f64) -> Description {
    let camera = &rig.config.camera;
    Description {
        info: CameraInfo {
            driver: "gphoto2".to_owned(),
            model: String::new(),
            serial: SERIAL.to_owned(),
            resolution_px: camera.resolution_px,
            bit_depth: camera.bit_depth,
            mosaic: Mosaic::None,
            exposure_range: camera.exposure_range,
            exposure_step: camera.exposure_step,
        },
        timeout: Seconds(timeout_s),
        keeper: None,
    }
}

fn open(server: &PtpServer, rig: &ResolvedRig) -> Result<Box<dyn Camera>, DeviceError> {
    let body = format!("port = {}; f-number = f/8", server.port());
    (gphoto2::DRIVER.open)(body.as_ref(), description(rig, 30.0))
}

/// The small simulated bench whose clock jumps, with records of its sensor.
fn small_rig(folder: &Path) -> ResolvedRig {
    let mut text = small_bench::rig_file();
    for (key, value) in [
        (
            "\nsettings_latency_frames = 2",
            "\nsettings_latency_frames = 0",
        ),
        ("\nshortest_ms = 0.05", "\nshortest_ms = 1.0"),
        ("\nshortest_ms = 0.1", "\nshortest_ms = 1.0"),
    ] {
        assert!(text.contains(key), "{key}");
        text = text.replacen(key, value, 1);
    }
    let at = text.find("# \"instant\" (motion").unwrap();
    let line = text[at..].find("\ntiming = ").map(|found| at + found);
    match line {
        Some(start) => {
            let end = start + 1 + text[start + 1..].find('\n').unwrap();
            text.replace_range(start..end, "\ntiming = \"instant\"");
        }
        None => text.insert_str(at, "timing = \"instant\"\n"),
    }
    let path = folder.join("bench.toml");
    std::fs::write(&path, text).unwrap();
    small_bench::put_records(folder);
    let name = path.to_str().unwrap();
    resolve_rig(Some(name), &Surroundings::of_process(), Vec::new).unwrap()
}

fn bench_of(rig: &ResolvedRig) -> SimulatedBench {
    SimulatedBench::start(rig.config.simulated_bench().unwrap()).unwrap()
}

fn images_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(images_below(&path));
        } else if path.extension().is_some_and(|ending| ending == "exr") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Captures two lights with this camera and returns their radiance images.
fn capture(rig: &ResolvedRig, folder: &str, devices: Devices) -> Vec<RadianceImage> {
    let request = CaptureRequest::new(Lights::Count(2), folder);
    let prepared = prepare(rig, &request, &mut |_| ()).unwrap();
    let job = prepared.begin(devices, &mut |_| ()).unwrap();
    let root = job.root().to_owned();
    job.run(&mut (), Interrupt::new()).unwrap();
    let images = images_below(&root);
    images
        .iter()
        .map(|path| exr::read(path).unwrap().image)
        .collect()
}

/// Two lights, captured through the programs and through a camera in memory: the images of
/// the same scene differ by noise alone. Of the pixels' differences over their standard
/// deviations the mean square is 1 within what 2 × 64 × 64 pixels and the lamp's own
/// differences from visit to visit allow, and the mean of the ratio is 1 within 0.5%.
#[test]
fn a_capture_through_gphoto2_equals_one_in_memory() {
    let folder = tempfile::tempdir().unwrap();
    let rig = small_rig(folder.path());
    let at = |name: &str| folder.path().join(name).display().to_string();
    let scene = || rig.config.truth().unwrap().unwrap();
    // Through the programs.
    let bench = bench_of(&rig);
    let server = body_at(&bench, scene(), body_config());
    let stage = Box::new(bench.open_stage().unwrap());
    let camera = open(&server, &rig).unwrap();
    let began = Instant::now();
    let through = capture(&rig, &at("still"), Devices::new(stage, camera));
    println!("through gphoto2: {:.1} s", began.elapsed().as_secs_f64());
    assert_eq!(server.objects(), 0, "the body keeps no file");
    drop(server);
    // In memory.
    let bench = bench_of(&rig);
    let stage = Box::new(bench.open_stage().unwrap());
    let camera = Box::new(bench.open_camera(scene()));
    let began = Instant::now();
    let memory = capture(&rig, &at("memory"), Devices::new(stage, camera));
    println!("in memory: {:.1} s", began.elapsed().as_secs_f64());
    // The images.
    assert_same_within_noise(&through, &memory);
}

/// A card that is lit evenly whatever the lamp does.
struct Card([u32; 2]);

impl RadianceSource for Card {
    fn resolution_px(&self) -> [u32; 2] {
        self.0
    }
    fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
        Arc::new(vec![0.05; (self.0[0] * self.0[1]) as usize])
    }
}

struct Bench {
    rig: ResolvedRig,
    _bench: SimulatedBench,
    server: PtpServer,
    _folder: tempfile::TempDir,
}

fn before_a_card(config: BodyConfig) -> Bench {
    let folder = tempfile::tempdir().unwrap();
    let rig = small_rig(folder.path());
    let bench = bench_of(&rig);
    let server = body_at(&bench, Arc::new(Card([64, 64])), config);
    Bench {
        rig,
        _bench: bench,
        server,
        _folder: folder,
    }
}

fn settings(exposure_s: f64, gain: f64) -> CameraSettings {
    let exposure = Seconds(exposure_s);
    CameraSettings { exposure, gain }
}

fn mean(counts: &[u16]) -> f64 {
    counts
        .iter()
        .map(|&count| f64::from(count) - 64.0)
        .sum::<f64>()
        / counts.len() as f64
}

#[test]
fn speeds_are_chosen_from_the_list_and_read_back_from_the_file() {
    let bench = before_a_card(body_config());
    let mut camera = open(&bench.server, &bench.rig).unwrap();
    let info = camera.info().clone();
    assert_eq!(
        (info.model.as_str(), info.serial.as_str()),
        ("Still Camera", SERIAL)
    );
    assert_eq!(info.exposure_range, [Seconds(0.001), Seconds(2.0)]);
    // 18 ms are not listed; 1/60 s is, as 0.0167 s, and its file states 1/60 s.
    let applied = camera.configure(settings(0.018, 1.0)).unwrap();
    assert!(
        (applied.exposure.0 - 1.0 / 60.0).abs() < 1e-9,
        "{applied:?}"
    );
    let at_60 = mean(&camera.grab(KEY).unwrap().counts);
    let applied = camera.configure(settings(1.0 / 15.0, 1.0)).unwrap();
    assert!(
        (applied.exposure.0 - 1.0 / 15.0).abs() < 1e-9,
        "{applied:?}"
    );
    let at_15 = mean(&camera.grab(KEY).unwrap().counts);
    assert!((at_15 / at_60 - 4.0).abs() < 0.05, "{at_60} {at_15}");
    // The gain is a sensitivity of the list.
    let applied = camera.configure(settings(1.0 / 60.0, 2.1)).unwrap();
    assert_eq!(applied.gain, 2.0);
    let doubled = mean(&camera.grab(KEY).unwrap().counts);
    assert!((doubled / at_60 - 2.0).abs() < 0.03, "{at_60} {doubled}");
}

/// During what a fault happens.
#[derive(Clone, Copy)]
enum During {
    /// A change of the shutter speed.
    Settings,
    /// A frame.
    Frame,
}

/// What comes of it: nothing but time; a frame that is taken again; an error.
enum Outcome {
    GoesOn,
    TakenAgain,
    Error(fn(&DeviceError) -> bool),
}

/// A fault by its name in docs/faults.md, when it happens and what comes of it.
type Fault = (&'static str, fn(&mut Faults), During, Outcome);

/// Faults of the body.
const FAULTS: [Fault; 7] = [
    (
        "the body is busy",
        |body| body.busy = 2,
        During::Settings,
        Outcome::GoesOn,
    ),
    (
        "a file states another exposure, once",
        |body| body.wrong_exif = 1,
        During::Frame,
        Outcome::GoesOn,
    ),
    (
        "a file is cut on its way",
        |body| body.cut_files = 1,
        During::Frame,
        Outcome::TakenAgain,
    ),
    (
        "files state another exposure for good",
        |body| body.wrong_exif = u32::MAX,
        During::Frame,
        Outcome::Error(
            |error| matches!(error, DeviceError::NotApplied { what, .. } if what.contains("exposure in the raw file")),
        ),
    ),
    (
        "a speed is refused",
        |body| body.refused_speeds = 1,
        During::Settings,
        Outcome::Error(|error| matches!(error, DeviceError::Refused { .. })),
    ),
    (
        "a speed is accepted and not taken",
        |body| body.kept_speeds = 1,
        During::Settings,
        Outcome::Error(|error| matches!(error, DeviceError::NotApplied { .. })),
    ),
    (
        "switched off, or out of reach",
        |body| body.is_gone = true,
        During::Frame,
        Outcome::Error(|error| matches!(error, DeviceError::Disconnected { .. })),
    ),
];

/// Rows of that table that have a test of their own below.
const OTHERS: [&str; 6] = [
    "the body does not answer",
    "no room for a file",
    "another serial number",
    "another size of frame",
    "another program has claimed the camera",
    "`gphoto2` or LibRaw's programs are missing",
];

#[test]
fn a_body_that_fails_is_reported_as_what_it_does() {
    let bench = before_a_card(body_config());
    let faults = bench.server.faults();
    let mut camera = open(&bench.server, &bench.rig).unwrap();
    // Frames of both speeds, so that no other frame is taken for one of them.
    for exposure_s in [0.05, 0.02] {
        camera.configure(settings(exposure_s, 1.0)).unwrap();
    }
    for (name, fault, during, outcome) in FAULTS {
        camera.configure(settings(0.02, 1.0)).unwrap();
        fault(&mut faults.now());
        let mut retakes = Retakes::default();
        let result = match during {
            During::Settings => camera.configure(settings(0.05, 1.0)).map(drop),
            During::Frame => grab_right(camera.as_mut(), KEY, &mut retakes).map(drop),
        };
        let expected = Retakes {
            damaged: u32::from(matches!(outcome, Outcome::TakenAgain)),
            ..Retakes::default()
        };
        assert_eq!(retakes, expected, "{name}");
        match (outcome, result) {
            (Outcome::Error(is_expected), Err(error)) => {
                assert!(is_expected(&error), "{name}: {error}");
            }
            (Outcome::Error(_), Ok(())) => panic!("{name}: no error"),
            (_, result) => result.unwrap_or_else(|error| panic!("{name}: {error}")),
        }
        let is_gone = faults.now().is_gone;
        if is_gone {
            let error = camera.reconnect().unwrap_err();
            assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
        }
        // Afterwards it works again.
        *faults.now() = Faults::default();
        camera.reconnect().unwrap();
        camera.configure(settings(0.02, 1.0)).unwrap();
        assert!(camera.grab(KEY).is_ok(), "{name}");
    }
}

#[test]
fn the_table_in_the_docs_has_these_rows() {
    let rows: BTreeSet<&str> = documented_faults("Still camera").collect();
    let cases = FAULTS.iter().map(|(name, ..)| *name).chain(OTHERS);
    assert_eq!(rows, cases.collect());
}

/// The program `rig` with a still camera, in a folder whose `bin` alone is in `PATH`.
struct Tethered(tempfile::TempDir);

impl Tethered {
    /// With these of the system's programs, and `gphoto2` as a shell script where one is given.
    fn new(installed: &[&str], gphoto2: Option<&str>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bin = folder.path().join("bin");
        std::fs::create_dir(&bin).unwrap();
        for program in installed {
            let real = Path::new("/usr/bin").join(program);
            std::os::unix::fs::symlink(real, bin.join(program)).unwrap();
        }
        let tethered = Self(folder);
        if let Some(script) = gphoto2 {
            tethered.install("gphoto2", script);
        }
        tethered
    }

    fn install(&self, program: &str, script: &str) {
        let path = self.0.path().join("bin").join(program);
        std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).unwrap();
    }

    /// stdout and stderr of `rig` with these arguments, the rig file's body at `port`.
    fn rig(&self, arguments: &str, port: &str) -> String {
        let body = format!("serial = \"{SERIAL}\"\nbody = \"port = {port}\"");
        self.rig_with(arguments, &body)
    }

    /// Likewise with these lines about the body in the rig file.
    fn rig_with(&self, arguments: &str, body: &str) -> String {
        let text = include_str!("../outside/shared/program-camera.toml");
        let command = "driver = \"command\"\ncommand = \"./camera {output} {exposure_s}\"";
        assert!(text.contains(command));
        let body = format!("driver = \"gphoto2\"\n{body}");
        let file = self.0.path().join("still.toml");
        std::fs::write(&file, text.replace(command, &body)).unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_rig"))
            .args(arguments.split(' '))
            .current_dir(self.0.path())
            .env("PATH", self.0.path().join("bin"))
            .env_remove("RIG_CONFIG")
            .output()
            .unwrap();
        [output.stdout, output.stderr]
            .map(|text| String::from_utf8_lossy(&text).into_owned())
            .concat()
    }
}

const GRAB: &str = "camera grab --rig still.toml --exposure-ms 20 --out frame.png";
const LIBRAW: [&str; 2] = ["unprocessed_raw", "raw-identify"];

#[test]
fn missing_programs_and_a_camera_that_is_claimed_come_with_the_remedy() {
    let claimed = "echo \"*** Error (-53: 'Could not claim the USB device') ***\" >&2; exit 1";
    let killed = Tethered::new(&LIBRAW, Some("kill -9 $$")).rig(GRAB, "usb:001,004");
    assert!(killed.contains("gphoto2: signal 9 ended it"), "{killed}");
    for (tethered, fact, hint) in [
        (
            Tethered::new(&[], None),
            "gphoto2: there is no such program in PATH",
            "install it (on Debian and Ubuntu `sudo apt install gphoto2`)",
        ),
        (
            Tethered::new(&["gphoto2"], None),
            "unprocessed_raw: there is no such program in PATH",
            "install LibRaw's programs (on Debian and Ubuntu `sudo apt install libraw-bin`)",
        ),
        (
            Tethered::new(&LIBRAW, Some(claimed)),
            "another program has claimed the camera at usb:001,004",
            "desktops claim cameras to show their files: `gio mount -s gphoto2`",
        ),
    ] {
        let said = tethered.rig(GRAB, "usb:001,004");
        assert!(said.contains(fact) && said.contains(hint), "{said}");
    }
}

#[test]
fn another_body_than_the_rig_file_names_comes_with_the_remedy() {
    let bench = before_a_card(BodyConfig::default());
    let tethered = Tethered::new(&["gphoto2", LIBRAW[0], LIBRAW[1]], None);
    let said = tethered.rig(GRAB, &bench.server.port());
    let fact = format!("is the camera \"S0001\", and {SERIAL:?} is wanted");
    assert!(said.contains(&fact), "{said}");
    assert!(
        said.contains("connect the camera of that serial number"),
        "{said}"
    );
}

/// A body whose numbers are PTP's, the printed one and the one in its files, as a script; it
/// adds notes of the loader to all that it says.
fn body_of_numbers(numbers: [&str; 3]) -> Tethered {
    let [ptp, printed, in_files] = numbers;
    let gphoto2 = format!(
        r#"PATH=/usr/bin:/bin
echo "gphoto2: /opt/lib/libjpeg.so.8: no version information available" >&2
text() {{ printf 'Label: x\nReadonly: 0\nType: TEXT\nCurrent: %s\nEND\n' "$1"; }}
[ "$1" = --auto-detect ] && printf 'Model  Port\n-----\nBody  usb:001,004\n'
while [ $# -gt 0 ]; do
    case "$1 $2" in
    --list-config*)
        echo /main/status/serialnumber
        [ "{printed}" ] && echo /main/status/eosserialnumber
        echo /main/status/lensserialnumber
        echo /main/capturesettings/shutterspeed ;;
    "--get-config "*/eosserialnumber) text "{printed}" ;;
    "--get-config "*/serialnumber) text "{ptp}" ;;
    "--get-config "*/shutterspeed)
        printf 'Label: x\nReadonly: 0\nType: RADIO\nCurrent: 1/50\nChoice: 0 1/50\nEND\n' ;;
    "--filename "*) : > "${{2%.%C}}.cr2" ;;
    esac
    shift
done"#
    );
    let tethered = Tethered::new(&[], Some(&gphoto2));
    let frame = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/outside/programs/answers/frame.png"
    );
    let size = "echo 'Raw size: 6x4'; echo 'Image size: 6x4'; echo 'Margins: top=0, left=0'";
    let unprocessed = format!("/bin/cp {frame} \"$2.tiff\"; {size}");
    tethered.install("unprocessed_raw", &unprocessed);
    let identify = format!("echo 'Body#: {in_files} Lens#: 7'; echo 'Shutter: 1/50.0'");
    tethered.install("raw-identify", &identify);
    tethered
}

#[test]
fn all_numbers_of_a_body_are_its_own() {
    const PTP: &str = "6e1c42d90fab4c3e8d27b5a1907f3c64";
    let canon = [PTP, "12345678", "12345678"];
    let fujifilm = ["5932363036160F2B4C20DA0C4B7C", "", "42001234"];
    for (numbers, named, refused) in [
        (canon, "12345678", None),
        (canon, PTP, None),
        (canon, "", None),
        (
            canon,
            "12345679",
            Some("is the camera \"12345678\", and \"12345679\" is wanted"),
        ),
        (
            [PTP, "12345678", "87654321"],
            "12345678",
            Some("is the camera \"87654321\""),
        ),
        (["000000000000012345678", "", "12345678"], "12345678", None),
        (["000000000000012345678", "", "12345678"], "", None),
        (fujifilm, "42001234", None),
        (fujifilm, fujifilm[0], None),
        (["", "", ""], "", None),
    ] {
        let serial = match named {
            "" => String::new(),
            named => format!("serial = {named:?}\n"),
        };
        let body = format!("{serial}body = \"port = any\"");
        let said = body_of_numbers(numbers).rig_with(GRAB, &body);
        match refused {
            None => assert!(said.contains("20 ms"), "{numbers:?} {named}: {said}"),
            Some(fact) => assert!(said.contains(fact), "{numbers:?} {named}: {said}"),
        }
    }
}

#[test]
fn a_file_of_another_body_is_noticed_without_any_number_before() {
    let tethered = body_of_numbers(["", "", ""]);
    let count = tethered.0.path().join("count");
    let identify = format!(
        "echo x >> {0}; echo Body#: 100$(/usr/bin/wc -l < {0}); echo 'Shutter: 1/50.0'",
        count.display()
    );
    tethered.install("raw-identify", &identify);
    let said = tethered.rig_with(GRAB, "body = \"port = any\"");
    assert!(
        said.contains("is the camera \"1003\", and \"1001\" is wanted"),
        "{said}"
    );
}

/// `gphoto2 --auto-detect` does not look for bodies on a network, so that a script is its
/// place here.
#[test]
fn rig_devices_lists_bodies_with_the_lines_of_a_rig_file() {
    let table =
        "echo 'Model                          Port'; echo '----------------------------------'
echo 'Canon EOS 5D Mark IV           usb:001,004'";
    let said = Tethered::new(&[], Some(table)).rig("devices", "any");
    assert!(
        said.contains("camera  gphoto2  Canon EOS 5D Mark IV"),
        "{said}"
    );
    assert!(
        said.contains("driver = \"gphoto2\", body = \"port=usb:001,004\""),
        "{said}"
    );
    let said = Tethered::new(&[], Some(table)).rig("devices --json", "any");
    assert!(
        said.contains("\"driver\": \"gphoto2\"") || said.contains("\"driver\":\"gphoto2\""),
        "{said}"
    );
    let none = Tethered::new(&[], None).rig("devices", "any");
    assert!(!none.contains("gphoto2"), "{none}");
}

#[test]
fn a_body_that_does_not_answer_ends_with_the_time_limit() {
    let bench = before_a_card(body_config());
    let body = format!("port = {}", bench.server.port());
    let slow = description(&bench.rig, 2.0);
    let mut camera = (gphoto2::DRIVER.open)(body.as_ref(), slow).unwrap();
    camera.configure(settings(0.02, 1.0)).unwrap();
    bench.server.faults().now().slow = Duration::from_secs(8);
    let began = Instant::now();
    let error = camera.grab(KEY).unwrap_err();
    assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_secs(6));
}

/// gphoto2 waits for a frame that the body has refused to take.
#[test]
fn a_body_without_room_for_a_file_ends_with_the_time_limit() {
    let bench = before_a_card(body_config());
    let body = format!("port = {}", bench.server.port());
    let mut camera = (gphoto2::DRIVER.open)(body.as_ref(), description(&bench.rig, 2.0)).unwrap();
    camera.configure(settings(0.02, 1.0)).unwrap();
    bench.server.faults().now().is_full = true;
    let error = camera.grab(KEY).unwrap_err();
    assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
}

#[test]
fn another_body_or_another_size_is_refused() {
    let bench = before_a_card(BodyConfig::default());
    let error = open(&bench.server, &bench.rig).err().unwrap();
    assert!(
        matches!(&error, DeviceError::OtherCamera { is, .. } if is == "S0001"),
        "{error}"
    );
    let bench = before_a_card(body_config());
    let body = format!("port = {}", bench.server.port());
    let mut larger = description(&bench.rig, 20.0);
    larger.info.resolution_px = [128, 64];
    let mut camera = (gphoto2::DRIVER.open)(body.as_ref(), larger).unwrap();
    let error = camera.configure(settings(0.02, 1.0)).unwrap_err();
    assert!(matches!(error, DeviceError::BadFrame { .. }), "{error}");
    let unlisted = format!("port = {}; f-number = f/64", bench.server.port());
    let opened = (gphoto2::DRIVER.open)(unlisted.as_ref(), description(&bench.rig, 20.0));
    assert!(opened.is_err());
}
