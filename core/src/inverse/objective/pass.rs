//! One pass over the cached paths: image, loss, gradient and Gauss–Newton matrix.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::{ModelImage, Modelled, Objective, ResidualWeights, add_outer};
use crate::inverse::simplex::Quadratic;
use crate::transport::CellRows;
use crate::transport::points::VarianceReduction;

/// One pass at given mixture weights.
pub struct Linearised {
    /// Per set: ½ rᵀWr as a quadratic in the step, unbiased by the render's noise;
    /// `h` positive semidefinite, `g` minus the gradient, `c` the loss.
    pub quadratics: Vec<Quadratic>,
    /// Per set: sym(J_Aᵀ W J_B), the information without the noise that JᵀWJ of a
    /// noisy J would add.
    pub information: Vec<DMatrix<f64>>,
    /// Per set: what the render's noise adds to the loss if the mean residual is squared.
    pub(in crate::inverse) noise: Vec<Noise>,
    /// Modelled radiance, `[light][cell][channel]`.
    pub model: Vec<ModelImage>,
    /// Per set: Σ w (r_A r_B − σ²_captured), which the noise of neither capture nor render
    /// makes: what the model leaves unexplained, as a part of χ².
    pub unexplained: Vec<f64>,
    /// Σ w I² per set, by which a relative error of the model counts as a part of χ².
    pub power: Vec<f64>,
    /// Per set and block of cells of one light: Jᵀ W r.
    pub block_scores: Vec<Vec<DVector<f64>>>,
}

/// The energy of the render's noise, ⅛ (r_A − r_B)ᵀW(r_A − r_B), and minus its gradient.
#[derive(Clone, Debug)]
pub(in crate::inverse) struct Noise {
    g: DVector<f64>,
    c: f64,
}

impl Noise {
    fn zero(n: usize) -> Self {
        Self {
            g: DVector::zeros(n),
            c: 0.0,
        }
    }
}

impl Linearised {
    /// Relative error of the model, root mean square, that leaves as much unexplained.
    pub fn relative_error(&self, set: usize) -> f64 {
        let power = self.power[set];
        if power > 0.0 {
            (self.unexplained[set] / power).max(0.0).sqrt()
        } else {
            0.0
        }
    }

    /// The least share of the noise's energy, per set, that makes the loss convex around
    /// this point together with a prior of curvature `prior` in every direction. Without it
    /// ½ r_AᵀWr_B has directions of negative curvature where paths are few, and its minimum
    /// is whatever the noise makes of them; with all of it the loss is ½ rᵀWr of the mean
    /// residual, which the noise biases (docs/adr/0003).
    pub fn convex_share(&self, prior: f64) -> Vec<f64> {
        self.quadratics
            .iter()
            .zip(&self.information)
            .map(|(q, information)| convex_share(&q.h, information, prior))
            .collect()
    }

    /// Adds a share of the noise's energy, per set, to loss and gradient.
    pub fn add_noise(&mut self, shares: &[f64]) {
        for ((q, noise), share) in self.quadratics.iter_mut().zip(&self.noise).zip(shares) {
            q.g.axpy(*share, &noise.g, 1.0);
            q.c += share * noise.c;
        }
    }
}

/// The least of 0, 1/64, 1/32, … 1 that makes `information` + share · (`full` −
/// `information`) with `prior` on its diagonal positive semidefinite, atoms scaled alike.
fn convex_share(full: &DMatrix<f64>, information: &DMatrix<f64>, prior: f64) -> f64 {
    let scale = full.diagonal().map(|d| 1.0 / (d + prior).sqrt());
    let scaled = |m: &DMatrix<f64>| {
        DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| {
            let prior = if i == j { prior } else { 0.0 };
            scale[i] * (m[(i, j)] + prior) * scale[j]
        })
    };
    let (full, information) = (scaled(full), scaled(information));
    let mut shares = std::iter::once(0.0).chain((0..6).map(|k| 1.0 / f64::from(64 >> k)));
    shares
        .find(|share| {
            let blend = &information * (1.0 - share) + &full * *share;
            let least = blend.symmetric_eigenvalues().min();
            least >= -CONVEX
        })
        .unwrap_or(1.0)
}

