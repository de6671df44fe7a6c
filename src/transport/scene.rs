//! What is traced: the sample, the camera and the lamps.

use glam::Vec3;

use super::camera::Camera;
use super::light::Light;
use crate::geometry::bvh::offset_origin;
use crate::geometry::{Bvh, Mesh, Ray};

/// Which normals the reflection uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Shading {
    /// The facets' own: exactly reciprocal.
    #[default]
    Flat,
    /// Interpolated between the corners' normals, where the mesh has them: no facets
    /// in narrow lobes, not exactly reciprocal.
    Smooth,
}

/// A sample of one uniform material, a camera and lamps.
pub struct Scene {
    mesh: Mesh,
    bvh: Bvh,
    shading: Shading,
    /// Face normals, one per triangle.
    normals: Vec<Vec3>,
    /// The camera.
    pub camera: Camera,
    /// The lamps; images are rendered one per lamp.
    pub lights: Vec<Light>,
}

/// A point of the sample's front side.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Start of rays that leave, just off the surface, millimetres.
    pub origin_mm: Vec3,
    /// Normal of the facet.
    face_normal: Vec3,
    /// Tangent, bitangent and shading normal.
    frame: [Vec3; 3],
}

impl Surface {
    /// Sample-frame direction in the local frame (+z is the normal).
    #[inline]
    pub fn local(&self, direction: Vec3) -> Vec3 {
        Vec3::new(
            self.frame[0].dot(direction),
            self.frame[1].dot(direction),
            self.frame[2].dot(direction),
        )
    }

    /// Local direction in the sample frame.
    #[inline]
    pub fn world(&self, local: Vec3) -> Vec3 {
        self.frame[0] * local.x + self.frame[1] * local.y + self.frame[2] * local.z
    }

    /// Whether a sample-frame direction leaves on the front side of the facet.
    #[inline]
    pub fn leaves(&self, direction: Vec3) -> bool {
        self.face_normal.dot(direction) > 0.0
    }
}

/// A visible connection between a surface point and a lamp.
#[derive(Clone, Copy, Debug)]
pub struct Connection {
    /// Local unit vector towards the lamp, z > 0.
    pub to_light: Vec3,
    /// Irradiance on the surface over the lamp's strength: includes the cosine.
    pub irradiance: f32,
}

impl Scene {
    /// Builds the ray queries over `mesh`.
    pub fn new(mesh: Mesh, shading: Shading, camera: Camera, lights: Vec<Light>) -> Self {
        let bvh = Bvh::new(&mesh);
        let normals = (0..mesh.triangles.len())
            .map(|i| mesh.face_normal(i))
            .collect();
        Self {
            mesh,
            bvh,
            shading,
            normals,
            camera,
            lights,
        }
    }

    /// The sample's surface.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Where a ray meets the front of the sample first; `None` if it leaves the
    /// scene or meets a back, which is black.
    #[inline]
    pub fn intersect(&self, ray: &Ray) -> Option<Surface> {
        let hit = self.bvh.closest(ray)?;
        let index = hit.triangle as usize;
        let face_normal = self.normals[index];
        if face_normal.dot(ray.direction) >= 0.0 {
            return None;
        }
        let corners = self.mesh.triangles[index];
        let [u, v] = hit.barycentric;
        let [a, b, c] = corners.map(|k| self.mesh.positions_mm[k as usize]);
        let position = a + (b - a) * u + (c - a) * v;
        let normal = match (self.shading, &self.mesh.normals) {
            (Shading::Smooth, Some(normals)) => {
                let [a, b, c] = corners.map(|k| normals[k as usize]);
                (a * (1.0 - u - v) + b * u + c * v).normalize()
            }
            _ => face_normal,
        };
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        Some(Surface {
            origin_mm: offset_origin(position, face_normal),
            face_normal,
            frame: [tangent, bitangent, normal],
        })
    }

    /// Connects a surface point with lamp `light`; `u` uniform in [0, 1)² for
    /// extended lamps. `None` if the lamp is below the horizon or hidden.
    #[inline]
    pub fn connect(&self, surface: &Surface, light: usize, u: [f32; 2]) -> Option<Connection> {
        let sample = self.lights[light].sample(surface.origin_mm, u);
        let to_light = surface.local(sample.direction);
        if to_light.z <= 0.0 || !surface.leaves(sample.direction) {
            return None;
        }
        let hidden = self.bvh.any(&Ray {
            origin_mm: surface.origin_mm,
            direction: sample.direction,
            limit_mm: sample.distance_mm,
        });
        (!hidden).then_some(Connection {
            to_light,
            irradiance: sample.relative_irradiance * to_light.z,
        })
    }

    /// The next surface along a local direction from `surface`.
    #[inline]
    pub fn next(&self, surface: &Surface, local: Vec3) -> Option<(Surface, Vec3)> {
        let direction = surface.world(local);
        if !surface.leaves(direction) {
            return None;
        }
        let ray = Ray {
            origin_mm: surface.origin_mm,
            direction,
            limit_mm: f32::INFINITY,
        };
        let next = self.intersect(&ray)?;
        let to_viewer = next.local(-direction);
        (to_viewer.z > 0.0).then_some((next, to_viewer))
    }

    /// The first surface seen from a sensor position, and the local direction to the viewer.
    #[inline]
    pub fn first(&self, ray: &Ray) -> Option<(Surface, Vec3)> {
        let surface = self.intersect(ray)?;
        let to_viewer = surface.local(-ray.direction);
        (to_viewer.z > 0.0).then_some((surface, to_viewer))
    }
}
