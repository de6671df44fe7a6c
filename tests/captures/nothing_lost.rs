//! What a capture has journalled stays, whatever happens to its disk; and what
//! was changed afterwards is found.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::capture_support::*;
use rig::capture::{CaptureError, Outcome, WRITE_QUEUE};
use rig::device::LampState;
use rig::random::{Purpose, stream};
use rig::session::commit::Disk;
use rig::session::faults::{Fault, FaultyDisk, UnsyncedDisk};
use rig::session::{Journal, SessionWriter, layout, verify};

/// An uninterrupted small capture: its files and the frames it took.
fn whole() -> (BTreeMap<PathBuf, Vec<u8>>, usize) {
    let parent = tempfile::tempdir().unwrap();
    let disk = Arc::new(UnsyncedDisk);
    let session = create_from(disk, parent.path(), &small_record()).unwrap();
    let root = session.root().to_owned();
    let (result, heard) = capture(&Bench::new(), session);
    assert_eq!(result.unwrap(), Outcome::Complete);
    (content(&root), heard.done.len())
}

/// Path and digest of everything in the journal that is never made again.
fn finished(root: &Path) -> Vec<(String, String)> {
    let journal = Journal::read(root).unwrap();
    let files = journal.files().into_iter();
    files
        .filter(|file| !layout::is_derived(&file.path))
        .map(|file| (file.path.clone(), file.sha256.clone()))
        .collect()
}

#[track_caller]
fn assert_kept(root: &Path, before: &[(String, String)], case: &str) {
    let now = finished(root);
    for file in before {
        assert!(now.contains(file), "{case}: {file:?} was lost or changed");
    }
}

/// A small capture on this disk: whether it came to its end, its session if it
/// made one, and the frames that were taken.
fn try_capture(disk: Arc<dyn Disk>, parent: &Path, case: &str) -> (bool, Option<PathBuf>, usize) {
    let bench = Bench::new();
    let mut frames = 0;
    let result = create_from(disk, parent, &small_record())
        .map_err(CaptureError::from)
        .and_then(|session| {
            let (result, heard) = capture(&bench, session);
            frames = heard.done.len();
            result
        });
    assert_eq!(bench.world().lamp, LampState::Off, "{case}");
    (result.is_ok(), session_in(parent), frames)
}

/// For every kind of fault at once: they wait more than they work.
fn for_each_fault(check: impl Fn(Fault) + Sync) {
    let check = &check;
    std::thread::scope(|scope| {
        for fault in Fault::ALL {
            scope.spawn(move || check(fault));
        }
    });
}

/// Every operation on the disk fails once in every way.
#[test]
fn a_fault_at_any_operation_costs_at_most_the_write_queue_and_one_frame() {
    let (expected, frames) = whole();
    for_each_fault(|fault| {
        let mut most_retaken = 0;
        for at in 0.. {
            let case = format!("{fault:?} at operation {at}");
            let parent = tempfile::tempdir().unwrap();
            let disk = Arc::new(FaultyDisk::over(Arc::new(UnsyncedDisk), at, fault));
            let (done, root, taken) = try_capture(disk.clone(), parent.path(), &case);
            if done {
                assert!(disk.operations() <= at, "{case} went unnoticed");
                assert!(at > 100, "{fault:?}: {at} operations only");
                println!(
                    "{fault:?}: {at} operations, at most {most_retaken} of {frames} frames retaken"
                );
                break;
            }
            let Some(root) = root else {
                assert_eq!(taken, 0, "{case}: frames without a session");
                continue;
            };
            let before = finished(&root);
            let again = resume(Arc::new(UnsyncedDisk), &root).done.len();
            assert_kept(&root, &before, &case);
            assert_eq!(content(&root), expected, "{case}");
            let retaken = taken + again - frames;
            assert!(
                retaken <= WRITE_QUEUE + 1,
                "{case}: {retaken} frames were taken again"
            );
            most_retaken = most_retaken.max(retaken);
        }
    });
}

