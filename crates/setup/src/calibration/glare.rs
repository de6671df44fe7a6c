//! The lens' veiling glare, from black traps on a white card.
//!
//! A trap sends no light of its own but a stated, small part of what the card sends; what the
//! camera sees in it came from elsewhere in the image. The even part is the same in all traps,
//! the halo falls with the distance from their edges: with the halo's width given, both shares are
//! linear in the traps' pixels. The width is that of the least residual, and its uncertainty
//! widens that of the shares.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use super::mirror_sphere::Grey;
use super::record::{BadValue, Kind, Measured, Values, within};
use super::white::Region;
use crate::cells::glare::{BlockSums, Glare};
use crate::radiance_image::RadianceImage;
use glam::DVec2;

/// The glare of a lens at one aperture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GlareValues {
    /// Share of the light that is spread evenly over the frame.
    pub uniform: Measured,
    /// Share that goes into a halo.
    pub halo: Measured,
    /// Correlation of the two, -1 to 1.
    pub correlation: f64,
    /// Length over which the halo falls to 1/e, part of the image's diagonal.
    pub halo_width: f64,
    /// What the traps reflect over what the card does.
    pub trap_reflectance: Measured,
    /// Pixels of the traps.
    pub pixels: usize,
    /// What the two shares leave unexplained in the traps, over the card's radiance, root mean
    /// square.
    pub residual: f64,
}

impl Values for GlareValues {
    const KIND: Kind = Kind::Glare;

    fn check(&self) -> Result<(), BadValue> {
        self.uniform.check("uniform", 0.0, 0.1)?;
        self.halo.check("halo", 0.0, 0.1)?;
        self.trap_reflectance.check("trap_reflectance", 0.0, 0.1)?;
        within("correlation", self.correlation, -1.0, 1.0)?;
        within("halo_width", self.halo_width, 0.005, 1.0)?;
        within("residual", self.residual, 0.0, 1.0)?;
        Ok(())
    }
}

impl GlareValues {
    /// As images are freed of it.
    pub fn glare(&self) -> Glare {
        let [u, h] = [self.uniform.std, self.halo.std];
        let both = self.correlation * u * h;
        Glare {
            uniform: self.uniform.value,
            halo: self.halo.value,
            halo_width: self.halo_width,
            covariance: [[u * u, both], [both, h * h]],
        }
    }

    /// All of it: share of the light and its standard uncertainty.
    pub fn total(&self) -> Measured {
        let [[a, b], [_, d]] = self.glare().covariance;
        Measured::new(
            self.uniform.value + self.halo.value,
            (a + 2.0 * b + d).max(0.0).sqrt(),
        )
    }
}

/// What glare is measured from.
#[derive(Clone, Copy, Debug)]
pub struct GlareRequest<'a> {
    /// The card with its traps.
    pub image: &'a Grey,
    /// Parts of the image that lie inside a trap, away from its edge.
    pub traps: &'a [Region],
    /// What the traps reflect over what the card does.
    pub trap_reflectance: Measured,
}

impl GlareRequest<'_> {
    /// Usual reflectance of a trap: a deep cavity, black inside, behind a small hole.
    pub const TRAP_REFLECTANCE: f64 = 0.001;
    /// Usual standard uncertainty of that.
    pub const TRAP_REFLECTANCE_STD: f64 = 0.0003;
}

/// Why an image gives no glare.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum GlareError {
    #[error("no trap is named")]
    NoTrap,
    /// A region leaves the image or holds too few pixels.
    #[error(
        "the trap of {} x {} pixels at ({}, {}) does not lie in the {} x {} image or holds fewer than {MIN_PIXELS} valid pixels",
        region.width, region.height, region.x, region.y, size[0], size[1]
    )]
    Region {
        region: Region,
        /// Width and height of the image.
        size: [usize; 2],
    },
    #[error(
        "the traps have {percent:.1}% of the card's radiance; at most {MAX_TRAP_PERCENT}% can be glare"
    )]
    NotDark { percent: f64 },
    /// More light than the stated reflectance explains is not there.
    #[error(
        "the traps have {percent:.3}% of the card's radiance, less than the {stated_percent:.3}% that they are stated to reflect"
    )]
    Darker { percent: f64, stated_percent: f64 },
}

