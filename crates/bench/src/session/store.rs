//! A session opened for reading, and one opened for adding to.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::SessionError;
use super::commit::{self, Disk, Replace};
use super::frame::{self, Sidecar};
use super::journal::{self, Event, FORMAT, FileDigest, Journal, Record};
use super::journalled;
use super::layout::{self, CALIBRATION_FOLDER, JOURNAL_FILE, MANIFEST_FILE, SESSION_FILE};
use super::record::SessionRecord;
use super::verify::{self, Summary};
use crate::device::{FrameKey, RawFrame};
use crate::file_system::{self, PART};
use crate::outside_file::never_waiting;
use crate::whole_file;

/// A rig file has at most 256 KiB, and a light takes about 60 bytes.
pub const LARGEST_RECORD_BYTES: u64 = 4 << 20;

/// Whether a capture ran to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionState {
    /// It has a stop record.
    Complete,
    /// It has none: it can be resumed.
    Interrupted,
}

/// A journalled frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEntry {
    /// Its place in the plan.
    pub key: FrameKey,
    /// 16-bit PNG.
    pub image: FileDigest,
    /// How it was taken.
    pub sidecar: FileDigest,
}

/// A session as its journal and `session.toml` tell it.
#[derive(Clone, Debug)]
pub struct Session {
    root: PathBuf,
    record: SessionRecord,
    journal: Journal,
}

impl Session {
    /// Reads the journal, checks `session.toml` against it and parses that.
    /// The other files are checked as they are read.
    pub fn open(root: &Path) -> Result<Self, SessionError> {
        let journal = Journal::read(root)?;
        let Some(Event::Start { session, .. }) = journal.records.first().map(|r| &r.event) else {
            return Err(SessionError::NotASession {
                path: root.to_owned(),
                why: "its journal has no start".into(),
            });
        };
        let path = root.join(&session.path);
        let bytes = journalled::read_within(root, session, LARGEST_RECORD_BYTES)?;
        let text = str::from_utf8(&bytes).map_err(|e| SessionError::malformed(&path, e))?;
        let mut record: SessionRecord =
            toml::from_str(text).map_err(|e| SessionError::malformed(&path, e))?;
        record.check(&path)?;
        let chosen = journal.decisions().filter_map(|decision| decision.next());
        record.plan.lights.extend(chosen);
        Ok(Self {
            root: root.to_owned(),
            record,
            journal,
        })
    }

    /// The session's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// `session.toml`, its plan with the lights that were chosen since.
    pub fn record(&self) -> &SessionRecord {
        &self.record
    }

    /// What happened.
    pub fn journal(&self) -> &Journal {
        &self.journal
    }

    /// Whether the capture ran to its end.
    pub fn state(&self) -> SessionState {
        if self.journal.is_complete() {
            SessionState::Complete
        } else {
            SessionState::Interrupted
        }
    }

