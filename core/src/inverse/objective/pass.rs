//! One pass over the cached paths: image, loss, gradient and Gauss–Newton matrix.

use nalgebra::{DMatrix, DVector};

use super::stray_light::ShadowSums;
use super::{ModelImage, Modelled, Objective, ResidualWeights};
use crate::inverse::normal_equations::NormalSums;
use crate::simplex::Quadratic;
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
    /// makes: what the model leaves unexplained, as a part of χ², without `stray_light`.
    pub unexplained: Vec<f64>,
    /// Variance of the light that is neither the lamp's nor the sample's, over the lamp's
    /// strength, `[light][channel]`; 0 where the shadows show none.
    pub stray_light: Vec<[f64; 3]>,
    /// Σ w I² per channel group, by which a relative error of the model counts as a part of χ².
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
    pub fn relative_error(&self, group: usize) -> f64 {
        let power = self.power[group];
        if power > 0.0 {
            (self.unexplained[group] / power).max(0.0).sqrt()
        } else {
            0.0
        }
    }

    /// The least share of the noise's energy, per channel group, that makes the loss convex around
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

    /// Adds a share of the noise's energy, per channel group, to loss and gradient.
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
            least >= -CONVEXITY_TOLERANCE
        })
        .unwrap_or(1.0)
}

/// Least eigenvalue, atoms scaled to unit curvature, that rounding may leave.
const CONVEXITY_TOLERANCE: f64 = 1e-9;

