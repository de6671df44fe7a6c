//! The squared residual between captured and modelled radiance: which values are
//! compared, and what each weighs. One pass over the cached paths gives its gradient and
//! Gauss–Newton matrix ([`Linearised`]).
//!
//! Residual and derivative come from independent halves of the paths, so that
//! the render's own noise biases neither the loss nor its gradient. Each value is
//! weighted by 1/(σ²_captured + σ²_rendered + (τ I)²), the last term standing for
//! what no mixture of the dictionary can explain; what paths say of I and σ_rendered is
//! taken from the pixel's neighbours, because a weight that follows a pixel's own noise
//! pulls the fit low ([`Modelled`]).

use nalgebra::{DMatrix, DVector};

use super::simplex::Quadratic;
use crate::radiance_image::RadianceImage;
use crate::transport::{Cache, DirectMatrix, Kernel};

mod departed;
mod modelled;
mod noise;
mod pass;

pub use departed::DepartedModel;
pub use modelled::{Modelled, around};
pub use noise::ScoreNoise;
pub use pass::Linearised;

/// Which mixtures are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channels {
    /// Weights of their own for R, G and B.
    Separate,
    /// One set of weights for all three.
    Shared,
}

impl Channels {
    /// Number of weight sets.
    pub fn sets(self) -> usize {
        match self {
            Channels::Separate => 3,
            Channels::Shared => 1,
        }
    }
}

/// Captured images, the paths that explain them, and what is compared.
pub struct Objective<'a> {
    cache: &'a Cache,
    direct: &'a DirectMatrix,
    /// Captured radiance over lamp strength: `[light][pixel][channel]`.
    target: Vec<Vec<[f64; 3]>>,
    /// Its variance.
    variance: Vec<Vec<[f64; 3]>>,
    /// Pixels of each light that are compared.
    compared: Vec<Vec<bool>>,
    resolution: [usize; 2],
    channels: Channels,
    kernel: Kernel,
    /// Relative model error τ, 0..=1.
    model_error: f64,
    /// How the material departs from the mixture.
    departed: Option<&'a DepartedModel>,
}

/// Deviation, in standard deviations and in typical deviations of the neighbours, from
/// which a value counts for less.
const DOUBTFUL: f64 = 4.0;

/// No captured variance counts as less than this part of the usual one around it.
const LEAST_OF_NEAR: f64 = 0.01;

/// Part of the values that may count for less.
const MOST_DOUBTED: f64 = 0.05;

/// Modelled radiance, `[pixel][channel]`.
pub type ModelImage = Vec<[Modelled; 3]>;

/// Weights of the residuals, `[light][pixel][channel]`; 0 where not compared.
pub type ResidualWeights = Vec<Vec<[f64; 3]>>;

impl<'a> Objective<'a> {
    /// Compares `captured[light]` with the model of `cache` and `direct`. Pixels that
    /// are invalid, at a silhouette or the edge of a shadow, or outside `region` (if any)
    /// are left out.
    pub fn new(
        cache: &'a Cache,
        direct: &'a DirectMatrix,
        captured: &[RadianceImage],
        region: Option<&[bool]>,
        channels: Channels,
        kernel: Kernel,
        model_error: f64,
    ) -> Self {
        let resolution = [captured[0].width, captured[0].height];
        let over_strength = |values: &[[f32; 3]], light: usize, power: i32| -> Vec<[f64; 3]> {
            let strength = cache.strength[light];
            values
                .iter()
                .map(|v| std::array::from_fn(|c| f64::from(v[c]) / strength[c].powi(power)))
                .collect()
        };
        let compared = captured
            .iter()
            .enumerate()
            .map(|(light, image)| {
                (0..image.mean.len())
                    .map(|p| {
                        let values = image.mean[p].iter().chain(&image.variance[p]);
                        image.valid[p]
                            && region.is_none_or(|r| r[p])
                            && values.copied().all(f32::is_finite)
                            && is_smooth(direct, p, light, resolution)
                    })
                    .collect()
            })
            .collect();
        Self {
            cache,
            direct,
            target: captured
                .iter()
                .enumerate()
                .map(|(l, i)| over_strength(&i.mean, l, 1))
                .collect(),
            variance: captured
                .iter()
                .enumerate()
                .map(|(l, i)| over_strength(&i.variance, l, 2))
                .collect(),
            compared,
            resolution,
            channels,
            kernel,
            model_error,
            departed: None,
        }
    }

