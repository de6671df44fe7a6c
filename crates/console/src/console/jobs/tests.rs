use std::os::unix::process::ExitStatusExt;

use super::*;
use serde_json::json;

/// Jobs whose program is this shell script.
fn jobs(script: &str) -> (tempfile::TempDir, Jobs, Hub) {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("program");
    std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    let program = Program {
        path,
        rig: "simulated".to_owned(),
        folder: folder.path().to_owned(),
    };
    let hub = Hub::default();
    let jobs = Jobs::new(program, hub.clone());
    (folder, jobs, hub)
}

fn topic(hub: &Hub, name: &str) -> Value {
    let all = hub.newer_than(0);
    let found = all.iter().find(|(topic, _)| *topic == name).unwrap();
    (*found.1.state).clone()
}

fn work(kind: Kind, arguments: &[&str]) -> Work {
    Work::new(kind, arguments.iter().map(OsString::from).collect())
}

#[track_caller]
fn wait_until(what: impl Fn() -> bool) {
    let began = Instant::now();
    while !what() {
        assert!(began.elapsed() < Duration::from_secs(30), "it takes long");
        std::thread::sleep(Duration::from_millis(10));
    }
}

const BEGUN: &str = r#"echo '{"event":"begun","at":"2026-11-27T08:00:00Z","session":"sessions/s","sample":"a","lights":[],"channels":[0],"pid":1}'"#;

#[test]
fn a_jobs_events_messages_and_end_are_published() {
    let (_folder, jobs, hub) = jobs(&format!(
        "{BEGUN}
         echo '{{\"event\":\"of another version\"}}'
         printf '\\033[1mwarning:\\033[0m warm' >&2
         echo '{{\"event\":\"ended\",\"at\":\"2026-11-27T08:00:09Z\",\"outcome\":\"complete\",\"session\":\"sessions/s\",\"elapsed_s\":9.0,\"error\":null}}'"
    ));
    assert_eq!(topic(&hub, "capture"), Value::Null);
    // The devices are the capture's as long as the other end of the channel is there.
    let (loan, lent) = std::sync::mpsc::channel::<()>();
    let loan = Mutex::new(Some(loan));
    jobs.lend_devices(Arc::new(move |_| Ok(Box::new(loan.lock().unwrap().take()))));
    let line = jobs.start(work(Kind::Capture, &["capture", "--sample=a b"]));
    assert_eq!(line.unwrap(), "rig capture '--sample=a b'");
    assert!(jobs.wait().unwrap().success());
    assert_eq!(
        lent.try_recv(),
        Err(std::sync::mpsc::TryRecvError::Disconnected)
    );
    let capture = topic(&hub, "capture");
    assert_eq!(capture["state"], "complete");
    assert!(capture["disk_free_bytes"].as_u64().unwrap() > 0);
    let job = topic(&hub, "job");
    assert_eq!(job["log"], json!(["warning: warm"]));
    assert_eq!((&job["state"], &job["exit"]), (&json!("done"), &json!(0)));
    assert_eq!(job["result"], "sessions/s");
    assert_eq!(
        topic(&hub, "sessions")["changed"].as_u64().map(|n| n > 0),
        Some(true)
    );
    // A fit has no capture; its result is what it prints.
    let (_folder, jobs, hub) = self::jobs("echo sessions/s/fits/0; echo 'error: no' >&2; exit 1");
    jobs.start(work(Kind::Fit, &["fit"])).unwrap();
    jobs.wait();
    assert_eq!(topic(&hub, "capture"), Value::Null);
    let job = topic(&hub, "job");
    assert_eq!((&job["state"], &job["exit"]), (&json!("failed"), &json!(1)));
    assert_eq!(job["result"], "sessions/s/fits/0");
}

#[test]
fn there_is_one_job_at_a_time_and_none_at_the_end() {
    let (_folder, jobs, _) = jobs("exec sleep 60");
    jobs.start(work(Kind::Fit, &["fit"])).unwrap();
    let refused = jobs.start(work(Kind::Capture, &["capture"])).unwrap_err();
    assert_eq!(refused.to_string(), "a fit is running");
    assert!(!jobs.is_capturing());
    // As when a page chooses another bench.
    assert!(!jobs.close_if_idle());
    jobs.stop();
    assert!(jobs.wait().unwrap().signal().is_some());
    assert!(jobs.close_if_idle());
    let refused = jobs.start(work(Kind::Fit, &["fit"])).unwrap_err();
    assert!(matches!(refused, JobError::Ending), "{refused}");
    let (_folder, jobs, _) = self::jobs("");
    std::fs::remove_file(&jobs.program().path).unwrap();
    let refused = jobs.start(work(Kind::Fit, &["fit"])).unwrap_err();
    assert!(refused.to_string().starts_with("rig fit: "), "{refused}");
    assert_eq!(jobs.running(), None);
    jobs.lend_devices(Arc::new(|_| {
        Err(JobError::Devices {
            fact: "the stage is moving".to_owned(),
            hint: None,
        })
    }));
    let refused = jobs.start(work(Kind::Capture, &["capture"])).unwrap_err();
    assert_eq!(refused.to_string(), "the stage is moving");
    assert_eq!(jobs.running(), None);
}