impl Objective<'_> {
    /// Image, loss, gradient and Gauss–Newton matrix at `mixture` (one vector per channel group).
    pub fn linearise(
        &self,
        mixture: &[DVector<f64>],
        residual_weights: &ResidualWeights,
    ) -> Linearised {
        let (n, groups, lights) = (self.atoms(), self.groups(), self.lights());
        let group = || (Part::new(n, groups, lights), self.row_pair());
        let parts = self.evaluate(mixture, None, group, |(part, pair), rows| {
            let mut model = vec![[Modelled::default(); 3]; lights];
            for (light, c) in (0..lights).flat_map(|l| [(l, 0), (l, 1), (l, 2)]) {
                let group = self.channels.group(c);
                let r = light * groups + group;
                let indirect = [0, 1].map(|h| f64::from(rows.value[h][r]));
                let variance = f64::from(rows.variance[r]);
                part.reduction[light][c].add(0.25 * (indirect[0] - indirect[1]).powi(2), variance);
                model[light][c] = Modelled {
                    direct: self.direct_light(rows.cell, light, c, &mixture[group]),
                    indirect: 0.5 * (indirect[0] + indirect[1]),
                    variance,
                };
            }
            part.model.push(model);
            self.visit_cell(rows, mixture, residual_weights, pair, |value| {
                let (w, residual) = (value.weight, value.residual);
                let sums = &mut part.groups[value.group];
                sums.normal.add(value.block, w, value.by_weights, residual);
                let product = residual[0] * residual[1];
                sums.loss += 0.5 * w * product;
                sums.unexplained += w * (product - value.variance);
                part.shadows[value.light][value.channel].add(value, self.is_shadow(value));
                sums.power += w * value.model[0] * value.model[1];
                let difference = residual[0] - residual[1];
                let [a, b] = value.by_weights;
                for (g, (a, b)) in sums.noise.g.iter_mut().zip(a.iter().zip(b)) {
                    *g += 0.25 * w * (a - b) * difference;
                }
                sums.noise.c += 0.125 * w * difference * difference;
            });
        });
        let parts = parts.into_iter().map(|(part, _)| part).collect();
        self.gather(parts)
    }

    /// Direct light, over the lamp's strength.
    pub(in crate::inverse) fn direct_light(
        &self,
        cell: usize,
        light: usize,
        channel: usize,
        mixture: &DVector<f64>,
    ) -> f64 {
        let direct = self.direct.row(cell, light).iter();
        let terms = direct.zip(mixture).map(|(&d, w)| f64::from(d) * w);
        terms.sum::<f64>() * self.direct_factor(cell, light, channel)
    }

    /// Derivatives of one value by the weights of its set, with the paths of each half.
    pub(in crate::inverse) fn derivatives(
        &self,
        rows: &CellRows<'_>,
        light: usize,
        channel: usize,
        halves: [&mut [f64]; 2],
    ) {
        let (n, row) = (
            self.atoms(),
            light * self.groups() + self.channels.group(channel),
        );
        let direct = self.direct.row(rows.cell, light);
        let factor = self.direct_factor(rows.cell, light, channel);
        for (half, jacobian) in halves.into_iter().zip(rows.jacobian) {
            let indirect = &jacobian[row * n..(row + 1) * n];
            for (sum, (&d, &i)) in half.iter_mut().zip(direct.iter().zip(indirect)) {
                *sum = factor * f64::from(d) + f64::from(i);
            }
        }
    }

    fn gather(&self, parts: Vec<Part>) -> Linearised {
        let (n, groups) = (self.atoms(), self.groups());
        let mut total = Part::new(n, groups, self.lights());
        let mut stray_light = vec![[0.0; 3]; self.lights()];
        let mut model = vec![Vec::with_capacity(self.cells.len()); self.lights()];
        for part in parts {
            for (total, part) in total.groups.iter_mut().zip(part.groups) {
                total.normal.join(part.normal);
                total.loss += part.loss;
                total.noise.g += &part.noise.g;
                total.noise.c += part.noise.c;
                total.unexplained += part.unexplained;
                total.power += part.power;
            }
            let reductions = part.reduction.iter().flatten();
            for (total, part) in total.reduction.iter_mut().flatten().zip(reductions) {
                total.join(part);
            }
            let shadows = part.shadows.iter().flatten();
            for (total, part) in total.shadows.iter_mut().flatten().zip(shadows) {
                total.join(part);
            }
            for cell in part.model {
                for (image, value) in model.iter_mut().zip(cell) {
                    image.push(value);
                }
            }
        }
        for (image, reduction) in model.iter_mut().zip(&total.reduction) {
            let factors = reduction.map(|channel| channel.factor());
            for cell in image {
                for (modelled, factor) in cell.iter_mut().zip(factors) {
                    modelled.variance *= factor;
                }
            }
        }
        for (light, shadows) in total.shadows.iter().enumerate() {
            for (channel, shadows) in shadows.iter().enumerate() {
                let variance = shadows.variance();
                stray_light[light][channel] = variance;
                let group = &mut total.groups[self.channels.group(channel)];
                group.unexplained -= variance * shadows.weight;
            }
        }
        let mut pass = Linearised {
            quadratics: Vec::with_capacity(groups),
            information: Vec::with_capacity(groups),
            noise: Vec::with_capacity(groups),
            model,
            unexplained: Vec::with_capacity(groups),
            stray_light,
            power: Vec::with_capacity(groups),
            block_scores: Vec::with_capacity(groups),
        };
        for sums in total.groups {
            let equations = sums.normal.equations();
            pass.quadratics.push(Quadratic {
                h: equations.full,
                g: equations.scores.total,
                c: sums.loss,
            });
            pass.information.push(equations.information);
            pass.noise.push(sums.noise);
            pass.unexplained.push(sums.unexplained);
            pass.power.push(sums.power);
            pass.block_scores
                .push(equations.scores.blocks.into_values().collect());
        }
        pass
    }
}

/// Sums over a group of cells.
struct Part {
    groups: Vec<Sums>,
    model: Vec<ModelImage>,
    /// Per light and channel.
    reduction: Vec<[VarianceReduction; 3]>,
    /// Per light and channel.
    shadows: Vec<[ShadowSums; 3]>,
}

/// Sums over the values of a channel group.
struct Sums {
    normal: NormalSums,
    loss: f64,
    noise: Noise,
    unexplained: f64,
    power: f64,
}

impl Part {
    fn new(n: usize, groups: usize, lights: usize) -> Self {
        let none = |_| Sums {
            normal: NormalSums::zero(n),
            loss: 0.0,
            noise: Noise::zero(n),
            unexplained: 0.0,
            power: 0.0,
        };
        Self {
            groups: (0..groups).map(none).collect(),
            model: Vec::new(),
            reduction: vec![[VarianceReduction::default(); 3]; lights],
            shadows: vec![[ShadowSums::default(); 3]; lights],
        }
    }
}