    /// Number of atoms.
    pub fn atoms(&self) -> usize {
        self.cache.atoms.atoms()
    }

    /// Number of weight sets.
    pub fn sets(&self) -> usize {
        self.channels.sets()
    }

    /// Number of lamps.
    pub fn lights(&self) -> usize {
        self.target.len()
    }

    /// Width and height of the images, pixels.
    pub fn resolution(&self) -> [usize; 2] {
        self.resolution
    }

    /// Relative error that the model is allowed.
    pub fn model_error(&self) -> f64 {
        self.model_error
    }

    /// Whether a pixel is compared under a light.
    pub fn is_compared(&self, light: usize, pixel: usize) -> bool {
        self.compared[light][pixel]
    }

    /// Which pixels are compared under any light.
    pub fn compared_pixels(&self) -> Vec<bool> {
        let pixels = self.target[0].len();
        (0..pixels)
            .map(|pixel| self.compared.iter().any(|of_light| of_light[pixel]))
            .collect()
    }

    /// Whether any pixel is compared under a light.
    pub fn compares_any(&self, light: usize) -> bool {
        self.compared[light].contains(&true)
    }

    /// The linear part of the model.
    pub fn direct(&self) -> &DirectMatrix {
        self.direct
    }

    /// The instructions that evaluate the paths.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// (captured − model)/σ and σ of a compared value; `None` where σ is 0.
    pub fn deviation(
        &self,
        model: &[ModelImage],
        light: usize,
        pixel: usize,
        channel: usize,
    ) -> Option<(f64, f64)> {
        let modelled = model[light][pixel][channel];
        let value = modelled.value();
        let allowed = (self.model_error * value).powi(2);
        let sigma = (self.variance[light][pixel][channel] + modelled.variance + allowed).sqrt();
        (sigma > 0.0).then(|| ((self.target[light][pixel][channel] - value) / sigma, sigma))
    }

