//! Parameters of a model that are nearest to a BRDF.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::residuals::Target;
use super::{COUNT, LIMITS, Model, Parameters, ParametricBrdf};
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::{Brdf, score};
use crate::least_squares::{Equations, Options, Problem, minimise};

/// Why there is no fit.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum FitError {
    /// Some value is infinite or undefined.
    #[error("the BRDF has values that are no finite numbers")]
    NotFinite,
    /// Nothing is reflected.
    #[error("the BRDF reflects nothing")]
    Black,
}

/// A model's nearest material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    /// Whose conventions.
    pub model: Model,
    /// The parameters.
    pub parameters: Parameters,
    /// What programs show that ignore all extensions: glTF's base alone. For the other models
    /// the same as `parameters`.
    pub core: Parameters,
    /// Root mean square difference of ∛(f·cos θi), sr^(−1/3).
    pub difference: f64,
}

impl Fitted {
    /// The material.
    pub fn brdf(&self) -> ParametricBrdf {
        ParametricBrdf::new(self.model, &self.parameters)
    }

    /// The material without extensions.
    pub fn core_brdf(&self) -> ParametricBrdf {
        ParametricBrdf::new(self.model, &self.core)
    }
}

/// Positions in the array of parameters.
const BASE: [usize; 3] = [0, 1, 2];
const METALNESS: usize = 3;
const DIFFUSE_ROUGHNESS: usize = 4;
const ROUGHNESS: usize = 5;
const IOR: usize = 6;
const SPECULAR: [usize; 3] = [7, 8, 9];
const COAT: [usize; 2] = [10, 11];
const FUZZ: [usize; 4] = [12, 13, 14, 15];

/// Roughnesses from which a base is sought.
const START_ROUGHNESS: [f64; 3] = [0.15, 0.35, 0.65];
/// Metalness from which it is sought.
const START_METALNESS: [f64; 2] = [0.02, 0.9];
/// Pixels a side of the spheres by which candidates are chosen.
const SMALL_SPHERE: usize = 20;
/// A layer more must lower the sum of squares by this part.
const LEAST_GAIN: f64 = 0.03;

const OPTIONS: Options = Options {
    rounds: 40,
    damping: 1e-2,
    least_relative_gain: 1e-4,
    least_gain: 1e-12,
};

/// The parameters of `model` whose ∛(f·cos θi) is nearest to that of `brdf`, over directions
/// up to θd = 80°. Several starts; layers (coat, fibres) that gain less than 3% are left out.
///
/// For glTF the base, which all programs show, is found first and alone; the extensions are
/// then fitted around it.
///
/// # Errors
/// A BRDF that is black or has undefined values.
pub fn fit(brdf: &dyn Brdf, model: Model) -> Result<Fitted, FitError> {
    let target = Target::of(brdf);
    if !target.is_finite() {
        return Err(FitError::NotFinite);
    }
    if target.is_black() {
        return Err(FitError::Black);
    }
    let maps = EnvironmentMap::all();
    let search = Search {
        target: &target,
        model,
        brdf,
        maps: &maps,
    };
    let mut base: Vec<usize> = BASE.into_iter().chain([METALNESS, ROUGHNESS]).collect();
    let mut extensions: Vec<usize> = vec![IOR];
    extensions.extend(SPECULAR);
    if model != Model::Gltf {
        base.append(&mut extensions);
    }
    if model == Model::OpenPbr {
        base.push(DIFFUSE_ROUGHNESS);
    }

    // The base from every start; the layers on the best two of different kinds.
    let plain = search.each_start_fitted(&starts(&target), &base);
    let core = plain[0].1;
    let kinds = match model {
        Model::Gltf => 1,
        _ => 2,
    };
    let grounds: Vec<Parameters> = plain.iter().take(kinds).map(|(_, found)| *found).collect();
    let layered = |layers: [bool; 2], starts: &dyn Fn(&Parameters) -> Vec<Parameters>| {
        let [coat, fuzz] = layers;
        let mut free = match model {
            Model::Gltf => extensions.clone(),
            _ => base.clone(),
        };
        free.extend(COAT.into_iter().filter(|_| coat));
        free.extend(FUZZ.into_iter().filter(|_| fuzz));
        let starts: Vec<Parameters> = grounds.iter().flat_map(starts).collect();
        search.each_start_fitted(&starts, &free)[0]
    };
    let mut found = match model {
        Model::Gltf => layered([false, false], &|ground| vec![*ground]),
        _ => plain[0],
    };
    let with = [
        layered([true, false], &coated),
        layered([false, true], &|ground| vec![fuzzy(ground)]),
        layered([true, true], &|ground| {
            coated(ground).iter().map(fuzzy).collect()
        }),
    ];
    // A layer stays that lowers both measures.
    let mut error = search.environment_error(&found.1);
    for candidate in with {
        if candidate.0 < (1.0 - LEAST_GAIN) * found.0 {
            let with_layer = search.environment_error(&candidate.1);
            if with_layer < error {
                (found, error) = (candidate, with_layer);
            }
        }
    }
    Ok(Fitted {
        model,
        parameters: found.1,
        core: match model {
            Model::Gltf => core,
            _ => found.1,
        },
        difference: (found.0 / target.len() as f64).sqrt(),
    })
}