    /// The journalled frames, in the order in which they were taken.
    pub fn frames(&self) -> impl Iterator<Item = FrameEntry> + '_ {
        self.journal.records.iter().filter_map(|r| match &r.event {
            Event::Frame {
                key,
                image,
                sidecar,
            } => Some(FrameEntry {
                key: *key,
                image: image.clone(),
                sidecar: sidecar.clone(),
            }),
            _ => None,
        })
    }

    /// Whether all frames of a light direction are journalled.
    pub fn light_is_finished(&self, light: u32) -> bool {
        self.journal
            .records
            .iter()
            .any(|r| r.event == Event::LightStop { light })
    }

    /// A frame's counts and sidecar, checked against the journal.
    pub fn read_frame(&self, entry: &FrameEntry) -> Result<(RawFrame, Sidecar), SessionError> {
        let image_path = self.root.join(&entry.image.path);
        let png = journalled::read(&self.root, &entry.image)?;
        let counts =
            frame::decode_png(&png).map_err(|why| SessionError::malformed(&image_path, why))?;
        let sidecar_path = self.root.join(&entry.sidecar.path);
        let text = journalled::read(&self.root, &entry.sidecar)?;
        let text = str::from_utf8(&text).map_err(|e| SessionError::malformed(&sidecar_path, e))?;
        let sidecar: Sidecar =
            toml::from_str(text).map_err(|e| SessionError::malformed(&sidecar_path, e))?;
        if sidecar.key != entry.key {
            return Err(SessionError::malformed(
                &sidecar_path,
                format!(
                    "it describes {:?}, the journal records {:?}",
                    sidecar.key, entry.key
                ),
            ));
        }
        Ok((counts, sidecar))
    }

    /// The bytes of a journalled file (a calibration copy, a record), checked against
    /// the journal.
    pub fn read_file(&self, relative: &str) -> Result<Vec<u8>, SessionError> {
        journalled::read(&self.root, self.journalled(relative)?)
    }

    /// Likewise of a file of at most so many bytes.
    ///
    /// # Errors
    /// Likewise; a longer file, of which nothing is read.
    pub fn read_file_within(
        &self,
        relative: &str,
        largest_bytes: u64,
    ) -> Result<Vec<u8>, SessionError> {
        journalled::read_within(&self.root, self.journalled(relative)?, largest_bytes)
    }

    /// A journalled file of any length (merged radiance), checked against the journal piece
    /// by piece and then open at its beginning.
    ///
    /// # Errors
    /// As [`read_file`](Self::read_file), with nothing of the file in memory.
    pub fn open_file(&self, relative: &str) -> Result<File, SessionError> {
        journalled::open(&self.root, self.journalled(relative)?)
    }

    fn journalled(&self, relative: &str) -> Result<&FileDigest, SessionError> {
        let mut files = self.journal.files().into_iter();
        match files.find(|file| file.path == relative) {
            Some(file) => Ok(file),
            None if let Some(light) = self.not_captured(relative) => Err(light),
            None => Err(SessionError::Missing {
                path: self.root.join(relative),
            }),
        }
    }

    /// Why a light of an interrupted session has no merged image.
    fn not_captured(&self, relative: &str) -> Option<SessionError> {
        if self.journal.is_complete() {
            return None;
        }
        let planned = self.record.plan.lights.len();
        let light = (0..planned as u32).find(|&n| layout::radiance_file(n) == relative)?;
        let reason = self
            .journal
            .records
            .iter()
            .rev()
            .find_map(|r| match &r.event {
                Event::Interrupted { reason } => Some(reason.clone()),
                _ => None,
            });
        Some(SessionError::NotCaptured {
            path: self.root.clone(),
            light,
            finished: self.summary().lights_finished,
            planned,
            reason: reason.unwrap_or_else(|| "without a word: killed, or a power cut".to_owned()),
        })
    }

    /// Whether the journal names a file of this path.
    pub fn vouches_for(&self, relative: &str) -> bool {
        self.journal.files().iter().any(|f| f.path == relative)
    }

    /// One line for a list.
    pub fn summary(&self) -> Summary {
        let lights = self.record.plan.lights.len();
        Summary {
            session: self.root.clone(),
            sample: self.record.sample.clone(),
            created_utc: self.record.created_utc.clone(),
            simulated: self.record.simulated,
            complete: self.state() == SessionState::Complete,
            lights_planned: lights,
            lights_finished: (0..lights)
                .filter(|&l| self.light_is_finished(l as u32))
                .count(),
            frames: self.frames().count(),
            suspect: self.journal().steps_lost().is_some(),
            clock_step: self.journal().clock_step().is_some(),
        }
    }
}

/// What a session begins with.
pub struct NewSession<'a> {
    /// The folder that receives the session's folder; made if missing.
    pub parent: &'a Path,
    /// Time in the session's name.
    pub created: jiff::Timestamp,
    /// Keeps apart sessions of one second; letters and digits.
    pub short_id: &'a str,
    /// Becomes `session.toml`.
    pub record: &'a SessionRecord,
    /// File names and contents for `calibration/`.
    pub calibration: &'a [(String, Vec<u8>)],
}

/// The one process that may add to a session.
pub struct SessionWriter {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    journal: Journal,
    /// The journal may hold a torn line, because the last append failed.
    torn: bool,
    /// Held locked as long as the writer lives; while the session is being made, its folder.
    _lock: Option<File>,
}

