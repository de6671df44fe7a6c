//! Importance sampling of any isotropic BRDF from a table of itself.
//!
//! For each of a few angles of the viewer, f·cos θ is integrated over cells of the half
//! vector; a cell is drawn with that probability and the half vector evenly inside it.
//! Half vectors follow the highlight when the viewer moves, so few angles suffice.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Brdf;

/// Bins of the viewer's angle to the normal, evenly over 0 to 90°.
const VIEWERS: usize = 45;
/// Rings of the half vector: θh = 90°·(ring/RINGS)².
const RINGS: usize = 64;
/// Sectors of the half vector's azimuth to the viewer, 0 to 180°; the other half mirrors it.
const SECTORS: usize = 16;
const CELLS: usize = RINGS * SECTORS;

/// A piecewise constant density over half vectors.
#[derive(Clone, Debug, PartialEq)]
pub struct LobeTable {
    /// Per viewer and cell: probability of this and all cells before.
    cumulative: Vec<f64>,
    /// Per viewer and cell: probability per solid angle of the half vector, 1/sr.
    density: Vec<f32>,
}

/// 1 − cos θ of a ring's inner edge, without its cancellation near the normal.
fn versine(ring: usize) -> f64 {
    let theta = std::f64::consts::FRAC_PI_2 * (ring as f64 / RINGS as f64).powi(2);
    2.0 * (0.5 * theta).sin().powi(2)
}

/// Solid angle of a cell and its mirror image.
fn solid_angle(ring: usize) -> f64 {
    2.0 * std::f64::consts::PI / SECTORS as f64 * (versine(ring + 1) - versine(ring))
}

/// Azimuth 0 is the viewer's.
fn half_vector(versine: f64, azimuth: f64) -> DVec3 {
    let sin = (versine * (2.0 - versine)).max(0.0).sqrt();
    DVec3::new(sin * azimuth.cos(), sin * azimuth.sin(), 1.0 - versine)
}

impl LobeTable {
    /// Tabulates `brdf`, all channels together, by 370,000 evaluations on all threads.
    pub fn new(brdf: &dyn Brdf) -> Self {
        let rows: Vec<(Vec<f64>, Vec<f32>)> = (0..VIEWERS)
            .into_par_iter()
            .map(|viewer| {
                let mut weights: Vec<f64> = (0..CELLS)
                    .map(|cell| cell_power(brdf, viewer, cell / SECTORS, cell % SECTORS))
                    .collect();
                let total: f64 = weights.iter().sum();
                if total > 0.0 {
                    weights.iter_mut().for_each(|w| *w /= total);
                }
                let density = weights.iter().enumerate();
                let density = density.map(|(cell, w)| (w / solid_angle(cell / SECTORS)) as f32);
                let mut sum = 0.0;
                let cumulative = weights.iter().map(|w| {
                    sum += w;
                    sum
                });
                (cumulative.collect(), density.collect())
            })
            .collect();
        let (cumulative, density): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
        Self {
            cumulative: cumulative.concat(),
            density: density.concat(),
        }
    }

    /// A direction for the local `to_viewer`, from four numbers in [0, 1); `None` where it
    /// would point below the horizon, or the BRDF is black from there.
    #[inline]
    pub fn sample(&self, to_viewer: Vec3, u: [f64; 4]) -> Option<Vec3> {
        let first = viewer_bin(to_viewer) * CELLS;
        let cumulative = &self.cumulative[first..first + CELLS];
        let cell = cumulative.partition_point(|&sum| sum <= u[0] * cumulative[CELLS - 1]);
        if cell == CELLS {
            return None;
        }
        let (ring, sector) = (cell / SECTORS, cell % SECTORS);
        let inner = versine(ring);
        let versine = inner + u[1] * (versine(ring + 1) - inner);
        let azimuth = (sector as f64 + u[2]) * std::f64::consts::PI / SECTORS as f64;
        let azimuth = if u[3] < 0.5 { azimuth } else { -azimuth };
        let local = half_vector(versine, azimuth).as_vec3();
        let (x, y) = viewer_axes(to_viewer);
        let half = Vec3::new(
            x * local.x - y * local.y,
            y * local.x + x * local.y,
            local.z,
        );
        let direction = (2.0 * to_viewer.dot(half) * half - to_viewer).normalize();
        (direction.z > 0.0).then_some(direction)
    }

    /// Density of [`Self::sample`] per solid angle of `direction` (1/sr, cosine excluded).
    #[inline]
    pub fn pdf(&self, to_viewer: Vec3, direction: Vec3) -> f32 {
        let sum = to_viewer + direction;
        let length = sum.length();
        if !(direction.z > 0.0 && to_viewer.z > 0.0 && length > 0.0) {
            return 0.0;
        }
        let tangential = sum.x.hypot(sum.y);
        let theta = tangential.atan2(sum.z);
        let ring = (((theta / FRAC_PI_2).sqrt() * RINGS as f32) as usize).min(RINGS - 1);
        let (x, y) = viewer_axes(to_viewer);
        let across = (x * sum.y - y * sum.x).abs();
        let azimuth = across.atan2(x * sum.x + y * sum.y);
        let sector = ((azimuth / PI * SECTORS as f32) as usize).min(SECTORS - 1);
        let density = self.density[viewer_bin(to_viewer) * CELLS + ring * SECTORS + sector];
        // dω = 4 (o·h) dω_h, and |o + i| = 2 (o·h).
        density / (2.0 * length)
    }
}

/// Mean over a viewer bin's edges of f·cos θ·dω over a cell, by 2 × 2 midpoints each.
fn cell_power(brdf: &dyn Brdf, viewer: usize, ring: usize, sector: usize) -> f64 {
    let mut power = 0.0;
    for edge in [0.05, 0.95] {
        let theta = std::f64::consts::FRAC_PI_2 * (viewer as f64 + edge) / VIEWERS as f64;
        let to_viewer = DVec3::new(theta.sin(), 0.0, theta.cos());
        for step in 0..4 {
            let (u, v) = (f64::from(step % 2), f64::from(step / 2));
            let inner = versine(ring);
            let versine = inner + (0.25 + 0.5 * u) * (versine(ring + 1) - inner);
            let azimuth = (sector as f64 + 0.25 + 0.5 * v) * std::f64::consts::PI / SECTORS as f64;
            let half = half_vector(versine, azimuth);
            let cos_d = to_viewer.dot(half);
            let direction = 2.0 * cos_d * half - to_viewer;
            if cos_d > 0.0 && direction.z > 0.0 {
                let f = brdf.eval(direction.as_vec3(), to_viewer.as_vec3());
                let sum: f32 = f.iter().filter(|f| f.is_finite()).sum();
                power += f64::from(sum.max(0.0)) * direction.z * 4.0 * cos_d;
            }
        }
    }
    power * solid_angle(ring)
}

fn viewer_bin(to_viewer: Vec3) -> usize {
    let theta = to_viewer.x.hypot(to_viewer.y).atan2(to_viewer.z);
    ((theta / FRAC_PI_2 * VIEWERS as f32) as usize).min(VIEWERS - 1)
}

/// Cosine and sine of the viewer's azimuth.
fn viewer_axes(to_viewer: Vec3) -> (f32, f32) {
    let length = to_viewer.x.hypot(to_viewer.y);
    if length > 0.0 {
        (to_viewer.x / length, to_viewer.y / length)
    } else {
        (1.0, 0.0)
    }
}
