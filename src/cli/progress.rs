//! Progress on stderr, silent where nobody watches.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use super::Context;

impl Context {
    /// A bar over `length` steps of `unit`, with the time left.
    pub fn bar(&self, length: u64, unit: &str) -> ProgressBar {
        if !self.shows_progress() {
            return ProgressBar::hidden();
        }
        let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{eta}} left {{msg}}");
        let style = ProgressStyle::with_template(&template);
        ProgressBar::new(length).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    }

    /// A spinner whose message says what is being done.
    pub fn spinner(&self) -> ProgressBar {
        if !self.shows_progress() {
            return ProgressBar::hidden();
        }
        let spinner = ProgressBar::new_spinner();
        spinner.enable_steady_tick(Duration::from_millis(120));
        spinner
    }
}
