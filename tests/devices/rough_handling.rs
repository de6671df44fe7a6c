//! What happens to a capture and its session between people, disks and
//! signals: nothing that was journalled is lost, and whatever is wrong is said
//! in one line with a hint.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::command_support::*;
use rig::session::{Journal, Session, SessionState, layout, verify};
use rustix::process::{Pid, Signal, kill_process};

const NO_FIT: &[&str] = &["capture", "--lights", "1", "--no-fit"];

/// As on a real bench: motion, exposures and settling take their time.
fn realistic(text: String) -> String {
    assert!(text.contains("timing = \"instant\""));
    text.replace("timing = \"instant\"", "timing = \"realistic\"")
}

fn flip_a_bit(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(path, bytes).unwrap();
}

/// One way to damage the session `w`, and what the commands say: per command
/// line the exit code, a part of the fact and of the hint.
struct Damage {
    name: &'static str,
    done: fn(&Path),
    said: &'static [(&'static [&'static str], i32, &'static str, &'static str)],
    /// Whether the session is whole after `capture --resume`.
    heals: bool,
}

const VERIFY: &[&str] = &["session", "verify", "w"];
const RESUME: &[&str] = &["capture", "--no-fit", "--resume", "w"];
const FIT: &[&str] = &["fit", "w"];
const REPORT: &[&str] = &["report", "w"];
const LIST: &[&str] = &["session", "list", "w"];

fn first_calibration_copy(session: &Path) -> PathBuf {
    let mut folders = vec![session.join(layout::CALIBRATION_FOLDER)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            if entry.path().is_dir() {
                folders.push(entry.path());
            } else {
                return entry.path();
            }
        }
    }
    panic!("no calibration copy");
}

/// What cannot be made again must come from a backup.
const BACKUP: &str = "lists every such file; restore them from a backup";

