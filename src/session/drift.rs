//! How the lamp changed while each light was captured, and over the whole session: the last
//! frames of a light repeat one of its first exposures, and the last frames of all those of
//! the first light.

use super::{Session, SessionError};
use crate::device::FrameKind;

/// The lamp over the lights of a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LampDrift {
    /// By light: change of the lamp from its first frames to its last ones, relative, of
    /// the channel that changed most; `None` where the images do not tell.
    pub lights: Vec<Option<f64>>,
    /// Change from the first light to when it was visited again after the last one,
    /// relative; `None` where it was not, or the images do not tell.
    pub over_session: Option<f64>,
}

/// Number of the round in which the first light is visited again; brackets have far fewer.
pub const REVISIT_ROUND: u32 = 1000;

impl LampDrift {
    /// Light and change where it changed most.
    pub fn worst(&self) -> Option<(usize, f64)> {
        let known = self.lights.iter().enumerate();
        known
            .filter_map(|(light, change)| Some((light, (*change)?)))
            .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
    }

    /// Root mean square change within the lights; 0 where nothing is known.
    pub fn rms(&self) -> f64 {
        let known: Vec<f64> = self.lights.iter().flatten().copied().collect();
        let sum: f64 = known.iter().map(|change| change * change).sum();
        (sum / known.len().max(1) as f64).sqrt()
    }

    /// Standard deviation of a light's intensity, relative, that follows: by the changes
    /// within the lights, and by the one over the session as if it had gone evenly.
    pub fn of_intensities(&self) -> f64 {
        self.rms()
            .hypot(self.over_session.unwrap_or(0.0) / 12f64.sqrt())
    }
}

impl Session {
    /// What the repeated frames say of the lamp.
    pub fn lamp_drift(&self) -> Result<LampDrift, SessionError> {
        let plan = &self.record().plan;
        // Each round has a number for every channel and one for the frames without lamp.
        let states = plan.channels.len() as u32 + 1;
        let mut last = vec![None; plan.lights.len()];
        let is_lit = |kind: FrameKind| kind == FrameKind::Light;
        for entry in self.frames().filter(|entry| is_lit(entry.key.kind)) {
            if entry.key.exposure / states == REVISIT_ROUND {
                continue;
            }
            if let Some(last) = last.get_mut(entry.key.light as usize) {
                *last = (*last).max(Some(entry.key.exposure / states));
            }
        }
        let mut lights = vec![None; plan.lights.len()];
        let mut over_session = None;
        for entry in self.frames().filter(|entry| is_lit(entry.key.kind)) {
            let light = entry.key.light as usize;
            let round = entry.key.exposure / states;
            let is_last =
                last.get(light) == Some(&Some(round)) && self.light_is_finished(entry.key.light);
            if !is_last && round != REVISIT_ROUND {
                continue;
            }
            let (_, sidecar) = self.read_frame(&entry)?;
            if let Some(ratio) = sidecar.exposure_ratio.filter(|_| sidecar.pilot) {
                let change: &mut Option<f64> = match round {
                    REVISIT_ROUND => &mut over_session,
                    _ => &mut lights[light],
                };
                if change.is_none_or(|known| (ratio - 1.0).abs() > known.abs()) {
                    *change = Some(ratio - 1.0);
                }
            }
        }
        Ok(LampDrift {
            lights,
            over_session,
        })
    }
}
