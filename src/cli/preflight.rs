//! What makes a scene not worth measuring: [`SceneConcern`] states the facts, here is the advice.

use super::context::Context;
use crate::config::scene::SceneFile;
use crate::config::view::SurfaceSpec;
use crate::geometry::inspect::UNITS;
use crate::transport::Scene;
use crate::transport::visibility::{Concern, Visibility};
use crate::workflow::{DescribedIn, Notice, Observer, SceneConcern, millimetres};

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

/// What to do about a lens that blurs a part of the sample.
pub(super) const FOR_BLUR: &str = "stop the lens down, or focus on the middle of the sample's depth \
    and measure that with `rig calibrate focus`: fits include the blur, but it hides detail";

/// How the keys of a file are called, and what it says of the sample's surface.
#[derive(Clone, Copy)]
struct Keys<'a> {
    camera: &'static str,
    sample: &'static str,
    light: &'static str,
    surface: &'a SurfaceSpec,
}

impl<'a> Keys<'a> {
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

fn remedy(concern: &Concern, seen: &Visibility, keys: Keys<'_>) -> String {
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
