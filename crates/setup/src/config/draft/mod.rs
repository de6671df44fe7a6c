//! A rig file of the operator's own, from answers to a list of questions: which questions
//! there are, what may be answered, the commented text, and what to calibrate next.
//!
//! Nothing here opens a device or writes a file. `rig init` asks the questions.

mod answer;
mod completion;
mod derived;
mod found;
mod interview;
mod next;
mod question;
mod relation;
mod table;
mod text;

use std::path::Path;

pub use answer::{Answer, AnswerError, Answers};
pub use found::Found;
pub use interview::{Interviewee, interview};
pub use next::Step;
pub use question::{Choice, Kind, Question, When};
pub use table::questions;

use super::{ConfigError, RigConfig};

/// Answers that make no rig file.
#[derive(Debug, thiserror::Error)]
pub enum DraftError {
    /// An answer is missing, of no known question, or outside its range.
    #[error(transparent)]
    Answer(#[from] AnswerError),
    /// The reader of rig files refuses the text.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// A rig file that its reader has accepted, not yet written.
#[derive(Clone, Debug, PartialEq)]
pub struct Written {
    /// The text, with a comment for every key.
    pub text: String,
    /// What the reader makes of it.
    pub rig: RigConfig,
    /// What to do with the new file, in this order.
    pub next: Vec<Step>,
}

/// The rig file of these answers, as it would stand in `file`. Questions without an answer
/// take their defaults.
///
/// # Errors
/// [`DraftError`] with the key, its value and what is allowed.
pub fn write(
    questions: &[Question],
    found: &Found,
    answers: &Answers,
    file: &Path,
) -> Result<Written, DraftError> {
    let answers = completion::complete(questions, answers)?;
    relation::check(&answers)?;
    let text = text::text(&answers, found);
    let folder = file.parent().unwrap_or(Path::new(""));
    let rig = RigConfig::parse(&file.display().to_string(), folder, &text)?;
    let next = next::next(&answers, file);
    Ok(Written { text, rig, next })
}

/// Checks the answers given so far, one by one and against each other.
///
/// # Errors
/// [`AnswerError`] with the key of an answer that cannot stay.
pub fn check_so_far(questions: &[Question], answers: &Answers) -> Result<(), AnswerError> {
    completion::check(questions, answers)?;
    relation::check(answers)
}

#[cfg(test)]
mod tests;
