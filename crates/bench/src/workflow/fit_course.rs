//! How much of a fit's time is over when each of its phases begins.

use std::sync::{Mutex, PoisonError};

use super::notice::{Notice, Observer};
use crate::progress::Progress;

/// Phases of one estimate of the material, as they are reported, and the part of its time that is
/// over when each begins; a first, quick solution comes before the one on all paths.
const ONE_ESTIMATE: [(&str, f64); 7] = [
    ("direct reflection", 0.0),
    ("tracing paths", 0.07),
    ("optimising", 0.16),
    ("direct reflection", 0.2),
    ("tracing paths", 0.2),
    ("optimising", 0.68),
    ("uncertainty", 0.84),
];
/// Of two estimates, on the same paths.
const TWO_ESTIMATES: [(&str, f64); 10] = [
    ("direct reflection", 0.0),
    ("tracing paths", 0.06),
    ("optimising", 0.13),
    ("optimising", 0.17),
    ("direct reflection", 0.2),
    ("tracing paths", 0.2),
    ("optimising", 0.45),
    ("uncertainty", 0.6),
    ("optimising", 0.75),
    ("uncertainty", 0.87),
];
/// Phases after all estimates, and the part of the fit's time that is over when each begins.
const CLOSING: [(&str, f64); 3] = [
    ("diagnosis", 0.88),
    ("scoring", 0.9),
    ("longer paths", 0.96),
];
/// Part of the time that the rounds of a refinement take, and their number until it settles,
/// usually.
const ROUNDS_PART: f64 = 0.85;
const USUAL_ROUNDS: f64 = 6.0;

/// Hands on what a fit reports, and before each phase how much of the fit is over.
pub(super) struct Course<'a> {
    observer: &'a dyn Observer,
    reached: Mutex<Reached>,
}

/// Where a fit is.
struct Reached {
    /// What is to come, and what of the whole is over then.
    phases: Vec<(&'static str, f64)>,
    next: usize,
    rounds: u32,
    over: f64,
}

impl<'a> Course<'a> {
    /// Of a fit that makes one estimate of the material or two, after the bench was refined or
    /// not.
    pub(super) fn new(
        observer: &'a dyn Observer,
        two_estimates: bool,
        refines_bench: bool,
    ) -> Self {
        let reached = Mutex::new(Reached::new(two_estimates, refines_bench));
        Self { observer, reached }
    }

    /// All is over.
    pub(super) fn end(&self) {
        self.observer.part_over(1.0);
    }
}

impl Reached {
    fn new(two_estimates: bool, refines_bench: bool) -> Self {
        let [(_, estimated), ..] = CLOSING;
        let estimates = match two_estimates {
            true => &TWO_ESTIMATES[..],
            false => &ONE_ESTIMATE[..],
        };
        let estimates = estimates
            .iter()
            .map(|(phase, over)| (*phase, estimated * over));
        let rounds = if refines_bench { ROUNDS_PART } else { 0.0 };
        let phases = estimates.chain(CLOSING);
        Self {
            phases: phases
                .map(|(phase, over)| (phase, rounds + (1.0 - rounds) * over))
                .collect(),
            next: 0,
            rounds: 0,
            over: 0.0,
        }
    }

    /// The part of the whole that is over when `phase` begins; it never falls.
    fn at(&mut self, phase: &str) -> f64 {
        let ahead = self.phases[self.next..].iter();
        let over = match ahead.zip(self.next..).find(|((name, _), _)| *name == phase) {
            Some(((_, over), at)) => {
                self.next = at + 1;
                *over
            }
            // A round of the refinement: each takes some of what is left.
            None => {
                self.rounds += 1;
                let before = f64::from(self.rounds - 1) / USUAL_ROUNDS;
                ROUNDS_PART * (1.0 - (-before).exp())
            }
        };
        self.over = self.over.max(over);
        self.over
    }
}

impl Progress for Course<'_> {
    fn begin(&self, phase: &str, steps: Option<usize>) {
        let mut reached = self.reached.lock().unwrap_or_else(PoisonError::into_inner);
        self.observer.part_over(reached.at(phase));
        self.observer.begin(phase, steps);
    }

    fn advance(&self, steps: usize) {
        self.observer.advance(steps);
    }

    fn pulse(&self) {
        self.observer.pulse();
    }
}

impl Observer for Course<'_> {
    fn notice(&self, notice: Notice<'_>) {
        self.observer.notice(notice);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Phases come twice and more often; the part that is over grows with each all the same.
    #[test]
    fn the_part_that_is_over_grows() {
        let names = |phases: &[(&'static str, f64)]| -> Vec<_> {
            phases.iter().map(|(phase, _)| *phase).collect()
        };
        let rounds = ["round 1", "round 2", "what is left open"];
        for (two_estimates, refines_bench) in
            [(false, false), (true, false), (false, true), (true, true)]
        {
            let mut reached = Reached::new(two_estimates, refines_bench);
            let estimates = match two_estimates {
                true => names(&TWO_ESTIMATES),
                false => names(&ONE_ESTIMATE),
            };
            let before = rounds.into_iter().filter(|_| refines_bench);
            let phases = before.chain(estimates).chain(names(&CLOSING));
            let parts: Vec<f64> = phases.map(|phase| reached.at(phase)).collect();
            assert_eq!(parts[0], 0.0);
            assert!(parts.is_sorted(), "{parts:?}");
            let last = parts[parts.len() - 1];
            assert!((0.9..1.0).contains(&last), "{last}");
        }
    }
}
