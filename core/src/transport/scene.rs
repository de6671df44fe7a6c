//! What is traced: the sample, known bodies around it, the camera and the lamps.

use std::sync::Arc;

use glam::Vec3;

use super::camera::Camera;
use super::falloff::Falloff;
use super::light::Light;
use crate::brdf::Brdf;
use crate::geometry::bvh::offset_origin;
use crate::geometry::{Bvh, FileRemark, Mesh, Ray};

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

/// A thing in view whose reflectance is known: a holder, an occluder, a reference.
#[derive(Clone)]
pub struct Body {
    /// Its surface, in the sample's frame; seen from behind it is black.
    pub mesh: Mesh,
    /// Which normals shade.
    pub shading: Shading,
    /// What it is made of.
    pub brdf: Arc<dyn Brdf>,
}

/// A sample of one uniform material, known bodies, a camera and lamps. Clones share
/// the surfaces, so that one sample can be seen from many positions.
///
/// ```
/// use glam::{DVec2, DVec3};
/// use rig_core::geometry::Shape;
/// use rig_core::transport::{Camera, Light, Scene, Shading, Visibility};
///
/// let camera = Camera::above([64, 64], DVec2::splat(24.0), 100.0);
/// let light = Light::distant(DVec3::new(0.5, 0.0, 1.0), [3.0; 3]);
/// let bowl = Shape::Bowl { radius_mm: 10.0, segments: 64 }.mesh()?;
/// let scene = Scene::new(bowl, Shading::Smooth, camera, vec![light]);
/// // The camera sees the whole sample from the front, and the light reaches it.
/// assert!(Visibility::of(&scene).concerns().is_empty());
/// # Ok::<(), rig_core::geometry::MeshError>(())
/// ```
#[derive(Clone)]
pub struct Scene {
    sample: Arc<Mesh>,
    bvh: Arc<Bvh>,
    /// Per triangle: the sample's first, then the bodies'.
    facets: Arc<[Facet]>,
    /// Corners' normals of the triangles that are shaded smoothly.
    corner_normals: Arc<[[Vec3; 3]]>,
    bodies: Vec<Arc<dyn Brdf>>,
    /// About the files of its surfaces.
    remarks: Arc<[FileRemark]>,
    /// The camera.
    pub camera: Camera,
    /// The lamps; images are rendered one per lamp.
    pub lights: Vec<Light>,
    /// How their irradiance differs over the sample beyond what their positions imply; lamps
    /// beyond its length are even.
    pub falloffs: Vec<Falloff>,
}

/// Channels of a grey body differ by no more than rounding.
const GREY_TOLERANCE: f32 = 1e-5;

/// What a hit needs to know of a triangle.
#[derive(Clone)]
struct Facet {
    corners: [Vec3; 3],
    normal: Vec3,
    body: u32,
    /// Index into the corners' normals.
    smooth: Option<u32>,
}

/// A point on the front side of the sample or of a known body.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Start of rays that leave, just off the surface, millimetres.
    pub origin_mm: Vec3,
    /// Normal of the facet.
    face_normal: Vec3,
    /// Tangent, bitangent and shading normal.
    frame: [Vec3; 3],
    /// 0 for the sample, k for the k-th known body.
    body: u32,
}

impl Surface {
    /// Whether this is the sample, not a known body.
    #[inline]
    pub fn is_sample(&self) -> bool {
        self.body == 0
    }

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
    /// The sample alone under the camera.
    pub fn new(mesh: Mesh, shading: Shading, camera: Camera, lights: Vec<Light>) -> Self {
        Self::with_bodies(mesh, shading, Vec::new(), camera, lights)
    }

    /// The sample with known bodies around it: they shadow it and light it, and where
    /// one is seen first, that is no pixel of the sample.
    pub fn with_bodies(
        sample: Mesh,
        shading: Shading,
        bodies: Vec<Body>,
        camera: Camera,
        lights: Vec<Light>,
    ) -> Self {
        let parts = || {
            let bodies = bodies.iter().map(|b| (&b.mesh, b.shading));
            std::iter::once((&sample, shading)).chain(bodies)
        };
        let mut facets = Vec::with_capacity(parts().map(|(mesh, _)| mesh.triangles.len()).sum());
        let mut corner_normals = Vec::new();
        for (body, (mesh, shading)) in (0..).zip(parts()) {
            let normals = mesh.normals.as_ref().filter(|_| shading == Shading::Smooth);
            for (triangle, corners) in mesh.triangles.iter().enumerate() {
                facets.push(Facet {
                    corners: mesh.corners(triangle),
                    normal: mesh.face_normal(triangle),
                    body,
                    smooth: normals.map(|normals| {
                        corner_normals.push(corners.map(|v| normals[v as usize]));
                        (corner_normals.len() - 1) as u32
                    }),
                });
            }
        }
        let bvh = if bodies.is_empty() {
            Bvh::new(&sample)
        } else {
            Bvh::new(&Mesh::joined(parts().map(|(mesh, _)| mesh)))
        };
        let remarks = parts()
            .flat_map(|(mesh, _)| &mesh.remarks)
            .cloned()
            .collect();
        Self {
            remarks,
            bvh: Arc::new(bvh),
            facets: facets.into(),
            corner_normals: corner_normals.into(),
            bodies: bodies.into_iter().map(|body| body.brdf).collect(),
            sample: Arc::new(sample),
            camera,
            lights,
            falloffs: Vec::new(),
        }
    }

