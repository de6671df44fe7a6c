//! Estimates beside the truth, where the truth is known: the score of one fit, and the
//! experiments of `rig evaluate`.

pub mod experiment;
pub mod lab;
pub mod misalignment;
pub mod score_sheet;

mod shapes;

use experiment::{EvaluateError, Experiment};

pub use score_sheet::score;

/// All experiments, in the order of `rig evaluate --list`.
pub static EXPERIMENTS: &[&Experiment] = &[&shapes::SHAPES];

/// The experiment of a name.
pub fn find(name: &str) -> Result<&'static Experiment, EvaluateError> {
    let found = EXPERIMENTS.iter().find(|e| e.name == name);
    found
        .copied()
        .ok_or_else(|| EvaluateError::UnknownExperiment {
            name: name.to_owned(),
            known: EXPERIMENTS
                .iter()
                .map(|e| e.name)
                .collect::<Vec<_>>()
                .join(", "),
        })
}
