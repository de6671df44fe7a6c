//! What a dictionary can say about a known BRDF: the reference projection, and the
//! floor of each score.
//!
//! The *reference projection* minimises the squared cube-root error over the cells of
//! [`score`] (squared error of f itself is misled by mirror peaks). The *floor* of
//! a score is the minimum of that score itself over the simplex: no estimate of
//! the dictionary can do better.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::brdf::environment::EnvironmentMap;
use crate::brdf::ggx::Cosines;
use crate::brdf::score::{self, Cell, EnvironmentError, PerChannel};
use crate::brdf::sphere::{SphereImage, sphere_images, sphere_matrices};
use crate::brdf::{Brdf, BrdfError, Dictionary, Mixture};
use crate::outer_products::Squares;
use crate::simplex::{Quadratic, SimplexError};

/// Azimuths of the cells a projection is fitted on (scores use MERL's 180).
pub const FIT_AZIMUTHS: usize = 36;

/// Why a projection failed.
#[derive(Debug, thiserror::Error)]
pub enum ProjectionError {
    /// The quadratic subproblem.
    #[error(transparent)]
    Simplex(#[from] SimplexError),
    /// The weights found are no mixture.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// The truth is zero (or not finite) everywhere in a channel.
    #[error("channel {channel} of the BRDF is black or not finite")]
    Black {
        /// R, G or B.
        channel: &'static str,
    },
}

const CHANNELS: [&str; 3] = ["R", "G", "B"];
/// Rows summed by one task; part of the result's rounding, so fixed.
const CHUNK: usize = 2048;

/// The atoms of a dictionary at the cells of the BRDF error, with their cosine:
/// what projections of several BRDFs share.
pub struct CellMatrix {
    dictionary: Arc<Dictionary>,
    cells: Vec<Cell>,
    /// cos θi·f per cell and atom, 1/sr, atoms fastest.
    values: Vec<f32>,
}

/// What the fit of one channel minimises.
#[derive(Clone, Copy, PartialEq)]
enum Loss {
    /// Σ w·(∛a − ∛b)².
    Squared,
    /// Σ w·|∛a − ∛b|, by reweighting.
    Absolute,
}

impl CellMatrix {
    /// Evaluates all atoms at the cells of [`score::cells`]`(n_phi)`.
    pub fn new(dictionary: Arc<Dictionary>, n_phi: usize) -> Self {
        Self::of_cells(dictionary, score::cells(n_phi))
    }

    /// Evaluates all atoms at these cells.
    pub fn of_cells(dictionary: Arc<Dictionary>, cells: Vec<Cell>) -> Self {
        let evaluator = dictionary.evaluator();
        let n = dictionary.len();
        let mut values = vec![0.0f32; cells.len() * n];
        values
            .par_chunks_mut(n)
            .zip(&cells)
            .for_each(|(values, cell)| {
                let (i, o) = (cell.to_light.to_array(), cell.to_viewer.to_array());
                if let Some(at) = Cosines::new(i, o) {
                    evaluator.eval(&at, values);
                    for value in values {
                        *value *= at.cos_i;
                    }
                }
            });
        Self {
            dictionary,
            cells,
            values,
        }
    }

    /// The reference projection of `truth`.
    pub fn reference_projection(&self, truth: &dyn Brdf) -> Result<Mixture, ProjectionError> {
        self.per_channel(truth, |_, b| {
            let uniform = DVector::from_element(self.n(), 1.0 / self.n() as f64);
            self.fit_cube_root(b, uniform, Loss::Squared)
        })
    }

    /// The mixture of least relative BRDF error.
    pub fn relative_floor(&self, truth: &dyn Brdf) -> Result<Mixture, ProjectionError> {
        self.per_channel(truth, |_, b| {
            let quadratic = self.accumulate(
                |row, _| (f64::from(self.cells[row].solid_angle), 1.0, b[row]),
                None,
            );
            Ok(quadratic.minimise()?.x)
        })
    }

    /// The mixture of least cube-root error that reweighting finds, starting at the
    /// reference projection (the problem is not convex).
    pub fn cube_root_floor(&self, truth: &dyn Brdf) -> Result<Mixture, ProjectionError> {
        self.cube_root_floor_from(&self.reference_projection(truth)?, truth)
    }

