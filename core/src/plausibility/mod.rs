//! Whether captured images can show the sample that a scene describes, asked before a fit
//! begins: black, negative, noiseless or repeated images give weights as any others do, and
//! nothing in the result would say what they came from.
//!
//! What the images are measured against is a white sample: the direct reflection of a
//! Lambertian surface of albedo 1 in the same place, under the same lights.

mod brightest;

use brightest::brightest;

use crate::brdf::{Atom, Dictionary};
use crate::cells::{Captured, CellImage};
use crate::radiance_image::CHANNEL_NAMES;
use crate::shown::nth;
use crate::transport::{Cells, DirectMatrix, Scene};

/// Why images cannot be fitted. Lights and images count from 0; texts count them from 1.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Implausible {
    /// A light that gives none, of which no image can be explained.
    #[error(
        "the {} irradiance of {light} is {value}, allowed is a finite number above 0",
        CHANNEL_NAMES[*channel], light = nth("light", *light)
    )]
    Irradiance {
        /// Index of the light.
        light: usize,
        /// 0 to 2: red, green, blue.
        channel: usize,
        /// As stated (of a point light, its intensity).
        value: f64,
    },
    /// A light behind the sample, or at its horizon.
    #[error(
        "{light} brings {:.3}% of its irradiance to the surface that the camera sees and lights {lit} cells of its image above noise, 1% or {MIN_LIT_CELLS} cells are needed: it lies behind the sample or at its horizon",
        100.0 * mean_cosine, light = nth("light", *light)
    )]
    NotLit {
        /// Index of the light.
        light: usize,
        /// Mean cosine of incidence over the visible surface, 0 in its shadow.
        mean_cosine: f64,
        /// Cells that it reaches whose value stands out of noise.
        lit: usize,
    },
    /// Nothing but noise, or nothing at all.
    #[error(
        "{image} shows no light: its mean radiance on the sample is {mean:.2e} ± {std_dev:.2e}, that of a white sample would be {white:.2e}", image = nth("image", *image)
    )]
    NoLight {
        /// Index of the image.
        image: usize,
        /// Mean radiance over the sample's pixels and channels.
        mean: f64,
        /// Its standard deviation, by the stated variances.
        std_dev: f64,
        /// Mean radiance of a white Lambertian sample by direct reflection.
        white: f64,
    },
    /// Far beyond what any material reflects, at any angle.
    #[error(
        "{}{image} is {} times as bright as the brightest material under the stated irradiance",
        channel.map_or(String::new(), |channel| format!("in the {} channel, ", CHANNEL_NAMES[channel])),
        factor(*ratio), image = nth("image", *image)
    )]
    TooBright {
        /// Index of the image.
        image: usize,
        /// 0 to 2 where one channel alone is; `None` where all are.
        channel: Option<usize>,
        /// Mean radiance over that of the brightest material of the dictionary.
        ratio: f64,
    },
    /// Less than no light.
    #[error(
        "{image} is negative on {:.0}% of the sample by more than 5 standard deviations",
        100.0 * share, image = nth("image", *image)
    )]
    Negative {
        /// Index of the image.
        image: usize,
        /// Part of the sample's values.
        share: f64,
    },
    /// The same value everywhere, where shading must vary.
    #[error(
        "{image} has the same radiance in every pixel of the sample ({mean:.2e}), where a white sample's would vary by {:.0}%",
        100.0 * expected, image = nth("image", *image)
    )]
    Constant {
        /// Index of the image.
        image: usize,
        /// The radiance.
        mean: f64,
        /// Standard deviation over mean of a white sample's.
        expected: f64,
    },
    /// All light in one pixel.
    #[error("{:.0}% of the light of {image} is in one pixel, x {x}, y {y}", 100.0 * share, image = nth("image", *image))]
    OnePixel {
        /// Index of the image.
        image: usize,
        /// Part of the light on the sample.
        share: f64,
        /// Column.
        x: usize,
        /// Row, from the top.
        y: usize,
    },
    /// A capture without noise.
    #[error(
        "the variance of {image} is 0 where its radiance is not, in {:.0}% of the sample's values",
        100.0 * share, image = nth("image", *image)
    )]
    NoVariance {
        /// Index of the image.
        image: usize,
        /// Part of the sample's values.
        share: f64,
    },
    /// One image for two lights.
    #[error("images {} and {} are equal in every pixel, though their lights differ", first + 1, second + 1)]
    Repeated {
        /// Index of an image.
        first: usize,
        /// Index of the other.
        second: usize,
    },
}

