//! Which exception of `rig_reflectometry.errors` an error of the library becomes.

use std::error::Error;
use std::fmt::Display;
use std::io;

use pyo3::prelude::*;
use rig::brdf::BrdfError;
use rig::calibration::RecordError;
use rig::cells::AverageError;
use rig::config::{BuildError, ConfigError};
use rig::export::ExportError;
use rig::material::MaterialError;
use rig::radiance_image::exr::ExrError;
use rig::radiometry::bracket_files::{BracketError, Problem};
use rig::radiometry::bracket_merge::BracketMergeError;
use rig::session::SessionError;
use rig::session::fit_record::FitRecordError;
use rig::transport::polarised::NotPolarisable;
use rig::workflow::WorkflowError;

/// An exception class of `rig_reflectometry.errors`, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(clippy::enum_variant_names, reason = "the names of the classes")]
pub enum Kind {
    InputError,
    FileError,
    MissingFileError,
    SceneError,
    SessionError,
    NoFitError,
    FitError,
}

/// An exception that is about to be raised.
#[derive(Debug)]
pub struct Fault {
    kind: Kind,
    message: String,
}

/// An argument that cannot be used.
pub fn input(message: impl Display) -> Fault {
    Fault {
        kind: Kind::InputError,
        message: message.to_string(),
    }
}

impl Fault {
    /// Of this kind, unless the system refused a file.
    fn of(error: &(dyn Error + 'static), kind: Kind) -> Self {
        let mut cause = Some(error);
        let mut refused = None;
        while let Some(error) = cause {
            refused = refused.or(error.downcast_ref::<io::Error>());
            cause = error.source();
        }
        Self {
            kind: match refused.map(io::Error::kind) {
                Some(io::ErrorKind::NotFound) => Kind::MissingFileError,
                Some(_) => Kind::FileError,
                None => kind,
            },
            message: error.to_string(),
        }
    }
}

impl From<Fault> for PyErr {
    fn from(fault: Fault) -> Self {
        Python::attach(|py| {
            let raised = py
                .import("rig_reflectometry.errors")
                .and_then(|errors| errors.getattr(format!("{:?}", fault.kind).as_str()))
                .and_then(|class| class.call1((fault.message,)));
            match raised {
                Ok(exception) => PyErr::from_value(exception),
                Err(error) => error,
            }
        })
    }
}

/// Errors whose kind doesn't depend on which of them it is.
macro_rules! of_kind {
    ($($error:ty => $kind:ident),* $(,)?) => {$(
        impl From<$error> for Fault {
            fn from(error: $error) -> Self {
                Self::of(&error, Kind::$kind)
            }
        }
    )*};
}

of_kind! {
    BrdfError => InputError,
    BuildError => SceneError,
    ConfigError => SceneError,
    ExportError => InputError,
    ExrError => FileError,
    NotPolarisable => InputError,
    RecordError => FileError,
    SessionError => SessionError,
}

impl From<MaterialError> for Fault {
    fn from(error: MaterialError) -> Self {
        match error {
            MaterialError::Fit(error) => error.into(),
            error => Self::of(&error, Kind::InputError),
        }
    }
}

impl From<FitRecordError> for Fault {
    fn from(error: FitRecordError) -> Self {
        let kind = match &error {
            FitRecordError::NoFit { .. } => Kind::NoFitError,
            FitRecordError::Session(_) | FitRecordError::NotVouchedFor { .. } => Kind::SessionError,
            _ => Kind::FileError,
        };
        Self::of(&error, kind)
    }
}

impl From<BracketError> for Fault {
    fn from(error: BracketError) -> Self {
        let kind = match error.problem {
            Problem::Unreadable | Problem::Folder | Problem::UnreadableTable => Kind::FileError,
            _ => Kind::InputError,
        };
        Self::of(&error, kind)
    }
}

impl From<BracketMergeError> for Fault {
    fn from(error: BracketMergeError) -> Self {
        match error {
            BracketMergeError::Files(error) => error.into(),
            BracketMergeError::Image(error) => error.into(),
            error => Self::of(&error, Kind::InputError),
        }
    }
}

impl From<WorkflowError> for Fault {
    fn from(error: WorkflowError) -> Self {
        use WorkflowError::*;
        match error {
            Session(error) => error.into(),
            Config(error) => error.into(),
            Build(error) => error.into(),
            Brdf(error) => error.into(),
            Record(error) => error.into(),
            Image(error) => error.into(),
            FitRecord(error) => error.into(),
            MergedImage { .. } => Self::of(&error, Kind::SessionError),
            Scene(_) => Self::of(&error, Kind::SceneError),
            Average(AverageError::ImageCount { .. } | AverageError::ImageSize { .. })
            | Mask { .. }
            | Kernel(_)
            | UnusedUncertainty => Self::of(&error, Kind::InputError),
            _ => Self::of(&error, Kind::FitError),
        }
    }
}
