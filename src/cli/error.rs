//! What a command returns when it fails: the fact on one line, and advice.

use std::error::Error;
use std::fmt::Display;

use super::exit::Exit;
use super::hints;
use crate::interrupt::Signal;
use crate::shown;

/// A failed command.
///
/// Any library error becomes one with `?`: its message and its causes are the
/// fact, and [`hints`] finds the advice from its type. It is deliberately not
/// an [`Error`] itself, so that the conversion can be for all of them.
#[derive(Debug)]
pub struct CliError {
    fact: String,
    hint: Option<String>,
    exit: Exit,
    quiet: bool,
}

impl CliError {
    /// A fact that no library error states; exit code 1.
    pub fn new(fact: impl Display) -> Self {
        Self {
            fact: shown::line(&fact.to_string()),
            hint: None,
            exit: Exit::Failed,
            quiet: false,
        }
    }

    /// The command stopped in good order because of `signal`; exit code 128 + its number.
    pub fn interrupted(signal: Signal, fact: impl Display) -> Self {
        Self {
            exit: Exit::Signal(signal),
            ..Self::new(fact)
        }
    }

    /// The reader of stdout has gone: nothing is left to write, and nothing failed.
    pub(super) fn stdout_closed() -> Self {
        Self {
            exit: Exit::Done,
            quiet: true,
            ..Self::new("stdout was closed")
        }
    }

    /// Another process has stated what happened; this one ends as it did.
    #[cfg(feature = "console")]
    pub(super) fn stated(exit: Exit) -> Self {
        Self {
            exit,
            quiet: true,
            ..Self::new("stated before")
        }
    }

    /// The same error with this advice instead of any other.
    pub fn hint(mut self, hint: impl Display) -> Self {
        self.hint = Some(shown::line(&hint.to_string()));
        self
    }

    /// The fact, one line.
    pub fn fact(&self) -> &str {
        &self.fact
    }

    /// The advice, if there is any.
    pub fn advice(&self) -> Option<&str> {
        self.hint.as_deref()
    }

    /// How the program ends because of it.
    pub fn exit(&self) -> Exit {
        self.exit
    }

    /// `error: …`, a blank line, `hint: …`; empty if there is nothing to say.
    pub fn render(&self, color: bool) -> String {
        if self.quiet {
            return String::new();
        }
        let (red, cyan, plain) = if color {
            ("\x1b[1;31m", "\x1b[1;36m", "\x1b[0m")
        } else {
            ("", "", "")
        };
        let mut text = format!("{red}error:{plain} {}\n", self.fact);
        if let Some(hint) = &self.hint {
            text += &format!("\n{cyan}hint:{plain} {hint}\n");
        }
        text
    }
}

impl<E: Error + Send + Sync + 'static> From<E> for CliError {
    fn from(error: E) -> Self {
        Self {
            hint: hints::for_error(&error).or_else(|| Some(hints::FALLBACK.to_owned())),
            ..Self::new(shown::with_causes(&error))
        }
    }
}

/// Advice given where the error is raised.
pub trait HintExt<T> {
    /// On failure, this advice instead of the one that belongs to the error's type.
    fn hint(self, hint: impl Display) -> Result<T, CliError>;
}

impl<T, E: Into<CliError>> HintExt<T> for Result<T, E> {
    fn hint(self, hint: impl Display) -> Result<T, CliError> {
        self.map_err(|error| error.into().hint(hint))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("rig.toml: cannot be read")]
    struct Outer(#[source] std::io::Error);

    #[derive(Debug, thiserror::Error)]
    #[error("rig.toml: {0}")]
    struct Quoting(#[source] std::io::Error);

    fn denied() -> std::io::Error {
        std::io::Error::other("permission\n  denied")
    }

    #[test]
    fn causes_are_joined_on_one_line_and_not_repeated() {
        assert_eq!(
            CliError::from(Outer(denied())).hint("look").render(false),
            "error: rig.toml: cannot be read: permission denied\n\nhint: look\n"
        );
        assert_eq!(
            CliError::from(Quoting(denied())).fact,
            "rig.toml: permission denied"
        );
    }

    #[test]
    fn interruption_has_the_signals_code() {
        let error = CliError::interrupted(Signal::Terminate, "stopped after light 2 of 4");
        assert_eq!(error.exit().code(), 143);
    }
}
