//! Direct reflection by a material with model discrepancy: its ratio to the mixture's, and its
//! derivatives by the modes of the discrepancy.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::cell_footprints::Cells;
use super::direct::for_each_lit;
use super::scene::Scene;
use crate::brdf::Brdf;
use crate::brdf::discrepancy::{Material, NODES, Place, Prior, VALUES};

/// Rays per pixel, square root. The mixture's own reflection is computed with more
/// ([`super::DirectMatrix`]); here only a ratio is needed.
const STRATA: u32 = 4;

/// Direct reflection by a material, relative to its mixture's, per pixel, light and channel.
pub struct DirectDiscrepancy {
    lights: usize,
    modes: usize,
    /// Ratio to that of the mixture alone, `[(pixel · lights + light) · 3 + channel]`.
    factors: Vec<f32>,
    /// Derivatives of the logarithm of the reflected light by the discrepancy's modes, `[… · modes + mode]`.
    by_modes: Vec<f32>,
}

impl DirectDiscrepancy {
    /// In the `wanted` pixels; factors of 1 and derivatives of 0 elsewhere.
    pub fn new(
        scene: &Scene,
        cells: &Cells,
        material: &Material,
        prior: &Prior,
        wanted: &[bool],
        seed: u64,
    ) -> Self {
        let lights = scene.lights.len();
        let modes = prior.modes().ncols();
        let in_rows = prior.modes().transpose();
        let of_cells: Vec<(Vec<f32>, Vec<f32>)> = (0..cells.len())
            .into_par_iter()
            .map(|cell| {
                let values = lights * 3;
                if !wanted[cell] {
                    return (vec![1.0; values], vec![0.0; values * modes]);
                }
                let sums = sums_of(scene, cells, material, cell, seed);
                let factors = sums.iter().map(Sum::factor).collect();
                (
                    factors,
                    sums.iter().flat_map(|sum| sum.by_modes(&in_rows)).collect(),
                )
            })
            .collect();
        let (factors, by_modes): (Vec<_>, Vec<_>) = of_cells.into_iter().unzip();
        Self {
            lights,
            modes,
            factors: factors.into_iter().flatten().collect(),
            by_modes: by_modes.into_iter().flatten().collect(),
        }
    }

    fn index(&self, cell: usize, light: usize, channel: usize) -> usize {
        (cell * self.lights + light) * 3 + channel
    }

    /// Ratio of the material's direct reflection to the mixture's.
    pub fn factor(&self, cell: usize, light: usize, channel: usize) -> f32 {
        self.factors[self.index(cell, light, channel)]
    }

    /// The derivative of the logarithm of the reflected light by each mode.
    pub fn by_modes(&self, cell: usize, light: usize, channel: usize) -> &[f32] {
        let start = self.index(cell, light, channel) * self.modes;
        &self.by_modes[start..start + self.modes]
    }
}

/// Light of one pixel, lamp and channel.
#[derive(Clone)]
struct Sum {
    of_mixture: f64,
    reflected: f64,
    /// Derivatives of `reflected` by the values of the discrepancy.
    values: [f64; VALUES],
}

impl Sum {
    const ZERO: Self = Self {
        of_mixture: 0.0,
        reflected: 0.0,
        values: [0.0; VALUES],
    };

    fn factor(&self) -> f32 {
        if self.of_mixture > 0.0 {
            (self.reflected / self.of_mixture) as f32
        } else {
            1.0
        }
    }

    /// Along the modes, which are `in_rows`.
    fn by_modes(&self, in_rows: &DMatrix<f64>) -> Vec<f32> {
        let scale = if self.reflected > 0.0 {
            1.0 / self.reflected
        } else {
            0.0
        };
        let mut by_modes = vec![0.0; in_rows.nrows()];
        // Light that is reflected once meets few nodes.
        for (column, value) in in_rows.column_iter().zip(self.values) {
            if value != 0.0 {
                for (sum, mode) in by_modes.iter_mut().zip(column.iter()) {
                    *sum += value * mode;
                }
            }
        }
        by_modes.iter().map(|&v| (scale * v) as f32).collect()
    }
}

/// The sums of a pixel, per light and channel.
fn sums_of(scene: &Scene, cells: &Cells, material: &Material, cell: usize, seed: u64) -> Vec<Sum> {
    let lights = scene.lights.len();
    let share = 1.0 / f64::from(STRATA * STRATA);
    let mut sums = vec![Sum::ZERO; lights * 3];
    for_each_lit(
        scene,
        cells,
        cell,
        STRATA,
        seed,
        |light, lamp, to_viewer| {
            let of_mixture = material.mixture.eval(lamp.to_light, to_viewer);
            let place = Place::of(lamp.to_light, to_viewer);
            let sums = &mut sums[light * 3..light * 3 + 3];
            for (c, (sum, of_mixture)) in sums.iter_mut().zip(of_mixture).enumerate() {
                let arriving = share * f64::from(lamp.irradiance);
                let of_mixture = arriving * f64::from(of_mixture);
                sum.of_mixture += of_mixture;
                for (node, part) in place.around {
                    let factor = material.discrepancies[c].at(node, place.cos_2phi).exp();
                    let reflected = of_mixture * factor * f64::from(part);
                    sum.reflected += reflected;
                    sum.values[node] += reflected;
                    sum.values[NODES + node] += reflected * f64::from(place.cos_2phi);
                }
            }
        },
    );
    sums
}