/// Pixels that a trap must have.
const MIN_PIXELS: usize = 16;
/// Radiance over the card's from which on a trap is none, percent.
const MAX_TRAP_PERCENT: f64 = 10.0;
/// Widths of the halo that are tried, parts of the diagonal.
const WIDTHS: [f64; 10] = [0.02, 0.03, 0.04, 0.055, 0.075, 0.1, 0.135, 0.18, 0.25, 0.35];
/// How much of a halo of another shape counts as even, and how much is missed, parts of its share:
/// of halos that fall along rows and columns, in the tests below, up to 0.15 and 0.05.
const SHAPE_ERROR: [f64; 2] = [0.2, 0.05];
/// Deviations from the median, in median deviations, beyond which a pixel is a defect.
const OUTLIER: f64 = 8.0;

/// A pixel of a trap.
struct Pixel {
    middle_px: DVec2,
    /// Over the card's radiance.
    value: f64,
}

/// Measures the glare.
///
/// # Errors
/// Traps that are none, or not in the image.
pub fn measure(request: &GlareRequest<'_>) -> Result<GlareValues, GlareError> {
    let (image, card) = over_card(request.image, request.traps)?;
    let pixels = trap_pixels(&image, request.traps, card)?;
    let mean = pixels.iter().map(|pixel| pixel.value).sum::<f64>() / pixels.len() as f64;
    let reflectance = request.trap_reflectance;
    if 100.0 * mean > MAX_TRAP_PERCENT {
        return Err(GlareError::NotDark {
            percent: 100.0 * mean,
        });
    }
    if mean < reflectance.value - 3.0 * reflectance.std {
        return Err(GlareError::Darker {
            percent: 100.0 * mean,
            stated_percent: 100.0 * reflectance.value,
        });
    }
    let mut sums = BlockSums::new([image.width, image.height]);
    sums.add(&image);

    // The shares for each width, and how well they explain the traps.
    let found: Vec<Shares> = WIDTHS
        .iter()
        .map(|&width| Shares::of(&sums, &pixels, reflectance, width))
        .collect();
    let best = found
        .iter()
        .min_by(|a, b| a.mean_square.total_cmp(&b.mean_square))
        .unwrap_or(&found[0]);
    // Widths that explain them about as well count by their likelihood: neighbouring pixels share
    // their errors, so a trap's side stands for the number of independent ones.
    let independent = (pixels.len() as f64).sqrt();
    let likelihood = |shares: &Shares| {
        let ratio = shares.mean_square / best.mean_square.max(f64::MIN_POSITIVE);
        (-0.5 * independent * (ratio - 1.0)).exp()
    };
    let mut covariance = best.covariance;
    let total: f64 = found.iter().map(likelihood).sum();
    for shares in &found {
        let off = shares.shares - best.shares;
        covariance += off * off.transpose() * (likelihood(shares) / total);
    }
    let [as_even, missed] = SHAPE_ERROR.map(|part| part * best.shares.y);
    let exchanged = Vector2::new(as_even, -as_even);
    covariance += exchanged * exchanged.transpose();
    covariance[(1, 1)] += missed * missed;
    let std = [covariance[(0, 0)].sqrt(), covariance[(1, 1)].sqrt()];
    let measured = |k: usize| Measured {
        value: best.shares[k],
        std: std[k],
    };
    Ok(GlareValues {
        uniform: measured(0),
        halo: measured(1),
        correlation: match std[0] * std[1] {
            product if product > 0.0 => (covariance[(0, 1)] / product).clamp(-1.0, 1.0),
            _ => 0.0,
        },
        halo_width: best.width,
        trap_reflectance: reflectance,
        pixels: pixels.len(),
        residual: best.mean_square.sqrt(),
    })
}

