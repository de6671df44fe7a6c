//! A capture that is started and steered from the console's page.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::time::Duration;

use crate::command_support::{good, only_session, run, workplace};
use crate::support::{Console, PATIENCE};
use rustix::process::Signal;
use serde_json::json;

fn console(folder: &Path) -> Console {
    Console::start(folder, &["console", "--rig", "rig.toml"])
}

fn form() -> serde_json::Value {
    json!({"sample": "bowl", "lights": "2", "fit": false})
}

#[test]
fn a_capture_from_the_form_is_followed_to_its_end() {
    let folder = workplace(|text| text);
    let console = console(folder.path());
    let plan = console.post("a", "/api/plan", &form());
    assert_eq!(plan.status, 200, "{}", plan.text());
    let plan = plan.json();
    let command = "rig capture --rig=rig.toml --out=sessions --sample=bowl --lights=2 --no-fit";
    assert_eq!(plan["command"], command);
    assert_eq!(plan["plan"]["lights"].as_array().unwrap().len(), 2);
    assert!(
        only_session(folder.path()).is_none(),
        "a plan captures nothing"
    );
    assert!(console.get("/api/doctor").json()["checks"].is_array());

    let mut events = console.events("a");
    let started = console.post("a", "/api/capture/start", &form());
    assert_eq!(
        (started.status, &started.json()["command"]),
        (202, &json!(command))
    );
    let capture = events.wait_for("capture", |capture| capture["state"] == "complete");
    let lights = capture["lights"].as_array().unwrap();
    assert!(
        lights.len() == 2 && lights.iter().all(|light| light["state"] == "done"),
        "{capture}"
    );
    assert!(capture["frame"]["number"].as_u64() > Some(1), "{capture}");
    assert_eq!(capture["done"], 1.0);
    let job = events.wait_for("job", |job| job["state"] == "done");
    assert_eq!(
        (&job["exit"], &job["command"]),
        (&json!(0), &json!(command))
    );
    let session = only_session(folder.path()).unwrap();
    assert!(
        job["result"]
            .as_str()
            .unwrap()
            .ends_with(session.file_name().unwrap().to_str().unwrap())
    );
    good(run(
        folder.path(),
        &["session", "verify", session.to_str().unwrap()],
    ));
    events.wait_for("sessions", |sessions| {
        sessions["changed"].as_u64() >= Some(1)
    });
}

#[test]
fn a_capture_is_paused_and_stopped_by_buttons_and_can_be_resumed() {
    let folder = workplace(|text| text.replace("timing = \"instant\"", "timing = \"realistic\""));
    let console = console(folder.path());
    let act = |viewer, action: &str| {
        let answer = console.post(viewer, &format!("/api/capture/{action}"), &json!({}));
        (answer.status, answer.text())
    };
    let mut events = console.events("a");
    assert_eq!(console.post("a", "/api/capture/start", &form()).status, 202);
    assert_eq!(console.post("a", "/api/capture/start", &form()).status, 409);
    events.wait_for("capture", |capture| {
        capture["frame"]["number"].as_u64() >= Some(1)
    });
    assert_eq!(act("b", "pause").0, 409);
    assert_eq!(act("a", "pause").0, 202);
    events.wait_for("capture", |capture| capture["state"] == "paused");
    events.wait_for("job", |job| job["state"] == "paused");
    assert_eq!(act("a", "continue").0, 202);
    events.wait_for("capture", |capture| capture["state"] != "paused");
    // By anyone, and by either address.
    let stopping = r#"{"stopping":"a capture"}"#.to_owned();
    let at_bench = console.post("b", "/api/bench/stop", &json!({}));
    assert_eq!((at_bench.status, at_bench.text()), (202, stopping.clone()));
    assert_eq!(act("b", "stop"), (202, stopping));
    events.wait_for("capture", |capture| capture["state"] == "interrupted");
    let job = events.wait_for("job", |job| job["state"] == "interrupted");
    assert!([130, 143].contains(&job["exit"].as_i64().unwrap()), "{job}");

    let name = only_session(folder.path()).unwrap();
    let name = name.file_name().unwrap().to_str().unwrap().to_owned();
    let form = json!({"session": name, "fit": false});
    let resumed = console.post("a", "/api/capture/resume", &form);
    assert_eq!(resumed.status, 202, "{}", resumed.text());
    let job = events.wait_for("job", |job| job["state"] == "running");
    assert!(
        job["command"].as_str().unwrap().ends_with(" --no-fit"),
        "{job}"
    );
    // After this frame.
    events.wait_for("capture", |capture| {
        capture["frame"]["number"].as_u64() >= Some(1)
    });
    assert_eq!(act("a", "finish").0, 202);
    events.wait_for("capture", |capture| capture["state"] == "interrupted");
    events.wait_for("job", |job| job["exit"] == 130);
}

