//! The person at the bench of a calibration, asked at the terminal or, with `--events`, by the
//! program that reads the events.

use std::io::{BufRead, IsTerminal};

use indicatif::ProgressBar;

use crate::calibrating::Attendant;
use crate::capture::event_lines::EventLines;
use crate::capture::remote_operator::RemoteOperator;
use crate::cli::output::write_stderr;
use crate::cli::{CliError, Context};

/// Who is asked.
pub(super) fn attendant(events: bool, context: &Context) -> Result<Box<dyn Attendant>, CliError> {
    Ok(match events {
        true => Box::new(RemoteOperator::of(&EventLines::start()?)),
        false => Box::new(Terminal(ProgressBar::with_draw_target(
            Some(0),
            context.draw_target(),
        ))),
    })
}

/// Asks on stderr and receives on stdin; shows a bar, and clears it at last.
struct Terminal(ProgressBar);

impl Drop for Terminal {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

impl Attendant for Terminal {
    fn cover(&self, cover: bool) -> bool {
        let what = if cover { "Cover" } else { "Uncover" };
        ask(&format!("{what} the lens"))
    }

    fn switch(&self, on: bool) -> bool {
        let what = if on { "on" } else { "off" };
        ask(&format!(
            "Switch the light {what} and leave the room as it is"
        ))
    }

    fn progress(&self, done: u64, of: u64) {
        self.0.set_length(of);
        self.0.set_position(done);
    }
}

/// `false` without a terminal.
fn ask(what: &str) -> bool {
    if !std::io::stdin().is_terminal() {
        return false;
    }
    write_stderr(&format!("{what}, then press Enter: "));
    std::io::stdin()
        .lock()
        .lines()
        .next()
        .is_some_and(|line| line.is_ok())
}
