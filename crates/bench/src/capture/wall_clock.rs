//! Whether the computer's clock is set during a capture: it is compared with the time since
//! the system was started, which nobody sets. Without a clock of its own a computer has a wrong
//! date until the network tells it the right one.

use std::time::Duration;

use jiff::Timestamp;

/// More than a clock is slewed by within the part below, s.
const LEAST_STEP_S: f64 = 1.0;
/// A clock may run so much faster or slower, as a part: twice what the kernel slews it by.
const LARGEST_SLEW: f64 = 1e-3;

/// Both clocks at one moment.
type Moment = (Duration, Timestamp);

/// The computer's clock as it was seen last.
pub(super) struct WallClock(Moment);

impl WallClock {
    pub(super) fn start() -> Self {
        Self(now())
    }

    /// By how much it was set since the last call, s; `None`: it was not.
    pub(super) fn step_s(&mut self) -> Option<f64> {
        let now = now();
        let before = std::mem::replace(&mut self.0, now);
        step_s(before, now)
    }
}

fn now() -> Moment {
    // Goes on while the computer is suspended.
    let since_start = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    let seconds = u64::try_from(since_start.tv_sec).unwrap_or_default();
    let nanoseconds = u32::try_from(since_start.tv_nsec).unwrap_or_default();
    (Duration::new(seconds, nanoseconds), Timestamp::now())
}

fn step_s(before: Moment, now: Moment) -> Option<f64> {
    let passed_s = now.0.saturating_sub(before.0).as_secs_f64();
    let step_s = now.1.duration_since(before.1).as_secs_f64() - passed_s;
    (step_s.abs() > LEAST_STEP_S + LARGEST_SLEW * passed_s).then_some(step_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_set_is_told_from_one_that_is_slewed() {
        let at = |since_start_s: f64, wall_s: i64| {
            let wall = Timestamp::from_second(wall_s).unwrap();
            (Duration::from_secs_f64(since_start_s), wall)
        };
        for (passed_s, wall_s, expected) in [
            (0.0, 0, None),
            (10.0, 10, None),
            (10.4, 11, None),
            // An hour of slewing, a night of pause.
            (3600.0, 3602, None),
            (36_000.0, 36_018, None),
            (10.0, 12, Some(2.0)),
            (10.0, -3600, Some(-3610.0)),
            (3.0, 1_728_000_003, Some(1.728e9)),
        ] {
            let found = step_s(at(100.0, 0), at(100.0 + passed_s, wall_s));
            assert_eq!(found, expected, "{passed_s} {wall_s}");
        }
    }
}
