//! The five sample shapes of the paper, as the experiments see them: about 2 mm wide,
//! under a telecentric camera, each with its lights.

use glam::{DVec2, DVec3};

use crate::evaluate::error::EvaluateError;
use crate::geometry::Shape;
use crate::geometry::shapes::Form;
use crate::transport::{Camera, Light, Scene, Shading};

/// A sample shape of Fig. 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Sample {
    /// Three orthogonal facets, seen from outside.
    ConvexCorner,
    /// The same from inside.
    ConcaveCorner,
    /// The upper half of a sphere.
    Sphere,
    /// The inside of a hemisphere.
    Bowl,
    /// The shape of Section 6, extruded.
    Designed,
}

impl Sample {
    /// In the order of Fig. 2.
    pub const ALL: [Self; 5] = [
        Self::ConvexCorner,
        Self::ConcaveCorner,
        Self::Sphere,
        Self::Bowl,
        Self::Designed,
    ];

    /// As in tables and legends.
    pub fn name(self) -> &'static str {
        match self {
            Self::ConvexCorner => "convex corner",
            Self::ConcaveCorner => "concave corner",
            Self::Sphere => "sphere",
            Self::Bowl => "bowl",
            Self::Designed => "designed",
        }
    }

    /// The shape of a table's name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sample| sample.name() == name)
    }

    /// Whether light can reach the camera only after one reflection.
    pub fn is_convex(self) -> bool {
        matches!(self, Self::ConvexCorner | Self::Sphere)
    }

    fn is_corner(self) -> bool {
        matches!(self, Self::ConvexCorner | Self::ConcaveCorner)
    }

    /// The surface with `segments` facets around a full circle (a multiple of 4).
    pub fn shape(self, segments: u32) -> Shape {
        let corner = |depth_mm| Shape::Tetrahedron {
            radius_mm: 1.0,
            depth_mm,
        };
        match self {
            Self::ConvexCorner => corner(-std::f32::consts::FRAC_1_SQRT_2),
            Self::ConcaveCorner => corner(std::f32::consts::FRAC_1_SQRT_2),
            Self::Sphere => Shape::Cap {
                radius_mm: 1.0,
                opening_deg: 90.0,
                segments,
            },
            Self::Bowl => Shape::Bowl {
                radius_mm: 1.0,
                segments,
            },
            // 3.12 radii from the axis to the rim at C = 0.5 and 45°.
            Self::Designed => Shape::Designed {
                radius_mm: 1.0 / 3.12,
                offset: 0.5,
                phi_min_deg: 45.0,
                form: Form::Extruded,
                length_mm: 2.0,
                segments,
            },
        }
    }

    /// The first `count` lights of the sample's sequence: the first coaxial (25° off
    /// axis at azimuth 20° for the corners, whose facets look alike under a coaxial
    /// one), the others spread evenly within 60°, each set part of the next.
    pub fn lights(self, count: usize) -> Vec<Light> {
        let first = if self.is_corner() {
            (25.0, 20.0)
        } else {
            (0.0, 0.0)
        };
        (0..count)
            .map(|k| {
                let (polar_deg, azimuth_deg) = if k == 0 {
                    first
                } else {
                    // Cosines by van der Corput, azimuths by the golden angle.
                    let cos = 1.0 - 0.5 * radical_inverse(k as u32);
                    (cos.acos().to_degrees(), 137.507_764 * k as f64)
                };
                directional(polar_deg, azimuth_deg)
            })
            .collect()
    }

    /// Scene with the believed shape: what a fit is given.
    pub fn scene(self, resolution_px: usize, lights: Vec<Light>) -> Result<Scene, EvaluateError> {
        self.meshed(BELIEVED_SEGMENTS, resolution_px, lights)
    }

    /// Scene of the truth: a finer mesh of the same shape.
    pub fn true_scene(
        self,
        resolution_px: usize,
        lights: Vec<Light>,
    ) -> Result<Scene, EvaluateError> {
        self.meshed(TRUE_SEGMENTS, resolution_px, lights)
    }

    /// Scene with `segments` facets around.
    pub fn meshed(
        self,
        segments: u32,
        resolution_px: usize,
        lights: Vec<Light>,
    ) -> Result<Scene, EvaluateError> {
        let mesh = self.shape(segments).mesh()?;
        Ok(Scene::new(
            mesh,
            Shading::Smooth,
            camera(resolution_px),
            lights,
        ))
    }
}

/// Facets around a full circle as a fit believes, and in truth.
pub const BELIEVED_SEGMENTS: u32 = 192;
/// See [`BELIEVED_SEGMENTS`].
pub const TRUE_SEGMENTS: u32 = 320;

/// Half the field of view, mm.
pub const HALF_VIEW_MM: f64 = 1.1;

/// Telecentric, 2.2 × 2.2 mm, looking down −z from z = 5 mm.
pub fn camera(resolution_px: usize) -> Camera {
    Camera::above([resolution_px; 2], DVec2::splat(2.0 * HALF_VIEW_MM), 5.0)
}

/// A far lamp of unit irradiance at an angle from +z, azimuth from +x.
pub fn directional(polar_deg: f64, azimuth_deg: f64) -> Light {
    let (sin, cos) = polar_deg.to_radians().sin_cos();
    let (y, x) = azimuth_deg.to_radians().sin_cos();
    Light::distant(DVec3::new(sin * x, sin * y, cos), [1.0; 3])
}

/// Van der Corput's sequence in base 2.
fn radical_inverse(k: u32) -> f64 {
    f64::from(k.reverse_bits()) / 2f64.powi(32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_sets_are_nested_unit_and_within_60_degrees() {
        for sample in Sample::ALL {
            assert_eq!(Sample::named(sample.name()), Some(sample));
            let all = sample.lights(16);
            assert_eq!(all[..4], sample.lights(4));
            for light in all {
                let Light::Directional { to_light, .. } = light else {
                    panic!("{light:?}");
                };
                assert!((to_light.length() - 1.0).abs() < 1e-12);
                assert!(to_light.z >= 0.5);
            }
        }
    }
}
