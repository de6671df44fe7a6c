//! One line of the list of sessions.

use std::path::Path;

use serde::Serialize;

use crate::beneath::{self, BeneathError};
use crate::fault::{Advisor, Fault};
use crate::session::fit_record::{self, FitRecord, FitRecordError, Verdict};
use crate::session::layout::{FITS_FOLDER, JOURNAL_FILE, REPORT_FILE, SESSION_FILE};
use crate::session::{Session, SessionError};

/// A session, or a folder that should be one.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct Row<F = FitRow> {
    /// The folder's name.
    pub name: String,
    pub sample: Option<String>,
    /// What the operator has noted of the material.
    pub material: Option<String>,
    /// The material that a simulated sample is made of.
    pub true_material: Option<String>,
    /// What the operator has noted otherwise.
    pub comment: Option<String>,
    /// When the capture began, RFC 3339, UTC; by the folder's name where nothing else is
    /// known.
    pub began: Option<String>,
    /// Light directions planned.
    pub lights: usize,
    /// Light directions whose frames are all there.
    pub lights_finished: usize,
    pub frames: usize,
    /// Size of all its journalled files.
    pub bytes: u64,
    /// Whether the capture ran to its end.
    pub complete: bool,
    /// Whether any device was a simulated one.
    pub simulated: bool,
    /// Whether the stage was found to have lost steps.
    pub suspect: bool,
    /// Its fits, lowest number first.
    pub fits: Vec<F>,
    /// Whether it has a report.
    pub report: bool,
    pub error: Option<Fault>,
}

/// A fit of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct FitRow {
    /// Its number in `fits/`, as the console names it.
    pub name: String,
    /// Its number in `fits/`.
    #[serde(skip)]
    pub number: u32,
    pub dictionary: Option<String>,
    /// Whether it can be trusted.
    pub verdict: Option<Verdict>,
    /// The same as a sentence.
    pub verdict_text: Option<&'static str>,
    /// Worst reduced χ² of all lights and channels.
    pub chi2: Option<f64>,
    /// Environment error against the true material, relative; only where that is known.
    pub environment_error: Option<f64>,
    pub error: Option<Fault>,
}

