//! Sessions that are written, broken and resumed.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::checksum::sha256_hex;
use crate::device::*;
use crate::session::commit::SystemDisk;
use crate::session::faults::{Fault, FaultyDisk, UnsyncedDisk};
use crate::session::journal::Event;
use crate::session::verify::verify;
use crate::session::*;
use crate::units::Seconds;

fn create(disk: Arc<dyn commit::Disk>, parent: &Path) -> Result<SessionWriter, SessionError> {
    SessionWriter::create(
        disk,
        &NewSession {
            parent,
            created: jiff::Timestamp::UNIX_EPOCH,
            short_id: "0f3a9c",
            record: &example::record(),
            calibration: &[("sensor.toml".into(), b"gain = 1".to_vec())],
        },
    )
}

fn frame(repeat: u32) -> (RawFrame, Sidecar) {
    let settings = CameraSettings::new(Seconds(0.001), 1.0);
    let raw = RawFrame::new(4, 3, (0..12).map(|i| i * 100 + repeat as u16).collect());
    let key = FrameKey::new(0, 1, repeat, FrameKind::Light);
    let sidecar = Sidecar {
        camera_serial: "s".into(),
        frames_discarded: 2,
        ..Sidecar::of_frame(key, LampState::On(LampChannel(0)), settings)
    };
    (raw, sidecar)
}

/// Adds what is missing of three frames and finishes.
fn capture(writer: &mut SessionWriter) -> Result<(), SessionError> {
    for repeat in 0..3 {
        let (raw, sidecar) = frame(repeat);
        match writer.commit_frame(&raw, &sidecar) {
            Ok(()) | Err(SessionError::FrameTaken { .. }) => {}
            Err(e) => return Err(e),
        }
    }
    writer.commit_file("derived/radiance_L000.exr", b"radiance")?;
    writer.finish()
}

fn only_session(parent: &Path) -> Option<PathBuf> {
    let mut all: Vec<_> = fs::read_dir(parent)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| !path.file_name().unwrap().to_str().unwrap().starts_with('.'))
        .collect();
    assert!(all.len() <= 1);
    all.pop()
}

#[test]
fn what_is_committed_is_read_and_verified() {
    let parent = tempfile::tempdir().unwrap();
    let mut writer = create(Arc::new(SystemDisk), parent.path()).unwrap();
    let root = writer.root().to_owned();
    assert_eq!(root.file_name().unwrap(), "19700101T000000Z_bowl_0f3a9c");
    capture(&mut writer).unwrap();
    drop(writer);

    let session = Session::open(&root).unwrap();
    assert_eq!(session.record(), &example::record());
    assert_eq!(session.state(), SessionState::Complete);
    let entries: Vec<_> = session.frames().collect();
    assert_eq!(entries.len(), 3);
    let (raw, sidecar) = session.read_frame(&entries[2]).unwrap();
    assert_eq!((raw.counts, sidecar), (frame(2).0.counts, frame(2).1));
    assert_eq!(
        session.read_file("calibration/sensor.toml").unwrap(),
        b"gain = 1"
    );

    let found = verify(&root).unwrap();
    assert!(found.is_intact() && found.complete, "{found:?}");
    let manifest = fs::read_to_string(root.join("manifest-sha256.txt")).unwrap();
    for line in manifest.lines() {
        let (sha256, path) = line.split_once("  ").unwrap();
        assert_eq!(
            sha256,
            sha256_hex(&fs::read(root.join(path)).unwrap()),
            "{path}"
        );
    }
    assert_eq!(manifest.lines().count(), 9);
}

/// A file that is handed out open was checked as one whose bytes are.
#[test]
fn a_file_to_be_read_in_pieces_is_checked_first() {
    use std::io::Read;
    let parent = tempfile::tempdir().unwrap();
    let mut writer = create(Arc::new(SystemDisk), parent.path()).unwrap();
    let name = "derived/radiance_L000.exr";
    let whole: Vec<u8> = (0..300_000u32).map(|n| n as u8).collect();
    writer.commit_file(name, &whole).unwrap();
    let session = Session::open(writer.root()).unwrap();
    let path = session.root().join(name);
    let mut read = Vec::new();
    session
        .open_file(name)
        .unwrap()
        .read_to_end(&mut read)
        .unwrap();
    assert!(read == whole, "from its beginning to its end");
    let mut other = whole.clone();
    other[200_000] ^= 4;
    for bytes in [
        &whole[..whole.len() - 1],
        &other,
        &[whole.as_slice(), b"x"].concat(),
    ] {
        fs::write(&path, bytes).unwrap();
        let expected = session.read_file(name).unwrap_err().to_string();
        assert_eq!(session.open_file(name).unwrap_err().to_string(), expected);
    }
    fs::remove_file(&path).unwrap();
    let missing = session.open_file(name).unwrap_err();
    assert!(matches!(missing, SessionError::Missing { .. }), "{missing}");
}

