//! The camera's thread: frame after frame, each the newest for the pages.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::ports::BenchPorts;
use super::shared::{Shared, lock};
use super::state::View;
use crate::console::picture::Counts;
use crate::device::frame_figures::FrameFigures;
use crate::device::retake::{Retakes, grab_right};
use crate::device::{Camera, CameraSettings, DeviceError, FrameKey, FrameKind};

/// Frames are not taken faster: nobody sees more, and the machine has other work.
const LEAST_PERIOD: Duration = Duration::from_millis(80);
/// Figures of frames are not published more often.
const FIGURES_PERIOD: Duration = Duration::from_millis(200);

/// Takes frames until it is to leave.
pub(super) fn show(
    camera: &mut dyn Camera,
    mut settings: CameraSettings,
    shared: &Shared,
    ports: &BenchPorts,
    leave: &AtomicBool,
) -> Result<(), DeviceError> {
    let info = camera.info().clone();
    let period = camera.least_period().max(LEAST_PERIOD);
    let mut levels = (ports.levels)(settings.gain);
    let (mut rate, mut figures_at) = (Rate::default(), None::<Instant>);
    for number in 1.. {
        if leave.load(Ordering::SeqCst) {
            break;
        }
        let began = Instant::now();
        // Settings that a page requested.
        let wanted = lock(&shared.wanted).take();
        if let Some(wanted) = wanted {
            settings = camera.configure(wanted)?;
            levels = (ports.levels)(settings.gain);
            shared.change(|state| state.settings = Some(settings.into()));
        }
        // The frame.
        let key = FrameKey::new(0, 0, number as u32, FrameKind::Ambient);
        let frame = Arc::new(grab_right(camera, key, &mut Retakes::default())?);
        rate.count(Instant::now());
        shared
            .live
            .show(number, Arc::clone(&frame), Counts::from(&info));
        // Its figures.
        if figures_at.is_none_or(|at| at.elapsed() >= FIGURES_PERIOD) {
            figures_at = Some(Instant::now());
            let stated = camera.stated_with_frame().settings(settings);
            let view = View {
                number,
                frames_per_s: rate.per_s,
                figures: FrameFigures::of(&frame, &info, stated),
                levels,
            };
            shared.change(|state| state.view = Some(view));
        }
        // The next one.
        while began.elapsed() < period && !leave.load(Ordering::SeqCst) {
            std::thread::sleep(LEAST_PERIOD.min(period.saturating_sub(began.elapsed())));
        }
    }
    Ok(())
}

/// Frames per second, smoothed over about five.
#[derive(Default)]
struct Rate {
    last: Option<Instant>,
    per_s: f64,
}

impl Rate {
    fn count(&mut self, now: Instant) {
        if let Some(last) = self.last.replace(now) {
            let interval_s = now.saturating_duration_since(last).as_secs_f64().max(1e-6);
            self.per_s = match self.per_s == 0.0 {
                true => 1.0 / interval_s,
                false => 0.8 * self.per_s + 0.2 / interval_s,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_last_frames() {
        let (mut rate, mut now) = (Rate::default(), Instant::now());
        rate.count(now);
        assert_eq!(rate.per_s, 0.0, "one frame is no rate");
        for period_ms in [[100; 20], [50; 20]] {
            for ms in period_ms {
                now += Duration::from_millis(ms);
                rate.count(now);
            }
            let expected = 1000.0 / period_ms[0] as f64;
            assert!(
                (rate.per_s - expected).abs() < 0.02 * expected,
                "{}",
                rate.per_s
            );
        }
    }
}