/// The image with pixels of every place of a cell of 2 × 2, which may have filters of their own,
/// over what they have of the card; and the card's radiance then.
fn over_card(image: &Grey, traps: &[Region]) -> Result<(RadianceImage, f64), GlareError> {
    if traps.is_empty() {
        return Err(GlareError::NoTrap);
    }
    let (width, height) = (image.width, image.height);
    let place = |pixel: usize| pixel / width % 2 * 2 + pixel % width % 2;
    let mut bright: [Vec<f64>; 4] = Default::default();
    for (pixel, &value) in image.value.iter().enumerate() {
        if image.valid[pixel] && value.is_finite() {
            bright[place(pixel)].push(value);
        }
    }
    // The card is the most of what is not dark.
    let levels = bright.map(|mut values| {
        values.sort_unstable_by(f64::total_cmp);
        values.get(3 * values.len() / 4).copied().unwrap_or(0.0)
    });
    let mut relative = RadianceImage::new(width, height);
    for (pixel, &value) in image.value.iter().enumerate() {
        let level = levels[place(pixel)];
        relative.mean[pixel] = [(value / level) as f32; 3];
        relative.valid[pixel] = image.valid[pixel] && level > 0.0;
    }
    let card = relative.mean.iter().zip(&relative.valid);
    let card = card.filter(|(value, valid)| **valid && value[0] > 0.5);
    let (sum, count) = card.fold((0.0, 0usize), |(sum, count), (value, _)| {
        (sum + f64::from(value[0]), count + 1)
    });
    Ok((relative, sum / count.max(1) as f64))
}

