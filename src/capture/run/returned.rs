//! Back at a light whose frames were begun before the stage was homed anew: after an
//! interruption or a pause.

use super::Run;
use super::frame::{Reference, Shot};
use crate::capture::CaptureError;
use crate::capture::exposure_check::{Exposed, REFUSED};
use crate::capture::return_check::change;
use crate::device::{FrameKey, LampChannel, LampState};
use crate::units::Seconds;

impl Run<'_> {
    /// Once per channel after each homing, where the shot's reference is older: a frame at
    /// the reference's exposure, which is not kept, shows what has changed since. What is
    /// within the stage's tolerance is granted to the comparisons that follow.
    pub(super) async fn check_return(
        &mut self,
        shot: &Shot,
        reference: Reference<'_>,
    ) -> Result<(), CaptureError> {
        let (Reference::Exposure(before) | Reference::Lamp(before)) = reference else {
            return Ok(());
        };
        let (Some(tolerance_deg), LampState::On(LampChannel(channel))) =
            (self.position_tolerance_deg, shot.lamp)
        else {
            return Ok(());
        };
        let light = shot.key.light;
        if self.devices.is_homed() && before.homing == self.homing {
            return Ok(());
        }
        self.go_to(light).await?;
        if before.homing == self.homing || self.granted.contains_key(&(light, channel)) {
            return Ok(());
        }
        let again = Shot {
            key: FrameKey {
                exposure: NOT_KEPT,
                repeat: channel.into(),
                ..shot.key
            },
            exposure: Seconds(before.requested_s),
            pilot: true,
            ..*shot
        };
        let (frame, sidecar) = self.expose_again_if_lost(again, Reference::None).await?;
        let now = Exposed {
            counts: &frame.counts,
            exposure_s: sidecar.applied.exposure.0,
        };
        let width = self.devices.camera_info.resolution_px[0] as usize;
        let mut granted = 0.0;
        if let Some(change) = change(self.noise, width, before.exposed(), now) {
            if change.is_beyond(tolerance_deg) {
                return Err(CaptureError::LightMoved {
                    light,
                    pattern: change.pattern(),
                    turned_deg: change.turned_deg(),
                    tolerance_deg,
                    explained: change.explained(tolerance_deg),
                });
            }
            let ratio = change.ratio;
            let off = (ratio.ratio - 1.0).abs();
            if off > REFUSED + change.explained(tolerance_deg) + 3.0 * ratio.std_dev {
                return Err(CaptureError::LampDrift {
                    light,
                    channel,
                    change: ratio,
                });
            }
            if off > 3.0 * ratio.std_dev {
                granted = off;
            }
        }
        self.granted.insert((light, channel), granted);
        Ok(())
    }

    /// By how much, relative, the signal under a channel may differ from a reference that
    /// was taken before the stage was homed anew.
    pub(super) fn granted(&self, shot: &Shot, homing: u32) -> f64 {
        match shot.lamp {
            LampState::On(LampChannel(channel)) if homing != self.homing => {
                let granted = self.granted.get(&(shot.key.light, channel));
                granted.copied().unwrap_or(0.0)
            }
            _ => 0.0,
        }
    }
}

/// Number of an exposure that becomes no file.
const NOT_KEPT: u32 = u32::MAX - 1;
