//! Back at a light whose frames were begun before the stage was homed anew: after an
//! interruption or a pause.

use super::Run;
use super::frame::{NOT_KEPT, Reference, Shot, Taken};
use crate::capture::CaptureError;
use crate::capture::exposure_check::{Exposed, REFUSED};
use crate::capture::return_check::change;
use crate::device::{FrameKey, LampChannel, LampState};
use crate::units::Seconds;

impl Run<'_> {
    /// Keeps the latest lit frame of each channel at the light under way.
    pub(super) fn keep_as_witness(&mut self, shot: Shot, taken: &Taken) {
        if let LampState::On(_) = shot.lamp {
            self.witnesses
                .retain(|(kept, _)| kept.key.light == shot.key.light && kept.lamp != shot.lamp);
            self.witnesses.push((shot, taken.clone()));
        }
    }

    /// Before the first lit frame at a light that was begun before the last homing: a frame
    /// like one from before, which is not kept, shows what has changed since. What is within
    /// the stage's tolerance is granted to the comparisons that follow.
    pub(super) async fn check_return(
        &mut self,
        shot: &Shot,
        reference: Reference<'_>,
    ) -> Result<(), CaptureError> {
        let light = shot.key.light;
        let (Some(tolerance_deg), LampState::On(_)) = (self.position_tolerance_deg, shot.lamp)
        else {
            return Ok(());
        };
        if matches!(reference, Reference::Revisit(_))
            || (self.devices.is_homed() && self.granted.is_some_and(|(at, _)| at == light))
        {
            return Ok(());
        }
        let homing = self.homing + u32::from(!self.devices.is_homed());
        let is_older =
            |(kept, taken): &&(Shot, Taken)| kept.key.light == light && taken.homing < homing;
        let older: Vec<(Shot, Taken)> = self.witnesses.iter().filter(is_older).cloned().collect();
        if older.is_empty() {
            return Ok(());
        }
        self.go_to(light).await?;
        self.granted = Some((light, 0.0));
        for (kept, before) in older {
            if let Some(granted) = self.changed(&kept, &before, tolerance_deg).await? {
                self.granted = Some((light, granted));
                break;
            }
        }
        Ok(())
    }

    /// By how much, relative, the signal is off from that of a frame from before; `None`
    /// where the frames show too little.
    async fn changed(
        &mut self,
        kept: &Shot,
        before: &Taken,
        tolerance_deg: f64,
    ) -> Result<Option<f64>, CaptureError> {
        let (light, LampState::On(LampChannel(channel))) = (kept.key.light, kept.lamp) else {
            return Ok(None);
        };
        let again = Shot {
            key: FrameKey {
                exposure: NOT_KEPT - u32::from(channel),
                repeat: 0,
                ..kept.key
            },
            exposure: Seconds(before.requested_s),
            pilot: true,
            ..*kept
        };
        let (frame, sidecar) = self.expose_again_if_lost(again, Reference::None).await?;
        let now = Exposed {
            counts: &frame.counts,
            exposure_s: sidecar.applied.exposure.0,
        };
        let width = self.devices.camera_info.resolution_px[0] as usize;
        let Some(change) = change(self.noise, width, before.exposed(), now) else {
            return Ok(None);
        };
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
        let is_certain = off > 3.0 * ratio.std_dev;
        Ok(Some(if is_certain { off } else { 0.0 }))
    }

    /// By how much, relative, the signal at a light may differ from a reference that was
    /// taken before the stage was homed anew.
    pub(super) fn granted(&self, light: u32, homing: u32) -> f64 {
        match self.granted {
            Some((at, granted)) if at == light && homing != self.homing => granted,
            _ => 0.0,
        }
    }
}
