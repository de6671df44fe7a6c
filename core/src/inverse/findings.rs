//! What speaks against a fit, beyond the causes that [`super::diagnosis`] names: facts about
//! the images and the reported material from which a verdict follows.
//!
//! All are read off the compared values y with their stated variance v, the model m of the
//! material with its render variance, and what the model reflects directly (D) and by
//! interreflection (I), m = D + I.

use glam::DVec2;
use nalgebra::{Matrix2, Vector2};

use super::objective::{ModelImage, Objective};
use crate::shown::nth;
use crate::transport::Cells;

/// How an image would have to be turned over to look like the model's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flip {
    /// Not at all.
    None,
    /// Left and right exchanged.
    Horizontal,
    /// Top and bottom exchanged.
    Vertical,
    /// By half a turn.
    HalfTurn,
}

impl Flip {
    const ALL: [Flip; 4] = [Flip::None, Flip::Horizontal, Flip::Vertical, Flip::HalfTurn];

    /// The cell where the middle of a cell comes to lie; `None` if there is none.
    fn cell(self, cells: &Cells, cell: usize) -> Option<usize> {
        let [width, height] = cells.resolution_px().map(|n| n as f64);
        let DVec2 { x, y } = cells.cell(cell).middle_px();
        let place = match self {
            Flip::None => return Some(cell),
            Flip::Horizontal => DVec2::new(width - x, y),
            Flip::Vertical => DVec2::new(x, height - y),
            Flip::HalfTurn => DVec2::new(width - x, height - y),
        };
        cells.at(place)
    }
}

/// A fact that speaks against a fit. Lights, images and channels count from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// Where neither the lamp nor the sample sends light, the image has some.
    StrayLight {
        /// Index of the image.
        image: usize,
        /// Its root mean square over the image's 99th percentile, of the worst channel.
        share: f64,
        /// The same over the mean of the image's compared cells: with a lens' glare, alike in all
        /// images.
        share_of_mean: f64,
    },
    /// The posterior of a channel's weights is the prior.
    NoInformation {
        /// 0 to 2: red, green, blue; 0 stands for all where the weights are shared.
        channel: usize,
    },
    /// A channel of an image holds no light above its noise.
    DarkChannel {
        /// Index of the image.
        image: usize,
        /// 0 to 2.
        channel: usize,
    },
    /// Residuals larger than noise and model error allow, isolated outliers left out.
    Misfit {
        /// Mean square residual in variances, of the worst image and channel.
        mean_square: f64,
    },
    /// Much of the light is not where the model puts it.
    Unexplained {
        /// Index of the image.
        image: usize,
        /// Σ|y − m| over Σ|y|, what noise makes of it taken off.
        share: f64,
    },
    /// The same radiance in all cells explains an image as well as the material does.
    NoStructure {
        /// Index of the image.
        image: usize,
    },
    /// Neighbouring cells scatter by another noise than the variance states.
    Scatter {
        /// Index of the image.
        image: usize,
        /// Standard deviation found over the one stated.
        ratio: f64,
    },
    /// The images are brighter than any material under this irradiance.
    TooBright {
        /// 0 to 2.
        channel: usize,
        /// Radiance captured over that of the brightest material that comes close.
        ratio: f64,
    },
    /// Direct light and interreflection ask for another irradiance than the stated one.
    Scale {
        /// 0 to 2.
        channel: usize,
        /// Irradiance by the images over the stated one.
        ratio: f64,
        /// Standard uncertainty of its natural logarithm.
        log_std: f64,
    },
    /// The images ask for a material that reflects more than arrives; it was bounded.
    Bounded {
        /// 0 to 2.
        channel: usize,
        /// Largest directional albedo before, above 1.
        albedo: f64,
    },
    /// An image looks like that of another light, or turned over.
    Exchanged {
        /// Index of the image.
        image: usize,
        /// The light whose image it looks like.
        light: usize,
        /// After this.
        flip: Flip,
    },
}

