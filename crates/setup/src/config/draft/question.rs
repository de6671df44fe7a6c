//! A question of `rig init`: what is asked, in which unit, and what may be answered.

use std::borrow::Cow;

use serde::Serialize;

use super::answer::{Answer, AnswerError, Answers};

/// A question, as the terminal asks it and as `--questions --json` lists it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Question {
    /// Name of its answer.
    pub key: &'static str,
    /// What is asked, a few words.
    pub title: &'static str,
    /// Why, and where to find the answer: one line.
    pub help: Cow<'static, str>,
    /// What kind of answer it takes.
    pub kind: Kind,
    /// Unit of a number.
    pub unit: Option<&'static str>,
    /// Whether a number must be whole.
    pub whole: bool,
    /// What may be chosen; empty for other kinds.
    pub choices: Vec<Choice>,
    /// Whether a choice also takes a text that is none of the listed ones: a device that is
    /// not connected now.
    pub others: bool,
    /// The answer that is taken where none is given; `None`: one must be given.
    pub default: Option<Answer>,
    /// Smallest number.
    pub least: Option<f64>,
    /// Largest number.
    pub most: Option<f64>,
    /// It is asked only with these answers to another question; `None`: always.
    pub when: Option<When>,
    /// What a text must be, where not every text is an answer.
    #[serde(skip)]
    pub(super) text: Option<TextRule>,
}

/// What a text must be.
#[derive(Clone, Copy, Debug)]
pub(super) struct TextRule {
    pub allowed: &'static str,
    pub accepts: fn(&str) -> bool,
}

impl PartialEq for TextRule {
    fn eq(&self, other: &Self) -> bool {
        self.allowed == other.allowed
    }
}

/// What kind of answer a question takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// One of a list.
    Choice,
    /// A number in the question's unit.
    Number,
    /// A text.
    Text,
    /// Yes or no.
    YesNo,
}

/// One of the answers that may be chosen.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Choice {
    /// The answer.
    pub value: String,
    /// What a person reads.
    pub label: String,
}

/// The answers to another question with which a question is asked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct When {
    /// Name of the other answer, whose question comes before.
    pub key: &'static str,
    /// Any of these.
    pub is: Vec<Answer>,
}

impl Question {
    /// Whether it is asked, with these answers to the questions before it.
    pub fn applies(&self, answers: &Answers) -> bool {
        let Some(when) = &self.when else {
            return true;
        };
        answers
            .get(when.key)
            .is_some_and(|answer| when.is.contains(answer))
    }

    /// Default, or unit, of an answer that is asked for: a choice by its number, from 1.
    pub fn prompt(&self) -> String {
        let Some(default) = &self.default else {
            return format!("({})", self.unit.unwrap_or("needed"));
        };
        let is_default = |choice: &Choice| default.text() == Some(choice.value.as_str());
        let shown = match (self.kind, self.choices.iter().position(is_default)) {
            (Kind::Choice, Some(index)) => (index + 1).to_string(),
            _ => default.to_string(),
        };
        let unit = self.unit.map_or(String::new(), |unit| format!(" {unit}"));
        format!("[{shown}{unit}]")
    }

    /// What may be answered, to complete "must be …".
    pub fn allowed(&self) -> String {
        match self.kind {
            Kind::YesNo => "yes or no".to_owned(),
            Kind::Text => self
                .text
                .map_or("one or more characters", |rule| rule.allowed)
                .to_owned(),
            Kind::Choice => {
                let values = self.choices.iter().map(|choice| choice.value.as_str());
                let listed = values.collect::<Vec<_>>().join(", ");
                match (self.others, self.text) {
                    (true, Some(rule)) => format!("{listed}, or {}", rule.allowed),
                    _ => format!("one of {listed}"),
                }
            }
            Kind::Number => {
                let number = if self.whole {
                    "a whole number"
                } else {
                    "a number"
                };
                let unit = self.unit.map_or(String::new(), |unit| format!(" ({unit})"));
                let [least, most] = [self.least, self.most].map(Option::unwrap_or_default);
                format!("{number} from {least} to {most}{unit}")
            }
        }
    }

    /// The answer that a typed text stands for. A number of a choice's list, counted from 1,
    /// stands for that choice.
    ///
    /// # Errors
    /// [`AnswerError::Invalid`].
    pub fn typed(&self, text: &str) -> Result<Answer, AnswerError> {
        let text = text.trim();
        let answer = match self.kind {
            Kind::Choice => {
                let number = text.parse::<usize>().ok();
                let listed = number.and_then(|n| self.choices.get(n.checked_sub(1)?));
                Answer::Text(listed.map_or(text, |choice| &choice.value).to_owned())
            }
            _ => Answer::Text(text.to_owned()),
        };
        self.checked(&answer)
    }

    /// The answer in this question's own kind.
    ///
    /// # Errors
    /// [`AnswerError::Invalid`] where it is of another kind or outside the range.
    pub fn checked(&self, answer: &Answer) -> Result<Answer, AnswerError> {
        let found = match self.kind {
            Kind::Number => answer
                .number()
                .filter(|&n| self.least.is_none_or(|least| n >= least))
                .filter(|&n| self.most.is_none_or(|most| n <= most))
                .filter(|n| !self.whole || n.fract() == 0.0)
                .map(Answer::Number),
            Kind::YesNo => answer.flag().map(Answer::Flag),
            Kind::Text => answer
                .text()
                .filter(|text| !text.is_empty() && !text.chars().any(char::is_control))
                .filter(|text| self.text.is_none_or(|rule| (rule.accepts)(text)))
                .map(|text| Answer::Text(text.to_owned())),
            Kind::Choice => answer
                .text()
                .filter(|text| self.is_choice(text))
                .map(|text| Answer::Text(text.to_owned())),
        };
        found.ok_or_else(|| self.invalid(answer))
    }

    fn is_choice(&self, text: &str) -> bool {
        let listed = self.choices.iter().any(|choice| choice.value == text);
        let other = self.others
            && !text.chars().any(char::is_control)
            && self.text.is_some_and(|rule| (rule.accepts)(text));
        listed || other
    }

    fn invalid(&self, answer: &Answer) -> AnswerError {
        AnswerError::Invalid {
            key: self.key,
            value: answer.to_string(),
            allowed: self.allowed(),
        }
    }
}
