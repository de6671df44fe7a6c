//! How a test makes a device fail.

use std::fmt::Debug;
use std::sync::{Arc, Mutex, MutexGuard};

use crate::clock::lock;

/// Handle on what goes wrong at a device; clones act on the same device.
#[derive(Debug, Default)]
pub struct Failing<F>(Arc<Mutex<F>>);

impl<F> Failing<F> {
    /// What goes wrong now, to be looked at or changed. The device waits meanwhile.
    pub fn now(&self) -> MutexGuard<'_, F> {
        lock(&self.0)
    }
}

impl<F> Clone for Failing<F> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

/// Whether a fault that is to happen so many times happens now.
pub fn due(left: &mut u32) -> bool {
    let is_due = *left > 0;
    *left = left.saturating_sub(1);
    is_due
}
