//! A certificate of measurement: two printable A4 pages with what a laboratory signs.
//!
//! It states nothing that the session, its fit and its rig file do not hold; what they lack is
//! named as lacking. A fit that is not to be trusted, or a session whose files are not those
//! that were captured, gets none. A simulated session's is marked on every page as no
//! measurement (docs/adr/0045).

pub mod browser;
mod budget;
mod template;

use std::path::{Path, PathBuf};

pub use budget::{Budget, Column, Evaluation, Source};

use crate::brdf::BrdfError;
use crate::catalogue::Catalogue;
use crate::catalogue::reproducibility::{Reproducibility, ReproducibilityError};
use crate::fault::Advisor;
use crate::plot::PlotError;
use crate::session::fit_record::Verdict;
use crate::session::{SessionError, verify};
use crate::workflow::{StatedResult, StatedResultError};

/// Why there is no certificate.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum CertificateError {
    /// The session, its fit or its rig file.
    #[error(transparent)]
    Result(#[from] StatedResultError),
    /// The session could not be checked.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The fit's verdict.
    #[error("fit {number} of {} is not to be trusted: {reason}", session.display())]
    NotTrusted {
        session: PathBuf,
        number: u32,
        reason: String,
    },
    /// The session's own files, or what the stage did.
    #[error("{}: {fact}", session.display())]
    NotWhole { session: PathBuf, fact: String },
    #[error("fit {number} of {} has no budget of uncertainty", session.display())]
    NoBudget { session: PathBuf, number: u32 },
    /// The folder of repeats.
    #[error("{}: {source}", path.display())]
    Folder {
        path: PathBuf,
        source: std::io::Error,
    },
    /// The repeats cannot be compared.
    #[error("{}: {source}", path.display())]
    Repeats {
        path: PathBuf,
        source: ReproducibilityError,
    },
    /// The fit's atoms make no BRDF.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// A figure failed.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// The page's template failed: a defect of the program.
    #[error("certificate template: {0}")]
    Template(#[from] minijinja::Error),
}

/// What to certify.
#[derive(Clone, Debug)]
pub struct CertificateRequest {
    /// The session.
    pub session: PathBuf,
    /// Number of the fit; the latest if `None`.
    pub fit: Option<u32>,
    /// Folder of sessions: the scatter between those of this session's sample becomes a source
    /// of uncertainty.
    pub repeats: Option<PathBuf>,
}

/// The certificate as one HTML document of two pages, without any external resource.
///
/// # Errors
/// A session that is damaged, incomplete or suspect, a fit that is not to be trusted, or what
/// cannot be read.
pub fn certificate(request: &CertificateRequest) -> Result<String, CertificateError> {
    let result = StatedResult::load(&request.session, request.fit)?;
    check(&result)?;
    let record = result.record.budget.as_ref();
    let record = record.ok_or_else(|| CertificateError::NoBudget {
        session: request.session.clone(),
        number: result.number,
    })?;
    let scatter = match &request.repeats {
        Some(folder) => Some(between_sessions(folder, &result.session.record().sample)?),
        None => None,
    };
    let material = result.record.material()?;
    let table = &result.record.table;
    let budget = Budget::new(record, &*material, table, scatter.as_ref());
    template::render(&result, &budget)
}

/// How well the measurement of this sample is reproduced by the sessions of a folder.
fn between_sessions(folder: &Path, sample: &str) -> Result<Reproducibility, CertificateError> {
    let path = folder.to_owned();
    let found = std::fs::metadata(folder)
        .and_then(|_| Catalogue::new(folder, Advisor::silent()).repeats(Some(sample)));
    let repeats = match found {
        Ok(repeats) => repeats,
        Err(source) => return Err(CertificateError::Folder { path, source }),
    };
    let none = || Reproducibility::of(sample, &[]);
    let found = repeats.first();
    found
        .map_or_else(none, |repeats| repeats.reproducibility())
        .map_err(|source| CertificateError::Repeats { path, source })
}

/// Refuses what nobody should sign.
fn check(result: &StatedResult) -> Result<(), CertificateError> {
    let root = result.session.root();
    if result.record.verdict() == Verdict::NotToBeTrusted {
        let reason = match result.record.warnings.first() {
            Some(warning) => warning.what.clone(),
            None => "its residuals are far beyond noise and model error".to_owned(),
        };
        return Err(CertificateError::NotTrusted {
            session: root.to_owned(),
            number: result.number,
            reason,
        });
    }
    let found = verify::verify(root)?;
    let not_whole = |fact: String| CertificateError::NotWhole {
        session: root.to_owned(),
        fact,
    };
    if let Some(problem) = found.problems.first() {
        return Err(not_whole(format!("not as it was captured: {problem}")));
    }
    if !found.complete {
        return Err(not_whole("the capture is not complete".to_owned()));
    }
    if let Some(suspicion) = found.suspicion {
        return Err(not_whole(suspicion));
    }
    Ok(())
}

/// Where a certificate goes unless another file is named.
pub fn default_file(is_pdf: bool) -> &'static Path {
    Path::new(match is_pdf {
        true => "certificate.pdf",
        false => "certificate.html",
    })
}
