//! How the images change with the bench: every path is traced again on a bench that
//! differs a little, with the same random numbers, so that the noise of the two
//! values cancels in their difference.
//!
//! The two halves of the samples step in opposite directions: each half is an
//! independent estimate, and their mean is a central difference. A light that moves
//! leaves the camera's paths as they are, so all lights' steps share one set of them.
//! Direct reflection, which has most of the information, is a central difference of dense quadratures over
//! the cells' footprints, without noise and the same for both halves.
//!
//! Whatever multiplies the residual, it vanishes on average at the true bench: a
//! derivative that is off costs certainty, not truth. So what comes by way of other
//! surfaces, which is noisy and varies slowly, is averaged over neighbouring cells.

use glam::Vec3;
use nalgebra::DVector;
use rayon::prelude::*;

use super::parameters::{Nuisance, Parameter};
use crate::brdf::Brdf;
use crate::geometry::Mesh;
use crate::transport::direct::for_each_seen;
use crate::transport::falloff::Falloff;
use crate::transport::points::{IndependentSampler, Sampler};
use crate::transport::scene::Surface;
use crate::transport::{Cells, Continuations, Proposal, Scene, Steering};

/// Reach over which derivatives by way of other surfaces are averaged, parts of the image's width.
pub(in crate::inverse) const AVERAGED: f64 = 3.0 / 64.0;

/// How derivative images are traced.
#[derive(Clone, Debug)]
pub struct DerivativeOptions {
    /// Paths per cell in each half and on each differing bench; 0: direct reflection alone.
    pub samples_per_half: u32,
    /// Longest path in surface reflections, 1..=64.
    pub max_reflections: u32,
    /// Same seed, same paths.
    pub seed: u64,
    /// Where continuations go.
    pub proposal: Proposal,
    /// What leads continuations to light, on all benches as on the base.
    pub steering: Steering,
    /// Direct reflection: square root of the samples per cell, at least 1.
    pub direct_strata: u32,
    /// What comes by way of other surfaces is averaged over cells up to this far away, parts of
    /// the image's width.
    pub average: f64,
}

/// Derivatives of radiance over lamp strength with respect to the geometric parameters.
pub struct DerivativeImages {
    /// Parameter and light of each column: a light's direction changes its own image
    /// alone, the pose changes all.
    columns: Vec<(usize, usize)>,
    /// `[cell · columns + column]`.
    values: Vec<Derivative>,
}

/// The derivative of one value, per channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Derivative {
    /// By direct reflection, without noise.
    pub direct: [f32; 3],
    /// By all reflections, as each half of the paths sees it.
    pub halves: [[f32; 3]; 2],
}

/// A bench that differs from the base, as one half of the samples sees it.
struct View {
    /// Its lights are slots; the base view has more of them than the bench has lights.
    scene: Scene,
    /// The light that a slot stands for: slots of one light share random numbers.
    light_of_slot: Vec<usize>,
}

/// A column, and where its value stands: view and slot.
struct Place {
    parameter: usize,
    view: usize,
    slot: usize,
    light: usize,
    step: f64,
}

impl DerivativeImages {
    /// Derivatives at `values` for the material `brdf`, at the cells that are `wanted`; zero elsewhere.
    pub fn trace(
        bench: &Nuisance,
        values: &DVector<f64>,
        cells: &Cells,
        brdf: &dyn Brdf,
        wanted: &[bool],
        options: &DerivativeOptions,
    ) -> Self {
        let base = bench.scene(values);
        let halves = [1.0, -1.0].map(|sign| views(bench, &base, values, sign));
        Self::between(&base, cells, &halves, brdf, wanted, options)
    }

    /// By how much the images change when the sample takes these shapes: the mean of what a
    /// deformation adds and what its opposite takes away. `deformed` has a mesh for each, as
    /// the first half of the samples sees it and as the second does; its index stands for
    /// the parameter.
    pub fn of_shapes(
        base: &Scene,
        cells: &Cells,
        deformed: Vec<[Mesh; 2]>,
        brdf: &dyn Brdf,
        wanted: &[bool],
        options: &DerivativeOptions,
    ) -> Self {
        let lights = base.lights.len();
        let still = || View {
            scene: base.clone(),
            light_of_slot: (0..lights).collect(),
        };
        let mut halves = [1.0, -1.0].map(|_| (vec![still()], Vec::new()));
        for (parameter, meshes) in deformed.into_iter().enumerate() {
            for ((views, places), (mesh, step)) in
                halves.iter_mut().zip(meshes.into_iter().zip([1.0, -1.0]))
            {
                places.extend((0..lights).map(|light| Place {
                    parameter,
                    view: views.len(),
                    slot: light,
                    light,
                    step,
                }));
                views.push(View {
                    scene: base.deformed(mesh),
                    ..still()
                });
            }
        }
        Self::between(base, cells, &halves, brdf, wanted, options)
    }

