//! Parameters of a model that are nearest to a BRDF.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::residuals::Target;
use super::{COUNT, LIMITS, Model, Parameters, ParametricBrdf, USUAL_IOR};
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::sphere::{LitSphere, SphereImage};
use crate::brdf::{Brdf, score};
use crate::least_squares::{Equations, Options, Problem, minimise};
use crate::progress::Progress;

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
    /// The model whose parameters these are.
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
const FUZZ: [usize; 3] = [12, 13, 14];
const FUZZ_ROUGHNESS: usize = 15;

/// Roughnesses from which a base is sought.
const START_ROUGHNESS: [f64; 3] = [0.15, 0.35, 0.65];
/// Metalness from which it is sought.
const START_METALNESS: [f64; 2] = [0.02, 0.9];
/// Pixels a side of the spheres by which candidates are chosen.
const SMALL_SPHERE: usize = 20;
/// A layer or a tint more must lower the sum of squares by this part,
const LEAST_GAIN: f64 = 0.03;
/// and the environment error by this much.
const LEAST_GAIN_OF_ERROR: f64 = 0.005;
/// Fibres of a colour that nobody would choose must lower it to this part, and below [`POOR`].
const GAIN_OF_STRANGE_FIBRES: f64 = 0.9;
/// By how much the channels of usual fibres, relative to the brightest, may be below the base's.
const HUE: f64 = 0.1;
/// Environment error of the best base above which OpenPBR's is another start.
const POOR: f64 = 0.25;
/// A diffuse material is sought darker and brighter than the nearest by its values.
const SHARES_OF_MATT: [f64; 8] = [0.4, 0.6, 0.8, 0.9, 1.1, 1.3, 1.7, 2.5];

const OPTIONS: Options = Options {
    rounds: 40,
    damping: 1e-2,
    least_relative_gain: 1e-4,
    least_gain: 1e-12,
};

/// Parameters that a fit may change, in groups that change alike.
type Free = Vec<Vec<usize>>;

fn each(parameters: &[usize]) -> Free {
    parameters.iter().map(|&k| vec![k]).collect()
}

/// The parameters of `model` whose ∛(f·cos θi) is nearest to that of `brdf`, over directions
/// up to θd = 80°, of several starts the one that is nearest by environment error too. Never farther
/// in that error than the nearest diffuse material. Layers (coat, fibres), tints of reflections
/// and, in glTF, an index of refraction that gain less than 3% are left out: what is neutral
/// stays neutral.
///
/// For glTF the base, which all programs show, is found first and alone; the extensions are
/// then fitted around it.
///
/// # Errors
/// A BRDF that is black or has undefined values.
pub fn fit(brdf: &dyn Brdf, model: Model) -> Result<Fitted, FitError> {
    fit_shown(brdf, model, false, &())
}

/// [`fit`] with every layer and tint that brings the model nearer, however little.
///
/// # Errors
/// As there.
pub fn closest(brdf: &dyn Brdf, model: Model) -> Result<Fitted, FitError> {
    fit_shown(brdf, model, true, &())
}

