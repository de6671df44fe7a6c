//! `rig devices`, `rig stage` and `rig camera` as a person runs them, on
//! simulated firmware behind a port of its own.

use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::command_support::{self, rig_file_on_port, text, words};
use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use rustix::process::Signal;

use mock_devices::grbl::{Fault, GrblConfig, GrblSimulator, Trigger};

fn rig(args: &[&str]) -> Command {
    command_support::rig(".", args)
}

fn run(args: &[&str]) -> Output {
    rig(args).output().unwrap()
}

fn firmware() -> (GrblSimulator, String) {
    let bench = Bench::new(BenchConfig::default(), Clock::instant());
    let simulator = GrblSimulator::spawn(GrblConfig::default(), bench).unwrap();
    let port = simulator.path().display().to_string();
    (simulator, port)
}

/// A rig file for a stage on this port.
fn rig_file(port: &str) -> (tempfile::TempDir, String) {
    rig_file_on_port(include_str!("../../rig-configs/grbl-arm-v4l2.toml"), port)
}

/// Code 1, nothing on stdout, one line of fact, a blank line, a hint.
#[track_caller]
fn assert_fails(output: &Output, fact: &str) {
    assert_eq!(text(&output.stdout), "");
    assert_eq!(text(&output.stderr).lines().count(), 3);
    command_support::assert_fails(output, 1, fact, "");
}

/// The same, with this in the hint.
#[track_caller]
fn assert_advises(output: &Output, fact: &str, advice: &str) {
    assert_fails(output, fact);
    let stderr = text(&output.stderr);
    let hint = stderr.lines().last().unwrap();
    assert!(hint.contains(advice), "{hint}");
}

#[test]
fn a_stage_on_a_port_is_asked_homed_and_stopped() {
    let (simulator, port) = firmware();
    let status = run(&["stage", "status", "--port", &port]);
    assert_eq!(status.status.code(), Some(0), "{}", text(&status.stderr));
    assert!(text(&status.stdout).contains("locked until it is homed"));
    let home = run(&["stage", "home", "--port", &port, "--json"]);
    let answer: serde_json::Value = serde_json::from_slice(&home.stdout).unwrap();
    assert_eq!(answer["status"]["activity"], "idle");
    assert!(simulator.bench().is_homed());
    let stop = run(&["stage", "stop", "--port", &port]);
    assert_eq!(stop.status.code(), Some(0), "{}", text(&stop.stderr));
    assert!(text(&stop.stdout).starts_with("stopped"));
    let stop = run(&["stage", "stop", "--port", &port, "--json"]);
    let answer: serde_json::Value = serde_json::from_slice(&stop.stdout).unwrap();
    assert_eq!(answer["stopped"], true);
}

#[test]
fn a_move_needs_a_rig_and_stays_within_its_limits() {
    let (simulator, port) = firmware();
    let angles = ["--azimuth", "-30", "--elevation", "50"];
    let without = run(&[&["stage", "move", "--port", &port][..], &angles].concat());
    assert_fails(&without, "--port");
    assert!(!simulator.bench().is_homed());
    let simulated = ["stage", "move", "--rig", "simulated", "--quiet"];
    let there = run(&[&simulated[..], &angles].concat());
    assert_eq!(there.status.code(), Some(0), "{}", text(&there.stderr));
    assert!(text(&there.stdout).contains("azimuth -30.000°, elevation 50.000°"));
    let outside = run(&[&simulated[..], &["--azimuth", "0", "--elevation", "-5"]].concat());
    assert_fails(&outside, "outside the limits");
}

#[test]
fn ports_that_cannot_be_used() {
    let (simulator, port) = firmware();
    let status = |port: &str| run(&["stage", "status", "--port", port]);
    assert_fails(&status("/dev/no-such-port"), "does not exist");
    assert_fails(&status("/dev/null"), "not a serial port");
    let held =
        rig::device::grbl::GrblStage::open(rig::device::grbl::GrblConfig::of_port(&port, 115_200))
            .unwrap();
    assert_advises(&status(&port), "in use", "names the process that holds it");
    assert_fails(&run(&["stage", "stop", "--port", &port]), "in use");
    drop(held);
    let (_folder, file) = rig_file(&port);
    let status = || run(&["stage", "status", "--rig", &file]);
    simulator.faults().inject(Trigger::Always, Fault::Garbled);
    assert_advises(
        &status(),
        "is not a GRBL status report",
        "check the baud rate, and that the port belongs",
    );
    simulator.faults().clear();
    simulator.faults().inject(Trigger::Always, Fault::NoReply);
    assert_advises(
        &status(),
        "did not answer",
        "check power and cable, and that driver and baud rate",
    );
}

