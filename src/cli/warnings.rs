//! What a person should know before trusting a fit.

use super::Context;
use crate::brdf::check;
use crate::inverse::Fit;
use crate::inverse::diagnosis::Cause;
use crate::session::fit_record::{FitRecord, Warning};

/// Reasons not to trust a fit, with what most likely made them.
pub(super) fn warnings(fit: &Fit, record: &FitRecord) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut warn = |what: String, likely_cause: &str| {
        warnings.push(Warning {
            what,
            likely_cause: likely_cause.to_owned(),
        });
    };
    let diagnosis = &fit.diagnosis;
    let deviations = diagnosis.mean_square.sqrt();
    if let Some(cause) = diagnosis.finding() {
        let part = Cause::ALL
            .into_iter()
            .zip(diagnosis.explained)
            .find(|(c, _)| *c == cause)
            .map_or(0.0, |(_, part)| {
                100.0 * (part / diagnosis.mean_square).clamp(0.0, 1.0)
            });
        warn(
            format!(
                "the images differ from those of the material by {deviations:.1} times what noise and model error allow (root mean square), {part:.0}% of it as {} would",
                looks_like(cause)
            ),
            advice(cause),
        );
    } else if diagnosis.is_unexplained() {
        warn(
            format!(
                "the images differ from those of the material by {deviations:.1} times what noise and model error allow (root mean square), not as any one fault would"
            ),
            "a depth or shape that is not the mesh's, light that spreads below the surface, or a material beyond what mixtures and departures hold; the report's residuals show where",
        );
    }
    for (light, &share) in record.truncation_remainder.iter().enumerate() {
        if share > NOTABLE_REMAINDER {
            warn(
                format!(
                    "paths of more than {} reflections, which were not followed, hold {:.2}% of the light (light {light})",
                    record.settings.max_reflections,
                    100.0 * share
                ),
                "--max-reflections is too small for so bright a material in so deep a shape",
            );
        }
    }
    for (light, &part) in fit.doubted.iter().enumerate() {
        if part > NOTABLE_DOUBT {
            warn(
                format!(
                    "{:.1}% of the values of light {light} are isolated outliers and counted for less",
                    100.0 * part
                ),
                "dust or scratches on the sample, or hot pixels",
            );
        }
    }
    // A mixture reflects at most what arrives; what departs from it need not.
    let excess = || check::check_with(&fit.material, ALBEDO_DIRECTIONS, 0).excess();
    if let Some((albedo, theta_deg, channel)) = (fit.departure > 0.0).then(excess).flatten() {
        warn(
            format!(
                "the material, as it departs from the mixture, would reflect {:.0}% of the {} light that arrives at {theta_deg}° from the normal",
                100.0 * albedo,
                ["red", "green", "blue"][channel]
            ),
            "angles that the images show little of, or intensities that are off; capture more lights, or render the mixture alone (rig export --format mitsuba)",
        );
    }
    if fit.samples[0] < FEW_PATHS {
        warn(
            format!(
                "{} paths per pixel were followed; below {FEW_PATHS} the paths' noise can steer the fit",
                fit.samples[0]
            ),
            "--spp or --memory is small",
        );
    }
    warnings
}

/// Says them at the terminal.
pub(super) fn tell(warnings: &[Warning], context: &Context) {
    for Warning { what, likely_cause } in warnings {
        context.warn_of(what, likely_cause);
    }
}

/// Light beyond the longest path that a fit should not leave out.
const NOTABLE_REMAINDER: f64 = 1e-3;
/// Part of the values that dust may cover unmentioned.
const NOTABLE_DOUBT: f64 = 0.02;
/// Paths per pixel from which independent halves work well.
const FEW_PATHS: u32 = 128;
/// Directions per technique that an albedo takes.
const ALBEDO_DIRECTIONS: u32 = 1024;

/// What the residual looks like, by cause.
fn looks_like(cause: Cause) -> &'static str {
    match cause {
        Cause::StrayLight => "stray light",
        Cause::ShapeOrPose => "a wrong shape or pose",
        Cause::NonUniform => "a material that varies",
        Cause::Translucency => "translucency or blur",
        Cause::Dictionary => "a material beyond the dictionary",
    }
}

/// What to look at, by cause.
fn advice(cause: Cause) -> &'static str {
    match cause {
        Cause::StrayLight => {
            "stray light from the room or the holder; darken it, or subtract frames taken with the lamp off"
        }
        Cause::ShapeOrPose => {
            "the sample is not where, or not of the shape that, the scene file says; measure its pose again"
        }
        Cause::NonUniform => {
            "the material differs between places; fit a uniform region alone with --mask"
        }
        Cause::Translucency => {
            "light spreads below the surface, or the image is not sharp; neither is part of the model"
        }
        Cause::Dictionary => {
            "neither mixtures of the dictionary nor what departs from them holds the material; try another with --dictionary, or more lights"
        }
    }
}
