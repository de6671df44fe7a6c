//! The questions, asked one after the other until their answers make a rig file.

use std::path::Path;

use super::{AnswerError, Answers, DraftError, Found, Question, Written, check_so_far, write};

/// Who is asked.
pub trait Interviewee {
    /// Why no answer comes any more.
    type Error;

    /// Shows a question with its choices, before its first answer.
    fn show(&self, question: &Question);

    /// What is answered; nothing takes the default.
    ///
    /// # Errors
    /// No answer comes any more.
    fn answer(&self, question: &Question) -> Result<String, Self::Error>;

    /// Says why an answer is not possible; the question follows again.
    fn refuse(&self, fault: &str);
}

/// Asks until the answers make a rig file.
///
/// # Errors
/// No answer comes any more.
pub fn interview<I: Interviewee>(
    questions: &[Question],
    found: &Found,
    file: &Path,
    asked: &I,
) -> Result<Written, I::Error> {
    let mut answers = Answers::default();
    loop {
        for question in questions {
            if question.applies(&answers) && answers.get(question.key).is_none() {
                ask(question, questions, &mut answers, asked)?;
            }
        }
        let error = match write(questions, found, &answers, file) {
            Ok(written) => return Ok(written),
            Err(error) => error,
        };
        asked.refuse(&error.to_string());
        match error {
            DraftError::Answer(error) => answers.remove(error.key()),
            // An address that its driver does not take.
            DraftError::Config(_) => {
                for key in ["camera", "camera_address"] {
                    answers.remove(key);
                }
            }
        }
    }
}

/// Asks one question until its answer is valid, alone and with those before it.
fn ask<I: Interviewee>(
    question: &Question,
    questions: &[Question],
    answers: &mut Answers,
    asked: &I,
) -> Result<(), I::Error> {
    asked.show(question);
    loop {
        let line = asked.answer(question)?;
        let given = match (line.trim(), &question.default) {
            ("", Some(default)) => Ok(default.clone()),
            (text, _) => question.typed(text),
        };
        let kept = given.and_then(|answer| {
            answers.set(question.key, answer);
            check_so_far(questions, answers)
        });
        match kept {
            Ok(()) => return Ok(()),
            Err(error) => {
                asked.refuse(&fault(&error));
                answers.remove(question.key);
            }
        }
    }
}

/// What is wrong with an answer whose question stands above.
fn fault(error: &AnswerError) -> String {
    match error {
        AnswerError::Invalid { value, allowed, .. } if value.is_empty() => {
            format!("an answer is needed: {allowed}")
        }
        AnswerError::Invalid { value, allowed, .. } => {
            format!("{value} is not possible: it must be {allowed}")
        }
        other => other.to_string(),
    }
}
