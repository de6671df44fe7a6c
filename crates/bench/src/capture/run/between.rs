//! What comes between the frames: a pause, a stop that was requested, a disk that
//! fills, a device that becomes hot, a lamp that drifts.

use super::Run;
use super::frame::{Reference, Shot, Taken};
use crate::capture::exposure_check::{SignalRatio, signal_ratio};
use crate::capture::progress::Progress;
use crate::capture::{CaptureError, WRITE_QUEUE};
use crate::device::ReferenceCheck;
use crate::device::temperature::{Part, Warmth};
use crate::interrupt::StopLevel;
use crate::session::Event;
use crate::session::journal::clock_fact;
use crate::shown::nth;

/// Bytes of a sidecar and of the journal's line, generously.
const SIDECAR_BYTES: u64 = 4096;

/// Frames of one exposure, and how well more of their kind would compare with them where
/// they show least.
pub(super) struct Kept {
    frames: Vec<Taken>,
    worst: SignalRatio,
}

impl Kept {
    /// One per channel.
    pub(super) fn frames(self) -> Vec<Taken> {
        self.frames
    }
}

impl Run<'_> {
    /// Whether and when the next frame may be taken.
    pub(super) async fn before_frame(&mut self) -> Result<(), CaptureError> {
        self.check_stop()?;
        // Whoever requests both wants the end.
        if self.interrupt.take_pause() {
            self.pause().await?;
            self.check_stop()?;
        }
        self.check_room()
    }

    fn check_stop(&self) -> Result<(), CaptureError> {
        match self.interrupt.level() {
            StopLevel::Continue => Ok(()),
            StopLevel::AfterThisFrame | StopLevel::Now => Err(CaptureError::Interrupted),
        }
    }

    async fn pause(&mut self) -> Result<(), CaptureError> {
        self.devices.rest().await?;
        // The stage is homed and the lamp warmed up before the next frame.
        self.position = None;
        self.disk.record(Event::Paused).await?;
        self.disk.settle().await?;
        self.stored.report(self.observer);
        self.observer.observe(&Progress::Paused);
        self.observer.pause();
        self.observer.observe(&Progress::Continued);
        self.clock.forget_until(self.clock.now_s());
        self.disk.record(Event::Continued).await
    }

    /// Room for what is under way, and the reserve beyond.
    fn check_room(&self) -> Result<(), CaptureError> {
        let folder = self.session.root();
        let free = self.room.free_bytes(folder);
        let free_bytes = free.map_err(|e| {
            crate::session::SessionError::io("ask for the free space of", folder, e)
        })?;
        let [width, height] = self.devices.camera_info.resolution_px.map(u64::from);
        let frame_bytes = 2 * width * height + SIDECAR_BYTES;
        let wanted_bytes = self.reserve_bytes + (WRITE_QUEUE as u64 + 1) * frame_bytes;
        if free_bytes >= wanted_bytes {
            return Ok(());
        }
        Err(CaptureError::LowDisk {
            folder: folder.to_owned(),
            free_bytes,
            reserve_bytes: self.reserve_bytes,
        })
    }

    /// After the last light: whether the stage finds its switches where they
    /// should be. Where it does not, steps were lost since it was homed.
    pub(super) async fn check_reference(&mut self) -> Result<(), CaptureError> {
        let Some(check) = self.devices.check_reference().await? else {
            return Ok(());
        };
        self.position = None;
        let suspect = check.is_off();
        let ReferenceCheck {
            off: off @ [first, second],
            allowed,
        } = check;
        self.disk.record(Event::Reference { off, suspect }).await?;
        if suspect {
            let text = format!(
                "the stage has lost steps: its reference is off by {first:.4} and {second:.4}, where {allowed} is allowed; this session's light directions are suspect"
            );
            let last = self.lights.saturating_sub(1) as u32;
            self.warn(last, text).await?;
        }
        Ok(())
    }

    /// Whether the computer's clock is still the one by which the session's times began.
    pub(super) async fn check_wall_clock(&mut self, light: u32) -> Result<(), CaptureError> {
        let Some(by_s) = self.wall_clock.step_s() else {
            return Ok(());
        };
        self.disk.record(Event::ClockStep { by_s }).await?;
        let text = format!("{light}: {}", clock_fact(by_s), light = nth("light", light));
        self.warn(light, text).await
    }

    /// Whether a part is cool enough to continue; reported once where it nearly is not.
    pub(super) async fn check_temperature(
        &mut self,
        light: u32,
        part: Part,
        temperature_c: Option<f64>,
    ) -> Result<(), CaptureError> {
        let Some(temperature_c) = temperature_c else {
            return Ok(());
        };
        match self.plan.limits.judge(part, temperature_c) {
            Warmth::Fine => Ok(()),
            Warmth::Near(_) if self.warm_reported.contains(&part) => Ok(()),
            Warmth::Near(limit_c) => {
                self.warm_reported.push(part);
                let text = format!(
                    "{light}: the {part} has {temperature_c:.1} °C; above {limit_c} °C the capture is suspended",
                    light = nth("light", light)
                );
                self.warn(light, text).await
            }
            Warmth::Above(limit_c) => Err(CaptureError::TooHot {
                light,
                part,
                temperature_c,
                limit_c,
            }),
        }
    }

    /// Keeps the frames, one per channel, that [`Self::check_drift`] repeats: those of the
    /// first exposure in which a drift of 1% would show, or else where most shows.
    pub(super) fn keep_for_drift(&self, kept: &mut Option<Kept>, frames: Vec<Taken>) {
        if kept.as_ref().is_some_and(|kept| kept.worst.tells_good()) {
            return;
        }
        let worst = frames
            .iter()
            .filter_map(|taken| signal_ratio(self.noise, taken.exposed(), taken.exposed()))
            .max_by(|a, b| a.std_dev.total_cmp(&b.std_dev));
        if let Some(worst) = worst
            && kept
                .as_ref()
                .is_none_or(|kept| worst.std_dev < kept.worst.std_dev)
        {
            *kept = Some(Kept { frames, worst });
        }
    }

    /// One exposure of the bracket once more under each channel: whether the lamp is
    /// still what it was. `round` numbers these frames.
    pub(super) async fn check_drift(
        &mut self,
        light: u32,
        round: u32,
        before: Option<Kept>,
    ) -> Result<(), CaptureError> {
        let frames = before.map_or(Vec::new(), |kept| kept.frames);
        for (channel, before) in frames.iter().enumerate() {
            let shot = Shot {
                // No part of the bracket.
                pilot: true,
                ..self.light_shot(light, round, channel, 0, before.requested_s)
            };
            self.take(shot, Reference::Lamp(before)).await?;
        }
        Ok(())
    }
}
