//! Equal frames in a row. A camera that exposes all the time has begun the next of
//! them when the last one is taken: to wait for one more would halve its rate.

use super::FrameKey;
use crate::units::Seconds;

/// Between two frames that follow each other so closely no lamp is switched and
/// nothing moves.
const BACK_TO_BACK: Seconds = Seconds(0.005);

/// The frame before.
#[derive(Clone, Copy, Debug)]
pub struct PreviousFrame {
    /// What it was taken for.
    pub key: FrameKey,
    /// Since when nothing had changed, on the camera's clock.
    pub since: Seconds,
    /// When it was handed over, on the same clock.
    pub returned: Seconds,
}

impl PreviousFrame {
    /// Since when nothing has changed, for a frame that is requested `now`; `None`
    /// where something may have.
    pub fn unchanged_since(self, key: FrameKey, now: Seconds) -> Option<Seconds> {
        let repeats = FrameKey {
            repeat: key.repeat,
            ..self.key
        };
        (repeats == key && now.0 - self.returned.0 < BACK_TO_BACK.0).then_some(self.since)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::FrameKind;

    #[test]
    fn only_a_row_of_equal_frames_may_have_begun_before_it_was_asked_for() {
        let key = |exposure, repeat| FrameKey {
            light: 0,
            exposure,
            repeat,
            kind: FrameKind::Light,
        };
        let previous = PreviousFrame {
            key: key(2, 0),
            since: Seconds(1.0),
            returned: Seconds(1.5),
        };
        let since = |key, now| previous.unchanged_since(key, Seconds(now));
        assert_eq!(since(key(2, 1), 1.501), Some(Seconds(1.0)));
        assert_eq!(since(key(2, 1), 1.6), None);
        assert_eq!(since(key(3, 0), 1.501), None);
    }
}