const DAMAGES: &[Damage] = &[
    Damage {
        name: "merged image changed",
        done: |w| flip_a_bit(&w.join(layout::radiance_file(0))),
        said: &[
            (VERIFY, 1, "has SHA-256", "--resume"),
            (FIT, 1, "has SHA-256", "--resume"),
            (REPORT, 1, "has SHA-256", "--resume"),
        ],
        heals: true,
    },
    Damage {
        name: "merged image gone",
        done: |w| fs::remove_file(w.join(layout::radiance_file(0))).unwrap(),
        said: &[
            (VERIFY, 1, "not on the disk", "--resume"),
            (FIT, 1, "not on the disk", "--resume"),
        ],
        heals: true,
    },
    Damage {
        name: "manifest changed",
        done: |w| flip_a_bit(&w.join(layout::MANIFEST_FILE)),
        said: &[(VERIFY, 1, "manifest-sha256.txt has SHA-256", "--resume")],
        heals: true,
    },
    Damage {
        name: "manifest gone",
        done: |w| fs::remove_file(w.join(layout::MANIFEST_FILE)).unwrap(),
        said: &[(VERIFY, 1, "not on the disk", "--resume")],
        heals: true,
    },
    Damage {
        name: "torn journal",
        done: |w| {
            let path = w.join(layout::JOURNAL_FILE);
            let mut bytes = fs::read(&path).unwrap();
            bytes.extend(b"{\"half a li");
            fs::write(path, bytes).unwrap();
        },
        said: &[(
            VERIFY,
            1,
            "holds what its journal does not know",
            "--resume",
        )],
        heals: true,
    },
    Damage {
        name: "stray file",
        done: |w| fs::write(w.join("raw/note.txt"), "hello").unwrap(),
        said: &[(
            VERIFY,
            1,
            "holds what its journal does not know",
            "--resume",
        )],
        heals: true,
    },
    Damage {
        name: "raw frame changed",
        done: |w| flip_a_bit(&w.join("raw/L000_E00_R00_light.png")),
        said: &[
            (VERIFY, 1, "light.png has SHA-256", "backup"),
            (RESUME, 1, "light.png has SHA-256", BACKUP),
            (FIT, 1, "light.png has SHA-256", ""),
        ],
        heals: false,
    },
    Damage {
        name: "sidecar gone",
        done: |w| fs::remove_file(w.join("raw/L000_E00_R00_light.toml")).unwrap(),
        said: &[
            (VERIFY, 1, "light.toml is in the journal but not", "backup"),
            (RESUME, 1, "light.toml is in the journal but not", BACKUP),
            (REPORT, 1, "light.toml is in the journal but not", "verify"),
        ],
        heals: false,
    },
    Damage {
        name: "session.toml changed",
        done: |w| flip_a_bit(&w.join(layout::SESSION_FILE)),
        said: &[
            (VERIFY, 1, "session.toml has SHA-256", "backup"),
            (RESUME, 1, "session.toml has SHA-256", BACKUP),
            (FIT, 1, "session.toml has SHA-256", ""),
            (REPORT, 1, "session.toml has SHA-256", "verify"),
            (LIST, 1, "session.toml has SHA-256", BACKUP),
        ],
        heals: false,
    },
    Damage {
        name: "calibration copy changed",
        done: |w| flip_a_bit(&first_calibration_copy(w)),
        said: &[
            (VERIFY, 1, "has SHA-256", "backup"),
            (RESUME, 1, "has SHA-256", BACKUP),
        ],
        heals: false,
    },
    Damage {
        name: "journal changed",
        done: |w| {
            let path = w.join(layout::JOURNAL_FILE);
            let mut bytes = fs::read(&path).unwrap();
            bytes[200] ^= 1;
            fs::write(path, bytes).unwrap();
        },
        said: &[
            (VERIFY, 1, "journal.jsonl, line 1", "backup"),
            (RESUME, 1, "journal.jsonl, line 1", BACKUP),
            (FIT, 1, "journal.jsonl, line 1", ""),
            (REPORT, 1, "journal.jsonl, line 1", "verify"),
            (LIST, 1, "journal.jsonl, line 1", BACKUP),
        ],
        heals: false,
    },
    Damage {
        name: "journal empty",
        done: |w| fs::write(w.join(layout::JOURNAL_FILE), "").unwrap(),
        said: &[
            (VERIFY, 1, "holds no record", ""),
            (RESUME, 1, "holds no record", ""),
            (LIST, 1, "holds no record", ""),
        ],
        heals: false,
    },
    Damage {
        name: "journal gone",
        done: |w| fs::remove_file(w.join(layout::JOURNAL_FILE)).unwrap(),
        said: &[
            (VERIFY, 1, "it has no journal.jsonl", ""),
            (RESUME, 1, "it has no journal.jsonl", ""),
            (REPORT, 1, "it has no journal.jsonl", ""),
            (LIST, 1, "it has no journal.jsonl", ""),
        ],
        heals: false,
    },
];

#[test]
fn whatever_is_damaged_is_said_and_what_can_be_made_again_is() {
    let folder = workplace(|text| text);
    let folder = folder.path();
    let captured = run(folder, NO_FIT);
    assert_done(&captured);
    let whole = session_of(folder, &captured);
    let w = folder.join("w");
    for damage in DAMAGES {
        println!("{}", damage.name);
        copy(&whole, &w);
        (damage.done)(&w);
        for (arguments, code, fact, hint) in damage.said {
            assert_fails(&run(folder, arguments), *code, fact, hint);
        }
        if damage.heals {
            let healed = run(folder, RESUME);
            assert_done(&healed);
            assert_done(&run(folder, VERIFY));
            let check = Command::new("sha256sum")
                .args(["--check", "--quiet", "--strict", layout::MANIFEST_FILE])
                .current_dir(&w)
                .output()
                .unwrap();
            assert!(check.status.success(), "{}", text(&check.stdout));
        }
        fs::remove_dir_all(&w).unwrap();
    }
    // A report changes what the manifest vouches for.
    copy(&whole, &w);
    for _ in 0..2 {
        assert_done(&run(folder, REPORT));
    }
    assert_done(&run(folder, VERIFY));
    let manifest = fs::read_to_string(w.join(layout::MANIFEST_FILE)).unwrap();
    let report = rig::checksum::sha256_hex(&fs::read(w.join(layout::REPORT_FILE)).unwrap());
    assert!(manifest.contains(&format!("{report}  {}", layout::REPORT_FILE)));
}