    /// [`Self::cube_root_floor`] where the reference projection is known already.
    pub fn cube_root_floor_from(
        &self,
        reference: &Mixture,
        truth: &dyn Brdf,
    ) -> Result<Mixture, ProjectionError> {
        self.per_channel(truth, |c, b| {
            let start = DVector::from_column_slice(&reference.weights()[c]);
            // Leave the boundary, where reweighting cannot see.
            let start = 0.999 * start + DVector::from_element(self.n(), 1e-3 / self.n() as f64);
            self.fit_cube_root(b, start, Loss::Absolute)
        })
    }

    fn n(&self) -> usize {
        self.dictionary.len()
    }

    fn per_channel(
        &self,
        truth: &dyn Brdf,
        fit: impl Fn(usize, &[f64]) -> Result<DVector<f64>, ProjectionError>,
    ) -> Result<Mixture, ProjectionError> {
        let target = score::cosine_weighted(truth, &self.cells);
        let mut weights: [Vec<f64>; 3] = Default::default();
        for (c, weights) in weights.iter_mut().enumerate() {
            let b: Vec<f64> = target.iter().map(|rgb| f64::from(rgb[c])).collect();
            let sum: f64 = b.iter().sum();
            if !(sum > 0.0 && sum.is_finite()) {
                return Err(ProjectionError::Black {
                    channel: CHANNELS[c],
                });
            }
            *weights = fit(c, &b)?.as_slice().to_vec();
        }
        Ok(Mixture::new(self.dictionary.clone(), weights)?)
    }

    /// Sum over the rows of ½·w·(s·(A x) − t)², with (w, s, t) given by row and,
    /// where `x` is given, by its model value; summed in a fixed order.
    fn accumulate(
        &self,
        row: impl Fn(usize, f64) -> (f64, f64, f64) + Sync,
        x: Option<&DVector<f64>>,
    ) -> Quadratic {
        let n = self.n();
        let parts: Vec<Quadratic> = self
            .values
            .par_chunks(CHUNK * n)
            .enumerate()
            .map(|(chunk, values)| {
                let mut part = Quadratic::zero(n);
                let mut squares = Squares::zero(n);
                let mut wide = vec![0.0f64; n];
                for (k, values) in values.chunks_exact(n).enumerate() {
                    for (wide, value) in wide.iter_mut().zip(values) {
                        *wide = f64::from(*value);
                    }
                    let model = x.map_or(0.0, |x| dot(&wide, x.as_slice()));
                    let (w, s, t) = row(chunk * CHUNK + k, model);
                    let wst = w * s * t;
                    squares.add(w * s * s, &wide);
                    for (g, value) in part.g.iter_mut().zip(&wide) {
                        *g += wst * value;
                    }
                    part.c += 0.5 * w * t * t;
                }
                part.h = squares.matrix();
                part
            })
            .collect();
        let mut sum = Quadratic::zero(n);
        for part in &parts {
            sum.add_scaled(1.0, part);
        }
        sum
    }

    fn model(&self, x: &DVector<f64>) -> Vec<f64> {
        self.values
            .par_chunks_exact(self.n())
            .map(|row| row.iter().zip(x).map(|(a, x)| f64::from(*a) * x).sum())
            .collect()
    }