impl SessionWriter {
    /// Makes a session: everything up to the start record is written in a hidden
    /// folder next to it, which then gets the session's name. A failure leaves
    /// no session.
    ///
    /// # Errors
    /// [`SessionError::Exists`] where the folder exists.
    pub fn create(disk: Arc<dyn Disk>, new: &NewSession<'_>) -> Result<Self, SessionError> {
        let name = layout::session_name(new.created, &new.record.sample, new.short_id)?;
        let root = new.parent.join(&name);
        if root.symlink_metadata().is_ok() {
            return Err(SessionError::Exists { path: root });
        }
        commit::create_dirs(&*disk, new.parent)?;
        whole_file::clear_once(new.parent);
        let hidden = new.parent.join(format!(".{name}{PART}"));
        let made = Self::create_hidden(Arc::clone(&disk), &hidden, new).and_then(|mut writer| {
            // Some file systems rename no folder that is open, or in which a file is.
            writer._lock = None;
            disk.rename(&hidden, &root)
                .map_err(|e| SessionError::io("rename to", &root, e))?;
            writer._lock = Some(lock(&root, layout::LOCK_FILE)?);
            writer.root = root;
            commit::sync_dir(&*disk, new.parent)?;
            Ok(writer)
        });
        if made.is_err() {
            // Best effort: a hidden folder that stays behind is cleared later.
            drop(fs::remove_dir_all(&hidden));
        }
        made
    }

    fn create_hidden(
        disk: Arc<dyn Disk>,
        hidden: &Path,
        new: &NewSession<'_>,
    ) -> Result<Self, SessionError> {
        disk.create_dir(hidden)
            .map_err(|e| SessionError::io("create the folder", hidden, e))?;
        // Locked, it is not taken for what a killed program has left.
        let open = File::open(hidden).ok();
        drop(open.as_ref().map(File::try_lock));
        for folder in [
            layout::RAW_FOLDER,
            CALIBRATION_FOLDER,
            layout::DERIVED_FOLDER,
        ] {
            commit::create_dirs(&*disk, &hidden.join(folder))?;
        }
        let text = toml::to_string(new.record)
            .map_err(|e| SessionError::malformed(&hidden.join(SESSION_FILE), e))?;
        commit::commit_files(
            &*disk,
            hidden,
            &[(SESSION_FILE, text.as_bytes()), (JOURNAL_FILE, b"")],
            Replace::Never,
        )?;
        let mut writer = Self {
            disk,
            root: hidden.to_owned(),
            journal: Journal::default(),
            torn: false,
            _lock: open,
        };
        writer.record(Event::Start {
            format: FORMAT,
            session: FileDigest::of(SESSION_FILE, text.as_bytes()),
        })?;
        for (name, bytes) in new.calibration {
            writer.commit_file(&format!("{CALIBRATION_FOLDER}/{name}"), bytes)?;
        }
        Ok(writer)
    }

    /// Opens a session to add derived files: a fit, a report.
    pub fn open(disk: Arc<dyn Disk>, root: &Path) -> Result<Self, SessionError> {
        // Read once before locking, for the better error where there is no session.
        Journal::read(root)?;
        let lock = lock(root, layout::LOCK_FILE)?;
        let journal = Journal::read(root)?;
        Ok(Self {
            disk,
            root: root.to_owned(),
            torn: journal.torn_bytes > 0,
            journal,
            _lock: Some(lock),
        })
    }