#[test]
fn folders_and_names_that_cannot_be_used() {
    let folder = workplace(|text| text);
    let path = folder.path();
    fs::write(path.join("file"), "").unwrap();
    fs::create_dir(path.join("closed")).unwrap();
    fs::set_permissions(path.join("closed"), PermissionsExt::from_mode(0o555)).unwrap();
    fs::set_permissions(path, PermissionsExt::from_mode(0o755)).unwrap();
    // The superuser may write everywhere, so the test gives that up where it has it.
    let program = path.join("program");
    fs::copy(env!("CARGO_BIN_EXE_rig"), &program).unwrap();
    let mut command = Command::new(&program);
    command
        .args(NO_FIT)
        .args(["--rig", "rig.toml", "--out", "closed"])
        .current_dir(path);
    if rustix::process::geteuid().is_root() {
        command.uid(65_534).gid(65_534);
    }
    assert_fails(
        &command.output().unwrap(),
        1,
        "Permission denied",
        "permissions",
    );
    let with = |more: &[&str]| run(path, &[NO_FIT, more].concat());
    assert_fails(
        &with(&["--out", "file"]),
        1,
        "file: not a directory",
        "a part of this path is a file",
    );
    for name in ["Schüssel", "", "a b", ".hidden"] {
        assert_fails(
            &with(&["--sample", name]),
            1,
            "sample name",
            "choose a name such as",
        );
    }
    let odd = with(&["--out", "Größe ☃/neu"]);
    assert_done(&odd);
    assert!(session_of(path, &odd).starts_with(path.join("Größe ☃/neu")));
    let homeless = rig(path, NO_FIT)
        .env_clear()
        .args(["--out", "homeless"])
        .output()
        .unwrap();
    assert_done(&homeless);
}

#[test]
fn a_reader_that_leaves_does_not_end_a_capture() {
    let folder = workplace(|text| text);
    let mut child = rig(folder.path(), NO_FIT)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop((child.stdout.take(), child.stderr.take()));
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let root = only_session(folder.path()).unwrap();
    let found = verify::verify(&root).unwrap();
    assert!(found.is_intact() && found.complete, "{found:?}");
}

#[test]
fn one_writer_at_a_time_and_asked_twice_it_stops_in_mid_motion() {
    let folder = workplace(realistic);
    let path = folder.path();
    let (child, root) = begin(path, &["capture", "--lights", "2", "--no-fit"], |_| true);
    let name = root.to_str().unwrap();
    let busy = "is being written by another process";
    assert_fails(&run(path, &["capture", "--resume", name]), 1, busy, "wait");
    assert_fails(&run(path, &["report", name]), 1, busy, "wait");
    // It is homing by now, which takes seconds.
    let asked = Instant::now();
    let pid = Pid::from_child(&child);
    kill_process(pid, Signal::INT).unwrap();
    kill_process(pid, Signal::TERM).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(asked.elapsed() < Duration::from_secs(5));
    let code = output.status.code().unwrap();
    assert!(code == 130 || code == 143, "{code}");
    assert_fails(&output, code, "interrupted; the lamp is off", "--resume");
    assert_eq!(session_of(path, &output), root);
    let session = Session::open(&root).unwrap();
    assert_eq!(session.state(), SessionState::Interrupted);
    assert!(verify::verify(&root).unwrap().is_intact());
    assert_fails(&run(path, &["fit", name]), 1, "light 1 of", "--resume");
    let report = run(path, &["report", name]);
    assert_done(&report);
    assert!(text(&report.stderr).contains("rig fit"));
}

