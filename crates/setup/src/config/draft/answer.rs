//! Answers to the questions of a new rig file.

use std::collections::BTreeMap;
use std::fmt::{self, Display};

use serde::{Deserialize, Serialize};

use crate::shown::excerpt;

/// An answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Answer {
    /// Yes or no.
    Flag(bool),
    /// A number.
    Number(f64),
    /// A text, or the value of a choice.
    Text(String),
}

impl Answer {
    /// The finite number that it is or that its text says.
    pub fn number(&self) -> Option<f64> {
        let number = match self {
            Answer::Number(number) => Some(*number),
            Answer::Text(text) => text.trim().parse().ok(),
            Answer::Flag(_) => None,
        };
        number.filter(|number: &f64| number.is_finite())
    }

    /// Yes or no.
    pub fn flag(&self) -> Option<bool> {
        match self {
            Answer::Flag(flag) => Some(*flag),
            Answer::Text(text) => match text.trim().to_ascii_lowercase().as_str() {
                "yes" | "y" | "true" => Some(true),
                "no" | "n" | "false" => Some(false),
                _ => None,
            },
            Answer::Number(_) => None,
        }
    }

    /// Its text.
    pub fn text(&self) -> Option<&str> {
        match self {
            Answer::Text(text) => Some(text.trim()),
            Answer::Flag(_) | Answer::Number(_) => None,
        }
    }
}

impl Display for Answer {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Answer::Flag(true) => write!(out, "yes"),
            Answer::Flag(false) => write!(out, "no"),
            Answer::Number(number) => write!(out, "{number}"),
            Answer::Text(text) => write!(out, "{}", excerpt(text)),
        }
    }
}

impl From<&str> for Answer {
    fn from(text: &str) -> Self {
        Answer::Text(text.to_owned())
    }
}

impl From<f64> for Answer {
    fn from(number: f64) -> Self {
        Answer::Number(number)
    }
}

impl From<bool> for Answer {
    fn from(flag: bool) -> Self {
        Answer::Flag(flag)
    }
}

/// What is wrong with answers.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum AnswerError {
    /// Of another kind, or outside the range.
    #[error("the answer `{key}` is {value}, but must be {allowed}")]
    Invalid {
        key: &'static str,
        value: String,
        allowed: String,
    },
    /// Not given, and there is no default.
    #[error("the answer `{key}` is missing; it must be {allowed}")]
    Missing { key: &'static str, allowed: String },
    #[error("there is no question `{}`; known: {}", excerpt(key), known.join(", "))]
    Unknown {
        key: String,
        known: Vec<&'static str>,
    },
}

impl AnswerError {
    /// The question that the answer belongs to.
    pub fn key(&self) -> &str {
        match self {
            Self::Invalid { key, .. } | Self::Missing { key, .. } => key,
            Self::Unknown { key, .. } => key,
        }
    }
}

/// Answers by the key of their question.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Answers(BTreeMap<String, Answer>);

impl Answers {
    /// The answer to a question, if it was given.
    pub fn get(&self, key: &str) -> Option<&Answer> {
        self.0.get(key)
    }

    /// Takes an answer, in place of an earlier one.
    pub fn set(&mut self, key: &str, answer: Answer) {
        self.0.insert(key.to_owned(), answer);
    }

    /// Takes an answer back.
    pub fn remove(&mut self, key: &str) {
        self.0.remove(key);
    }

    /// Names of all answers.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// A number that was answered.
    pub(super) fn number(&self, key: &str) -> Option<f64> {
        self.get(key)?.number()
    }

    /// A text that was answered.
    pub(super) fn text(&self, key: &str) -> Option<&str> {
        self.get(key)?.text()
    }

    /// A whole number that was answered.
    pub(super) fn whole(&self, key: &str) -> Option<u32> {
        self.number(key).map(|number| number as u32)
    }
}
