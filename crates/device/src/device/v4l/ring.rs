//! The ring of buffers that a camera fills, and what a buffer's record says.

use std::io;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};
use v4l::Device;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::io::mmap::Stream;
use v4l::io::traits::CaptureStream;

use crate::units::Seconds;

/// Buffers in the ring; so many frames may be older than a request.
pub(super) const BUFFERS: u32 = 4;

/// The stream, started when the first frame is wanted.
#[derive(Default)]
pub(super) struct Ring {
    /// Absent before the first frame and after a timeout: the crate would queue
    /// again a buffer that the kernel still has.
    stream: Option<Stream<'static>>,
    is_stale: bool,
    /// Whether its times are those of a frame's arrival whatever its flags say.
    stamps_arrival: bool,
}

impl Ring {
    /// Not started yet. `uvcvideo` flags the start of the exposure and gives the
    /// time at which the frame's first bytes came, which is after its end.
    pub(super) fn of_driver(driver: &str) -> Self {
        Self {
            stamps_arrival: driver == "uvcvideo",
            ..Self::default()
        }
    }

    /// The next buffer's used bytes, of a fresh frame or not; `None` when
    /// nothing came in time.
    pub(super) fn next(
        &mut self,
        device: &Device,
        timeout: Duration,
    ) -> io::Result<Option<(&[u8], Metadata)>> {
        if self.is_stale {
            self.stop();
        }
        if self.stream.is_none() {
            let stream = Stream::with_buffers(device, Type::VideoCapture, BUFFERS)?;
            self.stream = Some(stream);
        }
        let Some(stream) = &mut self.stream else {
            return Ok(None);
        };
        stream.set_timeout(timeout.min(Duration::from_secs(3600)));
        match stream.next() {
            Ok((bytes, meta)) => {
                let used = (meta.bytesused as usize).min(bytes.len());
                Ok(Some((
                    &bytes[..used],
                    truly_stamped(*meta, self.stamps_arrival),
                )))
            }
            Err(error) => {
                self.is_stale = true;
                use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
                match error.kind() {
                    TimedOut | WouldBlock | Interrupted => Ok(None),
                    _ => Err(error),
                }
            }
        }
    }

    /// Ends the stream; its buffers are given back.
    pub(super) fn stop(&mut self) {
        self.stream = None;
        self.is_stale = false;
    }
}

/// The record, without a claim on the exposure's start that is not true.
fn truly_stamped(mut meta: Metadata, stamps_arrival: bool) -> Metadata {
    if stamps_arrival {
        meta.flags.remove(Flags::TSTAMP_SRC_SOE);
    }
    meta
}

/// Whether a frame began after `since` (CLOCK_MONOTONIC). `None` if the buffer
/// does not report.
pub(super) fn began_after(meta: &Metadata, exposure: Seconds, since: Seconds) -> Option<bool> {
    let (start_s, _) = span_s(meta, exposure)?;
    Some(start_s >= since.0)
}

/// Start and end of a frame's exposure, seconds of CLOCK_MONOTONIC.
fn span_s(meta: &Metadata, exposure: Seconds) -> Option<(f64, f64)> {
    let flags = meta.flags.bits();
    if flags & Flags::TIMESTAMP_MASK.bits() != Flags::TIMESTAMP_MONOTONIC.bits() {
        return None;
    }
    let stamp_s = timestamp(meta).0;
    let at_start = flags & Flags::TSTAMP_SRC_MASK.bits() == Flags::TSTAMP_SRC_SOE.bits();
    Some(if at_start {
        (stamp_s, stamp_s + exposure.0)
    } else {
        (stamp_s - exposure.0, stamp_s)
    })
}

/// The buffer's own time.
pub(super) fn timestamp(meta: &Metadata) -> Seconds {
    Seconds(meta.timestamp.sec as f64 + meta.timestamp.usec as f64 * 1e-6)
}

/// CLOCK_MONOTONIC.
pub(super) fn monotonic_now() -> Seconds {
    let now = clock_gettime(ClockId::Monotonic);
    Seconds(now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9)
}

