//! Normal equations of the pose from small patches of the images.
//!
//! Within a patch every region's radiance is a plane of its own, lit ones with a term
//! in the cosine to the light in addition. These coefficients stand for whatever the
//! material does and are eliminated; the pose is determined by where regions meet:
//! outline, creases, edges of cast shadows.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::regions::{Grid, Part, is_lit};
use crate::inverse::nuisance::Parameter;

/// Pixels along a patch's side.
pub const SIDE: usize = 8;
/// Pixels around a patch that the blur brings in.
pub const HALO: usize = 3;
/// Variance of the blur before the images, and its deviation, square pixels.
pub const BLUR_PX2: [f64; 2] = [0.2, 0.5];
/// Largest variance of the blur, square pixels: three steps of a half.
pub const LARGEST_BLUR_PX2: f64 = 1.5;
/// Regions of which a patch shows less than this many pixels have one constant radiance.
const FEW_PX: f32 = 6.0;
/// A patch has an edge where two regions show at least this many pixels.
const LEAST_PX: f32 = 4.0;

/// One light's image: grey radiance, and the reciprocal of its variance (0: not used).
pub struct Target {
    /// Mean of the channels.
    pub mean: Vec<f64>,
    /// Weight of each pixel.
    pub weight: Vec<f64>,
}

/// Regions of all pixels, `[pixel][light]`.
pub type Parts = Vec<Vec<Vec<Part>>>;

/// Two scenes that differ by a step in each direction.
pub struct Pair {
    /// Which parameters the step is in: one of the pose, or one of each light.
    pub parameters: Vec<usize>,
    /// Regions at plus and minus.
    pub parts: [Parts; 2],
    /// From one to the other.
    pub across: f64,
}

/// Normal equations of one patch. Parameters are those of pose and lights, then the
/// variance of the blur.
#[derive(Clone)]
pub struct PatchEquations {
    /// First pixel of the grid: column, row.
    pub at: [usize; 2],
    /// JᵀWJ.
    pub information: DMatrix<f64>,
    /// JᵀWr.
    pub score: DVector<f64>,
    /// Squared residuals over noise, and their degrees of freedom.
    pub chi2: [f64; 2],
    /// The same if the patch were one region.
    pub chi2_plain: f64,
    /// Each light's weight, at most 1: residuals beyond the noise lower it.
    pub weights: Vec<f64>,
}

/// What the elimination of the blur leaves.
pub struct Eliminated {
    /// Of all parameters, P × P.
    pub information: DMatrix<f64>,
    /// With the blur, P.
    pub to_blur: DVector<f64>,
    /// Of the blur, with its prior.
    pub blur_information: f64,
}

impl Eliminated {
    /// Of all patches, for `n` parameters besides the blur.
    pub fn new(patches: &[PatchEquations], n: usize) -> Self {
        let mut all = DMatrix::zeros(n + 1, n + 1);
        for patch in patches {
            all += &patch.information;
        }
        let to_blur = all.view((0, n), (n, 1)).column(0).into_owned();
        let blur_information = all[(n, n)] + BLUR_PX2[1].powi(-2);
        let own = all.view((0, 0), (n, n)) - &to_blur * to_blur.transpose() / blur_information;
        Self {
            information: 0.5 * (&own + own.transpose()),
            to_blur,
            blur_information,
        }
    }

    /// A patch's score, with what the blur would take of it taken away.
    pub fn score(&self, patch: &PatchEquations) -> DVector<f64> {
        let n = self.to_blur.len();
        patch.score.rows(0, n) - &self.to_blur * (patch.score[n] / self.blur_information)
    }
}

/// First pixels of the patches in which regions meet, for at least one light.
pub fn with_edges(grid: Grid, parts: &Parts) -> Vec<[usize; 2]> {
    let starts = |n: usize| (HALO..(n + 1).saturating_sub(SIDE + HALO)).step_by(SIDE);
    starts(grid.height)
        .flat_map(|y| starts(grid.width).map(move |x| [x, y]))
        .filter(|&at| {
            let lights = parts.first().map_or(0, Vec::len);
            (0..lights).any(|light| {
                let seen = labels(grid, parts, light, at);
                seen.iter().filter(|(_, px)| *px >= LEAST_PX).count() > 1
            })
        })
        .collect()
}

/// The pixels that patches need, with what the blur brings in.
pub fn needed(grid: Grid, patches: &[[usize; 2]]) -> Vec<bool> {
    let mut needed = vec![false; grid.pixels()];
    for [x, y] in patches {
        for row in y - HALO..y + SIDE + HALO {
            let first = row * grid.width + x - HALO;
            needed[first..first + SIDE + 2 * HALO].fill(true);
        }
    }
    needed
}