    /// Opens an interrupted session to go on with the capture: a torn line is
    /// cut off, every journalled file is checked, files without a record and
    /// derived files that are broken go to the quarantine folder.
    ///
    /// # Errors
    /// Where a raw frame, calibration copy or `session.toml` is not what was journalled,
    /// something of the session is a link, or its records contradict each other: all that
    /// [`verify`](verify::verify) calls a problem but what can be made again. Nothing was
    /// changed then.
    pub fn resume(disk: Arc<dyn Disk>, root: &Path) -> Result<Self, SessionError> {
        let mut writer = Self::open(disk, root)?;
        let mut problems = journalled::misplaced(root, &writer.journal);
        problems.extend(verify::contradictions(&Session::open(root)?));
        if let Some(problem) = problems.into_iter().next() {
            return Err(problem);
        }
        let mut unwanted = verify::strays(root, &writer.journal)?;
        let mut needed = vec![root.join(JOURNAL_FILE)];
        for file in writer.journal.files() {
            match journalled::check(root, file) {
                Ok(()) => needed.push(root.join(&file.path)),
                Err(SessionError::Missing { .. }) if layout::is_derived(&file.path) => {}
                Err(_) if layout::is_derived(&file.path) => {
                    unwanted.push(PathBuf::from(&file.path));
                }
                Err(problem) => return Err(problem),
            }
        }
        if writer.journal.is_complete() && unwanted.is_empty() && !writer.torn {
            return Ok(writer);
        }
        writer.quarantine(&unwanted)?;
        // Nothing that the session needs went with them.
        if let Some(path) = needed.into_iter().find(|path| !path.is_file()) {
            return Err(SessionError::Missing { path });
        }
        writer.record(Event::Resume {
            quarantined: unwanted.len() as u32,
        })?;
        Ok(writer)
    }

    fn quarantine(&self, files: &[PathBuf]) -> Result<(), SessionError> {
        if files.is_empty() {
            return Ok(());
        }
        let quarantine = self.root.join(layout::QUARANTINE_FOLDER);
        let folder = (1..)
            .map(|n: u32| quarantine.join(n.to_string()))
            .find(|folder| folder.symlink_metadata().is_err())
            .expect("a free number exists");
        for file in files {
            let from = self.root.join(file);
            let to = folder.join(file);
            let parent = to.parent().unwrap_or(&folder);
            commit::create_dirs(&*self.disk, parent)?;
            self.disk
                .rename(&from, &to)
                .map_err(|e| SessionError::io("rename to", &to, e))?;
            commit::sync_dir(&*self.disk, parent)?;
            commit::sync_dir(&*self.disk, from.parent().unwrap_or(&self.root))?;
        }
        Ok(())
    }

    /// Whether a file could be added: asked before work whose result is added at its end.
    ///
    /// # Errors
    /// What the file system reports of the journal, or of a new file in `folder`, which may
    /// have to be made.
    pub fn check_writable(&self, folder: &str) -> Result<(), SessionError> {
        let path = self.root.join(JOURNAL_FILE);
        let journal = OpenOptions::new().append(true).open(&path);
        journal.map_err(|e| SessionError::io("append to", &path, e))?;
        let path = self.root.join(folder);
        whole_file::check_folder(&path).map_err(|e| SessionError::io("write in", &path, e))
    }

    /// The session's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// What was journalled so far.
    pub fn journal(&self) -> &Journal {
        &self.journal
    }

    /// The disk that it writes on.
    pub fn disk(&self) -> Arc<dyn Disk> {
        Arc::clone(&self.disk)
    }

    /// Journals an event. After a failed append the journal is first cut back
    /// to its last whole line.
    pub fn record(&mut self, event: Event) -> Result<(), SessionError> {
        let path = self.root.join(JOURNAL_FILE);
        if self.torn {
            self.disk
                .truncate(&path, self.journal.whole_bytes)
                .map_err(|e| SessionError::io("truncate", &path, e))?;
            self.torn = false;
            self.journal.torn_bytes = 0;
        }
        let record = Record {
            number: self.journal.records.len() as u64,
            utc: utc_now(),
            event,
        };
        let line = journal::encode(&record);
        self.torn = true;
        commit::append_line(&*self.disk, &path, &line)?;
        self.torn = false;
        self.journal.whole_bytes += line.len() as u64;
        self.journal.records.push(record);
        Ok(())
    }

