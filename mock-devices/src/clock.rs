//! The one time that everything on a bench lives by.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A clock shared by all devices of one bench; clones tell the same time.
///
/// Times are seconds since the clock was made.
#[derive(Clone, Debug)]
pub struct Clock {
    kind: Arc<Kind>,
}

#[derive(Debug)]
enum Kind {
    Real(Instant),
    Virtual {
        now_s: Mutex<f64>,
        changed: Condvar,
        jumps: bool,
    },
}

impl Clock {
    /// Real time: waiting sleeps.
    pub fn real_time() -> Self {
        Self {
            kind: Arc::new(Kind::Real(Instant::now())),
        }
    }

    /// Virtual time that jumps: whoever waits moves the time forward instead of
    /// sleeping, so that hours pass in no wall time.
    pub fn instant() -> Self {
        Self::virtual_time(true)
    }

    /// Virtual time that only [`advance`](Self::advance) moves: whoever waits
    /// blocks until somebody has moved it far enough. For tests that look into
    /// the middle of a motion.
    pub fn manual() -> Self {
        Self::virtual_time(false)
    }

    fn virtual_time(jumps: bool) -> Self {
        Self {
            kind: Arc::new(Kind::Virtual {
                now_s: Mutex::new(0.0),
                changed: Condvar::new(),
                jumps,
            }),
        }
    }

    /// Seconds since the clock was made.
    pub fn now_s(&self) -> f64 {
        match &*self.kind {
            Kind::Real(origin) => origin.elapsed().as_secs_f64(),
            Kind::Virtual { now_s, .. } => *lock(now_s),
        }
    }

    /// Whether waiting moves the time instead of sleeping.
    pub fn is_instant(&self) -> bool {
        matches!(&*self.kind, Kind::Virtual { jumps: true, .. })
    }

    /// Whether the time passes by itself.
    pub fn is_real_time(&self) -> bool {
        matches!(&*self.kind, Kind::Real(_))
    }

    /// Returns once the time is `time_s` or later: sleeps, jumps or blocks, as
    /// the clock's kind has it.
    pub fn wait_until(&self, time_s: f64) {
        match &*self.kind {
            Kind::Real(origin) => {
                let left_s = time_s - origin.elapsed().as_secs_f64();
                if left_s > 0.0 {
                    std::thread::sleep(Duration::from_secs_f64(left_s.min(1e9)));
                }
            }
            Kind::Virtual { jumps: true, .. } => self.move_to(time_s),
            Kind::Virtual { now_s, changed, .. } => {
                let mut now = lock(now_s);
                while *now < time_s {
                    now = changed.wait(now).unwrap_or_else(PoisonError::into_inner);
                }
            }
        }
    }

    /// Moves a virtual clock forward by `seconds`; nothing on real time.
    pub fn advance(&self, seconds: f64) {
        if let Kind::Virtual { now_s, changed, .. } = &*self.kind {
            *lock(now_s) += seconds.max(0.0);
            changed.notify_all();
        }
    }

    fn move_to(&self, time_s: f64) {
        if let Kind::Virtual { now_s, changed, .. } = &*self.kind {
            let mut now = lock(now_s);
            if time_s > *now {
                *now = time_s;
                changed.notify_all();
            }
        }
    }
}

/// A lock whose data stays usable when another thread panicked.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_hour_on_the_instant_clock_takes_no_wall_time() {
        let wall = Instant::now();
        let clock = Clock::instant();
        let seen_by_another = clock.clone();
        clock.wait_until(3600.0);
        assert_eq!(seen_by_another.now_s(), 3600.0);
        clock.wait_until(10.0);
        assert_eq!(clock.now_s(), 3600.0, "time never runs back");
        assert!(wall.elapsed() < Duration::from_secs(1));
    }

    #[test]
    fn the_manual_clock_holds_who_waits_until_it_is_moved() {
        let clock = Clock::manual();
        let waiter = clock.clone();
        let thread = std::thread::spawn(move || {
            waiter.wait_until(2.0);
            waiter.now_s()
        });
        clock.advance(1.0);
        assert!(!thread.is_finished());
        clock.advance(1.5);
        assert_eq!(thread.join().unwrap(), 2.5);
    }
}
