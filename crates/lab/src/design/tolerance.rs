//! How exactly a design must be made and placed.

use glam::DVec3;

use crate::frames::{self, Rigid};
use crate::geometry::FormError;
use crate::inverse::expected_error::Deviation;
use crate::random::{Purpose, stream};
use crate::transport::{Light, Scene, Shading};

/// Standard deviations of what is made and placed from what a fit is told.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Tolerance {
    /// Of the surface along its normal, and of the sample's place along each axis, mm, 0..=10.
    pub length_mm: f64,
    /// Of the surface's slope, the sample's turn about each axis and the lamps' directions,
    /// degrees, 0..=10.
    pub angle_deg: f64,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self {
            length_mm: 0.05,
            angle_deg: 0.3,
        }
    }
}

impl std::fmt::Display for Tolerance {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{},{}", self.length_mm, self.angle_deg)
    }
}

/// Random surfaces.
const SURFACES: u64 = 4;
/// Standard deviations by which a parameter is off: the images' departure is in proportion, and
/// exceeds the noise of their paths.
const STEP: f64 = 3.0;

impl Tolerance {
    /// From `MM,DEG`, as it is displayed.
    ///
    /// # Errors
    /// What is expected instead.
    pub fn parse(text: &str) -> Result<Self, String> {
        let parts = text
            .split_once(',')
            .map(|(a, b)| [a, b].map(|part| part.trim().parse()));
        match parts {
            Some([Ok(length_mm), Ok(angle_deg)])
                if [length_mm, angle_deg]
                    .iter()
                    .all(|v| (0.0..=10.0).contains(v)) =>
            {
                Ok(Self {
                    length_mm,
                    angle_deg,
                })
            }
            _ => Err(
                "not a length in mm and an angle in degrees, each 0 to 10, e.g. 0.05,0.3".into(),
            ),
        }
    }

    /// A design's scene with one parameter after the other off by some standard deviations.
    pub fn deviations(&self, scene: &Scene, seed: u64) -> Vec<Deviation> {
        let angle_rad = STEP * self.angle_deg.to_radians();
        let length_mm = STEP * self.length_mm;
        let with_sample =
            |mesh| Scene::new(mesh, Shading::Smooth, scene.camera, scene.lights.clone());
        let one = |scene| Deviation {
            scene,
            weight: 1.0 / (STEP * STEP),
            by_light: false,
        };
        let mut all = Vec::new();

        // The surface: random fields.
        let mesh = scene.sample();
        if let Some(error) = FormError::new(length_mm, angle_rad) {
            all.extend((0..SURFACES).map(|k| {
                let mut numbers = stream(seed, Purpose::Experiment, k, 0, 0);
                let field = error.field(mesh.mean_edge_mm(), &mut numbers);
                Deviation {
                    weight: 1.0 / (SURFACES as f64 * STEP * STEP),
                    ..one(with_sample(field.deform(mesh, 1.0)))
                }
            }));
        }

        // Its place, then the lamps' directions.
        for axis in DVec3::AXES {
            for [turn, shift] in [
                [angle_rad * axis, DVec3::ZERO],
                [DVec3::ZERO, length_mm * axis],
            ] {
                let pose =
                    Rigid::<frames::Sample, frames::Sample>::from_rotation_vector(turn, shift);
                all.push(one(with_sample(mesh.transformed(&pose))));
            }
        }
        for across in [0, 1] {
            let mut turned = scene.clone();
            for light in &mut turned.lights {
                *light = turned_light(*light, across, angle_rad);
            }
            all.push(Deviation {
                by_light: true,
                ..one(turned)
            });
        }
        all
    }
}

/// Turned about one of two axes across its direction from the sample.
fn turned_light(mut light: Light, across: usize, angle_rad: f64) -> Light {
    let turned = |v: DVec3| {
        let (a, b) = v.normalize_or(DVec3::Z).any_orthonormal_pair();
        let axis = [a, b][across];
        glam::DQuat::from_axis_angle(axis, angle_rad) * v
    };
    match &mut light {
        Light::Directional { to_light, .. } => *to_light = turned(*to_light),
        Light::Point { position_mm, .. } => *position_mm = turned(*position_mm),
    }
    light
}
