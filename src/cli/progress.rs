//! Progress on stderr, hidden where stderr is no terminal.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::context::Context;
use super::stderr::Drawing;
use crate::progress::Progress;

/// Drawings per second at most.
const RATE_HZ: u8 = 20;

/// A bar of some work's parts of the whole.
const PARTS: &str = "{bar:30} {percent:>3}%  {wide_msg}";

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// A bar that counts the steps of some work; a spinner becomes one where their number is known.
pub struct Counting<'a>(pub &'a ProgressBar);

impl Progress for Counting<'_> {
    fn begin(&self, _: &str, steps: Option<usize>) {
        if let (Some(steps), None) = (steps, self.0.length()) {
            self.0.set_style(style(PARTS));
            self.0.set_length(steps as u64);
        }
    }

    fn advance(&self, steps: usize) {
        self.0.inc(steps as u64);
    }
}

impl Context {
    /// What bars draw on: stderr through its queue, or nothing where progress is hidden.
    pub fn draw_target(&self) -> ProgressDrawTarget {
        if !self.shows_progress() {
            return ProgressDrawTarget::hidden();
        }
        ProgressDrawTarget::term_like_with_hz(Box::new(Drawing::default()), RATE_HZ)
    }

    /// A bar over `length` steps of `unit`, with the time left.
    pub fn bar(&self, length: u64, unit: &str) -> ProgressBar {
        let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{eta}} left {{msg}}");
        ProgressBar::with_draw_target(Some(length), self.draw_target()).with_style(style(&template))
    }

    /// A bar for work of which parts are known by name, with the time left.
    pub fn staged_bar(&self) -> StagedBar {
        let bar = ProgressBar::with_draw_target(Some(STEPS), self.draw_target());
        bar.set_style(style(PARTS));
        if self.shows_progress() {
            // Drawn anew after a remark.
            bar.enable_steady_tick(Duration::from_secs(1));
        }
        StagedBar {
            bar,
            began: Instant::now(),
        }
    }

    /// A spinner whose message names what is being done.
    pub fn spinner(&self) -> ProgressBar {
        if !self.shows_progress() {
            return ProgressBar::hidden();
        }
        let style = ProgressStyle::default_spinner();
        let spinner = ProgressBar::with_draw_target(None, self.draw_target()).with_style(style);
        spinner.enable_steady_tick(Duration::from_millis(120));
        spinner
    }
}

/// Steps of a bar that is fed with parts of the whole.
const STEPS: u64 = 1000;
/// Part of the whole before which the remaining time cannot be estimated.
const LEAST_DONE: f64 = 0.02;

/// A bar that is fed with the name of a stage and the part of the whole that is done.
pub struct StagedBar {
    bar: ProgressBar,
    began: Instant,
}

impl StagedBar {
    /// `done` of the whole, 0 to 1, proportional to time as far as that is known.
    pub fn at(&self, stage: &str, done: f64) {
        let done = done.clamp(0.0, 1.0);
        self.bar.set_position((done * STEPS as f64) as u64);
        self.bar
            .set_message(staged(stage, done, self.began.elapsed().as_secs_f64()));
    }

    /// Clears the line.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// The text of a bar, with the time left once the pace is known.
fn staged(stage: &str, done: f64, elapsed_s: f64) -> String {
    if done < LEAST_DONE {
        return stage.to_owned();
    }
    let left_s = elapsed_s * (1.0 - done) / done;
    format!("{stage}; {} left", duration(left_s))
}

/// `47 s`, `3 min 20 s`, `2 h 5 min`.
pub fn duration(seconds: f64) -> String {
    let seconds = seconds.max(0.0).round() as u64;
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, min, s) => format!("{min} min {s} s"),
        (h, min, _) => format!("{h} h {min} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_two_units_at_most() {
        for (seconds, text) in [
            (-3.0, "0 s"),
            (46.6, "47 s"),
            (59.6, "1 min 0 s"),
            (200.0, "3 min 20 s"),
            (7500.0, "2 h 5 min"),
        ] {
            assert_eq!(duration(seconds), text);
        }
        assert_eq!(staged("tracing", 0.0, 5.0), "tracing");
        assert_eq!(staged("tracing", 0.25, 5.0), "tracing; 15 s left");
    }
}