/// What is judged.
pub(super) struct Judged<'a> {
    /// The comparison, with the light of the material.
    pub objective: &'a Objective<'a>,
    /// The material's images.
    pub model: &'a [ModelImage],
    /// Per channel group: directions in which the images have more information than noise could feign; `None`
    /// where no posterior was sought.
    pub informed: Vec<Option<usize>>,
    /// Variance of light in the shadows, per light and channel.
    pub stray_light: &'a [[f64; 3]],
    /// Per channel: weight of black in the reported mixture; `None` without such an atom.
    pub black: [Option<f64>; 3],
    /// Per channel: largest directional albedo of the material before it was bounded.
    pub albedo: [f64; 3],
    /// Mean square residual in variances, per light and channel.
    pub reduced_chi2: &'a [[f64; 3]],
}

/// Mean square residual up to which images count as explained. With thousands of cells its
/// own scatter is a few hundredths; the rest is room for errors that the objective's weights
/// only approximate.
pub const EXPLAINED_MEAN_SQUARE: f64 = 1.3;
/// A channel of an image is dark below this many standard deviations of its sum.
const SIGNIFICANT_DEVIATIONS: f64 = 5.0;
/// Part of the light that the model may put elsewhere.
const TOLERATED_SHARE: f64 = 0.4;
/// Stray light over the image's 99th percentile that is worth a word.
const NOTABLE_STRAY_LIGHT: f64 = 1e-3;
/// What is brighter in the shadows is the image of another light or sample.
const MAX_STRAY_LIGHT: f64 = 0.2;
/// Relative scatter that a model's image must have before one without any is remarkable.
const NOTABLE_SHADING: f64 = 0.05;
/// Standard deviation of the cells' scatter over the stated one, either way, that is
/// reported.
const NOTABLE_SCATTER: f64 = 3.0;
/// Weight of black below which a material is as bright as materials are.
const MAX_BLACK_WEIGHT: f64 = 0.05;
/// How much brighter the images may be then.
const NOTABLE_BRIGHTNESS: f64 = 1.1;
/// How much brighter they may be than a material that could still be brighter: only one whose
/// shading is another is not made so.
const IMPOSSIBLE_BRIGHTNESS: f64 = 2.0;
/// Factor between the irradiance stated and the one that interreflections ask for, either way.
/// Of measured materials on a bowl whose irradiance is known it was 0.95 to 1.10 (docs/adr/0034).
const NOTABLE_SCALE: f64 = 1.25;
/// Directional albedo that the material may have before it is bounded: what posterior and
/// interpolation between angles are wrong by.
const NOTABLE_ALBEDO: f64 = 1.02;
/// By how many of its standard uncertainties the logarithm of that factor must differ from 0.
const SCALE_DEVIATIONS: f64 = 4.0;
/// An image looks like another's if what a scaled copy of that leaves is so much less.
const EXCHANGE_RESIDUAL_RATIO: f64 = 0.5;

/// Everything found, the gravest kind first.
pub(super) fn find(judged: &Judged<'_>) -> Vec<Finding> {
    let mut found = Vec::new();
    let Judged {
        objective, model, ..
    } = judged;
    for (channel, informed) in judged.informed.iter().enumerate() {
        if *informed == Some(0) {
            found.push(Finding::NoInformation { channel });
        }
    }
    let values: Vec<Vec<Compared>> = (0..objective.lights())
        .map(|light| compared(objective, model, light))
        .collect();
    for (image, values) in values.iter().enumerate() {
        found.extend(stray_light(values, image, judged.stray_light[image]));
    }
    let excess_error = excess_error(judged, &values);
    if excess_error > EXPLAINED_MEAN_SQUARE {
        for image in 0..values.len() {
            found.extend(exchanged(objective, model, image));
        }
        found.push(Finding::Misfit {
            mean_square: excess_error,
        });
    }
    for (image, values) in values.iter().enumerate() {
        found.extend(dark_channels(values, image));
        found.extend(unexplained(values, image));
        found.extend(without_structure(values, image));
        found.extend(scatter(objective, model, image));
    }
    for (channel, &albedo) in judged.albedo.iter().enumerate() {
        if albedo > NOTABLE_ALBEDO {
            found.push(Finding::Bounded { channel, albedo });
        }
        let of_channel = || values.iter().flatten().filter(|v| v.channel == channel);
        let bright = judged.black[channel].is_none_or(|black| black < MAX_BLACK_WEIGHT);
        let ratio = brightness(of_channel());
        let limit = if bright {
            NOTABLE_BRIGHTNESS
        } else {
            IMPOSSIBLE_BRIGHTNESS
        };
        if ratio > limit {
            found.push(Finding::TooBright { channel, ratio });
        }
        if let Some([ratio, log_std]) = scale(of_channel())
            && ratio.ln().abs() > (SCALE_DEVIATIONS * log_std).max(NOTABLE_SCALE.ln())
        {
            found.push(Finding::Scale {
                channel,
                ratio,
                log_std,
            });
        }
    }
    found
}

