//! The squared residual between captured and modelled radiance: which values are
//! compared, and what each weighs. One pass over the cached paths gives its gradient and
//! Gauss–Newton matrix ([`Linearised`]).
//!
//! Residual and derivative come from independent halves of the paths, so that
//! the render's own noise biases neither the loss nor its gradient. Each value is
//! weighted by 1/(σ²_captured + σ²_rendered + (τ I)² + a²), the third term standing for
//! what no mixture of the dictionary can explain, the last for stray light that the shadows
//! show; I and σ_rendered as estimated by paths are
//! those of the cell's neighbours, because a weight that follows a cell's own noise
//! pulls the fit low ([`Modelled`]).

use nalgebra::DVector;

use std::sync::Arc;

use crate::cells::Captured;
use crate::outer_products::Squares;
use crate::simplex::Quadratic;
use crate::transport::{Cache, Cells, DirectMatrix, Kernel};

mod compared;
mod discrepancy_equations;
mod modelled;
mod noise;
mod pass;
mod stray_light;

pub use compared::Value;
pub use discrepancy_equations::DiscrepancyModel;
pub use modelled::Modelled;
pub use noise::ScoreNoise;
pub use pass::Linearised;

/// Which mixtures are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channels {
    /// Weights of their own for R, G and B.
    Separate,
    /// One channel group for all three.
    Shared,
}

impl Channels {
    /// Number of channel groups, each with weights of its own.
    pub fn groups(self) -> usize {
        match self {
            Channels::Separate => 3,
            Channels::Shared => 1,
        }
    }

    /// The channel group of R, G or B, whose weights make it.
    pub fn group(self, channel: usize) -> usize {
        channel.min(self.groups() - 1)
    }
}

/// Captured images, the paths that explain them, and what is compared.
pub struct Objective<'a> {
    cache: &'a Cache,
    direct: &'a DirectMatrix,
    cells: &'a Arc<Cells>,
    values: Arc<Values>,
    channels: Channels,
    kernel: Kernel,
    /// Relative model error τ, 0..=1.
    model_error: f64,
    /// The model discrepancy, where there is one.
    discrepancy: Option<&'a DiscrepancyModel>,
}

/// What is compared, `[light][cell]`.
struct Values {
    /// Captured radiance over lamp strength, per channel.
    target: Vec<Vec<[f64; 3]>>,
    /// Its variance.
    variance: Vec<Vec<[f64; 3]>>,
    /// What one standard deviation of each error that all have in common changes them by.
    common_errors: Vec<Vec<Vec<[f64; 3]>>>,
    /// Cells of each light that are compared.
    compared: Vec<Vec<bool>>,
}

/// Deviation, in standard deviations and in typical deviations of the neighbours, from
/// which a value counts for less.
const OUTLIER_DEVIATIONS: f64 = 4.0;

/// No captured variance counts as less than this part of the usual one around it.
const VARIANCE_FLOOR: f64 = 0.01;

/// Part of the values that may count for less.
const MAX_OUTLIER_FRACTION: f64 = 0.05;

/// Modelled radiance, `[cell][channel]`.
pub type ModelImage = Vec<[Modelled; 3]>;

/// Weights of the residuals, `[light][cell][channel]`; 0 where not compared.
pub type ResidualWeights = Vec<Vec<[f64; 3]>>;

