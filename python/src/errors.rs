//! Which exception of `rig_reflectometry.errors` an error of the library becomes.

use std::error::Error;
use std::fmt::Display;
use std::io;

use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use rig_bench::session::SessionError;
use rig_bench::session::fit_record::FitRecordError;
use rig_bench::workflow::{StatedResultError, WorkflowError};
use rig_core::brdf::BrdfError;
use rig_core::cells::AverageError;
use rig_core::inverse::memory::free_bytes;
use rig_core::radiance_image::exr::ExrError;
use rig_core::transport::polarised::NotPolarisable;
use rig_desk::export::ExportError;
use rig_desk::material::MaterialError;
use rig_device::radiometry::bracket_files::{BracketError, Problem};
use rig_device::radiometry::bracket_merge::BracketMergeError;
use rig_setup::calibration::RecordError;
use rig_setup::config::{BuildError, ConfigError};

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
    refused: Option<Refused>,
}

/// How the system refused a file.
#[derive(Debug)]
struct Refused {
    code: Option<i32>,
    text: String,
    file: Option<String>,
}

impl Refused {
    /// By the system's error, and the text of the one that it caused, which names the file.
    fn of(system: &io::Error, message: &str) -> Self {
        let text = system.to_string();
        let code = system.raw_os_error().or(match system.kind() {
            io::ErrorKind::NotFound => Some(ENOENT),
            _ => None,
        });
        // "file: text" or "cannot read file: text", perhaps after where it is named.
        let before = message.strip_suffix(text.as_str());
        let before = before.and_then(|before| before.strip_suffix(": "));
        let file = before.and_then(|before| before.rsplit(": ").next());
        let file = file.map(|file| match file.strip_prefix("cannot ") {
            Some(rest) => rest.split_once(' ').map_or(rest, |(_, file)| file),
            None => file,
        });
        Self {
            code,
            file: file.map(str::to_owned),
            text: text
                .split(" (os error")
                .next()
                .unwrap_or_default()
                .to_owned(),
        }
    }
}

/// "No such file or directory", of every Unix.
const ENOENT: i32 = 2;

/// An argument that cannot be used.
pub fn input(message: impl Display) -> Fault {
    Fault {
        kind: Kind::InputError,
        message: message.to_string(),
        refused: None,
    }
}

/// Refuses a result that the machine's memory cannot hold: `count` values with what becomes of
/// them on the way, this many bytes each. Where memory is used up, the process would be ended.
pub fn check_room(count: Option<usize>, bytes_each: usize) -> PyResult<()> {
    let bytes = count.and_then(|count| count.checked_mul(bytes_each));
    let is_there = bytes.is_some_and(|bytes| {
        let is_free = free_bytes().is_none_or(|free| bytes as u64 <= free);
        is_free && Vec::<u8>::new().try_reserve_exact(bytes).is_ok()
    });
    if is_there {
        return Ok(());
    }
    let needed = match bytes {
        Some(bytes) => format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30)),
        None => "more bytes than can be counted".to_owned(),
    };
    Err(PyMemoryError::new_err(format!(
        "{needed} are needed, which this process cannot have: use fewer values at a time"
    )))
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
        let message = error.to_string();
        Self {
            kind: match refused.map(io::Error::kind) {
                Some(io::ErrorKind::NotFound) => Kind::MissingFileError,
                Some(_) => Kind::FileError,
                None => kind,
            },
            refused: refused.map(|system| Refused::of(system, &message)),
            message,
        }
    }
}

impl From<Fault> for PyErr {
    fn from(fault: Fault) -> Self {
        Python::attach(|py| {
            let raised = || {
                let errors = py.import("rig_reflectometry.errors")?;
                let class = errors.getattr(format!("{:?}", fault.kind).as_str())?;
                match &fault.refused {
                    None => class.call1((fault.message,)),
                    Some(Refused { code, text, file }) => {
                        let arguments = (class, fault.message, code, text, file);
                        errors.call_method1("file_error", arguments)
                    }
                }
            };
            match raised() {
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
            MaterialError::UnknownMaterial { .. } => {
                let known = rig_core::brdf::nbrdf::NAMES.join(", ");
                input(format!("{error}; known are {known}"))
            }
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

impl From<StatedResultError> for Fault {
    fn from(error: StatedResultError) -> Self {
        use StatedResultError::*;
        match error {
            Fit(error) => error.into(),
            Session(error) => error.into(),
            Config(error) => error.into(),
            error => Self::of(&error, Kind::SessionError),
        }
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