/// A compared value, radiance over lamp strength.
struct Compared {
    channel: usize,
    block: usize,
    captured: f64,
    direct: f64,
    indirect: f64,
    /// Variance of noise.
    noise: f64,
    /// Variance of noise and model error.
    variance: f64,
    /// Less than 1 for an isolated outlier.
    robust_weight: f64,
}

impl Compared {
    fn modelled(&self) -> f64 {
        self.direct + self.indirect
    }

    fn residual(&self) -> f64 {
        self.captured - self.modelled()
    }
}

fn compared(objective: &Objective<'_>, model: &[ModelImage], light: usize) -> Vec<Compared> {
    let robust_weight = objective.robust_weights(model, light);
    let cells = (0..robust_weight.len()).filter(|&p| objective.is_compared(light, p));
    let of_pixel = |cell: usize| {
        let [captured, variance] = objective.captured(light, cell);
        let block = objective.block(cell, light);
        let robust_weight = robust_weight[cell];
        (0..3).map(move |channel| {
            let modelled = model[light][cell][channel];
            let noise = variance[channel] + modelled.variance;
            let allowed = objective.allowed(cell, modelled.value());
            Compared {
                channel,
                block,
                captured: captured[channel],
                direct: modelled.direct,
                indirect: modelled.indirect,
                noise,
                variance: noise + allowed,
                robust_weight: robust_weight[channel],
            }
        })
    };
    cells.flat_map(of_pixel).collect()
}

/// Mean square residual in variances, of the worst image and channel; stray light is allowed for.
fn excess_error(judged: &Judged<'_>, values: &[Vec<Compared>]) -> f64 {
    let mut worst = 0.0f64;
    for (image, values) in values.iter().enumerate() {
        for channel in 0..3 {
            let stray_light = judged.stray_light[image][channel];
            worst = worst.max(if stray_light > 0.0 {
                let of_channel = || values.iter().filter(|v| v.channel == channel);
                let squares = of_channel()
                    .map(|v| v.robust_weight * v.residual().powi(2) / (v.variance + stray_light));
                squares.sum::<f64>() / of_channel().count().max(1) as f64
            } else {
                judged.reduced_chi2[image][channel]
            });
        }
    }
    worst
}

fn stray_light(values: &[Compared], image: usize, variance: [f64; 3]) -> Option<Finding> {
    let shares_of = |channel: usize| {
        let of_channel = values.iter().filter(|v| v.channel == channel);
        let mut captured: Vec<f64> = of_channel.map(|v| v.captured).collect();
        let last = captured.len().checked_sub(1)?;
        let mean = captured.iter().sum::<f64>() / (last + 1) as f64;
        let bright = *captured
            .select_nth_unstable_by(99 * last / 100, f64::total_cmp)
            .1;
        let shares = [bright, mean].map(|level| variance[channel].sqrt() / level);
        (bright > 0.0 && mean > 0.0).then_some(shares)
    };
    let worst = (0..3).filter_map(shares_of);
    let [share, share_of_mean] = worst.max_by(|a, b| a[0].total_cmp(&b[0]))?;
    (NOTABLE_STRAY_LIGHT..MAX_STRAY_LIGHT)
        .contains(&share)
        .then_some(Finding::StrayLight {
            image,
            share,
            share_of_mean,
        })
}

fn dark_channels(values: &[Compared], image: usize) -> Vec<Finding> {
    (0..3)
        .filter(|&channel| {
            let of_channel = values.iter().filter(|v| v.channel == channel);
            let [sum, noise] = of_channel.fold([0.0, 0.0], |[sum, noise], v| {
                [sum + v.captured, noise + v.noise]
            });
            sum <= SIGNIFICANT_DEVIATIONS * f64::sqrt(noise)
        })
        .map(|channel| Finding::DarkChannel { image, channel })
        .collect()
}

