//! How far a fit is, and its verdict, at the terminal.

use std::sync::{Mutex, PoisonError};

use super::Context;
use super::capture_events::EventLines;
use super::progress::StagedBar;
use crate::capture;
use crate::progress::Progress;
use crate::session::fit_record::{FitRecord, Warning};
use crate::workflow::{Notice, Observer};

/// Phases of a fit, and of a prediction after it, as the library names them, and the part of its time that is over when each
/// begins; a first, quick solution comes before the one on all paths.
const PHASES: [(&str, f64); 11] = [
    ("direct reflection", 0.0),
    ("tracing paths", 0.06),
    ("optimising", 0.14),
    ("direct reflection", 0.18),
    ("tracing paths", 0.18),
    ("optimising", 0.6),
    ("uncertainty", 0.74),
    ("diagnosis", 0.88),
    ("scoring", 0.9),
    ("longer paths", 0.96),
    ("predicting", 0.98),
];
/// Part of the time that the rounds of a refinement take, and their number until it settles,
/// usually.
const ROUNDS_PART: f64 = 0.85;
const USUAL_ROUNDS: f64 = 6.0;

/// A bar that follows a fit's phases, with the notices in between.
pub struct FitProgress<'a> {
    context: &'a Context,
    lines: Option<&'a EventLines>,
    bar: StagedBar,
    reached: Mutex<Reached>,
}

#[derive(Default)]
struct Reached {
    refines_bench: bool,
    rounds: u32,
    next: usize,
}

impl<'a> FitProgress<'a> {
    /// At the beginning; phases are also reported to `lines`.
    pub(super) fn new(context: &'a Context, lines: Option<&'a EventLines>) -> Self {
        Self {
            context,
            lines,
            bar: context.staged_bar(),
            reached: Mutex::default(),
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

impl Reached {
    /// The part of the fit's time that is over when `phase` begins.
    fn part_over(&mut self, phase: &str) -> f64 {
        let ahead = PHASES[self.next..]
            .iter()
            .position(|(name, _)| *name == phase);
        let Some(ahead) = ahead else {
            // A round of the refinement: each takes some of what is left.
            self.rounds += 1;
            let over = f64::from(self.rounds - 1) / USUAL_ROUNDS;
            return ROUNDS_PART * (1.0 - (-over).exp());
        };
        self.next += ahead;
        let (_, over) = PHASES[self.next];
        self.next += 1;
        if self.refines_bench {
            ROUNDS_PART + (1.0 - ROUNDS_PART) * over
        } else {
            over
        }
    }
}

impl Progress for FitProgress<'_> {
    fn begin(&self, phase: &str, _: Option<usize>) {
        let mut reached = self.reached.lock().unwrap_or_else(PoisonError::into_inner);
        let done = reached.part_over(phase);
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
        if let Notice::Work(work) = notice {
            let mut reached = self.reached.lock().unwrap_or_else(PoisonError::into_inner);
            reached.refines_bench = work.refines_bench;
        }
        self.context.notice(notice);
    }
}
