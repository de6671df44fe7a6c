//! Light directions chosen for what they tell: `rig capture --lights best:N` before
//! anything is known, `rig evaluate next-light --session S` after a fit.

use std::path::Path;

use glam::DVec3;
use nalgebra::DVector;

use super::output::write_json;
use super::{CliError, Context, HintExt};
use crate::brdf::Dictionary;
use crate::capture::CaptureError;
use crate::capture::directions::plan_order;
use crate::capture::reach::StageReach;
use crate::config::RigConfig;
use crate::inverse::light_selection::{
    PRIOR_MATERIALS, Prospects, SelectionOptions, prior_materials,
};
use crate::out;
use crate::session::{Session, fit_record};
use crate::transport::Scene;
use crate::units::StageAngles;

/// Directions that are compared: the first of the evenly spread ones.
pub const CANDIDATES: usize = 60;
/// Pixels along the longer side of the images that are compared.
const RESOLUTION_PX: usize = 24;

/// The best `count` directions within reach for a material of which nothing is known,
/// best first. Says how much of the BRDF's variance each is expected to leave.
pub fn best(
    config: &RigConfig,
    reach: &StageReach,
    coaxial: DVec3,
    count: usize,
    context: &Context,
) -> Result<Vec<StageAngles>, CliError> {
    let candidates = plan_order(reach, coaxial, CANDIDATES, 0.0);
    if candidates.len() < count {
        return Err(CaptureError::TooManyLights {
            wanted: count,
            reachable: candidates.len(),
            blocked: reach.blocked().len(),
        }
        .into());
    }
    let dictionary = Dictionary::load(&config.fit.dictionary)?;
    let options = SelectionOptions {
        seed: config.fit.seed,
        ..SelectionOptions::default()
    };
    let materials = prior_materials(&dictionary, PRIOR_MATERIALS, options.seed);
    let bar = context.spinner();
    bar.set_message(format!("comparing {} light directions", candidates.len()));
    let scene = coarse(config.geometry.scene(&candidates)?);
    let prospects = Prospects::new(scene, &dictionary, &materials, &options)
        .hint("`--lights N` spreads the lights evenly with any dictionary")?;
    bar.finish_and_clear();
    let best = prospects.best(count);
    let left: Vec<String> = best
        .iter()
        .map(|choice| format!("{:.1}%", 100.0 * choice.remaining))
        .collect();
    context.note(format!(
        "best of {} directions; expected variance of the BRDF left after each: {}",
        candidates.len(),
        left.join(", ")
    ));
    Ok(best
        .iter()
        .map(|choice| candidates[choice.candidate])
        .collect())
}

/// Prints the directions that would add most to a fitted session, best first.
pub fn next(root: &Path, json: bool, context: &Context) -> Result<(), CliError> {
    let session = Session::open(root)?;
    let record = session.record();
    let number = fit_record::numbers_in(&session).pop().ok_or_else(|| {
        CliError::new(format!("{} holds no fit", root.display())).hint(
            "`rig fit SESSION` makes one; before a capture, `rig capture --lights best:N` chooses",
        )
    })?;
    let fit = fit_record::read_in(&session, number)?;
    let mixture = fit.mixture()?;
    let config = session.rig()?;

    let planned = record.plan.lights.iter().enumerate();
    let mut candidates: Vec<StageAngles> = planned
        .filter(|(index, _)| session.light_is_finished(*index as u32))
        .map(|(_, &angles)| angles)
        .collect();
    let taken: Vec<usize> = (0..candidates.len()).collect();
    let spread = plan_order(
        &StageReach::of_rig(&config)?,
        config.geometry.coaxial(),
        CANDIDATES,
        0.0,
    );
    candidates.extend(spread.into_iter().filter(|angles| {
        let near = |other: &StageAngles| other.to_light().dot(angles.to_light()) > NEAR_COSINE;
        !record.plan.lights.iter().any(near)
    }));

    let bar = context.spinner();
    bar.set_message(format!("comparing {} light directions", candidates.len()));
    let materials: Vec<DVector<f64>> = mixture
        .weights()
        .iter()
        .map(|weights| DVector::from_column_slice(weights))
        .collect();
    let options = SelectionOptions {
        seed: config.fit.seed,
        ..SelectionOptions::default()
    };
    let scene = coarse(config.geometry.scene(&candidates)?);
    let prospects = Prospects::new(scene, mixture.dictionary(), &materials, &options)?;
    bar.finish_and_clear();
    let now = prospects.remaining(&taken);
    let next = prospects.greedy(&taken, SHOWN);
    let rows = next.iter().map(|c| (candidates[c.candidate], c.remaining));
    if json {
        let lights: Vec<_> = rows
            .map(|(angles, remaining)| {
                serde_json::json!({
                    "azimuth_deg": angles.azimuth_deg,
                    "elevation_deg": angles.elevation_deg,
                    "expected_variance_left": remaining,
                })
            })
            .collect();
        return write_json(&serde_json::json!({
            "session": root,
            "fit": number,
            "lights_taken": taken.len(),
            "expected_variance_left": now,
            "next": lights,
        }));
    }
    out!(
        "expected variance of the BRDF after the {} lights taken: {:.2}% of that without images",
        taken.len(),
        100.0 * now
    )?;
    for (angles, remaining) in rows {
        out!("  with {angles}: {:.2}%", 100.0 * remaining)?;
    }
    Ok(())
}

/// Directions that `rig evaluate next-light --session` names.
const SHOWN: usize = 5;
/// Cosine of the angle within which a direction counts as taken already, 1°.
const NEAR_COSINE: f64 = 0.999_848;

/// The same view in fewer pixels.
pub fn coarse(mut scene: Scene) -> Scene {
    let longer = scene.camera.resolution_px.into_iter().max().unwrap_or(1);
    let scale = (RESOLUTION_PX as f64 / longer as f64).min(1.0);
    scene.camera.point_spread_px *= scale;
    scene.camera.resolution_px = scene
        .camera
        .resolution_px
        .map(|pixels| ((pixels as f64 * scale).round() as usize).max(1));
    scene
}
