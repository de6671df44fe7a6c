//! The person at the bench of a calibration, asked at the terminal.

use std::io::{BufRead, IsTerminal};

use indicatif::ProgressBar;

use crate::calibrating::Attendant;
use crate::cli::Context;
use crate::cli::output::write_stderr;

/// Asks on stderr and receives on stdin; shows a bar.
pub(super) struct Terminal(ProgressBar);

impl Terminal {
    pub fn new(context: &Context) -> Self {
        Self(ProgressBar::with_draw_target(
            Some(0),
            context.draw_target(),
        ))
    }

    /// Clears the bar.
    pub fn finish(self) {
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
