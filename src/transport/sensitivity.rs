//! How much the images change with ln f, by modes over the table of half and difference
//! angles: every reflection of a path multiplies its light by f at its pair of directions, so
//! the light itself, counted at the nodes around that pair, is the derivative.

use glam::Vec3;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::direct::for_each_seen;
use super::render::{Carrier, Event, RenderOptions, follow};
use super::scene::Scene;
use crate::brdf::Brdf;
use crate::brdf::departure::{NODES, around};

/// Rays per pixel for direct reflection, square root.
const DIRECT_STRATA: u32 = 4;

/// Derivatives of radiance over lamp strength, by two independent halves of the paths.
pub struct Sensitivity {
    lights: usize,
    modes: usize,
    /// `[((pixel · lights + light) · 3 + channel) · modes + mode]`.
    halves: [Vec<f32>; 2],
}

/// By the nodes, per light and channel.
type Sums = Vec<[f64; NODES]>;

impl Sensitivity {
    /// By `modes` (columns with values at the nodes) of ln f around `material`, for the
    /// `wanted` pixels; zero elsewhere.
    pub fn trace(
        scene: &Scene,
        material: &dyn Brdf,
        modes: &DMatrix<f64>,
        wanted: &[bool],
        options: &RenderOptions,
    ) -> Self {
        let lights = scene.lights.len();
        let continuations = options.continuations(scene);
        let per_half = (options.samples_per_pixel / 2).max(1);
        let by_modes = |direct: &Sums, others: &Sums| -> Vec<f32> {
            let scale = 1.0 / f64::from(per_half);
            let rows = direct.iter().zip(others);
            rows.flat_map(|(direct, others)| {
                modes.column_iter().map(move |mode| {
                    let values = direct.iter().zip(others).map(|(d, o)| d + scale * o);
                    mode.iter().zip(values).map(|(m, v)| m * v).sum::<f64>() as f32
                })
            })
            .collect()
        };
        let none = || vec![[0.0; NODES]; lights * 3];
        let pixels: Vec<[Vec<f32>; 2]> = (0..scene.camera.pixels())
            .into_par_iter()
            .map(|pixel| {
                if !wanted[pixel] {
                    return [(); 2].map(|()| vec![0.0; lights * 3 * modes.ncols()]);
                }
                let mut direct = none();
                look(scene, material, options.seed, pixel, &mut direct);
                [0, 1].map(|half| {
                    let mut others = none();
                    for sample in half * per_half..(half + 1) * per_half {
                        follow::<Visits>(
                            scene,
                            material,
                            options,
                            &continuations,
                            [pixel as u64, u64::from(sample)],
                            |order, light, reading, visits, event| {
                                if order > 1 {
                                    let sums = &mut others[light * 3..light * 3 + 3];
                                    visits.add(reading, event, sums);
                                }
                            },
                        );
                    }
                    by_modes(&direct, &others)
                })
            })
            .collect();
        Self {
            lights,
            modes: modes.ncols(),
            halves: [0, 1].map(|half| pixels.iter().flat_map(|p| &p[half]).copied().collect()),
        }
    }

    /// By each mode, of one value.
    pub fn at(&self, pixel: usize, light: usize, channel: usize) -> [&[f32]; 2] {
        let start = ((pixel * self.lights + light) * 3 + channel) * self.modes;
        let of_half = |half: usize| &self.halves[half][start..start + self.modes];
        [of_half(0), of_half(1)]
    }
}

/// Adds the direct reflection of a pixel.
fn look(scene: &Scene, material: &dyn Brdf, seed: u64, pixel: usize, sums: &mut Sums) {
    let share = 1.0 / f64::from(DIRECT_STRATA * DIRECT_STRATA);
    for_each_seen(
        scene,
        pixel,
        DIRECT_STRATA,
        seed,
        |surface, to_viewer, lamps| {
            for light in 0..scene.lights.len() {
                let u = [lamps.uniform_f32(), lamps.uniform_f32()];
                let Some(lamp) = scene.connect(surface, light, u) else {
                    continue;
                };
                let f = material.eval(lamp.to_light, to_viewer);
                for (node, part) in around(lamp.to_light, to_viewer) {
                    for (sum, f) in sums[light * 3..].iter_mut().zip(f) {
                        sum[node] += share * f64::from(f * lamp.irradiance * part);
                    }
                }
            }
        },
    );
}

