//! What makes a scene not worth measuring, reported before anything moves or is rendered:
//! [`Visibility`] finds the facts, here are their wording and the advice.

use super::context::Context;
use super::error::CliError;
use crate::capture::directions::plan_order;
use crate::capture::reach::StageReach;
use crate::config::RigConfig;
use crate::config::scene::SceneFile;
use crate::config::view::SurfaceSpec;
use crate::geometry::inspect::UNITS;
use crate::transport::visibility::{Concern, Visibility};
use crate::transport::{CameraBody, Scene};

/// Lights within a stage's reach that stand for all of them while none is planned.
const LIGHTS_LOOKED_AT: usize = 16;

/// How many times the field's width a sample is long that was made for it. Another unit
/// that brings a mesh into this range is likely its own.
const SUITS_THE_FIELD: std::ops::RangeInclusive<f64> = 0.05..=3.0;

/// Refuses a scene of which images can tell nothing; what is worth a remark goes to stderr.
pub(super) fn check_scene(
    scene: &Scene,
    keys: Keys<'_>,
    context: &Context,
) -> Result<(), CliError> {
    remark_on(scene, keys, context, Concern::is_fatal)
}

/// Warns of what is wrong with a scene file's scene, which is rendered all the same.
pub(super) fn remark_on_scene(scene: &Scene, file: &SceneFile, context: &Context) {
    // None is fatal, so that it cannot fail.
    drop(remark_on(scene, Keys::scene(file), context, |_| false));
}

/// Warns of each concern, unless it is fatal.
fn remark_on(
    scene: &Scene,
    keys: Keys<'_>,
    context: &Context,
    is_fatal: impl Fn(&Concern) -> bool,
) -> Result<(), CliError> {
    for remark in scene.remarks() {
        context.warn(remark);
    }
    let seen = Visibility::of(scene);
    for concern in seen.concerns() {
        let (fact, remedy) = (fact(&concern, &seen), remedy(&concern, &seen, keys));
        if is_fatal(&concern) {
            return Err(CliError::new(fact).hint(remedy));
        }
        context.warn(format_args!("{fact}; {remedy}"));
    }
    Ok(())
}

/// What a check of a rig found.
pub(super) struct Outlook {
    pub(super) fact: String,
    /// What speaks against it.
    pub(super) concern: Option<Remedied>,
}

/// What to do about a concern.
pub(super) struct Remedied {
    pub(super) remedy: String,
    pub(super) is_fatal: bool,
}

/// The sample as this rig's camera sees it. No light is planned: those within reach must all
/// fail to be a concern.
pub(super) fn outlook(config: &RigConfig) -> Result<Outlook, CliError> {
    let reach = StageReach::of_rig(config)?;
    let coaxial = config.geometry.coaxial();
    let lights = plan_order(&reach, coaxial, LIGHTS_LOOKED_AT, 0.0);
    let scene = config.geometry.scene(&lights)?;
    let seen = Visibility::of(&scene);
    let mut concerns = seen.concerns();
    if concerns.iter().filter(|c| is_of_a_light(c)).count() < lights.len() {
        concerns.retain(|concern| !is_of_a_light(concern));
    }
    Ok(match concerns.first() {
        Some(Concern::Unlit { .. }) => Outlook {
            fact: format!(
                "none of {} lights spread over the stage's reach reaches what the camera sees of the sample",
                lights.len()
            ),
            concern: Some(Remedied {
                remedy:
                    "correct [geometry.sample_from_stage] or the limits of [stage] in the rig file"
                        .to_owned(),
                is_fatal: true,
            }),
        },
        Some(concern) => Outlook {
            fact: fact(concern, &seen),
            concern: Some(Remedied {
                remedy: remedy(concern, &seen, Keys::rig(config)),
                is_fatal: concern.is_fatal(),
            }),
        },
        None => Outlook {
            fact: format!("the sample is in view: {}", position(&seen)),
            concern: scene.remarks().first().map(|remark| Remedied {
                remedy: format!("repair the mesh where it was made: {remark}"),
                is_fatal: false,
            }),
        },
    })
}

/// What the camera's body leaves of the directions within reach.
pub(super) fn light_paths(reach: &StageReach, body: Option<CameraBody>) -> Outlook {
    let free_of_concern = |fact: String| Outlook {
        fact,
        concern: None,
    };
    let Some(body) = body else {
        let fact = "no camera body is stated: no direction counts as blocked";
        return free_of_concern(fact.to_owned());
    };
    let (all, blocked) = (reach.reachable().len(), reach.blocked());
    let body = format!(
        "with the camera's body of {} mm radius and {} mm length",
        body.radius_mm, body.length_mm
    );
    let elevations = blocked.iter().map(|angles| angles.elevation_deg);
    let lowest_deg = elevations.fold(f64::INFINITY, f64::min);
    if blocked.is_empty() {
        return free_of_concern(format!(
            "{body}, all {all} directions within reach are free"
        ));
    }
    let fact = format!(
        "{body}, {} of {all} directions within reach are blocked, the lowest at elevation {lowest_deg:.1}°; plans leave them out",
        blocked.len()
    );
    let remedied = |remedy: &str, is_fatal| {
        let remedy = remedy.to_owned();
        Some(Remedied { remedy, is_fatal })
    };
    let concern = match (blocked.len() == all, reach.is_fixed()) {
        (true, _) => remedied(
            "correct [geometry.camera] body, or the limits of [stage] in the rig file",
            true,
        ),
        (false, true) => remedied(
            "move the camera farther away, take a slimmer lens, or leave those lights out of the rig file",
            false,
        ),
        (false, false) => None,
    };
    Outlook { fact, concern }
}

