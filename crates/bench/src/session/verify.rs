//! Checks every byte of a session against its journal, and finds what the
//! journal does not know.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Serialize, Serializer};

use super::journal::{Event, Journal};
pub use super::journalled::check;
use super::layout::{
    self, JOB_LOCK_FILE, JOURNAL_FILE, LOCK_FILE, QUARANTINE_FOLDER, SESSION_FILE,
};
use super::{Session, SessionError, journalled};
use crate::shown::nth;
use crate::units::StageAngles;

/// What a check of a session found.
#[derive(Debug)]
pub struct Verification {
    /// Whether the capture ran to its end.
    pub complete: bool,
    /// Journalled files that hold what they should.
    pub good_files: usize,
    /// Their bytes.
    pub good_bytes: u64,
    /// Journalled files that are gone or hold something else, links in place of the
    /// session's own files, and records that contradict each other or the plan.
    pub problems: Vec<SessionError>,
    /// Files that no record names, relative to the session.
    pub strays: Vec<PathBuf>,
    /// Bytes after the journal's last whole line.
    pub torn_bytes: u64,
    /// Why the frames may not be what they claim to be although every byte is
    /// the one that was written.
    pub suspicion: Option<String>,
    /// Why the session's times are not one clock's.
    pub clock_step: Option<String>,
}

impl Verification {
    /// Nothing is wrong: every journalled file holds what it should, there is
    /// no stray and no torn line. An interrupted session can be intact.
    pub fn is_intact(&self) -> bool {
        self.problems.is_empty() && self.strays.is_empty() && self.torn_bytes == 0
    }
}

impl Verification {
    /// As a machine reads it, of the session or archive at this path.
    pub fn stated_of(&self, session: &Path) -> serde_json::Value {
        let problems = self.problems.iter().map(ToString::to_string);
        let strays = self.strays.iter().map(|stray| stray.to_string_lossy());
        serde_json::json!({
            "session": session.to_string_lossy(),
            "intact": self.is_intact(),
            "complete": self.complete,
            "files": self.good_files,
            "bytes": self.good_bytes,
            "problems": problems.collect::<Vec<_>>(),
            "strays": strays.collect::<Vec<_>>(),
            "torn_bytes": self.torn_bytes,
            "suspect": self.suspicion,
            "clock_step": self.clock_step,
        })
    }

    /// A line for each finding, and one for what is good.
    pub fn lines(&self) -> Vec<String> {
        let mut lines: Vec<_> = (self.problems.iter())
            .map(|problem| format!("damaged  {problem}"))
            .collect();
        let strays = self.strays.iter().map(|stray| stray.display());
        lines.extend(strays.map(|stray| format!("stray    {stray} is in no journal record")));
        if self.torn_bytes > 0 {
            let bytes = self.torn_bytes;
            lines.push(format!(
                "torn     the journal ends in {bytes} bytes of an unfinished line"
            ));
        }
        lines.extend(self.suspicion.iter().map(|what| format!("suspect  {what}")));
        lines.extend(
            self.clock_step
                .iter()
                .map(|what| format!("times    {what}")),
        );
        let state = match self.complete {
            true => "complete",
            false => "interrupted",
        };
        let (files, bytes) = (self.good_files, self.good_bytes);
        lines.push(format!("{state}, {files} files, {bytes} bytes good"));
        lines
    }
}

/// How far a light of a session is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct LightState {
    /// Index in the plan.
    pub light: u32,
    #[serde(flatten)]
    pub angles: StageAngles,
    /// Frames journalled.
    pub frames: usize,
    pub finished: bool,
}

impl Session {
    /// The lights of the plan, and how far each is.
    pub fn lights(&self) -> impl Iterator<Item = LightState> {
        let lights = self.record().plan.lights.iter().zip(0..);
        lights.map(|(&angles, light)| LightState {
            light,
            angles,
            frames: self.frames().filter(|f| f.key.light == light).count(),
            finished: self.light_is_finished(light),
        })
    }
}

/// Checks the session in `root`.
///
/// # Errors
/// Only where the journal itself cannot be trusted; everything else is in the
/// [`Verification`].
pub fn verify(root: &Path) -> Result<Verification, SessionError> {
    let journal = Journal::read(root)?;
    let mut found = Verification {
        complete: journal.is_complete(),
        good_files: 0,
        good_bytes: 0,
        problems: journalled::misplaced(root, &journal),
        strays: strays(root, &journal)?,
        torn_bytes: journal.torn_bytes,
        suspicion: journal.suspicion(),
        clock_step: journal.clock_step(),
    };
    for file in journal.files() {
        match journalled::check(root, file) {
            Ok(()) => {
                found.good_files += 1;
                found.good_bytes = found.good_bytes.saturating_add(file.bytes);
            }
            Err(problem) => found.problems.push(problem),
        }
    }
    match Session::open(root) {
        Ok(session) => found.problems.extend(contradictions(&session)),
        // Damage was found above.
        Err(problem) if problem.damaged_file().is_some() => {}
        Err(problem) => found.problems.push(problem),
    }
    Ok(found)
}

