//! The normal equations of weights and departure together.

use std::collections::BTreeMap;

use nalgebra::{Cholesky, DMatrix, DVector};

use super::{At, CAUTION};
use crate::brdf::departure;
use crate::inverse::uncertainty::without_noise;
use crate::transport::PixelRows;
use crate::transport::sensitivity::Sensitivity;

/// Normal equations of one set: x its weights, z the free modes.
pub(super) struct Normal {
    /// F_xx, N × N.
    pub information: DMatrix<f64>,
    /// F_xz, N × M.
    pub coupling: DMatrix<f64>,
    /// F_zz, M × M.
    pub departure: DMatrix<f64>,
    /// Gᵀ W r.
    pub score: DVector<f64>,
}

impl Normal {
    /// Of the free modes, around what is expected of them.
    pub fn covariance(&self, amplitude: f64) -> DMatrix<f64> {
        let m = self.score.len();
        let prior = DMatrix::identity(m, m) * (CAUTION / (amplitude * amplitude));
        Cholesky::new(&self.departure + prior)
            .map_or_else(|| DMatrix::zeros(m, m), |root| root.inverse())
    }
}

/// The compared values one by one.
pub(super) struct Values<'a> {
    pub at: &'a At<'a>,
    /// How the images change with the departure's modes.
    pub images: &'a Sensitivity,
}

/// One compared value.
struct Value {
    light: usize,
    set: usize,
    weight: f64,
    /// Derivatives by both halves of the paths.
    by_weights: [DVector<f64>; 2],
    by_modes: [DVector<f64>; 2],
    /// Captured − model.
    residual: [f64; 2],
}

/// Sums over values, all modes.
#[derive(Clone)]
struct Sums {
    coupling: DMatrix<f64>,
    /// Of independent halves, and of the mean of both.
    departure: [DMatrix<f64>; 2],
    score: DVector<f64>,
}

