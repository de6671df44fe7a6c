//! What goes wrong at a still camera.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use mock_devices::clock::lock;

/// Something that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BodyFault {
    /// This many operations other than opening a session are answered with "device busy".
    Busy(u32),
    /// This many shutter speeds are refused although they are listed.
    RefuseSpeed(u32),
    /// This many shutter speeds are accepted, and the one before stays.
    KeepSpeed(u32),
    /// This many files state twice the exposure that they were taken with.
    WrongExif(u32),
    /// This many frames are taken with half the exposure that their file states.
    HalfExposure(u32),
    /// This many files lose their second half on the way.
    CutFile(u32),
    /// This many captures are accepted and give no file.
    NoFile(u32),
    /// Every file comes so much later.
    Slow(Duration),
    /// There is no room for a file until [`BodyFaults::clear`].
    StorageFull,
    /// It is off or out of reach until [`BodyFaults::clear`].
    Gone,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pending {
    pub(super) busy: u32,
    pub(super) refuse_speed: u32,
    pub(super) keep_speed: u32,
    pub(super) wrong_exif: u32,
    pub(super) half_exposure: u32,
    pub(super) cut_file: u32,
    pub(super) no_file: u32,
    pub(super) slow: Duration,
    pub(super) is_full: bool,
    pub(super) is_gone: bool,
}

/// Handle by which a test makes a body fail; clones act on the same body.
#[derive(Clone, Debug, Default)]
pub struct BodyFaults(Arc<Mutex<Pending>>);

impl BodyFaults {
    /// From now on.
    pub fn inject(&self, fault: BodyFault) {
        let mut pending = lock(&self.0);
        match fault {
            BodyFault::Busy(n) => pending.busy = n,
            BodyFault::RefuseSpeed(n) => pending.refuse_speed = n,
            BodyFault::KeepSpeed(n) => pending.keep_speed = n,
            BodyFault::WrongExif(n) => pending.wrong_exif = n,
            BodyFault::HalfExposure(n) => pending.half_exposure = n,
            BodyFault::CutFile(n) => pending.cut_file = n,
            BodyFault::NoFile(n) => pending.no_file = n,
            BodyFault::Slow(by) => pending.slow = by,
            BodyFault::StorageFull => pending.is_full = true,
            BodyFault::Gone => pending.is_gone = true,
        }
    }

    /// All is well again.
    pub fn clear(&self) {
        *lock(&self.0) = Pending::default();
    }

    /// Whether it cannot be reached now.
    pub fn is_gone(&self) -> bool {
        lock(&self.0).is_gone
    }

    /// What is pending now.
    pub(super) fn now(&self) -> Pending {
        *lock(&self.0)
    }

    /// Whether this fault is due, which uses it up once.
    pub(super) fn take(&self, which: fn(&mut Pending) -> &mut u32) -> bool {
        let mut pending = lock(&self.0);
        let left = which(&mut pending);
        let is_due = *left > 0;
        *left = left.saturating_sub(1);
        is_due
    }
}
