//! Which answers a list of questions takes, and what stands for those that were not given.

use super::answer::{AnswerError, Answers};
use super::question::Question;

/// Checks each answer alone.
///
/// # Errors
/// [`AnswerError::Unknown`], [`AnswerError::Invalid`].
pub fn check(questions: &[Question], answers: &Answers) -> Result<(), AnswerError> {
    for key in answers.keys() {
        if !questions.iter().any(|question| question.key == key) {
            return Err(AnswerError::Unknown {
                key: key.to_owned(),
                known: questions.iter().map(|question| question.key).collect(),
            });
        }
    }
    for question in questions {
        if let Some(answer) = answers.get(question.key)
            && question.applies(answers)
        {
            question.checked(answer)?;
        }
    }
    Ok(())
}

/// The answers to the questions that are asked with them, each in its question's kind, and
/// the defaults for those that were not answered. Answers to questions that are not asked
/// are left out.
pub fn complete(questions: &[Question], answers: &Answers) -> Result<Answers, AnswerError> {
    check(questions, answers)?;
    let mut complete = Answers::default();
    for question in questions {
        if !question.applies(&complete) {
            continue;
        }
        let given = answers.get(question.key).or(question.default.as_ref());
        let Some(given) = given else {
            return Err(AnswerError::Missing {
                key: question.key,
                allowed: question.allowed(),
            });
        };
        complete.set(question.key, question.checked(given)?);
    }
    Ok(complete)
}
