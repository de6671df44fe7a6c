//! Every way out of a capture, each in a process of its own, on simulated
//! firmware behind a pseudo-terminal: what the bench itself says about lamp and
//! motion afterwards.

use crate::capture_support as support;
use crate::command_support::words;

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use mock_devices::bench::{LampModel, StageErrors};
use mock_devices::camera::CameraConfig;
use mock_devices::grbl::{Fault, Trigger};
use mock_devices::sensor::SensorConfig;
use rig::capture::Outcome;
use rig::cli::exit::Exit;
use rig::cli::output::write_stderr;
use rig::device::grbl::{GrblConfig, GrblStage};
use rig::device::guardian::{GuardedStage, Watchdog};
use rig::device::kinematics::{AxisMap, Mechanism, TwoAxes};
use rig::device::simulated::{SimulatedBench, SimulatedConfig};
use rig::device::*;
use rig::session::faults::UnsyncedDisk;
use rig::units::{Seconds, StageAngles};
use rustix::process::{Pid, Signal, kill_process};

const PORT: &str = "WAYS_OUT_PORT";
const DEFECT: &str = "WAYS_OUT_DEFECT";
const REPLY_S: &str = "WAYS_OUT_REPLY_S";
/// What a reply of the stage may take where its driver is not to wait for one: a step
/// of the lamp is announced with four times that.
const QUICK_REPLY_S: f64 = 4.0;
/// In which the guardian has promised to act.
const PROMISE: Duration = Duration::from_secs(3);
/// What nothing here should ever take.
const PATIENCE: Duration = Duration::from_secs(60);

/// Nine axis units from end to end, at two units per second.
fn stage_config(port: &str) -> GrblConfig {
    let map = |min, max| AxisMap {
        scale: 0.1,
        offset: min,
        min,
        max,
    };
    GrblConfig {
        kinematics: TwoAxes {
            mechanism: Mechanism::Rotary,
            first: map(-45.0, 45.0),
            second: map(0.0, 90.0),
            approach: 2.0,
        },
        feed_per_min: 120.0,
        lamp_on: vec![vec!["M3 S1000".to_owned()], vec!["M8".to_owned()]],
        reply_timeout: Seconds(30.0),
        ..GrblConfig::of_port(port, 115_200)
    }
}

fn start_bench() -> SimulatedBench {
    SimulatedBench::start(SimulatedConfig {
        stage: stage_config(""),
        errors: StageErrors::default(),
        lamp: LampModel::default(),
        channel_of_colour: [Some(0), Some(1), None],
        sensor: SensorConfig::typical([8, 4], 1),
        camera: CameraConfig::default(),
        camera_serial: String::new(),
        mosaic: Mosaic::None,
        instant: false,
        seed: 1,
    })
    .unwrap()
}

/// The stage on the port, whose lamp and position the camera in memory sees.
struct Seen(Box<dyn LightStage>, support::Bench);

impl LightStage for Seen {
    fn info(&self) -> &StageInfo {
        self.0.info()
    }
    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        self.0.home()
    }
    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        let reached = self.0.move_to(target)?;
        self.1.world().position = Some(target);
        Ok(reached)
    }
    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        let applied = self.0.set_lamp(lamp)?;
        self.1.world().lamp = applied;
        Ok(applied)
    }
    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        self.0.status()
    }
    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        self.0.stop_handle()
    }
    fn watchdog(&self) -> Watchdog {
        self.0.watchdog()
    }
}

/// Not a test of its own but the process that the tests below start: a capture
/// as the program does it, with a camera in memory.
#[test]
fn the_process_that_is_ended() {
    if let Ok(port) = std::env::var(PORT) {
        std::process::exit(rig::cli::guarded(|| capture(&port)).code().into());
    }
}