/// Bases to begin with.
fn starts(target: &Target) -> Vec<Parameters> {
    let guess = target.diffuse_guess().map(|value| value.clamp(0.01, 0.95));
    let brightest = guess.into_iter().fold(0.01, f64::max);
    let start = |metalness: f64, roughness: f64| Parameters {
        // Metal of the same hue, bright.
        base_color: guess.map(|value| match metalness > 0.5 {
            true => 0.7 * value / brightest,
            false => value,
        }),
        metalness,
        roughness,
        ..Parameters::default()
    };
    START_METALNESS
        .into_iter()
        .flat_map(|metalness| START_ROUGHNESS.map(|roughness| start(metalness, roughness)))
        .collect()
}

/// A coat that is sharper than the base, or as rough.
fn coated(ground: &Parameters) -> Vec<Parameters> {
    let with = |coat_roughness: f64| Parameters {
        coat_weight: 0.3,
        coat_roughness,
        ..*ground
    };
    vec![with(0.12), with((0.6 * ground.roughness).max(0.15))]
}

fn fuzzy(ground: &Parameters) -> Parameters {
    Parameters {
        fuzz: ground.base_color.map(|value| 0.1 + 0.2 * value),
        fuzz_roughness: 0.4,
        ..*ground
    }
}

/// Fits of one model to one material.
struct Search<'a> {
    target: &'a Target,
    model: Model,
    brdf: &'a dyn Brdf,
    maps: &'a [EnvironmentMap],
}

impl Search<'_> {
    /// By small spheres.
    fn environment_error(&self, parameters: &Parameters) -> f64 {
        let model = ParametricBrdf::new(self.model, parameters);
        let error = score::environment_error(&model, self.brdf, self.maps, SMALL_SPHERE);
        error.mean.all
    }

    /// Minima from each start, with their sums of squares, the least first.
    fn each_start_fitted(&self, starts: &[Parameters], free: &[usize]) -> Vec<(f64, Parameters)> {
        let mut found: Vec<(f64, Parameters)> = starts
            .par_iter()
            .map(|start| {
                let mut problem = Nearest {
                    target: self.target,
                    model: self.model,
                    free,
                };
                let point = minimise(&mut problem, start.to_array(), &OPTIONS).point;
                (problem.cost(&point), Parameters::from_array(point))
            })
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found
    }
}

/// The problem that [`minimise`] solves, for some of the parameters.
struct Nearest<'a> {
    target: &'a Target,
    model: Model,
    free: &'a [usize],
}

/// Step of the differences that stand for derivatives.
const DIFFERENCE: f64 = 1e-4;

impl Nearest<'_> {
    fn residuals(&self, at: &[f64; COUNT]) -> Vec<f64> {
        let parameters = Parameters::from_array(*at);
        self.target.residuals(self.model, &parameters)
    }

    /// Derivative of the residuals by one parameter, taken towards the inside.
    fn column(&self, at: &[f64; COUNT], here: &[f64], parameter: usize) -> Vec<f64> {
        let mut moved = *at;
        let step = match at[parameter] + DIFFERENCE > LIMITS[parameter][1] {
            true => -DIFFERENCE,
            false => DIFFERENCE,
        };
        moved[parameter] += step;
        let there = self.residuals(&moved);
        let pairs = there.iter().zip(here);
        pairs.map(|(there, here)| (here - there) / step).collect()
    }
}

impl Problem for Nearest<'_> {
    type Point = [f64; COUNT];

    fn linearise(&mut self, at: &Self::Point) -> Equations {
        let here = self.residuals(at);
        let columns = self.free.iter();
        let columns: Vec<Vec<f64>> = columns.map(|&k| self.column(at, &here, k)).collect();
        let n = columns.len();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut normal = DMatrix::from_fn(n, n, |i, j| match i <= j {
            true => dot(&columns[i], &columns[j]),
            false => 0.0,
        });
        let mut right = DVector::from_fn(n, |i, _| dot(&columns[i], &here));
        for i in 0..n {
            for j in 0..i {
                normal[(i, j)] = normal[(j, i)];
            }
        }
        // What would leave the limits stays, and what changes nothing too.
        for (i, &k) in self.free.iter().enumerate() {
            let [low, high] = LIMITS[k];
            let leaves = (at[k] <= low && right[i] < 0.0) || (at[k] >= high && right[i] > 0.0);
            if leaves {
                for j in 0..n {
                    normal[(i, j)] = 0.0;
                    normal[(j, i)] = 0.0;
                }
                right[i] = 0.0;
            }
            normal[(i, i)] += 1e-9 * here.len() as f64;
        }
        Equations {
            normal,
            right,
            cost: dot(&here, &here),
        }
    }

    fn cost(&self, at: &Self::Point) -> f64 {
        self.residuals(at).iter().map(|r| r * r).sum()
    }

    fn moved(&self, from: &Self::Point, step: &DVector<f64>) -> Self::Point {
        let mut to = *from;
        for (&k, step) in self.free.iter().zip(step) {
            to[k] = (to[k] + step).clamp(LIMITS[k][0], LIMITS[k][1]);
        }
        to
    }
}

#[cfg(test)]
#[path = "fit_tests.rs"]
mod tests;