impl<'a> Objective<'a> {
    /// Compares the captured cells with the model of `cache` and `direct`. Under a light near
    /// the edge of whose shadow a cell lies it is left out.
    pub fn new(
        cache: &'a Cache,
        direct: &'a DirectMatrix,
        captured: &'a Captured,
        channels: Channels,
        kernel: Kernel,
        model_error: f64,
    ) -> Self {
        let over_strength = |values: &[[f64; 3]], light: usize, power: i32| -> Vec<[f64; 3]> {
            let strength = cache.strength[light];
            values
                .iter()
                .map(|v| std::array::from_fn(|c| v[c] / strength[c].powi(power)))
                .collect()
        };
        let images = || captured.images.iter().enumerate();
        let compared = |light: usize| {
            (0..captured.len())
                .map(|cell| captured.is_even(cell, light) && is_smooth(direct, cell, light))
                .collect()
        };
        let values = Values {
            target: images()
                .map(|(light, image)| over_strength(&image.mean, light, 1))
                .collect(),
            variance: images()
                .map(|(light, image)| over_strength(&image.variance, light, 2))
                .collect(),
            common_errors: (captured.common_errors.iter())
                .map(|error| {
                    let lights = error.iter().enumerate();
                    lights
                        .map(|(light, of)| over_strength(of, light, 1))
                        .collect()
                })
                .collect(),
            compared: (0..captured.images.len()).map(compared).collect(),
        };
        Self {
            cache,
            direct,
            cells: &captured.cells,
            values: Arc::new(values),
            channels,
            kernel,
            model_error,
            discrepancy: None,
        }
    }

    /// Number of atoms.
    pub fn atoms(&self) -> usize {
        self.cache.atoms.atoms()
    }

    /// Number of channel groups, each with weights of its own.
    pub fn groups(&self) -> usize {
        self.channels.groups()
    }

    /// Which channels share weights.
    pub fn channels(&self) -> Channels {
        self.channels
    }

    /// Number of lamps.
    pub fn lights(&self) -> usize {
        self.values.target.len()
    }

