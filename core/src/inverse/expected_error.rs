//! How well images would tell a material: the environment error that they are expected to leave.
//!
//! Unknown is ln f at the nodes of the discrepancy's table ([`crate::brdf::discrepancy`]). A priori
//! it is Gaussian about a plausible material, and varies as measured materials depart from their
//! mixtures. A light's image adds the Fisher information Jᵀ W J about it, with J the derivatives of
//! the image by the same paths and with the same weights W as in a fit, at a coarse resolution. The
//! posterior covariance C leaves the environment error √tr(E C), with E the error's curvature
//! ([`crate::brdf::error_curvature`]); of several materials the geometric mean counts. The weights
//! of a mixture are no unknowns: inside the span of a dictionary grazing f follows from the rest,
//! and every bench would do (docs/adr/0017).

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::normal_equations::above_noise;
use super::objective::{Channels, DiscrepancyModel, ModelImage, Objective, ResidualWeights};
use crate::brdf::discrepancy::{Discrepancy, Material, Prior};
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::error_curvature::ErrorCurvature;
use crate::brdf::nbrdf::NeuralBrdf;
use crate::brdf::{Atom, Brdf, BrdfError, Dictionary, Mixture};
use crate::cells::{Captured, CellImage, CellOptions, Grid, choose};
use crate::outer_products::Products;
use crate::transport::cache::CacheError;
use crate::transport::{Cache, CacheOptions, Cells, DirectMatrix, Kernel, Scene};

mod deviations;

pub use deviations::{Deviation, error_by_deviations};

/// How the information of the candidates is computed.
#[derive(Clone, Debug)]
pub struct PredictionOptions {
    /// Camera paths per cell, at least 2.
    pub samples_per_cell: u32,
    /// Longest path in surface reflections, 2..=64.
    pub max_reflections: u32,
    /// Same seed, same paths.
    pub seed: u64,
    /// Relative error of the model, 0..=1.
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

impl Default for PredictionOptions {
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

/// Limits of the bands of difference angles for which an error is stated separately, degrees.
pub const BANDS_DEG: [f64; BANDS + 1] = [0.0, 22.0, 42.0, 57.0, 72.0, 90.0];
/// Their number.
pub const BANDS: usize = 5;
/// Embedded materials that stand for an unknown one.
pub const USUAL: [&str; 5] = [
    "cherry-235",
    "red-plastic",
    "green-latex",
    "silver-paint",
    "light-brown-fabric",
];

/// Candidates traced together; fixed, for the same memory and sums everywhere.
const BATCH: usize = 8;
/// Square root of the samples per pixel of the direct reflection.
const DIRECT_STRATA: u32 = 6;
/// Cells of each batch.
const CELLS: usize = 500;
/// Pixels along the longer side of [`coarse`] images.
pub const RESOLUTION_PX: usize = 24;
/// Pixels per side of the spheres of the error.
const SPHERE_PX: usize = 16;
/// Keeps the logarithm of black finite, 1/sr.
const REFLECTANCE_FLOOR: f64 = 1e-5;

/// One channel of a material whose error is predicted.
pub struct Subject {
    /// What tables call it.
    pub name: String,
    /// ln (π f) at the nodes.
    ln_f: Discrepancy,
    /// How ln f varies about it a priori.
    prior: Arc<Prior>,
    /// E along the prior's modes.
    curvature: DMatrix<f64>,
    /// The same with what it does at difference angles of each band alone.
    bands: [DMatrix<f64>; BANDS],
}

impl Subject {
    /// A channel of `brdf`, with what is known of it a priori.
    pub fn new(name: &str, brdf: &dyn Brdf, channel: usize, prior: Arc<Prior>) -> Self {
        let mut tables = Discrepancy::closest(|angles| {
            let (to_light, to_viewer) = angles.to_directions();
            let f = brdf.eval(to_light.as_vec3(), to_viewer.as_vec3());
            f.map(|f| (std::f64::consts::PI * (f64::from(f) + REFLECTANCE_FLOOR)).ln())
        });
        let ln_f = std::mem::replace(&mut tables[channel], Discrepancy::none());
        let curvature = ErrorCurvature::new(&ln_f, &EnvironmentMap::all(), SPHERE_PX);
        let modes = prior.modes();
        let band = |k: usize| curvature.along(modes, BANDS_DEG[k]..BANDS_DEG[k + 1]);
        Self {
            name: name.to_owned(),
            ln_f,
            curvature: curvature.along(modes, 0.0..BANDS_DEG[BANDS]),
            bands: std::array::from_fn(band),
            prior,
        }
    }

