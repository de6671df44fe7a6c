//! What every command is given: notes, warnings and progress for the terminal.

use std::io::IsTerminal;

use super::output::write_stderr;
use crate::shown::escaped;

/// What every command gets in addition to its own arguments.
#[derive(Clone, Debug)]
pub struct Context {
    quiet: bool,
    pub(super) color: bool,
}

impl Context {
    /// `quiet` drops notes and progress; `color` colours warnings.
    pub fn new(quiet: bool, color: bool) -> Self {
        Self { quiet, color }
    }

    /// A remark for the person at the terminal, on stderr; `--quiet` drops it.
    pub fn note(&self, text: impl std::fmt::Display) {
        if !self.quiet {
            write_stderr(&format!("{}\n", escaped(&text.to_string())));
        }
    }

    /// [`Self::note`] of several lines, each [`escaped`] by itself.
    pub fn note_lines(&self, lines: impl IntoIterator<Item = impl std::fmt::Display>) {
        lines.into_iter().for_each(|line| self.note(line));
    }

    /// A remark that matters: `warning: …` on stderr, also with `--quiet`.
    pub fn warn(&self, text: impl std::fmt::Display) {
        self.warn_lines(&[&text.to_string()]);
    }

    /// [`Self::warn`] with the likely cause on a line of its own.
    pub fn warn_of(&self, what: &str, likely_cause: &str) {
        self.warn_lines(&[what, &format!("  likely: {likely_cause}")]);
    }

    fn warn_lines(&self, lines: &[&str]) {
        let (yellow, plain) = if self.color {
            ("\x1b[1;33m", "\x1b[0m")
        } else {
            ("", "")
        };
        let lines: Vec<_> = lines.iter().map(|line| escaped(line)).collect();
        write_stderr(&format!("{yellow}warning:{plain} {}\n", lines.join("\n")));
    }

    /// Whether to draw progress bars: stderr is a terminal and nobody asked for quiet.
    pub fn shows_progress(&self) -> bool {
        !self.quiet && std::io::stderr().is_terminal()
    }
}
