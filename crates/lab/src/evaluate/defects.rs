//! Defects of bench and sample that the model of the fit does not include.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use nalgebra::DVector;

use super::lab::misaligned;
use crate::brdf::Brdf;
use crate::frames::{self, Rigid};
use crate::geometry::{FormError, Mesh, MeshError};
use crate::radiance_image::RadianceImage;
use crate::random::{Purpose, stream};
use crate::transport::{Body, Scene, Shading};

/// A defect.
#[derive(Clone)]
pub enum Defect {
    /// The half of the sample with x > 0 is made of something else.
    SecondMaterial(Arc<dyn Brdf>),
    /// The sample is deeper than its file says, by this factor.
    Depth(f32),
    /// The sample is displaced (mm) and turned (rotation vector, radians).
    Pose(DVec3, DVec3),
    /// Lights and sample differ from their description by these values of a bench's parameters.
    Misaligned(DVector<f64>),
    /// The sample deviates from its mesh by a random field of this seed.
    Form(FormError, u64),
    /// Light from elsewhere in every pixel, over the image's mean radiance.
    StrayLight(f32),
    /// This share of the radiance spreads around with a Gaussian of this many pixels.
    Translucent(f32, f32),
}

impl Defect {
    /// The scene as it truly is.
    pub fn scene(&self, sound: &Scene) -> Result<Scene, MeshError> {
        if let Defect::Misaligned(values) = self {
            return Ok(misaligned::bench(sound).scene(values));
        }
        let mut mesh = sound.sample().clone();
        let mut bodies = Vec::new();
        let shading = if sound.is_flat() {
            Shading::Flat
        } else {
            Shading::Smooth
        };
        match self {
            Defect::SecondMaterial(brdf) => {
                let other = part(&mesh, |x| x > 0.0)?;
                mesh = part(&mesh, |x| x <= 0.0)?;
                bodies.push(Body {
                    mesh: other,
                    shading,
                    brdf: brdf.clone(),
                });
            }
            Defect::Depth(factor) => {
                mesh.positions_mm.iter_mut().for_each(|p| p.z *= factor);
                for n in mesh.normals.iter_mut().flatten() {
                    *n = Vec3::new(n.x, n.y, n.z / factor).normalize();
                }
            }
            Defect::Pose(shift_mm, turn_rad) => {
                let pose = Rigid::<frames::Sample, frames::Sample>::from_rotation_vector(
                    *turn_rad, *shift_mm,
                );
                mesh = mesh.transformed(&pose);
            }
            Defect::Form(error, seed) => {
                let mut numbers = stream(*seed, Purpose::Experiment, 0, 0, 0);
                let field = error.field(mesh.mean_edge_mm(), &mut numbers);
                mesh = field.deform(&mesh, 1.0);
            }
            Defect::StrayLight(_) | Defect::Translucent(..) | Defect::Misaligned(_) => {}
        }
        let lights = sound.lights.clone();
        Ok(Scene::with_bodies(
            mesh,
            shading,
            bodies,
            sound.camera,
            lights,
        ))
    }

    /// What happens to an image of that scene before the sensor sees it.
    pub fn image(&self, image: &mut RadianceImage) {
        match *self {
            Defect::StrayLight(share) => {
                let n = image.mean.len() as f32;
                let sum = image
                    .mean
                    .iter()
                    .fold([0.0f32; 3], |sum, v| std::array::from_fn(|c| sum[c] + v[c]));
                for v in &mut image.mean {
                    (0..3).for_each(|c| v[c] += share * sum[c] / n);
                }
            }
            Defect::Translucent(share, radius_px) => spread(image, share, radius_px),
            _ => {}
        }
    }
}

/// Mixes every pixel with a Gaussian mean of those around.
fn spread(image: &mut RadianceImage, share: f32, radius_px: f32) {
    let (width, height) = (image.width, image.height);
    let reach = (3.0 * radius_px).ceil() as usize;
    let before = image.mean.clone();
    for (p, v) in image.mean.iter_mut().enumerate() {
        let (x, y) = (p % width, p / width);
        let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
        for j in y.saturating_sub(reach)..=(y + reach).min(height - 1) {
            for i in x.saturating_sub(reach)..=(x + reach).min(width - 1) {
                let d2 = (i.abs_diff(x).pow(2) + j.abs_diff(y).pow(2)) as f32;
                let weight = (-0.5 * d2 / (radius_px * radius_px)).exp();
                total += weight;
                (0..3).for_each(|c| sum[c] += weight * before[j * width + i][c]);
            }
        }
        (0..3).for_each(|c| v[c] = (1.0 - share) * v[c] + share * sum[c] / total);
    }
}

/// The triangles for whose middle's x `keep` is true.
fn part(mesh: &Mesh, keep: impl Fn(f32) -> bool) -> Result<Mesh, MeshError> {
    let mut renumbered = vec![u32::MAX; mesh.positions_mm.len()];
    let (mut positions, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for (t, corners) in mesh.triangles.iter().enumerate() {
        if !keep(mesh.corners(t).iter().map(|c| c.x).sum::<f32>()) {
            continue;
        }
        triangles.push(corners.map(|v| {
            let new = &mut renumbered[v as usize];
            if *new == u32::MAX {
                *new = positions.len() as u32;
                positions.push(mesh.positions_mm[v as usize]);
                normals.extend(mesh.normals.as_ref().map(|all| all[v as usize]));
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
}
