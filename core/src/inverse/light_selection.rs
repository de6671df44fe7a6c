//! Which light directions would add most information on a BRDF that is not known yet.
//!
//! A light's image adds the Fisher information Jᵀ W J about the mixture weights. Both
//! J and the residual weights W depend on the material, so they are computed for a few
//! plausible ones (samples of a Dirichlet distribution, or the current estimate), at a coarse
//! resolution. To each belongs a Gaussian posterior: the prior's covariance, updated
//! by the information of the lights taken. What counts is the expected squared
//! error of the BRDF: tr(M C), where M sums a aᵀ over the (θh, θd, φd) cells of the
//! cube-root BRDF error (a: the atoms' values) with the weight that makes it the variance
//! of ∛(cos θi·f); relative to the prior's, averaged over the materials (A-optimal
//! design, with the covariance of f in place of the weights', which are not
//! identifiable).
//!
//! Lights are added one by one, each time the one that leaves the least variance
//! (docs/adr/0017).

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector, SymmetricEigen};
use rayon::prelude::*;

use super::normal_equations::above_noise;
use super::objective::{Channels, ModelImage, Objective};
use super::uncertainty::{CONCENTRATION, dirichlet};
use crate::brdf::Dictionary;
use crate::brdf::ggx::Cosines;
use crate::brdf::score::cells;
use crate::cells::{Captured, CellImage, CellOptions, Grid, choose};
use crate::outer_products::Products;
use crate::random::{Purpose, stream};
use crate::transport::cache::CacheError;
use crate::transport::{Cache, CacheOptions, Cells, DirectMatrix, Kernel, Scene};

/// How the information of the candidates is computed.
#[derive(Clone, Debug)]
pub struct SelectionOptions {
    /// Camera paths per cell, at least 2.
    pub samples_per_cell: u32,
    /// Longest path in surface reflections, 2..=64.
    pub max_reflections: u32,
    /// Same seed, same paths.
    pub seed: u64,
    /// Relative error of the model, as in the fit, 0..=1.
    pub model_error: f64,
    /// Noise of the capture as a fraction of an image's mean radiance: exposures follow
    /// the light.
    pub noise: f64,
    /// How many independent values one image is worth: model error is correlated
    /// between pixels.
    pub independent_values: f64,
    /// Instructions to use; the portable ones give the same choice on every machine.
    pub kernel: Kernel,
}

impl Default for SelectionOptions {
    fn default() -> Self {
        Self {
            samples_per_cell: 64,
            max_reflections: 8,
            seed: 1,
            model_error: 0.02,
            noise: 0.002,
            // A 64 × 64 image in the blocks of 8 × 8 pixels of the fit's uncertainty.
            independent_values: 64.0,
            kernel: Kernel::Portable,
        }
    }
}

/// Plausible materials where nothing is known.
pub const PRIOR_MATERIALS: usize = 8;
/// Candidates traced together; fixed, for the same memory and sums everywhere.
const BATCH: usize = 8;
/// Square root of the samples per pixel of the direct reflection.
const DIRECT_STRATA: u32 = 6;
/// Cells of each batch.
const CELLS: usize = 500;
/// Azimuths φd of the cells: materials change little with it.
const AZIMUTHS: usize = 3;
/// Keeps dark cells from counting without bound, 1/sr.
const REFLECTANCE_FLOOR: f64 = 1e-3;

/// Weights of plausible materials: samples of a symmetric Dirichlet distribution.
pub fn prior_materials(dictionary: &Dictionary, count: usize, seed: u64) -> Vec<DVector<f64>> {
    (0..count)
        .map(|k| {
            let mut numbers = stream(seed, Purpose::Experiment, 0x6c69_6768, 0, k as u64);
            dirichlet(dictionary.len(), &mut numbers)
        })
        .collect()
}

/// The information of each candidate light, for each plausible material.
pub struct Prospects {
    candidates: usize,
    materials: Vec<Prospect>,
}

/// One material.
struct Prospect {
    /// Per candidate: R with R Rᵀ its information, N × rank.
    roots: Vec<DMatrix<f64>>,
    /// Covariance of the weights before any image, N × N.
    prior: DMatrix<f64>,
    /// tr(metric · covariance) is the variance of the BRDF.
    metric: DMatrix<f64>,
    /// That variance before any image.
    initial: f64,
}

