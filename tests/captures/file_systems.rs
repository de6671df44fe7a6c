//! File systems that lack something, through whole commands. The kernel refuses the calls
//! (a seccomp filter of the child), as NFS, SMB, sshfs, shared folders and FAT do.

use std::fs;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Output;

use rustix::io::Errno;
use seccompiler::{BpfProgram, SeccompAction, SeccompFilter, TargetArch};

use crate::command_support;

use command_support::{assert_done, assert_fails, only_session, rig, text, workplace};

const CAPTURE: &[&str] = &["capture", "--lights", "1", "--no-fit"];

const LOCK: &[i64] = &[libc::SYS_flock];
const SYNC: &[i64] = &[libc::SYS_fsync, libc::SYS_fdatasync];
const RENAME_NEW: &[i64] = &[libc::SYS_renameat2];
#[cfg(target_arch = "x86_64")]
const RENAME: &[i64] = &[libc::SYS_rename, libc::SYS_renameat];
#[cfg(target_arch = "aarch64")]
const RENAME: &[i64] = &[libc::SYS_renameat];

/// The program in this folder, where these calls end with this error.
fn run_where(faults: &[(&[i64], Errno)], folder: &Path, arguments: &[&str]) -> Output {
    let faults = faults.iter().map(|(calls, errno)| {
        let rules = calls.iter().map(|&call| (call, Vec::new())).collect();
        (rules, *errno)
    });
    run_with(faults.collect(), folder, arguments)
}

/// Calls, and the conditions under which they fail.
type Rules = Vec<(i64, Vec<seccompiler::SeccompRule>)>;

fn run_with(faults: Vec<(Rules, Errno)>, folder: &Path, arguments: &[&str]) -> Output {
    let arch = match cfg!(target_arch = "x86_64") {
        true => TargetArch::x86_64,
        false => TargetArch::aarch64,
    };
    let filters: Vec<BpfProgram> = faults
        .into_iter()
        .map(|(rules, errno)| {
            let fails = SeccompAction::Errno(errno.raw_os_error() as u32);
            let rules = rules.into_iter().collect();
            let filter = SeccompFilter::new(rules, SeccompAction::Allow, fails, arch).unwrap();
            filter.try_into().unwrap()
        })
        .collect();
    let mut command = rig(folder, arguments);
    // SAFETY: between fork and exec only system calls are made.
    unsafe {
        command.pre_exec(move || {
            let applied = filters
                .iter()
                .try_for_each(|f| seccompiler::apply_filter(f));
            applied.map_err(|_| std::io::ErrorKind::Unsupported.into())
        });
    }
    command.output().unwrap()
}

/// The program in this folder, where no file can be made, as on a file system that is read-only.
fn run_where_nothing_is_made(folder: &Path, arguments: &[&str]) -> Output {
    use seccompiler::{
        SeccompCmpArgLen::Dword, SeccompCmpOp::MaskedEq, SeccompCondition, SeccompRule,
    };
    let flag = libc::O_CREAT as u64;
    let condition = SeccompCondition::new(2, Dword, MaskedEq(flag), flag).unwrap();
    let rule = SeccompRule::new(vec![condition]).unwrap();
    run_with(
        vec![(vec![(libc::SYS_openat, vec![rule])], Errno::ROFS)],
        folder,
        arguments,
    )
}

/// SMB and shared folders synchronise no folder: the capture is whole, and says so once.
#[test]
fn a_capture_goes_on_where_nothing_is_synchronised() {
    for errno in [Errno::INVAL, Errno::NOTSUP] {
        let folder = workplace(|text| text);
        let output = run_where(&[(SYNC, errno)], folder.path(), CAPTURE);
        assert_done(&output);
        let said = text(&output.stderr);
        assert_eq!(said.matches("a power cut may cost").count(), 1, "{said}");
        let session = only_session(folder.path()).unwrap();
        let verified = command_support::run(
            folder.path(),
            &["session", "verify", session.to_str().unwrap()],
        );
        assert_done(&verified);
    }
}

