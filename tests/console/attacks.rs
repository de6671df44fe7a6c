//! What a hostile or broken client sends to the console, as bytes on its socket: each gets
//! its refusal, and the next request of the page is answered.

use crate::command_support;

use std::collections::BTreeSet;
use std::fs;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket};
use std::path::Path;
use std::time::{Duration, Instant};

use crate::attack_table::{
    ACTION, ACTIONS, Row, bodies, forms, paths_and_methods, strangers, with,
};
use crate::support::{Answer, Console};
use rustix::process::Signal;
use serde_json::json;
use tempfile::TempDir;

/// A folder with sessions, one of them a link to elsewhere, and a secret outside.
fn workplace() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let sessions = folder.path().join("sessions");
    fs::create_dir_all(sessions.join("real")).unwrap();
    fs::write(folder.path().join("secret.txt"), "the secret").unwrap();
    fs::write(folder.path().join("report.html"), "the secret").unwrap();
    fs::create_dir(folder.path().join("elsewhere")).unwrap();
    fs::write(folder.path().join("elsewhere/report.html"), "the secret").unwrap();
    std::os::unix::fs::symlink("../elsewhere", sessions.join("link")).unwrap();
    std::os::unix::fs::symlink("../../secret.txt", sessions.join("real/report.html")).unwrap();
    folder
}

fn start(folder: &Path) -> Console {
    Console::start(folder, &["console", "--rig", "simulated", "-vv"])
}

#[track_caller]
fn assert_page_is_there(console: &Console, after: &str) {
    let answer = console.get("/");
    assert_eq!(answer.status, 200, "after {after}: {answer:?}");
    assert!(answer.text().contains("<!doctype html>"), "after {after}");
}

#[test]
fn every_attack_is_refused_and_the_page_is_there_afterwards() {
    let folder = workplace();
    let console = start(folder.path());
    let tables = [strangers(&console), paths_and_methods(), forms(), bodies()];
    let rows: Vec<Row> = tables.into_iter().flatten().collect();
    let names: BTreeSet<_> = rows.iter().map(|row| &row.0).collect();
    assert!(
        names.len() == rows.len() && rows.len() >= 90,
        "{}",
        rows.len()
    );
    for (name, request, expected) in &rows {
        // Requests that are no text have nothing to fill in but what is.
        let mut filled = Vec::new();
        for part in request.split_inclusive(|&b| b == b'}') {
            match std::str::from_utf8(part) {
                Ok(text) => filled.extend_from_slice(console.filled(text).as_bytes()),
                Err(_) => filled.extend_from_slice(part),
            }
        }
        let answer = console.exchange(&filled);
        assert!(expected.contains(&answer.status), "{name}: {answer:?}");
        let text = answer.text();
        assert!(
            !text.contains("the secret") && !text.contains("root:"),
            "{name}: {text}"
        );
        assert!(!answer.head.to_lowercase().contains("x-injected"), "{name}");
        // What the page asks for in vain tells why.
        if request.windows(9).any(|part| part == b"/{T}/api/")
            && [409, 422].contains(&answer.status)
        {
            let fact = answer.json()["error"].as_str().map(str::len);
            assert!(fact.is_some_and(|length| length > 10), "{name}: {text}");
        }
        // One answer, whatever came after the request.
        let answers = text.matches("HTTP/1.1 ").count();
        assert!(
            answers == 0 || *name == "Expect and no body",
            "{name}: {text}"
        );
        if answer.status == 404 && !request.windows(5).any(|part| part == b"/{T}/") {
            assert_eq!(text, "", "{name}: whoever has no token learns nothing");
        }
        assert_page_is_there(&console, name);
    }
    assert!(!folder.path().join("pwned").exists());
    let left = fs::read_dir(folder.path().join("sessions"))
        .unwrap()
        .count();
    assert_eq!(left, 2, "nothing was captured");

    // Nothing secret is in the log, however much is logged.
    let log = console.stderr();
    assert!(log.contains("Ctrl-C ends the console"), "{log}");
    assert!(!log.contains(&console.token[..20]), "{log}");
    assert!(!log.contains("internal error"), "{log}");
}

