//! How far a fit is, and its verdict, at the terminal.

use std::sync::{Mutex, PoisonError};

use super::Context;
use super::progress::StagedBar;
use crate::capture;
use crate::capture::event_lines::EventLines;
use crate::progress::Progress;
use crate::session::fit_record::{FitRecord, Warning};
use crate::workflow::{Notice, Observer};

/// A bar that follows a fit's phases, with the notices in between.
pub struct FitProgress<'a> {
    context: &'a Context,
    lines: Option<&'a EventLines>,
    bar: StagedBar,
    /// Part of the whole that is over, as last reported.
    over: Mutex<f64>,
}

impl<'a> FitProgress<'a> {
    /// At the beginning; phases are also reported to `lines`.
    pub(super) fn new(context: &'a Context, lines: Option<&'a EventLines>) -> Self {
        Self {
            context,
            lines,
            bar: context.staged_bar(),
            over: Mutex::default(),
        }
    }

    /// Clears the line, and prints warnings and verdict.
    pub fn finish(self, record: &FitRecord) {
        self.bar.finish();
        for Warning {
            what, likely_cause, ..
        } in &record.warnings
        {
            self.context.warn_of(what, likely_cause);
        }
        self.context
            .note(format!("verdict: {}", record.verdict().sentence()));
    }
}

impl Progress for FitProgress<'_> {
    fn begin(&self, phase: &str, _: Option<usize>) {
        let done = *self.over.lock().unwrap_or_else(PoisonError::into_inner);
        self.bar.at(phase, done);
        if let Some(lines) = self.lines {
            lines.send(&capture::Progress::Fit {
                stage: phase.to_owned(),
                done,
            });
        }
    }
}

impl Observer for FitProgress<'_> {
    fn notice(&self, notice: Notice<'_>) {
        self.context.notice(notice);
    }

    fn part_over(&self, part: f64) {
        *self.over.lock().unwrap_or_else(PoisonError::into_inner) = part;
    }
}