impl Prospect {
    fn new(roots: Vec<DMatrix<f64>>, prior: DMatrix<f64>, metric: DMatrix<f64>) -> Self {
        let initial = metric.dot(&prior);
        Self {
            roots,
            prior,
            metric,
            initial,
        }
    }
}

/// A light that was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Index of the candidate.
    pub candidate: usize,
    /// Expected variance of the BRDF with it and all before, over the variance without
    /// any image.
    pub remaining: f64,
}

impl Prospects {
    /// Traces the candidates, which are the scene's lights. `materials`: weights of
    /// plausible mixtures of the dictionary, at least one.
    ///
    /// # Errors
    /// The dictionary or the scene's bodies cannot be cached.
    pub fn new(
        mut scene: Scene,
        dictionary: &Dictionary,
        materials: &[DVector<f64>],
        options: &SelectionOptions,
    ) -> Result<Self, CacheError> {
        let lights = std::mem::take(&mut scene.lights);
        scene.falloffs.clear();
        let grid_options = CellOptions {
            budget: CELLS,
            ..CellOptions::default()
        };
        // Per material and candidate.
        let mut roots = vec![Vec::with_capacity(lights.len()); materials.len()];
        for batch in lights.chunks(BATCH) {
            scene.lights = batch.to_vec();
            let grid = choose(&scene, &grid_options);
            let captured = unknown_images(&scene, grid);
            let cells = &*captured.cells;
            let direct = DirectMatrix::new(&scene, cells, dictionary, DIRECT_STRATA, options.seed);
            let cache = Cache::trace(
                &scene,
                cells,
                dictionary,
                &CacheOptions {
                    samples_per_cell: options.samples_per_cell,
                    max_reflections: options.max_reflections,
                    seed: options.seed,
                    ..CacheOptions::default()
                },
            )?;
            let shared = Channels::Shared;
            let (kernel, error) = (options.kernel, options.model_error);
            let objective = Objective::new(&cache, &direct, &captured, shared, kernel, error);
            for (roots, weights) in roots.iter_mut().zip(materials) {
                let information = information(&objective, weights, options);
                roots.extend(information.into_iter().map(root));
            }
        }
        let prior = prior_covariance(dictionary.len());
        let prospects = materials.iter().zip(roots).map(|(weights, roots)| {
            Prospect::new(roots, prior.clone(), metric(dictionary, weights))
        });
        Ok(Self {
            candidates: lights.len(),
            materials: prospects.collect(),
        })
    }

    /// Number of candidates.
    pub fn candidates(&self) -> usize {
        self.candidates
    }

    /// Expected variance of the BRDF after images under these candidates, over the
    /// variance without any: 0..=1.
    pub fn remaining(&self, chosen: &[usize]) -> f64 {
        self.mean_variance(&self.posterior(chosen))
    }

    /// Up to `count` candidates beyond those `taken`, best first: each is the one that
    /// leaves the least variance together with all before it.
    pub fn greedy(&self, taken: &[usize], count: usize) -> Vec<Choice> {
        let mut used = vec![false; self.candidates];
        taken.iter().for_each(|&light| used[light] = true);
        let mut covariances = self.posterior(taken);
        let mut choices = Vec::new();
        while choices.len() < count {
            let left: Vec<(usize, f64)> = (0..self.candidates)
                .into_par_iter()
                .filter(|&light| !used[light])
                .map(|light| (light, self.with(&covariances, light)))
                .collect();
            // The first of equals.
            let Some((candidate, remaining)) = left
                .into_iter()
                .reduce(|best, next| if next.1 < best.1 { next } else { best })
            else {
                break;
            };
            used[candidate] = true;
            for (covariance, material) in covariances.iter_mut().zip(&self.materials) {
                update(covariance, &material.roots[candidate]);
            }
            choices.push(Choice {
                candidate,
                remaining,
            });
        }
        choices
    }

    /// [`Self::greedy`] from nothing, or the first `count` candidates if those leave
    /// less: no greedy choice is promised to beat a given set, and the candidates come in
    /// an order that is good for every number of lights.
    pub fn best(&self, count: usize) -> Vec<Choice> {
        let greedy = self.greedy(&[], count);
        let count = count.min(self.candidates);
        let spread: Vec<usize> = (0..count).collect();
        match greedy.last() {
            Some(last) if self.remaining(&spread) < last.remaining => spread
                .iter()
                .map(|&candidate| Choice {
                    candidate,
                    remaining: self.remaining(&spread[..=candidate]),
                })
                .collect(),
            _ => greedy,
        }
    }

