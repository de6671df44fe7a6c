//! The absolute scale from a diffuse standard whose reflectance a certificate
//! states: the irradiance that the lamp brings, in the unit of the image.

use std::f64::consts::PI;

use super::record::Measured;
use crate::radiance_image::RadianceImage;

/// A diffuse standard and how it is lit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WhiteStandard {
    /// Radiance factor by its certificate, for the angles of this measurement: its
    /// radiance over that of the perfect diffuser; 0.02 to 1.2.
    pub reflectance: Measured,
    /// Angle between its normal and the lamp, radians; 0 to 85 degrees.
    pub incidence_rad: f64,
    /// Standard uncertainty of that angle, radians.
    pub incidence_std_rad: f64,
}

impl WhiteStandard {
    /// Usual angle between the standard's normal and the lamp, degrees (45°/0°).
    pub const INCIDENCE_DEG: f64 = 45.0;
    /// Usual standard uncertainty of that angle, degrees.
    pub const INCIDENCE_STD_DEG: f64 = 0.1;
}

/// Part of an image, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Region {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl Region {
    /// All of an image of this width and height.
    pub fn whole([width, height]: [usize; 2]) -> Self {
        Self::from([0, 0, width, height])
    }

    /// Whether no part of it is outside an image of this width and height.
    pub fn is_inside(self, [width, height]: [usize; 2]) -> bool {
        self.x.saturating_add(self.width) <= width && self.y.saturating_add(self.height) <= height
    }
}

impl From<[usize; 4]> for Region {
    /// By first column, first row, columns and rows.
    fn from([x, y, width, height]: [usize; 4]) -> Self {
        Self {
            x,
            y,
            width,
            height,
        }
    }
}

/// Why an image of a standard gives no scale.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum WhiteError {
    #[error(
        "a reflectance of {value} ± {std} is no diffuse standard's: 0.02 to 1.2, known to a tenth"
    )]
    Certificate { value: f64, std: f64 },
    /// The lamp grazes or is behind.
    #[error("an incidence of {degrees:.1} degrees is outside 0 to 85")]
    Incidence { degrees: f64 },
    #[error(
        "the region of {width} x {height} pixels at ({x}, {y}) does not lie in the {image_width} x {image_height} image or holds fewer than {MIN_PIXELS} pixels without its margin"
    )]
    Region {
        x: usize,
        y: usize,
        width: usize,
        height: usize,
        image_width: usize,
        image_height: usize,
    },
    /// Clipped, hot or moving pixels.
    #[error("{percent:.0}% of the region's pixels are masked; at most 5% may be")]
    Masked { percent: f64 },
    /// Hardly any light.
    #[error("the region is dark: {mean:.3e} with a standard deviation of {std:.1e}")]
    Dark { mean: f64, std: f64 },
    #[error(
        "the region's quarters differ by {percent:.1}% from their mean; an evenly lit standard has less than 5%"
    )]
    Uneven { percent: f64 },
}

/// Part of the region on each side that is ignored: light leaks out of a
/// translucent standard (PTFE) near its edges.
const MARGIN: f64 = 0.15;
/// Largest angle between a standard's normal and the lamp, radians: 85°.
pub(super) const MOST_INCIDENCE_RAD: f64 = 1.483_529_9;
const MIN_PIXELS: usize = 64;
const MOST_MASKED: f64 = 0.05;
const MOST_UNEVEN: f64 = 0.05;

