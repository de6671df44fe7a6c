//! Direct reflection, which is linear in the weights: an exact pixels × atoms
//! matrix per lamp by dense quadrature over each pixel's footprint.

use glam::DVec2;
use rayon::prelude::*;

use super::event::LaneAtoms;
use super::scene::Scene;
use crate::brdf::dictionary::Dictionary;
use crate::brdf::ggx::Cosines;
use crate::random::{Purpose, stream};

/// Radiance by direct reflection per unit weight and unit lamp strength.
pub struct DirectMatrix {
    /// `[(pixel · lights + light) · atoms + atom]`.
    values: Vec<f32>,
    /// Fraction of each pixel's footprint that shows the front of the sample, 0..=1.
    pub coverage: Vec<f32>,
    /// Fraction of the seen footprint that the lamp reaches, `[pixel · lights + light]`.
    lit: Vec<f32>,
    lights: usize,
    atoms: usize,
}

impl DirectMatrix {
    /// `strata`² jittered samples per pixel.
    pub fn new(scene: &Scene, dictionary: &Dictionary, strata: u32, seed: u64) -> Self {
        let atoms = LaneAtoms::new(dictionary, true);
        let (n, lights) = (atoms.atoms(), scene.lights.len());
        let width = scene.camera.resolution_px[0];
        let rows: Vec<(Vec<f32>, f32, Vec<f32>)> = (0..scene.camera.pixels())
            .into_par_iter()
            .map(|pixel| {
                let mut sums = vec![0.0f64; lights * n];
                let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
                let mut seen = 0u32;
                let mut lit = vec![0u32; lights];
                for sample in 0..strata * strata {
                    let key =
                        |purpose| stream(seed, purpose, u64::MAX, pixel as u64, u64::from(sample));
                    let (mut position, mut lamps) =
                        (key(Purpose::PixelPosition), key(Purpose::LightAndLens));
                    let cell = DVec2::new(f64::from(sample % strata), f64::from(sample / strata));
                    let jitter = DVec2::new(position.uniform(), position.uniform());
                    let at = scene
                        .camera
                        .in_footprint(corner, (cell + jitter) / f64::from(strata));
                    let ray = scene
                        .camera
                        .ray(at, DVec2::new(lamps.uniform(), lamps.uniform()));
                    let Some((surface, to_viewer)) =
                        scene.first(&ray).filter(|(hit, _)| hit.is_sample())
                    else {
                        continue;
                    };
                    seen += 1;
                    for light in 0..lights {
                        let u = [lamps.uniform_f32(), lamps.uniform_f32()];
                        let Some(connection) = scene.connect(&surface, light, u) else {
                            continue;
                        };
                        lit[light] += 1;
                        let (i, o) = (connection.to_light.to_array(), to_viewer.to_array());
                        if let Some(cosines) = Cosines::new(i, o) {
                            let row = &mut sums[light * n..(light + 1) * n];
                            atoms.add_values(&cosines, f64::from(connection.irradiance), row);
                        }
                    }
                }
                let samples = f64::from(strata * strata);
                let row = sums.iter().map(|&v| (v / samples) as f32).collect();
                let lit = lit.iter().map(|&n| n as f32 / seen.max(1) as f32).collect();
                (row, (f64::from(seen) / samples) as f32, lit)
            })
            .collect();
        Self {
            values: rows.iter().flat_map(|(row, ..)| row).copied().collect(),
            coverage: rows.iter().map(|(_, coverage, _)| *coverage).collect(),
            lit: rows.iter().flat_map(|(_, _, lit)| lit).copied().collect(),
            lights,
            atoms: n,
        }
    }

    /// Fraction of a pixel's seen footprint that a lamp reaches, 0..=1: between the two
    /// lies the edge of a shadow.
    pub fn lit(&self, pixel: usize, light: usize) -> f32 {
        self.lit[pixel * self.lights + light]
    }

    /// The row of one pixel under one lamp, one value per atom.
    pub fn row(&self, pixel: usize, light: usize) -> &[f32] {
        let start = (pixel * self.lights + light) * self.atoms;
        &self.values[start..start + self.atoms]
    }
}