    /// The cells that are compared.
    pub fn cells(&self) -> &'a Cells {
        self.cells
    }

    /// The same, to be kept.
    pub(super) fn shared_cells(&self) -> Arc<Cells> {
        self.cells.clone()
    }

    /// Relative error that the model is allowed.
    pub fn model_error(&self) -> f64 {
        self.model_error
    }

    /// Whether a cell is compared under a light.
    pub fn is_compared(&self, light: usize, cell: usize) -> bool {
        self.values.compared[light][cell]
    }

    /// Which cells are compared under any light.
    pub fn compared_pixels(&self) -> Vec<bool> {
        (0..self.cells.len())
            .map(|cell| self.values.compared.iter().any(|of_light| of_light[cell]))
            .collect()
    }

    /// Whether any cell is compared under a light.
    pub fn compares_any(&self, light: usize) -> bool {
        self.values.compared[light].contains(&true)
    }

    /// The linear part of the model.
    pub fn direct(&self) -> &DirectMatrix {
        self.direct
    }

    /// The instructions that evaluate the paths.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Variance that the model's error is allowed in a value. The stated error is that of a
    /// 64th of the field of view; in a smaller cell it may be larger, as if parts of one erred
    /// independently.
    pub fn allowed(&self, cell: usize, value: f64) -> f64 {
        (self.model_error * value).powi(2) / self.cells.area(cell).min(1.0)
    }

    /// (captured − model)/σ and σ of a compared value; `None` where σ is 0.
    pub fn deviation(
        &self,
        model: &[ModelImage],
        light: usize,
        cell: usize,
        channel: usize,
    ) -> Option<(f64, f64)> {
        let modelled = model[light][cell][channel];
        let value = modelled.value();
        let allowed = self.allowed(cell, value);
        let noise = self.values.variance[light][cell][channel] + modelled.variance;
        let sigma = (noise + allowed).sqrt();
        (sigma > 0.0).then(|| {
            (
                (self.values.target[light][cell][channel] - value) / sigma,
                sigma,
            )
        })
    }

    /// 1/σ² of each compared value as [`Self::deviation`] has it.
    pub(super) fn inverse_variances(&self, model: &[ModelImage]) -> ResidualWeights {
        let weight = |light: usize, cell: usize| match self.is_compared(light, cell) {
            true => std::array::from_fn(|c| {
                let deviation = self.deviation(model, light, cell, c);
                deviation.map_or(0.0, |(_, sigma)| sigma.powi(-2))
            }),
            false => [0.0; 3],
        };
        let image = |light| {
            (0..self.cells.len())
                .map(|cell| weight(light, cell))
                .collect()
        };
        (0..self.lights()).map(image).collect()
    }

    /// Relative error that a model leaves beyond what the noise of capture and render
    /// explains, per channel group: root of the mean over the values, weighted as the fit weighs them.
    pub fn excess_error(&self, model: &[ModelImage]) -> Vec<f64> {
        let mut sums = vec![[0.0; 3]; self.groups()];
        for light in 0..self.lights() {
            for cell in (0..model[light].len()).filter(|&p| self.values.compared[light][p]) {
                for c in 0..3 {
                    let Some((z, sigma)) = self.deviation(model, light, cell, c) else {
                        continue;
                    };
                    let modelled = model[light][cell][c];
                    let noise = self.values.variance[light][cell][c] + modelled.variance;
                    let noise = noise / (sigma * sigma);
                    // A few extreme values are dust, not the material.
                    let excess = z.powi(2).min(25.0) - noise;
                    let sum = &mut sums[self.channels.group(c)];
                    sum[0] += excess;
                    sum[1] += (modelled.value() / sigma).powi(2);
                    sum[2] += excess * excess;
                }
            }
        }
        sums.into_iter()
            .map(|[excess, scale, square]| {
                // Only what stands out of the scatter of the excess itself.
                let sure = (excess - square.sqrt()).max(0.0);
                if scale > 0.0 {
                    (sure / scale).sqrt()
                } else {
                    0.0
                }
            })
            .collect()
    }

    /// Captured radiance over lamp strength, its variance.
    pub fn captured(&self, light: usize, cell: usize) -> [[f64; 3]; 2] {
        [
            self.values.target[light][cell],
            self.values.variance[light][cell],
        ]
    }

    /// Strength of a lamp, by which radiances are divided.
    pub(super) fn strength(&self, light: usize) -> [f64; 3] {
        self.cache.strength[light]
    }

    /// Weights from a model, with the stated model error; the captured images themselves,
    /// without noise, stand in for the first one.
    pub fn weights(&self, model: Option<&[ModelImage]>) -> ResidualWeights {
        let model_error = vec![self.model_error; self.groups()];
        match model {
            Some(model) => self.weights_allowing(model, true, &model_error, None),
            None => self.weights_allowing(&self.as_model(), false, &model_error, None),
        }
    }

    /// Weights for a first round on new paths, from `earlier` weights' pass over them if there
    /// are any: render noise is taken to be, relative to the radiance, at least what the model
    /// `even` has, as that of the solution is not known (docs/adr/0030).
    pub fn first_weights(
        &self,
        earlier: Option<&Linearised>,
        even: &[ModelImage],
    ) -> ResidualWeights {
        let mut model = earlier.map_or_else(|| self.as_model(), |pass| pass.model.clone());
        let values = model.iter_mut().flatten().flatten();
        for (modelled, even) in values.zip(even.iter().flatten().flatten()) {
            if even.value() > 0.0 {
                let noise = even.variance * (modelled.value() / even.value()).powi(2);
                modelled.variance = modelled.variance.max(noise);
            }
        }
        let found = match earlier {
            Some(pass) => self.found_error(pass),
            None => vec![self.model_error; self.groups()],
        };
        let stray_light = earlier.map(|pass| &pass.stray_light[..]);
        self.weights_allowing(&model, earlier.is_some(), &found, stray_light)
    }

    /// Weights after a fit that ended with `pass`: the model is allowed the error that it
    /// was found to have, if that is more than the stated one (docs/adr/0027), and the stray
    /// light that the shadows show.
    pub fn weights_after(&self, pass: &Linearised) -> ResidualWeights {
        let found = self.found_error(pass);
        log::debug!("model error by channel group: {found:?}");
        log::debug!("variance of stray light: {:?}", pass.stray_light);
        self.weights_allowing(&pass.model, true, &found, Some(&pass.stray_light))
    }

    /// Modelled radiance at `mixture`, without the matrices of a whole pass.
    pub fn modelled(&self, mixture: &[DVector<f64>]) -> Vec<ModelImage> {
        let unweighed = vec![vec![[0.0; 3]; self.cells.len()]; self.lights()];
        self.linearise(mixture, &unweighed).model
    }

    /// The stated model error or the one found, per channel group.
    fn found_error(&self, pass: &Linearised) -> Vec<f64> {
        (0..self.groups())
            .map(|group| pass.relative_error(group).max(self.model_error))
            .collect()
    }

    /// The captured images as if they were a model without noise. As they have noise of
    /// their own, none of their light counts as known.
    fn as_model(&self) -> Vec<ModelImage> {
        let exact = |value: &[f64; 3]| {
            value.map(|v| Modelled {
                indirect: v.max(0.0),
                ..Modelled::default()
            })
        };
        self.values
            .target
            .iter()
            .map(|image| image.iter().map(exact).collect())
            .collect()
    }

    fn weights_allowing(
        &self,
        model: &[ModelImage],
        robust: bool,
        model_error: &[f64],
        stray_light: Option<&[[f64; 3]]>,
    ) -> ResidualWeights {
        (0..self.lights())
            .map(|light| {
                let stray_light = stray_light.map_or([0.0; 3], |of| of[light]);
                let robust_weight = robust.then(|| self.robust_weights(model, light));
                (0..self.cells.len())
                    .map(|cell| {
                        if !self.values.compared[light][cell] {
                            return [0.0; 3];
                        }
                        // As in [`Self::allowed`].
                        let area = self.cells.area(cell).min(1.0);
                        std::array::from_fn(|c| {
                            let near = self.cells.around(cell);
                            let near = near.filter(|&other| self.values.compared[light][other]);
                            let near = near.map(|other| model[light][other][c]);
                            let [intensity, rendered] = model[light][cell][c].expected(near);
                            let captured = self.values.variance[light][cell][c]
                                .max(VARIANCE_FLOOR * self.near_variance(light, cell, c));
                            let model =
                                (model_error[self.channels.group(c)] * intensity).powi(2) / area;
                            let errors = self.values.common_errors.iter();
                            let common: f64 = errors.map(|e| e[light][cell][c].powi(2)).sum();
                            let total = captured + rendered + model + stray_light[c] + common;
                            let robust_weight = robust_weight.as_ref().map_or(1.0, |t| t[cell][c]);
                            if total > 0.0 {
                                robust_weight / total
                            } else {
                                0.0
                            }
                        })
                    })
                    .collect()
            })
            .collect()
    }

    /// How far each value of a light is believed, 0..=1: less than 1 only for isolated
    /// values, which dust makes, and for at most `MAX_OUTLIER_FRACTION` of them. Where the
    /// neighbours deviate as well, the model is wrong and must not look right.
    pub fn robust_weights(&self, model: &[ModelImage], light: usize) -> Vec<[f64; 3]> {
        let deviation = |p: usize, c: usize| {
            self.values.compared[light][p]
                .then(|| self.deviation(model, light, p, c))
                .flatten()
                .map(|d| d.0.abs())
        };
        let mut robust_weight = vec![[1.0; 3]; self.cells.len()];
        let mut outliers = Vec::new();
        let mut compared = 0;
        for (p, c) in (0..self.cells.len()).flat_map(|p| [(p, 0), (p, 1), (p, 2)]) {
            let Some(z) = deviation(p, c) else { continue };
            compared += 1;
            if z <= OUTLIER_DEVIATIONS {
                continue;
            }
            let mut two_around = self.two_around(p);
            two_around.retain(|&q| q != p);
            let mut around: Vec<f64> = two_around
                .into_iter()
                .filter_map(|q| deviation(q, c))
                .collect();
            let middle = around.len() / 2;
            let typical = if around.is_empty() {
                1.0
            } else {
                *around.select_nth_unstable_by(middle, f64::total_cmp).1
            };
            let limit = OUTLIER_DEVIATIONS * typical.max(1.0);
            if z > limit {
                outliers.push((z / limit, p, c));
            }
        }
        outliers.sort_by(|a, b| b.0.total_cmp(&a.0));
        outliers.truncate((MAX_OUTLIER_FRACTION * f64::from(compared)) as usize);
        for (excess, p, c) in outliers {
            robust_weight[p][c] = excess.powi(-2);
        }
        robust_weight
    }

    /// The cells that touch one or its neighbours.
    fn two_around(&self, cell: usize) -> Vec<usize> {
        let near = self.cells.around(cell);
        let mut all: Vec<usize> = near.flat_map(|near| self.cells.around(near)).collect();
        all.extend(self.cells.around(cell));
        all.sort_unstable();
        all.dedup();
        all
    }

    /// Part of a light's compared values that are believed less than the others.
    pub fn outlier_fraction(&self, model: &[ModelImage], light: usize) -> f64 {
        let outliers = self.robust_weights(model, light).into_iter().flatten();
        let compared = self.values.compared[light].iter().filter(|&&c| c).count();
        outliers.filter(|&t| t < 1.0).count() as f64 / (3 * compared.max(1)) as f64
    }

    /// Median captured variance of a compared cell and its neighbours. Of the whole image
    /// it would hide the dark parts of a scene with bright ones.
    fn near_variance(&self, light: usize, cell: usize, channel: usize) -> f64 {
        // Of as many pixels as the cell itself has.
        let pixels = |q: usize| self.cells.cell(q).pixels() as f64;
        let mut values: Vec<f64> = std::iter::once(cell)
            .chain(self.cells.around(cell))
            .filter(|&q| self.values.compared[light][q])
            .map(|q| self.values.variance[light][q][channel] * pixels(q) / pixels(cell))
            .collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The direct part alone, which is linear: its least-squares quadratic per channel group,
    /// Eq. (13) of the paper with the rendering under light m (docs/adr/0002).
    pub fn single_bounce(&self, residual_weights: &ResidualWeights) -> Vec<Quadratic> {
        let n = self.atoms();
        let mut squares = vec![Squares::zero(n); self.groups()];
        let mut quadratics = vec![Quadratic::zero(n); self.groups()];
        for (light, weights) in residual_weights.iter().enumerate() {
            for (cell, weights) in weights.iter().enumerate() {
                let row = self.direct.row(cell, light).iter();
                let row: Vec<f64> = row.map(|&v| f64::from(v)).collect();
                for (c, &w) in weights.iter().enumerate() {
                    if w > 0.0 {
                        let target = self.values.target[light][cell][c];
                        let group = self.channels.group(c);
                        squares[group].add(w, &row);
                        let sum = &mut quadratics[group];
                        let g = sum.g.iter_mut().zip(&row);
                        g.for_each(|(g, &v)| *g += w * v * target);
                        sum.c += 0.5 * w * target * target;
                    }
                }
            }
        }
        for (quadratic, squares) in quadratics.iter_mut().zip(squares) {
            quadratic.h = squares.matrix();
        }
        quadratics
    }

    /// Block of a cell under one light, over which model error is taken as correlated.
    pub fn block(&self, cell: usize, light: usize) -> usize {
        light * self.cells.blocks() + self.cells.block(cell)
    }
}

/// Part of a footprint that may show something else, or lie in another light.
const EDGE_FRACTION: f32 = 0.01;

/// Whether a cell shows nothing but the sample, all lit or all in shadow: along silhouettes and
/// edges of shadows an error of the pose or of the light's direction that is far below a pixel
/// changes the radiance by any amount.
fn is_smooth(direct: &DirectMatrix, cell: usize, light: usize) -> bool {
    let lit = direct.lit(cell, light);
    direct.coverage[cell] >= 1.0 - EDGE_FRACTION
        && (lit <= EDGE_FRACTION || lit >= 1.0 - EDGE_FRACTION)
}

#[cfg(test)]
mod tests;
