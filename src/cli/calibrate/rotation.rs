//! `rig calibrate pose --rotate`: whether a sample is uniform and isotropic, by sessions
//! between which it was turned.

use std::path::Path;

use serde::Serialize;

use super::target;
use crate::calibrating::{CalibratingError, TurnedSession, compare_turns};
use crate::calibration::rotation::{ChiSquare, RotationError, RotationTest};
use crate::cli::output::write_json;
use crate::cli::{CliError, Context};
use crate::out;

/// `SESSION=DEG`.
pub(super) fn parse(text: &str) -> Result<TurnedSession, String> {
    let parts = text.rsplit_once('=');
    let parsed = parts.and_then(|(root, angle)| Some((root, angle.trim().parse::<f64>().ok()?)));
    match parsed {
        Some((root, angle_deg)) if !root.is_empty() && (-360.0..=360.0).contains(&angle_deg) => {
            Ok(TurnedSession {
                root: root.into(),
                angle_deg,
            })
        }
        _ => Err("a session's folder, =, and degrees from -360 to 360".into()),
    }
}

#[derive(Serialize)]
struct Report {
    passed: bool,
    significance: f64,
    repeatability: f64,
    uniformity: Statistic,
    isotropy: Statistic,
    difference: f64,
    compared: usize,
}

#[derive(Serialize)]
struct Statistic {
    chi2: f64,
    freedom: f64,
    p: f64,
}

impl From<ChiSquare> for Statistic {
    fn from(of: ChiSquare) -> Self {
        Self {
            chi2: of.value,
            freedom: of.freedom,
            p: of.p,
        }
    }
}

/// What to do about it.
fn hint(error: &RotationError) -> &'static str {
    match error {
        RotationError::TooFew { .. } => "name a session for every turn with --rotate SESSION=DEG",
        RotationError::Differs { .. } => {
            "capture every turn with the same lights: `rig capture --lights N --no-fit`"
        }
        RotationError::NotSymmetric { .. } => {
            "turn the sample by an angle under which its shape is the same: any for a bowl, 120 \
             degrees for a three-sided corner"
        }
        RotationError::NothingSeen { .. } => "use more lights, or more pixels on the sample",
    }
}

/// Compares `first` (0 degrees) with `others`.
pub(super) fn run(
    first: &Path,
    others: &[TurnedSession],
    repeatability: f64,
    significance: f64,
    json: bool,
    context: &Context,
) -> Result<(), CliError> {
    let found = compare_turns(first, others, repeatability, context);
    let found = found.map_err(|error| match error {
        CalibratingError::Rotation(error) => {
            let hint = hint(&error);
            CliError::new(error.to_string()).hint(hint)
        }
        error => target::advised(error),
    })?;
    let passed = found.passes(significance);
    if json {
        write_json(&Report {
            passed,
            significance,
            repeatability,
            uniformity: found.uniformity.into(),
            isotropy: found.isotropy.into(),
            difference: found.difference,
            compared: found.compared,
        })?;
    } else {
        for (what, test) in [
            ("uniformity", found.uniformity),
            ("isotropy", found.isotropy),
        ] {
            let verdict = match test.p >= 0.5 * significance {
                true => "passed",
                false => "failed",
            };
            out!(
                "{what}: {verdict}, χ² {:.1} for {:.0} degrees of freedom, p = {:.2e}",
                test.value,
                test.freedom,
                test.p
            )?;
        }
    }
    verdict(&found, significance)
}

fn verdict(found: &RotationTest, significance: f64) -> Result<(), CliError> {
    if found.passes(significance) {
        return Ok(());
    }
    let percent = 100.0 * found.difference;
    let (fact, hint) = match found.uniformity.p <= found.isotropy.p {
        true => (
            "is not of one material all over",
            "clean it of dust; a fit would find a mean of its materials",
        ),
        false => (
            "reflects otherwise when turned",
            "it may have a grain, which no isotropic BRDF describes; or it was seated otherwise: \
             state how well seating repeats with --repeatability",
        ),
    };
    Err(CliError::new(format!(
        "the sample {fact}: turns differ by {percent:.1}% (root mean square) in its regions"
    ))
    .hint(hint))
}
