//! The program as a user runs it, on a simulated rig whose truth is rendered quickly.

// Each test uses some of it.
#![allow(dead_code)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rig::session::{Journal, Session, layout};
use tempfile::TempDir;

pub(crate) use crate::small_bench;

/// A folder with a rig file of the small simulated bench whose truth is rendered
/// quickly; `change` is applied to its text.
pub fn workplace(change: impl FnOnce(String) -> String) -> TempDir {
    let folder = quick_bench(&small_bench::rig_file(), change);
    small_bench::put_records(folder.path());
    folder
}

/// The same with the camera that the program ships.
pub fn shipped_workplace(change: impl FnOnce(String) -> String) -> TempDir {
    quick_bench(include_str!("../../rig-configs/simulated.toml"), change)
}

/// The bench of a rig file with a tilted camera, likewise small and quick.
pub fn tilted_workplace(text: &str) -> TempDir {
    let small = [
        ("name = \"simulated-tilted\"", "name = \"simulated\""),
        ("name = \"simulated-ball\"", "name = \"simulated\""),
        ("resolution_px = [640, 480]", "resolution_px = [64, 64]"),
        ("extent_mm = [24.0, 18.0]", "extent_mm = [22.0, 22.0]"),
        ("point_spread_px = 0.5", "point_spread_px = 0.0"),
    ];
    let text = (small.iter()).fold(text.to_owned(), |text, (old, new)| text.replace(old, new));
    let folder = quick_bench(&text, |text| {
        text.replace("segments = 32", "segments = 192")
    });
    small_bench::put_records(folder.path());
    folder
}

fn quick_bench(text: &str, change: impl FnOnce(String) -> String) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (before, simulation) = text.split_once("[simulation]").unwrap();
    let quick: String = simulation
        .lines()
        .map(|line| match line.split_once(" = ") {
            Some(("samples_per_pixel", _)) => "samples_per_pixel = 2\n".into(),
            Some(("max_reflections", _)) => "max_reflections = 2\n".into(),
            Some(("segments", _)) => "segments = 32\n".into(),
            Some(("timing", _)) => "timing = \"instant\"\n".into(),
            Some(("material", _)) => {
                "brdf = { mixture = [ { weight = 1.0, lambertian = { albedo = 0.8 } } ] }\n".into()
            }
            _ => format!("{line}\n"),
        })
        .collect();
    // The smaller dictionary and few paths: no test asks here how well a fit does.
    let before = before
        .replace("dictionary = \"rig65\"", "dictionary = \"rig26\"")
        .replace("samples_per_pixel = 160", "samples_per_pixel = 32");
    let text = change(format!("{before}[simulation]{quick}"));
    fs::write(folder.path().join("rig.toml"), text).unwrap();
    folder
}

