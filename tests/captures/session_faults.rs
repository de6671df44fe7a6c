//! Sessions that somebody or something has changed: links, pipes, devices, forged records and
//! plans, odd names, folders that cannot be written. Each is named, nothing is made worse.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

use crate::command_support::words;
use crate::command_support::*;
use rig::session::journal::encode;
use rig::session::{Event, FileDigest, Journal, Record, layout};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

/// A whole session of one light.
fn one_light(folder: &TempDir) -> PathBuf {
    let captured = run(folder.path(), &["capture", "--lights", "1", "--no-fit"]);
    assert_done(&captured);
    session_of(folder.path(), &captured)
}

/// Ends in time, whatever it reads: nothing that it waits for comes.
#[track_caller]
fn run_to_its_end(folder: &Path, arguments: &[&str]) -> Output {
    let child = rig(folder, arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut child = child.unwrap();
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if began.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!("{arguments:?} does not end");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    child.wait_with_output().unwrap()
}

fn make_pipe(path: &Path) {
    let kind = rustix::fs::FileType::Fifo;
    let mode = rustix::fs::Mode::from_raw_mode(0o600);
    rustix::fs::mknodat(rustix::fs::CWD, path, kind, mode, 0).unwrap();
}

const FRAME: &str = "raw/L000_E00_R00_light.png";

/// A link where something of the session belongs, or a pipe or device: `verify` names it,
/// `resume` refuses for the same reason and moves nothing, and what the hint says mends it.
#[test]
fn links_pipes_and_devices_in_a_session_are_named() {
    type Change = fn(&Path, &Path);
    let link = std::os::unix::fs::symlink::<PathBuf, PathBuf>;
    let elsewhere: Change = |root, aside| {
        fs::rename(root.join("raw"), aside).unwrap();
        std::os::unix::fs::symlink(aside, root.join("raw")).unwrap();
    };
    let frame_elsewhere: Change = |root, aside| {
        fs::rename(root.join(FRAME), aside).unwrap();
        std::os::unix::fs::symlink(aside, root.join(FRAME)).unwrap();
    };
    let quarantine_elsewhere: Change = |root, aside| {
        fs::create_dir(aside).unwrap();
        fs::write(root.join("notes.txt"), "a stray").unwrap();
        std::os::unix::fs::symlink(aside, root.join("quarantine")).unwrap();
    };
    let piped_frame: Change = |root, aside| {
        fs::rename(root.join(FRAME), aside).unwrap();
        make_pipe(&root.join(FRAME));
    };
    let endless_frame: Change = |root, aside| {
        fs::rename(root.join(FRAME), aside).unwrap();
        std::os::unix::fs::symlink("/dev/zero", root.join(FRAME)).unwrap();
    };
    let piped_journal: Change = |root, aside| {
        fs::rename(root.join(layout::JOURNAL_FILE), aside).unwrap();
        make_pipe(&root.join(layout::JOURNAL_FILE));
    };
    let endless_journal: Change = |root, aside| {
        fs::rename(root.join(layout::JOURNAL_FILE), aside).unwrap();
        std::os::unix::fs::symlink("/dev/zero", root.join(layout::JOURNAL_FILE)).unwrap();
    };
    let endless_record: Change = |root, aside| {
        fs::rename(root.join(layout::SESSION_FILE), aside).unwrap();
        std::os::unix::fs::symlink("/dev/zero", root.join(layout::SESSION_FILE)).unwrap();
    };
    let folder = workplace(|text| text);
    let whole = one_light(&folder);
    for (number, (change, fact)) in [
        (elsewhere, "raw is a link to"),
        (frame_elsewhere, "_light.png is a link to"),
        (quarantine_elsewhere, "quarantine is a link to"),
        (piped_frame, "it is a named pipe"),
        (endless_frame, "is a link to /dev/zero"),
        (piped_journal, "it is a named pipe"),
        (endless_journal, "it is a device"),
        (endless_record, "session.toml"),
    ]
    .into_iter()
    .enumerate()
    {
        let root = folder.path().join(format!("changed-{number}"));
        let aside = folder.path().join(format!("aside-{number}"));
        copy(&whole, &root);
        change(&root, &aside);
        let names = || {
            let mut names: Vec<_> = fs::read_dir(&root)
                .unwrap()
                .map(|entry| entry.unwrap().file_name())
                .collect();
            names.sort();
            names
        };
        let before = names();
        let name = root.to_str().unwrap();
        for command in [
            &["session", "verify"][..],
            &["capture", "--no-fit", "--resume"],
        ] {
            let output = run_to_its_end(folder.path(), &[command, &[name]].concat());
            let hint = match command[0] == "capture" && fact.contains("is a link to") {
                true => "put a copy of what it leads to in the link's place",
                false => "",
            };
            assert_fails(&output, 1, fact, hint);
            assert_eq!(names(), before, "{fact}: something was moved");
        }
        // Nothing was put into the folder behind the link.
        if aside.is_dir() && !aside.join("L000_E00_R00_light.png").exists() {
            assert_eq!(fs::read_dir(&aside).unwrap().count(), 0, "{fact}");
        }
    }
    // The hint, obeyed: a copy in the link's place.
    let root = folder.path().join("changed-0");
    fs::remove_file(root.join("raw")).unwrap();
    copy(&folder.path().join("aside-0"), &root.join("raw"));
    let name = root.to_str().unwrap();
    assert_done(&run(folder.path(), &["session", "verify", name]));
    assert_done(&run(
        folder.path(),
        &["capture", "--no-fit", "--resume", name],
    ));
    // A link that is nobody's is set aside like any other stray.
    link("nowhere".into(), root.join("latest")).unwrap();
    assert_done(&run(
        folder.path(),
        &["capture", "--no-fit", "--resume", name],
    ));
    assert!(root.join("quarantine/1/latest").is_symlink());
    assert_done(&run(folder.path(), &["session", "verify", name]));
}

/// Writes the records as a journal whose checksums are right.
fn forge(root: &Path, records: &[Record]) {
    let lines = records.iter().zip(0..).map(|(record, number)| {
        encode(&Record {
            number,
            ..record.clone()
        })
    });
    fs::write(
        root.join(layout::JOURNAL_FILE),
        lines.collect::<Vec<_>>().concat(),
    )
    .unwrap();
}

/// Records with right checksums that cannot all be true are named, by `verify` and `resume`.
#[test]
fn records_that_contradict_each_other_are_named() {
    type Change = fn(&mut Vec<Record>);
    fn place(records: &[Record], is: fn(&Event) -> bool) -> usize {
        records.iter().position(|record| is(&record.event)).unwrap()
    }
    let longer: Change = |records| {
        let at = place(records, |event| matches!(event, Event::Frame { .. }));
        if let Event::Frame { image, .. } = &mut records[at].event {
            image.bytes = u64::MAX;
        }
    };
    let shorter: Change = |records| {
        let at = place(records, |event| matches!(event, Event::Frame { .. }));
        if let Event::Frame { image, .. } = &mut records[at].event {
            image.bytes -= 1;
        }
    };
    let second_stop: Change = |records| {
        records.push(records.last().unwrap().clone());
    };
    let early_stop: Change = |records| {
        let at = place(records, |event| matches!(event, Event::Homed));
        let stop = records.pop().unwrap();
        records.insert(at, stop);
    };
    let frame_twice: Change = |records| {
        let at = place(records, |event| matches!(event, Event::Frame { .. }));
        records.insert(at + 1, records[at].clone());
    };
    let no_calibration: Change = |records| records.truncate(1);
    let other_light: Change = |records| {
        let at = place(records, |event| matches!(event, Event::LightStop { .. }));
        records[at].event = Event::LightStop { light: u32::MAX };
    };
    let other_frame: Change = |records| {
        let at = place(records, |event| matches!(event, Event::Frame { .. }));
        if let Event::Frame { key, .. } = &mut records[at].event {
            key.light = 1;
        }
    };
    let folder = workplace(|text| text);
    let whole = one_light(&folder);
    for (number, (change, fact)) in [
        (longer, "the journal records 18446744073709551615"),
        (shorter, "bytes, the journal records"),
        (second_stop, "a second stop"),
        (early_stop, "a stop before any frame"),
        (frame_twice, "frame L000_E00_R00_light a second time"),
        (no_calibration, "which session.toml names, is in no record"),
        (
            other_light,
            "a record of light 4294967296, and the plan has 1",
        ),
        (other_frame, "a record of light 2, and the plan has 1"),
    ]
    .into_iter()
    .enumerate()
    {
        let root = folder.path().join(format!("forged-{number}"));
        copy(&whole, &root);
        let mut records = Journal::read(&root).unwrap().records;
        change(&mut records);
        forge(&root, &records);
        let name = root.to_str().unwrap();
        for command in [
            &["session", "verify"][..],
            &["capture", "--no-fit", "--resume"],
        ] {
            let output = run(folder.path(), &[command, &[name]].concat());
            assert_fails(&output, 1, fact, "restore");
        }
    }
}

/// A plan that no capture can follow, with right checksums: the key, its value and what may
/// stand there. A session.toml of any length is refused before it is read.
#[test]
fn a_plan_outside_its_ranges_is_refused() {
    let folder = workplace(|text| text);
    let whole = one_light(&folder);
    let changes = cases(
        "
        longest_s | 1e-9 | plan.exposure.longest_s` is 0.000000001
        shortest_s | -0.1 | plan.exposure.shortest_s` is -0.1
        peak_fraction | 0.0 | plan.exposure.peak_fraction` is 0, but must be 0.1 to 0.95
        settle_s | nan | plan.settle_s` is NaN, but must be 0 to 60
        lamp_settle_s | -inf | plan.lamp_settle_s` is -inf
        lamp_warm_up_s | inf | plan.lamp_warm_up_s` is inf, but must be 0 to 7200
        dark_frames | 4000000000 | plan.exposure.dark_frames` is 4000000000
        max_frames | 0 | plan.exposure.max_frames` is 0, but must be 1 to 4096
        azimuth_deg | nan | plan.lights[0]` is
    ",
    );
    let forged = |name: &str, text: &str| {
        let root = folder.path().join(name);
        copy(&whole, &root);
        fs::write(root.join(layout::SESSION_FILE), text).unwrap();
        let mut records = Journal::read(&root).unwrap().records;
        if let Event::Start { session, .. } = &mut records[0].event {
            *session = FileDigest::of(layout::SESSION_FILE, text.as_bytes());
        }
        forge(&root, &records);
        root.to_str().unwrap().to_owned()
    };
    let text = fs::read_to_string(whole.join(layout::SESSION_FILE)).unwrap();
    let (before, plan) = text.split_once("[plan]").unwrap();
    for [key, value, fact] in changes {
        let (head, rest) = plan.split_once(&format!("\n{key} = ")).expect(key);
        let (_, tail) = rest.split_once('\n').unwrap();
        let changed = format!("{before}[plan]{head}\n{key} = {value}\n{tail}");
        let name = forged(key, &changed);
        for command in [
            &["session", "verify"][..],
            &["capture", "--resume"],
            &["fit"],
        ] {
            let output = run(folder.path(), &[command, &[name.as_str()]].concat());
            assert_fails(&output, 1, fact, "restore session.toml");
        }
    }
    let long = format!("{}\n{text}", "# a comment\n".repeat(400_000));
    let name = forged("long", &long);
    let output = run_to_its_end(folder.path(), &["session", "verify", &name]);
    assert_fails(&output, 1, "but at most 4194304 are read", "");
    // A configuration of many values takes no time that grows with their square.
    let values: String = (0..60_000).map(|i| format!("\nx{i} = {i}")).collect();
    let (head, tail) = text.split_once("config = ").unwrap();
    let quote = &tail[..3];
    let rest = tail[3..]
        .split_once(quote)
        .expect("a text of several lines")
        .1;
    let name = forged(
        "many",
        &format!("{head}config = {quote}{values}\n{quote}{rest}"),
    );
    let began = Instant::now();
    let output = run_to_its_end(folder.path(), &["fit", &name]);
    assert_fails(&output, 1, "", "");
    assert!(began.elapsed() < Duration::from_secs(20));
}

/// Bytes that are no UTF-8 in a path are U+FFFD in JSON, and hide no other session.
#[test]
fn sessions_in_oddly_named_folders_are_listed_and_verified() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let folder = workplace(|text| text);
    let whole = one_light(&folder);
    let sessions = whole.parent().unwrap();
    let odd = sessions.join(OsStr::from_bytes(b"caf\xe9"));
    copy(&whole, &odd);
    fs::write(odd.join(OsStr::from_bytes(b"stray\xff")), "").unwrap();
    let broken = sessions.join(OsStr::from_bytes(b"half\xff"));
    fs::create_dir(&broken).unwrap();
    fs::write(broken.join(layout::SESSION_FILE), "").unwrap();
    let listed = run(folder.path(), &["catalogue", "--json"]);
    assert_done(&listed);
    let listed: serde_json::Value = serde_json::from_slice(&listed.stdout).unwrap();
    let names: Vec<_> = listed
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["name"].as_str().unwrap())
        .collect();
    let whole = whole.file_name().unwrap().to_str().unwrap();
    assert_eq!(names, [whole, "half\u{fffd}", "caf\u{fffd}"]);
    let verified = rig(folder.path(), &["session", "verify", "--json"])
        .arg(&odd)
        .output()
        .unwrap();
    assert_eq!(
        verified.status.code(),
        Some(1),
        "{}",
        text(&verified.stderr)
    );
    let verified: serde_json::Value = serde_json::from_slice(&verified.stdout).unwrap();
    assert_eq!(verified["strays"][0], "stray\u{fffd}");
    let one = rig(folder.path(), &["session", "list", "--json"])
        .arg(&odd)
        .output()
        .unwrap();
    assert_done(&one);
    let resumed = rig(
        folder.path(),
        &["capture", "--no-fit", "--json", "--resume"],
    )
    .arg(&odd)
    .output()
    .unwrap();
    assert_done(&resumed);
}

const SCENE: &str = r#"
camera = { model = "orthographic", resolution_px = [64, 64], extent_mm = [2.2, 2.2], position_mm = [0.0, 0.0, 5.0] }
light = [ { kind = "directional", to_light = [0.0, 0.0, 1.0], irradiance = 3.0 } ]
sample = { shape = { kind = "bowl", radius_mm = 1.0, segments = 48 } }
brdf = { mixture = [ { weight = 1.0, lambertian = { albedo = 0.8 } } ] }
"#;

/// What works for hours and writes at its end asks first whether it may.
#[test]
fn what_cannot_be_written_is_refused_before_the_work() {
    let folder = workplace(|text| text);
    let at = folder.path();
    let whole = one_light(&folder);
    fs::write(at.join("file"), "").unwrap();
    let session = whole.to_str().unwrap();
    // The scene's images do not exist: what is written is looked at before what is read.
    fs::write(at.join("scene.toml"), SCENE).unwrap();
    for [line, fact] in cases(
        "
        fit --scene scene.toml --image none.exr --out file/x | file/x:
        fit --scene scene.toml --image none.exr --out /proc/x | /proc/x:
        render --scene scene.toml --spp 65536 --out /proc/x.exr | /proc/x.exr:
        calibrate sensor --out file/x | file/x:
    ",
    ) {
        assert_fails(&run_to_its_end(at, &words(line)), 1, fact, "");
    }
    // Neither a folder nor a place for one: with the paths of a fit of hours.
    fs::write(whole.join("fits"), "").unwrap();
    let output = run_to_its_end(at, &["fit", "--spp", "65536", "--refine-bench", session]);
    assert_fails(&output, 1, "fits: ", "");
    fs::remove_file(whole.join("fits")).unwrap();
    if !rustix::process::geteuid().is_root() {
        let closed = fs::Permissions::from_mode(0o555);
        fs::set_permissions(&whole, closed).unwrap();
        let output = run_to_its_end(at, &["fit", "--spp", "65536", session]);
        fs::set_permissions(&whole, fs::Permissions::from_mode(0o755)).unwrap();
        assert_fails(&output, 1, "Permission denied", "");
    }
}

/// The images of lights that were never captured are not said to be lost.
#[test]
fn a_fit_of_an_interrupted_session_says_what_is_missing() {
    let folder = workplace(|text| text);
    let arguments = ["capture", "--lights", "2", "--no-fit"];
    let is_light = |event: &Event| matches!(event, Event::LightStop { .. });
    let (child, root) = begin(folder.path(), &arguments, |journal| {
        journal.records.iter().any(|record| is_light(&record.event))
    });
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(143), "{}", text(&output.stderr));
    let output = run(folder.path(), &["fit", root.to_str().unwrap()]);
    let fact = "has no merged image, because the capture ended after 1 of 2 lights (stopped";
    assert_fails(&output, 1, fact, "rig capture --resume");
}
