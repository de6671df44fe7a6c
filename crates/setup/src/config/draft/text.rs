//! The commented rig file of a bench: the template with the answers in it.

use minijinja::syntax::SyntaxConfig;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, Error, ErrorKind, UndefinedBehavior};
use serde::Serialize;

use super::answer::Answers;
use super::derived::Derived;
use super::found::Found;

/// The rig file of complete answers, with a comment for every key.
pub fn text(answers: &Answers, found: &Found) -> String {
    render(answers, found).expect("the embedded template fits complete answers (tested)")
}

fn render(answers: &Answers, found: &Found) -> Result<String, Error> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    let mut syntax = SyntaxConfig::builder();
    syntax.trim_blocks(true).keep_trailing_newline(true);
    environment.set_syntax(syntax.build()?);
    environment.add_filter("toml", as_toml);
    environment.add_template("rig_file.toml", include_str!("rig_file.toml.j2"))?;
    environment
        .get_template("rig_file.toml")?
        .render(Value::from(Serde(Page {
            answers,
            each: answers,
            derived: Derived::of(answers, found),
        })))
}

/// What the template takes: each answer by its key, and all as `answers`.
#[derive(Serialize)]
struct Page<'a> {
    answers: &'a Answers,
    #[serde(flatten)]
    each: &'a Answers,
    #[serde(flatten)]
    derived: Derived<'a>,
}

/// A text as TOML quotes it; a number to a millionth.
fn as_toml(value: Value) -> Result<String, Error> {
    if let Some(text) = value.as_str() {
        return Ok(toml::Value::String(text.to_owned()).to_string());
    }
    let number = f64::try_from(value)
        .map_err(|error| Error::new(ErrorKind::InvalidOperation, error.to_string()))?;
    Ok(format!("{:?}", (number * 1e6).round() / 1e6 + 0.0))
}