/// A rig file whose stage is on this serial port, in a folder that lasts as long as its guard.
pub fn rig_file_on_port(built_in: &str, port: &str) -> (TempDir, String) {
    let with_port: String = built_in
        .lines()
        .map(|line| match line.strip_prefix("port = ") {
            Some(_) => format!("port = {port:?}\nconnect_timeout_s = 0.6\n"),
            None => format!("{line}\n"),
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("arm.toml");
    fs::write(&file, with_port).unwrap();
    let name = file.display().to_string();
    (folder, name)
}

/// The program with these arguments in this folder.
pub fn rig(folder: impl AsRef<Path>, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rig"));
    command
        .args(arguments)
        .current_dir(folder)
        .env_remove("RIG_CONFIG")
        .env_remove("RUST_BACKTRACE");
    command
}

/// The words of a command line, none of which holds a blank.
pub fn words(line: &str) -> Vec<&str> {
    line.split_whitespace().collect()
}

/// The cases of a table, one a line, with `|` between their columns.
pub fn cases<const N: usize>(table: &str) -> impl Iterator<Item = [&str; N]> {
    table.trim().lines().map(|case| {
        let columns: Vec<_> = case.split('|').map(str::trim).collect();
        columns
            .try_into()
            .unwrap_or_else(|_| panic!("{N} columns: {case}"))
    })
}

/// A small scene that renders.
pub const SCENE: &str = r#"
[camera]
model = "orthographic"
resolution_px = [8, 8]
extent_mm = [2.2, 2.2]
position_mm = [0.0, 0.0, 5.0]

[[light]]
kind = "directional"
to_light = [0.0, 0.0, 1.0]

[sample]
shape = { kind = "bowl", radius_mm = 1.0, segments = 16 }

[brdf]
mixture = [ { weight = 1.0, lambertian = { albedo = 0.5 } } ]
"#;

/// Likewise, run to its end.
pub fn run(folder: impl AsRef<Path>, arguments: &[&str]) -> Output {
    rig(folder.as_ref(), arguments).output().unwrap()
}

/// Likewise, of a line whose words hold no blank.
pub fn run_line(folder: impl AsRef<Path>, line: &str) -> Output {
    run(folder, &words(line))
}

/// Exit code, stdout, stderr.
pub fn ended(output: &Output) -> (i32, String, String) {
    let code = output.status.code().unwrap_or(-1);
    (code, text(&output.stdout), text(&output.stderr))
}

/// What the program said on stderr.
pub fn stderr(output: &Output) -> String {
    text(&output.stderr)
}

/// The output of a command that must succeed.
#[track_caller]
pub fn good(output: Output) -> Output {
    assert!(output.status.success(), "{}", text(&output.stderr));
    output
}

/// The JSON that a command must print.
#[track_caller]
pub fn json(output: Output) -> serde_json::Value {
    serde_json::from_slice(&good(output).stdout).unwrap()
}

/// The session that a capture has printed, as it is printed.
pub fn printed_session(output: &Output) -> PathBuf {
    PathBuf::from(text(&output.stdout).lines().last().unwrap())
}

/// The text with parts replaced that must be in it.
#[track_caller]
pub fn changed(mut text: String, changes: &[(&str, &str)]) -> String {
    for (old, new) in changes {
        assert!(text.contains(old), "{old}");
        text = text.replace(old, new);
    }
    text
}

/// A folder with the rig file of the small simulated bench, parts of it replaced, and the
/// records of its sensor.
#[track_caller]
pub fn small_bench_with(changes: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let text = changed(small_bench::rig_file(), changes);
    fs::write(folder.path().join("rig.toml"), text).unwrap();
    small_bench::put_records(folder.path());
    folder
}

/// For people to read.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Exit code 0.
#[track_caller]
pub fn assert_done(output: &Output) {
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
}

/// Exit code `code`, one line of fact, a blank line, a hint, and no defect.
#[track_caller]
pub fn assert_fails(output: &Output, code: i32, fact: &str, hint: &str) {
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    let lines: Vec<&str> = stderr.lines().collect();
    let [.., error, "", advice] = lines[..] else {
        panic!("not one fact and one hint:\n{stderr}");
    };
    assert!(
        error.starts_with("error: ") && error.contains(fact),
        "{stderr}"
    );
    assert!(
        advice.starts_with("hint: ") && advice.contains(hint),
        "{stderr}"
    );
    assert!(!stderr.contains("internal error"), "{stderr}");
}

/// Exit code 1, a line that states the fact, a hint at the end, and no defect; there may be
/// remarks before.
#[track_caller]
pub fn assert_refused(output: &Output, fact: &str) {
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let lines: Vec<&str> = stderr.trim_end().lines().collect();
    let error = lines
        .iter()
        .find(|line| line.starts_with("error: "))
        .unwrap_or(&"");
    assert!(error.contains(fact), "{stderr}");
    assert!(lines.last().unwrap().starts_with("hint: "), "{stderr}");
    assert!(
        !stderr.contains("panicked") && !stderr.contains("internal error"),
        "{stderr}"
    );
}

#[track_caller]
pub fn no_session(folder: impl AsRef<Path>) {
    let sessions = folder.as_ref().join("sessions");
    let any = fs::read_dir(sessions).map_or(0, |entries| entries.count());
    assert_eq!(any, 0);
}

/// The rig file with such a body around the sample.
pub fn with_body(text: &str, body: &str) -> String {
    let next = "[geometry.sample_from_stage]";
    text.replace(next, &format!("[[geometry.body]]\n{body}\n{next}"))
}

/// The path that stdout ends with.
pub fn session_of(folder: impl AsRef<Path>, output: &Output) -> PathBuf {
    let stdout = text(&output.stdout);
    folder
        .as_ref()
        .join(stdout.lines().last().expect("a path on stdout"))
}

/// A folder with all that is in it.
pub fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

pub fn only_session(folder: &Path) -> Option<PathBuf> {
    fs::read_dir(folder.join("sessions"))
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .find(|path| !path.file_name().unwrap().to_str().unwrap().starts_with('.'))
}

/// Starts a capture and waits until its journal is as wanted.
pub fn begin(
    folder: &Path,
    arguments: &[&str],
    until: impl Fn(&Journal) -> bool,
) -> (Child, PathBuf) {
    let mut child = rig(folder, arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let began = Instant::now();
    loop {
        if let Some(root) = only_session(folder)
            && Journal::read(&root).is_ok_and(|journal| until(&journal))
        {
            return (child, root);
        }
        assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
        assert!(began.elapsed() < Duration::from_secs(120), "it takes long");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Journalled files with their contents, but for what differs between any two
/// captures: times and the simulated stage's port.
pub fn content(root: &Path) -> BTreeMap<String, String> {
    let session = Session::open(root).unwrap();
    let files = session.journal().files().into_iter();
    files
        .filter(|file| file.path != layout::MANIFEST_FILE)
        .map(|file| {
            let bytes = fs::read(root.join(&file.path)).unwrap();
            let is_text = file.path.starts_with("raw/") && file.path.ends_with(".toml");
            let compared = if is_text || file.path == layout::SESSION_FILE {
                let text = String::from_utf8(bytes).unwrap();
                let text = text.split("[time]").next().unwrap_or("").to_owned();
                let changes = ["created_utc", "port = "];
                let same = |line: &&str| !changes.iter().any(|key| line.starts_with(key));
                text.lines().filter(same).collect()
            } else {
                file.sha256.clone()
            };
            (file.path.clone(), compared)
        })
        .collect()
}

/// Waits until the process is suspended.
pub fn wait_until_stopped(child: &Child) {
    let stat = format!("/proc/{}/stat", child.id());
    let is_stopped = || {
        let stat = fs::read_to_string(&stat).unwrap();
        stat.rsplit(')').next().unwrap().trim().starts_with('T')
    };
    let began = Instant::now();
    while !is_stopped() {
        assert!(began.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(5));
    }
}
