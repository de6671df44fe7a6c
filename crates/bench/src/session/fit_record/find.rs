//! Fits by their folder, or by the session that has them.

use std::path::{Path, PathBuf};

use super::{FIT_FILE, FitRecord, FitRecordError, numbers_in, read, read_in};
use crate::session::Session;
use crate::session::layout::{FITS_FOLDER, JOURNAL_FILE};

/// Reads the fit of a folder that holds one: written outside a session, `SESSION/fits/NUMBER`,
/// or a session, whose latest is taken. Of a session, every file must have the checksum that the
/// journal states.
///
/// # Errors
/// A folder without a fit, or a fit that is damaged.
pub fn find(folder: &Path) -> Result<FitRecord, FitRecordError> {
    match find_in_session(folder)? {
        Some((session, number)) => read_in(&session, number),
        None => read(folder),
    }
}

/// The session and the number of the fit that `folder` names: a session (its latest fit), or
/// `SESSION/fits/NUMBER`. `None` for a fit outside any session.
///
/// # Errors
/// A folder without a fit, or a session that is damaged.
pub fn find_in_session(folder: &Path) -> Result<Option<(Session, u32)>, FitRecordError> {
    if let Some((root, number)) = fit_of_session(folder) {
        return Ok(Some((Session::open(&root)?, number)));
    }
    if folder.join(FIT_FILE).exists() {
        return Ok(None);
    }
    let nothing = || FitRecordError::NoFit {
        folder: folder.to_owned(),
    };
    if !folder.join(JOURNAL_FILE).exists() {
        return Err(nothing());
    }
    let session = Session::open(folder)?;
    let latest = numbers_in(&session).pop().ok_or_else(nothing)?;
    Ok(Some((session, latest)))
}

/// Session and number where `folder` is `SESSION/fits/NUMBER`.
fn fit_of_session(folder: &Path) -> Option<(PathBuf, u32)> {
    let folder = folder.canonicalize().ok()?;
    let number = folder.file_name()?.to_str()?.parse().ok()?;
    let fits = folder.parent()?;
    let root = fits.parent()?;
    let is_session = fits.file_name()? == FITS_FOLDER && root.join(JOURNAL_FILE).exists();
    is_session.then(|| (root.to_owned(), number))
}
