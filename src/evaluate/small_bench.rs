//! A small simulated bench for studies of many captures: a bowl or the designed shape
//! under a few lamps, with what can go wrong on a real bench.
//!
//! The truth is rendered on a finer mesh than the fit's, with other paths.

use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};

use crate::brdf::Brdf;
use crate::frames::{Rigid, Sample};
use crate::geometry::shapes::Form;
use crate::geometry::{Mesh, MeshError, Shape};
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::transport::{
    Body, Camera, Light, Projection, Proposal, RenderOptions, Scene, Shading, render,
};

/// Which sample stands on the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sample1 {
    /// A half sphere seen from inside.
    Bowl,
    /// The paper's Section 6 shape, extruded.
    Designed,
}

/// The bench.
#[derive(Clone, Debug)]
pub struct SmallBench {
    /// The sample's shape.
    pub sample: Sample1,
    /// Pixels per side.
    pub size_px: usize,
    /// Directions of the lamps.
    pub lights: Vec<DVec3>,
    /// Paths per pixel of the truth.
    pub truth_samples: u32,
    /// Longest path of the truth in reflections.
    pub max_reflections: u32,
    /// Noise of a pixel over its radiance.
    pub relative_noise: f64,
    /// Noise of a black pixel over the image's mean radiance.
    pub dark_noise: f64,
}

impl Default for SmallBench {
    fn default() -> Self {
        Self {
            sample: Sample1::Bowl,
            size_px: 16,
            lights: vec![DVec3::Z, DVec3::new(0.5, 0.2, 1.0)],
            truth_samples: 256,
            max_reflections: 16,
            relative_noise: 0.007,
            dark_noise: 3e-4,
        }
    }
}

/// What is wrong with a bench.
#[derive(Clone)]
pub enum Defect {
    /// One half of the sample is made of something else.
    SecondMaterial(Arc<dyn Brdf>),
    /// The sample is deeper than its file says, by this factor.
    Deeper(f32),
    /// The sample is displaced (over its radius) and turned (radians).
    Pose(DVec3, DVec3),
    /// Light that comes from elsewhere, over the images' mean radiance.
    StrayLight(f32),
    /// Light leaves beside where it entered: the fraction of the radiance that is spread, and how far in pixels.
    Translucent(f32, f32),
}

impl SmallBench {
    fn mesh(&self, fineness: u32) -> Result<Mesh, MeshError> {
        match self.sample {
            Sample1::Bowl => Shape::Bowl {
                radius_mm: 1.0,
                segments: 64 * fineness,
            },
            Sample1::Designed => Shape::Designed {
                radius_mm: 0.32,
                offset: 0.5,
                phi_min_deg: 45.0,
                form: Form::Extruded,
                length_mm: 2.0,
                segments: 64 * fineness,
            },
        }
        .mesh()
    }

    fn camera_and_lights(&self) -> Option<(Camera, Vec<Light>)> {
        let camera = Camera::looking_at(
            [self.size_px, self.size_px],
            Projection::Orthographic {
                extent_mm: DVec2::splat(2.2),
            },
            DVec3::new(0.0, 0.0, 5.0),
            DVec3::ZERO,
            DVec3::Y,
        )?;
        let lights = self
            .lights
            .iter()
            .map(|d| Light::Directional {
                to_light: d.normalize(),
                irradiance: [1.0; 3],
                angular_radius_rad: 0.0,
            })
            .collect();
        Some((camera, lights))
    }

    /// What the fit believes.
    pub fn scene(&self) -> Result<Scene, MeshError> {
        let (camera, lights) = self.camera_and_lights().ok_or(MeshError::Empty)?;
        Ok(Scene::new(self.mesh(1)?, Shading::Smooth, camera, lights))
    }

    /// What is true.
    pub fn true_scene(&self, defect: Option<&Defect>) -> Result<Scene, MeshError> {
        let (camera, lights) = self.camera_and_lights().ok_or(MeshError::Empty)?;
        let mut mesh = self.mesh(2)?;
        let mut bodies = Vec::new();
        match defect {
            Some(Defect::SecondMaterial(brdf)) => {
                let (left, right) = halves(&mesh)?;
                mesh = left;
                bodies.push(Body {
                    mesh: right,
                    shading: Shading::Smooth,
                    brdf: brdf.clone(),
                });
            }
            Some(Defect::Deeper(factor)) => {
                for p in &mut mesh.positions_mm {
                    p.z *= factor;
                }
                for n in mesh.normals.iter_mut().flatten() {
                    *n = Vec3::new(n.x, n.y, n.z / factor).normalize();
                }
            }
            Some(Defect::Pose(shift, turn)) => {
                let pose = Rigid::<Sample, Sample>::from_rotation_vector(*turn, *shift);
                mesh = mesh.transformed(&pose);
            }
            _ => {}
        }
        Ok(Scene::with_bodies(
            mesh,
            Shading::Smooth,
            bodies,
            camera,
            lights,
        ))
    }

