//! Whether the camera obeys its exposure at all. Frames of different exposures
//! are compared as they come; a light that needs one exposure alone has nothing to
//! compare, and a camera that ignores what it confirms would go unnoticed.

use super::Run;
use super::frame::{Shot, Taken};
use crate::capture::CaptureError;
use crate::capture::exposure_check::{Verdict, signal_ratio};
use crate::shown::nth;

impl Run<'_> {
    /// Whether these two frames of one scene would have contradicted each other if
    /// the later one still had the earlier one's exposure.
    pub(super) fn is_shown(&self, earlier: &Taken, later: &Taken) -> bool {
        signal_ratio(self.noise, earlier.exposed(), later.exposed()).is_some_and(|found| {
            found.verdict() != Verdict::Refused
                && found.would_tell(earlier.exposure_s / later.exposure_s)
        })
    }

    /// Whether any channel's two frames do so.
    pub(super) fn any_is_shown(&self, earlier: &[Option<Taken>], later: &[Option<Taken>]) -> bool {
        let mut pairs = earlier.iter().flatten().zip(later.iter().flatten());
        pairs.any(|(earlier, later)| self.is_shown(earlier, later))
    }

    /// One frame at half or twice the exposure of the channel of most signal, for
    /// a light whose frames have shown no change of exposure. `round` numbers it.
    pub(super) async fn prove_exposure(
        &mut self,
        light: u32,
        round: u32,
        latest: &[Option<Taken>],
    ) -> Result<(), CaptureError> {
        let certainty = |taken: &Taken| {
            signal_ratio(self.noise, taken.exposed(), taken.exposed())
                .map_or(f64::INFINITY, |own| own.std_dev)
        };
        let most_telling = latest
            .iter()
            .enumerate()
            .filter_map(|(channel, taken)| Some((channel, taken.as_ref()?.clone())))
            .min_by(|(_, a), (_, b)| certainty(a).total_cmp(&certainty(b)));
        let Some((channel, before)) = most_telling else {
            return Ok(());
        };
        let mut is_shown = false;
        if let Some(exposure_s) = self.other_exposure(before.requested_s) {
            let shot = Shot {
                // No part of the bracket.
                pilot: true,
                ..self.light_shot(light, round, channel, 0, exposure_s)
            };
            let taken = self.take(shot, Some(&before).into()).await?;
            is_shown = self.is_shown(&before, &taken);
        }
        if !is_shown && !self.unproven_reported {
            self.unproven_reported = true;
            let text = format!(
                "{light}: the images cannot show whether the camera obeys its exposure",
                light = nth("light", light)
            );
            self.warn(light, text).await?;
        }
        Ok(())
    }

    /// Half this exposure, or twice it where the camera has none so short. `None`
    /// where it has neither.
    fn other_exposure(&self, exposure_s: f64) -> Option<f64> {
        let rules = &self.plan.exposure;
        let stepped = |wanted_s: f64| match rules.step_s.0 {
            step_s if step_s > 0.0 => (wanted_s / step_s).round() * step_s,
            _ => wanted_s,
        };
        let half_s = stepped(exposure_s / 2.0);
        if half_s >= rules.shortest_s.0 && half_s > 0.0 && half_s < 0.7 * exposure_s {
            return Some(half_s);
        }
        let double_s = stepped(exposure_s * 2.0);
        (double_s <= rules.longest_s.0).then_some(double_s)
    }
}
