//! Light that a material reflects once which departs from a mixture: by how much it differs
//! from the mixture's, and how it changes with ln f at the nodes of the departure.

use nalgebra::DVector;
use rayon::prelude::*;

use super::cells::Cells;
use super::direct::for_each_seen;
use super::points::Numbers;
use super::scene::Scene;
use crate::brdf::Brdf;
use crate::brdf::departure::{Departed, NODES, around, modes};

/// Rays per pixel, square root. The mixture's own light is known better
/// ([`super::DirectMatrix`]); here only a factor is needed.
const STRATA: u32 = 4;

/// Direct reflection of a departed material, per pixel, light and channel.
pub struct DirectDeparted {
    lights: usize,
    /// Over that of the mixture alone, `[(pixel · lights + light) · 3 + channel]`.
    factors: Vec<f32>,
    /// Derivatives of ln of the departed light by the departure's modes, `[… · modes + mode]`.
    by_modes: Vec<f32>,
}

impl DirectDeparted {
    /// In the `wanted` pixels; factors of 1 and derivatives of 0 elsewhere.
    pub fn new(
        scene: &Scene,
        cells: &Cells,
        material: &Departed,
        wanted: &[bool],
        seed: u64,
    ) -> Self {
        let lights = scene.lights.len();
        let of_cells: Vec<(Vec<f32>, Vec<f32>)> = (0..cells.len())
            .into_par_iter()
            .map(|cell| {
                let values = lights * 3;
                if !wanted[cell] {
                    return (vec![1.0; values], vec![0.0; values * modes().ncols()]);
                }
                let sums = look(scene, cells, material, cell, seed);
                let factors = sums.iter().map(Sum::factor).collect();
                (factors, sums.iter().flat_map(Sum::by_modes).collect())
            })
            .collect();
        let (factors, by_modes): (Vec<_>, Vec<_>) = of_cells.into_iter().unzip();
        Self {
            lights,
            factors: factors.into_iter().flatten().collect(),
            by_modes: by_modes.into_iter().flatten().collect(),
        }
    }

    fn index(&self, cell: usize, light: usize, channel: usize) -> usize {
        (cell * self.lights + light) * 3 + channel
    }

    /// By what the mixture's light is multiplied.
    pub fn factor(&self, cell: usize, light: usize, channel: usize) -> f32 {
        self.factors[self.index(cell, light, channel)]
    }

    /// The derivative of ln of the light by each mode.
    pub fn by_modes(&self, cell: usize, light: usize, channel: usize) -> &[f32] {
        let modes = modes().ncols();
        let start = self.index(cell, light, channel) * modes;
        &self.by_modes[start..start + modes]
    }
}

/// Light of one pixel, lamp and channel.
#[derive(Clone)]
struct Sum {
    of_mixture: f64,
    departed: f64,
    /// The departed, by node.
    nodes: [f64; NODES],
}

impl Sum {
    const ZERO: Self = Self {
        of_mixture: 0.0,
        departed: 0.0,
        nodes: [0.0; NODES],
    };

    fn factor(&self) -> f32 {
        if self.of_mixture > 0.0 {
            (self.departed / self.of_mixture) as f32
        } else {
            1.0
        }
    }

    fn by_modes(&self) -> Vec<f32> {
        let by_modes = modes().tr_mul(&DVector::from_column_slice(&self.nodes));
        let scale = if self.departed > 0.0 {
            1.0 / self.departed
        } else {
            0.0
        };
        by_modes.iter().map(|&v| (scale * v) as f32).collect()
    }
}

/// The sums of a pixel, per light and channel.
fn look(scene: &Scene, cells: &Cells, material: &Departed, cell: usize, seed: u64) -> Vec<Sum> {
    let lights = scene.lights.len();
    let share = 1.0 / f64::from(STRATA * STRATA);
    let mut sums = vec![Sum::ZERO; lights * 3];
    for_each_seen(
        scene,
        cells,
        cell,
        STRATA,
        seed,
        |surface, to_viewer, numbers| {
            for light in 0..lights {
                let u = numbers.on_lamp();
                let Some(lamp) = scene.connect(surface, light, u) else {
                    continue;
                };
                let of_mixture = material.mixture.eval(lamp.to_light, to_viewer);
                let around = around(lamp.to_light, to_viewer);
                let sums = &mut sums[light * 3..light * 3 + 3];
                for (c, (sum, of_mixture)) in sums.iter_mut().zip(of_mixture).enumerate() {
                    let arriving = share * f64::from(lamp.irradiance);
                    let of_mixture = arriving * f64::from(of_mixture);
                    sum.of_mixture += of_mixture;
                    for (node, part) in around {
                        let factor = material.departures[c].0[node].exp();
                        let departed = of_mixture * factor * f64::from(part);
                        sum.departed += departed;
                        sum.nodes[node] += departed;
                    }
                }
            }
        },
    );
    sums
}