/// [`fit`], or [`closest`], with its progress: the starts of its searches.
///
/// # Errors
/// As there.
pub fn fit_shown(
    brdf: &dyn Brdf,
    model: Model,
    closest: bool,
    progress: &dyn Progress,
) -> Result<Fitted, FitError> {
    let least_gain = match closest {
        true => [0.0; 2],
        false => [LEAST_GAIN, LEAST_GAIN_OF_ERROR],
    };
    let target = Target::of(brdf);
    if !target.is_finite() {
        return Err(FitError::NotFinite);
    }
    if target.is_black() {
        return Err(FitError::Black);
    }
    let spheres = LitSphere::new(&EnvironmentMap::all(), SMALL_SPHERE);
    let truth = spheres.images(brdf);
    let search = Search {
        target: &target,
        model,
        spheres: &spheres,
        truth: &truth,
        least_gain,
        progress,
    };
    progress.begin("seeking the nearest material", Some(search.usual_starts()));
    let grounds = search.bases();
    let mut core = grounds[0];
    let found = search.with_layers(&grounds);
    let mut found = search.without_needless(search.with_tints(found));
    let matt = search.matt();
    if found.error > matt.error {
        (found, core) = (matt, matt);
        core.parameters.specular_color = [1.0; 3];
    }
    Ok(Fitted {
        model,
        parameters: found.parameters,
        core: match model {
            Model::Gltf => core.parameters,
            _ => found.parameters,
        },
        difference: (found.squares / target.len() as f64).sqrt(),
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

fn fuzzy(ground: &Parameters, tinted: bool) -> Parameters {
    let grey = ground.base_color.iter().sum::<f64>() / 3.0;
    let color = match tinted {
        true => ground.base_color,
        false => [grey; 3],
    };
    Parameters {
        fuzz: color.map(|value| 0.1 + 0.2 * value),
        fuzz_roughness: 0.4,
        ..*ground
    }
}

/// Whether fibres have a hue between none and the base's, as an artist would choose.
fn has_usual_fibres(parameters: &Parameters) -> bool {
    let relative = |color: [f64; 3]| {
        let brightest = color.into_iter().fold(1e-9, f64::max);
        color.map(|value| value / brightest)
    };
    let [fuzz, base] = [parameters.fuzz, parameters.base_color].map(relative);
    let mut pairs = fuzz.into_iter().zip(base);
    parameters.fuzz == [0.0; 3] || pairs.all(|(fuzz, base)| fuzz >= base - HUE)
}

/// A material and how far it is from the one that is sought.
#[derive(Clone, Copy, Debug)]
struct Found {
    parameters: Parameters,
    /// Sum of squares over the target.
    squares: f64,
    /// Environment error of small spheres.
    error: f64,
}

/// Fits of one model to one material.
struct Search<'a> {
    target: &'a Target,
    model: Model,
    spheres: &'a LitSphere,
    /// The material's, under each map.
    truth: &'a [SphereImage],
    /// By how much a layer or a tint more must lower the sum of squares, as a part, and the
    /// environment error.
    least_gain: [f64; 2],
    progress: &'a dyn Progress,
}

impl Search<'_> {
    /// Starts, those of the diffuse material included, unless the best base is poor.
    fn usual_starts(&self) -> usize {
        let bases = START_METALNESS.len() * START_ROUGHNESS.len();
        let matt = 1 + SHARES_OF_MATT.len();
        let tints = usize::from(self.target.is_tinted());
        // Of each ground: two coats, and fibres on it and on them.
        let layers = 2 + 3 * (1 + tints);
        match self.model {
            Model::Gltf => bases + 1 + layers + tints + 1 + matt,
            _ => bases + matt + 1 + 2 * layers + tints + matt,
        }
    }

    /// Whether more parameters have lowered both measures by enough.
    fn is_nearer(&self, found: &Found, fewer: &Found) -> bool {
        let [of_squares, of_error] = self.least_gain;
        let is_usual = self.least_gain == [0.0; 2] || has_usual_fibres(&found.parameters);
        let most = match is_usual {
            true => fewer.error - of_error,
            false => (GAIN_OF_STRANGE_FIBRES * fewer.error).min(POOR),
        };
        found.squares < (1.0 - of_squares) * fewer.squares && found.error < most
    }

    /// What of the base is free: all that programs show without extensions.
    fn base(&self) -> Free {
        let mut free = each(&BASE);
        free.extend(each(&[METALNESS, ROUGHNESS]));
        match self.model {
            Model::Gltf => return free,
            Model::OpenPbr => free.push(vec![DIFFUSE_ROUGHNESS]),
            Model::Principled => {}
        }
        free.extend([vec![IOR], SPECULAR.to_vec()]);
        free
    }

    /// Bases, the nearest first: from every start, and the plain diffuse one.
    fn bases(&self) -> Vec<Found> {
        let free = self.base();
        let mut bases = self.each_start_fitted(&starts(self.target), &free);
        if self.model != Model::Gltf {
            let matt = self.matt();
            bases.push(matt);
            bases.extend(self.each_start_fitted(&[matt.parameters], &free));
            sort(&mut bases);
        }
        if bases[0].error > POOR && self.model == Model::Principled {
            let open_pbr = Search {
                model: Model::OpenPbr,
                ..*self
            };
            let nearest = open_pbr.with_layers(&open_pbr.bases());
            bases.extend(self.each_start_fitted(&[nearest.parameters], &free));
            sort(&mut bases);
        }
        bases
    }

    /// The nearest diffuse material without an interface, by environment error.
    fn matt(&self) -> Found {
        let guess = self.target.diffuse_guess();
        let mut matt = Parameters {
            base_color: guess.map(|value| value.clamp(0.0, 0.95)),
            roughness: 1.0,
            ..Parameters::default()
        };
        match self.model {
            // Schlick's curve reflects at grazing incidence whatever the index.
            Model::Gltf => matt.specular_color = [0.0; 3],
            _ => matt.ior = 1.0,
        }
        let matt = self.each_start_fitted(&[matt], &each(&BASE))[0];
        let scaled = SHARES_OF_MATT.map(|share| {
            let base_color = matt
                .parameters
                .base_color
                .map(|value| (share * value).min(1.0));
            let parameters = Parameters {
                base_color,
                ..matt.parameters
            };
            self.each_start_fitted(&[parameters], &Free::new())[0]
        });
        let nearer = |best: Found, next: Found| if next.error < best.error { next } else { best };
        scaled.into_iter().fold(matt, nearer)
    }

    /// The nearest of a base alone and with a coat, fibres or both.
    fn with_layers(&self, bases: &[Found]) -> Found {
        let mut best = bases[0];
        let mut grounds: Vec<Parameters> = match self.model {
            Model::Gltf => vec![best.parameters],
            _ => bases.iter().take(2).map(|found| found.parameters).collect(),
        };
        if self.model != Model::Gltf && best.error > POOR {
            grounds.push(self.matt().parameters);
        }
        if self.model == Model::Gltf {
            best = self.nearer(best, &grounds, &self.all_of(&best.parameters, false));
        }
        let coat: Vec<Parameters> = grounds.iter().flat_map(coated).collect();
        best = self.nearer(best, &coat, &self.all_of(&coat[0], false));
        // Fibres of no colour; then, if the material has one, in it.
        for tints in [false, true]
            .into_iter()
            .take(1 + usize::from(self.target.is_tinted()))
        {
            for below in [&grounds, &coat] {
                let starts: Vec<Parameters> = below.iter().map(|p| fuzzy(p, tints)).collect();
                best = self.nearer(best, &starts, &self.all_of(&starts[0], tints));
            }
        }
        best
    }

    /// With tints of its reflections, where these are needed.
    fn with_tints(&self, plain: Found) -> Found {
        if !self.target.is_tinted() {
            return plain;
        }
        let start = plain.parameters;
        self.nearer(plain, &[start], &self.all_of(&start, true))
    }

    /// Without those extensions of glTF that change little.
    fn without_needless(&self, found: Found) -> Found {
        if self.model != Model::Gltf {
            return found;
        }
        let [r, g, b] = found.parameters.specular_color;
        let with = |specular_color: [f64; 3]| Parameters {
            ior: USUAL_IOR,
            specular_color,
            ..found.parameters
        };
        for start in [with([1.0; 3]), with([r, g, b])] {
            let mut free = self.all_of(&start, (r, g) != (g, b));
            free.retain(|group| {
                let is_specular = SPECULAR.contains(&group[0]);
                group[0] != IOR && !(is_specular && start.specular_color == [1.0; 3])
            });
            let simple = self.each_start_fitted(&[start], &free)[0];
            if !self.is_nearer(&found, &simple) {
                return simple;
            }
        }
        found
    }

    /// What is free in a material of these layers: in glTF, of the extensions. The channels of
    /// a tint are so one by one, or alike.
    fn all_of(&self, layers: &Parameters, tints: bool) -> Free {
        let tint = |channels: &[usize]| match tints {
            true => each(channels),
            false => vec![channels.to_vec()],
        };
        let mut free = match self.model {
            Model::Gltf => each(&[IOR]),
            _ => self.base(),
        };
        free.retain(|group| group[0] != SPECULAR[0]);
        free.extend(tint(&SPECULAR));
        if layers.coat_weight > 0.0 {
            free.extend(each(&COAT));
        }
        if layers.fuzz != [0.0; 3] {
            free.extend(tint(&FUZZ));
            free.push(vec![FUZZ_ROUGHNESS]);
        }
        free
    }

    /// Minima from each start, that of the least environment error first.
    fn each_start_fitted(&self, starts: &[Parameters], free: &Free) -> Vec<Found> {
        let of_start = |start: &Parameters| {
            let mut problem = Nearest {
                target: self.target,
                model: self.model,
                free,
            };
            let start = start.to_array();
            let point = match free.is_empty() {
                true => start,
                false => minimise(&mut problem, start, &OPTIONS).point,
            };
            let parameters = Parameters::from_array(point);
            let found = Found {
                parameters,
                squares: problem.cost(&point),
                error: self.environment_error(&parameters),
            };
            self.progress.advance(1);
            found
        };
        let mut found: Vec<Found> = starts.par_iter().map(of_start).collect();
        sort(&mut found);
        found
    }

    /// By small spheres.
    fn environment_error(&self, parameters: &Parameters) -> f64 {
        let model = ParametricBrdf::new(self.model, parameters);
        let images = self.spheres.images(&model);
        let pairs = images.iter().zip(self.truth);
        let errors = pairs.map(|(image, truth)| score::image_error(image, truth).all);
        errors.sum::<f64>() / self.truth.len() as f64
    }

    /// A minimum from these starts that is nearer than the best so far, or that.
    fn nearer(&self, best: Found, starts: &[Parameters], free: &Free) -> Found {
        let found = self.each_start_fitted(starts, free).into_iter();
        let mut nearer = found.filter(|found| self.is_nearer(found, &best));
        nearer.next().unwrap_or(best)
    }
}

/// By environment error, but first those whose differences are at most twice the least.
fn sort(found: &mut [Found]) {
    let squares = found.iter().map(|found| found.squares);
    let least = squares.fold(f64::INFINITY, f64::min);
    let key = |found: &Found| (found.squares > 4.0 * least, found.error);
    found.sort_by(|a, b| {
        let ((a_far, a), (b_far, b)) = (key(a), key(b));
        a_far.cmp(&b_far).then(a.total_cmp(&b))
    });
}

/// The problem that [`minimise`] solves, for some of the parameters.
struct Nearest<'a> {
    target: &'a Target,
    model: Model,
    free: &'a Free,
}

