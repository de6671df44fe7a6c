//! Progress on stderr, silent where nobody watches.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::Context;
use super::stderr::Drawing;

/// Drawings per second at most.
const RATE_HZ: u8 = 20;

impl Context {
    /// What bars draw on: stderr through its queue, or nothing where nobody watches.
    pub fn draw_target(&self) -> ProgressDrawTarget {
        if !self.shows_progress() {
            return ProgressDrawTarget::hidden();
        }
        ProgressDrawTarget::term_like_with_hz(Box::new(Drawing::default()), RATE_HZ)
    }

    /// A bar over `length` steps of `unit`, with the time left.
    pub fn bar(&self, length: u64, unit: &str) -> ProgressBar {
        let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{eta}} left {{msg}}");
        let style = ProgressStyle::with_template(&template);
        ProgressBar::with_draw_target(Some(length), self.draw_target())
            .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    }

    /// A spinner whose message says what is being done.
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
