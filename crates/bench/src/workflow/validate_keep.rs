//! Keeping a validation with its pictures, in its session or in a folder.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{LightPrediction, Validated, WorkflowError};
use crate::session::commit::SystemDisk;
#[cfg(feature = "figures")]
use crate::session::fit_record::FitRecordError;
use crate::session::{SessionWriter, layout, validation};

/// Whether a session could keep a validation: asked before the fit, which may take hours.
///
/// # Errors
/// A folder that is no session, or that cannot be written.
pub fn check_keeps_validations(root: &Path) -> Result<(), WorkflowError> {
    let writer = SessionWriter::open(Arc::new(SystemDisk), root)?;
    Ok(writer.check_writable(layout::VALIDATIONS_FOLDER)?)
}

/// Adds a validation to its session, as the next `validations/<n>`, which is returned.
///
/// # Errors
/// A session that takes no more.
pub fn keep_validation(root: &Path, found: &Validated) -> Result<PathBuf, WorkflowError> {
    let mut writer = SessionWriter::open(Arc::new(SystemDisk), root)?;
    let folder = validation::commit(&mut writer, &found.validation, &found.pictures)?;
    writer.refresh_manifest()?;
    Ok(folder)
}

/// Writes it to a folder outside any session, which must not exist or be empty.
///
/// # Errors
/// A folder with something in it, or the system's error.
pub fn write_validation(folder: &Path, found: &Validated) -> Result<(), WorkflowError> {
    Ok(validation::write(
        folder,
        &found.validation,
        &found.pictures,
    )?)
}

/// Name and bytes of the PNG file that shows a predicted light; `None` in a build without the feature
/// `figures`.
#[cfg(feature = "figures")]
pub(super) fn picture_of(
    prediction: &LightPrediction,
) -> Result<Option<(String, Vec<u8>)>, WorkflowError> {
    let name = validation::picture_file(prediction.light);
    let figure = crate::plot::comparison(&name, &prediction.captured, &prediction.predicted);
    match figure.png() {
        Ok(png) => Ok(Some((name, png))),
        Err(error) => Err(FitRecordError::Io {
            path: name.into(),
            source: std::io::Error::other(error),
        }
        .into()),
    }
}

#[cfg(not(feature = "figures"))]
pub(super) fn picture_of(_: &LightPrediction) -> Result<Option<(String, Vec<u8>)>, WorkflowError> {
    Ok(None)
}