/// Step of the differences that stand for derivatives.
const DIFFERENCE: f64 = 1e-4;

impl Nearest<'_> {
    fn brdf(&self, at: &[f64; COUNT]) -> ParametricBrdf {
        ParametricBrdf::new(self.model, &Parameters::from_array(*at))
    }

    /// Derivative of the residuals by a group, taken towards the inside.
    fn column(
        &self,
        at: &[f64; COUNT],
        (brdf, here): (&ParametricBrdf, &[f64]),
        group: &[usize],
    ) -> Vec<f64> {
        let mut moved = *at;
        let is_high = |&k: &usize| at[k] + DIFFERENCE > LIMITS[k][1];
        let step = match group.iter().any(is_high) {
            true => -DIFFERENCE,
            false => DIFFERENCE,
        };
        group.iter().for_each(|&k| moved[k] += step);
        let moved = brdf.with(&Parameters::from_array(moved));
        let there = self.target.residuals(&moved);
        let pairs = there.iter().zip(here);
        pairs.map(|(there, here)| (here - there) / step).collect()
    }
}

impl Problem for Nearest<'_> {
    type Point = [f64; COUNT];

    fn linearise(&mut self, at: &Self::Point) -> Equations {
        let brdf = self.brdf(at);
        let here = self.target.residuals(&brdf);
        let column = |group: &Vec<usize>| self.column(at, (&brdf, &here), group);
        let columns: Vec<Vec<f64>> = self.free.iter().map(column).collect();
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
        for (i, group) in self.free.iter().enumerate() {
            let is_low = group.iter().any(|&k| at[k] <= LIMITS[k][0]);
            let is_high = group.iter().any(|&k| at[k] >= LIMITS[k][1]);
            let leaves = (is_low && right[i] < 0.0) || (is_high && right[i] > 0.0);
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
        let residuals = self.target.residuals(&self.brdf(at));
        residuals.iter().map(|r| r * r).sum()
    }

    fn moved(&self, from: &Self::Point, step: &DVector<f64>) -> Self::Point {
        let mut to = *from;
        for (group, step) in self.free.iter().zip(step) {
            for &k in group {
                to[k] = (to[k] + step).clamp(LIMITS[k][0], LIMITS[k][1]);
            }
        }
        to
    }
}

#[cfg(test)]
#[path = "fit_tests.rs"]
mod tests;
