//! Names inside a session, and of the session.

use std::path::{Component, Path};

use super::SessionError;
use crate::device::{FrameKey, FrameKind};

/// What was planned and with what; written once.
pub const SESSION_FILE: &str = "session.toml";
/// What happened, line by line.
pub const JOURNAL_FILE: &str = "journal.jsonl";
/// Locked by the process that adds to the session. A file that nobody reads or writes,
/// because some file systems keep every other handle from a locked one.
pub const LOCK_FILE: &str = ".lock";
/// Locked, likewise, by the job of a batch that fits the session, from its first look at the
/// fits to its last word on them; the session may be added to meanwhile.
pub const JOB_LOCK_FILE: &str = ".job.lock";
/// Raw frames and their sidecars.
pub const RAW_FOLDER: &str = "raw";
/// Copies of the calibration records that were used.
pub const CALIBRATION_FOLDER: &str = "calibration";
/// What can be made again from the raw frames.
pub const DERIVED_FOLDER: &str = "derived";
/// Where sessions go unless another folder is named, below the working folder.
pub const SESSIONS_FOLDER: &str = "sessions";
/// One numbered folder per fit.
pub const FITS_FOLDER: &str = "fits";
/// One numbered folder per validation.
pub const VALIDATIONS_FOLDER: &str = "validations";
/// The report that a person reads.
pub const REPORT_FILE: &str = "report.html";
/// SHA-256 of every journalled file, as `sha256sum -c` reads it.
pub const MANIFEST_FILE: &str = "manifest-sha256.txt";
/// Where a resume moves files that no journal record names.
pub const QUARANTINE_FOLDER: &str = "quarantine";

/// Name of a frame without extension, e.g. `L003_E02_R00_light`. Every field
/// takes as many digits as it needs.
pub fn frame_stem(key: FrameKey) -> String {
    let kind = match key.kind {
        FrameKind::Light => "light",
        FrameKind::Ambient => "ambient",
        FrameKind::Dark => "dark",
    };
    format!(
        "L{:03}_E{:02}_R{:02}_{kind}",
        key.light, key.exposure, key.repeat
    )
}

/// A frame's image, e.g. `raw/L003_E02_R00_light.png`.
pub fn image_file(key: FrameKey) -> String {
    format!("{RAW_FOLDER}/{}.png", frame_stem(key))
}

/// The merged radiance of one light direction, e.g. `derived/radiance_L003.exr`.
pub fn radiance_file(light: u32) -> String {
    format!("{DERIVED_FOLDER}/radiance_L{light:03}.exr")
}

/// Whether a sample can have this name: 1 to 64 letters, digits, dots, hyphens, underscores,
/// the first a letter or digit.
pub fn is_sample_name(name: &str) -> bool {
    let starts_well = name.starts_with(|c: char| c.is_ascii_alphanumeric());
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    starts_well && name.len() <= 64 && name.chars().all(allowed)
}

/// The sample's name in a [`session_name`]; `None` of another name.
pub fn sample_of(session: &str) -> Option<&str> {
    let (stamp, rest) = session.split_once('_')?;
    let (sample, _) = rest.rsplit_once('_')?;
    let is_stamp = stamp.len() == 16 && stamp.ends_with('Z');
    (is_stamp && is_sample_name(sample)).then_some(sample)
}

/// The session's folder name from its start (`20261121T023400Z`), the sample's
/// name and a short random id.
pub fn session_name(
    created: jiff::Timestamp,
    sample: &str,
    short_id: &str,
) -> Result<String, SessionError> {
    if !is_sample_name(sample) {
        return Err(SessionError::SampleName {
            name: sample.to_owned(),
        });
    }
    Ok(format!(
        "{}_{sample}_{short_id}",
        created.strftime("%Y%m%dT%H%M%SZ")
    ))
}

/// Whether a path from a journal stays inside its session: relative, only
/// plain names.
pub fn is_inside(path: &str) -> bool {
    !path.is_empty()
        && !path.contains('\\')
        && Path::new(path)
            .components()
            .all(|part| matches!(part, Component::Normal(_)))
}

/// Whether a file can be made again from the raw frames, so that it may be replaced.
pub fn is_derived(path: &str) -> bool {
    path == REPORT_FILE
        || path == MANIFEST_FILE
        || [DERIVED_FOLDER, FITS_FOLDER, VALIDATIONS_FOLDER]
            .iter()
            .any(|folder| {
                path.strip_prefix(folder)
                    .is_some_and(|p| p.starts_with('/'))
            })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_documentation() {
        let key = FrameKey::new(3, 2, 0, FrameKind::Light);
        assert_eq!(frame_stem(key), "L003_E02_R00_light");
        assert_eq!(radiance_file(3), "derived/radiance_L003.exr");
        let created: jiff::Timestamp = "2026-11-21T02:34:00Z".parse().unwrap();
        assert_eq!(
            session_name(created, "red-plastic", "0f3a9c").unwrap(),
            "20261121T023400Z_red-plastic_0f3a9c"
        );
        let name = session_name(created, "red_plastic", "0f3a9c").unwrap();
        assert_eq!(sample_of(&name), Some("red_plastic"));
        for other in ["cup", "20261121T023400Z_cup", "a_b_c", "_cup_"] {
            assert_eq!(sample_of(other), None, "{other}");
        }
    }

    #[test]
    fn names_that_would_leave_the_folder_are_refused() {
        let created = jiff::Timestamp::UNIX_EPOCH;
        for name in ["", "..", "a/b", ".hidden", "ü", "a b", &"x".repeat(65)] {
            assert!(session_name(created, name, "0").is_err(), "{name:?}");
        }
        for path in ["", "/etc/passwd", "../x", "raw/../../x", "a\\b", "./x"] {
            assert!(!is_inside(path), "{path:?}");
        }
        assert!(is_inside("raw/L000_E00_R00_light.png"));
        assert!(is_derived("fits/1/fit.toml") && is_derived("validations/0/light_L001.png"));
        assert!(!is_derived("fitsomething"));
    }
}