/// Least eigenvalue, atoms scaled to unit curvature, that rounding may leave.
const CONVEX: f64 = 1e-9;

impl Objective<'_> {
    /// Image, loss, gradient and Gauss–Newton matrix at `mixture` (one vector per set).
    pub fn linearise(
        &self,
        mixture: &[DVector<f64>],
        residual_weights: &ResidualWeights,
    ) -> Linearised {
        let (n, sets, lights) = (self.atoms(), self.sets(), self.lights());
        let parts = self.evaluate(
            mixture,
            false,
            || Part::new(n, sets, lights),
            |part, rows| {
                let cell = rows.cell;
                let mut model = vec![[Modelled::default(); 3]; lights];
                let mut derivatives = [vec![0.0; n], vec![0.0; n]];
                let mut row_mean = vec![0.0; n];
                for light in 0..lights {
                    for c in 0..3 {
                        let set = self.set_of(c);
                        let r = light * sets + set;
                        let direct = self.direct_light(cell, light, c, &mixture[set]);
                        let indirect = [0, 1].map(|h| f64::from(rows.value[h][r]));
                        let halves = indirect.map(|value| direct + value);
                        let variance = f64::from(rows.variance[r]);
                        part.reduction[light][c]
                            .add(0.25 * (indirect[0] - indirect[1]).powi(2), variance);
                        model[light][c] = Modelled {
                            direct,
                            indirect: 0.5 * (indirect[0] + indirect[1]),
                            variance,
                        };
                        let w = residual_weights[light][cell][c];
                        if w <= 0.0 {
                            continue;
                        }
                        let [row_a, row_b] = &mut derivatives;
                        self.derivatives(rows, light, c, [row_a, row_b]);
                        for (mean, (a, b)) in row_mean.iter_mut().zip(row_a.iter().zip(&*row_b)) {
                            *mean = 0.5 * (a + b);
                        }
                        let target = self.values.target[light][cell][c];
                        let residual = halves.map(|m| m - target);
                        let q = &mut part.quadratics[set];
                        add_outer(&mut q.h, &row_mean, w);
                        add_product(&mut part.information[set], row_a, row_b, w);
                        let block = self.block(cell, light);
                        let score = part.scores[set]
                            .entry(block)
                            .or_insert_with(|| DVector::zeros(n));
                        for k in 0..n {
                            let descent =
                                -0.5 * w * (row_a[k] * residual[1] + row_b[k] * residual[0]);
                            q.g[k] += descent;
                            score[k] += descent;
                        }
                        q.c += 0.5 * w * residual[0] * residual[1];
                        part.unexplained[set] +=
                            w * (residual[0] * residual[1] - self.values.variance[light][cell][c]);
                        part.power[set] += w * halves[0] * halves[1];
                        let difference = residual[0] - residual[1];
                        let noise = &mut part.noise[set];
                        for k in 0..n {
                            noise.g[k] -= 0.25 * w * (row_a[k] - row_b[k]) * difference;
                        }
                        noise.c += 0.125 * w * difference * difference;
                    }
                }
                part.model.push(model);
            },
        );
        self.gather(parts)
    }

    /// What is reflected once, over the lamp's strength.
    pub(in crate::inverse) fn direct_light(
        &self,
        cell: usize,
        light: usize,
        channel: usize,
        mixture: &DVector<f64>,
    ) -> f64 {
        let direct = self.direct.row(cell, light).iter();
        let terms = direct.zip(mixture).map(|(&d, w)| f64::from(d) * w);
        terms.sum::<f64>() * self.once_factor(cell, light, channel)
    }

    /// Derivatives of one value by the weights of its set, with the paths of each half.
    pub(in crate::inverse) fn derivatives(
        &self,
        rows: &CellRows<'_>,
        light: usize,
        channel: usize,
        halves: [&mut [f64]; 2],
    ) {
        let (n, row) = (self.atoms(), light * self.sets() + self.set_of(channel));
        let direct = self.direct.row(rows.cell, light);
        let factor = self.once_factor(rows.cell, light, channel);
        for (half, jacobian) in halves.into_iter().zip(rows.jacobian) {
            let indirect = &jacobian[row * n..(row + 1) * n];
            for (sum, (&d, &i)) in half.iter_mut().zip(direct.iter().zip(indirect)) {
                *sum = factor * f64::from(d) + f64::from(i);
            }
        }
    }

    fn gather(&self, parts: Vec<Part>) -> Linearised {
        let (n, sets) = (self.atoms(), self.sets());
        let mut total = Part::new(n, sets, self.lights());
        let mut model = vec![Vec::with_capacity(self.values.target[0].len()); self.lights()];
        for part in parts {
            for set in 0..sets {
                total.quadratics[set].add_scaled(1.0, &part.quadratics[set]);
                total.information[set] += &part.information[set];
                total.noise[set].g += &part.noise[set].g;
                total.noise[set].c += part.noise[set].c;
                total.unexplained[set] += part.unexplained[set];
                total.power[set] += part.power[set];
                for (block, score) in &part.scores[set] {
                    *total.scores[set]
                        .entry(*block)
                        .or_insert_with(|| DVector::zeros(n)) += score;
                }
            }
            for (total, part) in total.reduction.iter_mut().zip(&part.reduction) {
                for (total, part) in total.iter_mut().zip(part) {
                    total.join(part);
                }
            }
            for cell in part.model {
                for (light, value) in cell.into_iter().enumerate() {
                    model[light].push(value);
                }
            }
        }
        for set in 0..sets {
            total.quadratics[set]
                .h
                .fill_upper_triangle_with_lower_triangle();
            total.information[set].fill_upper_triangle_with_lower_triangle();
        }
        for (image, reduction) in model.iter_mut().zip(&total.reduction) {
            let factors = reduction.map(|channel| channel.factor());
            for cell in image {
                for (modelled, factor) in cell.iter_mut().zip(factors) {
                    modelled.variance *= factor;
                }
            }
        }
        Linearised {
            noise: total.noise,
            unexplained: total.unexplained,
            power: total.power,
            quadratics: total.quadratics,
            information: total.information,
            model,
            block_scores: total
                .scores
                .into_iter()
                .map(|s| s.into_values().collect())
                .collect(),
        }
    }
}

