//! What a person sees of a capture while it runs.

use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};

use super::progress::duration;
use super::{Context, interrupt};
use crate::capture::{Observer, Progress, Spent};
use crate::device::{FrameKind, LampState};
use crate::units::Seconds;

/// A bar on stderr, or nothing where nobody watches; warnings always.
pub struct Bar<'a> {
    context: &'a Context,
    bar: ProgressBar,
    /// How long the rest takes, as last said, and when.
    left: Option<(Seconds, Instant)>,
    spent: Option<Spent>,
}

/// Steps of the bar.
const LENGTH: u64 = 1000;

impl<'a> Bar<'a> {
    /// Drawn if stderr is a terminal.
    pub fn new(context: &'a Context) -> Self {
        let style = ProgressStyle::with_template("{bar:30} {percent:>3}%  {wide_msg}");
        let bar = ProgressBar::with_draw_target(Some(LENGTH), context.draw_target())
            .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        Self {
            context,
            bar,
            left: None,
            spent: None,
        }
    }

    /// Where the time went, once the capture has ended.
    pub fn spent(&self) -> Option<Spent> {
        self.spent
    }

    /// What is being done, with the time left.
    fn say(&self, what: &str) {
        let left = self
            .left
            .map(|(left, said)| left.0 - said.elapsed().as_secs_f64());
        self.bar.set_message(match left {
            Some(left_s) => format!("{what}; {} left", duration(left_s)),
            None => what.to_owned(),
        });
    }

    /// Clears the line.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for Bar<'_> {
    fn observe(&mut self, progress: Progress<'_>) {
        match progress {
            Progress::Resumed { frames } => {
                self.bar.suspend(|| {
                    self.context.note(format!("frames there already: {frames}"));
                });
            }
            Progress::Left(left) => self.left = Some((left, Instant::now())),
            Progress::Homing => self.say("homing"),
            Progress::Moving { light, target } => {
                self.say(&format!("light {light}: moving to {target}"));
            }
            Progress::Planned { .. } | Progress::LightDone { .. } => {}
            Progress::Frame {
                key,
                exposure,
                lamp,
                done,
            } => {
                self.bar.set_position((done * LENGTH as f64) as u64);
                let what = match (key.kind, lamp) {
                    (FrameKind::Light, LampState::On(channel)) => format!("lamp {}", channel.0),
                    (FrameKind::Dark, _) => "dark".to_owned(),
                    _ => "lamp off".to_owned(),
                };
                self.say(&format!("light {}, {what}, {exposure}", key.light));
            }
            Progress::Merging => {
                self.bar.set_position(LENGTH);
                self.bar.set_message("merging");
            }
            Progress::Ended(spent) => self.spent = Some(spent),
            Progress::Warning(text) => self.bar.suspend(|| self.context.warn(text)),
        }
    }

    fn pause(&mut self) {
        self.bar.suspend(|| {
            let id = std::process::id();
            self.context.note(format!(
                "paused: the lamp is off, all frames are on the disk; `fg` or `kill -CONT {id}` goes on"
            ));
            interrupt::suspend();
            self.context.note("going on: homing first");
        });
    }
}