    /// Gauss–Newton with the exact simplex step and halving of the step where the loss
    /// does not fall.
    fn fit_cube_root(
        &self,
        b: &[f64],
        start: DVector<f64>,
        loss: Loss,
    ) -> Result<DVector<f64>, ProjectionError> {
        let mean = b.iter().sum::<f64>() / b.len() as f64;
        // Below this the cube root's slope would let dark cells rule the step.
        let smallest = 1e-6 * mean;
        let roots: Vec<f64> = b.iter().map(|b| b.cbrt()).collect();
        // |r| is smoothed below a thousandth of a typical root.
        let corner = 1e-3 * mean.cbrt();
        let value = |x: &DVector<f64>| -> f64 {
            let model = self.model(x);
            let part = |chunk: usize| -> f64 {
                let rows = chunk * CHUNK..(chunk * CHUNK + CHUNK).min(model.len());
                rows.map(|row| {
                    let r = model[row].max(0.0).cbrt() - roots[row];
                    let magnitude = match loss {
                        Loss::Squared => r * r,
                        Loss::Absolute => (r * r + corner * corner).sqrt(),
                    };
                    f64::from(self.cells[row].solid_angle) * magnitude
                })
                .sum()
            };
            let parts: Vec<f64> = (0..model.len().div_ceil(CHUNK))
                .into_par_iter()
                .map(part)
                .collect();
            parts.iter().sum()
        };
        let mut x = start;
        let mut current = value(&x);
        // Reweighting creeps; its last 1e-4 is not worth its time.
        let enough = match loss {
            Loss::Squared => 1e-6,
            Loss::Absolute => 1e-4,
        };
        for _ in 0..40 {
            let quadratic = self.accumulate(
                |row, model| {
                    let a = model.max(smallest);
                    let root = a.cbrt();
                    // r(x') ≈ r + slope·(A x' − a)
                    let slope = root / (3.0 * a);
                    let r = root - roots[row];
                    let mut weight = f64::from(self.cells[row].solid_angle);
                    if loss == Loss::Absolute {
                        weight /= (r * r + corner * corner).sqrt();
                    }
                    (weight, slope, slope * model - r)
                },
                Some(&x),
            );
            let target = quadratic.minimise()?.x;
            let mut step = 1.0;
            let mut next = None;
            while step > 1e-3 {
                let candidate = &x + step * (&target - &x);
                let reached = value(&candidate);
                if reached < current {
                    next = Some((candidate, reached));
                    break;
                }
                step *= 0.5;
            }
            let Some((candidate, reached)) = next else {
                break;
            };
            let gain = (current - reached) / current.max(f64::MIN_POSITIVE);
            (x, current) = (candidate, reached);
            if gain < enough {
                break;
            }
        }
        Ok(x)
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The sphere images of all atoms under several maps: what environment floors of several
/// BRDFs share.
pub struct EnvironmentMatrix<'a> {
    dictionary: Arc<Dictionary>,
    maps: &'a [EnvironmentMap],
    size: usize,
    /// Per map and channel, pixels × atoms.
    matrices: Vec<crate::brdf::sphere::SphereMatrix>,
    /// Per map and channel, AᵀA.
    grams: Vec<[DMatrix<f64>; 3]>,
}

impl<'a> EnvironmentMatrix<'a> {
    /// Renders every atom under every map, `size` × `size`.
    pub fn new(dictionary: Arc<Dictionary>, maps: &'a [EnvironmentMap], size: usize) -> Self {
        Self::with_images(dictionary, maps, size, &[]).0
    }

    /// [`Self::new`] and, in the same pass, the spheres of some BRDFs: per map one image of
    /// each.
    pub fn with_images(
        dictionary: Arc<Dictionary>,
        maps: &'a [EnvironmentMap],
        size: usize,
        brdfs: &[&dyn Brdf],
    ) -> (Self, Vec<Vec<SphereImage>>) {
        let (matrices, images) = sphere_matrices(&dictionary, maps, size, brdfs);
        let grams = matrices
            .iter()
            .map(|matrix| [0, 1, 2].map(|c| matrix.channels[c].tr_mul(&matrix.channels[c])))
            .collect();
        let matrix = Self {
            dictionary,
            maps,
            size,
            matrices,
            grams,
        };
        (matrix, images)
    }

    /// The least environment error of any mixture, and that mixture.
    pub fn floor(&self, truth: &dyn Brdf) -> Result<(EnvironmentError, Mixture), ProjectionError> {
        self.of(truth).floor()
    }

    /// Its dictionary.
    pub fn dictionary(&self) -> &Arc<Dictionary> {
        &self.dictionary
    }

    /// The environment error of `estimate` against `truth`; a mixture of this dictionary is not
    /// rendered for it.
    pub fn error(&self, estimate: &dyn Brdf, truth: &dyn Brdf) -> EnvironmentError {
        match estimate.as_mixture() {
            Some(mixture) if *mixture.dictionary() == self.dictionary => {
                self.of(truth).error(mixture)
            }
            _ => score::environment_error(estimate, truth, self.maps, self.size),
        }
    }

