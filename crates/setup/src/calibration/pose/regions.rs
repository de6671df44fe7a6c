//! What each pixel sees: which piece of the sample, lit or in shadow, and how
//! steeply the light falls there. From geometry alone; no reflectance is assumed.

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::pieces::smooth_pieces;
use crate::geometry::bvh::offset_origin;
use crate::geometry::{Bvh, Mesh, Ray};
use crate::random::{Purpose, stream};
use crate::transport::{Scene, footprint};

/// Next to the sample.
pub const BACKGROUND: u32 = 0;
/// The back of the sample.
const BACK: u32 = 1;

/// Part of a pixel that one region covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// [`BACKGROUND`], the back, or a piece in shadow (even) or in light (odd).
    pub label: u32,
    /// Part of the pixel's area.
    pub coverage: f32,
    /// Its mean cosine between normal and light times the coverage; 0 in shadow.
    pub cosine: f32,
}

/// Whether a label is a piece in light.
pub fn is_lit(label: u32) -> bool {
    label > BACK && label % 2 == 1
}

/// The pixels on which poses are compared: the camera's, `factor` × `factor` of them as one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Grid {
    /// The camera's pixels along one side of a pixel of the grid.
    pub factor: usize,
    pub width: usize,
    pub height: usize,
}

impl Grid {
    /// Of whole blocks of the camera's pixels.
    pub fn new(resolution_px: [usize; 2], factor: usize) -> Self {
        let [width, height] = resolution_px.map(|n| n / factor);
        Self {
            factor,
            width,
            height,
        }
    }

    /// Its pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }
}

/// The sample with what ray queries need.
pub struct Sight<'a> {
    mesh: &'a Mesh,
    bvh: Bvh,
    pieces: Vec<u32>,
    /// Rays along one side of a pixel that shows more than one region.
    subsamples: u32,
}

/// What one ray sees under one light.
#[derive(Clone, Copy, PartialEq)]
pub struct Seen {
    /// As of a [`Part`].
    pub label: u32,
    /// Between normal and light; 0 in shadow.
    pub cosine: f32,
}

impl<'a> Sight<'a> {
    /// Prepares the mesh.
    pub fn new(mesh: &'a Mesh, subsamples: u32) -> Self {
        Self {
            mesh,
            bvh: Bvh::new(mesh),
            pieces: smooth_pieces(mesh),
            subsamples: subsamples.max(2),
        }
    }

    /// For each pixel of the grid, and within it each light of `scene`, the regions seen;
    /// nothing where a pixel is not `wanted`. The rays' positions in a pixel depend on the
    /// pixel and `seed` alone, so that scenes which differ a little differ smoothly.
    pub fn parts(
        &self,
        scene: &Scene,
        grid: Grid,
        wanted: &[bool],
        seed: u64,
    ) -> Vec<Vec<Vec<Part>>> {
        (0..grid.pixels())
            .into_par_iter()
            .map(|pixel| match wanted[pixel] {
                true => self.pixel(scene, grid, pixel, seed),
                false => Vec::new(),
            })
            .collect()
    }

    fn pixel(&self, scene: &Scene, grid: Grid, pixel: usize, seed: u64) -> Vec<Vec<Part>> {
        let corner = [pixel % grid.width, pixel / grid.width].map(|i| (i * grid.factor) as f64);
        let corner = DVec2::from_array(corner);
        let lights = scene.lights.len();
        let mut seen = vec![BLACK; lights];
        let mut parts: Vec<Vec<Part>> = vec![Vec::new(); lights];
        // Every straight edge through a pixel has a corner of it for itself.
        let look = |x: f64, y: f64, seen: &mut [Seen]| {
            let at = corner + DVec2::new(x, y) * grid.factor as f64;
            self.look(scene, at, seen);
        };
        let spread = scene.camera.point_spread_px / grid.factor as f64;
        let (near, far) = (-FOOTPRINT_REACH * spread, 1.0 + FOOTPRINT_REACH * spread);
        look(0.5, 0.5, &mut seen);
        let middle = seen.clone();
        let same = [[near, near], [far, near], [near, far], [far, far]]
            .iter()
            .all(|&[x, y]| {
                look(x, y, &mut seen);
                seen.iter().zip(&middle).all(|(a, b)| a.label == b.label)
            });
        if same {
            for (parts, seen) in parts.iter_mut().zip(&middle) {
                add(parts, seen, 1.0);
            }
            return parts;
        }
        let n = self.subsamples;
        let mut numbers = stream(seed, Purpose::PixelPosition, 0, pixel as u64, 0);
        let share = 1.0 / (n * n) as f32;
        for row in 0..n {
            for column in 0..n {
                let x = (f64::from(column) + numbers.uniform()) / f64::from(n);
                let y = (f64::from(row) + numbers.uniform()) / f64::from(n);
                look(
                    footprint::position(x, spread),
                    footprint::position(y, spread),
                    &mut seen,
                );
                for (parts, seen) in parts.iter_mut().zip(&seen) {
                    add(parts, seen, share);
                }
            }
        }
        parts
    }

    /// Room for what a ray sees under each light of a scene.
    pub fn blank(&self, scene: &Scene) -> Vec<Seen> {
        vec![BLACK; scene.lights.len()]
    }

    /// What the ray through a point of the image, the camera's pixels, sees under each light.
    pub fn look(&self, scene: &Scene, position_px: DVec2, seen: &mut [Seen]) {
        seen.fill(BLACK);
        let ray = scene.camera.ray(position_px, DVec2::ZERO);
        let Some(hit) = self.bvh.closest(&ray) else {
            return;
        };
        let triangle = hit.triangle as usize;
        let facet = self.mesh.face_normal(triangle);
        if facet.dot(ray.direction) >= 0.0 {
            seen.fill(Seen {
                label: BACK,
                cosine: 0.0,
            });
            return;
        }
        let [u, v] = hit.barycentric;
        let blend = |[a, b, c]: [Vec3; 3]| a * (1.0 - u - v) + b * u + c * v;
        let point = blend(self.mesh.corners(triangle));
        let normal = match &self.mesh.normals {
            Some(normals) => {
                blend(self.mesh.triangles[triangle].map(|v| normals[v as usize])).normalize()
            }
            None => facet,
        };
        let origin_mm = offset_origin(point, facet);
        let dark = 2 * (self.pieces[triangle] + 1);
        for (light, seen) in scene.lights.iter().zip(seen) {
            let towards = light.sample(origin_mm, [0.0; 2]);
            let cosine = normal.dot(towards.direction);
            let lit = cosine > 0.0
                && facet.dot(towards.direction) > 0.0
                && !self.bvh.any(&Ray {
                    origin_mm,
                    direction: towards.direction,
                    limit_mm: towards.distance_mm,
                });
            *seen = Seen {
                label: dark + u32::from(lit),
                cosine: if lit { cosine } else { 0.0 },
            };
        }
    }
}

/// Standard deviations of the point spread beyond a pixel that are searched for edges.
const FOOTPRINT_REACH: f64 = 3.0;

const BLACK: Seen = Seen {
    label: BACKGROUND,
    cosine: 0.0,
};

fn add(parts: &mut Vec<Part>, seen: &Seen, share: f32) {
    let known = parts.iter().position(|part| part.label == seen.label);
    let index = known.unwrap_or_else(|| {
        parts.push(Part {
            label: seen.label,
            coverage: 0.0,
            cosine: 0.0,
        });
        parts.len() - 1
    });
    parts[index].coverage += share;
    parts[index].cosine += share * seen.cosine;
}