    /// The scene with its sample in another shape: the same triangles, their corners and
    /// normals a little elsewhere.
    pub fn deformed(&self, sample: Mesh) -> Self {
        let mut corner_normals = self.corner_normals.to_vec();
        let facets = self.facets.iter().enumerate().map(|(triangle, facet)| {
            let mut facet = facet.clone();
            if facet.body == 0 {
                facet.corners = sample.corners(triangle);
                facet.normal = sample.face_normal(triangle);
                if let (Some(index), Some(normals)) = (facet.smooth, &sample.normals) {
                    let corners = sample.triangles[triangle];
                    corner_normals[index as usize] = corners.map(|v| normals[v as usize]);
                }
            }
            facet
        });
        Self {
            facets: facets.collect(),
            bvh: Arc::new(self.bvh.refitted(&sample)),
            corner_normals: corner_normals.into(),
            sample: Arc::new(sample),
            ..self.clone()
        }
    }

    /// The sample's surface.
    pub fn sample(&self) -> &Mesh {
        &self.sample
    }

    /// Remarks about the files of its surfaces.
    pub fn remarks(&self) -> &[FileRemark] {
        &self.remarks
    }

    /// Whether the sample's facets shade with their own normals.
    pub fn is_flat(&self) -> bool {
        self.facets.first().is_none_or(|f| f.smooth.is_none())
    }

    /// The reflectance of the known body that `surface` is part of; `None` for the sample.
    #[inline]
    pub fn known(&self, surface: &Surface) -> Option<&dyn Brdf> {
        if surface.is_sample() {
            return None;
        }
        self.bodies.get(surface.body as usize - 1).map(|b| &**b)
    }

    /// What the known bodies are made of.
    pub fn bodies(&self) -> &[Arc<dyn Brdf>] {
        &self.bodies
    }

    /// The first known body whose channels differ by more than rounding, of directions 30° apart:
    /// a fit needs grey ones, as a path's record has one weight for all channels.
    pub fn coloured_body(&self) -> Option<usize> {
        let direction = |theta_deg: u16, phi_deg: u16| {
            let (sin, cos) = f32::from(theta_deg).to_radians().sin_cos();
            let (y, x) = f32::from(phi_deg).to_radians().sin_cos();
            Vec3::new(sin * x, sin * y, cos)
        };
        let is_coloured = |brdf: &Arc<dyn Brdf>| {
            let thetas_deg = || (0..90).step_by(30);
            let pairs = thetas_deg().flat_map(|i| thetas_deg().map(move |o| (i, o)));
            let mut all = pairs.flat_map(|(i, o)| (0..=180).step_by(30).map(move |d| (i, o, d)));
            all.any(|(i, o, d)| {
                let [r, g, b] = brdf.eval(direction(i, 0), direction(o, d));
                r.max(g).max(b) - r.min(g).min(b) > GREY_TOLERANCE * g
            })
        };
        self.bodies.iter().position(is_coloured)
    }

    /// Where a ray meets a front first; `None` if it leaves the scene or meets a back,
    /// which is black.
    #[inline]
    pub fn intersect(&self, ray: &Ray) -> Option<Surface> {
        let hit = self.bvh.closest(ray)?;
        if self.facets[hit.triangle as usize].normal.dot(ray.direction) >= 0.0 {
            return None;
        }
        Some(self.surface(hit.triangle, hit.barycentric))
    }

    /// Where a ray meets anything first, and whether it meets the front there.
    pub(super) fn meet(&self, ray: &Ray) -> Option<(Surface, bool)> {
        let hit = self.bvh.closest(ray)?;
        let is_front = self.facets[hit.triangle as usize].normal.dot(ray.direction) < 0.0;
        Some((self.surface(hit.triangle, hit.barycentric), is_front))
    }

    /// Whether anything lies between a point of the sample, on whichever side, and a position in
    /// this direction and distance.
    pub(super) fn is_blocked(&self, position: &Surface, direction: Vec3, distance_mm: f32) -> bool {
        let normal = position.face_normal;
        let origin_mm = match normal.dot(direction) >= 0.0 {
            true => position.origin_mm,
            // Twice: from just off the front to just off the back.
            false => offset_origin(offset_origin(position.origin_mm, -normal), -normal),
        };
        self.bvh.any(&Ray {
            origin_mm,
            direction,
            limit_mm: distance_mm,
        })
    }

    /// The point of a triangle at given barycentric coordinates.
    #[inline]
    pub fn surface(&self, triangle: u32, [u, v]: [f32; 2]) -> Surface {
        let facet = &self.facets[triangle as usize];
        let [a, b, c] = facet.corners;
        let position = a + (b - a) * u + (c - a) * v;
        let normal = match facet.smooth {
            Some(index) => {
                let [a, b, c] = self.corner_normals[index as usize];
                (a * (1.0 - u - v) + b * u + c * v).normalize()
            }
            None => facet.normal,
        };
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        Surface {
            origin_mm: offset_origin(position, facet.normal),
            face_normal: facet.normal,
            frame: [tangent, bitangent, normal],
            body: facet.body,
        }
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
        if hidden {
            return None;
        }
        let falloff = self.falloffs.get(light);
        let factor = falloff.map_or(1.0, |falloff| falloff.at(surface.origin_mm));
        Some(Connection {
            to_light,
            irradiance: sample.relative_irradiance * to_light.z * factor,
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

#[cfg(test)]
impl Scene {
    /// A smooth hemisphere of radius 1 mm under a coaxial camera and lamp.
    pub(crate) fn bowl(segments: u32, resolution_px: [usize; 2], width_mm: f64) -> Self {
        use glam::{DVec2, DVec3};
        let bowl = crate::geometry::Shape::Bowl {
            radius_mm: 1.0,
            segments,
        };
        let camera = Camera::above(resolution_px, DVec2::splat(width_mm), 5.0);
        let sun = Light::distant(DVec3::Z, [1.0; 3]);
        Self::new(bowl.mesh().unwrap(), Shading::Smooth, camera, vec![sun])
    }
}