/// Records whose checksums are right and that cannot all be true.
pub(super) fn contradictions(session: &Session) -> Vec<SessionError> {
    let lights = session.record().plan.lights.len() as u32;
    let wrong = |line: usize, why: String| SessionError::CorruptJournal {
        path: session.root().join(JOURNAL_FILE),
        line,
        why,
    };
    let mut frames = HashSet::new();
    let mut is_stopped = false;
    let mut found = Vec::new();
    // They are journalled before the session has its name: a resume must not take them for strays.
    for copy in &session.record().calibration {
        if !session.vouches_for(&copy.file) {
            let why = format!("{}, which {SESSION_FILE} names, is in no record", copy.file);
            found.push(wrong(session.journal().records.len(), why));
        }
    }
    for (index, record) in session.journal().records.iter().enumerate() {
        let light = match &record.event {
            Event::Frame { key, .. } => Some(key.light),
            Event::LightStart { light, .. }
            | Event::LightStop { light }
            | Event::Warning { light, .. } => Some(*light),
            _ => None,
        };
        let why = match &record.event {
            _ if light.is_some_and(|light| light >= lights) => format!(
                "a record of {}, and the plan has {lights} lights",
                nth("light", light.unwrap_or_default())
            ),
            Event::Frame { key, .. } if !frames.insert(*key) => {
                format!("frame {} a second time", layout::frame_stem(*key))
            }
            Event::Stop if is_stopped => "a second stop".to_owned(),
            Event::Stop if frames.is_empty() && lights > 0 => {
                is_stopped = true;
                "a stop before any frame".to_owned()
            }
            event => {
                match event {
                    Event::Stop => is_stopped = true,
                    // A resume of a complete session makes derived files again.
                    Event::Resume { .. } => is_stopped = false,
                    _ => {}
                }
                continue;
            }
        };
        found.push(wrong(index + 1, why));
    }
    found
}

/// Files below `root` that no record names, relative to it, sorted. Folders
/// don't count, nor what is in quarantine already, nor a link that stands where a file or
/// folder of the session belongs: what it leads to may be the session's own.
pub fn strays(root: &Path, journal: &Journal) -> Result<Vec<PathBuf>, SessionError> {
    let known: HashSet<PathBuf> = journal
        .files()
        .iter()
        .map(|file| PathBuf::from(&file.path))
        .chain([JOURNAL_FILE, LOCK_FILE, JOB_LOCK_FILE].map(PathBuf::from))
        .collect();
    let own = journalled::own_names(journal);
    let mut strays = Vec::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(folder) = folders.pop() {
        let path = root.join(&folder);
        let read = |e| SessionError::io("list", &path, e);
        for entry in fs::read_dir(&path).map_err(read)? {
            let entry = entry.map_err(read)?;
            let relative = folder.join(entry.file_name());
            let file_type = entry.file_type().map_err(read)?;
            if relative == Path::new(QUARANTINE_FOLDER) {
                continue;
            }
            if file_type.is_dir() {
                folders.push(relative);
            } else if !known.contains(&relative)
                && (!file_type.is_symlink() || !own.contains(&relative))
            {
                strays.push(relative);
            }
        }
    }
    strays.sort();
    Ok(strays)
}

/// A session in short.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Its folder; serialised with U+FFFD for bytes that are no UTF-8.
    #[serde(serialize_with = "as_text")]
    pub session: PathBuf,
    /// The sample's name.
    pub sample: String,
    /// Start, RFC 3339, UTC.
    pub created_utc: String,
    /// Whether any device was a simulated one.
    pub simulated: bool,
    /// Whether the capture ran to its end.
    pub complete: bool,
    /// Light directions planned.
    pub lights_planned: usize,
    /// Light directions whose frames are all journalled.
    pub lights_finished: usize,
    /// Frames journalled.
    pub frames: usize,
    /// Whether the stage was found to have lost steps.
    pub suspect: bool,
    /// Whether its times are not one clock's.
    pub clock_step: bool,
}

fn as_text<S: Serializer>(path: &Path, out: S) -> Result<S::Ok, S::Error> {
    out.serialize_str(&path.to_string_lossy())
}
