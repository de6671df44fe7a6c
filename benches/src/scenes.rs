//! The measured scenes: a shape under a telecentric camera and far lamps.

use glam::{DVec2, DVec3};
use rig::geometry::shapes::Form;
use rig::geometry::{Mesh, MeshError, Shape};
use rig::transport::{Camera, Lens, Light, Projection, Scene, Shading};

/// A hemisphere of radius 1 mm and 19 800 triangles.
pub fn bowl() -> Result<Mesh, MeshError> {
    Shape::Bowl {
        radius_mm: 1.0,
        segments: 200,
    }
    .mesh()
}

/// Three facets, each perpendicular to the others, seen along their axis.
pub fn corner() -> Result<Mesh, MeshError> {
    Shape::Tetrahedron {
        radius_mm: 1.0,
        depth_mm: std::f32::consts::FRAC_1_SQRT_2,
    }
    .mesh()
}

/// The paper's Section 6 shape, extruded.
pub fn designed() -> Result<Mesh, MeshError> {
    Shape::Designed {
        radius_mm: 1.0,
        offset: 0.5,
        phi_min_deg: 45.0,
        form: Form::Extruded,
        length_mm: 3.0,
        segments: 200,
    }
    .mesh()
}

/// `mesh` under a telecentric camera along −z that sees all of it, with one lamp for
/// each of the angles from the camera's axis, in the plane of x.
pub fn scene(mesh: Mesh, resolution_px: usize, lamps_deg: &[f64]) -> Scene {
    let [low, high] = mesh.bounds_mm().map(|p| p.as_dvec3());
    let middle = 0.5 * (low + high);
    let size = high - low;
    let extent_mm = 1.1 * size.x.max(size.y);
    let camera = Camera {
        resolution_px: [resolution_px; 2],
        projection: Projection::Orthographic {
            extent_mm: DVec2::splat(extent_mm),
        },
        lens: Lens::IDEAL,
        sample_from_camera: rig::frames::Rigid::new(
            glam::DQuat::from_rotation_x(std::f64::consts::PI),
            DVec3::new(middle.x, middle.y, high.z + 5.0),
        ),
        focus_mm: 5.0,
        object_na: 0.0,
        point_spread_px: 0.0,
    };
    let lamps = lamps_deg
        .iter()
        .map(|degrees| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Light::Directional {
                to_light: DVec3::new(sin, 0.0, cos),
                irradiance: [1.0; 3],
                angular_radius_rad: 0.0,
            }
        })
        .collect();
    Scene::new(mesh, Shading::Flat, camera, lamps)
}