    /// Differences between the first view and the others, over their steps.
    fn between(
        base: &Scene,
        cells: &Cells,
        halves: &[(Vec<View>, Vec<Place>); 2],
        brdf: &dyn Brdf,
        wanted: &[bool],
        options: &DerivativeOptions,
    ) -> Self {
        let lights = base.lights.len();
        let places = &halves[0].1;
        let columns: Vec<_> = places.iter().map(|p| (p.parameter, p.light)).collect();
        // Direct reflection alone follows nothing.
        let guide = match options.samples_per_half {
            0 => None,
            _ => options.steering.guide(base, options.seed),
        };
        let continuations = Continuations::new(&options.proposal, options.steering, guide);
        let rows: Vec<Vec<Parts>> = (0..cells.len())
            .into_par_iter()
            .map(|cell| {
                let mut row = vec![Parts::default(); columns.len()];
                if !wanted[cell] {
                    return row;
                }
                for (half, (views, places)) in halves.iter().enumerate() {
                    let mut direct = Vec::with_capacity(views.len());
                    let mut others = Vec::with_capacity(views.len());
                    for view in views {
                        let mut walk = Walk::new(view, lights);
                        walk.look(brdf, options, cells, cell);
                        direct.push(walk.take());
                        let n = options.samples_per_half;
                        for sample in half as u32 * n..(half as u32 + 1) * n {
                            walk.follow(brdf, options, &continuations, (cells, cell), sample);
                        }
                        others.push(walk.take());
                    }
                    for (value, place) in row.iter_mut().zip(places) {
                        let change = |means: &[Vec<[f64; 3]>], c: usize| {
                            let moved = means[place.view][place.slot][c];
                            (moved - means[0][place.light][c]) / place.step
                        };
                        for c in 0..3 {
                            value.direct[c] += (0.5 * change(&direct, c)) as f32;
                            value.others[half][c] = change(&others, c) as f32;
                        }
                    }
                }
                row
            })
            .collect();
        let values = smoothed(&rows, wanted, cells, options.average);
        Self { columns, values }
    }

    /// Parameter, light and derivative, of one cell.
    pub fn at(&self, cell: usize) -> impl Iterator<Item = (usize, usize, &Derivative)> {
        let n = self.columns.len();
        let values = &self.values[cell * n..(cell + 1) * n];
        self.columns
            .iter()
            .zip(values)
            .map(|(&(parameter, light), value)| (parameter, light, value))
    }
}

/// The derivative of one value before it is averaged, per channel.
#[derive(Clone, Copy, Default)]
struct Parts {
    /// By direct reflection.
    direct: [f32; 3],
    /// By way of other surfaces, as each half of the paths sees it.
    others: [[f32; 3]; 2],
}

/// The direct part of each cell, and the mean of the other over the wanted cells around.
fn smoothed(rows: &[Vec<Parts>], wanted: &[bool], cells: &Cells, reach: f64) -> Vec<Derivative> {
    (0..rows.len())
        .into_par_iter()
        .map(|cell| {
            let mut out: Vec<Derivative> = rows[cell]
                .iter()
                .map(|&Parts { direct, .. }| Derivative {
                    direct,
                    halves: [direct; 2],
                })
                .collect();
            if !wanted[cell] {
                return out;
            }
            // The neighbours at least, where anything is averaged.
            let side = f64::from(cells.cell(cell).side_px) / cells.resolution_px()[0] as f64;
            let reach = if reach > 0.0 {
                reach.max(1.01 * side)
            } else {
                0.0
            };
            let near: Vec<usize> = cells.within(cell, reach).filter(|&q| wanted[q]).collect();
            let total: f64 = near.iter().map(|&q| cells.area(q)).sum();
            for q in near {
                let share = (cells.area(q) / total) as f32;
                for (out, parts) in out.iter_mut().zip(&rows[q]) {
                    for (out, others) in out.halves.iter_mut().zip(&parts.others) {
                        for (out, other) in out.iter_mut().zip(others) {
                            *out += share * other;
                        }
                    }
                }
            }
            out
        })
        .collect::<Vec<_>>()
        .concat()
}

/// The views of one half, and where each column's value stands in them.
fn views(
    bench: &Nuisance,
    base: &Scene,
    values: &DVector<f64>,
    sign: f64,
) -> (Vec<View>, Vec<Place>) {
    let lights = base.lights.len();
    let mut views = vec![View {
        scene: base.clone(),
        light_of_slot: (0..lights).collect(),
    }];
    // Moved lights follow those that stay, each with its own falloff.
    if !base.falloffs.is_empty() {
        let falloffs = &mut views[0].scene.falloffs;
        falloffs.resize(lights, Falloff::default());
    }
    let mut places = Vec::new();
    for (k, &parameter) in bench.parameters().iter().enumerate() {
        if !parameter.is_geometric() {
            continue;
        }
        let step = sign * step(bench, k);
        let mut moved = values.clone();
        moved[k] += step;
        let mut scene = bench.scene(&moved);
        if let Some(light) = parameter.light() {
            views[0].scene.lights.push(scene.lights.swap_remove(light));
            if !base.falloffs.is_empty() {
                let own = views[0].scene.falloffs[light];
                views[0].scene.falloffs.push(own);
            }
            views[0].light_of_slot.push(light);
            places.push(Place {
                parameter: k,
                view: 0,
                slot: views[0].light_of_slot.len() - 1,
                light,
                step,
            });
        } else {
            views.push(View {
                scene,
                light_of_slot: (0..lights).collect(),
            });
            places.extend((0..lights).map(|light| Place {
                parameter: k,
                view: views.len() - 1,
                slot: light,
                light,
                step,
            }));
        }
    }
    (views, places)
}

