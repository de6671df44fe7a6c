//! How the lamp changed while each light was captured, and over the whole session: the last
//! frames of a light repeat one of its first exposures, and the last frames of all those of
//! the first light. Each comparison has an uncertainty, and a change is notable only where
//! all comparisons of the capture together leave little doubt of it.

use std::collections::BTreeSet;
use std::fmt;

use super::{Event, Session, SessionError};
use crate::device::FrameKind;
use crate::shown::nth;
use crate::statistics::two_sided_normal_quantile;

/// Number of the round in which the first light is visited again; brackets have far fewer.
pub const REVISIT_ROUND: u32 = 1000;

/// Probability that a capture under a constant lamp has any notable change.
pub const FALSE_ALARM_RATE: f64 = 1e-3;
/// Changes up to this are not notable, however certain: an intensity that is known to 1%
/// (the default of `[uncertainty] intensity`) becomes an eighth less certain by it.
pub const NOTABLE: f64 = 0.005;

/// Between which frames the lamp is compared with itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Span {
    /// A light's first frames and its last.
    WithinLight(u32),
    /// The first light's first frames and those of its second visit after the last light.
    OverSession,
}

/// One comparison of the lamp with itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LampChange {
    /// Between which frames.
    pub span: Span,
    /// Index of the lamp channel in the plan.
    pub channel: u32,
    /// Relative change of the signal.
    pub change: f64,
    /// Its standard uncertainty if the lamp is constant, relative: noise of both frames,
    /// and the stage's tolerance where it moved in between. `None` in sessions that were
    /// captured before it was recorded.
    pub std_dev: Option<f64>,
}

/// The lamp over the lights of a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LampDrift {
    /// All comparisons that the images allow, by light and channel, the session's last.
    pub changes: Vec<LampChange>,
}

impl LampDrift {
    /// The changes within lights.
    pub fn within_lights(&self) -> impl Iterator<Item = &LampChange> {
        let is_within = |change: &&LampChange| change.span != Span::OverSession;
        self.changes.iter().filter(is_within)
    }

    /// The changes from the first light to its second visit.
    pub fn over_session(&self) -> impl Iterator<Item = &LampChange> {
        let is_over = |change: &&LampChange| change.span == Span::OverSession;
        self.changes.iter().filter(is_over)
    }

    /// Standard uncertainties beyond which a change is significant: one of as many normal
    /// comparisons as this capture made is beyond them, either way, with the probability
    /// [`FALSE_ALARM_RATE`] (Šidák; less where comparisons share a frame).
    pub fn significant_beyond(&self) -> f64 {
        let known = self.changes.iter().filter(|c| c.std_dev.is_some()).count();
        let each = -f64::exp_m1(f64::ln_1p(-FALSE_ALARM_RATE) / known.max(1) as f64);
        two_sided_normal_quantile(each)
    }

    /// The changes that are significant and matter, the largest first.
    pub fn notable(&self) -> Vec<LampChange> {
        let beyond = self.significant_beyond();
        let is_notable = |change: &LampChange| {
            let significant = change.std_dev.map(|std_dev| beyond * std_dev);
            significant.is_some_and(|least| change.change.abs() > least.max(NOTABLE))
        };
        let mut notable: Vec<_> = self.changes.iter().copied().filter(is_notable).collect();
        notable.sort_by(|a, b| b.change.abs().total_cmp(&a.change.abs()));
        notable
    }

    /// Standard deviation of a light's intensity, relative, that follows: by the changes
    /// within the lights, and by the one over the session as if it had gone evenly. What
    /// noise alone makes of the changes is taken off.
    pub fn of_intensities(&self) -> f64 {
        let within = beyond_noise(self.within_lights());
        (within + beyond_noise(self.over_session()) / 12.0).sqrt()
    }
}

/// Mean square of the changes less that of their uncertainties, at least 0.
fn beyond_noise<'a>(changes: impl Iterator<Item = &'a LampChange>) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for change in changes {
        sum += change.change.powi(2) - change.std_dev.unwrap_or(0.0).powi(2);
        count += 1;
    }
    (sum / f64::from(count.max(1))).max(0.0)
}

impl LampChange {
    /// `+0.53 ± 0.12%`.
    pub fn percent(&self) -> String {
        let percent = 100.0 * self.change;
        match self.std_dev {
            Some(std_dev) => format!("{percent:+.2} ± {:.2}%", 100.0 * std_dev),
            None => format!("{percent:+.2}% (uncertainty not recorded)"),
        }
    }
}

impl fmt::Display for LampChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the lamp drifted by {} ", self.percent())?;
        match self.span {
            Span::WithinLight(light) => write!(f, "during {light}", light = nth("light", light)),
            Span::OverSession => write!(f, "between light 1 and its second visit at the end"),
        }?;
        write!(f, " (lamp channel {})", self.channel)
    }
}

/// Relative standard uncertainty that the stage's tolerance makes between two visits: where
/// each ends anywhere within it, on a surface that the light meets at 45°.
pub(crate) fn of_revisit(tolerance_deg: f64) -> f64 {
    tolerance_deg.to_radians() * (2.0f64 / 3.0).sqrt()
}

