//! The person at the bench of a manual stage, asked at the terminal.

use std::io::{BufRead, IsTerminal};

use super::error::CliError;
use super::output::write_stderr;
use crate::device::manual::{Operator, Request};
use crate::device::{LampChannel, LampState};

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

fn words(request: Request) -> String {
    match request {
        Request::Place { light, angles } => {
            format!("place the light at direction {light}: {angles}")
        }
        Request::Lamp(LampState::Off) => "turn the lamp off".to_owned(),
        Request::Lamp(LampState::On(LampChannel(channel))) => {
            format!("turn on channel {channel} of the lamp, and no other")
        }
    }
}

impl Operator for Terminal {
    fn ask(&self, request: Request) -> bool {
        let question = words(request);
        write_stderr(&format!(
            "\n{question}, then press Enter (n and Enter: not possible) "
        ));
        let mut answer = String::new();
        let heard = std::io::stdin().lock().read_line(&mut answer);
        heard.is_ok_and(|bytes| bytes > 0) && !answer.trim().eq_ignore_ascii_case("n")
    }

    fn tell(&self, request: Request) {
        write_stderr(&format!("\n{} now\n", words(request)));
    }
}