/// What fails while a broken session is resumed costs nothing either.
#[test]
fn a_fault_at_any_operation_of_a_resume_is_resumed_from() {
    let (expected, _) = whole();
    for_each_fault(|fault| {
        for at in (0..).step_by(5) {
            let case = format!("{fault:?} at operation {at} of the resume");
            let parent = tempfile::tempdir().unwrap();
            // In the middle of a frame's commit, which leaves strays or a torn line.
            let torn = FaultyDisk::over(Arc::new(UnsyncedDisk), 60, Fault::ShortWrite);
            let (done, root, _) = try_capture(Arc::new(torn), parent.path(), &case);
            assert!(!done);
            let root = root.unwrap();
            let before = finished(&root);
            let disk = Arc::new(FaultyDisk::over(Arc::new(UnsyncedDisk), at, fault));
            let resumed = SessionWriter::resume(disk.clone(), &root)
                .map_err(CaptureError::from)
                .and_then(|session| capture(&Bench::new(), session).0);
            if resumed.is_ok() {
                assert!(disk.operations() <= at, "{case} went unnoticed");
                break;
            }
            assert_kept(&root, &before, &case);
            let before = finished(&root);
            resume(Arc::new(UnsyncedDisk), &root);
            assert_kept(&root, &before, &case);
            assert_eq!(content(&root), expected, "{case}");
        }
    });
}

fn every_file(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        match entry.file_type().unwrap().is_dir() {
            true => files.extend(every_file(&entry.path())),
            false => files.push(entry.path()),
        }
    }
    files.sort();
    files
}

/// Bits to flip: all of a short file, else those at both ends and at random places.
fn places(file: u64, bytes: usize) -> Vec<(usize, u8)> {
    if bytes <= 24 {
        return (0..bytes)
            .flat_map(|at| (0..8).map(move |bit| (at, bit)))
            .collect();
    }
    let mut random = stream(7, Purpose::Experiment, file, bytes as u64, 0);
    let mut below = |limit: usize| (random.uniform() * limit as f64) as usize;
    let ends = [0, 1, bytes - 2, bytes - 1];
    let inside: Vec<usize> = (0..28).map(|_| below(bytes)).collect();
    let places = ends.into_iter().chain(inside);
    places.map(|at| (at, below(8) as u8)).collect()
}

#[test]
fn a_flipped_bit_anywhere_in_a_session_is_found() {
    let parent = tempfile::tempdir().unwrap();
    let disk = Arc::new(UnsyncedDisk);
    let session = create_from(disk.clone(), parent.path(), &small_record()).unwrap();
    let root = session.root().to_owned();
    capture(&Bench::new(), session).0.unwrap();
    let mut writer = SessionWriter::open(disk, &root).unwrap();
    for (name, bytes) in [
        ("fits/1/fit.toml", &b"loss = 1.0\n"[..]),
        ("fits/1/residual_L000.png", &[7; 500]),
        (layout::REPORT_FILE, b"<html></html>"),
    ] {
        writer.commit_file(name, bytes).unwrap();
    }
    writer.refresh_manifest().unwrap();
    drop(writer);
    assert!(verify::verify(&root).unwrap().is_intact());
    let mut files = every_file(&root);
    // Empty: nothing of the session is in it.
    files.retain(|path| !path.ends_with(layout::LOCK_FILE));
    let mut flips = 0;
    for (number, path) in files.iter().enumerate() {
        let bytes = std::fs::read(path).unwrap();
        for (at, bit) in places(number as u64, bytes.len()) {
            let mut broken = bytes.clone();
            broken[at] ^= 1 << bit;
            std::fs::write(path, &broken).unwrap();
            let found = verify::verify(&root);
            assert!(
                found.map_or(true, |found| !found.is_intact()),
                "bit {bit} of byte {at} of {}",
                path.display()
            );
            flips += 1;
        }
        // So is a file that is gone, or longer, or shorter.
        for other in [None, Some(&bytes[..bytes.len() - 1])] {
            match other {
                None => std::fs::remove_file(path).unwrap(),
                Some(other) => std::fs::write(path, other).unwrap(),
            }
            let found = verify::verify(&root);
            let what = path.display();
            assert!(found.map_or(true, |found| !found.is_intact()), "{what}");
        }
        std::fs::write(path, &bytes).unwrap();
    }
    println!("{flips} flipped bits in {} files", files.len());
    assert!(files.len() > 15 && flips > 500, "{flips}, {}", files.len());
    assert!(verify::verify(&root).unwrap().is_intact());
}