    /// Brings a frame and its sidecar to the disk, then to the journal. When it
    /// returns, the frame is finished.
    ///
    /// # Errors
    /// [`SessionError::FrameTaken`] if the journal holds this frame.
    pub fn commit_frame(
        &mut self,
        frame: &RawFrame,
        sidecar: &Sidecar,
    ) -> Result<(), SessionError> {
        let folder = self.root.join(layout::RAW_FOLDER);
        let stem = layout::frame_stem(sidecar.key);
        let (image, text) = (format!("{stem}.png"), format!("{stem}.toml"));
        let path = folder.join(&image);
        let taken =
            |r: &Record| matches!(&r.event, Event::Frame { key, .. } if *key == sidecar.key);
        if self.journal.records.iter().any(taken) {
            return Err(SessionError::FrameTaken { path });
        }
        let png = frame::encode_png(frame).map_err(|why| SessionError::malformed(&path, why))?;
        let sidecar_toml = toml::to_string(sidecar)
            .map_err(|e| SessionError::malformed(&folder.join(&text), e))?;
        commit::commit_files(
            &*self.disk,
            &folder,
            &[(&image, &png), (&text, sidecar_toml.as_bytes())],
            Replace::Never,
        )?;
        let raw = layout::RAW_FOLDER;
        self.record(Event::Frame {
            key: sidecar.key,
            image: FileDigest::of(format!("{raw}/{image}"), &png),
            sidecar: FileDigest::of(format!("{raw}/{text}"), sidecar_toml.as_bytes()),
        })
    }

    /// Brings any other file to the disk, then to the journal. `relative` has
    /// `/` between names; missing folders are made. Derived files (`derived/`,
    /// `fits/`, the report, the manifest) may replace an older one.
    pub fn commit_file(&mut self, relative: &str, bytes: &[u8]) -> Result<(), SessionError> {
        let path = self.root.join(relative);
        let (Some(folder), Some(name), true) = (
            path.parent(),
            path.file_name().and_then(|name| name.to_str()),
            layout::is_inside(relative),
        ) else {
            return Err(SessionError::malformed(
                &path,
                "the path leaves the session",
            ));
        };
        commit::create_dirs(&*self.disk, folder)?;
        let replace = if layout::is_derived(relative) {
            Replace::Derived
        } else {
            Replace::Never
        };
        commit::commit_files(&*self.disk, folder, &[(name, bytes)], replace)?;
        self.record(Event::File {
            file: FileDigest::of(relative, bytes),
        })
    }

    /// Writes the manifest of all files journalled so far, sorted by path, in
    /// the format that `sha256sum -c` reads.
    pub fn write_manifest(&mut self) -> Result<(), SessionError> {
        let mut lines: Vec<String> = self
            .journal
            .files()
            .iter()
            .filter(|file| file.path != MANIFEST_FILE)
            .map(|file| format!("{}  {}\n", file.sha256, file.path))
            .collect();
        lines.sort_by(|a, b| a[64..].cmp(&b[64..]));
        self.commit_file(MANIFEST_FILE, lines.concat().as_bytes())
    }

    /// Writes the manifest anew where the capture is complete and so has one.
    pub fn refresh_manifest(&mut self) -> Result<(), SessionError> {
        if self.journal.is_complete() {
            self.write_manifest()?;
        }
        Ok(())
    }

    /// Ends the capture: manifest, then the stop record, unless it has one.
    pub fn finish(&mut self) -> Result<(), SessionError> {
        self.write_manifest()?;
        if self.journal.is_complete() {
            return Ok(());
        }
        self.record(Event::Stop)
    }
}

/// Now, RFC 3339 to the millisecond.
pub fn utc_now() -> String {
    jiff::Timestamp::now()
        .strftime("%Y-%m-%dT%H:%M:%S%.3fZ")
        .to_string()
}

/// Holds [`layout::JOB_LOCK_FILE`] of a session until the file is dropped.
///
/// # Errors
/// [`SessionError::Locked`] where another process, or another part of this one, holds it.
pub fn lock_for_job(root: &Path) -> Result<File, SessionError> {
    lock(root, layout::JOB_LOCK_FILE)
}

fn lock(root: &Path, name: &str) -> Result<File, SessionError> {
    let path = root.join(name);
    // A link or a named pipe in its place is neither followed nor waited for.
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    let file = never_waiting(&mut options, false)
        .open(&path)
        .map_err(|e| SessionError::io("open", &path, e))?;
    match file_system::lock(&file, &path) {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(SessionError::Locked {
            path: root.to_owned(),
        }),
        Err(TryLockError::Error(e)) => Err(SessionError::io("lock", &path, e)),
    }
}

#[cfg(test)]
mod tests;