/// Irradiance across the light at the standard, R, G and B, in the image's unit
/// times steradian: `E = π L / (reflectance cos θ)`. The uncertainty is of
/// certificate, angle, noise, and evenness (the spread of the quarters' means).
pub fn irradiance(
    image: &RadianceImage,
    region: Region,
    standard: &WhiteStandard,
) -> Result<[Measured; 3], WhiteError> {
    let reflectance = standard.reflectance;
    let known = (0.02..=1.2).contains(&reflectance.value)
        && (0.0..=0.1).contains(&(reflectance.std / reflectance.value));
    if !known {
        return Err(WhiteError::Certificate {
            value: reflectance.value,
            std: reflectance.std,
        });
    }
    let degrees = standard.incidence_rad.to_degrees();
    if !(0.0..=MOST_INCIDENCE_RAD).contains(&standard.incidence_rad) {
        return Err(WhiteError::Incidence { degrees });
    }
    let quarters = quarters(image, region)?;
    let cos = standard.incidence_rad.cos();
    let angle = standard.incidence_rad.tan() * standard.incidence_std_rad;
    let certificate = reflectance.std / reflectance.value;
    let mut found = [Measured::new(0.0, 0.0); 3];
    for (channel, found) in found.iter_mut().enumerate() {
        let mean = quarters.iter().map(|q| q.mean[channel]).sum::<f64>() / 4.0;
        let noise2 = quarters.iter().map(|q| q.variance[channel]).sum::<f64>() / 16.0;
        let pixel2 = quarters
            .iter()
            .map(|q| q.pixel_variance[channel])
            .sum::<f64>()
            / 4.0;
        let std = pixel2.sqrt();
        let bright = mean > 0.0 && mean * mean > 25.0 * noise2;
        if !bright {
            return Err(WhiteError::Dark { mean, std });
        }
        let off = |q: &Quarter| (q.mean[channel] / mean - 1.0).abs();
        let worst = quarters.iter().map(off).fold(0.0, f64::max);
        let explained = 3.0 * (4.0 * noise2).sqrt() / mean;
        if worst > MOST_UNEVEN + explained {
            let percent = 100.0 * worst;
            return Err(WhiteError::Uneven { percent });
        }
        let spread2 = quarters.iter().map(|q| off(q).powi(2)).sum::<f64>() / 3.0 / 4.0;
        let relative2 = certificate.powi(2) + angle.powi(2) + spread2.max(noise2 / (mean * mean));
        let value = PI * mean / (reflectance.value * cos);
        *found = Measured::new(value, value * relative2.sqrt());
    }
    Ok(found)
}

#[derive(Clone, Copy, Debug, Default)]
struct Quarter {
    mean: [f64; 3],
    /// Of the mean, from the pixels' own variances.
    variance: [f64; 3],
    /// Mean variance of a pixel.
    pixel_variance: [f64; 3],
}