/// With a sentence that says so.
#[test]
fn every_action_refuses_what_is_no_form() {
    let folder = workplace();
    let console = start(folder.path());
    let deep = "[".repeat(20_000);
    for action in ACTIONS {
        for body in ["", "x", "{", "{}{}", "\u{0}", "{\"a\": 1e999}", &deep] {
            let (_, request, _) = with(action, &format!("/api/{action}"), ACTION, body, &[400]);
            let request = console.filled(std::str::from_utf8(&request).unwrap());
            let answer = console.exchange(request.as_bytes());
            assert_eq!(answer.status, 400, "{action} {body:.20}: {answer:?}");
            let fact = answer.json()["error"].as_str().map(str::len);
            assert!(
                fact.is_some_and(|length| length > 10),
                "{action}: {answer:?}"
            );
        }
        assert_page_is_there(&console, action);
    }
    assert!(!console.stderr().contains("internal error"));
}

#[test]
fn the_page_carries_the_headers_that_keep_others_out() {
    let folder = workplace();
    let console = start(folder.path());
    for path in ["/", "/api/nothing", "/api/doctor"] {
        let head = console.get(path).head.to_lowercase();
        for header in [
            "content-security-policy: default-src 'none'; script-src 'self'; style-src 'self'; \
             img-src 'self' blob: data:; connect-src 'self'; frame-src 'self'; base-uri 'none'; \
             form-action 'none'; frame-ancestors 'none'",
            "cross-origin-resource-policy: same-origin",
            "cross-origin-opener-policy: same-origin",
            "referrer-policy: no-referrer",
            "x-content-type-options: nosniff",
            "cache-control: no-store",
        ] {
            assert!(head.contains(header), "{path}: {header}: {head}");
        }
        assert!(!head.contains("access-control-allow"), "{path}: {head}");
    }
    let stranger = console.exchange(b"GET /x HTTP/1.1\r\nHost: x\r\n\r\n");
    assert!(stranger.head.contains("cache-control: no-store") && stranger.body.is_empty());
}

#[test]
fn slow_clients_are_cut_off_and_hold_nobody_up() {
    let folder = workplace();
    let console = start(folder.path());
    // One byte of the head at a time.
    let began = Instant::now();
    let mut slow = console.connect();
    let head = console.filled("GET /{T}/ HTTP/1.1\r\nHost: {H}\r\nX: ");
    slow.write_all(head.as_bytes()).unwrap();
    let mut slowest = Duration::ZERO;
    loop {
        let asked = Instant::now();
        assert_page_is_there(&console, "a slow head");
        slowest = slowest.max(asked.elapsed());
        if slow.write_all(b"x").is_err() || began.elapsed() > Duration::from_secs(8) {
            break;
        }
        std::thread::sleep(Duration::from_millis(500));
    }
    let mut rest = Vec::new();
    let _ = slow.read_to_end(&mut rest);
    let text = String::from_utf8_lossy(&rest);
    assert!(!text.contains(" 200 "), "{text}");
    assert!(began.elapsed() < Duration::from_secs(20), "it is cut off");
    assert!(slowest < Duration::from_secs(4), "{slowest:?}");
}

#[test]
fn eight_hundred_open_connections_keep_nobody_out() {
    let folder = workplace();
    let console = start(folder.path());
    let partial = console.filled("GET /{T}/ HTTP/1.1\r\nHost: {H}\r\n");
    for first in [&b""[..], partial.as_bytes()] {
        let held: Vec<TcpStream> = (0..800)
            .map(|_| {
                let mut stream = console.connect();
                let _ = stream.write_all(first);
                stream
            })
            .collect();
        let began = Instant::now();
        assert_page_is_there(&console, "800 connections, while they are open");
        assert!(
            began.elapsed() < Duration::from_secs(10),
            "{:?}",
            began.elapsed()
        );
        let open = fs::read_dir(format!("/proc/{}/fd", console.child.id())).unwrap();
        let open = open.count();
        assert!(open < 600, "{open} files are open");
        drop(held);
        assert_page_is_there(&console, "800 connections");
    }
}

