//! Fits by their folder, or by the session that has them.

use std::path::{Path, PathBuf};

use crate::session::fit_record::{self, FIT_FILE, FitRecord, FitRecordError};
use crate::session::layout::{FITS_FOLDER, JOURNAL_FILE};
use crate::session::{Session, SessionError};

/// Why there is no fit.
#[derive(Debug, thiserror::Error)]
pub enum FitFolderError {
    /// Neither a fit nor a session that has one.
    #[error("{} holds no fit (no fit.toml, no fits/)", dir.display())]
    None {
        /// The folder.
        dir: PathBuf,
    },
    /// The session could not be opened.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A fit of a session is damaged.
    #[error(transparent)]
    OfSession(FitRecordError),
    /// A fit in a folder of its own is damaged.
    #[error(transparent)]
    Alone(FitRecordError),
}

/// The fit in a folder of its own, or of a session (its latest): there its files must
/// be those whose hashes the journal has.
///
/// # Errors
/// No fit, or one that is damaged.
pub fn read_fit(dir: &Path) -> Result<FitRecord, FitFolderError> {
    if let Some((root, number)) = fit_of_session(dir) {
        let session = Session::open(&root)?;
        return fit_record::read_in(&session, number).map_err(FitFolderError::OfSession);
    }
    if dir.join(FIT_FILE).exists() {
        return fit_record::read(dir).map_err(FitFolderError::Alone);
    }
    let none = || FitFolderError::None {
        dir: dir.to_owned(),
    };
    if !dir.join(JOURNAL_FILE).exists() {
        return Err(none());
    }
    let session = Session::open(dir)?;
    let latest = fit_record::numbers_in(&session).pop().ok_or_else(none)?;
    fit_record::read_in(&session, latest).map_err(FitFolderError::OfSession)
}

/// Session and number where `dir` is `SESSION/fits/NUMBER`.
fn fit_of_session(dir: &Path) -> Option<(PathBuf, u32)> {
    let dir = dir.canonicalize().ok()?;
    let number = dir.file_name()?.to_str()?.parse().ok()?;
    let fits = dir.parent()?;
    let root = fits.parent()?;
    let is_session = fits.file_name()? == FITS_FOLDER && root.join(JOURNAL_FILE).exists();
    is_session.then(|| (root.to_owned(), number))
}
