//! The bench of `rig console`: live picture, moves, lamp and stop over HTTP, on the simulated
//! rig, and on simulated firmware behind a port of its own, whose bench says what is lit.

use std::path::Path;
use std::time::{Duration, Instant};

use image::{ImageBuffer, Luma};
use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::grbl::{Fault, GrblConfig, GrblSimulator, Trigger};
use rustix::process::Signal;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::command_support::workplace;
use crate::support::{Console, Events};

/// What nothing here should ever take.
const PATIENCE: Duration = Duration::from_secs(60);

#[track_caller]
fn accepted(console: &Console, path: &str, body: &Value) {
    let answer = console.post("operator", path, body);
    assert_eq!(answer.status, 202, "{path}: {answer:?}");
}

#[track_caller]
fn wait_until(what: &str, is: impl Fn() -> bool) -> Duration {
    let began = Instant::now();
    while !is() {
        assert!(began.elapsed() < PATIENCE, "not {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
    began.elapsed()
}

/// Connected, with a first frame.
#[track_caller]
fn connect(console: &Console) -> Events {
    let mut events = console.events("operator");
    accepted(console, "/api/bench/connect", &json!({}));
    let state = events.wait_for("bench", |b| !b["view"].is_null() || !b["error"].is_null());
    assert_eq!(state["error"], Value::Null, "{state}");
    assert_eq!(state["connected"], true);
    events
}

/// Without an error; its state then.
#[track_caller]
fn done(events: &mut Events, is: impl Fn(&Value) -> bool) -> Value {
    let state = events.wait_for("bench", |b| {
        !b["error"].is_null() || b["busy"].is_null() && is(b)
    });
    assert_eq!(state["error"], Value::Null, "{state}");
    state
}

#[test]
fn the_simulated_bench_is_seen_moved_and_lit() {
    let folder = workplace(|text| text);
    let console = Console::start(folder.path(), &["console", "--rig", "rig.toml"]);
    assert_eq!(
        console.get("/api/live.jpg").status,
        204,
        "nothing is live yet"
    );
    let mut events = connect(&console);
    let dark = done(&mut events, |_| true);
    let dark_dn = dark["view"]["mean_dn"].as_f64().unwrap();
    assert!(dark["view"]["black_dn"].as_f64().unwrap() > 0.0, "{dark}");
    assert!(dark["view"]["full_well_dn"].as_f64().unwrap() > 1000.0);

    // Motion.
    accepted(&console, "/api/bench/home", &json!({}));
    done(&mut events, |b| !b["stage"]["position"].is_null());
    let target = json!({"azimuth_deg": 20.0, "elevation_deg": 50.0});
    accepted(&console, "/api/bench/move", &target);
    done(&mut events, |b| {
        let position = &b["stage"]["position"];
        let near = |key: &str, is: f64| (position[key].as_f64().unwrap_or(999.0) - is).abs() < 0.5;
        near("azimuth_deg", 20.0) && near("elevation_deg", 50.0)
    });
    let refused = console.post(
        "operator",
        "/api/bench/move",
        &json!({"azimuth_deg": 0.0, "elevation_deg": -80.0}),
    );
    assert_eq!(refused.status, 202, "the stage decides: {refused:?}");
    let state = events.wait_for("bench", |b| !b["error"].is_null());
    assert_eq!(state["connected"], true, "{state}");

    // The picture shows the lamp.
    accepted(&console, "/api/bench/lamp", &json!({"channel": 0}));
    let lit = done(&mut events, |b| {
        b["stage"]["lamp"] == 0 && b["view"]["mean_dn"].as_f64().unwrap() > 1.2 * dark_dn
    });
    assert!(
        lit["lamp_off_in_s"]
            .as_f64()
            .is_some_and(|left| left <= 30.0),
        "{lit}"
    );
    let plain = console.get("/api/live.jpg?n=1&peaking=0&marks=1");
    assert_eq!(plain.status, 200);
    assert!(
        plain.head.to_lowercase().contains("x-rig-number"),
        "{}",
        plain.head
    );
    let size = |bytes: &[u8]| {
        let picture = image::load_from_memory(bytes).unwrap();
        [picture.width(), picture.height()]
    };
    let frame = ["width", "height"].map(|key| lit["view"][key].as_u64().unwrap() as u32);
    assert_eq!(size(&plain.body), frame);
    assert_eq!(size(&console.get("/api/live.jpg?peaking=1").body), frame);
    assert_eq!(console.get("/api/live.jpg?peaking=x").status, 400);
    let outline = console.get("/api/outline").json();
    assert!(
        !outline["polygons"][0].as_array().unwrap().is_empty(),
        "{outline}"
    );

    // Exposure, as the camera applies it.
    accepted(
        &console,
        "/api/bench/exposure",
        &json!({"exposure_ms": 5.0, "gain": 1.0}),
    );
    done(&mut events, |b| {
        let exposure_s = b["settings"]["exposure_s"].as_f64().unwrap();
        (exposure_s - 0.005).abs() < 1e-4
    });

    // Another page looks on, and may stop.
    let refused = console.post("other", "/api/bench/lamp", &json!({"channel": 1}));
    assert_eq!(refused.status, 409, "{refused:?}");
    assert_eq!(
        console.post("other", "/api/bench/stop", &json!({})).status,
        202
    );
    done(&mut events, |b| b["stage"]["lamp"].is_null());

    // The end.
    accepted(&console, "/api/bench/disconnect", &json!({}));
    done(&mut events, |b| b["connected"] == false);
    assert_eq!(console.get("/api/live.jpg").status, 204);
    let refused = console.post("operator", "/api/bench/home", &json!({}));
    assert_eq!(refused.status, 409);
    assert_eq!(console.get("/api/sessions").json(), json!([]));
}

/// A stage on its port, a camera that is a program, and a rig file that names both.
struct Port {
    simulator: GrblSimulator,
    folder: TempDir,
}

impl Port {
    fn new(clock: Clock) -> Self {
        let bench = Bench::new(BenchConfig::default(), clock);
        let simulator = GrblSimulator::spawn(GrblConfig::default(), bench).unwrap();
        let folder = tempfile::tempdir().unwrap();
        write_rig(folder.path(), &simulator.path().display().to_string());
        Self { simulator, folder }
    }

    fn console(&self) -> Console {
        Console::start(self.folder.path(), &["console", "--rig", "rig.toml"])
    }

    fn is_lit(&self) -> bool {
        self.simulator.bench().lamp_drive() != [0.0; 3]
    }

    /// A console that has lit the lamp.
    fn lit(&self) -> (Console, Events) {
        let console = self.console();
        let mut events = connect(&console);
        accepted(&console, "/api/bench/home", &json!({}));
        done(&mut events, |b| !b["stage"]["position"].is_null());
        accepted(&console, "/api/bench/lamp", &json!({"channel": 0}));
        done(&mut events, |b| b["stage"]["lamp"] == 0);
        assert!(self.is_lit());
        (console, events)
    }
}

fn write_rig(folder: &Path, port: &str) {
    let text = include_str!("../../rig-configs/grbl-arm-v4l2.toml");
    let (before, rest) = text.split_once("[camera]").unwrap();
    let (_, after) = rest.split_once("[stage]").unwrap();
    let camera = "driver = \"command\"\ncommand = \"sh photo.sh {exposure_s} {output}\"\n\
                  resolution_px = [6, 4]\nbit_depth = 12\nshortest_ms = 1.0\nlongest_ms = 1000.0\n";
    let after: String = after
        .lines()
        .map(|line| match line.strip_prefix("port = ") {
            Some(_) => format!("port = {port:?}\nreply_timeout_s = 1.0\n"),
            None => format!("{line}\n"),
        })
        .collect();
    let text = format!("{before}[camera]\n{camera}\n[stage]{after}");
    std::fs::write(folder.join("rig.toml"), text).unwrap();
    let ramp = ImageBuffer::from_fn(6, 4, |x, y| Luma([(600 * x + y + 1) as u16]));
    ramp.save(folder.join("ramp.tif")).unwrap();
    std::fs::write(folder.join("photo.sh"), "cp ramp.tif $2").unwrap();
}

/// The controller lights the lamp otherwise than it was told: it is not left so.
#[test]
fn a_lamp_that_does_not_obey_is_reset() {
    let port = Port::new(Clock::instant());
    let rig = port.folder.path().join("rig.toml");
    let text = std::fs::read_to_string(&rig).unwrap();
    // The firmware limits to S1000, and reports that.
    let beyond = text.replacen("on = \"M3 S1000\"", "on = \"M3 S5000\"", 1);
    assert_ne!(text, beyond);
    std::fs::write(&rig, beyond).unwrap();
    let console = port.console();
    let mut events = connect(&console);
    accepted(&console, "/api/bench/home", &json!({}));
    done(&mut events, |b| !b["stage"]["position"].is_null());
    accepted(&console, "/api/bench/lamp", &json!({"channel": 0}));
    let state = events.wait_for("bench", |b| b["busy"].is_null() && !b["error"].is_null());
    assert!(!port.is_lit(), "{state}");
    let fault = state["error"].to_string();
    assert!(
        fault.contains("the stage was stopped and reports its lamp off now"),
        "{fault}"
    );
    let hint = "look at the lamp: if it is still lit, turn it off at its supply";
    assert!(fault.contains(hint), "{fault}");
    assert_eq!(
        (
            &state["connected"],
            &state["stage"]["lamp"],
            &state["stage"]["lamp_word"]
        ),
        (&json!(true), &Value::Null, &json!("reported"))
    );
}

/// However the console ends, and without a word of the page that lit it.
#[test]
fn no_lamp_stays_lit() {
    std::thread::scope(|scope| {
        for (signal, code, longest_s) in [
            (Signal::KILL, None, 8),
            (Signal::INT, Some(130), 8),
            (Signal::TERM, Some(143), 8),
            (Signal::HUP, Some(129), 8),
        ] {
            scope.spawn(move || {
                let port = Port::new(Clock::instant());
                let (mut console, _events) = port.lit();
                console.send(signal);
                let took = wait_until("dark", || !port.is_lit());
                assert!(
                    took < Duration::from_secs(longest_s),
                    "{signal:?}: {took:?}"
                );
                assert_eq!(console.wait(), code, "{signal:?}: {}", console.stderr());
            });
        }
        // The page says nothing more: 30 s.
        scope.spawn(|| {
            let port = Port::new(Clock::instant());
            let (console, mut events) = port.lit();
            let took = wait_until("dark", || !port.is_lit());
            assert!((25..40).contains(&took.as_secs()), "{took:?}");
            let state = events.wait_for("bench", |b| b["stage"]["lamp"].is_null());
            assert_eq!(state["connected"], true, "{state}");
            drop(console);
        });
        // It is heard of for longer than that, and then disconnects.
        scope.spawn(|| {
            let port = Port::new(Clock::instant());
            let (console, _events) = port.lit();
            for _ in 0..9 {
                std::thread::sleep(Duration::from_secs(4));
                let answer = console.post("operator", "/api/control/ping", &json!({}));
                assert_eq!(answer.json()["controls"], true);
                assert!(port.is_lit());
            }
            accepted(&console, "/api/bench/disconnect", &json!({}));
            wait_until("dark", || !port.is_lit());
        });
    });
}

/// A console that is continued while it still makes the bench safe is not suspended.
#[test]
fn a_console_that_is_continued_answers() {
    let port = Port::new(Clock::instant());
    let (console, _events) = port.lit();
    for pause_ms in [0, 20, 500] {
        console.send(Signal::TSTP);
        wait_until("dark", || !port.is_lit());
        std::thread::sleep(Duration::from_millis(pause_ms));
        console.send(Signal::CONT);
        let answer = console.post("x", "/api/bench/stop", &json!({}));
        assert!(
            [202, 409].contains(&answer.status),
            "{pause_ms}: {answer:?}"
        );
    }
}

#[test]
fn a_stop_ends_a_motion_at_once() {
    let port = Port::new(Clock::real_time());
    let console = port.console();
    let mut events = connect(&console);
    accepted(&console, "/api/bench/home", &json!({}));
    events.wait_for("bench", |b| b["busy"] == "homing");
    // One motion at a time; the picture goes on.
    let refused = console.post("operator", "/api/bench/home", &json!({}));
    assert_eq!(refused.status, 409, "{refused:?}");
    let number = |b: &Value| b["view"]["number"].as_u64().unwrap_or(0);
    let before = number(&events.wait_for("bench", |b| number(b) > 0));
    events.wait_for("bench", |b| number(b) > before && b["busy"] == "homing");
    let began = Instant::now();
    assert_eq!(
        console.post("other", "/api/bench/stop", &json!({})).status,
        202
    );
    let state = events.wait_for("bench", |b| b["busy"].is_null());
    assert!(
        began.elapsed() < Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
    assert_eq!(
        (&state["connected"], &state["error"]),
        (&true.into(), &Value::Null)
    );
    assert_eq!(state["stage"]["position"], Value::Null);
}

/// The page's bench has homed the stage; the program of the calibration lights the lamp.
#[test]
fn a_stop_ends_a_calibration_under_the_lamp() {
    let port = Port::new(Clock::real_time());
    let console = port.console();
    let mut events = connect(&console);
    accepted(&console, "/api/bench/home", &json!({}));
    done(&mut events, |b| !b["stage"]["position"].is_null());
    let form = json!({"kind": "lamp", "values": {"minutes": "2"}});
    accepted(&console, "/api/guides/measure", &form);
    wait_until("lit", || {
        let job = console.events("x").wait_for("job", |_| true);
        assert_eq!(job["state"], "running", "{job}");
        port.is_lit()
    });
    let answer = console.post("other", "/api/bench/stop", &json!({}));
    assert_eq!(answer.json(), json!({"stopping": "a calibration"}));
    let took = wait_until("dark", || !port.is_lit());
    assert!(took < Duration::from_secs(2), "{took:?}");
    events.wait_for("job", |job| job["state"] == "interrupted");
    let mut events = console.events("x");
    events.wait_for("bench", |bench| bench["lent_to"].is_null());
    assert!(!port.is_lit());
    // The bench is the page's again.
    connect(&console);
}

/// What another program holds, a STOP does not reach, and says so.
#[test]
fn a_stop_says_that_it_reached_nothing() {
    let port = Port::new(Clock::instant());
    let (holder, mut events) = port.lit();
    let other = port.console();
    let stop = |console: &Console| {
        let answer = console.post("x", "/api/bench/stop", &json!({}));
        (answer.status, answer.json())
    };
    accepted(&other, "/api/bench/connect", &json!({}));
    let refused = other
        .events("operator")
        .wait_for("bench", |b| !b["error"].is_null());
    assert!(refused["busy"].is_null(), "{refused}");
    // The refusal is shown a moment before the attempt counts as over.
    let tries = std::iter::repeat_with(|| {
        std::thread::sleep(Duration::from_millis(20));
        stop(&other)
    });
    let refused = tries.take(100).find(|(status, _)| *status != 202);
    let (status, answer) = refused.expect("an attempt to connect that ends");
    assert_eq!(status, 409, "{answer}");
    let fact = "the bench is not connected to this console, which did not check its stage and lamp";
    assert_eq!(answer["error"], fact);
    let hint = answer["hint"].to_string();
    assert!(
        hint.contains("end the program that has the stage"),
        "{hint}"
    );
    let no_job = other.post("x", "/api/jobs/stop", &json!({}));
    assert_eq!(
        (no_job.status, no_job.json()),
        (202, json!({"stopping": null}))
    );
    assert!(port.is_lit());
    assert_eq!(stop(&holder), (202, json!({"stopping": "the stage"})));
    wait_until("dark", || !port.is_lit());
    done(&mut events, |b| b["stage"]["lamp"].is_null());
}

/// Whatever a stage answers, its console is gone within 5 s: its time-outs do not follow each
/// other.
#[test]
fn a_stage_without_answers_is_not_waited_for() {
    std::thread::scope(|scope| {
        for (fault, is_lit, signal) in [
            (Fault::Garbled, true, Signal::TERM),
            (Fault::NoReply, true, Signal::INT),
            (Fault::Garbled, false, Signal::HUP),
            (Fault::Delayed { seconds: 1.5 }, true, Signal::TERM),
        ] {
            scope.spawn(move || {
                let port = Port::new(Clock::real_time());
                let (mut console, _events) = port.lit();
                if !is_lit {
                    accepted(&console, "/api/bench/lamp", &json!({"channel": null}));
                    wait_until("dark", || !port.is_lit());
                }
                let case = format!("{fault:?} {is_lit} {signal:?}");
                port.simulator.faults().inject(Trigger::Always, fault);
                let asked = Instant::now();
                console.send(signal);
                wait_until("dark", || !port.is_lit());
                assert!(asked.elapsed() < Duration::from_secs(4), "{case}");
                assert!(console.wait().is_some_and(|code| code > 128), "{case}");
                let took = asked.elapsed();
                assert!(took < Duration::from_secs(5), "{case}: {took:?}");
            });
        }
    });
}

#[test]
fn a_stage_that_is_unplugged_is_reported_and_can_be_connected_again() {
    let port = Port::new(Clock::instant());
    let console = port.console();
    let mut events = connect(&console);
    port.simulator.unplug();
    let state = events.wait_for("bench", |b| b["connected"] == false);
    assert!(
        !state["error"]["error"].as_str().unwrap().is_empty(),
        "{state}"
    );
    assert!(!state["error"]["hint"].is_null(), "{state}");
    // Another one on another port cannot be reached by this rig file; the attempt says so.
    accepted(&console, "/api/bench/connect", &json!({}));
    let state = events.wait_for("bench", |b| b["busy"].is_null());
    assert!(
        !state["error"]["error"].as_str().unwrap().is_empty(),
        "{state}"
    );
    assert_eq!(console.get("/api/sessions").status, 200);
}