/// As where its terminal is closed.
#[test]
fn a_stdout_that_is_gone_hides_no_signal() {
    let folder = workplace(realistic);
    let arguments = ["capture", "--lights", "2", "--no-fit"];
    let (mut child, _) = begin(folder.path(), &arguments, |_| true);
    drop(child.stdout.take());
    kill_process(Pid::from_child(&child), Signal::HUP).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_fails(&output, 129, "interrupted; the lamp is off", "--resume");
}

#[test]
fn a_signal_during_the_fit_ends_it_and_leaves_the_capture_complete() {
    let folder = workplace(|text| text);
    let path = folder.path();
    let (child, root) = begin(path, &["capture", "--lights", "1"], Journal::is_complete);
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    let output = child.wait_with_output().unwrap();
    let name = root.file_name().unwrap().to_str().unwrap();
    assert_fails(
        &output,
        130,
        "the capture is complete",
        &format!("`rig fit sessions/{name}`"),
    );
    assert_eq!(session_of(path, &output), root);
    assert!(verify::verify(&root).unwrap().complete);
}

/// A disk of its own that has room for few files, where the system lets a
/// program mount one.
#[test]
fn a_full_disk_costs_nothing_that_was_journalled() {
    let folder = workplace(|text| text.replace("disk_reserve_mb = 200", "disk_reserve_mb = 0"));
    let path = folder.path();
    let script = r#"
        set -u
        mkdir full && mount -t tmpfs -o size=2m,nr_inodes=300 tmpfs full || exit 77
        # Another program takes all files that are left, once the first frame is there.
        (
          set --; until [ -e "${1-}" ]; do set -- full/2*/raw/*; done
          n=0; while : > full/other$n; do n=$((n + 1)); done
        ) 2> /dev/null &
        "$RIG" capture --lights 1 --no-fit --out full; echo "capture $?"
        session=$(echo full/2*)
        "$RIG" session verify "$session"; echo "verify $?"
        "$RIG" capture --no-fit --resume "$session"; echo "resume $?"
        "$RIG" camera grab --rig simulated --out full/frame.png; echo "grab $?"
        wait; ls -A full
        rm full/other*
        "$RIG" capture --no-fit --resume "$session"; echo "resume $?"
        "$RIG" session verify "$session"; echo "verify $?"
    "#;
    let output = Command::new("unshare")
        .args(["--mount", "--map-root-user", "sh", "-c", script])
        .env("RIG", env!("CARGO_BIN_EXE_rig"))
        .env_remove("RIG_CONFIG")
        .current_dir(path)
        .output()
        .unwrap();
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    if !stdout.contains("capture ") {
        // Without the right to mount, the disks of `tests/captures/run.rs` must do.
        println!("no disk can be mounted here: {stderr}");
        return;
    }
    let ends: Vec<&str> = stdout
        .lines()
        .filter(|line| {
            line.split_once(' ')
                .is_some_and(|(_, code)| code.len() == 1)
        })
        .collect();
    let expected = [
        "capture 1",
        "verify 0",
        "resume 1",
        "grab 1",
        "resume 0",
        "verify 0",
    ];
    assert_eq!(ends, expected, "{stdout}\n{stderr}");
    assert!(!stdout.contains("frame.png"), "{stdout}");
    for line in stderr.lines().filter(|line| line.starts_with("error: ")) {
        assert!(
            [
                "no more files",
                "more can be made",
                "no storage space",
                "no space left"
            ]
            .iter()
            .any(|said| line.contains(said)),
            "{line}"
        );
    }
    assert_eq!(stderr.matches("\n\nhint: ").count(), 3, "{stderr}");
    assert!(stderr.contains("`df -i` counts them"), "{stderr}");
}
