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
    if let Some((root, number)) = fit_of_session(folder) {
        return read_in(&Session::open(&root)?, number);
    }
    if folder.join(FIT_FILE).exists() {
        return read(folder);
    }
    let nothing = || FitRecordError::NoFit {
        folder: folder.to_owned(),
    };
    if !folder.join(JOURNAL_FILE).exists() {
        return Err(nothing());
    }
    let session = Session::open(folder)?;
    let latest = numbers_in(&session).pop().ok_or_else(nothing)?;
    read_in(&session, latest)
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
