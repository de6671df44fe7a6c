//! Direct reflection, which is linear in the weights: an exact pixels × atoms
//! matrix per lamp by dense quadrature over each pixel's footprint.

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::event::LaneAtoms;
use super::scene::{Scene, Surface};
use crate::brdf::dictionary::Dictionary;
use crate::brdf::ggx::Cosines;
use crate::random::{Purpose, Stream, stream};

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

/// Shows `each` where `strata`² jittered rays through a pixel meet the sample, with the
/// direction to the viewer and the numbers for the lamps.
pub fn for_each_seen(
    scene: &Scene,
    pixel: usize,
    strata: u32,
    seed: u64,
    mut each: impl FnMut(&Surface, Vec3, &mut Stream),
) {
    for sample in 0..strata * strata {
        let key = |purpose| stream(seed, purpose, u64::MAX, pixel as u64, u64::from(sample));
        let (mut position, mut lamps) = (key(Purpose::PixelPosition), key(Purpose::LightAndLens));
        let cell = DVec2::new(f64::from(sample % strata), f64::from(sample / strata));
        let jitter = DVec2::new(position.uniform(), position.uniform());
        let place = (cell + jitter) / f64::from(strata);
        let lens = DVec2::new(lamps.uniform(), lamps.uniform());
        let ray = scene.camera.ray_of_pixel(pixel, place, lens);
        if let Some((surface, to_viewer)) = scene.first(&ray).filter(|(hit, _)| hit.is_sample()) {
            each(&surface, to_viewer, &mut lamps);
        }
    }
}

impl DirectMatrix {
    /// `strata`² jittered samples per pixel.
    pub fn new(scene: &Scene, dictionary: &Dictionary, strata: u32, seed: u64) -> Self {
        let atoms = LaneAtoms::new(dictionary, true);
        let (n, lights) = (atoms.atoms(), scene.lights.len());
        let rows: Vec<(Vec<f32>, f32, Vec<f32>)> = (0..scene.camera.pixels())
            .into_par_iter()
            .map(|pixel| {
                let mut sums = vec![0.0f64; lights * n];
                let mut seen = 0u32;
                let mut lit = vec![0u32; lights];
                for_each_seen(scene, pixel, strata, seed, |surface, to_viewer, lamps| {
                    seen += 1;
                    for light in 0..lights {
                        let u = [lamps.uniform_f32(), lamps.uniform_f32()];
                        let Some(connection) = scene.connect(surface, light, u) else {
                            continue;
                        };
                        lit[light] += 1;
                        let (i, o) = (connection.to_light.to_array(), to_viewer.to_array());
                        if let Some(cosines) = Cosines::new(i, o) {
                            let row = &mut sums[light * n..(light + 1) * n];
                            atoms.add_values(&cosines, f64::from(connection.irradiance), row);
                        }
                    }
                });
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
