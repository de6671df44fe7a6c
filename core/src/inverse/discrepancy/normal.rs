//! The normal equations of weights and discrepancy together.

use std::collections::BTreeMap;

use nalgebra::{Cholesky, DMatrix, DVector};

use super::At;
use crate::brdf::discrepancy::{self, NODES};
use crate::inverse::uncertainty::without_noise;

/// The scores Jᵀ W r of the weights and Gᵀ W r of the modes.
type Scores = [DVector<f64>; 2];

/// Normal equations of one set: x its weights, z the free modes.
pub(super) struct Normal {
    /// F_xx, N × N.
    pub information: DMatrix<f64>,
    /// F_xz, N × M.
    pub coupling: DMatrix<f64>,
    /// F_zz, M × M.
    pub discrepancy: DMatrix<f64>,
    /// Of all cells.
    pub scores: Scores,
    /// By block of cells.
    pub blocks: Vec<Scores>,
    /// Takes noise out of scores of both.
    told: DMatrix<f64>,
}

impl Normal {
    /// (F_zz + Λ)⁻¹ for modes of this amplitude, with this caution.
    pub fn covariance(&self, amplitude: f64, caution: f64) -> DMatrix<f64> {
        let m = self.discrepancy.nrows();
        let prior = DMatrix::identity(m, m) * (caution / (amplitude * amplitude));
        Cholesky::new(&self.discrepancy + prior)
            .map_or_else(|| DMatrix::zeros(m, m), |root| root.inverse())
    }
}

/// One compared value.
struct Value {
    set: usize,
    block: usize,
    weight: f64,
    /// Derivatives by the weights and by all modes, by either half of the paths.
    by_weights: [DVector<f64>; 2],
    by_modes: [DVector<f64>; 2],
    /// Captured − model.
    residual: [f64; 2],
}

/// Sums over the values of a set, all modes.
#[derive(Clone)]
struct Sums {
    /// Of independent halves, and of the mean of both.
    coupling: [DMatrix<f64>; 2],
    discrepancy: [DMatrix<f64>; 2],
    blocks: Blocks,
}

/// Scores by block of cells, all modes.
#[derive(Clone, Default)]
struct Blocks(BTreeMap<usize, Scores>);

impl Blocks {
    fn add(&mut self, block: usize, [weights, modes]: [&DVector<f64>; 2], factor: f64) {
        let none = || [weights, modes].map(|v| DVector::zeros(v.len()));
        let scores = self.0.entry(block).or_insert_with(none);
        scores[0].axpy(factor, weights, 1.0);
        scores[1].axpy(factor, modes, 1.0);
    }

    /// What a value adds whose `residual` is this: every product between independent halves.
    fn add_value(&mut self, value: &Value, residual: [f64; 2]) {
        for (half, other) in [(0, 1), (1, 0)] {
            let by = [&value.by_weights[half], &value.by_modes[half]];
            self.add(value.block, by, 0.5 * value.weight * residual[other]);
        }
    }

    fn join(&mut self, other: Self) {
        for (block, [weights, modes]) in other.0 {
            self.add(block, [&weights, &modes], 1.0);
        }
    }

    fn of_free(self, free: &DMatrix<f64>) -> Vec<Scores> {
        let scores = self.0.into_values();
        scores.map(|[x, z]| [x, free.tr_mul(&z)]).collect()
    }
}

impl Sums {
    fn zero(n: usize, m: usize) -> Self {
        Self {
            coupling: [DMatrix::zeros(n, m), DMatrix::zeros(n, m)],
            discrepancy: [DMatrix::zeros(m, m), DMatrix::zeros(m, m)],
            blocks: Blocks::default(),
        }
    }

    fn add(&mut self, value: &Value) {
        let w = value.weight;
        let [[j, k], [a, b]] = [&value.by_weights, &value.by_modes];
        self.discrepancy[0].ger(0.5 * w, a, b, 1.0);
        self.discrepancy[0].ger(0.5 * w, b, a, 1.0);
        self.coupling[0].ger(0.5 * w, j, b, 1.0);
        self.coupling[0].ger(0.5 * w, k, a, 1.0);
        // (a + b)(a + b)ᵀ/4 is half of the above and these.
        self.discrepancy[1].ger(0.25 * w, a, a, 1.0);
        self.discrepancy[1].ger(0.25 * w, b, b, 1.0);
        self.coupling[1].ger(0.25 * w, j, a, 1.0);
        self.coupling[1].ger(0.25 * w, k, b, 1.0);
        self.blocks.add_value(value, value.residual);
    }

    fn join(&mut self, other: Self) {
        for k in 0..2 {
            self.coupling[k] += &other.coupling[k];
            self.discrepancy[k] += &other.discrepancy[k];
        }
        self.blocks.join(other.blocks);
    }