/// Regions in a patch under one light with the pixels that each covers.
fn labels(grid: Grid, parts: &Parts, light: usize, [x, y]: [usize; 2]) -> Vec<(u32, f32)> {
    let mut found: Vec<(u32, f32)> = Vec::new();
    for row in y..y + SIDE {
        for column in x..x + SIDE {
            for part in &parts[row * grid.width + column][light] {
                match found.iter_mut().find(|(label, _)| *label == part.label) {
                    Some((_, px)) => *px += part.coverage,
                    None => found.push((part.label, part.coverage)),
                }
            }
        }
    }
    found.retain(|(_, px)| *px > 0.2);
    found.sort_by_key(|(label, _)| *label);
    found
}

/// Normal equations of each patch, linearised at `base` with the blur at `blur_px2`; weighted
/// as `like`, patch by patch, or by their own residuals.
#[allow(clippy::too_many_arguments)]
pub fn accumulate_patches(
    grid: Grid,
    targets: &[Target],
    patches: &[[usize; 2]],
    base: &Parts,
    pairs: &[Pair],
    parameters: &[Parameter],
    blur_px2: f64,
    like: Option<&[PatchEquations]>,
) -> Vec<PatchEquations> {
    let unknowns = parameters.len() + 1;
    let patch = |(index, &at): (usize, &[usize; 2])| {
        let mut sum = PatchEquations {
            at,
            information: DMatrix::zeros(unknowns, unknowns),
            score: DVector::zeros(unknowns),
            chi2: [0.0; 2],
            chi2_plain: 0.0,
            weights: vec![1.0; targets.len()],
        };
        for (light, target) in targets.iter().enumerate() {
            let basis = Basis::new(grid, base, light, at);
            let Some(fit) = basis.fit(grid, base, target, blur_px2) else {
                continue;
            };
            sum.chi2[0] += fit.chi2;
            sum.chi2[1] += fit.freedom;
            sum.chi2_plain += fit.chi2_plain;
            let weight = match like {
                Some(like) => like[index].weights[light],
                None => (fit.freedom / fit.chi2.max(1e-300)).min(1.0),
            };
            sum.weights[light] = weight;
            let mut jacobian = DMatrix::zeros(SIDE * SIDE, unknowns);
            let change = |to: DMatrix<f64>, from: DMatrix<f64>, across: f64| {
                fit.beyond(&((to - from) * &fit.coefficients / across))
            };
            for pair in pairs {
                for &k in &pair.parameters {
                    if parameters[k].light().is_none_or(|own| own == light) {
                        let [to, from] =
                            [0, 1].map(|i| basis.columns(grid, &pair.parts[i], blur_px2));
                        jacobian.set_column(k, &change(to, from, pair.across));
                    }
                }
            }
            let ends = [-0.1, 0.1].map(|d| (blur_px2 + d).clamp(0.0, LARGEST_BLUR_PX2));
            let [from, to] = ends.map(|v| basis.columns(grid, base, v));
            jacobian.set_column(unknowns - 1, &change(to, from, ends[1] - ends[0]));
            sum.information += weight * jacobian.tr_mul(&jacobian);
            sum.score += weight * jacobian.tr_mul(&fit.residual);
        }
        sum
    };
    patches.par_iter().enumerate().map(patch).collect()
}

/// The functions whose sum a patch's radiance is, under one light.
struct Basis {
    light: usize,
    at: [usize; 2],
    /// Label, and whether it has a plane, not just a constant.
    regions: Vec<(u32, bool)>,
}

/// A patch's radiance in the basis; rows are divided by the noise.
struct PatchFit {
    coefficients: DVector<f64>,
    columns: DMatrix<f64>,
    root_weight: DVector<f64>,
    normal: Cholesky<f64, Dyn>,
    residual: DVector<f64>,
    chi2: f64,
    freedom: f64,
    chi2_plain: f64,
}

impl Basis {
    fn new(grid: Grid, parts: &Parts, light: usize, at: [usize; 2]) -> Self {
        let labels = labels(grid, parts, light, at);
        Self {
            light,
            at,
            regions: labels.iter().map(|&(l, px)| (l, px >= FEW_PX)).collect(),
        }
    }

    /// The functions at the patch's pixels, blurred.
    fn columns(&self, grid: Grid, parts: &Parts, blur_px2: f64) -> DMatrix<f64> {
        const WIDE: usize = SIDE + 2 * HALO;
        let [x, y] = self.at;
        let mut columns: Vec<DVector<f64>> = Vec::new();
        for &(label, plane) in &self.regions {
            let mut coverage = vec![0.0; WIDE * WIDE];
            let mut cosine = vec![0.0; WIDE * WIDE];
            for row in 0..WIDE {
                for column in 0..WIDE {
                    let pixel = (y + row - HALO) * grid.width + x + column - HALO;
                    let seen = parts[pixel].get(self.light).into_iter().flatten();
                    for part in seen.filter(|part| part.label == label) {
                        coverage[row * WIDE + column] += f64::from(part.coverage);
                        cosine[row * WIDE + column] += f64::from(part.cosine);
                    }
                }
            }
            let inside = |mut wide: Vec<f64>| {
                blur(&mut wide, WIDE, blur_px2);
                DVector::from_fn(SIDE * SIDE, |i, _| {
                    wide[(i / SIDE + HALO) * WIDE + i % SIDE + HALO]
                })
            };
            let coverage = inside(coverage);
            if plane {
                let offset = |i: usize| i as f64 - 0.5 * (SIDE - 1) as f64;
                columns.push(coverage.map_with_location(|i, _, c| c * offset(i % SIDE)));
                columns.push(coverage.map_with_location(|i, _, c| c * offset(i / SIDE)));
                if is_lit(label) {
                    columns.push(inside(cosine));
                }
            }
            columns.push(coverage);
        }
        DMatrix::from_columns(&columns)
    }