    /// Renders `truth` once for any number of comparisons.
    pub fn of(&self, truth: &dyn Brdf) -> EnvironmentTruth<'_, 'a> {
        let images = sphere_images(&[truth], self.maps, self.size);
        self.of_images(images.iter().map(|under| &under[0]))
    }

    /// [`Self::of`] from the truth's images, one per map.
    pub fn of_images<'i>(
        &self,
        images: impl IntoIterator<Item = &'i SphereImage>,
    ) -> EnvironmentTruth<'_, 'a> {
        EnvironmentTruth {
            targets: self.targets(images),
            matrix: self,
        }
    }

    /// G such that wᵀGw is the mean square radiance of the mixture w over the pixels of
    /// all spheres, in one channel: atoms × atoms.
    pub fn mean_square(&self, channel: usize) -> DMatrix<f64> {
        let atoms = self.dictionary.len();
        let sum = self.grams.iter().map(|of_map| &of_map[channel]);
        let sum = sum.fold(DMatrix::zeros(atoms, atoms), |sum, gram| sum + gram);
        let pixels: usize = self.matrices.iter().map(|m| m.pixels.len()).sum();
        sum / pixels as f64
    }

    fn targets<'i>(&self, images: impl IntoIterator<Item = &'i SphereImage>) -> Vec<Target> {
        images
            .into_iter()
            .zip(&self.matrices)
            .zip(&self.grams)
            .map(|((image, matrix), grams)| {
                let quadratics = [0, 1, 2].map(|c| {
                    let b = matrix.column_of(image, c);
                    Quadratic {
                        h: grams[c].clone(),
                        g: matrix.channels[c].tr_mul(&b),
                        c: 0.5 * b.norm_squared(),
                    }
                });
                Target {
                    reference2: quadratics.iter().map(|q| 2.0 * q.c).sum(),
                    quadratics,
                }
            })
            .collect()
    }
}

/// A truth under all maps, beside a dictionary's spheres.
pub struct EnvironmentTruth<'m, 'a> {
    matrix: &'m EnvironmentMatrix<'a>,
    targets: Vec<Target>,
}

impl EnvironmentTruth<'_, '_> {
    /// The least environment error of any mixture, and that mixture: the mean of
    /// norms, by reweighted least squares.
    pub fn floor(&self) -> Result<(EnvironmentError, Mixture), ProjectionError> {
        let mut pull = vec![1.0; self.matrix.maps.len()];
        let mut best: Option<(f64, [DVector<f64>; 3])> = None;
        for _ in 0..40 {
            let mut weights: [DVector<f64>; 3] = Default::default();
            for (c, weights) in weights.iter_mut().enumerate() {
                let mut sum = Quadratic::zero(self.matrix.dictionary.len());
                for (map, pull) in self.targets.iter().zip(&pull) {
                    sum.add_scaled(pull / map.reference2, &map.quadratics[c]);
                }
                *weights = sum.minimise()?.x;
            }
            let errors: Vec<f64> = self.targets.iter().map(|map| map.error(&weights)).collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            let gain = best.as_ref().map_or(f64::INFINITY, |(b, _)| b - mean);
            if gain > 0.0 {
                best = Some((mean, weights));
            }
            if gain < 1e-7 * mean {
                break;
            }
            // ∇‖r‖ = ∇½‖r‖²/‖r‖.
            for (pull, error) in pull.iter_mut().zip(&errors) {
                *pull = 1.0 / error.max(1e-9);
            }
        }
        let (_, weights) = best.ok_or(SimplexError::NotConvex)?;
        let mixture = Mixture::new(
            self.matrix.dictionary.clone(),
            weights.map(|w| w.as_slice().to_vec()),
        )?;
        Ok((self.error(&mixture), mixture))
    }

    /// The environment error of a mixture of the dictionary.
    pub fn error(&self, mixture: &Mixture) -> EnvironmentError {
        let weights = mixture
            .weights()
            .each_ref()
            .map(|w| DVector::from_column_slice(w));
        let errors: Vec<PerChannel> = self
            .targets
            .iter()
            .map(|map| PerChannel {
                all: map.error(&weights),
                channels: [0, 1, 2].map(|c| {
                    let q = &map.quadratics[c];
                    (q.value(&weights[c]).max(0.0) / q.c).sqrt()
                }),
            })
            .collect();
        score::summarise(self.matrix.maps, &errors)
    }
}