    /// One image per lamp of a sample of `brdf`. `proposal` should resemble the material.
    pub fn capture(
        &self,
        truth: &Scene,
        brdf: &dyn Brdf,
        proposal: &Proposal,
        defect: Option<&Defect>,
        seed: u64,
    ) -> Vec<RadianceImage> {
        let options = RenderOptions {
            samples_per_pixel: self.truth_samples,
            max_reflections: self.max_reflections,
            seed: stream(seed, Purpose::Experiment, 0, 0, 0).bits(),
            proposal: proposal.clone(),
        };
        let mut images = render(truth, brdf, &options, &|_| {});
        for (light, image) in images.iter_mut().enumerate() {
            let n = image.mean.len() as f32;
            let mean: [f32; 3] =
                std::array::from_fn(|c| image.mean.iter().map(|v| v[c]).sum::<f32>() / n);
            match defect {
                Some(Defect::StrayLight(share)) => {
                    for v in &mut image.mean {
                        (0..3).for_each(|c| v[c] += share * mean[c]);
                    }
                }
                Some(Defect::Translucent(share, radius)) => spread(image, *share, *radius),
                _ => {}
            }
            let rendered = image.variance.clone();
            for p in 0..image.mean.len() {
                let mut numbers = stream(seed, Purpose::Experiment, 1 + light as u64, p as u64, 0);
                for c in 0..3 {
                    let value = f64::from(image.mean[p][c]);
                    let sigma = (self.relative_noise * value)
                        .hypot(self.dark_noise * f64::from(mean[c]));
                    image.mean[p][c] += (sigma * numbers.normal()) as f32;
                    let around = neighbours(p, self.size_px);
                    let count = around.len() as f32;
                    let paths: f32 = around.into_iter().map(|q| rendered[q][c]).sum();
                    image.variance[p][c] = (sigma * sigma) as f32 + paths / count;
                }
            }
        }
        images
    }
}

fn neighbours(p: usize, size: usize) -> Vec<usize> {
    let (x, y) = (p % size, p / size);
    (y.saturating_sub(1)..=(y + 1).min(size - 1))
        .flat_map(|j| {
            (x.saturating_sub(1)..=(x + 1).min(size - 1)).map(move |i| j * size + i)
        })
        .collect()
}

/// Spreads a share of the radiance to the pixels around, with a Gaussian.
fn spread(image: &mut RadianceImage, share: f32, radius_px: f32) {
    let (w, h) = (image.width as isize, image.height as isize);
    let reach = (3.0 * radius_px).ceil() as isize;
    let before = image.mean.clone();
    for y in 0..h {
        for x in 0..w {
            let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
            for j in (y - reach).max(0)..=(y + reach).min(h - 1) {
                for i in (x - reach).max(0)..=(x + reach).min(w - 1) {
                    let d2 = ((i - x).pow(2) + (j - y).pow(2)) as f32;
                    let k = (-0.5 * d2 / (radius_px * radius_px)).exp();
                    total += k;
                    (0..3).for_each(|c| sum[c] += k * before[(j * w + i) as usize][c]);
                }
            }
            let v = &mut image.mean[(y * w + x) as usize];
            (0..3).for_each(|c| v[c] = (1.0 - share) * v[c] + share * sum[c] / total);
        }
    }
}

/// The triangles left and right of the plane x = 0.
fn halves(mesh: &Mesh) -> Result<(Mesh, Mesh), MeshError> {
    let part = |right: bool| -> Result<Mesh, MeshError> {
        let mut renumbered = vec![u32::MAX; mesh.positions_mm.len()];
        let (mut positions, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let x: f32 = mesh.corners(t).iter().map(|c| c.x).sum();
            if (x > 0.0) != right {
                continue;
            }
            triangles.push(corners.map(|v| {
                let new = &mut renumbered[v as usize];
                if *new == u32::MAX {
                    *new = positions.len() as u32;
                    positions.push(mesh.positions_mm[v as usize]);
                    if let Some(all) = &mesh.normals {
                        normals.push(all[v as usize]);
                    }
                }
                *new
            }));
        }
        let part = Mesh::new(positions, triangles)?;
        if mesh.normals.is_some() {
            part.with_normals(normals)
        } else {
            Ok(part)
        }
    };
    Ok((part(false)?, part(true)?))
}