    /// `None` where there is no edge or nothing to compare.
    fn fit(&self, grid: Grid, parts: &Parts, target: &Target, blur_px2: f64) -> Option<PatchFit> {
        if self.regions.len() < 2 {
            return None;
        }
        let [x, y] = self.at;
        let pixel = |i: usize| (y + i / SIDE) * grid.width + x + i % SIDE;
        let root_weight = DVector::from_fn(SIDE * SIDE, |i, _| target.weight[pixel(i)].sqrt());
        let weighted = |mut m: DMatrix<f64>| {
            for mut column in m.column_iter_mut() {
                column.component_mul_assign(&root_weight);
            }
            m
        };
        let columns = weighted(self.columns(grid, parts, blur_px2));
        let freedom =
            root_weight.iter().filter(|w| **w > 0.0).count() as f64 - columns.ncols() as f64;
        if freedom < 0.25 * (SIDE * SIDE) as f64 {
            return None;
        }
        let radiance = DVector::from_fn(SIDE * SIDE, |i, _| target.mean[pixel(i)] * root_weight[i]);
        let normal = normal(&columns)?;
        let coefficients = normal.solve(&columns.tr_mul(&radiance));
        let residual = &radiance - &columns * &coefficients;
        let plane = weighted(DMatrix::from_fn(SIDE * SIDE, 3, |i, k| {
            [1.0, (i % SIDE) as f64, (i / SIDE) as f64][k]
        }));
        let plain = &radiance - &plane * self::normal(&plane)?.solve(&plane.tr_mul(&radiance));
        Some(PatchFit {
            chi2: residual.norm_squared(),
            chi2_plain: plain.norm_squared(),
            freedom,
            coefficients,
            columns,
            root_weight,
            normal,
            residual,
        })
    }
}

impl PatchFit {
    /// A change of radiance over its noise, less what other coefficients would make of it.
    fn beyond(&self, change: &DVector<f64>) -> DVector<f64> {
        let change = change.component_mul(&self.root_weight);
        let absorbed = self.normal.solve(&self.columns.tr_mul(&change));
        change - &self.columns * absorbed
    }
}

/// BᵀB, with a trace of its diagonal where functions are almost the same.
fn normal(columns: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let mut normal = columns.tr_mul(columns);
    let mean = normal.trace() / normal.nrows().max(1) as f64;
    for k in 0..normal.nrows() {
        normal[(k, k)] += 1e-9 * normal[(k, k)] + 1e-12 * mean;
    }
    normal.cholesky()
}

/// Convolves with three times `[v/6, 1 − v/3, v/6]` along each axis, whose variance is v.
fn blur(image: &mut [f64], side: usize, variance_px2: f64) {
    let edge = variance_px2 / 6.0;
    let mut line = vec![0.0; side];
    for stride in [1, side] {
        let next = if stride == 1 { side } else { 1 };
        for start in (0..side).map(|i| i * next) {
            for _ in 0..3 {
                for (i, value) in line.iter_mut().enumerate() {
                    *value = image[start + i * stride];
                }
                for i in 0..side {
                    let (before, after) = (line[i.saturating_sub(1)], line[(i + 1).min(side - 1)]);
                    image[start + i * stride] = line[i] + edge * (before + after - 2.0 * line[i]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mass and variance of a blurred point.
    #[test]
    fn the_blur_has_its_variance() {
        let side = 15;
        let mut image = vec![0.0; side * side];
        image[7 * side + 7] = 2.0;
        blur(&mut image, side, 0.9);
        let moment = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            let term =
                |(i, v): (usize, &f64)| v * f((i % side) as f64 - 7.0, (i / side) as f64 - 7.0);
            image.iter().enumerate().map(term).sum()
        };
        assert!((moment(&|_, _| 1.0) - 2.0).abs() < 1e-12);
        assert!((moment(&|x, _| x * x) - 1.8).abs() < 1e-12);
        assert!((moment(&|_, y| y * y) - 1.8).abs() < 1e-12);
        assert!(moment(&|x, y| x * y).abs() < 1e-12);
    }
}
