//! What a capture shows at the terminal while it runs.

use std::fmt::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

use super::context::Context;
use super::interrupt;
use super::progress::duration;
use crate::capture::{Observer, Progress, Spent};
use crate::device::FrameKind;
use crate::shown::nth;
use crate::units::Seconds;

/// A bar on stderr, or nothing where that is no terminal; warnings always.
pub struct Bar<'a> {
    context: &'a Context,
    bar: ProgressBar,
    left: Left,
    lamps: Vec<&'static str>,
    spent: Option<Spent>,
}

/// How long the rest takes, as last reported, and when: counted down until the next report.
#[derive(Clone, Default)]
struct Left(Arc<Mutex<Option<(Seconds, Instant)>>>);

impl Left {
    fn set(&self, left: Option<Seconds>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) =
            left.map(|left| (left, Instant::now()));
    }

    fn text(&self) -> String {
        let left = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        left.map_or(String::new(), |(left, reported)| {
            let left_s = left.0 - reported.elapsed().as_secs_f64();
            format!("{} left", duration(left_s))
        })
    }
}

/// Steps of the bar.
const LENGTH: u64 = 1000;

impl<'a> Bar<'a> {
    /// Drawn if stderr is a terminal; `lamps` are the names of the lamp's channels.
    pub fn new(context: &'a Context, lamps: Vec<&'static str>) -> Self {
        let left = Left::default();
        let shown = left.clone();
        let style = ProgressStyle::with_template("{bar:30} {percent:>3}%  {left}  {wide_msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .with_key("left", move |_: &ProgressState, out: &mut dyn Write| {
                // What a bar cannot show is not shown.
                let _ = out.write_str(&shown.text());
            });
        let bar =
            ProgressBar::with_draw_target(Some(LENGTH), context.draw_target()).with_style(style);
        if context.shows_progress() {
            bar.enable_steady_tick(Duration::from_secs(1));
        }
        Self {
            context,
            bar,
            left,
            lamps,
            spent: None,
        }
    }

    /// Where the time went, once the capture has ended.
    pub fn spent(&self) -> Option<Spent> {
        self.spent
    }

    /// Clears the line.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for Bar<'_> {
    fn observe(&mut self, progress: &Progress) {
        match progress {
            Progress::Resumed { frames } => {
                self.bar.suspend(|| {
                    self.context.note(format!("frames there already: {frames}"));
                });
            }
            Progress::Left { seconds } => self.left.set(Some(Seconds(*seconds))),
            Progress::Homing => self.bar.set_message("homing"),
            Progress::Moving { light, target } => {
                self.bar.set_message(format!(
                    "{light}: moving to {target}",
                    light = nth("light", *light)
                ));
            }
            Progress::Begun { .. }
            | Progress::Asked { .. }
            | Progress::Planned { .. }
            | Progress::Stored { .. }
            | Progress::Drift { .. }
            | Progress::LightDone { .. }
            | Progress::Paused
            | Progress::Continued
            | Progress::Fit { .. }
            | Progress::Fitted { .. }
            | Progress::FitFailed { .. }
            | Progress::Calibrating { .. }
            | Progress::Dropped { .. } => {}
            Progress::Frame { frame, done, .. } => {
                self.bar.set_position((done * LENGTH as f64) as u64);
                let what = match (frame.kind, frame.lamp) {
                    (FrameKind::Light, Some(channel)) => {
                        let lamp = self.lamps.get(usize::from(channel.0));
                        lamp.copied().unwrap_or("lamp")
                    }
                    (FrameKind::Dark, _) => "dark",
                    _ => "lamp off",
                };
                let exposure = Seconds(frame.exposure_s);
                self.bar
                    .set_message(format!("{}, {what}, {exposure}", nth("light", frame.light)));
            }
            Progress::Merging => {
                self.bar.set_position(LENGTH);
                self.bar.set_message("merging");
                self.left.set(None);
            }
            Progress::Choosing => self.bar.set_message("choosing the next light"),
            Progress::Decided(decision) => {
                self.bar.suspend(|| self.context.note(decision.to_string()))
            }
            Progress::Ended { spent, .. } => self.spent = *spent,
            Progress::Warning { text } => self.bar.suspend(|| self.context.warn(text)),
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