/// Counts frames that are lost while one is waited for.
///
/// Between two requests the ring fills and the camera goes on, so that a gap in
/// the numbers is natural there. It is a loss only after a frame that ended
/// while somebody waited, because then the ring had room.
#[derive(Clone, Copy, Debug)]
pub(super) struct LossCounter {
    asked: Seconds,
    exposure: Seconds,
    waited_for: Option<u32>,
    pub(super) lost: u64,
}

impl LossCounter {
    /// For a request at this moment.
    pub(super) fn new(asked: Seconds, exposure: Seconds) -> Self {
        Self {
            asked,
            exposure,
            waited_for: None,
            lost: 0,
        }
    }

    /// Takes note of the next buffer.
    pub(super) fn note(&mut self, meta: &Metadata) {
        if let Some(before) = self.waited_for {
            // The numbers wrap; one that goes back has been set anew.
            let gap = meta.sequence.wrapping_sub(before).wrapping_sub(1);
            if gap < u32::MAX / 2 {
                self.lost += u64::from(gap);
            }
        }
        let ended = span_s(meta, self.exposure).map(|(_, end_s)| end_s);
        self.waited_for = ended
            .is_some_and(|end_s| end_s >= self.asked.0)
            .then_some(meta.sequence);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meta(flags: Flags, microseconds: i64, sequence: u32) -> Metadata {
        Metadata {
            flags,
            timestamp: v4l::Timestamp::new(100, microseconds),
            sequence,
            ..Metadata::default()
        }
    }

    #[test]
    fn only_frames_that_began_later_are_fresh() {
        let fresh = |flags, microseconds| {
            let meta = meta(flags, microseconds, 0);
            began_after(&meta, Seconds(0.02), Seconds(100.01))
        };
        let at_start = Flags::TIMESTAMP_MONOTONIC | Flags::TSTAMP_SRC_SOE;
        assert_eq!(fresh(at_start, 9_000), Some(false));
        assert_eq!(fresh(at_start, 11_000), Some(true));
        let at_end = Flags::TIMESTAMP_MONOTONIC;
        assert_eq!(fresh(at_end, 29_000), Some(false));
        assert_eq!(fresh(at_end, 31_000), Some(true));
        assert_eq!(fresh(Flags::empty(), 31_000), None);
    }

    #[test]
    fn uvcvideo_gives_the_arrival_for_the_start() {
        let at_start = Flags::TIMESTAMP_MONOTONIC | Flags::TSTAMP_SRC_SOE;
        let fresh = |driver| {
            let stamped = truly_stamped(
                meta(at_start, 29_000, 0),
                Ring::of_driver(driver).stamps_arrival,
            );
            began_after(&stamped, Seconds(0.02), Seconds(100.01))
        };
        assert_eq!(fresh("uvcvideo"), Some(false));
        assert_eq!(fresh("another"), Some(true));
    }

    #[test]
    fn a_gap_is_a_loss_only_while_somebody_waits() {
        let at_end = Flags::TIMESTAMP_MONOTONIC;
        let count = |frames: &[(i64, u32)]| {
            let mut counter = LossCounter::new(Seconds(100.5), Seconds(0.03));
            for &(microseconds, sequence) in frames {
                counter.note(&meta(at_end, microseconds, sequence));
            }
            counter.lost
        };
        // Frames 3 to 6 lay in the ring, then the camera went on without it.
        let ring = [(100_000, 3), (133_000, 4), (166_000, 5), (200_000, 6)];
        let then = |rest: &[(i64, u32)]| count(&[&ring, rest].concat());
        assert_eq!(then(&[(510_000, 15), (543_000, 16)]), 0);
        assert_eq!(then(&[(510_000, 15), (610_000, 18)]), 2);
        assert_eq!(then(&[(610_000, 18)]), 0);
        // The number wraps, and it is set anew after the stream was restarted.
        assert_eq!(count(&[(510_000, u32::MAX), (543_000, 1)]), 1);
        assert_eq!(count(&[(510_000, 99), (543_000, 0)]), 0);
    }
}
