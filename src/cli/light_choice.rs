//! Light directions chosen for what they tell: `rig capture --lights best:N`.

use glam::DVec3;

use super::{CliError, Context, HintExt};
use crate::brdf::Dictionary;
use crate::capture::CaptureError;
use crate::capture::directions::{StageReach, farthest_point_order};
use crate::config::RigConfig;
use crate::inverse::light_selection::{
    PRIOR_MATERIALS, Prospects, SelectionOptions, prior_materials,
};
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
    let candidates = farthest_point_order(reach, coaxial, CANDIDATES, 0.0);
    if candidates.len() < count {
        return Err(CaptureError::TooManyLights {
            wanted: count,
            reachable: candidates.len(),
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

/// The same view in fewer pixels.
pub fn coarse(mut scene: Scene) -> Scene {
    let longer = scene.camera.resolution_px.into_iter().max().unwrap_or(1);
    let scale = (RESOLUTION_PX as f64 / longer as f64).min(1.0);
    scene.camera.resolution_px = scene
        .camera
        .resolution_px
        .map(|pixels| ((pixels as f64 * scale).round() as usize).max(1));
    scene
}
