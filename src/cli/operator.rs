//! The person at the bench of a manual stage, asked at the terminal or, where `--events` is given
//! and stdin is none, by the program that reads the events.

use std::io::{BufRead, IsTerminal};
use std::sync::Arc;

use super::error::CliError;
use super::output::write_stderr;
use crate::capture::event_lines::EventLines;
use crate::capture::remote_operator::RemoteOperator;
use crate::device::manual::{Operator, Request};

/// Asks on stderr, receives on stdin.
pub struct Terminal(());

impl Terminal {
    /// An error where nobody sits at the terminal.
    pub fn new() -> Result<Self, CliError> {
        if std::io::stdin().is_terminal() && std::io::stderr().is_terminal() {
            return Ok(Self(()));
        }
        Err(CliError::new(
            "a manual stage needs its operator at a terminal, and stdin or stderr is no terminal",
        )
        .hint("run it in a terminal, without redirecting stdin or stderr"))
    }
}

impl Operator for Terminal {
    fn ask(&self, request: Request) -> bool {
        write_stderr(&format!(
            "\n{request}, then press Enter (n and Enter: not possible) "
        ));
        let mut answer = String::new();
        let heard = std::io::stdin().lock().read_line(&mut answer);
        heard.is_ok_and(|bytes| bytes > 0) && !answer.trim().eq_ignore_ascii_case("n")
    }

    fn tell(&self, request: Request) {
        write_stderr(&format!("\n{request} now\n"));
    }
}

/// Who is asked in a capture: the reader of its events where it has some and no terminal.
pub fn of_capture(lines: Option<&EventLines>) -> Result<Arc<dyn Operator>, CliError> {
    match lines {
        Some(lines) if !std::io::stdin().is_terminal() => Ok(Arc::new(RemoteOperator::of(lines))),
        _ => Ok(Arc::new(Terminal::new()?)),
    }
}