/// Every page that may look on, and as many dry runs as may wait and more: each STOP is
/// answered, also between connections that say nothing.
#[test]
fn stop_is_answered_whatever_else_is_open() {
    let folder = workplace();
    let console = start(folder.path());
    let streams: Vec<_> = (0..24).map(|n| console.events(&format!("v{n}"))).collect();
    let body = r#"{"lights": "best:40"}"#;
    let head = ACTION.replace("{H}", &format!("127.0.0.1:{}", console.port));
    let plan = format!(
        "POST /{{T}}/api/plan HTTP/1.1\r\n{head}Content-Length: {}\r\n\r\n{body}",
        body.len()
    );
    let plans: Vec<_> = (0..150)
        .map(|_| {
            let mut stream = console.connect();
            stream.write_all(console.filled(&plan).as_bytes()).unwrap();
            stream
        })
        .collect();
    let silent: Vec<_> = (0..300).map(|_| console.connect()).collect();
    let mut took: Vec<_> = (0..120)
        .map(|n| {
            // No bench is connected, and it is said.
            let (path, status) = [
                ("/api/bench/stop", 409),
                ("/api/capture/stop", 202),
                ("/api/jobs/stop", 202),
            ][n % 3];
            let began = Instant::now();
            assert_eq!(console.post("x", path, &json!({})).status, status, "{n}");
            began.elapsed()
        })
        .collect();
    took.sort();
    assert!(took[60] < Duration::from_millis(500), "{:?}", took[60]);
    // What is too much is refused with its reason, and not dropped.
    let mut statuses = BTreeSet::new();
    for mut stream in plans.into_iter().skip(130) {
        let _ = stream.set_read_timeout(Some(Duration::from_secs(2)));
        statuses.insert(Answer::read(&mut stream).status);
    }
    assert_eq!(statuses, BTreeSet::from([503]));
    drop((streams, silent));
}

#[test]
fn streams_are_bounded_and_one_that_stalls_holds_nobody_up() {
    let folder = workplace();
    let console = start(folder.path());
    // Nobody reads any of them.
    let mut streams: Vec<_> = (0..30).map(|n| console.events(&format!("v{n}"))).collect();
    let statuses: Vec<_> = streams.iter_mut().map(|stream| stream.status()).collect();
    let served = statuses.iter().filter(|s| s.contains(" 200 ")).count();
    let refused = statuses.iter().filter(|s| s.contains(" 503 ")).count();
    assert_eq!((served, refused), (24, 6), "{statuses:?}");
    for n in 0..100 {
        let answer = console.post("a", "/api/control/take", &json!({}));
        assert_eq!(answer.status, 200, "{n}");
    }
    assert_page_is_there(&console, "streams that nobody reads");
    // A viewer that comes again replaces its own stream; one that leaves makes room.
    let mut again = console.events("v0");
    assert!(again.status().contains(" 200 "));
    again.wait_for("console", |console| console["viewers"] == 24);
    streams.truncate(20);
    again.wait_for("console", |console| console["viewers"].as_u64() < Some(24));
    assert!(console.events("w").status().contains(" 200 "));
}

/// A program in a rig file is run by every later command, so that the token would be worth a
/// shell.
#[test]
fn no_page_names_a_program() {
    let folder = workplace();
    let console = start(folder.path());
    for camera in ["command", " Command", "command touch pwned"] {
        let answers = json!({"camera": camera, "camera_address": "touch pwned", "stage": "manual"});
        let refused = console.post("a", "/api/setup", &json!({"answers": answers}));
        assert_eq!(refused.status, 422, "{camera}");
        let error = refused.json()["error"].to_string();
        assert!(error.contains("may not name a program"), "{error}");
    }
    assert!(!folder.path().join("rig.toml").exists());
    let questions = console.get("/api/setup").json();
    let cameras = questions.as_array().unwrap().iter();
    let cameras = cameras.filter(|question| question["key"] == "camera");
    let choices: Vec<_> = cameras
        .map(|question| question["choices"].clone())
        .collect();
    assert!(choices[0].as_array().is_some_and(|all| !all.is_empty()));
    assert!(
        !choices[0].to_string().contains("\"command\""),
        "{choices:?}"
    );
}