    /// The green channel of an embedded material, known a priori from the others; `None` for a name
    /// that is not in [`crate::brdf::nbrdf::NAMES`].
    pub fn embedded(name: &str) -> Option<Self> {
        let material = NeuralBrdf::named(name)?;
        let prior = Prior::without(&[name.to_owned()]);
        Some(Self::new(name, &material, 1, prior))
    }
}

/// The information of each candidate light about each material.
pub struct Prospects {
    candidates: usize,
    materials: Vec<Prospect>,
}

/// One material.
struct Prospect {
    subject: Arc<Subject>,
    /// About the prior's modes, per candidate.
    information: Vec<DMatrix<f64>>,
}

impl Prospect {
    /// Of the modes after images under these candidates.
    fn covariance(&self, chosen: &[usize]) -> DMatrix<f64> {
        let modes = self.subject.prior.modes().ncols();
        let mut precision = DMatrix::identity(modes, modes);
        for &light in chosen {
            precision += &self.information[light];
        }
        Cholesky::new(precision).map_or_else(|| DMatrix::identity(modes, modes), |c| c.inverse())
    }
}

/// The error that is expected of one material.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ExpectedError {
    /// The material.
    pub material: String,
    /// Environment error.
    pub error: f64,
    /// By what it differs at difference angles of each band alone, [`BANDS_DEG`].
    pub by_theta_d: [f64; BANDS],
}

/// A light that was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Index of the candidate.
    pub candidate: usize,
    /// Expected error with it and all before, geometric mean of the materials.
    pub error: f64,
}

impl Prospects {
    /// Traces the candidates, which are the scene's lights, for these materials, at least one.
    ///
    /// # Errors
    /// The scene's bodies cannot be cached.
    pub fn new(
        mut scene: Scene,
        subjects: &[Arc<Subject>],
        options: &PredictionOptions,
    ) -> Result<Self, PredictionError> {
        let lights = std::mem::take(&mut scene.lights);
        scene.falloffs.clear();
        let mixture = Mixture::grey(white()?, vec![1.0])?;
        let mut materials: Vec<Prospect> = subjects
            .iter()
            .map(|subject| Prospect {
                subject: subject.clone(),
                information: Vec::with_capacity(lights.len()),
            })
            .collect();
        for batch in lights.chunks(BATCH) {
            scene.lights = batch.to_vec();
            let traced = Traced::new(&scene, grid_of(&scene), options)?;
            let plain = traced.objective(options);
            for Prospect {
                subject,
                information,
            } in &mut materials
            {
                let material = Material::new(mixture.clone(), std::slice::from_ref(&subject.ln_f));
                let prior = &subject.prior;
                let model =
                    DiscrepancyModel::of_compared(&plain, &scene, &material, prior, options.seed);
                let objective = plain.with_discrepancy(&model);
                let weights = residual_weights(&objective, options);
                let of_lights = of_lights(&objective, prior, &model, &weights);
                information.extend(of_lights.into_iter().map(above_noise));
            }
        }
        Ok(Self {
            candidates: lights.len(),
            materials,
        })
    }

    /// Number of candidates.
    pub fn candidates(&self) -> usize {
        self.candidates
    }

    /// What is expected of each material after images under these candidates.
    pub fn by_material(&self, chosen: &[usize]) -> Vec<ExpectedError> {
        let of = |material: &Prospect| {
            let covariance = material.covariance(chosen);
            let subject = &material.subject;
            let error = |curvature: &DMatrix<f64>| curvature.dot(&covariance).max(0.0).sqrt();
            ExpectedError {
                material: subject.name.clone(),
                error: error(&subject.curvature),
                by_theta_d: subject.bands.each_ref().map(error),
            }
        };
        self.materials.iter().map(of).collect()
    }

    /// Their geometric mean.
    pub fn error(&self, chosen: &[usize]) -> f64 {
        let ln_error = |material: &Prospect| {
            let covariance = material.covariance(chosen);
            0.5 * material.subject.curvature.dot(&covariance).ln()
        };
        let sum: f64 = self.materials.iter().map(ln_error).sum();
        (sum / self.materials.len() as f64).exp()
    }

    /// Up to `count` candidates beyond those `taken`, best first: each is the one that
    /// leaves the least error together with all before it.
    pub fn greedy(&self, taken: &[usize], count: usize) -> Vec<Choice> {
        let mut chosen = taken.to_vec();
        let mut choices = Vec::new();
        while choices.len() < count {
            let left: Vec<Choice> = (0..self.candidates)
                .into_par_iter()
                .filter(|light| !chosen.contains(light))
                .map(|candidate| Choice {
                    candidate,
                    error: self.error(&[&chosen[..], &[candidate]].concat()),
                })
                .collect();
            // The first of equals.
            let better = |best: Choice, next: Choice| match next.error < best.error {
                true => next,
                false => best,
            };
            let Some(best) = left.into_iter().reduce(better) else {
                break;
            };
            chosen.push(best.candidate);
            choices.push(best);
        }
        choices
    }