impl Session {
    /// What the repeated frames say of the lamp.
    ///
    /// # Errors
    /// A frame that cannot be read or is not what the journal says.
    pub fn lamp_drift(&self) -> Result<LampDrift, SessionError> {
        let plan = &self.record().plan;
        // Each round has a number for every channel and one for the frames without lamp.
        let states = plan.channels.len() as u32 + 1;
        let lit: Vec<_> = self
            .frames()
            .filter(|entry| entry.key.kind == FrameKind::Light && entry.key.repeat == 0)
            .collect();
        let round = |exposure: u32| exposure / states;
        let mut last = vec![0; plan.lights.len()];
        for key in lit.iter().map(|entry| entry.key) {
            if let Some(last) = last.get_mut(key.light as usize)
                && round(key.exposure) != REVISIT_ROUND
            {
                *last = round(key.exposure).max(*last);
            }
        }
        let moved_within = self.lights_homed_within();
        let revisit = of_revisit(plan.stage_tolerance_deg);
        let mut found = LampDrift::default();
        for entry in &lit {
            let key = entry.key;
            let (span, has_moved) = match round(key.exposure) {
                REVISIT_ROUND => (Span::OverSession, true),
                // One more round may follow, which proves exposures.
                round
                    if self.light_is_finished(key.light)
                        && last
                            .get(key.light as usize)
                            .is_some_and(|&l| round + 1 >= l) =>
                {
                    let light = key.light;
                    (Span::WithinLight(light), moved_within.contains(&light))
                }
                _ => continue,
            };
            let (_, sidecar) = self.read_frame(entry)?;
            let is_last = last.get(key.light as usize) == Some(&round(key.exposure));
            let compares = match sidecar.lamp_ratio_std {
                Some(_) => true,
                // Sessions before it was recorded.
                None => sidecar.pilot && (is_last || span == Span::OverSession),
            };
            if let Some(ratio) = sidecar.exposure_ratio.filter(|_| compares) {
                let of_stage = if has_moved { revisit } else { 0.0 };
                found.changes.push(LampChange {
                    span,
                    channel: key.exposure % states,
                    change: ratio - 1.0,
                    std_dev: sidecar
                        .lamp_ratio_std
                        .map(|of_noise| of_noise.hypot(of_stage)),
                });
            }
        }
        Ok(found)
    }

    /// Lights during which the stage was homed anew, after a pause or an interruption.
    fn lights_homed_within(&self) -> BTreeSet<u32> {
        let mut homed = BTreeSet::new();
        let mut current = None;
        for record in &self.journal().records {
            match &record.event {
                Event::Frame { key, .. } => current = Some(key.light),
                Event::LightStop { .. } => current = None,
                Event::Continued | Event::Resume { .. } => homed.extend(current),
                _ => {}
            }
        }
        homed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Changes of a capture of four lights under three channels, visited again, whose noise
    /// is normal and as stated; `drift` within light 2.
    fn capture(seed: u64, std_dev: f64, drift: f64) -> LampDrift {
        let spans = (0..4).map(Span::WithinLight).chain([Span::OverSession]);
        let changes = spans.flat_map(|span| (0..3).map(move |channel| (span, channel)));
        let changes = changes.enumerate().map(|(index, (span, channel))| {
            let noise = stream(seed, Purpose::Experiment, 0, index as u64, 0).normal();
            let drift = if span == Span::WithinLight(2) {
                drift
            } else {
                0.0
            };
            LampChange {
                span,
                channel,
                change: drift + std_dev * noise,
                std_dev: Some(std_dev),
            }
        });
        LampDrift {
            changes: changes.collect(),
        }
    }

    /// The rule alone, on normal noise that is larger than what matters: over 20,000
    /// captures the false-alarm rate is what is stated (20 expected; beyond 38 or below 6
    /// with a probability below 1e-3).
    #[test]
    fn false_alarms_are_as_rare_as_stated() {
        let captures = 20_000;
        let alarms = (0..captures)
            .filter(|&seed| !capture(seed, 0.01, 0.0).notable().is_empty())
            .count();
        assert!((6..=38).contains(&alarms), "{alarms} of {captures}");
    }

    #[test]
    fn a_percent_is_named_and_what_does_not_matter_is_not() {
        let named = |std_dev: f64, drift: f64| {
            let is_named = |seed: &u64| {
                let notable = capture(*seed, std_dev, drift).notable();
                notable.first().map(|change| change.span) == Some(Span::WithinLight(2))
            };
            (0..100).filter(is_named).count()
        };
        assert!(named(0.0014, 0.01) >= 95);
        assert_eq!(named(0.0001, 0.004), 0);
        // Significant alone, but not among fifteen comparisons.
        assert!(named(0.003, 0.009) < 50);
    }

    #[test]
    fn noise_is_no_drift_of_the_intensities() {
        let mean = |std_dev, drift| {
            let all = (0..200).map(|seed| capture(seed, std_dev, drift).of_intensities());
            all.sum::<f64>() / 200.0
        };
        assert!(mean(0.002, 0.0) < 0.0006, "{}", mean(0.002, 0.0));
        // 2% in one light of four.
        assert!((mean(0.002, 0.02) / 0.01 - 1.0).abs() < 0.02);
    }

    #[test]
    fn changes_are_said_with_their_uncertainty() {
        let mut change = LampChange {
            span: Span::WithinLight(1),
            channel: 2,
            change: 0.0053,
            std_dev: Some(0.0012),
        };
        assert_eq!(
            change.to_string(),
            "the lamp drifted by +0.53 ± 0.12% during light 2 (lamp channel 2)"
        );
        change.std_dev = None;
        assert!(change.to_string().contains("uncertainty not recorded"));
        // What is not known to be certain is reported and no remark.
        change.change = 0.5;
        let old = LampDrift {
            changes: vec![change],
        };
        assert_eq!(old.notable(), []);
        assert_eq!(old.of_intensities(), 0.5);
    }
}