impl Implausible {
    /// The image that is at fault; `None` where a light of the scene is.
    pub fn image(&self) -> Option<usize> {
        use Implausible::*;
        match *self {
            Irradiance { .. } | NotLit { .. } => None,
            NoLight { image, .. }
            | TooBright { image, .. }
            | Negative { image, .. }
            | Constant { image, .. }
            | OnePixel { image, .. }
            | NoVariance { image, .. }
            | Repeated { second: image, .. } => Some(image),
        }
    }
}

/// A light must bring this part of its irradiance to the visible surface on average: of a
/// flat sample, one that stands 0.6° above its horizon.
const MIN_MEAN_COSINE: f64 = 0.01;
/// Or it must light so many cells above noise: a lamp far behind a ball lights a narrow crescent.
const MIN_LIT_CELLS: usize = 20;
/// Below this part of a white sample's radiance an image counts as black, whatever variance
/// it states: the blackest coatings reflect some 3e-4 of the light.
const MIN_RADIANCE_RATIO: f64 = 1e-5;
/// How much brighter than the brightest material of the dictionary images may be whose
/// irradiance is known: measured materials are no mixtures, and retroreflect a little.
const MAX_BRIGHTNESS_RATIO: f64 = 2.0;
/// A channel counts as too bright alone where the others are below this part of it.
const OTHER_CHANNELS_RATIO: f64 = 0.2;
/// By how many of its standard deviations a stated irradiance may be wrong.
const IRRADIANCE_DEVIATIONS: f64 = 2.0;
/// Standard deviations by which light must stand out of noise, and negative values below 0.
const SIGNIFICANT_DEVIATIONS: f64 = 5.0;
/// Part of the values that may be significantly negative, or without variance.
const TOLERATED_SHARE: f64 = 0.1;
/// Part of the light that one pixel may hold. A highlight of the narrowest lobe lies in one or
/// two, but not alone.
const ONE_PIXEL_SHARE: f64 = 0.9;
/// Relative scatter that a white sample's shading must have before an image without any is
/// refused: a flat sample under one direction has none.
const NOTABLE_SHADING: f64 = 0.05;
/// Square root of the rays through a cell for the white sample.
const STRATA: u32 = 3;

/// What a white sample would show: radiance per unit of the light's strength, `[light][cell]`.
fn white_radiance(scene: &Scene, cells: &Cells) -> Option<Vec<Vec<f64>>> {
    let atom = Atom::Lambertian { albedo: 1.0 };
    let dictionary = Dictionary::new("white", vec![atom]).ok()?;
    let direct = DirectMatrix::new(scene, cells, &dictionary, STRATA, 0);
    let of_light = |light: usize| {
        let of_cell = |cell: usize| f64::from(direct.row(cell, light)[0]);
        (0..cells.len()).map(of_cell).collect()
    };
    Some((0..scene.lights.len()).map(of_light).collect())
}

/// Refuses images that cannot be those of the scene. What needs a fit to be seen is left to
/// the findings of one. `log_std` is the standard deviation of the natural logarithm of the
/// stated irradiance, 0 where it is exact.
///
/// # Errors
/// The first [`Implausible`] found.
pub fn check(
    scene: &Scene,
    captured: &Captured,
    dictionary: &Dictionary,
    log_std: f64,
) -> Result<(), Implausible> {
    check_lights(scene)?;
    let Some(white) = white_radiance(scene, &captured.cells) else {
        return Ok(());
    };
    for (light, (white, image)) in white.iter().zip(&captured.images).enumerate() {
        let mean_cosine = std::f64::consts::PI * mean(white) / reference_irradiance(scene, light);
        let lit = (0..white.len()).filter(|&cell| white[cell] > 0.0 && stands_out(image, cell));
        let lit = lit.count();
        if mean_cosine < MIN_MEAN_COSINE && lit < MIN_LIT_CELLS {
            return Err(Implausible::NotLit {
                light,
                mean_cosine,
                lit,
            });
        }
    }
    let means: Vec<f64> = white.iter().map(|white| mean(white)).collect();
    let allowed = MAX_BRIGHTNESS_RATIO * (IRRADIANCE_DEVIATIONS * log_std).exp();
    let brightest = brightest(scene, &captured.cells, dictionary, &means);
    for (light, image) in captured.images.iter().enumerate() {
        let strength = scene.lights[light].strength();
        let brightest = strength.map(|strength| strength * brightest[light]);
        check_brightness(light, image, brightest, allowed)?;
    }
    for (light, (image, white)) in captured.images.iter().zip(&white).enumerate() {
        let strength = mean(&scene.lights[light].strength());
        let white = white.iter().map(|unit| unit * strength).collect();
        Values { image, white }.check(light, &captured.cells)?;
    }
    for (second, image) in captured.images.iter().enumerate() {
        let same = |&first: &usize| captured.images[first].mean == image.mean;
        if let Some(first) = (0..second).find(same) {
            return Err(Implausible::Repeated { first, second });
        }
    }
    Ok(())
}