/// A bench of the folder is edited, within bounds, and chosen without a new console.
#[test]
fn a_page_edits_and_chooses_benches_of_its_folder_alone() {
    let folder = workplace();
    let file = folder.path().join("arm.toml");
    let text = include_str!("../../rig-configs/simulated.toml");
    let text = text.replacen("name = \"simulated\"", "name = \"arm\"", 1);
    fs::write(&file, &text).unwrap();
    fs::write(folder.path().join("scene.toml"), "[camera]\n").unwrap();
    let console = start(folder.path());
    let rigs = console.get("/api/rigs").json();
    let names: Vec<_> = (rigs["rigs"].as_array().unwrap().iter())
        .map(|rig| rig["rig"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(names, ["simulated", "rehearsal-flat", "arm.toml"]);

    // What may not be saved, and what may.
    let opened = console.get("/api/rigs/text?rig=arm.toml").json();
    let save = |text: &str, sum: &serde_json::Value| {
        let form = json!({"rig": "arm.toml", "text": text, "sum": sum});
        console.post("a", "/api/rigs/save", &form)
    };
    let elsewhere = "[calibration]\nfolder = \"../..\"\n";
    for (bad, said) in [
        (
            text.replacen("bit_depth = 12", "bit_depth = 99", 1),
            "bit_depth",
        ),
        (
            text.replacen("[calibration]\n", elsewhere, 1),
            "calibration.folder",
        ),
    ] {
        let refused = save(&bad, &opened["sum"]);
        assert_eq!(refused.status, 422, "{refused:?}");
        assert!(refused.text().contains(said), "{refused:?}");
    }
    assert_eq!(save(&text, &json!("old")).status, 409);
    assert_eq!(fs::read_to_string(&file).unwrap(), text);
    let edited = text.replacen("bit_depth = 12", "bit_depth = 10", 1);
    assert_eq!(save(&edited, &opened["sum"]).status, 200);
    assert_eq!(fs::read_to_string(&file).unwrap(), edited);
    let before = folder.path().join("arm.toml.before");
    assert_eq!(fs::read_to_string(before).unwrap(), text);

    // The console goes on at its address with the other bench.
    let named =
        |name: &'static str| move |console: &serde_json::Value| console["rig"]["name"] == name;
    console.events("v").wait_for("console", named("simulated"));
    let chosen = console.post("a", "/api/rigs/use", &json!({"rig": "arm.toml"}));
    assert_eq!(chosen.status, 202, "{chosen:?}");
    let began = Instant::now();
    while console.get("/api/rigs").json()["rigs"][2]["in_use"] != true {
        assert!(began.elapsed() < Duration::from_secs(30));
        std::thread::sleep(Duration::from_millis(50));
    }
    console.events("v").wait_for("console", named("arm"));
}

/// A rig file of the page's names no file elsewhere on the machine, and replaces no other one.
#[test]
fn a_page_sets_up_a_bench_below_its_folder_alone() {
    let folder = workplace();
    let at = |name: &str| folder.path().join(name);
    let console = start(folder.path());
    let set_up = |answers: serde_json::Value| {
        let answer = console.post("a", "/api/setup", &json!({"answers": answers}));
        (answer.status, answer.json())
    };
    std::fs::write(at("own.ply"), "").unwrap();
    std::fs::create_dir(at("frames")).unwrap();
    std::os::unix::fs::symlink("own.ply", at("link.ply")).unwrap();
    std::os::unix::fs::symlink("/tmp", at("linked")).unwrap();
    let mesh = |file: &str| json!({"sample_shape": "mesh", "sample_mesh": file});
    let frames = |place: &str| json!({"camera": "folder", "camera_address": place});
    for bad in [
        "/etc/passwd",
        "../own.ply",
        "link.ply",
        "linked/x.ply",
        "none.ply",
        "",
    ] {
        let (status, answer) = set_up(mesh(bad));
        assert_eq!(status, 422, "{bad}: {answer}");
        let error = answer["error"].to_string();
        assert!(
            error.contains("is not below the console's folder"),
            "{error}"
        );
    }
    for bad in ["/tmp", "..", "linked"] {
        let (status, answer) = set_up(frames(bad));
        let error = answer["error"].to_string();
        assert_eq!(status, 422, "{bad}: {answer}");
        assert!(
            error.contains("is not below the console's folder"),
            "{error}"
        );
    }
    for good in [mesh("own.ply"), frames("frames")] {
        let (_, answer) = set_up(good);
        let error = answer["error"].to_string();
        assert!(!error.contains("is not below"), "{error}");
    }
    std::fs::write(at("rig.toml"), "").unwrap();
    // A second bench has a file of its own name, which is no path and no option.
    std::fs::write(at("arm.toml"), "").unwrap();
    for bad in ["", "../arm", "/tmp/arm", "-arm", ".arm", "a\nb", "arm"] {
        let (status, answer) = set_up(json!({"name": bad}));
        assert_eq!(status, 409, "{bad:?}: {answer}");
        assert!(answer["hint"].to_string().contains("name"), "{answer}");
    }
    let (status, answer) = set_up(json!({"name": "second arm"}));
    assert_ne!(status, 409, "{answer}");
    assert!(!at("second-arm.toml").exists() || status == 200);
}

#[test]
fn one_viewer_controls_and_anyone_can_stop() {
    let folder = workplace();
    let console = start(folder.path());
    let start = |viewer| {
        console
            .post(viewer, "/api/capture/pause", &json!({}))
            .status
    };
    // The first action takes control, although there is nothing to pause.
    assert_eq!(start("a"), 409);
    let mut events = console.events("b");
    events.wait_for("control", |control| control["viewer"] == "a");
    let refused = console.post("b", "/api/capture/start", &json!({"lights": "1"}));
    assert_eq!(refused.status, 409);
    assert_eq!(refused.json()["error"], "another page controls the bench");
    assert_eq!(
        console.post("b", "/api/capture/stop", &json!({})).status,
        202
    );
    let ping =
        |viewer| console.post(viewer, "/api/control/ping", &json!({})).json()["controls"].clone();
    assert_eq!((ping("a"), ping("b")), (json!(true), json!(false)));
    console.post("b", "/api/control/take", &json!({}));
    events.wait_for("control", |control| control["viewer"] == "b");
    assert_eq!((ping("a"), ping("b")), (json!(false), json!(true)));
    console.post("b", "/api/control/release", &json!({}));
    events.wait_for("control", |control| control["viewer"].is_null());
}

#[test]
fn without_listen_no_other_address_reaches_it() {
    let folder = workplace();
    let console = start(folder.path());
    let reach = |ip: Ipv4Addr| {
        let address = SocketAddr::from((ip, console.port));
        TcpStream::connect_timeout(&address, Duration::from_secs(5))
    };
    assert!(reach(Ipv4Addr::LOCALHOST).is_ok());
    assert!(reach(Ipv4Addr::new(127, 0, 0, 2)).is_err());
    // This machine's own address, where it has one.
    let socket = UdpSocket::bind("0.0.0.0:0").unwrap();
    if socket.connect("192.0.2.1:9").is_ok()
        && let SocketAddr::V4(own) = socket.local_addr().unwrap()
        && !own.ip().is_loopback()
    {
        assert!(reach(*own.ip()).is_err(), "{own}");
    }
}

#[test]
fn with_listen_others_reach_it_by_address_and_are_warned_of() {
    let folder = workplace();
    let arguments = [
        "console",
        "--rig",
        "simulated",
        "--listen",
        "0.0.0.0",
        "--host-name",
        "bench.lab",
    ];
    let console = Console::start(folder.path(), &arguments);
    assert!(console.stderr().contains("the connection is not encrypted"));
    let host = |host: &str| {
        let request = format!("GET /{{T}}/ HTTP/1.1\r\nHost: {host}\r\n\r\n");
        console.exchange(console.filled(&request).as_bytes()).status
    };
    assert_eq!((host("{H}"), host("bench.lab")), (200, 200));
    assert_eq!((host("evil.example"), host("10.0.0.1:1")), (403, 403));
    // The page behind a TLS proxy, which passes its own name on.
    let proxied = |origin: &str| {
        let head = format!("{}Origin: {origin}\r\n", ACTION.replace("{H}", "bench.lab"));
        let (_, request, _) = with("", "/api/control/ping", &head, "{}", &[]);
        let request = String::from_utf8(request).unwrap();
        console.exchange(console.filled(&request).as_bytes()).status
    };
    assert_eq!(
        (
            proxied("https://bench.lab"),
            proxied("https://evil.example")
        ),
        (200, 403)
    );
}

#[test]
fn without_a_job_a_signal_ends_it_at_once() {
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let folder = workplace();
        let mut console = start(folder.path());
        let _looks_on: Answer = console.get("/");
        let _stream = console.events("a");
        let began = Instant::now();
        console.send(signal);
        assert_eq!(console.wait(), Some(code), "{}", console.stderr());
        assert!(began.elapsed() < Duration::from_secs(10));
        assert!(!console.stderr().contains("error:"), "{}", console.stderr());
    }
}

#[test]
fn a_host_name_is_a_name_alone() {
    let folder = workplace();
    for bad in ["*", "a\nb", "http://x/", "x:80"] {
        let output = command_support::run(folder.path(), &["console", "--host-name", bad]);
        assert!(!output.status.success(), "{bad}");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            said.contains("a name alone, as bench.example.org"),
            "{said}"
        );
    }
}

#[test]
fn an_address_that_is_taken_or_elsewhere_is_refused() {
    let folder = workplace();
    let console = start(folder.path());
    let port = console.port.to_string();
    let hint = "choose another --port, or 0 for a free one";
    for (arguments, fact) in [
        (["--port", port.as_str()], "Address already in use"),
        (["--listen", "203.0.113.7"], "203.0.113.7:0: "),
    ] {
        let all = [&["console", "--rig", "simulated"], &arguments[..]].concat();
        let output = command_support::run(folder.path(), &all);
        command_support::assert_fails(&output, 1, fact, hint);
    }
    let output = command_support::run(
        folder.path(),
        &["console", "--listen", "127.0.0.1:1", "--port", "2"],
    );
    command_support::assert_fails(
        &output,
        1,
        "--listen names port 1 and --port 2",
        "give the port once",
    );
}