fn unexplained(values: &[Compared], image: usize) -> Option<Finding> {
    let sum = |f: &dyn Fn(&Compared) -> f64| values.iter().map(f).sum::<f64>();
    // Mean magnitude of a normal deviate: √(2/π).
    let by_noise = std::f64::consts::FRAC_2_PI.sqrt() * sum(&|v| v.noise.sqrt());
    let share = (sum(&|v| v.residual().abs()) - by_noise) / sum(&|v| v.captured.abs());
    (share > TOLERATED_SHARE).then_some(Finding::Unexplained { image, share })
}

/// Compares the material's image with an even one, where the material's is not even itself.
fn without_structure(values: &[Compared], image: usize) -> Option<Finding> {
    let (mut by_model, mut by_even) = (0.0, 0.0);
    let mut is_shaded = false;
    for channel in 0..3 {
        let of_channel = || {
            let known = |v: &&Compared| v.channel == channel && v.variance > 0.0;
            values.iter().filter(known)
        };
        let weight: f64 = of_channel().map(|v| 1.0 / v.variance).sum();
        let mean_of = |f: &dyn Fn(&Compared) -> f64| -> f64 {
            of_channel().map(|v| f(v) / v.variance).sum::<f64>() / weight
        };
        let even = mean_of(&|v| v.captured);
        let modelled = mean_of(&|v| v.modelled());
        let shading = mean_of(&|v| (v.modelled() - modelled).powi(2)).sqrt();
        is_shaded |= shading > NOTABLE_SHADING * modelled.abs();
        by_even += weight * mean_of(&|v| (v.captured - even).powi(2));
        by_model += weight * mean_of(&|v| v.residual().powi(2));
    }
    (is_shaded && by_even <= by_model).then_some(Finding::NoStructure { image })
}

/// Noise by second differences along the rows, against the stated one. Those of the residual
/// say whether more was stated too little; those of the captured image itself, which no noise
/// of the render blurs, whether it was too much. Median of squares, so that edges and
/// highlights do not count; of a normal's square it is 0.4549.
fn scatter(objective: &Objective<'_>, model: &[ModelImage], image: usize) -> Option<Finding> {
    const MEDIAN_OF_SQUARE: f64 = 0.4549;
    let cells = objective.cells();
    let (mut of_image, mut of_residual) = (Vec::new(), Vec::new());
    for cell in 0..cells.len() {
        // Neighbours of the same size.
        let here = cells.cell(cell);
        let [x, y] = here.middle_px().to_array();
        let side = f64::from(here.side_px);
        let ends = [x - side, x + side].map(|x| {
            let other = cells.at(DVec2::new(x, y))?;
            (cells.cell(other).side_px == here.side_px).then_some(other)
        });
        let [Some(left), Some(right)] = ends else {
            continue;
        };
        let row = [left, cell, right];
        if !row.iter().all(|&p| objective.is_compared(image, p)) {
            continue;
        }
        for channel in 0..3 {
            let (mut image_difference, mut residual_difference) = (0.0, 0.0);
            let (mut image_variance, mut residual_variance) = (0.0, 0.0);
            for (&p, weight) in row.iter().zip([1.0, -2.0, 1.0f64]) {
                let [captured, variance] = objective.captured(image, p);
                let modelled = model[image][p][channel];
                let allowed = objective.allowed(p, modelled.value());
                image_difference += weight * captured[channel];
                image_variance += weight * weight * variance[channel];
                residual_difference += weight * (captured[channel] - modelled.value());
                residual_variance +=
                    weight * weight * (variance[channel] + modelled.variance + allowed);
            }
            if image_variance > 0.0 {
                of_image.push(image_difference.powi(2) / image_variance);
                of_residual.push(residual_difference.powi(2) / residual_variance);
            }
        }
    }
    if of_image.len() < 30 {
        return None;
    }
    let middle = of_image.len() / 2;
    let median = |mut squares: Vec<f64>| {
        (*squares.select_nth_unstable_by(middle, f64::total_cmp).1 / MEDIAN_OF_SQUARE).sqrt()
    };
    let [at_most, beyond_model_error] = [of_image, of_residual].map(median);
    log::debug!(
        "scatter of neighbouring cells, {image}: at most {at_most}, beyond the model's error {beyond_model_error}",
        image = nth("image", image)
    );
    // Noise below the model's error harms nothing, whatever is stated.
    let ratio = if beyond_model_error > NOTABLE_SCATTER {
        beyond_model_error
    } else {
        at_most
    };
    let is_notable = beyond_model_error > NOTABLE_SCATTER || at_most < 1.0 / NOTABLE_SCATTER;
    is_notable.then_some(Finding::Scatter { image, ratio })
}