/// Whether the light of a cell, all channels together, exceeds its noise.
fn stands_out(image: &CellImage, cell: usize) -> bool {
    let [light, variance] = [&image.mean, &image.variance].map(|of| of[cell].iter().sum::<f64>());
    light > SIGNIFICANT_DEVIATIONS * variance.sqrt()
}

/// Refuses an image that is more than `allowed` times as bright as the brightest material, per
/// channel, beyond its noise and without the brightest cell: a hot pixel says nothing of the
/// irradiance.
fn check_brightness(
    index: usize,
    image: &CellImage,
    brightest: [f64; 3],
    allowed: f64,
) -> Result<(), Implausible> {
    let count = image.mean.len().max(1) as f64;
    let mut ratios = [0.0; 3];
    let mut sure = [false; 3];
    for channel in 0..3 {
        let of_channel = |values: &[[f64; 3]]| -> Vec<f64> {
            values.iter().map(|value| value[channel]).collect()
        };
        let values = of_channel(&image.mean);
        let highest = values.iter().copied().fold(0.0, f64::max);
        let mean = (values.iter().sum::<f64>() - highest) / count;
        let noise = of_channel(&image.variance).iter().sum::<f64>().sqrt() / count;
        ratios[channel] = mean / brightest[channel];
        sure[channel] = mean - SIGNIFICANT_DEVIATIONS * noise > allowed * brightest[channel];
    }
    let Some(worst) = (0..3)
        .filter(|&channel| sure[channel])
        .max_by(|&a, &b| ratios[a].total_cmp(&ratios[b]))
    else {
        return Ok(());
    };
    let is_alone = (0..3).all(|c| c == worst || ratios[c] < OTHER_CHANNELS_RATIO * ratios[worst]);
    Err(Implausible::TooBright {
        image: index,
        channel: is_alone.then_some(worst),
        ratio: ratios[worst],
    })
}

/// Two significant digits.
fn factor(ratio: f64) -> String {
    match ratio {
        ..10.0 => format!("{ratio:.1}"),
        ..1e4 => format!("{ratio:.0}"),
        _ => format!("{ratio:.1e}"),
    }
}

fn check_lights(scene: &Scene) -> Result<(), Implausible> {
    for (light, lamp) in scene.lights.iter().enumerate() {
        for (channel, value) in lamp.strength().into_iter().enumerate() {
            if !(value.is_finite() && value > 0.0) {
                return Err(Implausible::Irradiance {
                    light,
                    channel,
                    value,
                });
            }
        }
    }
    Ok(())
}

/// Irradiance across the light's direction at the sample's middle, per unit of strength.
fn reference_irradiance(scene: &Scene, light: usize) -> f64 {
    let [low, high] = scene.sample().bounds_mm();
    let middle = 0.5 * (low + high);
    f64::from(
        scene.lights[light]
            .sample(middle, [0.5; 2])
            .relative_irradiance,
    )
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Standard deviation over mean; 0 of nothing.
fn relative_scatter(values: &[f64]) -> f64 {
    let mean = mean(values);
    let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    let scatter = (square / values.len().max(1) as f64).sqrt();
    if mean.abs() > 0.0 {
        scatter / mean.abs()
    } else {
        0.0
    }
}

/// An image, and that of a white sample.
struct Values<'a> {
    image: &'a CellImage,
    /// Radiance of a white sample, mean of the channels.
    white: Vec<f64>,
}