fn is_of_a_light(concern: &Concern) -> bool {
    matches!(concern, Concern::Unlit { .. })
}

/// The fact, with where the sample appears.
pub(super) fn fact(concern: &Concern, seen: &Visibility) -> String {
    match concern {
        Concern::Unlit { .. } => concern.to_string(),
        _ => format!("{concern}; {}", position(seen)),
    }
}

/// The sample's box, in millimetres and in the image, and the field of view.
fn position(seen: &Visibility) -> String {
    let [low, high] = seen.bounds_mm;
    let size = high - low;
    let [width, height] = seen.resolution_px;
    let in_image = match seen.projected_px {
        Some([from, to]) => format!(
            "x {:.1} to {:.1} and y {:.1} to {:.1} px of an image of {width} × {height} px",
            from.x, to.x, from.y, to.y
        ),
        None => format!(
            "no position: a part of it is behind the camera, whose image has {width} × {height} px"
        ),
    };
    format!(
        "its box of {} × {} × {} mm (x {} to {}, y {} to {}, z {} to {}) appears at {in_image}, the field of view is {} × {} mm",
        mm(size.x),
        mm(size.y),
        mm(size.z),
        mm(low.x),
        mm(high.x),
        mm(low.y),
        mm(high.y),
        mm(low.z),
        mm(high.z),
        mm(seen.field_mm.x),
        mm(seen.field_mm.y),
    )
}

/// Millimetres with about three digits.
fn mm(length: f64) -> String {
    let digits = match length.abs() {
        1e-6..0.1 => 4,
        0.1..1.0 => 2,
        _ => 1,
    };
    // No negative zero.
    format!("{:.digits$}", length + 0.0)
}

/// How the keys of a file are called, and what the file states of the sample's surface.
#[derive(Clone, Copy)]
pub(super) struct Keys<'a> {
    camera: &'static str,
    sample: &'static str,
    light: &'static str,
    surface: &'a SurfaceSpec,
}

impl<'a> Keys<'a> {
    /// Of a rig file, or the session made by it.
    pub(super) fn rig(config: &'a RigConfig) -> Self {
        Self {
            camera: "[geometry.camera] in the rig file",
            sample: "[geometry.sample] in the rig file",
            light: "leave this light out (`--light AZ,EL` names lights one by one), or correct [geometry.sample_from_stage] in the rig file if the stage stands otherwise",
            surface: &config.geometry.sample.surface,
        }
    }

    /// Of a scene file.
    pub(super) fn scene(file: &'a SceneFile) -> Self {
        Self {
            camera: "[camera] in the scene file",
            sample: "[sample] in the scene file",
            light: "correct the light's direction in the scene file: it points from the sample to the lamp",
            surface: &file.sample.surface,
        }
    }

    /// The unit in which a mesh so many times the field's length would suit it, if its own
    /// does not.
    fn better_unit(&self, times: f64) -> Option<&'static str> {
        let SurfaceSpec::Mesh(mesh) = self.surface else {
            return None;
        };
        if SUITS_THE_FIELD.contains(&times) {
            return None;
        }
        let suits = |mm: f64| SUITS_THE_FIELD.contains(&(times * mm / mesh.placement.mm_per_unit));
        let unit = UNITS.iter().find(|(_, mm)| suits(*mm));
        unit.map(|(name, _)| *name)
    }
}

/// What to do about it.
pub(super) fn remedy(concern: &Concern, seen: &Visibility, keys: Keys<'_>) -> String {
    let (camera, sample) = (keys.camera, keys.sample);
    let better_unit = keys.better_unit(seen.times_the_field());
    let [low, high] = seen.bounds_mm;
    match (concern, keys.surface, better_unit) {
        (
            Concern::OutOfView { .. } | Concern::PartlyInView { .. } | Concern::TooSmall { .. },
            SurfaceSpec::Mesh(_),
            Some(unit),
        ) => format!(
            "the mesh is {} mm across, the view {} mm: if the mesh is in another unit, say so: mesh_unit = \"{unit}\" in {sample}",
            mm((high - low).max_element()),
            mm(seen.field_mm.max_element())
        ),
        (
            Concern::OutOfView { .. } | Concern::PartlyInView { .. },
            SurfaceSpec::Mesh(mesh),
            None,
        ) => format!(
            "correct position_mm, look_at_mm and the field of view of {camera}, or bring the mesh's own axes to the sample's with mesh_to_sample in {sample}, for which `rig shape --inspect {}` makes a suggestion: the origin of the sample's frame is on its datum",
            mesh.path.display()
        ),
        (Concern::OutOfView { .. } | Concern::PartlyInView { .. }, ..) => format!(
            "correct position_mm, look_at_mm and the field of view of {camera}: the origin of the sample's frame is on its datum"
        ),
        (Concern::TooSmall { .. }, ..) => format!(
            "correct the field of view of {camera} or the sample's size ({sample}); lengths are millimetres"
        ),
        (
            Concern::FacesAway { .. } | Concern::PartlyFacesAway { .. },
            SurfaceSpec::Mesh(mesh),
            _,
        ) => format!(
            "`rig shape --inspect {}` shows whether the mesh is inside out, which {} corrects, or upside down, which mesh_to_sample corrects ({sample}); else correct position_mm of {camera}",
            mesh.path.display(),
            match mesh.placement.flip_facets {
                true => "leaving out flip_facets",
                false => "flip_facets = true",
            }
        ),
        (Concern::FacesAway { .. } | Concern::PartlyFacesAway { .. }, ..) => format!(
            "the sample's front is seen from above: correct position_mm and look_at_mm of {camera}"
        ),
        (Concern::Unlit { .. }, ..) => keys.light.to_owned(),
    }
}
