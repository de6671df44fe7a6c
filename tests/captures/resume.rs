//! Captures that are interrupted, paused, killed or cut at any record, and their sessions
//! resumed, as a user does it on the simulated rig.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant};

use crate::command_support::*;
use rig::random::{Purpose, stream};
use rig::session::{Event, Journal, Session, SessionState, layout, verify};
use rustix::process::{Pid, Signal, kill_process};

/// Starts a capture of two lights and waits until `frames` frames are journalled.
fn begin_two(folder: &Path, frames: usize) -> (Child, PathBuf) {
    let is_frame = |event: &Event| matches!(event, Event::Frame { .. });
    begin(
        folder,
        &["capture", "--lights", "2", "--no-fit"],
        |journal| {
            let records = journal.records.iter();
            records.filter(|r| is_frame(&r.event)).count() >= frames
        },
    )
}

fn finish(folder: &Path, root: &Path) {
    let before: Vec<_> = Session::open(root).unwrap().frames().collect();
    let output = run(
        folder,
        &["capture", "--no-fit", "--resume", root.to_str().unwrap()],
    );
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(Path::new(text(&output.stdout).trim_end()), root);
    let found = verify::verify(root).unwrap();
    assert!(found.is_intact() && found.complete, "{found:?}");
    let after: Vec<_> = Session::open(root).unwrap().frames().collect();
    assert_eq!(after[..before.len()], before, "finished frames stay");
    let output = run(folder, &["session", "verify", root.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn a_signal_ends_a_capture_in_good_order_and_it_resumes() {
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let folder = workplace(|text| text);
        let (child, root) = begin_two(folder.path(), 6);
        kill_process(Pid::from_child(&child), signal).unwrap();
        let output = child.wait_with_output().unwrap();
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{stderr}");
        assert!(stderr.contains("hint: `rig capture --resume"), "{stderr}");
        assert_eq!(session_of(folder.path(), &output), root);
        assert_eq!(
            Session::open(&root).unwrap().state(),
            SessionState::Interrupted
        );
        assert!(verify::verify(&root).unwrap().is_intact());
        if signal == Signal::INT {
            finish(folder.path(), &root);
        }
    }
}

/// A capture paused by Ctrl-Z in its first light and continued: its session and output.
fn paused_and_continued(folder: &Path) -> (PathBuf, Output) {
    let (child, root) = begin_two(folder, 14);
    let pid = Pid::from_child(&child);
    kill_process(pid, Signal::TSTP).unwrap();
    wait_until_stopped(&child);
    let last = Journal::read(&root).unwrap().records.pop().unwrap();
    assert_eq!(last.event, Event::Paused);
    kill_process(pid, Signal::CONT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(text(&output.stderr).contains("paused: the lamp is off"));
    assert!(verify::verify(&root).unwrap().is_intact());
    (root, output)
}

/// Ctrl-Z: the program turns the lamp off and then suspends; continued, it homes the stage
/// anew and goes on, since the switches are found again within the stage's tolerance.
#[test]
fn a_capture_is_paused_by_ctrl_z_and_goes_on() {
    let folder = shipped_workplace(|text| text);
    let (root, output) = paused_and_continued(folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(Journal::read(&root).unwrap().is_complete());
}

/// A stage that finds its switches some degrees elsewhere: the light begun is not mixed
/// from two, and the message says by how much it is off.
#[test]
fn a_light_that_is_not_back_where_it_was_is_refused() {
    let folder = workplace(|text| text.replace("homing = 0.02", "homing = 4.0"));
    let (root, output) = paused_and_continued(folder.path());
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    for words in [
        "since the stage was homed anew",
        "position_tolerance_deg of 0.05° explains",
        "`rig capture --resume",
    ] {
        assert!(stderr.contains(words), "{stderr}");
    }
    // The next homing, of another process, finds them where the first one did.
    finish(folder.path(), &root);
}

/// Over several lights, and back to the first one.
const FOUR_LIGHTS: [&str; 4] = ["capture", "--lights", "4", "--no-fit"];

/// A whole session of four lights. Nothing on the bench changes, so nothing is remarked on.
fn four_lights(folder: &Path) -> PathBuf {
    let output = run(folder, &FOUR_LIGHTS);
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    assert!(!stderr.contains("warning"), "{stderr}");
    let root = session_of(folder, &output);
    let record = |event: &Event| matches!(event, Event::Warning { .. });
    let journal = Journal::read(&root).unwrap();
    assert!(!journal.records.iter().any(|r| record(&r.event)));
    root
}

/// A session as a crash after so many records leaves it, with the files of `ahead` records
/// more, in another folder.
pub(super) fn cut(reference: &Path, to: &Path, records: usize, ahead: usize) {
    let journal = std::fs::read(reference.join(layout::JOURNAL_FILE)).unwrap();
    let lines: Vec<&[u8]> = journal.split_inclusive(|&b| b == b'\n').collect();
    let there = Journal::parse(&lines[..(records + ahead).min(lines.len())].concat()).unwrap();
    for folder in [layout::RAW_FOLDER, layout::DERIVED_FOLDER] {
        std::fs::create_dir_all(to.join(folder)).unwrap();
    }
    for file in there.files() {
        let path = to.join(&file.path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::copy(reference.join(&file.path), path).unwrap();
    }
    std::fs::write(to.join(layout::JOURNAL_FILE), lines[..records].concat()).unwrap();
}

/// Records after which a cut is tried: one of every kind in every light, at another place
/// in each; all of them with `RIG_CUTS=all`. A session has its name from the first record
/// after its calibration on.
fn cuts(journal: &Journal) -> Vec<usize> {
    let every = std::env::var("RIG_CUTS").is_ok_and(|which| which == "all");
    let is_copy = |event: &Event| matches!(event, Event::File { file } if file.path.starts_with("calibration/"));
    let first = journal
        .records
        .iter()
        .rposition(|r| is_copy(&r.event))
        .unwrap()
        + 1;
    let mut light = 0;
    let mut times: BTreeMap<String, u32> = BTreeMap::new();
    let mut chosen = Vec::new();
    for count in first..journal.records.len() {
        let event = &journal.records[count - 1].event;
        if let Event::LightStart { light: at, .. } = event {
            light = *at;
        }
        let (kind, wanted) = match event {
            Event::Frame { key, .. } => (format!("{:?} of light {}", key.kind, key.light), light),
            Event::File { file } => (file.path.clone(), 0),
            other => (format!("{other:?}"), 0),
        };
        let seen = times.entry(kind).or_default();
        if every || *seen == wanted {
            chosen.push(count);
        }
        *seen += 1;
    }
    chosen
}

/// A journal that ends after any record: the session is resumed and is the uninterrupted one.
#[test]
fn a_capture_cut_at_any_record_resumes_to_the_same_session() {
    let folder = workplace(|text| text);
    let reference = four_lights(folder.path());
    let expected = content(&reference);
    let journal = Journal::read(&reference).unwrap();
    let cuts = cuts(&journal);
    for (number, &records) in cuts.iter().enumerate() {
        let root = folder.path().join(format!("cut-{records}"));
        cut(&reference, &root, records, number % 3);
        finish(folder.path(), &root);
        let last = &journal.records[records - 1].event;
        assert_eq!(content(&root), expected, "after record {records}, {last:?}");
        std::fs::remove_dir_all(root).unwrap();
    }
    println!("{} cuts of {} records", cuts.len(), journal.records.len());
    assert!(cuts.len() > 20, "{cuts:?}");
}

/// `kill -9` at random moments over the length of a capture, `RIG_KILLS` times.
#[test]
fn a_capture_killed_at_any_moment_resumes_to_the_same_session() {
    let kills: u64 = std::env::var("RIG_KILLS").map_or(5, |text| text.parse().unwrap());
    let folder = workplace(|text| text);
    let began = Instant::now();
    let reference = four_lights(folder.path());
    let length_s = began.elapsed().as_secs_f64();
    let expected = content(&reference);
    let journal_bytes = |root: &Path| {
        std::fs::metadata(root.join(layout::JOURNAL_FILE)).map_or(0, |file| file.len())
    };
    let whole_bytes = journal_bytes(&reference);
    let whole = Session::open(&reference).unwrap().frames().count();
    let mut random = stream(9, Purpose::Experiment, 0, 0, 0);
    let (mut without, mut complete, mut torn, mut with_strays) = (0, 0, 0, 0);
    let mut journalled = Vec::new();
    for number in 0..kills {
        let folder = workplace(|text| text);
        let part = random.uniform();
        let case = format!("kill {number} of {kills} after {part:.3} of the capture");
        let mut child = rig(folder.path(), &FOUR_LIGHTS)
            .args(["--quiet"])
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        if number % 5 == 0 {
            // Of its time, most of which goes by before the first frame ...
            std::thread::sleep(Duration::from_secs_f64(length_s * part));
        } else {
            // ... or of its journal, and a moment more.
            let reached = || {
                only_session(folder.path())
                    .is_some_and(|root| journal_bytes(&root) as f64 >= part * whole_bytes as f64)
            };
            while !reached() && child.try_wait().unwrap().is_none() {
                std::thread::sleep(Duration::from_micros(100));
            }
            std::thread::sleep(Duration::from_secs_f64(0.004 * random.uniform()));
        }
        // One that has ended already is no worse.
        let _ = child.kill();
        child.wait().unwrap();
        let Some(root) = only_session(folder.path()) else {
            without += 1;
            continue;
        };
        let before = Journal::read(&root).unwrap();
        let frames: Vec<_> = Session::open(&root).unwrap().frames().collect();
        complete += u32::from(before.is_complete());
        torn += u32::from(before.torn_bytes > 0);
        journalled.push(frames.len());
        finish(folder.path(), &root);
        let after = Session::open(&root).unwrap();
        let strays = |event: &Event| matches!(event, Event::Resume { quarantined: 1.. });
        with_strays += u32::from(after.journal().records.iter().any(|r| strays(&r.event)));
        assert_eq!(content(&root), expected, "{case}");
    }
    journalled.sort_unstable();
    println!(
        "{kills} kills over {length_s:.2} s: {without} before there was a session, {complete} after \
         its end, {torn} with a torn journal, {with_strays} with files that no record names; \
         0 journalled frames lost or changed; journalled at the kill, of {whole}: {journalled:?}"
    );
    assert!(journalled.len() as u64 + without == kills && journalled.len() > 1);
}
