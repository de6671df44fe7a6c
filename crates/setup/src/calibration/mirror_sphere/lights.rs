//! All lights of a bench from images of mirror spheres.

use super::light::FoundLight;
use super::outline::Stated;
use super::{Circle, Grey, Sphere, SphereError, locate_all, spheres_in};
use crate::calibration::directions::DirectionsValues;
use crate::calibration::stage_directions::{self, StageFit, StageFitError};
use crate::config::geometry::GeometryConfig;
use crate::device::kinematics::{Kinematics, Mechanism};
use crate::units::StageAngles;

/// A measurement of the lights of a bench with mirror spheres.
pub struct DirectionsRequest<'a> {
    /// The bench as described, with its measured lens.
    pub geometry: &'a GeometryConfig,
    /// How the lights are moved.
    pub kinematics: &'a Kinematics,
    /// The stage's angles for each light.
    pub angles: &'a [StageAngles],
    /// An image of the spheres per light.
    pub images: &'a [Grey],
    /// An image in which the outlines are found; `None`: all lights' images, each on the
    /// side that its light shines on.
    pub outline: Option<&'a Grey>,
    /// Radius and height of the spheres.
    pub stated: Stated,
    /// Where spheres roughly are in the image; empty: searched for.
    pub near: &'a [Circle],
    /// How many equal spheres there are, 1 or 2.
    pub spheres: usize,
}

/// The lights of a bench as measured.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct MeasuredDirections {
    pub spheres: Vec<Sphere>,
    pub lights: Vec<FoundLight>,
    /// The stage, unless its lights are fixed.
    pub stage: Option<StageFit>,
    pub values: DirectionsValues,
}

/// Why images of spheres do not determine the lights.
#[derive(Debug, thiserror::Error)]
pub enum DirectionsError {
    /// The spheres or their highlights.
    #[error(transparent)]
    Sphere(#[from] SphereError),
    /// The lights together.
    #[error(transparent)]
    Stage(#[from] StageFitError),
}

/// Measures the lights of a bench.
pub fn measure(request: &DirectionsRequest) -> Result<MeasuredDirections, DirectionsError> {
    let &DirectionsRequest {
        geometry,
        kinematics,
        angles,
        images,
        ..
    } = request;
    let camera = &geometry.image_camera();
    let spheres = spheres_in(
        images,
        request.outline,
        camera,
        &request.stated,
        request.near,
        request.spheres,
    )?;
    let centre_mm = geometry.sample_from_stage.translation_mm;
    let stated_mm: Vec<_> = angles
        .iter()
        .map(|&at| lamp_distance_mm(geometry, at))
        .collect();
    let (lights, distance) = locate_all(camera, &spheres, images, centre_mm, &stated_mm)?;
    let stage = match kinematics {
        Kinematics::FixedLights(_) => None,
        Kinematics::TwoAxes(axes) => Some(stage_directions::fit(
            geometry.sample_from_stage.rotation,
            angles,
            &lights,
            axes.mechanism == Mechanism::Rotary,
        )?),
    };
    let values = DirectionsValues::new(angles, &lights, stage.as_ref(), distance);
    Ok(MeasuredDirections {
        spheres,
        lights,
        stage,
        values,
    })
}

/// The lamp's distance that the rig file states for these angles; `None`: parallel light.
fn lamp_distance_mm(geometry: &GeometryConfig, angles: StageAngles) -> Option<f64> {
    let light = &geometry.light;
    let mechanism = light.mechanism.as_ref();
    let by_stage = mechanism.and_then(|m| m.lamp_distance_mm(angles));
    by_stage.or(light.distance_mm)
}