    fn posterior(&self, chosen: &[usize]) -> Vec<DMatrix<f64>> {
        self.materials
            .iter()
            .map(|material| {
                let mut covariance = material.prior.clone();
                for &light in chosen {
                    update(&mut covariance, &material.roots[light]);
                }
                covariance
            })
            .collect()
    }

    fn mean_variance(&self, covariances: &[DMatrix<f64>]) -> f64 {
        let relative = covariances
            .iter()
            .zip(&self.materials)
            .map(|(c, material)| material.metric.dot(c) / material.initial);
        relative.sum::<f64>() / self.materials.len() as f64
    }

    /// The mean variance with one more light.
    fn with(&self, covariances: &[DMatrix<f64>], light: usize) -> f64 {
        let relative = covariances
            .iter()
            .zip(&self.materials)
            .map(|(c, material)| {
                let root = &material.roots[light];
                let gain = match gain(c, root) {
                    Some((c_root, inner)) => {
                        let seen = c_root.tr_mul(&(&material.metric * &c_root));
                        inner.solve(&seen).trace()
                    }
                    None => 0.0,
                };
                (material.metric.dot(c) - gain) / material.initial
            });
        relative.sum::<f64>() / self.materials.len() as f64
    }
}

/// C R and the Cholesky factor of I + Rᵀ C R; `None` where R has no information.
fn gain(
    covariance: &DMatrix<f64>,
    root: &DMatrix<f64>,
) -> Option<(DMatrix<f64>, Cholesky<f64, nalgebra::Dyn>)> {
    if root.ncols() == 0 {
        return None;
    }
    let c_root = covariance * root;
    let mut inner = root.tr_mul(&c_root);
    inner.fill_upper_triangle_with_lower_triangle();
    for k in 0..inner.nrows() {
        inner[(k, k)] += 1.0;
    }
    Some((c_root, Cholesky::new(inner)?))
}

/// (C⁻¹ + R Rᵀ)⁻¹ = C − C R (I + Rᵀ C R)⁻¹ Rᵀ C (Woodbury), for singular C too.
fn update(covariance: &mut DMatrix<f64>, root: &DMatrix<f64>) {
    if let Some((c_root, inner)) = gain(covariance, root) {
        *covariance -= &c_root * inner.solve(&c_root.transpose());
        covariance.fill_upper_triangle_with_lower_triangle();
    }
}

/// Images that are not taken yet, over the cells of a scene.
fn unknown_images(scene: &Scene, grid: Grid) -> Captured {
    let none = CellImage {
        mean: vec![[0.0; 3]; grid.cells.len()],
        variance: vec![[0.0; 3]; grid.cells.len()],
    };
    Captured {
        images: vec![none; scene.lights.len()],
        common_errors: Vec::new(),
        cells: Arc::new(Cells::new(grid.resolution_px, grid.cells)),
        edges: grid.edges,
        outliers: 0,
    }
}

/// R with R Rᵀ the information above Monte Carlo noise, without its null space.
fn root(information: DMatrix<f64>) -> DMatrix<f64> {
    let n = information.nrows();
    let eigen = SymmetricEigen::new(above_noise(information));
    let largest = eigen.eigenvalues.max();
    let columns: Vec<DVector<f64>> = (0..n)
        .filter(|&k| eigen.eigenvalues[k] > 1e-10 * largest)
        .map(|k| eigen.eigenvectors.column(k) * eigen.eigenvalues[k].sqrt())
        .collect();
    match columns.is_empty() {
        true => DMatrix::zeros(n, 0),
        false => DMatrix::from_columns(&columns),
    }
}

/// Of a symmetric Dirichlet distribution, by its concentration.
fn prior_covariance(n: usize) -> DMatrix<f64> {
    let share = 1.0 / n as f64;
    let scale = share / (CONCENTRATION * n as f64 + 1.0);
    DMatrix::from_fn(n, n, |i, j| scale * (f64::from(u8::from(i == j)) - share))
}