/// The page answers what a job asks; one that is to end is asked nothing more.
#[test]
fn a_question_is_answered_or_given_up() {
    let script = r#"trap 'exit 130' INT
        echo '{"event":"asked","at":"t","number":3,"do":"cover"}'
        read answer; echo "$answer" >&2"#;
    for answered in [true, false] {
        let (_folder, jobs, hub) = jobs(script);
        jobs.start(work(Kind::Calibration, &["calibrate"])).unwrap();
        wait_until(|| topic(&hub, "job")["asked"]["do"] == "cover");
        let log = match answered {
            true => {
                assert!(!jobs.answer(2, true) && jobs.answer(3, true));
                json!([json!({"number": 3, "done": true}).to_string()])
            }
            false => {
                jobs.finish();
                json!([])
            }
        };
        jobs.wait();
        let job = topic(&hub, "job");
        assert_eq!((&job["log"], &job["asked"]), (&log, &Value::Null));
    }
}

/// What a capture does on signals: it suspends itself, and counts requests to stop.
const OBEDIENT: &str = r#"
    stops=0
    trap 'echo "{\"event\":\"paused\",\"at\":\"t\"}"; kill -STOP $$; echo "{\"event\":\"continued\",\"at\":\"t\"}"' TSTP
    trap 'stops=$((stops + 1))' INT TERM
    echo ready >&2
    while [ $stops -lt $1 ]; do sleep 0.02; done
    echo "stops $stops" >&2
    exit 130"#;

#[test]
fn a_capture_is_paused_continued_and_stopped_even_while_it_is_paused() {
    let state = |hub: &Hub| topic(hub, "job")["state"].as_str().unwrap_or("").to_owned();
    let begin = |stops: &str| {
        let (folder, jobs, hub) = jobs(OBEDIENT);
        jobs.start(work(Kind::Capture, &[stops])).unwrap();
        wait_until(|| topic(&hub, "job")["log"] == json!(["ready"]));
        jobs.pause();
        wait_until(|| state(&hub) == "paused");
        assert_eq!(topic(&hub, "capture")["state"], "paused");
        (folder, jobs, hub)
    };
    let (_folder, jobs, hub) = begin("1");
    jobs.resume();
    wait_until(|| state(&hub) == "running");
    // A pause that follows at once holds.
    jobs.pause();
    wait_until(|| state(&hub) == "paused");
    std::thread::sleep(Duration::from_millis(1200));
    assert_eq!(state(&hub), "paused");
    jobs.finish();
    // Unless the program has ended already.
    let after = state(&hub);
    assert!(["ending", "interrupted"].contains(&&*after), "{after}");
    assert_eq!(jobs.wait().unwrap().code(), Some(130));
    assert_eq!(topic(&hub, "capture")["state"], "interrupted");
    let (_folder, jobs, hub) = begin("2");
    jobs.stop();
    assert_eq!(jobs.wait().unwrap().code(), Some(130));
    assert_eq!(topic(&hub, "job")["log"][1], "stops 2");
    assert_eq!(state(&hub), "interrupted");
}

/// Nothing that a job leaves behind, and nothing that it prints, holds up its end.
#[test]
fn a_process_that_inherited_the_pipes_and_a_flood_do_not_hold_up_the_end() {
    let (_folder, jobs, hub) = jobs(
        "sleep 60 & yes '{\"event\":\"homing\",\"at\":\"t\"}' | head -n 20000
         head -c 3000000 /dev/zero | tr '\\0' x
         echo; echo last; echo $! >&2; exit 0",
    );
    let began = Instant::now();
    jobs.start(work(Kind::Capture, &["capture"])).unwrap();
    assert!(jobs.wait().unwrap().success());
    assert!(began.elapsed() < Duration::from_secs(50));
    let job = topic(&hub, "job");
    assert_eq!(job["result"], "last");
    assert_eq!(
        topic(&hub, "capture")["state"],
        "failed",
        "it reported no end"
    );
    let left = job["log"][0].as_str().unwrap();
    let _ = Command::new("kill").arg(left).status();
}

#[test]
fn a_session_is_a_folder_of_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("a.b-c_1")).unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    std::os::unix::fs::symlink("/etc", folder.path().join("link")).unwrap();
    assert!(is_session(folder.path(), "a.b-c_1"));
    for bad in [
        "", ".", "..", "../x", "/etc", "link", "file", "-a", "a.b-c_1/", "a\0", "%2e%2e",
    ] {
        assert!(!is_session(folder.path(), bad), "{bad}");
    }
}

#[test]
fn figures_are_kept_for_the_frame_that_they_are_of() {
    let stored = r#"echo '{"event":"stored","at":"t","light":0,"exposure":0,"repeat":0,"kind":"light","pilot":false,"exposure_s":0.1,"lamp":0,"file":"raw/a.png","retakes":0}'"#;
    let (_folder, jobs, hub) = jobs(&format!("{BEGUN}\n{stored}"));
    let (sender, frames) = std::sync::mpsc::channel();
    jobs.watch_frames(Arc::new(move |session, file| {
        sender.send((session.to_owned(), file.to_owned())).unwrap();
    }));
    jobs.start(work(Kind::Capture, &["capture"])).unwrap();
    jobs.wait();
    assert_eq!(
        frames.try_recv().unwrap(),
        (PathBuf::from("sessions/s"), "raw/a.png".to_owned())
    );
    let (session, frame) = jobs.last_frame().unwrap();
    assert_eq!(
        (session, frame.file.as_str()),
        (PathBuf::from("sessions/s"), "raw/a.png")
    );
    jobs.set_frame_figures(7, json!(7));
    assert_eq!(topic(&hub, "capture")["frame"]["figures"], Value::Null);
    jobs.set_frame_figures(1, json!(1));
    assert_eq!(topic(&hub, "capture")["frame"]["figures"], 1);
}
