//! What scripts and shells rely on, beyond any single command.

use std::io::Read;
use std::process::{Command, Stdio};

use rig::cli::exit::Exit;
use rig::session::example;

fn rig() -> Command {
    Command::new(assert_cmd::cargo::cargo_bin("rig"))
}

/// `rig … | head -c 1` ends quietly.
#[test]
fn a_closed_stdout_ends_quietly() {
    let mut child = rig()
        .args(["completions", "bash"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let mut stderr = String::new();
    child
        .stderr
        .take()
        .unwrap()
        .read_to_string(&mut stderr)
        .unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0), "{stderr}");
    assert_eq!(stderr, "");
}

/// Data that cannot be delivered is a failure, unlike a reader that has enough.
#[test]
fn a_full_stdout_is_an_error_with_a_hint() {
    let full = std::fs::File::options().write(true).open("/dev/full");
    let output = rig()
        .args(["completions", "bash"])
        .stdout(full.unwrap())
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let lines: Vec<_> = stderr.lines().collect();
    assert!(lines[0].starts_with("error: stdout: No space left on device"));
    assert!(
        lines[1].is_empty() && lines[2].starts_with("hint: "),
        "{stderr}"
    );
    assert_eq!(lines.len(), 3, "{stderr}");
}

/// Wrong usage is one fact and one hint; an option of another command leads there.
#[test]
fn usage_errors_are_one_fact_and_one_hint() {
    for (words, said) in [
        (
            "completions bsh",
            "error: invalid value 'bsh' for '<SHELL>' [possible values: bash, elvish, fish, powershell, zsh]\n\n\
             hint: a similar value exists: 'bash'; `rig completions --help` explains the arguments\n",
        ),
        (
            "man",
            "error: the following required arguments were not provided: --out <DIR>\n\n\
             hint: `rig man --help` explains the arguments\n",
        ),
        (
            "batch run x --fail-on y",
            "error: unexpected argument '--fail-on' found\n\n\
             hint: --fail-on is of `rig batch` and `rig batch collect`; `rig batch run --help` explains the arguments\n",
        ),
        (
            "merge --certificate",
            "error: unexpected argument '--certificate' found\n\n\
             hint: --certificate is of `rig report`; `rig merge --help` explains the arguments\n",
        ),
        (
            "fit --certificate", // much like --uncertainty
            "error: unexpected argument '--certificate' found\n\n\
             hint: --certificate is of `rig report`; `rig fit --help` explains the arguments\n",
        ),
    ] {
        let output = rig().args(words.split(' ')).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stderr), said);
    }
}

/// What cannot be a filter is said; the command runs all the same.
#[test]
fn a_wrong_rust_log_is_warned_of() {
    let show = |filter| {
        let mut check = rig();
        check.args(["brdf", "check", "lambertian:1"]);
        let output = check.env("RUST_LOG", filter).output().unwrap();
        assert_eq!(output.status.code(), Some(0));
        String::from_utf8(output.stderr).unwrap()
    };
    assert_eq!(show(""), "");
    assert_eq!(show("rig=warn,off"), "");
    assert!(show("rig==x").contains("RUST_LOG is \"rig==x\", no filter such as"));
}

#[test]
fn help_version_completions_and_man_pages() {
    for args in [&["--help"][..], &["--version"], &["doctor", "--help"]] {
        let output = rig().args(args).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{args:?}");
        assert!(
            !output.stdout.is_empty() && output.stderr.is_empty(),
            "{args:?}"
        );
    }
    for shell in ["bash", "zsh", "fish"] {
        let output = rig().args(["completions", shell]).output().unwrap();
        let script = String::from_utf8(output.stdout).unwrap();
        assert!(script.contains("doctor"), "{shell}");
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("man");
    let output = rig().arg("man").arg("--out").arg(&out).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let page = std::fs::read_to_string(out.join("rig-doctor.1")).unwrap();
    assert!(page.contains("permissions"), "{page}");
}

/// Colour is only for terminals, unless asked for.
#[test]
fn color_is_asked_for() {
    let errors = |color: &[&str]| {
        let output = rig()
            .args(["doctor", "--rig", "x"])
            .args(color)
            .output()
            .unwrap();
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(errors(&[]).starts_with("error: "));
    assert!(errors(&["--color", "never"]).starts_with("error: "));
    assert!(errors(&["--color", "always"]).starts_with("\x1b[1;31merror:\x1b[0m "));
}

/// The body of [`a_panic_is_one_line_and_exit_code_2`], run in a process of its own.
#[test]
fn panics_when_asked() {
    if std::env::var_os("RIG_TEST_PANIC").is_some() {
        let exit = rig::cli::guarded(|| -> Exit { panic!("the lamp is\nan orange") });
        std::process::exit(exit.code().into());
    }
}

#[test]
fn a_panic_is_one_line_and_exit_code_2() {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "command_line::panics_when_asked", "--nocapture"])
        .env("RIG_TEST_PANIC", "1")
        .env_remove("RUST_BACKTRACE")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let stderr = String::from_utf8(output.stderr).unwrap();
    let lines: Vec<_> = stderr.lines().collect();
    assert_eq!(lines.len(), 3, "{stderr}");
    assert!(
        lines[0]
            .starts_with("internal error: the lamp is an orange (tests/commands/command_line.rs:")
    );
    assert!(lines[2].starts_with("hint: ") && lines[2].contains("report"));
}

/// A session travels as one file, which is verified, and comes back as it was.
#[test]
fn a_session_is_packed_and_unpacked() {
    let home = tempfile::tempdir().unwrap();
    let name = example::session(home.path(), "bowl", "2026-11-21T02:34:00Z");
    example::add_fit(home.path(), &name, &example::fit());
    std::fs::write(home.path().join(&name).join("note.txt"), "mine").unwrap();
    let run = |words: &[&str]| {
        let mut command = assert_cmd::Command::cargo_bin("rig").unwrap();
        let output = command
            .current_dir(&home)
            .args(["session"])
            .args(words)
            .output()
            .unwrap();
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        (text(&output.stdout), text(&output.stderr))
    };
    let (packed, said) = run(&["pack", &name]);
    assert_eq!(packed, format!("{name}.tar\n"), "{said}");
    assert!(said.contains("note.txt left out"), "{said}");
    let tar = format!("{name}.tar");
    assert!(run(&["verify", &tar]).0.starts_with("interrupted, "));
    assert_eq!(run(&["unpack", &tar, "--out", "copy"]).0, "copy\n");
    assert_eq!(run(&["verify", "copy"]), run(&["verify", &tar]));
    std::fs::write(home.path().join("bad.tar"), "no archive").unwrap();
    let inside = format!("copy/{tar}");
    let cases = [
        (
            &["unpack", &tar, "--out", "copy"][..],
            "choose another folder or name",
        ),
        (
            &["unpack", "bad.tar"],
            "let `rig session pack` make it anew",
        ),
        (
            &["pack", "copy", "--out", &inside],
            "choose a place outside the session",
        ),
    ];
    for (words, hint) in cases {
        let said = run(words).1;
        assert!(said.contains(hint), "{words:?}: {said}");
    }
    assert!(!home.path().join("bad").exists());
}