#[test]
fn an_existing_session_and_a_second_writer_are_refused() {
    let parent = tempfile::tempdir().unwrap();
    let writer = create(Arc::new(SystemDisk), parent.path()).unwrap();
    assert!(matches!(
        create(Arc::new(SystemDisk), parent.path()),
        Err(SessionError::Exists { .. })
    ));
    assert!(matches!(
        SessionWriter::resume(Arc::new(SystemDisk), writer.root()),
        Err(SessionError::Locked { .. })
    ));
}

#[test]
fn every_flipped_bit_is_detected() {
    let parent = tempfile::tempdir().unwrap();
    let mut writer = create(Arc::new(SystemDisk), parent.path()).unwrap();
    capture(&mut writer).unwrap();
    let root = writer.root().to_owned();
    drop(writer);
    let mut files: Vec<String> = Journal::read(&root)
        .unwrap()
        .files()
        .iter()
        .map(|f| f.path.clone())
        .collect();
    files.push("journal.jsonl".into());
    for file in files {
        let path = root.join(&file);
        let bytes = fs::read(&path).unwrap();
        for at in [0, bytes.len() / 3, bytes.len() / 2, bytes.len() - 1] {
            let mut broken = bytes.clone();
            broken[at] ^= 1 << (at % 8);
            fs::write(&path, &broken).unwrap();
            assert!(
                verify(&root).map_or(true, |found| !found.is_intact()),
                "byte {at} of {file}"
            );
        }
        fs::write(&path, &bytes).unwrap();
    }
    assert!(verify(&root).unwrap().is_intact());
}

#[test]
fn a_broken_raw_frame_stops_a_resume_and_a_broken_derived_file_is_set_aside() {
    let parent = tempfile::tempdir().unwrap();
    let mut writer = create(Arc::new(SystemDisk), parent.path()).unwrap();
    let (raw, sidecar) = frame(0);
    writer.commit_frame(&raw, &sidecar).unwrap();
    writer
        .commit_file("derived/radiance_L000.exr", b"radiance")
        .unwrap();
    let root = writer.root().to_owned();
    drop(writer);

    fs::write(root.join("derived/radiance_L000.exr"), b"other").unwrap();
    fs::write(root.join("raw/.L000_E01_R01_light.png.part"), b"half").unwrap();
    let writer = SessionWriter::resume(Arc::new(SystemDisk), &root).unwrap();
    assert_eq!(
        writer.journal().records.last().unwrap().event,
        Event::Resume { quarantined: 2 }
    );
    drop(writer);
    assert!(root.join("quarantine/1/derived/radiance_L000.exr").exists());
    assert!(
        root.join("quarantine/1/raw/.L000_E01_R01_light.png.part")
            .exists()
    );

    fs::write(root.join("raw/L000_E01_R00_light.png"), b"other").unwrap();
    assert!(matches!(
        SessionWriter::resume(Arc::new(SystemDisk), &root),
        Err(SessionError::Length { .. })
    ));
}

/// Every operation of a whole session fails once in every way: either there is
/// no session yet, or it resumes and then holds the same files.
#[test]
fn a_fault_at_any_write_leaves_a_session_that_resumes() {
    for fault in Fault::ALL {
        for at in 0.. {
            let parent = tempfile::tempdir().unwrap();
            let disk = Arc::new(FaultyDisk::over(Arc::new(UnsyncedDisk), at, fault));
            let first = create(disk.clone(), parent.path()).and_then(|mut w| capture(&mut w));
            if first.is_ok() {
                assert!(disk.operations() <= at, "{fault:?} at {at} went unnoticed");
                break;
            }
            let mut writer = match only_session(parent.path()) {
                None => create(Arc::new(UnsyncedDisk), parent.path()),
                Some(root) => SessionWriter::resume(Arc::new(UnsyncedDisk), &root),
            }
            .unwrap_or_else(|e| panic!("{fault:?} at {at}: {e}"));
            capture(&mut writer).unwrap_or_else(|e| panic!("{fault:?} at {at}: {e}"));
            let found = verify(writer.root()).unwrap();
            assert!(
                found.is_intact() && found.complete,
                "{fault:?} at {at}: {found:?}"
            );
            let session = Session::open(writer.root()).unwrap();
            for (repeat, entry) in session.frames().enumerate() {
                let (raw, sidecar) = session.read_frame(&entry).unwrap();
                assert_eq!(
                    (raw.counts, sidecar),
                    (frame(repeat as u32).0.counts, frame(repeat as u32).1)
                );
            }
        }
    }
}
