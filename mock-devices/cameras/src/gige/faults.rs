//! What goes wrong at the device and on its network.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use mock_devices::clock::lock;
use mock_devices::random::stream;

#[derive(Debug, Default)]
struct Faults {
    lost_per_thousand: u32,
    packets: u64,
    late: u32,
    halved: u32,
    silent: u32,
    other_format: u32,
    delay: Option<Duration>,
    stuck_exposure_us: Option<f64>,
    ignores_exposure: bool,
    locks_settings: bool,
    forgets_controller: bool,
    is_held: bool,
    is_gone: bool,
}

/// Handle by which a test makes the device fail; clones act on the same device.
#[derive(Clone, Debug, Default)]
pub struct GigeFaults(Arc<Mutex<Faults>>);

impl GigeFaults {
    /// So many packets of the stream in a thousand are lost.
    pub fn lose_packets(&self, per_thousand: u32) {
        lock(&self.0).lost_per_thousand = per_thousand;
    }

    /// So many frames are the one before, sent once more.
    pub fn repeat_frames(&self, frames: u32) {
        lock(&self.0).late = frames;
    }

    /// So many frames have half the height.
    pub fn halve_frames(&self, frames: u32) {
        lock(&self.0).halved = frames;
    }

    /// So many frames are not sent.
    pub fn swallow_frames(&self, frames: u32) {
        lock(&self.0).silent = frames;
    }

    /// So many frames come in another pixel format than the one that was set.
    pub fn change_format(&self, frames: u32) {
        lock(&self.0).other_format = frames;
    }

    /// The next frame is so long on its way.
    pub fn delay_frame(&self, by: Duration) {
        lock(&self.0).delay = Some(by);
    }

    /// It exposes for so long whatever its register is set to, microseconds; `None`: it obeys.
    pub fn stick_exposure(&self, exposure_us: Option<f64>) {
        lock(&self.0).stuck_exposure_us = exposure_us;
    }

    /// Whether the exposure can only be set while no acquisition is under way.
    pub fn lock_settings(&self, locks: bool) {
        lock(&self.0).locks_settings = locks;
    }

    /// Whether it confirms exposures and keeps the one that it has.
    pub fn ignore_exposure(&self, ignores: bool) {
        lock(&self.0).ignores_exposure = ignores;
    }

    /// It takes its controller for gone, as after a silence longer than the heartbeat time-out.
    pub fn forget_controller(&self) {
        lock(&self.0).forgets_controller = true;
    }

    /// Whether another controller has it.
    pub fn hold(&self, is_held: bool) {
        lock(&self.0).is_held = is_held;
    }

    /// Whether it is unplugged. It comes back as when it was switched on.
    pub fn unplug(&self, is_gone: bool) {
        lock(&self.0).is_gone = is_gone;
    }

    pub(super) fn ignores_exposure(&self) -> bool {
        lock(&self.0).ignores_exposure
    }

    pub(super) fn locks_settings(&self) -> bool {
        lock(&self.0).locks_settings
    }

    pub(super) fn stuck_exposure_us(&self) -> Option<f64> {
        lock(&self.0).stuck_exposure_us
    }

    pub(super) fn changes_format(&self) -> bool {
        due(&mut lock(&self.0).other_format)
    }

    pub(super) fn delays_frame(&self) -> Option<Duration> {
        lock(&self.0).delay.take()
    }

    pub(super) fn forgets_controller(&self) -> bool {
        std::mem::take(&mut lock(&self.0).forgets_controller)
    }

    pub(super) fn is_held(&self) -> bool {
        lock(&self.0).is_held
    }

    /// Whether it is unplugged.
    pub fn is_gone(&self) -> bool {
        lock(&self.0).is_gone
    }

    /// Whether the next packet is lost.
    pub(super) fn loses_packet(&self) -> bool {
        let mut faults = lock(&self.0);
        faults.packets += 1;
        let drawn = stream(&[31, faults.packets]).uniform();
        drawn * 1000.0 < f64::from(faults.lost_per_thousand)
    }

    pub(super) fn repeats_frame(&self) -> bool {
        due(&mut lock(&self.0).late)
    }

    pub(super) fn halves_frame(&self) -> bool {
        due(&mut lock(&self.0).halved)
    }

    pub(super) fn swallows_frame(&self) -> bool {
        due(&mut lock(&self.0).silent)
    }
}

fn due(left: &mut u32) -> bool {
    let is_due = *left > 0;
    *left = left.saturating_sub(1);
    is_due
}