    /// With what the paths' noise alone could have made taken out of the information, given
    /// that of the weights by independent halves and by their mean.
    fn normal(mut self, weights: [&DMatrix<f64>; 2], free: &DMatrix<f64>) -> Normal {
        self.coupling[1] = &self.coupling[1] + 0.5 * &self.coupling[0];
        self.discrepancy[1] = &self.discrepancy[1] + 0.5 * &self.discrepancy[0];
        let (n, m) = (weights[0].nrows(), free.ncols());
        let joint = |k: usize| {
            let mut joint = DMatrix::zeros(n + m, n + m);
            let coupling = &self.coupling[k] * free;
            joint.view_mut((0, 0), (n, n)).copy_from(weights[k]);
            joint.view_mut((0, n), (n, m)).copy_from(&coupling);
            joint.view_mut((n, 0), (m, n)).tr_copy_from(&coupling);
            let modes = free.tr_mul(&self.discrepancy[k]) * free;
            joint.view_mut((n, n), (m, m)).copy_from(&modes);
            joint
        };
        let told = without_noise(&joint(0), &joint(1));
        let joint = told.information;
        let blocks = told_of(&told.scores, self.blocks.of_free(free));
        let mut scores = [DVector::zeros(n), DVector::zeros(m)];
        for block in &blocks {
            for (sum, score) in scores.iter_mut().zip(block) {
                *sum += score;
            }
        }
        Normal {
            information: joint.view((0, 0), (n, n)).into_owned(),
            coupling: joint.view((0, n), (n, m)).into_owned(),
            discrepancy: joint.view((n, n), (m, m)).into_owned(),
            scores,
            blocks,
            told: told.scores,
        }
    }
}

/// What scores say in the directions that are told apart.
fn told_of(told: &DMatrix<f64>, scores: Vec<Scores>) -> Vec<Scores> {
    let of = |[x, z]: Scores| {
        let both = DVector::from_iterator(x.len() + z.len(), x.iter().chain(&z).copied());
        let both = told * both;
        [
            both.rows(0, x.len()).into_owned(),
            both.rows(x.len(), z.len()).into_owned(),
        ]
    };
    scores.into_iter().map(of).collect()
}

/// The equations of each set with its `free` modes.
pub(super) fn equations(at: &At<'_>, free: &[DMatrix<f64>]) -> Vec<Normal> {
    let (n, m) = (at.objective.atoms(), discrepancy::modes().ncols());
    let zero = || vec![Sums::zero(n, m); free.len()];
    let parts = over_values(at, zero, |sums, value| sums[value.set].add(value));
    let mut total = zero();
    for part in parts {
        for (total, part) in total.iter_mut().zip(part) {
            total.join(part);
        }
    }
    let pass = at.pass;
    let known = pass.information.iter().zip(&pass.quadratics);
    let sets = total.into_iter().zip(known).zip(free);
    sets.map(|((sums, (halves, mean)), free)| sums.normal([halves, &mean.h], free))
        .collect()
}

/// Sets the scores of weights and free modes by block of cells to those of the residual that small
/// discrepancies (values of all modes, per set) leave.
pub(super) fn blocks_after(
    at: &At<'_>,
    discrepancies: &[DVector<f64>],
    free: &[DMatrix<f64>],
    normal: &mut [Normal],
) {
    let none = || vec![Blocks::default(); free.len()];
    let parts = over_values(at, none, |blocks, value| {
        let departed = |half: usize| value.by_modes[half].dot(&discrepancies[value.set]);
        let residual = [0, 1].map(|half| value.residual[half] - departed(half));
        blocks[value.set].add_value(value, residual);
    });
    let mut total = none();
    for part in parts {
        for (total, part) in total.iter_mut().zip(part) {
            total.join(part);
        }
    }
    for ((normal, blocks), free) in normal.iter_mut().zip(total).zip(free) {
        normal.blocks = told_of(&normal.told, blocks.of_free(free));
    }
}

/// Visits every compared value, by groups of cells.
fn over_values<T: Send>(
    at: &At<'_>,
    group: impl Fn() -> T + Sync,
    visit: impl Fn(&mut T, &Value) + Sync,
) -> Vec<T> {
    let objective = at.objective;
    let modes = discrepancy::modes();
    let (n, m, sets) = (objective.atoms(), modes.ncols(), objective.sets());
    let group = || {
        let value = Value {
            set: 0,
            block: 0,
            weight: 0.0,
            by_weights: [DVector::zeros(n), DVector::zeros(n)],
            by_modes: [DVector::zeros(m), DVector::zeros(m)],
            residual: [0.0; 2],
        };
        (group(), value, DVector::zeros(NODES))
    };
    let parts = objective.evaluate(at.mixture, true, group, |(sums, value, nodes), rows| {
        let cell = rows.cell;
        for (light, c) in (0..objective.lights()).flat_map(|l| [(l, 0), (l, 1), (l, 2)]) {
            value.weight = at.residual_weights[light][cell][c];
            if value.weight <= 0.0 {
                continue;
            }
            value.set = c.min(sets - 1);
            value.block = objective.block(cell, light);
            let [a, b] = value.by_weights.each_mut().map(|v| v.as_mut_slice());
            objective.derivatives(rows, light, c, [a, b]);
            let direct_light = objective.direct_light(cell, light, c, &at.mixture[value.set]);
            let [target, _] = objective.captured(light, cell);
            let row = light * sets + value.set;
            for half in 0..2 {
                value.residual[half] = target[c] - direct_light - f64::from(rows.value[half][row]);
                let by_node = &rows.nodes[half][row * NODES..(row + 1) * NODES];
                for (node, &by_node) in nodes.iter_mut().zip(by_node) {
                    *node = f64::from(by_node);
                }
                modes.tr_mul_to(nodes, &mut value.by_modes[half]);
                let direct = at.direct.by_modes(cell, light, c);
                for (mode, &direct) in value.by_modes[half].iter_mut().zip(direct) {
                    *mode += direct_light * f64::from(direct);
                }
            }
            visit(sums, value);
        }
    });
    parts.into_iter().map(|(sums, ..)| sums).collect()
}
