//! What makes a scene not worth measuring, reported before anything moves or is rendered:
//! [`Visibility`] finds the facts, here are their wording and the advice.

use super::context::Context;
use super::error::CliError;
use crate::capture::directions::{Aim, plan_order};
use crate::capture::reach::StageReach;
use crate::config::RigConfig;
use crate::config::scene::SceneFile;
use crate::config::view::SurfaceSpec;
use crate::geometry::inspect::UNITS;
use crate::transport::visibility::{Concern, Visibility};
use crate::transport::{CameraBody, Scene};
use crate::workflow::{DescribedIn, Notice, Observer, SceneConcern, extent_in_image, millimetres};

/// Lights within a stage's reach that stand for all of them while none is planned.
const LIGHTS_LOOKED_AT: usize = 16;

/// How many times the field's width a sample is long that was made for it. Another unit
/// that brings a mesh into this range is likely its own.
const SUITS_THE_FIELD: std::ops::RangeInclusive<f64> = 0.05..=3.0;

/// Warns of what is wrong with a scene file's scene, which is rendered all the same.
pub(super) fn remark_on_scene(scene: &Scene, file: &SceneFile, context: &Context) {
    for remark in scene.remarks() {
        context.warn(remark);
    }
    let seen = Visibility::of(scene);
    for concern in SceneConcern::all(&seen, DescribedIn::Scene, &file.sample.surface) {
        context.notice(Notice::Scene(&concern));
    }
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
    let aim = Aim::of(&config.geometry);
    let lights = plan_order(&reach, aim, LIGHTS_LOOKED_AT, 0.0);
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
            fact: format!("the sample is in view: {}", extent_in_image(&seen)),
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
        _ => format!("{concern}; {}", extent_in_image(seen)),
    }
}

/// How the keys of a file are called, and what it says of the sample's surface.
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
        Self::of(DescribedIn::Rig, &config.geometry.sample.surface)
    }

    fn of(file: DescribedIn, surface: &'a SurfaceSpec) -> Self {
        match file {
            DescribedIn::Rig => Self {
                camera: "[geometry.camera] in the rig file",
                sample: "[geometry.sample] in the rig file",
                light: "leave this light out (`--light AZ,EL` names lights one by one), or correct [geometry.sample_from_stage] in the rig file if the stage stands otherwise",
                surface,
            },
            DescribedIn::Scene => Self {
                camera: "[camera] in the scene file",
                sample: "[sample] in the scene file",
                light: "correct the light's direction in the scene file: it points from the sample to the lamp",
                surface,
            },
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

/// What to do about a concern of a scene.
pub(super) fn remedy_of(concern: &SceneConcern) -> String {
    let keys = Keys::of(concern.file, &concern.surface);
    remedy(&concern.concern, &concern.seen, keys)
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
            millimetres((high - low).max_element()),
            millimetres(seen.field_mm.max_element())
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