    /// Relative error that a model leaves beyond what the noise of capture and render
    /// explains, per set: root of the mean over the values, weighted as the fit weighs them.
    pub fn misfit(&self, model: &[ModelImage]) -> Vec<f64> {
        let mut sums = vec![[0.0; 3]; self.sets()];
        for light in 0..self.lights() {
            for pixel in (0..model[light].len()).filter(|&p| self.compared[light][p]) {
                for c in 0..3 {
                    let Some((z, sigma)) = self.deviation(model, light, pixel, c) else {
                        continue;
                    };
                    let modelled = model[light][pixel][c];
                    let noise = self.variance[light][pixel][c] + modelled.variance;
                    let noise = noise / (sigma * sigma);
                    // A few wild values are dust, not the material.
                    let excess = z.powi(2).min(25.0) - noise;
                    let sum = &mut sums[self.set_of(c)];
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
    pub fn captured(&self, light: usize, pixel: usize) -> [[f64; 3]; 2] {
        [self.target[light][pixel], self.variance[light][pixel]]
    }

    fn set_of(&self, channel: usize) -> usize {
        match self.channels {
            Channels::Separate => channel,
            Channels::Shared => 0,
        }
    }

    /// Weights from a model, with the stated model error; the captured images themselves,
    /// without noise, stand in for the first one.
    pub fn weights(&self, model: Option<&[ModelImage]>) -> ResidualWeights {
        let model_error = vec![self.model_error; self.sets()];
        match model {
            Some(model) => self.weights_allowing(model, true, &model_error),
            None => self.weights_allowing(&self.as_model(), false, &model_error),
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
            None => vec![self.model_error; self.sets()],
        };
        self.weights_allowing(&model, earlier.is_some(), &found)
    }

    /// Weights after a fit that ended with `pass`: the model is allowed the error that it
    /// was found to have, if that is more than the stated one (docs/adr/0027).
    pub fn weights_after(&self, pass: &Linearised) -> ResidualWeights {
        let found = self.found_error(pass);
        tracing::debug!(?found, "model error");
        self.weights_allowing(&pass.model, true, &found)
    }

    /// Modelled radiance at `mixture`, without the matrices of a whole pass.
    pub fn modelled(&self, mixture: &[DVector<f64>]) -> Vec<ModelImage> {
        let unweighed = vec![vec![[0.0; 3]; self.target[0].len()]; self.lights()];
        self.linearise(mixture, &unweighed).model
    }

    /// The stated model error or the one found, per set.
    fn found_error(&self, pass: &Linearised) -> Vec<f64> {
        (0..self.sets())
            .map(|set| pass.relative_error(set).max(self.model_error))
            .collect()
    }

    /// The captured images as if they were a model without noise. As they have noise of
    /// their own, none of their light counts as known.
    fn as_model(&self) -> Vec<ModelImage> {
        let exact = |value: &[f64; 3]| {
            value.map(|v| Modelled {
                again: v.max(0.0),
                ..Modelled::default()
            })
        };
        self.target
            .iter()
            .map(|image| image.iter().map(exact).collect())
            .collect()
    }

    fn weights_allowing(
        &self,
        model: &[ModelImage],
        doubting: bool,
        model_error: &[f64],
    ) -> ResidualWeights {
        let [width, height] = self.resolution;
        (0..self.lights())
            .map(|light| {
                let trust = doubting.then(|| self.trust(model, light));
                (0..width * height)
                    .map(|p| {
                        if !self.compared[light][p] {
                            return [0.0; 3];
                        }
                        std::array::from_fn(|c| {
                            let beside =
                                |q: usize| self.compared[light][q].then_some(model[light][q][c]);
                            let [intensity, rendered] =
                                model[light][p][c].expected(p, self.resolution, beside);
                            let captured = self.variance[light][p][c]
                                .max(LEAST_OF_NEAR * self.near_variance(light, p, c));
                            let model = (model_error[self.set_of(c)] * intensity).powi(2);
                            let total = captured + rendered + model;
                            let trust = trust.as_ref().map_or(1.0, |t| t[p][c]);
                            if total > 0.0 { trust / total } else { 0.0 }
                        })
                    })
                    .collect()
            })
            .collect()
    }

    /// How far each value of a light is believed, 0..=1: less than 1 only for isolated
    /// values, which dust makes, and for at most [`MOST_DOUBTED`] of them. Where the
    /// neighbours deviate as well, the model is wrong and must not look right.
    pub fn trust(&self, model: &[ModelImage], light: usize) -> Vec<[f64; 3]> {
        let [width, height] = self.resolution;
        let deviation = |p: usize, c: usize| {
            self.compared[light][p]
                .then(|| self.deviation(model, light, p, c))
                .flatten()
                .map(|d| d.0.abs())
        };
        let mut trust = vec![[1.0; 3]; width * height];
        let mut doubted = Vec::new();
        let mut compared = 0;
        for (p, c) in (0..width * height).flat_map(|p| [(p, 0), (p, 1), (p, 2)]) {
            let Some(z) = deviation(p, c) else { continue };
            compared += 1;
            if z <= DOUBTFUL {
                continue;
            }
            let (x, y) = (p % width, p / width);
            let mut around: Vec<f64> = (y.saturating_sub(2)..=(y + 2).min(height - 1))
                .flat_map(|j| {
                    (x.saturating_sub(2)..=(x + 2).min(width - 1)).map(move |i| j * width + i)
                })
                .filter(|&q| q != p)
                .filter_map(|q| deviation(q, c))
                .collect();
            let middle = around.len() / 2;
            let typical = if around.is_empty() {
                1.0
            } else {
                *around.select_nth_unstable_by(middle, f64::total_cmp).1
            };
            let limit = DOUBTFUL * typical.max(1.0);
            if z > limit {
                doubted.push((z / limit, p, c));
            }
        }
        doubted.sort_by(|a, b| b.0.total_cmp(&a.0));
        doubted.truncate((MOST_DOUBTED * f64::from(compared)) as usize);
        for (excess, p, c) in doubted {
            trust[p][c] = excess.powi(-2);
        }
        trust
    }

    /// Part of a light's compared values that are believed less than the others.
    pub fn doubted(&self, model: &[ModelImage], light: usize) -> f64 {
        let doubted = self.trust(model, light).into_iter().flatten();
        let compared = self.compared[light].iter().filter(|&&c| c).count();
        doubted.filter(|&t| t < 1.0).count() as f64 / (3 * compared.max(1)) as f64
    }

    /// Median captured variance of a compared pixel and its neighbours. Of the whole image
    /// it would hide the dark parts of a scene with bright ones.
    fn near_variance(&self, light: usize, pixel: usize, channel: usize) -> f64 {
        let mut values: Vec<f64> = around(pixel, self.resolution)
            .filter(|&q| self.compared[light][q])
            .map(|q| self.variance[light][q][channel])
            .collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The direct part alone, which is linear: its least-squares quadratic per set,
    /// Eq. (13) of the paper with the rendering under light m (docs/adr/0002).
    pub fn single_bounce(&self, residual_weights: &ResidualWeights) -> Vec<Quadratic> {
        let n = self.atoms();
        let mut quadratics = vec![Quadratic::zero(n); self.sets()];
        for (light, weights) in residual_weights.iter().enumerate() {
            for (pixel, weights) in weights.iter().enumerate() {
                let row: Vec<f64> = self
                    .direct
                    .row(pixel, light)
                    .iter()
                    .map(|&v| f64::from(v))
                    .collect();
                for (c, &w) in weights.iter().enumerate() {
                    if w > 0.0 {
                        let target = self.target[light][pixel][c];
                        let sum = &mut quadratics[self.set_of(c)];
                        add_outer(&mut sum.h, &row, w);
                        sum.g
                            .iter_mut()
                            .zip(&row)
                            .for_each(|(g, &v)| *g += w * v * target);
                        sum.c += 0.5 * w * target * target;
                    }
                }
            }
        }
        quadratics
            .iter_mut()
            .for_each(|q| q.h.fill_upper_triangle_with_lower_triangle());
        quadratics
    }

    /// Blocks of 8 × 8 pixels of one light, over which model error is taken as correlated.
    pub fn block(&self, pixel: usize, light: usize) -> usize {
        let [width, _] = self.resolution;
        let (x, y) = (pixel % width / 8, pixel / width / 8);
        (light * self.resolution[1].div_ceil(8) + y) * width.div_ceil(8) + x
    }
}

/// Whether a pixel and its neighbours show nothing but the sample, all lit or all in
/// shadow: along silhouettes and edges of shadows an error of the pose or of the light's
/// direction that is far below a pixel changes the radiance by any amount.
fn is_smooth(direct: &DirectMatrix, pixel: usize, light: usize, resolution: [usize; 2]) -> bool {
    let lit = direct.lit(pixel, light);
    (lit == 0.0 || lit == 1.0)
        && around(pixel, resolution)
            .all(|q| direct.coverage[q] >= 1.0 && direct.lit(q, light) == lit)
}

/// Lower triangle of `h += w · v vᵀ`.
fn add_outer(h: &mut DMatrix<f64>, v: &[f64], w: f64) {
    let n = v.len();
    let data = h.as_mut_slice();
    for j in 0..n {
        let scale = w * v[j];
        if scale != 0.0 {
            let column = &mut data[j * n + j..(j + 1) * n];
            column
                .iter_mut()
                .zip(&v[j..])
                .for_each(|(h, &x)| *h += scale * x);
        }
    }
}