/// As the superuser may open everything, the test gives that up where it has it.
#[test]
fn a_port_or_camera_without_permission() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o755)).unwrap();
    let program = folder.path().join("rig");
    // Copied by another process: what this one has open to write, another test may inherit.
    let copied = Command::new("cp")
        .arg(assert_cmd::cargo::cargo_bin("rig"))
        .arg(&program)
        .status();
    assert!(copied.unwrap().success());
    let file = folder.path().join("ttyUSB0");
    std::fs::write(&file, "").unwrap();
    std::fs::set_permissions(&file, PermissionsExt::from_mode(0o000)).unwrap();
    let name = file.display().to_string();
    for args in [
        ["stage", "status", "--port", &name],
        ["camera", "info", "--device", &name],
    ] {
        let mut command = Command::new(&program);
        command.args(args).current_dir(folder.path());
        if rustix::process::geteuid().is_root() {
            command.uid(65_534).gid(65_534);
        }
        assert_advises(
            &command.output().unwrap(),
            "permission denied",
            "check who owns the file and its folder",
        );
    }
}

#[test]
fn a_lamp_burns_until_it_is_interrupted() {
    let (simulator, port) = firmware();
    let (_folder, file) = rig_file(&port);
    let locked = run(&["stage", "lamp", "0", "--rig", &file]);
    assert_fails(&locked, "locked");
    for (signal, code) in [
        (Signal::INT, Some(130)),
        (Signal::TERM, Some(143)),
        (Signal::HUP, Some(129)),
        (Signal::QUIT, None),
        (Signal::KILL, None),
    ] {
        burn_until(signal, code, &simulator, &file);
    }
}

/// A signal that leaves the program no time, and so no code, is the guardian's.
fn burn_until(signal: Signal, code: Option<i32>, simulator: &GrblSimulator, file: &str) {
    let mut child = rig(&["stage", "lamp", "0", "--home", "--rig", file])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap()).lines();
    let first = stderr.next().unwrap().unwrap();
    assert!(first.starts_with("lit until"), "{first}");
    assert!(
        simulator
            .bench()
            .lamp_drive()
            .iter()
            .any(|&drive| drive > 0.0)
    );
    let id = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(id, signal).unwrap();
    assert_eq!(child.wait().unwrap().code(), code);
    // The last to write is the guardian, if it had to act.
    let last = stderr.next().unwrap().unwrap();
    let expected = match code {
        Some(_) => "lamp off",
        None => "its guardian has turned it off",
    };
    assert!(last.contains(expected), "{last}");
    assert_eq!(simulator.bench().lamp_drive(), [0.0; 3]);
}

/// Azimuth, elevation and DMX address of the lights of the rig file.
fn lights() -> impl Iterator<Item = ([f64; 2], usize)> {
    let arc = |azimuth: [f64; 6], elevation| azimuth.map(|azimuth| [azimuth, elevation]);
    let low = arc([0.0, 60.0, 120.0, 180.0, -120.0, -60.0], 30.0);
    let high = [[30.0, 60.0], [120.0, 60.0], [-150.0, 60.0], [-60.0, 60.0]];
    let all: Vec<_> = low.into_iter().chain(high).collect();
    all.into_iter()
        .enumerate()
        .map(|(light, at)| (at, 3 * light + 1))
}

/// A dome on DMX has no watchdog, and its lights confirm nothing.
#[test]
fn a_killed_program_leaves_no_light_of_a_dome_lit() {
    use mock_devices::dmx::{DmxConfig, DmxSimulator};
    let built_in = include_str!("../../rig-configs/dmx-dome-v4l2.toml");
    let lights = lights().collect();
    let bench = Bench::new(BenchConfig::default(), Clock::real_time());
    let packets = DmxSimulator::spawn(DmxConfig { lights }, bench).unwrap();
    let (_folder, file) = rig_file_on_port(built_in, &packets.path().display().to_string());
    let at = ["--azimuth", "60", "--elevation", "30", "--rig", &file];
    let lamp = |more: &[&str]| rig(&[&["stage", "lamp", "0"][..], more, &at].concat());
    let is_lit = || packets.bench().lamp_drive() != [0.0; 3];
    let until = |what: &str, is: &dyn Fn() -> bool| {
        let began = Instant::now();
        while !is() {
            assert!(began.elapsed() < Duration::from_secs(30), "{what}");
            std::thread::sleep(Duration::from_millis(5));
        }
        began.elapsed()
    };
    let ended = lamp(&["--seconds", "0.1"]).output().unwrap();
    assert_eq!(ended.status.code(), Some(0), "{}", text(&ended.stderr));
    assert!(
        !text(&ended.stderr).contains("guardian"),
        "{}",
        text(&ended.stderr)
    );
    until("the end of the first", &|| !is_lit());
    let mut child = lamp(&[]).stderr(Stdio::piped()).spawn().unwrap();
    until("the lamp", &is_lit);
    child.kill().unwrap();
    let took = until("the guardian", &|| !is_lit());
    assert!(took < Duration::from_secs(3), "{took:?}");
    let said = text(&child.wait_with_output().unwrap().stderr);
    assert!(said.contains("sent it the command to turn off"), "{said}");
}

