//! The program as a person runs it, on a stage behind a port and this camera.

use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::{Duration, Instant};

use rig::session::{Event, Session, verify};
use rustix::process::{Pid, Signal, kill_process};

use crate::stand::{SERIAL, Stand};
use crate::support::{assert_done, assert_fails, begin, run, text};

const PATIENCE: Duration = Duration::from_secs(60);

/// A capture of two lights of which so many frames are journalled.
fn begun(stand: &Stand, frames: usize) -> (Child, PathBuf) {
    stand.real_rig_file(2.0);
    let is_frame = |event: &Event| matches!(event, Event::Frame { .. });
    begin(
        stand.folder.path(),
        &["capture", "--lights", "2", "--no-fit"],
        |journal| {
            journal
                .records
                .iter()
                .filter(|record| is_frame(&record.event))
                .count()
                >= frames
        },
    )
}

fn wait_until(what: &str, is: impl Fn() -> bool) {
    let began = Instant::now();
    while !is() {
        assert!(began.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn assert_complete(root: &Path) {
    let found = verify::verify(root).unwrap();
    assert!(found.is_intact() && found.complete, "{found:?}");
}

#[test]
fn a_killed_capture_resumes_with_every_frame() {
    let stand = Stand::new(71);
    let (mut child, root) = begun(&stand, 25);
    child.kill().unwrap();
    child.wait().unwrap();
    wait_until("the lamp goes off", || !stand.is_lit());
    let before: Vec<_> = Session::open(&root).unwrap().frames().collect();
    assert!(before.len() >= 25);
    // The camera is the killed program's until its heartbeat time-out, which is waited for.
    assert!(stand.device.is_controlled());
    let resumed = ["capture", "--no-fit", "--resume", root.to_str().unwrap()];
    assert_done(&run(stand.folder.path(), &resumed));
    assert_complete(&root);
    let after: Vec<_> = Session::open(&root).unwrap().frames().collect();
    assert_eq!(after[..before.len()], before);
    assert!(!stand.is_lit());
}

#[test]
fn ctrl_z_for_longer_than_the_heartbeat_loses_nothing() {
    let stand = Stand::new(72);
    let (child, root) = begun(&stand, 14);
    let pid = Pid::from_child(&child);
    kill_process(pid, Signal::TSTP).unwrap();
    let stat = format!("/proc/{}/stat", child.id());
    wait_until("it is suspended", || {
        let stat = std::fs::read_to_string(&stat).unwrap();
        stat.rsplit(')').next().unwrap().trim().starts_with('T')
    });
    assert!(!stand.is_lit());
    wait_until("the camera lets go", || !stand.device.is_controlled());
    kill_process(pid, Signal::CONT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_done(&output);
    let stderr = text(&output.stderr);
    assert!(stderr.contains("the camera is waited for"), "{stderr}");
    assert_complete(&root);
    assert!(!stand.is_lit());
}

#[test]
fn a_camera_that_another_program_has_is_named_with_the_remedy() {
    let stand = Stand::new(73);
    stand.real_rig_file(2.0);
    let held = stand.open();
    let capture = ["capture", "--lights", "2", "--no-fit"];
    let output = run(stand.folder.path(), &capture);
    assert_fails(
        &output,
        1,
        "127.0.0.73 is controlled by another program",
        "end the other program that has the camera",
    );
    assert!(!stand.is_lit());
    drop(held);
}

#[test]
fn the_rig_file_of_the_documents_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let text = include_str!("../../rig-configs/genicam.toml");
    std::fs::write(folder.path().join("rig.toml"), text).unwrap();
    let rig = rig::config::RigConfig::load(&folder.path().join("rig.toml")).unwrap();
    let rig::config::CameraDriver::Described { driver, .. } = &rig.camera.driver else {
        panic!("{:?}", rig.camera.driver);
    };
    assert_eq!(driver.name, "genicam");
    assert_eq!(rig.camera.settings_latency_frames, 0);
    assert_eq!(rig.camera.serial.as_deref(), Some("12345678"));
    assert_ne!(rig.camera.serial.as_deref(), Some(SERIAL));
}
