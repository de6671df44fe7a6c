//! The parts that every experiment has.
//!
//! An [`Experiment`] lists independent *cases*, each with a key; running a case gives
//! rows of a table; figures are drawn from the table alone. [`run`] does the cases on
//! all cores, keeps every finished one in a journal and skips it the next time.
//!
//! A new experiment is one file with a `pub static NAME: Experiment`, and one line in
//! [`super::EXPERIMENTS`].

mod journal;
mod panels;
mod run;
pub(super) mod settings;
mod statistics;

pub use super::error::EvaluateError;
pub use crate::result_table::{Row, Table, Value};
pub use crate::statistics::quantile;
pub use panels::{Medians, Scatter, doublings};
pub use run::{Done, Outcome, Run, run};
pub use settings::{Overrides, Scale, Settings};
pub use statistics::{Spread, spread};

use std::path::PathBuf;

use super::lab::Lab;
use crate::plot::Figure;

/// One experiment: what it shows, at which scale, its cases and its figures.
pub struct Experiment {
    /// As on the command line.
    pub name: &'static str,
    /// What the table and the figures show, one sentence.
    pub shows: &'static str,
    /// Settings without options.
    pub full: Scale,
    /// Settings with `--quick`: minutes at most on one core.
    pub quick: Scale,
    /// The cases of a laboratory's settings; cheap, for nothing is computed yet.
    pub cases: fn(&Lab) -> Result<Vec<Case>, EvaluateError>,
    /// The figures of a finished table.
    pub figures: fn(&Lab, &Table) -> Result<Vec<Figure>, EvaluateError>,
}

/// What a case does: the same rows for the same laboratory, on any thread.
type Work = Box<dyn Fn(&Lab) -> Result<Vec<Row>, EvaluateError> + Send + Sync>;

/// One independent part of an experiment.
pub struct Case {
    /// Its name in the journal: unique within the experiment, made of all that
    /// distinguishes the case.
    pub key: String,
    work: Work,
}

impl Case {
    /// A case whose rows `work` computes.
    pub fn new(
        key: impl Into<String>,
        work: impl Fn(&Lab) -> Result<Vec<Row>, EvaluateError> + Send + Sync + 'static,
    ) -> Self {
        Self {
            key: key.into(),
            work: Box::new(work),
        }
    }

    /// Computes the rows.
    pub fn run(&self, lab: &Lab) -> Result<Vec<Row>, EvaluateError> {
        (self.work)(lab)
    }
}

impl EvaluateError {
    /// For `map_err`, with the path.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }
}
