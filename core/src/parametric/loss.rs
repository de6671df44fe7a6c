//! What a parametric model loses of a material.

use glam::DVec3;

use super::ParametricBrdf;
use crate::brdf::check::{ALBEDO_ANGLES_DEG, directional_albedo};
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::score::{self, EnvironmentError};
use crate::brdf::sphere::{SphereImage, sphere_images};
use crate::brdf::{Brdf, HalfDifference};

/// Half and difference angles at which the two are compared, degrees.
const THETA_H_DEG: [f64; 11] = [
    0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0,
];
const THETA_D_DEG: [f64; 9] = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0];
/// Azimuths over which is averaged.
const AZIMUTHS: usize = 6;
/// Cells named.
const NAMED: usize = 3;
/// Directions per technique of an albedo's quadrature.
const PER_TECHNIQUE: u32 = 256;

/// What was lost, and the spheres that show it.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Loss {
    /// Of spheres under the environment maps.
    pub environment: EnvironmentError,
    /// Where values differ most, the worst first.
    pub worst: Vec<WorstAngle>,
    /// Directional albedos, of all channels in the mean.
    pub albedo: Vec<AlbedoPair>,
    /// For each map the model's sphere and the material's.
    #[serde(skip)]
    pub spheres: Vec<[SphereImage; 2]>,
}

/// A half and a difference angle at which the model is wrong.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[allow(missing_docs)]
pub struct WorstAngle {
    pub theta_h_deg: f64,
    pub theta_d_deg: f64,
    /// f of the model over f of the material, less 1, both averaged over azimuth and channels.
    pub relative: f64,
}

/// Light reflected of light from one direction.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[allow(missing_docs)]
pub struct AlbedoPair {
    /// Angle of incidence, degrees.
    pub theta_deg: f64,
    pub model: f64,
    pub material: f64,
}

impl Loss {
    /// Of `model` against `material`, by spheres of `size` pixels a side.
    pub fn of(model: &ParametricBrdf, material: &dyn Brdf, size: usize) -> Self {
        Self::with_spheres_of(model, material, &[], size).0
    }

    /// [`Self::of`], and images of spheres of `others` under each environment map, which the same
    /// pass over the maps renders.
    pub fn with_spheres_of(
        model: &ParametricBrdf,
        material: &dyn Brdf,
        others: &[&dyn Brdf],
        size: usize,
    ) -> (Self, Vec<Vec<SphereImage>>) {
        let maps = EnvironmentMap::all();
        let brdfs = [&[model as &dyn Brdf, material], others].concat();
        let (spheres, others): (Vec<[SphereImage; 2]>, _) = sphere_images(&brdfs, &maps, size)
            .into_iter()
            .filter_map(|mut under| {
                let others = under.split_off(2);
                Some((under.try_into().ok()?, others))
            })
            .unzip();
        let errors: Vec<_> = spheres
            .iter()
            .map(|[model, material]| score::image_error(model, material))
            .collect();
        let loss = Self {
            environment: score::summarise(&maps, &errors),
            worst: worst(model, material),
            albedo: albedo(model, material),
            spheres,
        };
        (loss, others)
    }

    /// The environment error: mean over the maps, all channels together.
    pub fn error(&self) -> f64 {
        self.environment.mean.all
    }
}

/// The cells with the largest difference of ∛(f·cos θi), none next to another.
fn worst(model: &dyn Brdf, material: &dyn Brdf) -> Vec<WorstAngle> {
    let mut cells = Vec::new();
    for (i, &theta_h_deg) in THETA_H_DEG.iter().enumerate() {
        for (j, &theta_d_deg) in THETA_D_DEG.iter().enumerate() {
            let [a, b] = means([model, material], theta_h_deg, theta_d_deg);
            if b > 0.0 {
                let relative = a / b - 1.0;
                let angle = WorstAngle {
                    theta_h_deg,
                    theta_d_deg,
                    relative,
                };
                cells.push(((a.cbrt() - b.cbrt()).abs(), [i, j], angle));
            }
        }
    }
    cells.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut named: Vec<([usize; 2], WorstAngle)> = Vec::new();
    for (_, at, angle) in cells {
        let near = |other: &[usize; 2]| (0..2).all(|axis| other[axis].abs_diff(at[axis]) <= 1);
        if named.len() < NAMED && !named.iter().any(|(other, _)| near(other)) {
            named.push((at, angle));
        }
    }
    named.into_iter().map(|(_, angle)| angle).collect()
}

/// f·cos θi averaged over azimuth and channels; 0 where all lies below the horizon.
fn means(brdfs: [&dyn Brdf; 2], theta_h_deg: f64, theta_d_deg: f64) -> [f64; 2] {
    let mut sums = [0.0; 2];
    let mut count = 0;
    for k in 0..AZIMUTHS {
        let (to_light, to_viewer) = HalfDifference {
            theta_h_rad: theta_h_deg.to_radians(),
            theta_d_rad: theta_d_deg.to_radians(),
            phi_d_rad: std::f64::consts::PI * (k as f64 + 0.5) / AZIMUTHS as f64,
        }
        .to_directions();
        if to_light.z > 0.03 && to_viewer.z > 0.03 {
            count += 3;
            for (sum, brdf) in sums.iter_mut().zip(brdfs) {
                let f = brdf.eval(to_light.as_vec3(), to_viewer.as_vec3());
                *sum += to_light.z * f.into_iter().map(f64::from).sum::<f64>();
            }
        }
    }
    sums.map(|sum| sum / f64::from(count.max(1)))
}

fn albedo(model: &dyn Brdf, material: &dyn Brdf) -> Vec<AlbedoPair> {
    // Normal, oblique and grazing incidence.
    [0, 3, 6]
        .map(|k| {
            let theta_deg = ALBEDO_ANGLES_DEG[k];
            let (sin, cos) = theta_deg.to_radians().sin_cos();
            let mean = |brdf: &dyn Brdf| {
                let to_light = DVec3::new(sin, 0.0, cos);
                directional_albedo(brdf, to_light, PER_TECHNIQUE)
                    .iter()
                    .sum::<f64>()
                    / 3.0
            };
            AlbedoPair {
                theta_deg,
                model: mean(model),
                material: mean(material),
            }
        })
        .to_vec()
}