    /// [`Self::greedy`] from nothing, or the first `count` candidates if those leave
    /// less: no greedy choice is promised to beat a given set, and the candidates come in
    /// an order that is good for every number of lights.
    pub fn best(&self, count: usize) -> Vec<Choice> {
        let greedy = self.greedy(&[], count);
        let planned: Vec<usize> = (0..count.min(self.candidates)).collect();
        match greedy.last() {
            Some(last) if self.error(&planned) < last.error => planned
                .iter()
                .map(|&candidate| Choice {
                    candidate,
                    error: self.error(&planned[..=candidate]),
                })
                .collect(),
            _ => greedy,
        }
    }
}

/// Why an error cannot be predicted.
#[derive(Debug, thiserror::Error)]
pub enum PredictionError {
    /// The paths.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// The material.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
}

/// The same view in [`RESOLUTION_PX`] pixels along its longer side at most: what a prediction needs.
pub fn coarse(mut scene: Scene) -> Scene {
    let camera = &mut scene.camera;
    let longer = camera.resolution_px.into_iter().max().unwrap_or(1);
    let scale = (RESOLUTION_PX as f64 / longer as f64).min(1.0);
    camera.point_spread_px *= scale;
    let fewer = |pixels: usize| ((pixels as f64 * scale).round() as usize).max(1);
    camera.resolution_px = camera.resolution_px.map(fewer);
    scene
}

/// The paths of a scene's images.
struct Traced {
    captured: Captured,
    direct: DirectMatrix,
    cache: Cache,
}

impl Traced {
    /// Over given cells of the scene's camera.
    fn new(
        scene: &Scene,
        grid: Grid,
        options: &PredictionOptions,
    ) -> Result<Self, PredictionError> {
        let captured = unknown_images(scene, grid);
        let (cells, white) = (&*captured.cells, white()?);
        let direct = DirectMatrix::new(scene, cells, &white, DIRECT_STRATA, options.seed);
        let paths = CacheOptions {
            samples_per_cell: options.samples_per_cell,
            max_reflections: options.max_reflections,
            seed: options.seed,
            ..CacheOptions::default()
        };
        let cache = Cache::trace(scene, cells, &white, &paths)?;
        Ok(Self {
            captured,
            direct,
            cache,
        })
    }

    fn objective(&self, options: &PredictionOptions) -> Objective<'_> {
        Objective::new(
            &self.cache,
            &self.direct,
            &self.captured,
            Channels::Shared,
            options.kernel,
            options.model_error,
        )
    }
}

/// The cells over which a scene's images are predicted.
fn grid_of(scene: &Scene) -> Grid {
    let options = CellOptions {
        budget: CELLS,
        ..CellOptions::default()
    };
    choose(scene, &options)
}

/// What the tables of ln f multiply.
fn white() -> Result<Arc<Dictionary>, BrdfError> {
    let white = vec![Atom::Lambertian { albedo: 1.0 }];
    Ok(Arc::new(Dictionary::new("white", white)?))
}

/// The weights of its mixture.
fn unit() -> [DVector<f64>; 1] {
    [DVector::from_element(1, 1.0)]
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

/// What each value weighs, scaled to the number of independent values. Values are weighed as in a
/// fit: by the cell's neighbours, since one whose paths missed the light would count as certain.
fn residual_weights(objective: &Objective<'_>, options: &PredictionOptions) -> ResidualWeights {
    let cells = objective.cells();
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
    let images = objective.modelled(&unit());
    images.iter().enumerate().map(of_light).collect()
}

/// Information of each light's image about the modes: sym(J_Aᵀ W J_B).
fn of_lights(
    objective: &Objective<'_>,
    prior: &Prior,
    model: &DiscrepancyModel,
    weights: &ResidualWeights,
) -> Vec<DMatrix<f64>> {
    let n = prior.modes().ncols();
    let sums = objective.accumulate(
        &unit(),
        weights,
        Some(prior.modes()),
        || vec![Products::zero(n); objective.lights()],
        |sums, value| {
            let direct = model
                .direct
                .by_modes(value.cell, value.light, value.channel);
            let [a, b] = value.by_modes.map(|indirect| -> Vec<f64> {
                let both = indirect.iter().zip(direct);
                both.map(|(&i, &d)| f64::from(i) + value.direct * f64::from(d))
                    .collect()
            });
            sums[value.light].add(value.weight, [&a, &b]);
        },
        |total, part| {
            for (sum, part) in total.iter_mut().zip(part) {
                sum.join(part);
            }
        },
    );
    sums.into_iter().map(Products::matrix).collect()
}

#[cfg(test)]
mod tests;