/// Why a session is not read; facts only.
#[derive(Debug, thiserror::Error)]
pub enum EntryError {
    /// One of its files or folders.
    #[error(transparent)]
    File(#[from] BeneathError),
    /// The session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A fit.
    #[error(transparent)]
    Fit(#[from] FitRecordError),
    /// It has neither journal nor `session.toml`.
    #[error("{name:?} is no session: it has neither {SESSION_FILE} nor {JOURNAL_FILE}")]
    Foreign {
        /// The folder's name.
        name: String,
    },
}

/// Opens a session of the folder, none of whose files that are read is a link.
///
/// # Errors
/// What keeps it from being read.
pub fn open(folder: &Path, name: &str) -> Result<Session, EntryError> {
    check_name(name)?;
    beneath::check_folder(folder, name)?;
    let files = [SESSION_FILE, JOURNAL_FILE].map(|file| beneath::open(folder, &path(name, file)));
    if files
        .iter()
        .all(|file| matches!(file, Err(error) if error.is_missing()))
    {
        return Err(EntryError::Foreign {
            name: name.to_owned(),
        });
    }
    for file in files {
        match file {
            // The session states itself what it lacks.
            Err(error) if !error.is_missing() => return Err(error.into()),
            _ => {}
        }
    }
    Ok(Session::open(&folder.join(name))?)
}

/// The record of a session's fit, none of whose files is a link.
///
/// # Errors
/// A file of it that is a link, missing, changed or not understood.
pub fn read_fit(session: &Session, number: u32) -> Result<FitRecord, EntryError> {
    let inside = format!("{FITS_FOLDER}/{number}/");
    for file in session.journal().files() {
        let is_read = file.path.ends_with(".toml") || file.path.ends_with(".csv");
        if is_read && file.path.starts_with(&inside) {
            beneath::open(session.root(), &file.path)?;
        }
    }
    Ok(fit_record::read_in(session, number)?)
}

/// Whether this can be the name of a session: one plain name that is not hidden.
///
/// # Errors
/// It cannot.
pub fn check_name(name: &str) -> Result<(), BeneathError> {
    match name.contains('/') || name.starts_with('.') {
        true => Err(BeneathError::Path {
            path: name.to_owned(),
        }),
        false => Ok(()),
    }
}

/// A path below the folder.
pub fn path(name: &str, file: &str) -> String {
    format!("{name}/{file}")
}

impl Row {
    /// Reads the session of this name; one that cannot be read has an error and little else.
    pub fn read(folder: &Path, name: &str, advisor: &Advisor) -> Self {
        let session = match open(folder, name) {
            Ok(session) => session,
            Err(error) => return Self::failed(name, entry_fault(&error, advisor)),
        };
        let fits = fit_record::numbers_in(&session);
        let fit = |number| match read_fit(&session, number) {
            Ok(record) => FitRow::of(number, &record),
            Err(error) => FitRow::failed(number, entry_fault(&error, advisor)),
        };
        Self::of(&session, name, fits.into_iter().map(fit).collect())
    }

    /// Whether each word of a search is part of name, sample, material (noted or true) or
    /// comment, in any case.
    pub fn matches(&self, search: &str) -> bool {
        let texts = [
            Some(&self.name),
            self.sample.as_ref(),
            self.material.as_ref(),
            self.true_material.as_ref(),
            self.comment.as_ref(),
        ];
        let texts: Vec<String> = texts
            .into_iter()
            .flatten()
            .map(|t| t.to_lowercase())
            .collect();
        let search = search.to_lowercase();
        search
            .split_whitespace()
            .all(|word| texts.iter().any(|text| text.contains(word)))
    }
}

impl<F> Row<F> {
    /// Its latest fit.
    pub fn latest(&self) -> Option<&F> {
        self.fits.last()
    }

    /// Of an open session with these fits.
    pub fn of(session: &Session, name: &str, fits: Vec<F>) -> Self {
        let (summary, record) = (session.summary(), session.record());
        Self {
            name: name.to_owned(),
            sample: Some(summary.sample),
            material: record.material.clone(),
            true_material: record.true_material.clone(),
            comment: record.comment.clone(),
            began: Some(summary.created_utc),
            lights: summary.lights_planned,
            lights_finished: summary.lights_finished,
            frames: summary.frames,
            bytes: session.journal().files().iter().map(|f| f.bytes).sum(),
            complete: summary.complete,
            simulated: summary.simulated,
            suspect: summary.suspect,
            fits,
            report: beneath::open(session.root(), REPORT_FILE).is_ok(),
            error: None,
        }
    }

    /// A folder that is no session to be read.
    pub fn failed(name: &str, error: Fault) -> Self {
        Self {
            name: name.to_owned(),
            sample: None,
            material: None,
            true_material: None,
            comment: None,
            began: began_of_name(name),
            lights: 0,
            lights_finished: 0,
            frames: 0,
            bytes: 0,
            complete: false,
            simulated: false,
            suspect: false,
            fits: Vec::new(),
            report: false,
            error: Some(error),
        }
    }
}

impl FitRow {
    /// Of a fit that was read.
    pub fn of(number: u32, record: &FitRecord) -> Self {
        let verdict = record.verdict();
        let score = record.score.as_ref();
        Self {
            name: number.to_string(),
            number,
            dictionary: Some(record.dictionary.clone()),
            verdict: Some(verdict),
            verdict_text: Some(verdict.sentence()),
            chi2: record.worst_reduced_chi_square(),
            environment_error: score.map(|score| score.environment_error.estimate.overall),
            error: None,
        }
    }

    /// Of one that cannot be read.
    pub fn failed(number: u32, error: Fault) -> Self {
        Self {
            name: number.to_string(),
            number,
            error: Some(error),
            ..Self::default()
        }
    }
}

/// The error with the advice that belongs to the inner one.
pub fn entry_fault(error: &EntryError, advisor: &Advisor) -> Fault {
    match error {
        EntryError::Session(inner) => advisor.fault(inner),
        EntryError::Fit(inner) => advisor.fault(inner),
        EntryError::File(inner) => advisor.fault(inner),
        EntryError::Foreign { .. } => advisor.fault(error),
    }
}

/// `20261121T023400Z_…` as RFC 3339.
fn began_of_name(name: &str) -> Option<String> {
    let (stamp, _) = name.split_once('_')?;
    let time = jiff::civil::DateTime::strptime("%Y%m%dT%H%M%SZ", stamp).ok()?;
    Some(time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_finds_all_its_words_in_any_case() {
        let fault = Fault::new("a fact");
        let row = Row {
            sample: Some("bowl-7".to_owned()),
            material: Some("Red-Plastic".to_owned()),
            ..Row::<FitRow>::failed("20261121T023400Z_bowl-7_0f3a", fault)
        };
        for found in ["", "bowl", "BOWL plastic", "20261121 red", " 0f3a "] {
            assert!(row.matches(found), "{found}");
        }
        for other in ["cup", "bowl cup"] {
            assert!(!row.matches(other), "{other}");
        }
    }

    #[test]
    fn a_name_tells_when_a_broken_session_began() {
        let began = began_of_name("20261121T023400Z_x_1");
        assert_eq!(began.as_deref(), Some("2026-11-21T02:34:00Z"));
        for other in ["x", "2026_x", "99999999T999999Z_x", "20261121T023400Zé_x"] {
            assert_eq!(began_of_name(other), None, "{other}");
        }
    }
}