fn capture(port: &str) -> Exit {
    let interrupt = rig::cli::interrupt::listen().unwrap();
    let bench = support::Bench::with(|world| {
        world.interrupt = interrupt.clone();
        world.frame_time = Duration::from_millis(10);
        match std::env::var(DEFECT).as_deref() {
            Ok("panic") => world.panic_at_frame = Some(3),
            Ok("camera panic") => world.panic_at_grab = Some(5),
            Ok("camera") => world.fail_at_grab = Some(5),
            Ok("camera hangs") => world.hang_at_grab = Some(3),
            Ok("thread hangs") => world.hang_at_frame = Some(3),
            _ => {}
        }
    });
    let reply_s = std::env::var(REPLY_S).unwrap().parse().unwrap();
    let config = GrblConfig {
        reply_timeout: Seconds(reply_s),
        ..stage_config(port)
    };
    let stage = GrblStage::open(config).unwrap();
    let guarded = GuardedStage::guard(Box::new(stage), |port| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rig"));
        command.args(["guardian", "--port", port]);
        command
    });
    let session = support::create(Arc::new(UnsyncedDisk), Path::new(".")).unwrap();
    let stage = Box::new(Seen(guarded.unwrap(), bench.clone()));
    match support::capture_with_stage(&bench, stage, session).0 {
        Ok(Outcome::Complete) => Exit::Done,
        Ok(Outcome::Interrupted) => Exit::Signal(interrupt.signal().unwrap()),
        Err(error) => {
            write_stderr(&format!("{error}\n"));
            Exit::Failed
        }
    }
}

fn start(bench: &SimulatedBench, folder: &Path, defect: &str, reply_s: f64) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(words(
            "--exact ways_out::the_process_that_is_ended --nocapture",
        ))
        .env(PORT, bench.stage_config().port)
        .env(DEFECT, defect)
        .env(REPLY_S, reply_s.to_string())
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// When it is ended.
#[derive(Clone, Copy, Debug)]
enum Moment {
    /// While the stage moves to its first light.
    Moving,
    /// While frames are taken under the lamp.
    Lit,
    /// While the driver waits for the answer to the command that lit the lamp.
    Waiting,
}

fn is_lit(bench: &SimulatedBench) -> bool {
    bench.bench().lamp_drive().iter().any(|&drive| drive > 0.0)
}

/// Degrees that the stage turned in the last so many seconds.
fn turned_deg(bench: &SimulatedBench, seconds: f64) -> f64 {
    let now_s = bench.bench().clock().now_s();
    bench.bench().turned_deg(now_s - seconds, now_s)
}

