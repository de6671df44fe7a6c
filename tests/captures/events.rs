//! What a capture reports to other programs: by the library on a bench in memory, and as the
//! JSON lines of `rig capture --events` on the simulated rig, whatever their reader does.

use crate::capture_support as bench;

use std::io::{BufRead, BufReader, PipeReader, PipeWriter, Read, Write};
use std::path::Path;
use std::process::{Output, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::command_support::*;
use rig::capture::DriftSpan;
use rig::capture::Outcome;
use rig::capture::{Ending, FrameEvent, Progress, Stamped};
use rig::session::faults::UnsyncedDisk;
use rig::session::{Event, Journal, Session, drift};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};

const TWO_LIGHTS: [&str; 4] = ["capture", "--lights", "2", "--no-fit"];
/// What nothing here should ever take.
const PATIENCE: Duration = Duration::from_secs(120);

fn with_events(arguments: &[&'static str]) -> Vec<&'static str> {
    [arguments, &["--events"]].concat()
}

/// Every line of stdout is an event.
#[track_caller]
fn events(stdout: &[u8]) -> Vec<Progress> {
    let lines = str::from_utf8(stdout).unwrap().lines();
    let read = |line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{line}: {e}"));
    let stamped: Vec<Stamped> = lines.map(read).collect();
    assert!(
        stamped.windows(2).all(|pair| pair[0].at <= pair[1].at),
        "times do not run back"
    );
    stamped.into_iter().map(|stamped| stamped.event).collect()
}

/// What distinguishes a frame.
fn identity(frame: &FrameEvent) -> (u32, u32, u32, String) {
    let kind = format!("{:?}", frame.kind);
    (frame.light, frame.exposure, frame.repeat, kind)
}

/// Every frame that is kept was announced before it was stored; files in the order of the
/// journal from `first` on.
#[track_caller]
fn check_frames(events: &[Progress], root: &Path, first: usize) {
    let mut announced = Vec::new();
    let (mut stored, mut files) = (Vec::new(), Vec::new());
    for event in events {
        match event {
            Progress::Frame {
                frame,
                kept: true,
                done,
            } => {
                assert!((0.0..=1.0).contains(done));
                announced.push(identity(frame));
            }
            Progress::Stored { frame, file, .. } => {
                stored.push(identity(frame));
                files.push(file.clone());
                assert_eq!(
                    stored,
                    announced[..stored.len()],
                    "stored before it was taken"
                );
            }
            _ => {}
        }
    }
    assert_eq!(stored, announced);
    let session = Session::open(root).unwrap();
    let journalled: Vec<_> = session.frames().map(|entry| entry.image.path).collect();
    assert_eq!(files, journalled[first..]);
}

fn end(events: &[Progress]) -> Option<Ending> {
    match events.last() {
        Some(Progress::Ended { outcome, .. }) => Some(*outcome),
        _ => None,
    }
}

fn position(events: &[Progress], wanted: &Progress) -> usize {
    let found = events.iter().position(|event| event == wanted);
    found.unwrap_or_else(|| panic!("no {wanted:?} in {events:?}"))
}

#[test]
fn a_capture_reports_all_that_happens_in_its_order() {
    let folder = workplace(|text| text);
    let output = good(run(folder.path(), &with_events(&TWO_LIGHTS)));
    let root = only_session(folder.path()).unwrap();
    let session = Session::open(&root).unwrap();
    let events = events(&output.stdout);
    // The plan first, the end last.
    let Progress::Begun {
        session: named,
        sample,
        lights,
        channels,
        ..
    } = &events[0]
    else {
        panic!("{:?}", events[0]);
    };
    let plan = &session.record().plan;
    assert_eq!(folder.path().join(named), root);
    assert_eq!(sample, &session.record().sample);
    assert_eq!((lights, channels), (&plan.lights, &plan.channels));
    assert_eq!(end(&events), Some(Ending::Complete));
    check_frames(&events, &root, 0);
    // Every light in its order.
    let at = |wanted| position(&events, wanted);
    let planned = |light| {
        let is_planned = |event: &Progress| matches!(event, Progress::Planned { light: at, steps, .. } if *at == light && !steps.is_empty());
        events.iter().position(is_planned).unwrap()
    };
    let order = [
        at(&Progress::Homing),
        planned(0),
        at(&Progress::LightDone { light: 0 }),
        planned(1),
        at(&Progress::LightDone { light: 1 }),
        at(&Progress::Merging),
    ];
    assert!(order.is_sorted(), "{order:?}");
    // The lamp, as the session has it.
    let reported = events.iter().filter_map(|event| match *event {
        Progress::Drift {
            light,
            channel,
            span,
            relative,
            uncertainty,
        } => Some((light, u32::from(channel.0), span, relative, uncertainty)),
        _ => None,
    });
    let changes = session.lamp_drift().unwrap().changes;
    let recorded = changes.iter().map(|change| {
        let (light, span) = match change.span {
            drift::Span::WithinLight(light) => (light, DriftSpan::Light),
            drift::Span::OverSession => (0, DriftSpan::Session),
        };
        (
            light,
            change.channel,
            span,
            change.change,
            change.std_dev.unwrap(),
        )
    });
    let reported: Vec<_> = reported.collect();
    assert_eq!(reported, recorded.collect::<Vec<_>>());
    assert_eq!(reported.len(), 3 * plan.channels.len());
    assert!(reported.iter().all(|drift| drift.4 > 0.0), "{reported:?}");
}

/// The second run reports what the first one has left.
#[test]
fn an_interrupted_capture_says_so_and_a_resumed_one_goes_on_from_there() {
    let folder = workplace(|text| text);
    let frames = |journal: &Journal| {
        let is_frame = |event: &Event| matches!(event, Event::Frame { .. });
        journal
            .records
            .iter()
            .filter(|r| is_frame(&r.event))
            .count()
    };
    let (child, root) = begin(folder.path(), &with_events(&TWO_LIGHTS), |journal| {
        frames(journal) >= 6
    });
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    let first = events(&output.stdout);
    assert_eq!(end(&first), Some(Ending::Interrupted));
    check_frames(&first, &root, 0);
    let there = Session::open(&root).unwrap().frames().count();

    let root_text = root.to_str().unwrap();
    let resume = ["capture", "--no-fit", "--events", "--resume", root_text];
    let second = events(&good(run(folder.path(), &resume)).stdout);
    assert!(
        matches!(second[0], Progress::Begun { .. }),
        "{:?}",
        second[0]
    );
    assert_eq!(second[1], Progress::Resumed { frames: there });
    assert_eq!(end(&second), Some(Ending::Complete));
    check_frames(&second, &root, there);

    // Nothing is left to do.
    let third = events(&good(run(folder.path(), &resume)).stdout);
    let done = |light| Progress::LightDone { light };
    assert_eq!(third[1..3], [done(0), done(1)]);
    assert_eq!(end(&third), Some(Ending::Complete));
}

/// The news of the pause is there while the process is suspended.
#[test]
fn a_pause_is_reported_before_the_process_is_suspended() {
    let folder = shipped_workplace(|text| text);
    let mut child = rig(folder.path(), &with_events(&TWO_LIGHTS))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut next = || {
        let line = lines.next()?.unwrap();
        Some(serde_json::from_str::<Stamped>(&line).unwrap().event)
    };
    let mut until = |is: &dyn Fn(&Progress) -> bool| {
        let mut before = Vec::new();
        while let Some(event) = next() {
            let found = is(&event);
            before.push(event);
            if found {
                return before;
            }
        }
        panic!("not among {before:?}");
    };
    let is_stored = |event: &Progress| matches!(event, Progress::Stored { .. });
    until(&is_stored);
    let pid = Pid::from_child(&child);
    kill_process(pid, Signal::TSTP).unwrap();
    until(&|event| *event == Progress::Paused);
    wait_until_stopped(&child);
    let root = only_session(folder.path()).unwrap();
    let last = Journal::read(&root).unwrap().records.pop().unwrap();
    assert_eq!(last.event, Event::Paused);
    kill_process(pid, Signal::CONT).unwrap();
    assert_eq!(until(&|_| true), [Progress::Continued]);
    let rest = until(&|event| matches!(event, Progress::Ended { .. }));
    assert!(rest.contains(&Progress::Homing), "{rest:?}");
    assert_eq!(end(&rest), Some(Ending::Complete));
    assert!(child.wait().unwrap().success());
}

/// A pipe that takes nothing more.
fn full_pipe() -> (PipeReader, PipeWriter) {
    let (reader, mut writer) = std::io::pipe().unwrap();
    let flags = fcntl_getfl(&writer).unwrap();
    fcntl_setfl(&writer, flags | OFlags::NONBLOCK).unwrap();
    for size in [4096, 1] {
        while writer.write(&vec![b'\n'; size]).is_ok() {}
    }
    fcntl_setfl(&writer, flags).unwrap();
    (reader, writer)
}

/// The capture ends in order; `stdout` is what its events are written to.
#[track_caller]
fn captured_to(folder: &Path, stdout: impl Into<Stdio>) {
    let mut child = rig(folder, &with_events(&TWO_LIGHTS))
        .stdout(stdout)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if began.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("it does not end");
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert!(status.success());
}

/// Whatever the reader does, the session is that of a capture without one.
#[test]
fn no_reader_changes_the_session() {
    let reference = workplace(|text| text);
    good(run(reference.path(), &TWO_LIGHTS));
    let expected = content(&only_session(reference.path()).unwrap());
    let check = |case: &str, capture: &dyn Fn(&Path)| {
        let folder = workplace(|text| text);
        capture(folder.path());
        let root = only_session(folder.path()).unwrap();
        assert!(Session::open(&root).unwrap().journal().is_complete());
        assert_eq!(content(&root), expected, "{case}");
    };
    check("one that reads all", &|folder| {
        let output = good(run(folder, &with_events(&TWO_LIGHTS)));
        assert_eq!(end(&events(&output.stdout)), Some(Ending::Complete));
    });
    check("one that never reads", &|folder| {
        let (reader, writer) = full_pipe();
        captured_to(folder, writer);
        drop(reader);
    });
    check("one that is gone", &|folder| {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        captured_to(folder, writer);
    });
    check("one that goes", &|folder| {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let leaves = std::thread::spawn(move || reader.read_exact(&mut [0; 500]).unwrap());
        captured_to(folder, writer);
        leaves.join().unwrap();
    });
    check("one that takes a byte a second", &|folder| {
        let (mut reader, writer) = full_pipe();
        std::thread::spawn(move || {
            // Until the writer has gone.
            while reader.read(&mut [0]).is_ok_and(|count| count > 0) {
                std::thread::sleep(Duration::from_secs(1));
            }
        });
        captured_to(folder, writer);
    });
    check("a full disk", &|folder| {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full");
        captured_to(folder, full.unwrap());
    });
}

/// What comes after the capture: the fit's phases and what it comes to; `rig fit` likewise.
#[test]
fn the_fit_is_reported_in_the_same_stream() {
    let folder = workplace(|text| text);
    let capture = with_events(&["capture", "--lights", "2"]);
    let events_of_capture = events(&good(run(folder.path(), &capture)).stdout);
    let is_end = |event: &Progress| matches!(event, Progress::Ended { .. });
    let ended = events_of_capture.iter().position(is_end).unwrap();
    assert_eq!(end(&events_of_capture[..=ended]), Some(Ending::Complete));
    let root = only_session(folder.path()).unwrap();
    let check = |events: &[Progress], has_report: bool| {
        let Some((Progress::Fitted { fit, report, .. }, phases)) = events.split_last() else {
            panic!("{events:?}");
        };
        assert!(folder.path().join(fit).join("fit.toml").exists(), "{fit}");
        assert_eq!(report.is_some(), has_report);
        if let Some(report) = report {
            assert!(folder.path().join(report).exists(), "{report}");
        }
        let done: Vec<f64> = phases
            .iter()
            .map(|event| match event {
                Progress::Fit { done, .. } => *done,
                other => panic!("{other:?}"),
            })
            .collect();
        assert!(
            done.len() > 2 && done.iter().all(|d| (0.0..=1.0).contains(d)),
            "{done:?}"
        );
    };
    check(&events_of_capture[ended + 1..], true);
    let fit = ["fit", "--events", root.to_str().unwrap()];
    let fitted = events(&good(run(folder.path(), &fit)).stdout);
    check(&fitted, cfg!(feature = "reports"));

    // A fit that fails.
    std::fs::remove_file(root.join("derived/radiance_L001.exr")).unwrap();
    let output = run(folder.path(), &fit);
    assert_eq!(output.status.code(), Some(1));
    let [.., Progress::FitFailed { error, hint }] = &events(&output.stdout)[..] else {
        panic!("{}", text(&output.stdout));
    };
    assert!(text(&output.stderr).contains(error), "{error}");
    assert!(hint.is_some());
}

#[test]
fn a_capture_that_cannot_begin_ends_without_a_session() {
    let folder = workplace(|text| text.replace("driver = \"simulated\"", "driver = \"other\""));
    let refused = |output: &Output| {
        assert_eq!(output.status.code(), Some(1));
        match &events(&output.stdout)[..] {
            [
                ..,
                Progress::Ended {
                    outcome: Ending::Failed,
                    session: None,
                    error,
                    ..
                },
            ] => error.clone().unwrap(),
            other => panic!("{other:?}"),
        }
    };
    let output = run(folder.path(), &with_events(&TWO_LIGHTS));
    let error = refused(&output);
    assert!(text(&output.stderr).contains(&error), "{error}");
    no_session(folder.path());
    refused(&run(
        folder.path(),
        &["capture", "--events", "--resume", "nothing"],
    ));
    for other in ["--json", "--dry-run"] {
        let output = run(
            folder.path(),
            &[&with_events(&TWO_LIGHTS)[..], &[other]].concat(),
        );
        assert_fails(&output, 1, "cannot be used with", "explains the arguments");
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn options_of_the_console_need_it() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        &["capture", "--lights", "2", "--port", "8080"][..],
        &["demo", "--listen", "127.0.0.1"],
    ] {
        let output = run(folder.path(), arguments);
        assert_fails(
            &output,
            1,
            "--listen, --port and --host-name are of the console",
            "add --console, or leave them out",
        );
    }
    for other in ["--events", "--json", "--dry-run"] {
        let output = run(
            folder.path(),
            &["capture", "--lights", "2", "--console", other],
        );
        assert_fails(&output, 1, "cannot be used with", "explains the arguments");
    }
}

fn capture_in_memory(world: impl FnOnce(&mut bench::World)) -> Vec<Progress> {
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(UnsyncedDisk);
    let session = bench::create(disk, folder.path()).unwrap();
    let bench = bench::Bench::with(world);
    let (result, observed) = bench::capture(&bench, session);
    let failed = end(&observed.events) == Some(Ending::Failed);
    assert_eq!(result.is_err(), failed);
    if let Ok(outcome) = result {
        assert_eq!(outcome, Outcome::Complete);
    }
    observed.events
}

/// The library itself: whatever ends a run, the end is the last event, and says why.
#[test]
fn the_end_is_the_last_event_and_has_the_reason() {
    let events = capture_in_memory(|world| world.fail_at_grab = Some(25));
    let Some(Progress::Ended { outcome, error, .. }) = events.last() else {
        panic!("{events:?}");
    };
    assert_eq!(*outcome, Ending::Failed);
    assert!(error.is_some());
    let stored = |event: &&Progress| matches!(event, Progress::Stored { .. });
    assert!(events.iter().filter(stored).count() > 4, "{events:?}");
    let ends = |event: &&Progress| matches!(event, Progress::Ended { .. });
    assert_eq!(events.iter().filter(ends).count(), 1);

    let events = capture_in_memory(|world| world.pause_at_grab = Some(25));
    let at = |wanted| position(&events, wanted);
    assert_eq!(at(&Progress::Paused) + 1, at(&Progress::Continued));
    // Every frame that was taken before was reported before.
    let [mut taken, mut stored] = [0, 0];
    for event in &events[..at(&Progress::Paused)] {
        taken += u32::from(matches!(event, Progress::Frame { .. }));
        stored += u32::from(matches!(event, Progress::Stored { .. }));
    }
    assert!(stored > 0 && taken == stored, "{taken} {stored}");
    // The light is compared by a frame that becomes no file.
    let unkept = |event: &Progress| matches!(event, Progress::Frame { kept: false, .. });
    assert!(events.iter().any(unkept), "{events:?}");
}