/// What the medium itself says is no peculiarity of its file system.
#[test]
fn an_error_of_the_medium_ends_a_capture() {
    for (errno, fact, hint) in [
        (Errno::IO, "Input/output error", "see `dmesg`"),
        (
            Errno::DQUOT,
            "the disk quota is used up",
            "nothing that was journalled is lost; remove some of your files",
        ),
        (
            Errno::NOSPC,
            "no space left",
            "nothing that was journalled is lost; free some space and try again",
        ),
    ] {
        let folder = workplace(|text| text);
        let output = run_where(&[(SYNC, errno)], folder.path(), CAPTURE);
        assert_fails(&output, 1, fact, hint);
        assert!(only_session(folder.path()).is_none());
    }
}

/// NFS without its lock service, and file systems without locks: said once, and done.
/// A lock that another holds is one.
#[test]
fn a_session_is_written_where_there_are_no_locks() {
    let folder = workplace(|text| text);
    assert_done(&command_support::run(folder.path(), CAPTURE));
    let session = only_session(folder.path()).unwrap();
    let report = ["report", session.to_str().unwrap()];
    for errno in [Errno::NOLCK, Errno::BADF, Errno::NOTSUP, Errno::NOSYS] {
        let output = run_where(&[(LOCK, errno)], folder.path(), &report);
        assert_done(&output);
        let said = text(&output.stderr);
        let said_once = said.matches("warning: the file system of").count();
        assert_eq!(said_once, 1, "{said}");
        assert!(said.contains("has no locks"), "{said}");
    }
    let held = run_where(&[(LOCK, Errno::AGAIN)], folder.path(), &report);
    assert_fails(
        &held,
        1,
        "is being written by another process",
        "wait until the other",
    );
    let verify = ["session", "verify", report[1]];
    assert_done(&command_support::run(folder.path(), &verify));
}

/// An experiment that another process carries out is its own.
#[test]
fn an_experiment_has_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let run = ["evaluate", "atoms", "--quick", "--out", "ev"];
    let held = run_where(&[(LOCK, Errno::AGAIN)], folder.path(), &run);
    assert_fails(&held, 1, "ev", "wait for it, or give another --out");
}

/// Programs leave their frames in the folder for temporary files.
#[test]
fn a_folder_for_temporary_files_that_is_none_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let program = include_str!("../outside/shared/program-camera.toml");
    fs::write(folder.path().join("rig.toml"), program).unwrap();
    let grab = ["camera", "grab", "--exposure-ms", "20", "--out", "x.png"];
    let mut command = rig(folder.path(), &grab);
    let output = command.env("TMPDIR", "/no/such/folder").output().unwrap();
    assert_fails(
        &output,
        1,
        "/no/such/folder",
        "the variable TMPDIR names that folder",
    );
}

/// Where nothing can be made, the fit of a session goes elsewhere, and nothing of the session
/// changes.
#[test]
fn a_session_that_cannot_be_written_is_fitted_elsewhere() {
    let folder = workplace(|text| text);
    assert_done(&command_support::run(folder.path(), CAPTURE));
    let root = only_session(folder.path()).unwrap();
    fs::remove_file(root.join(".lock")).unwrap();
    let session = root.to_str().unwrap();
    let fit = [
        "fit",
        session,
        "--spp",
        "4",
        "--cells",
        "64",
        "--dictionary",
        "rig26",
    ];
    let output = run_where_nothing_is_made(folder.path(), &fit);
    let hint = format!("`rig fit {session} --out DIR` only reads the session");
    assert_fails(&output, 1, "Read-only file system", &hint);
    let tree = || {
        let listed = std::process::Command::new("ls")
            .args(["-lR", "--full-time", session])
            .output();
        text(&listed.unwrap().stdout)
    };
    let before = tree();
    let elsewhere = [&fit[..], &["--out", "result/fit"]].concat();
    assert_done(&command_support::run(folder.path(), &elsewhere));
    let report = [
        "report",
        session,
        "--fit",
        "result/fit",
        "--out",
        "result/report.html",
    ];
    assert_done(&command_support::run(folder.path(), &report));
    assert_eq!(tree(), before);
    let page = fs::read_to_string(folder.path().join("result/report.html")).unwrap();
    assert!(page.contains("rig26"));
    let other = workplace(|text| text);
    assert_done(&command_support::run(other.path(), CAPTURE));
    let other = only_session(other.path()).unwrap();
    let report = [
        "report",
        other.to_str().unwrap(),
        "--fit",
        "result/fit",
        "--out",
        "x.html",
    ];
    let output = command_support::run(folder.path(), &report);
    assert_fails(
        &output,
        1,
        "the fit in result/fit is none of",
        "that `rig fit SESSION --out DIR` was given",
    );
    let certificate = ["report", session, "--fit", "result/fit", "--certificate"];
    let output = command_support::run(folder.path(), &certificate);
    assert_fails(
        &output,
        1,
        "is made of a fit in its session",
        "and fit it there",
    );
}

