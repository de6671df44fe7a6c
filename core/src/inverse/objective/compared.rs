//! The one loop over compared values: every cell, light and channel, with both halves of the
//! paths.

use nalgebra::{DMatrix, DVector};

use super::{Objective, ResidualWeights};
use crate::transport::CellRows;

/// A compared value. Radiances are over the lamp's strength.
pub struct Value<'a> {
    /// The light.
    pub light: usize,
    /// The cell.
    pub cell: usize,
    /// R, G or B.
    pub channel: usize,
    /// The channel group, whose weights make it.
    pub group: usize,
    /// Block of cells of one light, within which model error is taken as correlated.
    pub block: usize,
    /// Weight of the squared residual, above 0.
    pub weight: f64,
    /// Variance of the captured value.
    pub variance: f64,
    /// Direct light of the model.
    pub direct: f64,
    /// All light of the model, by half.
    pub model: [f64; 2],
    /// Captured − model, by half.
    pub residual: [f64; 2],
    /// Derivatives of the model by the weights, by half.
    pub by_weights: [&'a [f64]; 2],
    /// Derivatives of the indirect light along the modes of a discrepancy, by half; empty unless
    /// requested.
    pub by_modes: [&'a [f32]; 2],
}

impl Objective<'_> {
    /// Sums over all values with a weight at `mixture`: `visit` adds one to the sum of some
    /// cells, which start as `zero`, `join` adds such sums, in a fixed order.
    pub(in crate::inverse) fn accumulate<T: Send>(
        &self,
        mixture: &[DVector<f64>],
        residual_weights: &ResidualWeights,
        modes: Option<&DMatrix<f64>>,
        zero: impl Fn() -> T + Sync,
        visit: impl Fn(&mut T, &Value<'_>) + Sync,
        join: impl Fn(&mut T, T),
    ) -> T {
        let group = || (zero(), self.row_pair());
        let parts = self.evaluate(mixture, modes, group, |(sum, pair), rows| {
            self.visit_cell(rows, mixture, residual_weights, pair, |value| {
                visit(sum, value)
            });
        });
        let mut total = zero();
        for (part, _) in parts {
            join(&mut total, part);
        }
        total
    }

    /// Room for the derivatives of a value.
    pub(super) fn row_pair(&self) -> [Vec<f64>; 2] {
        [vec![0.0; self.atoms()], vec![0.0; self.atoms()]]
    }

    /// Visits the values of a cell that have a weight.
    pub(super) fn visit_cell(
        &self,
        rows: &CellRows<'_>,
        mixture: &[DVector<f64>],
        residual_weights: &ResidualWeights,
        pair: &mut [Vec<f64>; 2],
        mut visit: impl FnMut(&Value<'_>),
    ) {
        let (cell, groups) = (rows.cell, self.groups());
        for (light, weights) in residual_weights.iter().enumerate() {
            for (channel, &weight) in weights[cell].iter().enumerate() {
                if weight <= 0.0 {
                    continue;
                }
                let group = self.channels.group(channel);
                let row = light * groups + group;
                let direct = self.direct_light(cell, light, channel, &mixture[group]);
                let model = [0, 1].map(|half| direct + f64::from(rows.value[half][row]));
                let [target, variance] = self.captured(light, cell).map(|of| of[channel]);
                let [a, b] = pair;
                self.derivatives(rows, light, channel, [a, b]);
                let modes = rows.by_modes[0].len() / rows.value[0].len();
                let along = row * modes..(row + 1) * modes;
                visit(&Value {
                    light,
                    cell,
                    channel,
                    group,
                    block: self.block(cell, light),
                    weight,
                    variance,
                    direct,
                    model,
                    residual: model.map(|m| target - m),
                    by_weights: [a, b],
                    by_modes: rows.by_modes.map(|all| &all[along.clone()]),
                });
            }
        }
    }
}