/// Sums over a group of cells.
struct Part {
    quadratics: Vec<Quadratic>,
    information: Vec<DMatrix<f64>>,
    noise: Vec<Noise>,
    unexplained: Vec<f64>,
    power: Vec<f64>,
    scores: Vec<BTreeMap<usize, DVector<f64>>>,
    model: Vec<ModelImage>,
    /// Per light and channel.
    reduction: Vec<[VarianceReduction; 3]>,
}

impl Part {
    fn new(n: usize, sets: usize, lights: usize) -> Self {
        Self {
            quadratics: vec![Quadratic::zero(n); sets],
            information: vec![DMatrix::zeros(n, n); sets],
            noise: vec![Noise::zero(n); sets],
            unexplained: vec![0.0; sets],
            power: vec![0.0; sets],
            scores: vec![Default::default(); sets],
            model: Vec::new(),
            reduction: vec![[VarianceReduction::default(); 3]; lights],
        }
    }
}

/// Lower triangle of `h += w · ½ (a bᵀ + b aᵀ)`.
pub(super) fn add_product(h: &mut DMatrix<f64>, a: &[f64], b: &[f64], w: f64) {
    let n = a.len();
    let data = h.as_mut_slice();
    for j in 0..n {
        let (wa, wb) = (0.5 * w * a[j], 0.5 * w * b[j]);
        if wa != 0.0 || wb != 0.0 {
            let column = &mut data[j * n + j..(j + 1) * n];
            for (h, (&x, &y)) in column.iter_mut().zip(a[j..].iter().zip(&b[j..])) {
                *h += wa * y + wb * x;
            }
        }
    }
}