#[test]
fn a_camera_is_described_and_a_frame_is_written_once() {
    let info = run(&["camera", "info", "--rig", "simulated", "--json"]);
    let answer: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(answer["bit_depth"], 12);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("frame.png").display().to_string();
    let grab = ["camera", "grab", "--rig", "simulated", "--out", &file];
    let taken = run(&grab);
    assert_eq!(taken.status.code(), Some(0), "{}", text(&taken.stderr));
    assert_eq!(text(&taken.stdout).lines().last(), Some(file.as_str()));
    let png = std::fs::read(&file).unwrap();
    let frame = rig::session::frame::decode_png(&png).unwrap();
    assert_eq!([frame.width, frame.height], [640, 480]);
    assert_fails(&run(&grab), "exists");
    let missing = run(&["camera", "info", "--device", "/dev/video-none"]);
    assert_fails(&missing, "does not exist");
    let other = run(&["camera", "info", "--device", "/dev/null"]);
    assert_fails(&other, "/dev/null is not a camera");
    let asked = ["--exposure-ms", "99999", "--json"];
    let longest = run(&[&["camera", "grab", "--rig", "simulated"][..], &asked].concat());
    assert_eq!(longest.status.code(), Some(0));
    let told = text(&longest.stderr);
    assert!(told.contains("were requested"), "{told}");
}

#[test]
fn devices_are_listed_as_json_with_or_without_any() {
    let output = run(&["devices", "--json"]);
    assert_eq!(output.status.code(), Some(0));
    let list: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for device in list.as_array().unwrap() {
        assert!(device["path"].is_string() && device["accessible"].is_boolean());
    }
}

/// The gantry of the rig file on simulated devices, whose homing scatters by
/// 0.05 mm: what is measured is the difference of finding and homing.
#[test]
fn repeated_homing_measures_what_the_switches_scatter() {
    use mock_devices::bench::StageErrors;
    use mock_devices::zaber::{ZaberConfig, ZaberSimulator};
    let bench = BenchConfig {
        errors: StageErrors {
            homing_mm: 0.05,
            ..StageErrors::default()
        },
        ..BenchConfig::default()
    };
    let config = ZaberConfig {
        microsteps_per_unit: [2016.0; 2],
        limit_max: [2_016_000; 2],
        ..ZaberConfig::default()
    };
    let bench = Bench::new(bench, Clock::instant());
    let simulator = ZaberSimulator::spawn(config, bench).unwrap();
    let port = simulator.path().display().to_string();
    let built_in = include_str!("../../rig-configs/zaber-gantry-v4l2.toml");
    let with_port: String = built_in
        .lines()
        .map(|line| match line.strip_prefix("port = ") {
            Some(_) => format!("port = {port:?}\n"),
            None => format!("{line}\n"),
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("gantry.toml").display().to_string();
    std::fs::write(&file, with_port).unwrap();
    let output = run(&words(&format!(
        "stage repeatability --rig {file} --cycles 12 --json"
    )));
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["unit"], "mm");
    assert_eq!(answer["off"].as_array().unwrap().len(), 12);
    for axis in 0..2 {
        // 12 draws of one scatter: within 0.4 and 1.8 of it, far beyond 99.9%.
        let rms = answer["standard_deviation"][axis].as_f64().unwrap() * 2f64.sqrt();
        assert!((0.02..0.09).contains(&rms), "axis {axis}: {rms}");
    }
    let grbl = run(&["stage", "repeatability", "--rig", "simulated", "--quiet"]);
    assert_fails(&grbl, "cannot tell where it finds its switches");
}

#[test]
fn a_manual_stage_needs_a_terminal() {
    let built_in = include_str!("../../rig-configs/dmx-dome-v4l2.toml");
    let manual: String = built_in
        .lines()
        .filter(|line| {
            ["port = ", "level = ", "dmx_address = "]
                .iter()
                .all(|key| !line.starts_with(key))
        })
        .map(|line| line.replace("driver = \"dmx\"", "driver = \"manual\"") + "\n")
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("manual.toml").display().to_string();
    std::fs::write(&file, manual).unwrap();
    assert_fails(&run(&["stage", "home", "--rig", &file]), "no terminal");
}