/// ½‖A x − b‖² of each channel under one map.
struct Target {
    quadratics: [Quadratic; 3],
    /// ‖b‖² over the channels.
    reference2: f64,
}

impl Target {
    fn error(&self, weights: &[DVector<f64>; 3]) -> f64 {
        let sum: f64 = (0..3)
            .map(|c| 2.0 * self.quadratics[c].value(&weights[c]).max(0.0))
            .sum();
        (sum / self.reference2).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::nbrdf::NeuralBrdf;

    fn inside(dictionary: &Arc<Dictionary>) -> Mixture {
        let weights = [(3, 0.2), (22, 0.3), (14, 0.1)].map(|(atom, weight)| {
            let mut w = vec![0.0; dictionary.len()];
            (w[atom], w[40], w[41]) = (weight, 0.4, 0.6 - weight);
            w
        });
        Mixture::new(dictionary.clone(), weights).unwrap()
    }

    #[test]
    fn a_mixture_projects_onto_itself() {
        let dictionary = Arc::new(Dictionary::paper42());
        let truth = inside(&dictionary);
        let matrix = CellMatrix::new(dictionary.clone(), 3);
        let cells = score::cells(3);
        for (name, projected) in [
            ("reference", matrix.reference_projection(&truth).unwrap()),
            ("relative", matrix.relative_floor(&truth).unwrap()),
            ("cube root", matrix.cube_root_floor(&truth).unwrap()),
        ] {
            let errors = score::brdf_errors(&projected, &truth, &cells);
            assert!(errors.cube_root.all < 3e-3, "{name}: {errors:?}");
        }
        let maps = [EnvironmentMap::embedded("studio").unwrap()];
        let spheres = EnvironmentMatrix::new(dictionary, &maps, 16);
        let (floor, _) = spheres.floor(&truth).unwrap();
        assert!(floor.mean.all < 1e-3, "{floor:?}");
    }

    #[test]
    fn every_floor_is_below_the_others_at_its_own_score() {
        let dictionary = Arc::new(Dictionary::paper42());
        let truth = NeuralBrdf::named("alum-bronze").unwrap();
        let matrix = CellMatrix::new(dictionary.clone(), 4);
        let cells = score::cells(4);
        let mixtures = [
            matrix.reference_projection(&truth).unwrap(),
            matrix.relative_floor(&truth).unwrap(),
            matrix.cube_root_floor(&truth).unwrap(),
        ];
        let [reference, relative, absolute] = mixtures
            .each_ref()
            .map(|m| score::brdf_errors(m, &truth, &cells));
        assert!(relative.relative.all <= reference.relative.all.min(absolute.relative.all));
        assert!(absolute.cube_root.all <= reference.cube_root.all.min(relative.cube_root.all));
        let maps = [EnvironmentMap::embedded("city").unwrap()];
        let spheres = EnvironmentMatrix::new(dictionary, &maps, 12);
        let (floor, mixture) = spheres.floor(&truth).unwrap();
        for other in &mixtures {
            assert!(floor.mean.all <= spheres.error(other, &truth).mean.all + 1e-9);
        }
        // The shortcut through the Gram matrix is the rendered error.
        let rendered = score::environment_error(&mixture, &truth, &maps, 12);
        assert!(
            (rendered.mean.all - floor.mean.all).abs() < 1e-4,
            "{rendered:?} {floor:?}"
        );
    }

    #[test]
    fn a_black_channel_is_an_error() {
        struct Red;
        impl Brdf for Red {
            fn eval(&self, _: glam::Vec3, _: glam::Vec3) -> [f32; 3] {
                [0.1, 0.0, 0.0]
            }
        }
        let matrix = CellMatrix::new(Arc::new(Dictionary::paper42()), 2);
        let error = matrix.reference_projection(&Red).unwrap_err();
        assert_eq!(
            error.to_string(),
            "channel G of the BRDF is black or not finite"
        );
    }
}
