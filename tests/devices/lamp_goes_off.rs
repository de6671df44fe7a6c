//! Nothing that a terminal, a pipe, a signal or a program at the other end does
//! leaves the lamp lit: `rig` as a person runs it, on simulated firmware behind a
//! port of its own, whose bench says what is lit.

use std::io::{PipeReader, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::command_support::{self, stderr};
use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::grbl::{Fault, GrblConfig, GrblSimulator, Trigger};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Action, tcflow};
use tempfile::TempDir;

/// What nothing here should ever take.
const PATIENCE: Duration = Duration::from_secs(60);

/// A stage on its port, and a rig file that names it.
struct Stage {
    simulator: GrblSimulator,
    folder: TempDir,
}

impl Stage {
    fn new() -> Self {
        let bench = Bench::new(BenchConfig::default(), Clock::instant());
        let simulator = GrblSimulator::spawn(GrblConfig::default(), bench).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let port = simulator.path().display().to_string();
        let text: String = include_str!("../../rig-configs/grbl-arm-v4l2.toml")
            .lines()
            .map(|line| match line.strip_prefix("port = ") {
                Some(_) => format!("port = {port:?}\nreply_timeout_s = 1.0\n"),
                None => format!("{line}\n"),
            })
            .collect();
        std::fs::write(folder.path().join("rig.toml"), text).unwrap();
        Self { simulator, folder }
    }

    fn is_lit(&self) -> bool {
        self.simulator.bench().lamp_drive() != [0.0; 3]
    }

    /// `rig stage lamp`, once the lamp is lit.
    fn light(&self, more: &[&str], stderr: impl Into<Stdio>) -> Running {
        let child = rig(&["stage", "lamp", "0", "--home", "--rig", "rig.toml"])
            .args(more)
            .current_dir(self.folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(stderr)
            // A job of its own: of an orphaned group the system stops nobody for SIGTTIN.
            .process_group(0)
            .spawn()
            .unwrap();
        wait_until("lit", || self.is_lit());
        Running(child)
    }
}

fn rig(arguments: &[&str]) -> Command {
    command_support::rig(".", arguments)
}

/// Killed where a test fails.
struct Running(Child);

impl Running {
    fn pid(&self) -> Pid {
        Pid::from_child(&self.0)
    }