#[track_caller]
fn wait_until(what: &str, mut is: impl FnMut() -> bool) -> Duration {
    let began = Instant::now();
    while !is() {
        assert!(began.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
    began.elapsed()
}

/// What it said and how it ended. Standard error closes when the guardian has ended,
/// too; neither may outlast [`PATIENCE`].
#[track_caller]
fn output_in_time(child: Child, case: &str) -> Output {
    let (ended, ends) = std::sync::mpsc::channel();
    std::thread::spawn(move || ended.send(child.wait_with_output()));
    let output = ends.recv_timeout(PATIENCE);
    output
        .unwrap_or_else(|_| panic!("{case}: it or its guardian does not end"))
        .unwrap()
}

/// Ends one capture and returns its exit code (none where a signal killed it)
/// and what it said.
fn end_one(moment: Moment, signals: &[Signal], defect: &str) -> (Option<i32>, String) {
    let case = format!("{moment:?} {signals:?} {defect}");
    let bench = start_bench();
    if matches!(moment, Moment::Waiting) {
        let line = Trigger::Line("M3".to_owned());
        bench.stage_faults().inject(line, Fault::NoReply);
    }
    let folder = tempfile::tempdir().unwrap();
    let child = start(&bench, folder.path(), defect, 30.0);
    match moment {
        Moment::Moving => {
            let moves = || bench.bench().is_homed() && turned_deg(&bench, 0.1) > 0.0;
            wait_until(&case, moves);
        }
        Moment::Lit | Moment::Waiting => {
            wait_until(&case, || is_lit(&bench));
        }
    }
    for &signal in signals {
        kill_process(Pid::from_child(&child), signal).unwrap();
    }
    let mut ended = child;
    if signals.contains(&Signal::KILL) {
        ended.wait().unwrap();
        let safe = || !is_lit(&bench) && turned_deg(&bench, 0.05) == 0.0;
        let took = wait_until(&case, safe);
        write_stderr(&format!("{case}: lamp off and standing after {took:?}\n"));
        assert!(took < PROMISE, "{case}: {took:?}");
    }
    let output = output_in_time(ended, &case);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!is_lit(&bench), "{case}: {said}");
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(turned_deg(&bench, 0.3), 0.0, "{case}: {said}");
    // The port is free for the next command, which finds a stage to be homed.
    let mut next = GrblStage::open(bench.stage_config()).unwrap();
    let status = next.status().unwrap();
    assert_eq!(status.lamp, Some(LampState::Off), "{case}: {said}");
    (output.status.code(), said)
}

/// All cases side by side: most of their time they wait for the bench.
fn end_all(moment: Moment, cases: &[(&[Signal], &str, Option<i32>, &str)]) {
    std::thread::scope(|scope| {
        for &(signals, defect, code, fact) in cases {
            scope.spawn(move || {
                let (found, said) = end_one(moment, signals, defect);
                assert_eq!(found, code, "{moment:?} {signals:?} {defect}: {said}");
                assert!(said.contains(fact), "{moment:?} {signals:?}: {said}");
            });
        }
    });
}

const GUARDIAN: &str = "its guardian has turned it off";

#[test]
fn the_lamp_is_lit() {
    end_all(
        Moment::Lit,
        &[
            (&[Signal::INT], "", Some(130), ""),
            (&[Signal::TERM], "", Some(143), ""),
            (&[Signal::HUP], "", Some(129), ""),
            (&[Signal::INT, Signal::INT], "", Some(130), ""),
            (&[], "panic", Some(2), "a defect"),
            (&[], "camera panic", Some(1), "camera thread ended"),
            (&[], "camera", Some(1), "no frame"),
            (&[Signal::QUIT], "", None, GUARDIAN),
            (&[Signal::KILL], "", None, GUARDIAN),
        ],
    );
}

#[test]
fn the_stage_moves() {
    end_all(
        Moment::Moving,
        &[
            (&[Signal::INT], "", Some(130), ""),
            (&[Signal::TERM], "", Some(143), ""),
            (&[Signal::HUP], "", Some(129), ""),
            (&[Signal::KILL], "", None, GUARDIAN),
        ],
    );
}

#[test]
fn the_driver_waits_for_a_reply() {
    end_all(
        Moment::Waiting,
        &[
            (&[Signal::INT], "", Some(130), ""),
            (&[Signal::HUP], "", Some(129), ""),
            (&[Signal::TERM, Signal::TERM], "", Some(143), ""),
            (&[Signal::KILL], "", None, GUARDIAN),
        ],
    );
}

/// Who does not go on, and why.
#[derive(Clone, Copy, Debug)]
enum Blow {
    /// The capture's process gets this signal.
    Process(Signal),
    /// Its guardian gets this signal.
    Guardian(Signal),
    /// A defect of its own.
    Defect(&'static str),
}

/// The guardian of a capture's process: its only child.
fn guardian_of(child: &Child) -> Pid {
    let is_child = |name: &str| {
        let stat = std::fs::read_to_string(format!("/proc/{name}/stat")).unwrap_or_default();
        let after = stat.rsplit_once(") ").map_or("", |(_, after)| after);
        after.split(' ').nth(1) == Some(&child.id().to_string())
    };
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let mut names = processes.filter_map(|entry| entry.file_name().into_string().ok());
    let name = names.find(|name| is_child(name)).expect("a guardian");
    Pid::from_raw(name.parse().unwrap()).unwrap()
}

/// A capture that does not go on leaves no lamp lit, whatever keeps it; where it still
/// can it ends with an error and a session that resumes.
#[test]
fn a_capture_that_does_not_go_on_is_relieved() {
    use Blow::*;
    let relieved = "its guardian has taken the stage over";
    let unguarded = "has ended or does not answer";
    std::thread::scope(|scope| {
        for (blow, code, fact) in [
            (Process(Signal::STOP), Some(1), relieved),
            (Guardian(Signal::KILL), Some(1), unguarded),
            (Guardian(Signal::STOP), Some(1), unguarded),
            (Defect("camera hangs"), Some(1), relieved),
            (Defect("thread hangs"), None, "has turned it off"),
        ] {
            scope.spawn(move || {
                let bench = start_bench();
                let folder = tempfile::tempdir().unwrap();
                let defect = match blow {
                    Defect(defect) => defect,
                    _ => "",
                };
                let mut child = start(&bench, folder.path(), defect, QUICK_REPLY_S);
                wait_until("lit", || is_lit(&bench));
                let pid = Pid::from_child(&child);
                match blow {
                    Process(signal) => kill_process(pid, signal).unwrap(),
                    Guardian(signal) => kill_process(guardian_of(&child), signal).unwrap(),
                    Defect(_) => {}
                }
                // Longer than the lamp is off for an ambient frame.
                let mut dark_since = Instant::now();
                let took = wait_until("dark", || {
                    let now = Instant::now();
                    if is_lit(&bench) {
                        dark_since = now;
                    }
                    now.duration_since(dark_since) > Duration::from_secs(2)
                });
                write_stderr(&format!("{blow:?}: dark for good after {took:?} - 2 s\n"));
                let announced = Duration::from_secs_f64(4.0 * QUICK_REPLY_S);
                assert!(
                    took < announced + PROMISE + Duration::from_secs(2),
                    "{blow:?}"
                );
                match (blow, code) {
                    (Process(_), _) => kill_process(pid, Signal::CONT).unwrap(),
                    (_, None) => child.kill().unwrap(),
                    _ => {}
                }
                let output = output_in_time(child, &format!("{blow:?}"));
                let said = String::from_utf8_lossy(&output.stderr);
                assert_eq!(output.status.code(), code, "{blow:?}: {said}");
                assert!(said.contains(fact), "{blow:?}: {said}");
                assert!(!is_lit(&bench), "{blow:?}: {said}");
                let root = support::session_in(folder.path()).unwrap();
                drop(bench);
                support::resume(Arc::new(UnsyncedDisk), &root);
            });
        }
    });
}

/// A stage that answers nothing any more, though it obeys, costs no more than a few seconds:
/// its time-outs do not follow each other.
#[test]
fn a_stage_that_falls_mute_is_not_waited_for() {
    std::thread::scope(|scope| {
        for signals in [1, 2] {
            scope.spawn(move || {
                let bench = start_bench();
                let folder = tempfile::tempdir().unwrap();
                let mut child = start(&bench, folder.path(), "", 2.0);
                wait_until("lit", || is_lit(&bench));
                bench.stage_faults().inject(Trigger::Always, Fault::NoReply);
                let asked = Instant::now();
                for _ in 0..signals {
                    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
                }
                wait_until("ended", || child.try_wait().unwrap().is_some());
                let took = asked.elapsed();
                assert!(took < Duration::from_secs(5), "{signals}: {took:?}");
                wait_until("dark", || !is_lit(&bench));
                assert!(asked.elapsed() < Duration::from_secs(5), "{signals}");
                let output = output_in_time(child, "mute");
                let said = String::from_utf8_lossy(&output.stderr);
                assert_eq!(output.status.code(), Some(1), "{said}");
                assert!(said.contains("did not confirm that it stopped"), "{said}");
            });
        }
    });
}