fn trap_pixels(
    image: &RadianceImage,
    traps: &[Region],
    card: f64,
) -> Result<Vec<Pixel>, GlareError> {
    let mut pixels = Vec::new();
    for &region in traps {
        let size = [image.width, image.height];
        let refused = GlareError::Region { region, size };
        if !region.is_inside(size) {
            return Err(refused);
        }
        let columns = region.x..region.x + region.width;
        let rows = region.y..region.y + region.height;
        let all = rows.flat_map(|y| columns.clone().map(move |x| [x, y]));
        let valid = all.filter(|[x, y]| image.valid[y * image.width + x]);
        let mut of_trap: Vec<Pixel> = valid
            .map(|[x, y]| Pixel {
                middle_px: DVec2::new(x as f64, y as f64) + 0.5,
                value: f64::from(image.mean[y * image.width + x][0]) / card,
            })
            .collect();
        if of_trap.len() < MIN_PIXELS {
            return Err(refused);
        }
        // Hot pixels.
        let median = |values: &mut Vec<f64>| {
            values.sort_unstable_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let middle = median(&mut of_trap.iter().map(|p| p.value).collect());
        let spread = median(&mut of_trap.iter().map(|p| (p.value - middle).abs()).collect());
        of_trap.retain(|pixel| (pixel.value - middle).abs() <= OUTLIER * spread);
        pixels.extend(of_trap);
    }
    Ok(pixels)
}

/// The shares at one width of the halo.
struct Shares {
    width: f64,
    /// Even part, halo.
    shares: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// Mean square residual over the card's radiance squared.
    mean_square: f64,
}

impl Shares {
    fn of(sums: &BlockSums, pixels: &[Pixel], reflectance: Measured, halo_width: f64) -> Self {
        let mut found = Self {
            width: halo_width,
            shares: Vector2::zeros(),
            covariance: Matrix2::zeros(),
            mean_square: 0.0,
        };
        // What scatters is the card without its glare, which the second time is known.
        for _ in 0..2 {
            let glare = Glare {
                uniform: found.shares.x,
                halo: found.shares.y,
                halo_width,
                covariance: [[0.0; 2]; 2],
            };
            let scattered = sums.scattered(&glare);
            let row = |pixel: &Pixel| {
                let [mean, halo] = scattered.at(pixel.middle_px);
                Vector2::new(mean[0], halo[0]).add_scalar(-reflectance.value)
            };
            let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
            let mut sum = Vector2::zeros();
            for pixel in pixels {
                let x = row(pixel);
                normal += x * x.transpose();
                right += x * (pixel.value - reflectance.value);
                sum += x;
            }
            // Neither share can be negative.
            let inverse = normal.try_inverse().unwrap_or_else(Matrix2::zeros);
            let mut shares = inverse * right;
            let mut answer = inverse;
            for (negative, other) in [(0, 1), (1, 0)] {
                if shares[negative] < 0.0 {
                    answer = Matrix2::zeros();
                    answer[(other, other)] = 1.0 / normal[(other, other)];
                    shares = answer * right;
                }
            }
            found.shares = shares.map(|share| share.max(0.0));
            let residual = |p: &Pixel| p.value - reflectance.value - row(p).dot(&found.shares);
            let square: f64 = pixels.iter().map(|pixel| residual(pixel).powi(2)).sum();
            found.mean_square = square / pixels.len() as f64;
            let by_trap = answer * sum * reflectance.std;
            found.covariance = answer * found.mean_square + by_trap * by_trap.transpose();
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::glare_card::{self, Glare as True};

    fn photograph(size: [usize; 2], glare: True) -> (Grey, Vec<Region>) {
        let (card, traps) = glare_card::card(size, [0.8, 0.001], glare);
        let image = Grey {
            width: size[0],
            height: size[1],
            variance: vec![1e-6; card.len()],
            valid: vec![true; card.len()],
            value: card.into_iter().map(f64::from).collect(),
        };
        (image, traps.map(Region::from).to_vec())
    }

    fn measured(glare: True) -> GlareValues {
        let (image, traps) = photograph([96, 72], glare);
        let request = GlareRequest {
            image: &image,
            traps: &traps,
            trap_reflectance: Measured::new(0.001, 0.0001),
        };
        measure(&request).unwrap()
    }

    /// By the simulated lens, whose halo has another shape.
    #[test]
    fn shares_are_found() {
        for (uniform, halo, halo_width) in [
            (0.005, 0.0, 0.1),
            (0.0025, 0.0025, 0.05),
            (0.0025, 0.0025, 0.1),
            (0.002, 0.01, 0.08),
        ] {
            let found = measured(True {
                uniform,
                halo,
                halo_width,
            });
            println!("{uniform} {halo} {halo_width}: {found:?}");
            let total = found.total();
            assert!((total.value - uniform - halo).abs() < 3.0 * total.std + 2e-4);
            assert!((found.uniform.value - uniform).abs() < 3.0 * found.uniform.std + 2e-4);
            assert!((found.halo.value - halo).abs() < 3.0 * found.halo.std + 2e-4);
            found.check().unwrap();
        }
    }

    #[test]
    fn what_is_no_trap_is_refused() {
        let (image, mut traps) = photograph([96, 72], True::default());
        let mut fact = |change: &mut dyn FnMut(&mut Vec<Region>), value| {
            let mut named = std::mem::take(&mut traps);
            let before = named.clone();
            change(&mut named);
            let trap_reflectance = Measured { value, std: 1e-4 };
            let request = GlareRequest {
                image: &image,
                traps: &named,
                trap_reflectance,
            };
            traps = before;
            measure(&request).unwrap_err().to_string()
        };
        assert_eq!(fact(&mut Vec::clear, 0.001), "no trap is named");
        let outside = fact(&mut |traps| traps[0].x = 90, 0.001);
        assert!(
            outside.contains("does not lie in the 96 x 72 image"),
            "{outside}"
        );
        let card = fact(&mut |traps| traps[0].y = 0, 0.001);
        assert!(
            card.contains("of the card's radiance; at most 10%"),
            "{card}"
        );
        let darker = fact(&mut |_| {}, 0.01);
        assert!(darker.contains("less than the 1.000%"), "{darker}");
    }
}