/// Factor by which the model's images would have to be brighter: Σ y m/σ² over Σ m²/σ².
fn brightness<'a>(values: impl Iterator<Item = &'a Compared>) -> f64 {
    let [mut cross, mut square] = [0.0, 0.0];
    for v in values.filter(|v| v.variance > 0.0 && v.robust_weight >= 1.0) {
        cross += v.captured * v.modelled() / v.variance;
        square += v.modelled().powi(2) / v.variance;
    }
    if square > 0.0 { cross / square } else { 1.0 }
}

/// Irradiance by the images over the stated one, and the standard uncertainty of its
/// logarithm; `None` where too little is interreflected.
///
/// If the irradiance is s times the stated one, direct light of a material of reflectance ρ is
/// sρD and light reflected twice sρ²I. Fitted with the irradiance as stated, with a reflectance
/// ρ′, the model's parts must be scaled by a = sρ/ρ′ and b = sρ²/ρ′², so s = a²/b. Their
/// covariance is the sandwich over blocks of cells.
fn scale<'a>(values: impl Iterator<Item = &'a Compared>) -> Option<[f64; 2]> {
    let values: Vec<&Compared> = values
        .filter(|v| v.variance > 0.0 && v.robust_weight >= 1.0)
        .collect();
    let blocks = 1 + values.iter().map(|v| v.block).max()?;
    let row = |v: &Compared| Vector2::new(v.direct, v.indirect);
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for v in &values {
        normal += row(v) * row(v).transpose() / v.variance;
        right += row(v) * (v.captured / v.variance);
    }
    let inverse = normal.try_inverse()?;
    let found = inverse * right;
    let [a, b] = [found.x, found.y];
    if a <= 0.0 || b <= 0.0 {
        return None;
    }
    let mut scores = vec![Vector2::zeros(); blocks];
    for v in &values {
        let left = v.captured - row(v).dot(&found);
        scores[v.block] += row(v) * (left / v.variance);
    }
    let scatter: Matrix2<f64> = scores.iter().map(|s| s * s.transpose()).sum();
    // Noise is part of the scores' scatter, but few blocks could miss it.
    let covariance = inverse * scatter * inverse + inverse;
    let slope = Vector2::new(2.0 / a, -1.0 / b);
    let log_std = slope.dot(&(covariance * slope)).sqrt();
    log::debug!(
        "scale by interreflections: {} (log std {log_std}), from {a} and {b}",
        a * a / b
    );
    log_std.is_finite().then_some([a * a / b, log_std])
}

/// The light and the flip whose modelled image an image resembles far more than its own.
fn exchanged(objective: &Objective<'_>, model: &[ModelImage], image: usize) -> Option<Finding> {
    let own = unlike(objective, model, image, image, Flip::None)?;
    let mut best = (own, image, Flip::None);
    for light in 0..objective.lights() {
        for flip in Flip::ALL {
            if let Some(left) = unlike(objective, model, image, light, flip)
                && left < best.0
            {
                best = (left, light, flip);
            }
        }
    }
    let (left, light, flip) = best;
    (left < EXCHANGE_RESIDUAL_RATIO * own).then_some(Finding::Exchanged { image, light, flip })
}

/// Part of an image's square that a scaled copy of a light's model, turned over, leaves: 1 − cos².
fn unlike(
    objective: &Objective<'_>,
    model: &[ModelImage],
    image: usize,
    light: usize,
    flip: Flip,
) -> Option<f64> {
    let cells = objective.cells();
    let [mut cross, mut captured, mut modelled] = [0.0; 3];
    for cell in (0..cells.len()).filter(|&p| objective.is_compared(image, p)) {
        let place = flip.cell(cells, cell);
        let Some(place) = place.filter(|&place| objective.is_compared(light, place)) else {
            continue;
        };
        let [values, _] = objective.captured(image, cell);
        for (value, model) in values.iter().zip(&model[light][place]) {
            cross += value * model.value();
            captured += value * value;
            modelled += model.value().powi(2);
        }
    }
    (captured * modelled > 0.0).then(|| 1.0 - cross * cross / (captured * modelled))
}