/// Sum over the cells of w·a aᵀ: tr(metric · covariance) is the mean variance of
/// ∛(cos θi·f) to first order.
fn metric(dictionary: &Dictionary, weights: &DVector<f64>) -> DMatrix<f64> {
    let n = dictionary.len();
    let mut metric = DMatrix::zeros(n, n);
    let mut total = 0.0;
    for cell in cells(AZIMUTHS) {
        let directions = [cell.to_light, cell.to_viewer].map(|d| d.as_dvec3().to_array());
        let Some(at) = Cosines::new(directions[0], directions[1]) else {
            continue;
        };
        let atoms = DVector::from_iterator(n, dictionary.atoms().iter().map(|a| a.eval(&at)));
        let f = atoms.dot(weights) + REFLECTANCE_FLOOR;
        let solid_angle = f64::from(cell.solid_angle);
        // (d∛(cos·f)/df)² = cos^(2/3) f^(−4/3) / 9.
        let weight = solid_angle * at.cos_i.powf(2.0 / 3.0) * f.powf(-4.0 / 3.0) / 9.0;
        metric.syger(weight, &atoms, &atoms, 1.0);
        total += solid_angle;
    }
    metric.fill_upper_triangle_with_lower_triangle();
    metric / total
}

/// Information of each light's image about the weights: sym(J_Aᵀ W J_B), scaled to the number
/// of independent values. Values are compared and weighed as in a fit: a residual's weight comes
/// from the cell's neighbours, since one whose paths missed the light would count as certain.
fn information(
    objective: &Objective<'_>,
    weights: &DVector<f64>,
    options: &SelectionOptions,
) -> Vec<DMatrix<f64>> {
    let (cells, mixture) = (objective.cells(), std::slice::from_ref(weights));
    // Each counts by the part of the field that it covers.
    let field: usize = cells.resolution_px().iter().product();
    let per_pixel = options.independent_values / field as f64;
    let of_light = |(light, image): (usize, &ModelImage)| {
        let values = image.iter().map(|cell| cell[0].value());
        let lit = values.clone().filter(|&value| value > 0.0).count();
        let mean = values.sum::<f64>() / lit.max(1) as f64;
        let noise = (options.noise * mean).powi(2);
        let weight = |cell: usize| {
            let compared = |&other: &usize| objective.is_compared(light, other);
            if mean <= 0.0 || !compared(&cell) {
                return [0.0; 3];
            }
            let near = cells.around(cell).filter(compared);
            let [value, rendered] = image[cell][0].expected(near.map(|other| image[other][0]));
            let variance = (options.model_error * value).powi(2) + rendered + noise;
            let scale = per_pixel * cells.cell(cell).pixels() as f64;
            // One channel: a lamp's colour is not known.
            [scale / variance, 0.0, 0.0]
        };
        (0..cells.len()).map(weight).collect()
    };
    let model = objective.modelled(mixture);
    let residual_weights: Vec<_> = model.iter().enumerate().map(of_light).collect();
    let n = weights.len();
    let all = objective.accumulate(
        mixture,
        &residual_weights,
        None,
        || vec![Products::zero(n); objective.lights()],
        |sums, value| sums[value.light].add(value.weight, value.by_weights),
        |total, part| {
            let both = total.iter_mut().zip(part);
            both.for_each(|(sum, part)| sum.join(part));
        },
    );
    all.into_iter().map(Products::matrix).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Shape;
    use crate::transport::{Camera, Light, Projection, Shading};
    use glam::{DVec2, DVec3};

    /// Random information of low rank about five weights, for two materials.
    fn synthetic(candidates: usize) -> Prospects {
        let mut numbers = stream(4, Purpose::Experiment, 0, 0, 0);
        let mut matrix = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| numbers.normal());
        let materials = (0..2).map(|_| {
            let roots = (0..candidates).map(|_| matrix(5, 2) * 3.0).collect();
            let cells = matrix(5, 9);
            Prospect::new(roots, prior_covariance(5), &cells * cells.transpose())
        });
        Prospects {
            candidates,
            materials: materials.collect(),
        }
    }

    /// The variance by inverting the whole precision on the simplex's tangent space.
    fn by_inversion(prospects: &Prospects, chosen: &[usize]) -> f64 {
        let relative = prospects.materials.iter().map(|material| {
            let mut information = DMatrix::zeros(5, 5);
            for &light in chosen {
                information += &material.roots[light] * material.roots[light].transpose();
            }
            // Columns span the vectors whose components sum to zero.
            let tangent = DMatrix::from_fn(5, 4, |i, j| {
                f64::from(u8::from(i == j)) - f64::from(u8::from(i == j + 1))
            });
            let reduced = tangent.clone().pseudo_inverse(1e-12).unwrap();
            let prior = &reduced * &material.prior * reduced.transpose();
            let precision =
                prior.try_inverse().unwrap() + tangent.transpose() * information * &tangent;
            let posterior = &tangent * precision.try_inverse().unwrap() * tangent.transpose();
            material.metric.dot(&posterior) / material.metric.dot(&material.prior)
        });
        relative.sum::<f64>() / 2.0
    }

    #[test]
    fn greedy_steps_are_the_best_single_steps() {
        let prospects = synthetic(7);
        let choices = prospects.greedy(&[], 3);
        let mut chosen = Vec::new();
        for choice in choices {
            let with = |light: usize| {
                let mut set = chosen.clone();
                set.push(light);
                by_inversion(&prospects, &set)
            };
            let left = (0..7).filter(|light| !chosen.contains(light));
            let best = left.min_by(|&a, &b| with(a).total_cmp(&with(b))).unwrap();
            assert_eq!(choice.candidate, best);
            assert!((choice.remaining / with(best) - 1.0).abs() < 1e-9);
            chosen.push(best);
        }
        assert!(
            (prospects.remaining(&chosen) / by_inversion(&prospects, &chosen) - 1.0).abs() < 1e-9
        );
        assert_eq!(prospects.remaining(&[]), 1.0);
        // What is taken is not chosen again, and there are no more than there are.
        let rest = prospects.greedy(&chosen, 100);
        assert_eq!(rest.len(), 4);
        assert!(
            rest.iter()
                .all(|choice| !chosen.contains(&choice.candidate))
        );
    }

    #[test]
    fn best_is_never_worse_than_the_evenly_spread() {
        let prospects = synthetic(9);
        for count in 1..=9 {
            let best = prospects.best(count);
            let set: Vec<usize> = best.iter().map(|choice| choice.candidate).collect();
            let spread: Vec<usize> = (0..count).collect();
            assert_eq!(set.len(), count);
            assert!(prospects.remaining(&set) <= prospects.remaining(&spread) * (1.0 + 1e-9));
        }
    }

    fn bowl(lights: Vec<Light>) -> Scene {
        let mesh = Shape::Bowl {
            radius_mm: 1.0,
            segments: 24,
        }
        .mesh()
        .unwrap();
        let camera = Camera::looking_at(
            [12, 12],
            Projection::Orthographic {
                extent_mm: DVec2::splat(2.2),
            },
            DVec3::new(0.0, 0.0, 5.0),
            DVec3::ZERO,
            DVec3::Y,
        )
        .unwrap();
        Scene::new(mesh, Shading::Smooth, camera, lights)
    }

    fn prospects(threads: usize) -> Prospects {
        let light = |degrees: f64| Light::Directional {
            to_light: DVec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos()),
            irradiance: [1.0; 3],
            angular_radius_rad: 0.0,
        };
        let lights = [
            0.0, 120.0, -30.0, 30.0, 50.0, -50.0, 10.0, -10.0, 20.0, 65.0,
        ];
        let dictionary = Dictionary::paper42();
        let materials = prior_materials(&dictionary, 2, 5);
        let options = SelectionOptions {
            samples_per_cell: 16,
            ..SelectionOptions::default()
        };
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            Prospects::new(
                bowl(lights.map(light).into()),
                &dictionary,
                &materials,
                &options,
            )
        })
        .unwrap()
    }

    /// Bit for bit; and the light from below, which lights nothing, comes last.
    #[test]
    fn the_choice_is_the_same_for_any_number_of_threads() {
        let (one, three) = (prospects(1), prospects(3));
        let (first, second) = (one.greedy(&[], 10), three.greedy(&[], 10));
        assert_eq!(first, second);
        assert_eq!(first.last().unwrap().candidate, 1);
        let falling = first
            .windows(2)
            .all(|pair| pair[1].remaining <= pair[0].remaining * (1.0 + 1e-12));
        assert!(falling && first[0].remaining < 1.0, "{first:?}");
    }
}