/// What a session takes is estimated before anything moves.
#[test]
fn a_disk_that_is_too_small_is_said_before() {
    let folder = workplace(|text| {
        let line = |line: &str| match line.starts_with("disk_reserve_mb") {
            true => "disk_reserve_mb = 1000000\n".to_owned(),
            false => format!("{line}\n"),
        };
        text.lines().map(line).collect()
    });
    let output = command_support::run(folder.path(), CAPTURE);
    let hint = "free some space, choose another disk with --out";
    assert_fails(&output, 1, "has only ", hint);
    assert!(only_session(folder.path()).is_none());
}

/// The doctor tries it where sessions go, and leaves nothing there.
#[test]
fn the_doctor_names_what_is_lacking() {
    let folder = workplace(|text| text);
    let names = || {
        let entries = fs::read_dir(folder.path()).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = names();
    let doctor = |faults: &[(&[i64], Errno)]| {
        let output = run_where(faults, folder.path(), &["doctor"]);
        let said = text(&output.stdout);
        let line = said.lines().find(|line| line.contains("file system"));
        line.unwrap_or_else(|| panic!("{said}")).to_owned()
    };
    let whole = doctor(&[]);
    assert!(whole.starts_with("ok "), "{whole}");
    let lacking = doctor(&[(LOCK, Errno::NOLCK), (SYNC, Errno::INVAL)]);
    assert!(lacking.starts_with("warning"), "{lacking}");
    assert!(
        lacking.contains("has no locks") && lacking.contains("a power cut may cost"),
        "{lacking}"
    );
    let broken = doctor(&[(RENAME, Errno::IO)]);
    assert!(broken.starts_with("FAILED"), "{broken}");
    assert_eq!(names(), before);
}

/// Where a name cannot be taken in one step, it is taken first; never from another file.
#[test]
fn a_new_file_gets_its_name_alone() {
    let folder = workplace(|text| text);
    let grab = ["camera", "grab", "--exposure-ms", "5", "--out", "frame.png"];
    let first = run_where(&[(RENAME_NEW, Errno::INVAL)], folder.path(), &grab);
    assert_done(&first);
    let path = folder.path().join("frame.png");
    let bytes = fs::read(&path).unwrap();
    let again = run_where(&[(RENAME_NEW, Errno::INVAL)], folder.path(), &grab);
    assert_fails(&again, 1, "frame.png", "does not exist yet");
    assert_eq!(fs::read(&path).unwrap(), bytes);
}

/// Whatever a file system says of the file that is written comes with its own advice, and
/// what stood there stays.
#[test]
fn a_result_that_cannot_be_written_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let shape = ["shape", "bowl", "--out", "bowl.ply"];
    assert_done(&command_support::run(folder.path(), &shape));
    let bytes = fs::read(folder.path().join("bowl.ply")).unwrap();
    for (errno, fact, hint) in [
        (
            Errno::INVAL,
            "Invalid argument",
            "on FAT, exFAT and most shares leave out",
        ),
        (Errno::NAMETOOLONG, "name too long", "shorten the name"),
        (
            Errno::ROFS,
            "Read-only file system",
            "a folder that can be written",
        ),
        (
            Errno::NOSPC,
            "No space left",
            "or choose another folder with --out",
        ),
        (Errno::DQUOT, "quota", "counts), or choose another folder"),
        (
            Errno::FBIG,
            "File too large",
            "(`ulimit -f`) and the file system",
        ),
        (
            Errno::ACCESS,
            "Permission denied",
            "check who owns the file and the folder",
        ),
    ] {
        let output = run_where(&[(RENAME, errno)], folder.path(), &shape);
        assert_fails(&output, 1, fact, hint);
        assert_eq!(fs::read(folder.path().join("bowl.ply")).unwrap(), bytes);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