impl Values<'_> {
    fn for_each(&self, rows: &PixelRows<'_>, mut visit: impl FnMut(Value)) {
        let objective = self.at.objective;
        let (n, sets) = (objective.atoms(), objective.sets());
        for light in 0..objective.lights() {
            let direct = objective.direct().row(rows.pixel, light);
            for c in 0..3 {
                let weight = self.at.residual_weights[light][rows.pixel][c];
                if weight <= 0.0 {
                    continue;
                }
                let set = c.min(sets - 1);
                let mut by_weights = [DVector::zeros(n), DVector::zeros(n)];
                let [a, b] = &mut by_weights;
                objective.derivatives(rows, light, set, [a.as_mut_slice(), b.as_mut_slice()]);
                let mixture = self.at.mixture[set].iter();
                let once: f64 = direct
                    .iter()
                    .zip(mixture)
                    .map(|(&d, w)| f64::from(d) * w)
                    .sum();
                let [target, _] = objective.captured(light, rows.pixel);
                let residual =
                    [0, 1].map(|h| target[c] - once - f64::from(rows.value[h][light * sets + set]));
                let by_modes = self.images.at(rows.pixel, light, c);
                visit(Value {
                    light,
                    set,
                    weight,
                    by_weights,
                    by_modes: by_modes.map(|half| {
                        DVector::from_iterator(half.len(), half.iter().map(|&v| f64::from(v)))
                    }),
                    residual,
                });
            }
        }
    }

    fn slices(&self) -> Vec<&[f64]> {
        self.at.mixture.iter().map(|w| w.as_slice()).collect()
    }

    /// With what the paths' noise alone could have made taken out of the information.
    pub fn normal_equations(&self, free: &[DMatrix<f64>]) -> Vec<Normal> {
        let (n, m) = (self.at.objective.atoms(), departure::modes().ncols());
        let none = || {
            let sums = Sums {
                coupling: DMatrix::zeros(n, m),
                departure: [DMatrix::zeros(m, m), DMatrix::zeros(m, m)],
                score: DVector::zeros(m),
            };
            vec![sums; free.len()]
        };
        let kernel = self.at.objective.kernel();
        let parts = self
            .at
            .cache
            .evaluate(kernel, &self.slices(), none, |sums, rows| {
                self.for_each(rows, |value| {
                    let (sums, w) = (&mut sums[value.set], value.weight);
                    let [a, b] = &value.by_modes;
                    let modes = 0.5 * (a + b);
                    let weights = 0.5 * (&value.by_weights[0] + &value.by_weights[1]);
                    sums.departure[0].ger(0.5 * w, a, b, 1.0);
                    sums.departure[0].ger(0.5 * w, b, a, 1.0);
                    sums.departure[1].ger(w, &modes, &modes, 1.0);
                    sums.coupling.ger(w, &weights, &modes, 1.0);
                    let residual = 0.5 * (value.residual[0] + value.residual[1]);
                    sums.score.axpy(w * residual, &modes, 1.0);
                });
            });
        let mut total = none();
        for part in parts {
            for (total, part) in total.iter_mut().zip(part) {
                total.coupling += part.coupling;
                total.departure[0] += &part.departure[0];
                total.departure[1] += &part.departure[1];
                total.score += part.score;
            }
        }
        let pass = self.at.pass;
        let known = pass.information.iter().zip(&pass.quadratics);
        let sets = total.into_iter().zip(free).zip(known);
        sets.map(|((sums, free), (information, quadratic))| {
            let coupling = &sums.coupling * free;
            let m = free.ncols();
            let joint = |weights: &DMatrix<f64>, modes: &DMatrix<f64>| {
                let mut joint = DMatrix::zeros(n + m, n + m);
                joint.view_mut((0, 0), (n, n)).copy_from(weights);
                joint.view_mut((0, n), (n, m)).copy_from(&coupling);
                joint.view_mut((n, 0), (m, n)).tr_copy_from(&coupling);
                let modes = free.tr_mul(modes) * free;
                joint.view_mut((n, n), (m, m)).copy_from(&modes);
                joint
            };
            let [halves, mean] = &sums.departure;
            let joint = without_noise(&joint(information, halves), &joint(&quadratic.h, mean));
            Normal {
                information: joint.view((0, 0), (n, n)).into_owned(),
                coupling: joint.view((0, n), (n, m)).into_owned(),
                departure: joint.view((n, n), (m, m)).into_owned(),
                score: free.tr_mul(&sums.score),
            }
        })
        .collect()
    }

    /// The scores of weights and free modes by block of pixels, of the residual that
    /// departures (values of all modes, per set) leave.
    pub fn blocks(
        &self,
        departures: &[DVector<f64>],
        free: &[DMatrix<f64>],
    ) -> Vec<Vec<[DVector<f64>; 2]>> {
        let objective = self.at.objective;
        let (n, m) = (objective.atoms(), departure::modes().ncols());
        let zero = || [DVector::zeros(n), DVector::zeros(m)];
        let none = || vec![BTreeMap::<usize, [DVector<f64>; 2]>::new(); free.len()];
        let parts =
            self.at
                .cache
                .evaluate(objective.kernel(), &self.slices(), none, |blocks, rows| {
                    self.for_each(rows, |value| {
                        let block = objective.block(rows.pixel, value.light);
                        let [weights, modes] = blocks[value.set].entry(block).or_insert_with(zero);
                        for (half, other) in [(0, 1), (1, 0)] {
                            let departed = value.by_modes[other].dot(&departures[value.set]);
                            let residual = 0.5 * value.weight * (value.residual[other] - departed);
                            weights.axpy(residual, &value.by_weights[half], 1.0);
                            modes.axpy(residual, &value.by_modes[half], 1.0);
                        }
                    });
                });
        let mut total = none();
        for part in parts {
            for (total, part) in total.iter_mut().zip(part) {
                for (block, [weights, modes]) in part {
                    let sum = total.entry(block).or_insert_with(zero);
                    sum[0] += weights;
                    sum[1] += modes;
                }
            }
        }
        let sets = total.into_iter().zip(free);
        sets.map(|(blocks, free)| {
            let blocks = blocks.into_values();
            blocks
                .map(|[weights, modes]| [weights, free.tr_mul(&modes)])
                .collect()
        })
        .collect()
    }
}