/// Half the prior deviation, where that is small enough to be linear (0.2°, a two
/// hundredth of the sample) and large enough against rounding and the jumps at edges.
fn step(bench: &Nuisance, parameter: usize) -> f64 {
    let half = 0.5 * bench.prior_deviation(parameter);
    match bench.parameters()[parameter] {
        Parameter::Translation(_) => {
            let size = bench.sample_radius_mm();
            half.clamp(1e-3 * size, 5e-3 * size)
        }
        _ => half.clamp(5e-4, 3.5e-3),
    }
}

/// Follows paths through one view and sums their values per slot.
struct Walk<'a> {
    view: &'a View,
    lamp_numbers: Vec<[f32; 2]>,
    paths: u32,
    sums: Vec<[f64; 3]>,
}

impl<'a> Walk<'a> {
    fn new(view: &'a View, lights: usize) -> Self {
        Self {
            view,
            lamp_numbers: vec![[0.0; 2]; lights],
            paths: 0,
            sums: vec![[0.0; 3]; view.light_of_slot.len()],
        }
    }

    /// The mean value per slot of what was followed since the last time.
    fn take(&mut self) -> Vec<[f64; 3]> {
        let paths = f64::from(std::mem::take(&mut self.paths).max(1));
        let none = vec![[0.0; 3]; self.sums.len()];
        let sums = std::mem::replace(&mut self.sums, none);
        sums.into_iter().map(|sum| sum.map(|v| v / paths)).collect()
    }

    /// Adds what the lamps give at a reflection to which `throughput` belongs.
    fn connect(
        &mut self,
        brdf: &dyn Brdf,
        surface: &Surface,
        to_viewer: Vec3,
        throughput: Vec3,
        mut on_lamp: impl FnMut() -> [f32; 2],
    ) {
        for numbers in &mut self.lamp_numbers {
            *numbers = on_lamp();
        }
        for (slot, sum) in self.sums.iter_mut().enumerate() {
            let numbers = self.lamp_numbers[self.view.light_of_slot[slot]];
            if let Some(connection) = self.view.scene.connect(surface, slot, numbers) {
                let f = Vec3::from(brdf.eval(connection.to_light, to_viewer));
                let value = throughput * f * connection.irradiance;
                for (sum, value) in sum.iter_mut().zip(value.to_array()) {
                    *sum += f64::from(value);
                }
            }
        }
    }

    /// Adds the direct reflection of a cell.
    fn look(&mut self, brdf: &dyn Brdf, options: &DerivativeOptions, cells: &Cells, cell: usize) {
        let view = self.view;
        let strata = options.direct_strata;
        self.paths += strata * strata;
        for_each_seen(
            &view.scene,
            cells,
            cell,
            strata,
            options.seed,
            |surface, to_viewer, numbers| {
                let brdf = view.scene.known(surface).unwrap_or(brdf);
                let on_lamp = || numbers.on_lamp();
                self.connect(brdf, surface, to_viewer, Vec3::ONE, on_lamp);
            },
        );
    }

    /// Adds what a path finds by way of other surfaces.
    fn follow(
        &mut self,
        brdf: &dyn Brdf,
        options: &DerivativeOptions,
        continuations: &Continuations<'_>,
        (cells, cell): (&Cells, usize),
        sample: u32,
    ) {
        let view = self.view;
        let scene = &view.scene;
        self.paths += 1;
        let (mut numbers, ray) =
            IndependentSampler::begin_in(&scene.camera, cells, options.seed, cell, sample);
        let mut throughput = Vec3::ONE;
        let mut kind = continuations.begin();
        let mut next = scene.first(&ray).filter(|(hit, _)| hit.is_sample());
        let mut reflections = 0;
        while let Some((surface, to_viewer)) = next {
            reflections += 1;
            let brdf = scene.known(&surface).unwrap_or(brdf);
            if reflections > 1 {
                let on_lamp = || numbers.on_lamp();
                self.connect(brdf, &surface, to_viewer, throughput, on_lamp);
            }
            if reflections >= options.max_reflections {
                break;
            }
            let drawn = continuations.draw(&mut kind, &surface, to_viewer, &mut numbers);
            let Some((direction, pdf)) = drawn else {
                break;
            };
            throughput *= Vec3::from(brdf.eval(direction, to_viewer)) * (direction.z / pdf);
            if throughput == Vec3::ZERO {
                break;
            }
            next = scene.next(&surface, direction);
        }
    }
}
