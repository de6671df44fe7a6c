//! Fits by their folder, or by the session that has them.

use std::path::{Path, PathBuf};

use super::{CliError, HintExt};
use crate::session::Session;
use crate::session::fit_record::{self, FIT_FILE, FitRecord};
use crate::session::layout::{FITS_FOLDER, JOURNAL_FILE};

/// The fit in a folder of its own, or of a session: there its files must be those
/// that the journal vouches for.
pub(super) fn read(dir: &Path) -> Result<FitRecord, CliError> {
    let damaged =
        "`rig session verify SESSION` lists every damaged file; `rig fit SESSION` makes a new fit";
    if let Some((root, number)) = fit_of_session(dir) {
        let session = Session::open(&root)?;
        return fit_record::read_in(&session, number).hint(damaged);
    }
    if dir.join(FIT_FILE).exists() {
        return fit_record::read(dir)
            .hint("`rig fit` makes the folder anew; its files are not meant to be edited");
    }
    let nothing = || {
        CliError::new(format!(
            "{} holds no fit (no fit.toml, no fits/)",
            dir.display()
        ))
        .hint("give the folder that `rig fit --out` wrote, or a session that `rig fit` has fitted")
    };
    if !dir.join(JOURNAL_FILE).exists() {
        return Err(nothing());
    }
    let session = Session::open(dir)?;
    let latest = fit_record::numbers_in(&session).pop().ok_or_else(nothing)?;
    fit_record::read_in(&session, latest).hint(damaged)
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