/// The four quarters of the region without its margin.
fn quarters(image: &RadianceImage, region: Region) -> Result<[Quarter; 4], WhiteError> {
    let margin = |n: usize| (MARGIN * n as f64).ceil() as usize;
    let (left, top) = (
        region.x + margin(region.width),
        region.y + margin(region.height),
    );
    let width = region.width.saturating_sub(2 * margin(region.width));
    let height = region.height.saturating_sub(2 * margin(region.height));
    let is_inside = region.is_inside([image.width, image.height]);
    if !is_inside || width * height < MIN_PIXELS || width < 2 || height < 2 {
        return Err(WhiteError::Region {
            x: region.x,
            y: region.y,
            width: region.width,
            height: region.height,
            image_width: image.width,
            image_height: image.height,
        });
    }
    let mut quarters = [Quarter::default(); 4];
    let mut counts = [0.0; 4];
    for row in 0..height {
        for column in 0..width {
            let pixel = (top + row) * image.width + left + column;
            if !image.valid[pixel] {
                continue;
            }
            let at = 2 * usize::from(2 * row >= height) + usize::from(2 * column >= width);
            counts[at] += 1.0;
            for channel in 0..3 {
                quarters[at].mean[channel] += f64::from(image.mean[pixel][channel]);
                quarters[at].variance[channel] += f64::from(image.variance[pixel][channel]);
            }
        }
    }
    let masked = 1.0 - counts.iter().sum::<f64>() / (width * height) as f64;
    if masked > MOST_MASKED || counts.contains(&0.0) {
        let percent = 100.0 * masked;
        return Err(WhiteError::Masked { percent });
    }
    for (quarter, n) in quarters.iter_mut().zip(counts) {
        for channel in 0..3 {
            quarter.mean[channel] /= n;
            quarter.pixel_variance[channel] = quarter.variance[channel] / n;
            quarter.variance[channel] /= n * n;
        }
    }
    Ok(quarters)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    const REGION: Region = Region {
        x: 10,
        y: 6,
        width: 60,
        height: 50,
    };
    const IRRADIANCE: [f64; 3] = [3.0, 2.5, 1.2];

    /// A standard of true reflectance `true_reflectance` in a dark image, lit from
    /// 45 degrees; light leaks out over three pixels of its edge.
    fn photograph(seed: u64, true_reflectance: f64, true_incidence_rad: f64) -> RadianceImage {
        let mut image = RadianceImage::new(80, 64);
        for p in 0..80 * 64 {
            let (x, y): (usize, usize) = (p % 80, p / 80);
            let inside = (10..70).contains(&x) && (6..56).contains(&y);
            let edge = (x.abs_diff(10))
                .min(x.abs_diff(69))
                .min(y.abs_diff(6))
                .min(y.abs_diff(55));
            let leak = if edge < 3 { 0.85 } else { 1.0 };
            for (channel, irradiance) in IRRADIANCE.into_iter().enumerate() {
                let lit = irradiance * true_incidence_rad.cos() * true_reflectance / PI;
                let truth = if inside { leak * lit } else { 0.0 };
                let std = 0.02 * lit;
                let mut random = stream(seed, Purpose::Experiment, channel as u64, p as u64, 0);
                image.mean[p][channel] = (truth + std * random.normal()) as f32;
                image.variance[p][channel] = (std * std) as f32;
            }
        }
        image
    }

    fn standard(std: f64, incidence_std_rad: f64) -> WhiteStandard {
        WhiteStandard {
            reflectance: Measured { value: 0.99, std },
            incidence_rad: 45f64.to_radians(),
            incidence_std_rad,
        }
    }

    /// 64 standards that differ from their certificate, and angles from their
    /// reading, as stated: the errors over the stated uncertainty are a unit
    /// normal, χ² over 64 between the 1e-5 tails of χ²(64).
    #[test]
    fn the_irradiance_is_recovered_within_its_uncertainty() {
        let standard = standard(0.005, 0.005);
        let mut chi2 = 0.0;
        for seed in 0..64 {
            let mut random = stream(77, Purpose::Experiment, seed, 0, 0);
            let reflectance = 0.99 + 0.005 * random.normal();
            let incidence_rad = standard.incidence_rad + 0.005 * random.normal();
            let image = photograph(seed, reflectance, incidence_rad);
            let found = irradiance(&image, REGION, &standard).unwrap();
            for (found, truth) in found.iter().zip(IRRADIANCE) {
                assert!((found.value / truth - 1.0).abs() < 0.03, "{found:?}");
            }
            chi2 += ((found[0].value - IRRADIANCE[0]) / found[0].std).powi(2);
        }
        assert!((26.0..125.0).contains(&chi2), "{chi2}");
    }

    /// With the irradiance so found, the standard measured as a sample under
    /// another angle has its reflectance within 3%, and a grey one its own.
    #[test]
    fn a_standard_measured_as_a_sample_returns_its_value() {
        let found = irradiance(
            &photograph(1, 0.99, 45f64.to_radians()),
            REGION,
            &standard(0.005, 0.0),
        );
        let found = found.unwrap();
        for (reflectance, degrees) in [(0.99, 20.0f64), (0.5, 60.0)] {
            let image = photograph(2, reflectance, degrees.to_radians());
            let pixels = (20..60).map(|x| f64::from(image.mean[30 * 80 + x][1]));
            let mean = pixels.sum::<f64>() / 40.0;
            let measured = PI * mean / (found[1].value * degrees.to_radians().cos());
            assert!((measured / reflectance - 1.0).abs() < 0.03, "{measured}");
        }
    }

    #[test]
    fn what_is_no_evenly_lit_standard_is_refused() {
        let image = photograph(3, 0.99, 45f64.to_radians());
        let good = standard(0.005, 0.0);
        let with = |change: &dyn Fn(&mut RadianceImage, &mut Region, &mut WhiteStandard)| {
            let (mut image, mut region, mut standard) = (image.clone(), REGION, good);
            change(&mut image, &mut region, &mut standard);
            irradiance(&image, region, &standard).unwrap_err()
        };
        let percent = with(&|_, _, s| s.reflectance.value = 99.0);
        assert!(
            matches!(percent, WhiteError::Certificate { .. }),
            "{percent}"
        );
        let unknown = with(&|_, _, s| s.reflectance.std = 0.2);
        assert!(
            matches!(unknown, WhiteError::Certificate { .. }),
            "{unknown}"
        );
        let grazing = with(&|_, _, s| s.incidence_rad = 1.55);
        assert!(matches!(grazing, WhiteError::Incidence { .. }), "{grazing}");
        let outside = with(&|_, r, _| r.x = 60);
        assert!(matches!(outside, WhiteError::Region { .. }), "{outside}");
        let tiny = with(&|_, r, _| (r.width, r.height) = (6, 6));
        assert!(matches!(tiny, WhiteError::Region { .. }), "{tiny}");
        let masked = with(&|i, _, _| i.valid[30 * 80..36 * 80].fill(false));
        assert!(matches!(masked, WhiteError::Masked { .. }), "{masked}");
        let dark = with(&|i, _, _| i.mean.fill([0.0; 3]));
        assert!(matches!(dark, WhiteError::Dark { .. }), "{dark}");
        let shadow = with(&|i, _, _| {
            for p in (0..80 * 64).filter(|p| p % 80 > 50) {
                i.mean[p] = i.mean[p].map(|m| 0.5 * m);
            }
        });
        assert!(matches!(shadow, WhiteError::Uneven { .. }), "{shadow}");
    }
}
