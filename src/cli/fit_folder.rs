//! Fits by their folder, or by the session that has them.

use std::path::Path;

use super::CliError;
use crate::material::{FitFolderError, read_fit};
use crate::session::fit_record::FitRecord;

/// [`read_fit`], with advice.
pub(super) fn read(dir: &Path) -> Result<FitRecord, CliError> {
    read_fit(dir).map_err(advise)
}

pub(super) fn advise(error: FitFolderError) -> CliError {
    let hint = match error {
        FitFolderError::None { .. } => {
            "give the folder that `rig fit --out` wrote, or a session that `rig fit` has fitted"
        }
        FitFolderError::OfSession(_) => {
            "`rig session verify SESSION` lists every damaged file; `rig fit SESSION` makes a new fit"
        }
        FitFolderError::Alone(_) => {
            "`rig fit` makes the folder anew; its files are not meant to be edited"
        }
        FitFolderError::Session(error) => return error.into(),
    };
    CliError::from(error).hint(hint)
}