impl Values<'_> {
    fn check(&self, image: usize, cells: &Cells) -> Result<(), Implausible> {
        let count = 3.0 * cells.len() as f64;
        let white = mean(&self.white);
        let total: f64 = self.image.mean.iter().flatten().sum();
        let variance: f64 = self.image.variance.iter().flatten().sum();
        let average = total / count;

        // How bright, against noise and against white.
        let share = self.share(|mean, variance| mean < -SIGNIFICANT_DEVIATIONS * variance.sqrt());
        let magnitude: f64 = self.image.mean.iter().flatten().map(|v| v.abs()).sum();
        if share > TOLERATED_SHARE && magnitude - total > 2.0 * TOLERATED_SHARE * magnitude {
            return Err(Implausible::Negative { image, share });
        }
        if total <= SIGNIFICANT_DEVIATIONS * variance.sqrt() || average < MIN_RADIANCE_RATIO * white
        {
            return Err(Implausible::NoLight {
                image,
                mean: average,
                std_dev: variance.sqrt() / count,
                white,
            });
        }

        // Where the light is.
        let light_of = |values: &[f64; 3]| values.iter().map(|v| v.abs()).sum::<f64>();
        let brightest = (0..cells.len()).max_by(|&a, &b| {
            light_of(&self.image.mean[a]).total_cmp(&light_of(&self.image.mean[b]))
        });
        if let Some(brightest) = brightest.filter(|_| cells.len() > 1) {
            let share = light_of(&self.image.mean[brightest]) / magnitude;
            if share > ONE_PIXEL_SHARE {
                let [x, y] = cells.cell(brightest).corner_px.map(|at| at as usize);
                return Err(Implausible::OnePixel { image, share, x, y });
            }
        }
        let expected = relative_scatter(&self.white);
        let first = self.image.mean[0];
        if expected > NOTABLE_SHADING && self.image.mean.iter().all(|values| *values == first) {
            return Err(Implausible::Constant {
                image,
                mean: average,
                expected,
            });
        }

        // What is said of the noise.
        let share = self.share(|mean, variance| variance == 0.0 && mean != 0.0);
        if share > TOLERATED_SHARE {
            return Err(Implausible::NoVariance { image, share });
        }
        Ok(())
    }

    /// Part of the values of which something holds, given mean and variance.
    fn share(&self, holds: impl Fn(f64, f64) -> bool) -> f64 {
        let values = self.image.mean.iter().flatten();
        let both = values.zip(self.image.variance.iter().flatten());
        let count = both
            .filter(|(mean, variance)| holds(**mean, **variance))
            .count();
        count as f64 / (3 * self.image.mean.len()) as f64
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DVec2, DVec3};

    use super::*;
    use crate::brdf::Mixture;
    use crate::cells::CellOptions;
    use crate::geometry::Shape;
    use crate::transport::{Camera, Light, RenderOptions, Shading, render};

    /// A white ball whose lamp stands so far from the camera, with noise of this standard
    /// deviation.
    fn lit_from(off_deg: f64, noise: f32) -> Result<(), Implausible> {
        let (sin, cos) = off_deg.to_radians().sin_cos();
        let light = Light::distant(DVec3::new(sin, 0.0, cos), [1.0; 3]);
        let ball = Shape::Sphere {
            radius_mm: 1.0,
            segments: 128,
        };
        let camera = Camera::above([64; 2], DVec2::splat(2.2), 5.0);
        let mesh = ball.mesh().unwrap();
        let scene = Scene::new(mesh, Shading::Smooth, camera, vec![light]);
        let white = Dictionary::new("white", vec![Atom::Lambertian { albedo: 1.0 }]).unwrap();
        let mixture = Mixture::new(Arc::new(white.clone()), std::array::from_fn(|_| vec![1.0]));
        let mut images = render(&scene, &mixture.unwrap(), &RenderOptions::default());
        for variance in &mut images[0].variance {
            *variance = [noise * noise; 3];
        }
        let captured = Captured::new(&scene, &images, &CellOptions::exact()).unwrap();
        check(&scene, &captured, &white, 0.0)
    }

    /// A lamp far behind a ball lights a crescent: less than 1% of its light arrives on average,
    /// and so many cells stand out of noise that the image says something.
    #[test]
    fn a_crescent_of_twenty_cells_is_lit() {
        assert_eq!(lit_from(120.0, 1e-3), Ok(()));
        assert_eq!(lit_from(155.0, 1e-4), Ok(()));
        let refused = lit_from(155.0, 0.3).unwrap_err();
        assert!(
            matches!(refused, Implausible::NotLit { mean_cosine, lit, .. }
                if (0.002..0.01).contains(&mean_cosine) && lit < MIN_LIT_CELLS),
            "{refused}"
        );
        let refused = lit_from(180.0, 1e-4).unwrap_err();
        assert!(
            matches!(refused, Implausible::NotLit { lit: 0, .. }),
            "{refused}"
        );
    }
}
