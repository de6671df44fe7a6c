//! A capture that chooses its lights as it goes: when it has enough, and what it decided after
//! each.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::units::{Seconds, StageAngles, percent};

/// When a capture has enough lights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Until {
    /// Expected environment error that is enough, above 0.
    pub error: f64,
    /// Lights at most.
    pub max_lights: u32,
    /// Time on the bench after which no light shall end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within_s: Option<Seconds>,
}

/// A direction and what it is expected to add.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ranked {
    /// The direction.
    #[serde(flatten)]
    pub light: StageAngles,
    /// Environment error that is expected with it and all before it.
    #[serde(rename = "expected_error")]
    pub error: f64,
}

/// What was decided after some lights, journalled before anything follows from it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// Of the fit and the prediction.
    pub seed: u64,
    /// Whether the fit of the lights so far can be trusted.
    pub is_trusted: bool,
    /// Environment error that is expected of it.
    pub expected_error: f64,
    /// The free light that lowers it most, where it was looked for.
    pub best: Option<Ranked>,
    /// Why no light follows; `None`: the best one does.
    pub stop: Option<Stop>,
}

/// Why no light follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// The target, by a fit that can be trusted.
    Reached,
    /// As many lights as are allowed.
    MostLights,
    /// Another light would end too late.
    Time,
    /// No direction is free.
    NoneFree,
    /// Twice in succession the best light promised little.
    LittleGain,
}

/// A light that lowers the error by less than this part promises little.
const LEAST_GAIN: f64 = 0.05;

impl Until {
    /// Why no light follows a number of them whose capture took `spent_s`, whatever it would add.
    /// A fit that is not to be trusted has not reached anything.
    pub fn enough(&self, now: &Decision, lights: usize, spent_s: f64) -> Option<Stop> {
        let ends_s = spent_s * (1.0 + 1.0 / lights.max(1) as f64);
        if now.is_trusted && now.expected_error <= self.error {
            Some(Stop::Reached)
        } else if lights >= self.max_lights as usize {
            Some(Stop::MostLights)
        } else {
            let is_late = self.within_s.is_some_and(|most| ends_s > most.0);
            is_late.then_some(Stop::Time)
        }
    }
}

impl Decision {
    /// The light that follows.
    pub fn next(&self) -> Option<StageAngles> {
        let best = self.best.filter(|_| self.stop.is_none());
        best.map(|best| best.light)
    }

    /// Why the best light need not follow; `before` is the decision before this one.
    pub fn futile(&self, before: Option<&Self>) -> Option<Stop> {
        match self.best {
            None => Some(Stop::NoneFree),
            Some(_) => {
                let again = before.is_some_and(Self::promises_little);
                (again && self.promises_little()).then_some(Stop::LittleGain)
            }
        }
    }

    fn promises_little(&self) -> bool {
        let gains = |best: Ranked| best.error <= (1.0 - LEAST_GAIN) * self.expected_error;
        !self.best.is_some_and(gains)
    }
}

impl fmt::Display for Stop {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Reached => "the target is reached",
            Self::MostLights => "these are as many lights as are allowed",
            Self::Time => "another light would take too long",
            Self::NoneFree => "no direction is free",
            Self::LittleGain => "twice the best light promised less than 5% of it",
        })
    }
}

impl fmt::Display for Decision {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let expected = percent(self.expected_error);
        write!(out, "expected environment error {expected}")?;
        if !self.is_trusted {
            write!(out, " by a fit that is not to be trusted")?;
        }
        match (self.stop, self.best) {
            (Some(stop), _) => write!(out, "; no light follows: {stop}"),
            (None, Some(Ranked { light, error })) => {
                write!(out, "; with {light} next {}", percent(error))
            }
            (None, None) => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_capture_stops_for_one_of_five_reasons() {
        let until = Until {
            error: 0.05,
            max_lights: 4,
            within_s: Some(Seconds(100.0)),
        };
        let of = |is_trusted, expected_error, best: Option<f64>| Decision {
            seed: 1,
            is_trusted,
            expected_error,
            best: best.map(|error| Ranked {
                light: StageAngles::new(0.0, 45.0),
                error,
            }),
            stop: None,
        };
        let explains = |error, best| of(true, error, best);
        let weak = explains(0.1, Some(0.096));
        let strong = explains(0.1, Some(0.08));
        for (now, before, lights, spent_s, expected) in [
            (strong, None, 1, 10.0, None),
            (explains(0.05, None), None, 4, 1e3, Some(Stop::Reached)),
            (of(false, 0.01, Some(0.008)), None, 1, 10.0, None),
            (strong, None, 4, 10.0, Some(Stop::MostLights)),
            (strong, None, 3, 74.0, None),
            (strong, None, 3, 76.0, Some(Stop::Time)),
            (explains(0.1, None), None, 1, 10.0, Some(Stop::NoneFree)),
            (weak, None, 1, 10.0, None),
            (weak, Some(strong), 2, 10.0, None),
            (weak, Some(weak), 2, 10.0, Some(Stop::LittleGain)),
        ] {
            let enough = until.enough(&now, lights, spent_s);
            let found = enough.or_else(|| now.futile(before.as_ref()));
            assert_eq!(found, expected, "{now}, {lights} lights, {spent_s} s");
            let stopped = Decision { stop: found, ..now };
            assert_eq!(stopped.next().is_some(), found.is_none());
        }
    }
}
