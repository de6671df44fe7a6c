//! When a lamp that was lit from a page goes out by itself.

use std::time::{Duration, Instant};

use crate::console::control::LONGEST_SILENCE;

/// Runs from the last sign of life of the page that controls; the command that lit the lamp
/// is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LampTimer {
    last_sign: Instant,
}

impl LampTimer {
    /// The lamp is lit now.
    pub fn lit(now: Instant) -> Self {
        Self { last_sign: now }
    }

    /// The controlling page has been silent for so long, or none controls.
    pub fn hear(&mut self, silence: Option<Duration>, now: Instant) {
        let sign = silence.and_then(|silence| now.checked_sub(silence));
        self.last_sign = sign.map_or(self.last_sign, |sign| sign.max(self.last_sign));
    }

    /// How long the lamp stays lit without another sign; 0: it must be turned off.
    pub fn left(&self, now: Instant) -> Duration {
        LONGEST_SILENCE.saturating_sub(now.saturating_duration_since(self.last_sign))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn the_lamp_goes_out_30_s_after_the_last_sign() {
        let began = Instant::now();
        let mut timer = LampTimer::lit(began);
        // Nobody is heard of: the command that lit it counts.
        timer.hear(None, began + 10 * SECOND);
        assert_eq!(timer.left(began + 29 * SECOND), SECOND);
        assert!(timer.left(began + 30 * SECOND).is_zero());
        // A page that pings keeps it lit; what it said before the lamp was lit is no sign.
        timer.hear(Some(20 * SECOND), began + 10 * SECOND);
        assert_eq!(timer.left(began + 10 * SECOND), 20 * SECOND);
        timer.hear(Some(SECOND), began + 60 * SECOND);
        assert_eq!(timer.left(began + 60 * SECOND), 29 * SECOND);
        // Control that is given up, or passes to a page that was silent, takes nothing back.
        timer.hear(None, began + 70 * SECOND);
        timer.hear(Some(50 * SECOND), began + 71 * SECOND);
        assert_eq!(timer.left(began + 71 * SECOND), 18 * SECOND);
        assert!(timer.left(began + 89 * SECOND).is_zero());
    }
}
