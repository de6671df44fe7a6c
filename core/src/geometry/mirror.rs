//! Mirror rays: what a shape promises of coaxial light, tried by tracing it.

use glam::Vec3;
use serde::Serialize;

use super::bvh::{Bvh, Ray, offset_origin};
use super::mesh::Mesh;
use super::shapes::{Profile, Shape};

/// How vertical rays leave a mirror of the shape that promises to send them back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MirrorCheck {
    /// Vertical rays traced.
    pub rays: u32,
    /// Those that left after exactly two reflections.
    pub returned_after_two: u32,
    /// Largest angle between +z and the direction of one that did, degrees.
    pub worst_deviation_deg: f32,
}

/// Rays of a check.
const RAYS: u32 = 1000;

impl Shape {
    /// Traces vertical rays over the part of the profile whose light returns vertically
    /// after two reflections, on `mesh` of this shape with its corners' normals: of the
    /// designed shape the arc from 2° past `phi_min_deg` to 88°, of a right-angled V
    /// groove its width less a hundredth at the rims and the bottom. `None` for shapes
    /// without such a part.
    pub fn mirror_check(&self, mesh: &Mesh) -> Option<MirrorCheck> {
        let fraction = |i: u32| (i as f32 + 0.5) / RAYS as f32;
        let x_mm: Vec<f32> = match *self {
            Shape::Designed {
                radius_mm,
                phi_min_deg,
                ..
            } => (0..RAYS)
                .map(|i| phi_min_deg + 2.0 + (86.0 - phi_min_deg) * fraction(i))
                .map(|phi_deg| radius_mm * phi_deg.to_radians().sin())
                .collect(),
            Shape::Groove {
                radius_mm,
                width_mm,
                profile: Profile::Vee { depth_mm },
                ..
            } if (2.0 * depth_mm - width_mm).abs() < 1e-3 * width_mm => (0..RAYS)
                .map(|i| 2.0 * fraction(i) - 1.0)
                .map(|t| t.signum() * (0.01 + 0.98 * t.abs()))
                .map(|t| radius_mm + 0.5 * width_mm * t)
                .collect(),
            _ => return None,
        };
        Some(trace(mesh, &x_mm))
    }
}

/// Sends a ray down at each `x_mm`, at a small offset from the plane y = 0, where facets meet.
fn trace(mesh: &Mesh, x_mm: &[f32]) -> MirrorCheck {
    let bvh = Bvh::new(mesh);
    let [low, high] = mesh.bounds_mm();
    let y_mm = 1e-3 * (high.y - low.y);
    let mut check = MirrorCheck {
        rays: x_mm.len() as u32,
        returned_after_two: 0,
        worst_deviation_deg: 0.0,
    };
    for &x in x_mm {
        let mut ray = Ray {
            origin_mm: Vec3::new(x, y_mm, high.z + 1.0),
            direction: Vec3::NEG_Z,
            limit_mm: f32::INFINITY,
        };
        let mut reflections = 0;
        while let Some(hit) = bvh.closest(&ray).filter(|_| reflections < 3) {
            let triangle = hit.triangle as usize;
            let face = mesh.face_normal(triangle);
            let [u, v] = hit.barycentric;
            let mix = |[a, b, c]: [Vec3; 3]| a * (1.0 - u - v) + b * u + c * v;
            let normal = match &mesh.normals {
                Some(normals) => {
                    mix(mesh.triangles[triangle].map(|k| normals[k as usize])).normalize()
                }
                None => face,
            };
            ray.direction = ray.direction.reflect(normal).normalize();
            ray.origin_mm = offset_origin(mix(mesh.corners(triangle)), face);
            reflections += 1;
        }
        if reflections == 2 {
            check.returned_after_two += 1;
            // An arc cosine could not resolve a hundredth of a degree.
            let across = ray.direction.truncate().length();
            let deviation_deg = across.atan2(ray.direction.z).to_degrees();
            check.worst_deviation_deg = check.worst_deviation_deg.max(deviation_deg);
        }
    }
    check
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::Form;

    fn check(shape: &Shape) -> Option<MirrorCheck> {
        shape.mirror_check(&shape.mesh().unwrap())
    }

    #[test]
    fn mirror_rays_return_after_two_reflections() {
        for form in [Form::Extruded, Form::Revolved] {
            let segments = if form == Form::Extruded { 1024 } else { 64 };
            let shape = Shape::Designed {
                radius_mm: 1.0,
                offset: 0.5,
                phi_min_deg: 40.0,
                form,
                length_mm: 2.0,
                segments,
            };
            let found = check(&shape).unwrap();
            assert_eq!(found.returned_after_two, found.rays);
            let limit_deg = 50.0 / segments as f32;
            assert!(found.worst_deviation_deg < limit_deg, "{form:?}: {found:?}");
        }
    }

    #[test]
    fn only_a_right_angled_groove_sends_light_back() {
        let groove = |depth_mm| Shape::Groove {
            radius_mm: 5.0,
            width_mm: 2.0,
            profile: Profile::Vee { depth_mm },
            segments: 1024,
        };
        let found = check(&groove(1.0)).unwrap();
        assert_eq!(found.returned_after_two, found.rays);
        assert!(found.worst_deviation_deg < 0.1, "{found:?}");
        assert_eq!(check(&groove(0.9)), None);
        // The same rays on a shallower groove leave elsewhere: the check can fail.
        let x_mm: Vec<f32> = (0..100).map(|i| 4.1 + 0.018 * i as f32).collect();
        let shallow = trace(&groove(0.9).mesh().unwrap(), &x_mm);
        assert!(shallow.worst_deviation_deg > 5.0, "{shallow:?}");
    }
}
