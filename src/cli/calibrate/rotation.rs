//! `rig calibrate pose --rotate`: whether a sample is uniform and isotropic, by sessions
//! between which it was turned.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::calibration::rotation::{ChiSquare, RotationError, RotationTest, Turn, compare};
use crate::cli::output::write_json;
use crate::cli::{CliError, Context};
use crate::out;
use crate::workflow::{BenchRecords, session_images};

/// A session, and by how much the sample was turned for it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TurnedSession {
    root: PathBuf,
    angle_deg: f64,
}

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
    let mut session = session_images(first)?;
    let bench = BenchRecords::load(first)?.apply(&session.config, &mut session.places, context);
    let scene = bench.geometry.scene(&session.places)?;
    // The turned sessions, under the same lights.
    let mut turned = Vec::new();
    for other in others {
        let images = session_images(&other.root)?;
        let same = images.places.len() == session.places.len()
            && images.places.iter().zip(&session.places).all(|(a, b)| {
                a.to_light().angle_between(b.to_light()).to_degrees() < SAME_LIGHT_DEG
            });
        // What was read back has the offset of the records, which the first has lost to them.
        let planned = images.session.record().plan.lights == session.session.record().plan.lights;
        if !same && !planned {
            return Err(
                CliError::new(format!("{} has other lights", other.root.display()))
                    .hint(hint(&RotationError::Differs { index: 0 })),
            );
        }
        turned.push((other.angle_deg, images.captured));
    }
    // The comparison.
    let mut turns = vec![Turn {
        angle_deg: 0.0,
        images: &session.captured,
    }];
    turns.extend(turned.iter().map(|(angle_deg, images)| Turn {
        angle_deg: *angle_deg,
        images,
    }));
    let found = compare(&scene, &turns, repeatability).map_err(|error| {
        let hint = hint(&error);
        CliError::new(error.to_string()).hint(hint)
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

/// Two lights further apart are others, degrees.
const SAME_LIGHT_DEG: f64 = 1.0;

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
