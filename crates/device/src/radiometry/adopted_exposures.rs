//! Exposures as the frames themselves show them, in place of the stated ones.

use std::fmt;

use super::agreement::ExposureAgreement;
use super::bracket_doubts::shown_s;
use super::stack::Stack;

/// An exposure that a merge used.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct UsedExposure {
    /// As stated, seconds.
    pub stated_s: f64,
    /// As used, seconds: the shortest as stated, the others as their light is to it.
    pub used_s: f64,
    /// Relative standard uncertainty of the used one against the shortest, from noise and
    /// black level or response; `None` where nothing could be compared, and the stated one used.
    pub relative_std: Option<f64>,
}

impl fmt::Display for UsedExposure {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let stated_s = shown_s(self.stated_s);
        match self.relative_std {
            Some(0.0) => write!(
                out,
                "the exposure of {stated_s} s is used as stated, the others against it"
            ),
            Some(std) => write!(
                out,
                "the exposure of {stated_s} s is used as {} s ± {:.2}%, as its light shows",
                shown_s(self.used_s),
                100.0 * std
            ),
            None => write!(
                out,
                "the exposure of {stated_s} s is used as stated: no pixel of it is measured by a \
                 shorter one as well"
            ),
        }
    }
}

/// A pass changes only what depends on the exposures before, so few are needed.
const MOST_PASSES: usize = 12;
/// Ratios this close to 1 are taken for 1.
const SETTLED: f64 = 1e-5;

/// Changes the exposures of a stack to those at which each collects what the shorter ones
/// predict, as `survey` reports it; those of frames without light change with them. Colours
/// count by their uncertainty.
pub(super) fn adopt<E>(
    stack: &mut Stack,
    survey: impl Fn(&Stack) -> Result<Vec<Vec<ExposureAgreement>>, E>,
) -> Result<Vec<UsedExposure>, E> {
    let mut used: Vec<UsedExposure> = Vec::new();
    for _ in 0..MOST_PASSES {
        let colours = survey(stack)?;
        if used.is_empty() {
            used = as_stated(&colours);
        }
        let mut settled = true;
        let before = used.clone();
        let mut earlier_std = 0.0;
        for exposure in used.iter_mut().skip(1) {
            exposure.relative_std = None;
            let Some((ratio, std)) = ratio(&colours, exposure.used_s) else {
                continue;
            };
            settled &= (ratio - 1.0).abs() < SETTLED;
            exposure.used_s *= ratio;
            earlier_std = f64::hypot(earlier_std, std);
            exposure.relative_std = Some(earlier_std);
        }
        stack.change_exposures(|exposure_s| {
            let at = before.iter().position(|e| is_same(e.used_s, exposure_s));
            at.map_or(exposure_s, |at| used[at].used_s)
        });
        if settled {
            break;
        }
    }
    Ok(used)
}

fn is_same(a_s: f64, b_s: f64) -> bool {
    (a_s - b_s).abs() <= 1e-9 * b_s
}

fn as_stated(colours: &[Vec<ExposureAgreement>]) -> Vec<UsedExposure> {
    let steps = colours.first().map_or(&[][..], Vec::as_slice);
    let stated = steps.iter().enumerate().map(|(index, step)| UsedExposure {
        stated_s: step.exposure_s,
        used_s: step.exposure_s,
        relative_std: (index == 0).then_some(0.0),
    });
    stated.collect()
}

/// The ratio of an exposure over all colours, by their uncertainties, and its own.
fn ratio(colours: &[Vec<ExposureAgreement>], exposure_s: f64) -> Option<(f64, f64)> {
    let steps = colours.iter().flatten();
    let (mut score, mut information) = (0.0, 0.0);
    for step in steps.filter(|step| is_same(step.exposure_s, exposure_s)) {
        if step.pixels > 0 && step.signal_ratio > 0.0 && step.signal_ratio_std > 0.0 {
            let weight = step.signal_ratio_std.powi(-2);
            score += weight * step.signal_ratio;
            information += weight;
        }
    }
    (information > 0.0).then(|| (score / information, information.sqrt().recip()))
}