#[test]
fn a_console_that_is_ended_passes_it_on_and_waits() {
    let folder = workplace(|text| text.replace("timing = \"instant\"", "timing = \"realistic\""));
    let mut console = console(folder.path());
    let mut events = console.events("a");
    assert_eq!(console.post("a", "/api/capture/start", &form()).status, 202);
    let job = events.wait_for("job", |job| job["pid"].is_u64());
    events.wait_for("capture", |capture| {
        capture["frame"]["number"].as_u64() >= Some(1)
    });
    console.send(Signal::TERM);
    assert_eq!(console.wait(), Some(143), "{}", console.stderr());
    let pid = job["pid"].as_u64().unwrap();
    assert!(
        !Path::new(&format!("/proc/{pid}")).exists(),
        "the capture has ended before it"
    );
    let session = only_session(folder.path()).unwrap();
    good(run(
        folder.path(),
        &["session", "verify", session.to_str().unwrap()],
    ));
}

/// A paused process takes no signal but the one that continues it.
#[test]
fn a_console_is_ended_while_its_capture_is_paused() {
    std::thread::scope(|scope| {
        for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
            scope.spawn(move || {
                let folder = workplace(|text| {
                    text.replace("timing = \"instant\"", "timing = \"realistic\"")
                });
                let mut console = console(folder.path());
                let mut events = console.events("a");
                assert_eq!(console.post("a", "/api/capture/start", &form()).status, 202);
                let job = events.wait_for("job", |job| job["pid"].is_u64());
                events.wait_for("capture", |capture| {
                    capture["frame"]["number"].as_u64() >= Some(1)
                });
                console.post("a", "/api/capture/pause", &json!({}));
                events.wait_for("capture", |capture| capture["state"] == "paused");
                let began = std::time::Instant::now();
                console.send(signal);
                assert_eq!(console.wait(), Some(code), "{}", console.stderr());
                assert!(began.elapsed() < Duration::from_secs(15), "{signal:?}");
                assert!(!Path::new(&format!("/proc/{}", job["pid"])).exists());
            });
        }
    });
}

#[test]
fn a_console_that_is_killed_harms_no_capture() {
    let folder = workplace(|text| text);
    let mut console = console(folder.path());
    let mut events = console.events("a");
    assert_eq!(console.post("a", "/api/capture/start", &form()).status, 202);
    let job = events.wait_for("job", |job| job["pid"].is_u64());
    console.send(Signal::KILL);
    console.wait();
    let process = format!("/proc/{}/stat", job["pid"]);
    let began = std::time::Instant::now();
    // Whoever inherits it may not have waited for it yet.
    while fs::read_to_string(&process).is_ok_and(|stat| !stat.contains(") Z")) {
        assert!(
            began.elapsed() < Duration::from_secs(120),
            "it does not end"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
    let session = only_session(folder.path()).unwrap();
    let shown = run(
        folder.path(),
        &["session", "verify", session.to_str().unwrap()],
    );
    good(shown);
    let journal = rig::session::Journal::read(&session).unwrap();
    assert!(journal.is_complete(), "the capture went on to its end");
}

#[test]
fn a_capture_with_a_console_prints_its_session_and_ends_as_it_did() {
    let folder = workplace(|text| text);
    let arguments = [
        "capture",
        "--console",
        "--rig=rig.toml",
        "--lights=1",
        "--no-fit",
    ];
    let mut console = Console::start(folder.path(), &arguments);
    let mut events = console.events("a");
    events.wait_for("job", |job| job["state"] == "done");
    assert_eq!(console.get("/").status, 200, "the console stays");
    let began = std::time::Instant::now();
    while !console
        .stderr()
        .contains("the console stays; Ctrl-C ends it")
    {
        assert!(began.elapsed() < PATIENCE, "{}", console.stderr());
        std::thread::sleep(Duration::from_millis(50));
    }
    console.send(Signal::INT);
    assert_eq!(console.wait(), Some(0), "{}", console.stderr());
    let mut rest = String::new();
    console.stdout.read_to_string(&mut rest).unwrap();
    let session = only_session(folder.path()).unwrap();
    assert_eq!(folder.path().join(rest.trim()), session);
}
