//! A frame as it was requested, from a camera that may go away or ignore its
//! settings.

use super::Run;
use super::frame::{Reference, Shot, Taken};
use crate::capture::CaptureError;
use crate::capture::exposure_check::{self, Exposed, SignalRatio, Verdict, signal_ratio};
use crate::device::{CameraSettings, LampChannel, LampState, RawFrame};
use crate::session::Sidecar;
use crate::shown::nth;

/// Frames beyond the camera's own latency that may be thrown away until a
/// change of settings shows.
const PATIENCE_FRAMES: u32 = 8;

impl Run<'_> {
    /// The frame of this shot, also from a camera that goes away and comes back.
    pub(super) async fn expose_again_if_lost(
        &mut self,
        shot: Shot,
        reference: Reference<'_>,
    ) -> Result<(RawFrame, Sidecar), CaptureError> {
        loop {
            let lost = match self.expose(shot, reference).await {
                Err(error) if self.devices.camera_is_lost() => error,
                done => return done,
            };
            let light = shot.key.light;
            let within = self.devices.may_return_within().await?;
            if within.0 <= 0.0 {
                return Err(lost);
            }
            let text = format!(
                "{light}: {lost}; the lamp is off and the camera is waited for, {within} at most",
                light = nth("light", light)
            );
            self.warn(light, text).await?;
            if !self.devices.camera_returned(within).await? {
                return Err(lost);
            }
        }
    }

    /// A frame whose signal agrees with its reference. Others are thrown away for
    /// a while, because a change of settings can take its time; then the settings
    /// are sent once more, because a camera can have missed them.
    pub(super) async fn grab_as_claimed(
        &mut self,
        shot: Shot,
        applied: CameraSettings,
        reference: Reference<'_>,
    ) -> Result<(RawFrame, Option<SignalRatio>), CaptureError> {
        // The frame to compare with, and what a new homing may have changed since.
        let same_exposure = |taken: &Taken| {
            let same = |a: f64, b: f64| (a - b).abs() <= 1e-9;
            same(taken.exposure_s, applied.exposure.0) || same(taken.requested_s, shot.exposure.0)
        };
        let before = match reference {
            Reference::Exposure(taken) if shot.key.repeat > 0 || same_exposure(taken) => None,
            Reference::None => None,
            Reference::Exposure(taken) | Reference::Lamp(taken) | Reference::Revisit(taken) => {
                Some(taken)
            }
        };
        let granted = before.map_or(0.0, |before| self.granted(shot.key.light, before.homing));
        // Frames until one agrees, or patience is over.
        let mut sent_again = false;
        let mut patience = self.plan.settings_latency_frames + PATIENCE_FRAMES;
        loop {
            let grabbed = self.devices.grab(shot.key);
            let frame = self.stored.report_during(self.observer, grabbed).await?;
            let claimed = Exposed {
                counts: &frame.counts,
                exposure_s: self.devices.stated().settings(applied).exposure.0,
            };
            let Some(found) =
                before.and_then(|before| signal_ratio(self.noise, before.exposed(), claimed))
            else {
                return Ok((frame, None));
            };
            match found.verdict_beyond(granted) {
                Verdict::Good => return Ok((frame, found.if_known())),
                Verdict::Doubtful | Verdict::Refused if let Reference::Revisit(_) = reference => {
                    if found.verdict() == Verdict::Refused && self.discarded < patience {
                        self.discarded += 1;
                        continue;
                    }
                    let text = format!(
                        "the lamp drifted by {found} since {} was captured",
                        nth("light", shot.key.light)
                    );
                    self.warn(shot.key.light, text).await?;
                    return Ok((frame, found.if_known()));
                }
                Verdict::Doubtful => {
                    let light = shot.key.light;
                    let text = match reference {
                        Reference::Lamp(_) => {
                            format!(
                                "the lamp drifted by {found} during {light}",
                                light = nth("light", light)
                            )
                        }
                        _ => format!(
                            "{light}: at {} the images show {:.4} of the expected signal, more than {} % off",
                            applied.exposure,
                            found.ratio,
                            100.0 * exposure_check::GOOD,
                            light = nth("light", light)
                        ),
                    };
                    self.warn(shot.key.light, text).await?;
                    return Ok((frame, found.if_known()));
                }
                Verdict::Refused if self.discarded < patience => self.discarded += 1,
                Verdict::Refused if !sent_again => {
                    sent_again = true;
                    self.discarded += 1;
                    patience = self.discarded + self.plan.settings_latency_frames;
                    if self.devices.configure_again().await? != Some(applied) {
                        return Err(self.contradicted(shot, applied, reference, found));
                    }
                }
                Verdict::Refused => {
                    return Err(self.contradicted(shot, applied, reference, found));
                }
            }
        }
    }

    fn contradicted(
        &self,
        shot: Shot,
        applied: CameraSettings,
        reference: Reference<'_>,
        found: SignalRatio,
    ) -> CaptureError {
        let light = shot.key.light;
        if let Reference::Exposure(before) | Reference::Lamp(before) = reference
            && before.homing != self.homing
        {
            return CaptureError::NotAsBefore {
                light,
                ratio: found.ratio,
            };
        }
        match (reference, shot.lamp) {
            (Reference::Lamp(_), LampState::On(LampChannel(channel))) => CaptureError::LampDrift {
                light,
                channel,
                change: found,
            },
            _ => CaptureError::ExposureNotApplied {
                light,
                exposure_s: applied.exposure.0,
                ratio: found.ratio,
                discarded: self.discarded,
            },
        }
    }
}