    /// Its exit code, once it has ended by itself.
    fn code(&mut self) -> Option<i32> {
        let began = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status.code();
            }
            assert!(began.elapsed() < PATIENCE, "it does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// What it said to the end.
    fn said(&mut self) -> String {
        let mut said = String::new();
        let mut stderr = self.0.stderr.take().unwrap();
        stderr.read_to_string(&mut said).unwrap();
        said
    }

    /// Its guardian.
    fn guardian(&self) -> Pid {
        let parent = self.0.id();
        let mut found = None;
        wait_until("a guardian", || {
            found = children_of(parent).into_iter().next();
            found.is_some()
        });
        found.unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// Parent and state of a process, by its number; `None` where it is gone.
fn parent_and_state(process: &str) -> Option<(u32, char)> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let (_, after) = stat.rsplit_once(") ")?;
    let mut words = after.split(' ');
    let state = words.next()?.chars().next()?;
    Some((words.next()?.parse().ok()?, state))
}

/// Whether a process has ended, buried or not.
fn is_gone(process: &str) -> bool {
    parent_and_state(process).is_none_or(|(_, state)| state == 'Z')
}

fn children_of(parent: u32) -> Vec<Pid> {
    std::fs::read_dir("/proc")
        .unwrap()
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| parent_and_state(name).is_some_and(|(of, _)| of == parent))
        .filter_map(|name| Pid::from_raw(name.parse().ok()?))
        .collect()
}

#[track_caller]
fn wait_until(what: &str, mut is: impl FnMut() -> bool) -> Duration {
    let began = Instant::now();
    while !is() {
        assert!(began.elapsed() < PATIENCE, "not {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
    began.elapsed()
}

/// A pipe that is full, and its unread end.
fn full_pipe() -> (PipeReader, OwnedFd) {
    let (reader, mut writer) = std::io::pipe().unwrap();
    let flags = fcntl_getfl(&writer).unwrap();
    fcntl_setfl(&writer, flags | OFlags::NONBLOCK).unwrap();
    while writer.write(&[b'x'; 512]).is_ok() {}
    fcntl_setfl(&writer, flags).unwrap();
    (reader, writer.into())
}

/// A terminal after Ctrl-S: its master and itself.
fn stopped_terminal() -> (OwnedFd, OwnedFd) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    let flags = OFlags::RDWR | OFlags::NOCTTY;
    let terminal = rustix::fs::open(name.as_c_str(), flags, rustix::fs::Mode::empty()).unwrap();
    tcflow(terminal.as_fd(), Action::OOff).unwrap();
    (master, terminal)
}

/// Nobody reads, and the program goes on, obeys signals and ends by itself.
#[test]
fn a_stderr_that_takes_nothing_holds_nobody() {
    let (soon, late) = (&["--seconds", "0.5"][..], &["-vv"][..]);
    std::thread::scope(|scope| {
        for (is_terminal, more, signal, code) in [
            (false, soon, None, 0),
            (false, &["--seconds", "0.5", "-vv"], None, 0),
            (false, late, Some(Signal::INT), 130),
            (true, soon, None, 0),
            (true, late, Some(Signal::TERM), 143),
        ] {
            scope.spawn(move || {
                let stage = Stage::new();
                let (_other_end, stderr) = match is_terminal {
                    true => stopped_terminal(),
                    false => {
                        let (reader, stderr) = full_pipe();
                        (reader.into(), stderr)
                    }
                };
                let mut running = stage.light(more, stderr);
                if let Some(signal) = signal {
                    kill_process(running.pid(), signal).unwrap();
                }
                let took = wait_until("dark", || !stage.is_lit());
                assert!(took < Duration::from_secs(5), "{more:?}: {took:?}");
                assert_eq!(running.code(), Some(code), "{more:?} {is_terminal}");
                assert!(!stage.is_lit());
            });
        }
    });
}

/// Whom a signal reaches.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Victim {
    Program,
    Guardian,
}

/// A program that does not go on is relieved, also where it was not killed; one
/// whose guardian is gone turns the lamp off itself.
#[test]
fn the_program_and_its_guardian_watch_over_each_other() {
    use Victim::*;
    std::thread::scope(|scope| {
        for (victim, signal, fact) in [
            (
                Program,
                Signal::STOP,
                "its guardian has taken the stage over",
            ),
            (
                Program,
                Signal::TTIN,
                "its guardian has taken the stage over",
            ),
            (Program, Signal::KILL, "its guardian has turned it off"),
            (Guardian, Signal::KILL, "has ended or does not answer"),
            (Guardian, Signal::STOP, "has ended or does not answer"),
        ] {
            scope.spawn(move || {
                let case = format!("{victim:?} {signal:?}");
                let stage = Stage::new();
                let mut running = stage.light(&[], Stdio::piped());
                let guardian = running.guardian();
                kill_process(
                    match victim {
                        Program => running.pid(),
                        Guardian => guardian,
                    },
                    signal,
                )
                .unwrap();
                let took = wait_until("dark", || !stage.is_lit());
                // Switching the lamp is announced with 4 s, and 3 s later it is off.
                assert!(took < Duration::from_secs(8), "{case}: {took:?}");
                let taken = stage.simulator.bytes_taken();
                if victim == Program && signal != Signal::KILL {
                    // What wakes finds itself relieved.
                    kill_process(running.pid(), Signal::CONT).unwrap();
                }
                let code = running.code();
                assert_eq!(
                    code,
                    (signal != Signal::KILL || victim == Guardian).then_some(1)
                );
                let said = running.said();
                assert!(said.contains(fact), "{case}: {said}");
                // One that was killed says no more.
                let hint = match (victim, signal) {
                    (Program, Signal::KILL) => "",
                    (Program, _) => "find out what stopped the program",
                    (Guardian, _) => "leave the process `rig guardian` alone",
                };
                assert!(said.contains(hint), "{case}: {said}");
                assert!(!said.contains("internal error"), "{case}: {said}");
                assert!(!stage.is_lit(), "{case}");
                if victim == Program {
                    // The guardian's stop once more at most, of a few bytes each.
                    let more = stage.simulator.bytes_taken() - taken;
                    assert!(more < 20, "{case}: {more} bytes were sent");
                }
                let guardian = guardian.as_raw_nonzero().to_string();
                wait_until("ended", || is_gone(&guardian));
            });
        }
    });
}

/// Ctrl-Z: the lamp goes off first, and stays off when the program goes on.
#[test]
fn ctrl_z_turns_the_lamp_off_before_it_suspends() {
    let stage = Stage::new();
    let mut running = stage.light(&[], Stdio::piped());
    let process = running.0.id().to_string();
    for _ in 0..2 {
        kill_process(running.pid(), Signal::TSTP).unwrap();
    }
    wait_until("suspended", || {
        parent_and_state(&process).is_some_and(|(_, state)| state == 'T')
    });
    assert!(!stage.is_lit());
    // Longer than any step: with the lamp off nothing is overdue.
    std::thread::sleep(Duration::from_millis(3500));
    kill_process(running.pid(), Signal::CONT).unwrap();
    assert_eq!(running.code(), Some(0));
    let said = running.said();
    assert!(said.contains("suspended: the lamp is off"), "{said}");
    assert!(said.contains("the lamp stays off"), "{said}");
    assert!(!said.contains("guardian"), "{said}");
    assert!(!stage.is_lit());
}

/// A lamp that is out of the program's hands is said to be, within seconds.
#[test]
fn a_stage_that_goes_away_or_restarts_is_noticed() {
    type Blow = fn(&GrblSimulator);
    let blows: [(Blow, &str, &str); 3] = [
        (|s| s.unplug(), "was disconnected", "may still be lit"),
        (|s| s.faults().inject(Trigger::Always, Fault::Reset), "", ""),
        (
            |s| s.faults().inject(Trigger::Always, Fault::NoReply),
            "did not answer",
            "",
        ),
    ];
    std::thread::scope(|scope| {
        for (blow, fact, hint) in blows {
            scope.spawn(move || {
                let stage = Stage::new();
                let mut running = stage.light(&[], Stdio::piped());
                let began = Instant::now();
                blow(&stage.simulator);
                assert_eq!(running.code(), Some(1));
                let took = began.elapsed();
                let said = running.said();
                assert!(took < Duration::from_secs(15), "{took:?}: {said}");
                assert!(said.contains(fact) && said.contains(hint), "{said}");
            });
        }
    });
}

/// A rig whose camera is this shell script, in a folder of its own.
fn command_camera(script: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let lines = include_str!("../../rig-configs/grbl-arm-v4l2.toml").lines();
    let text: String = lines
        .filter(|line| !["device = ", "format = ", "serial = "].iter().any(|key| line.starts_with(key)))
        .map(|line| match line {
            "driver = \"v4l\"" => {
                "driver = \"command\"\ncommand = \"sh camera.sh {output} {exposure_s}\"\nframe_timeout_s = 600.0\n"
                    .to_owned()
            }
            line => format!("{line}\n"),
        })
        .collect();
    std::fs::write(folder.path().join("rig.toml"), text).unwrap();
    std::fs::write(folder.path().join("camera.sh"), script).unwrap();
    std::fs::create_dir(folder.path().join("tmp")).unwrap();
    folder
}

fn grab(folder: &Path) -> Command {
    let mut command = rig(&["camera", "grab", "--rig", "rig.toml"]);
    command
        .current_dir(folder)
        .env("TMPDIR", folder.join("tmp"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    command
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries.flatten().map(|entry| entry.path()).collect()
}

/// However `rig` ends, the camera's program ends with all it has started, and its
/// folder is removed.
#[test]
fn a_camera_s_program_ends_with_the_program_that_started_it() {
    std::thread::scope(|scope| {
        for signal in [Signal::INT, Signal::TERM, Signal::HUP, Signal::KILL] {
            scope.spawn(move || {
                let folder = command_camera(
                    // By the time of the signal the keeper has been told, also on a loaded machine.
                    "echo half > $1; sleep 600 & echo $! > pid.new; sleep 1; mv pid.new pid; wait",
                );
                let running = Running(grab(folder.path()).spawn().unwrap());
                let pid = folder.path().join("pid");
                wait_until("started", || pid.exists());
                let sleeps = std::fs::read_to_string(pid).unwrap();
                let tmp = folder.path().join("tmp");
                assert_eq!(files_in(&tmp).len(), 1);
                kill_process(running.pid(), signal).unwrap();
                wait_until("ended", || is_gone(sleeps.trim()));
                wait_until("removed", || files_in(&tmp).is_empty());
            });
        }
    });
}

#[test]
fn what_a_camera_s_program_leaves_is_named_for_what_it_is() {
    for (script, tmp, fact) in [
        (
            "mkfifo $1",
            "tmp",
            "frame.tif: it is a named pipe, not a regular file",
        ),
        ("mkdir $1", "tmp", "frame.tif: Is a directory"),
        (
            "ln -s /dev/zero $1",
            "tmp",
            "frame.tif: it is a device, not a regular file",
        ),
        ("exit 0", "tmp", "it wrote no file"),
        ("exit 0", "gone", "the folder for temporary files, "),
    ] {
        let folder = command_camera(script);
        let output = grab(folder.path())
            .env("TMPDIR", folder.path().join(tmp))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1));
        let said = stderr(&output);
        assert!(said.contains(fact), "{script}: {said}");
        assert_eq!(said.contains("TMPDIR"), tmp == "gone", "{said}");
        assert!(files_in(&folder.path().join("tmp")).is_empty(), "{script}");
    }
}