/// What a path carries, and the nodes that its reflections at the sample met.
struct Visits {
    carried: [f64; 3],
    met: Vec<(usize, f32)>,
}

impl Carrier for Visits {
    fn start(direction: Vec3) -> Self {
        Self {
            carried: Carrier::start(direction),
            met: Vec::new(),
        }
    }

    fn reading(&self, event: &Event<'_>, irradiance: f32) -> [f64; 3] {
        self.carried.reading(event, irradiance)
    }

    fn reflect(&mut self, event: &Event<'_>, weight: [f32; 2]) -> bool {
        self.met.extend(met_at(event).into_iter().flatten());
        self.carried.reflect(event, weight)
    }
}

impl Visits {
    /// Adds a reading at the nodes that made it, the last reflection's included.
    fn add(&self, reading: [f64; 3], event: &Event<'_>, sums: &mut [[f64; NODES]]) {
        let last = met_at(event);
        for &(node, part) in self.met.iter().chain(last.iter().flatten()) {
            for (sum, value) in sums.iter_mut().zip(reading) {
                sum[node] += value * f64::from(part);
            }
        }
    }
}

/// The nodes of a reflection; none at a known body.
fn met_at(event: &Event<'_>) -> Option<[(usize, f32); 4]> {
    let on_sample = event.surface.is_sample();
    on_sample.then(|| around(event.to_light, event.to_viewer))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DVec2, DVec3};
    use nalgebra::DVector;

    use super::*;
    use crate::brdf::departure::{Departed, Departure, modes};
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::geometry::Shape;
    use crate::transport::{Camera, Light, Projection, Proposal, Shading, Steering, render};

    /// Against images of a material that departs a little to either side, along two modes:
    /// the renderer shares nothing but the table.
    #[test]
    fn images_change_as_told() {
        let projection = Projection::Orthographic {
            extent_mm: DVec2::splat(2.2),
        };
        let above = DVec3::new(0.0, 0.0, 5.0);
        let camera = Camera::looking_at([8, 8], projection, above, DVec3::ZERO, DVec3::Y).unwrap();
        let bowl = Shape::Bowl {
            radius_mm: 1.0,
            segments: 48,
        };
        let lamp = Light::Directional {
            to_light: DVec3::new(0.4, 0.1, 1.0).normalize(),
            irradiance: [1.0; 3],
            angular_radius_rad: 0.0,
        };
        let scene = Scene::new(bowl.mesh().unwrap(), Shading::Smooth, camera, vec![lamp]);
        let atoms = vec![
            Atom::Lambertian { albedo: 1.0 },
            Atom::Ggx {
                alpha: 0.3,
                eta: 3.0,
            },
        ];
        let dictionary = Arc::new(Dictionary::new("two", atoms).unwrap());
        let mixture = Mixture::grey(dictionary, vec![0.5, 0.5]).unwrap();
        let modes = modes().columns(0, 2).into_owned();
        let options = RenderOptions {
            samples_per_pixel: 4096,
            max_reflections: 4,
            seed: 5,
            proposal: Proposal::resembling(&mixture, 0.3),
            steering: Steering::NONE,
        };
        let wanted = vec![true; 64];
        let told = Sensitivity::trace(&scene, &mixture, &modes, &wanted, &options);
        let step = 0.05;
        for mode in 0..2 {
            let image = |sign: f64| {
                let g: DVector<f64> = modes.column(mode) * (sign * step);
                let g = Departure(g);
                let departed = Departed {
                    mixture: &mixture,
                    departures: [&g; 3],
                };
                render(&scene, &departed, &options, &|_| {}).remove(0)
            };
            let [more, less] = [1.0, -1.0].map(image);
            let (mut square, mut error) = (0.0, 0.0);
            for pixel in 0..64 {
                let seen = f64::from(more.mean[pixel][1] - less.mean[pixel][1]) / (2.0 * step);
                let [a, b] = told.at(pixel, 0, 1);
                let told = 0.5 * f64::from(a[mode] + b[mode]);
                square += seen * seen;
                error += (told - seen).powi(2);
            }
            // What is left is the direct part's own sampling.
            let relative = (error / square).sqrt();
            assert!(relative < 0.03, "mode {mode}: {relative}");
        }
    }
}
