//! What the camera sees of the sample, and where light can come from.

use super::{Check, Trouble};
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, depth_of_field};
use crate::capture::directions::{Aim, plan_order};
use crate::capture::reach::StageReach;
use crate::config::scene_concern::{DescribedIn, SceneConcern, extent_in_image};
use crate::config::{BuildError, ResolvedRig, RigConfig};
use crate::transport::CameraBody;
use crate::transport::visibility::{Concern, Visibility};

/// Lights within a stage's reach that stand for all of them while none is planned.
const LIGHTS_LOOKED_AT: usize = 16;

pub(super) fn checks(rig: &ResolvedRig, library: &Library) -> Vec<Check> {
    let view = view(&rig.config).unwrap_or_else(|error| Check::refused("view", error));
    let is_in_view = view.verdict != super::Verdict::Failed;
    let body = rig.config.geometry.camera_body;
    let paths = match StageReach::of_rig(&rig.config) {
        Ok(reach) => light_paths(&reach, body),
        Err(error) => Check::refused("light paths", error),
    };
    vec![view, paths, sharpness(rig, library, is_in_view)]
}

/// The sample as this rig's camera sees it. No light is planned: those within reach must all
/// fail to be a concern.
fn view(config: &RigConfig) -> Result<Check, BuildError> {
    let name = "view";
    let reach = StageReach::of_rig(config)?;
    let aim = Aim::of(&config.geometry);
    let lights = plan_order(&reach, aim, LIGHTS_LOOKED_AT, 0.0);
    let scene = config.geometry.scene(&lights)?;
    let seen = Visibility::of(&scene);
    let surface = &config.geometry.sample.surface;
    let mut concerns = SceneConcern::all(&seen, DescribedIn::Rig, surface);
    let is_of_a_light = |c: &SceneConcern| matches!(c.concern, Concern::Unlit { .. });
    if concerns.iter().filter(|c| is_of_a_light(c)).count() < lights.len() {
        concerns.retain(|concern| !is_of_a_light(concern));
    }
    Ok(match concerns.into_iter().next() {
        Some(concern) if is_of_a_light(&concern) => {
            let fact = format!(
                "none of {} lights spread over the stage's reach reaches what the camera sees of the sample",
                lights.len()
            );
            Check::failed(name, fact, Trouble::OutOfReach)
        }
        Some(concern) => {
            let check = match concern.concern.is_fatal() {
                true => Check::failed,
                false => Check::warning,
            };
            check(name, concern.to_string(), Trouble::Scene(Box::new(concern)))
        }
        None => {
            let fact = format!("the sample is in view: {}", extent_in_image(&seen));
            match scene.remarks().first() {
                Some(remark) => Check::warning(name, fact, Trouble::Mesh(remark.to_string())),
                None => Check::ok(name, fact),
            }
        }
    })
}

/// What the camera's body leaves of the directions within reach.
fn light_paths(reach: &StageReach, body: Option<CameraBody>) -> Check {
    let name = "light paths";
    let Some(body) = body else {
        let fact = "no camera body is stated: no direction counts as blocked";
        return Check::ok(name, fact);
    };
    let (all, blocked) = (reach.reachable().len(), reach.blocked());
    let body = format!(
        "with the camera's body of {} mm radius and {} mm length",
        body.radius_mm, body.length_mm
    );
    if blocked.is_empty() {
        return Check::ok(
            name,
            format!("{body}, all {all} directions within reach are free"),
        );
    }
    let elevations = blocked.iter().map(|angles| angles.elevation_deg);
    let lowest_deg = elevations.fold(f64::INFINITY, f64::min);
    let fact = format!(
        "{body}, {} of {all} directions within reach are blocked, the lowest at elevation {lowest_deg:.1}°; plans leave them out",
        blocked.len()
    );
    match (blocked.len() == all, reach.is_fixed()) {
        (true, _) => Check::failed(name, fact, Trouble::AllBlocked),
        (false, true) => Check::warning(name, fact, Trouble::SomeBlocked),
        (false, false) => Check::ok(name, fact),
    }
}

fn sharpness(rig: &ResolvedRig, library: &Library, is_in_view: bool) -> Check {
    let name = "depth of field";
    let named = rig.config.calibration.focus.as_deref();
    // A record that cannot be read has its own line.
    let focus = library.load::<FocusValues>(named).unwrap_or_default();
    let focus = focus.as_ref().map(|loaded| &loaded.record.values);
    let limit_px = rig.config.capture.blur_limit_px;
    match depth_of_field::of_rig(&rig.config, focus) {
        Err(error) => Check::warning(name, error.to_string(), Trouble::Error(Box::new(error))),
        Ok(None) if is_in_view => Check::ok(name, "unlimited: no aperture is stated"),
        Ok(None) => Check::ok(name, "not checked: the camera doesn't see the sample"),
        Ok(Some(found)) if found.worst.disc_px > limit_px => {
            Check::warning(name, found.concern(limit_px), Trouble::Blurred)
        }
        Ok(Some(found)) => Check::ok(name, found.to_string()),
    }
}
