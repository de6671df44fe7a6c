//! Photographs of rendered images: exposed with noise by the simulated sensor, then merged
//! as real frames are.

use mock_devices::sensor::{FrameKey, NoiseKey, SensorConfig, SensorModel};

use crate::radiance_image::RadianceImage;
use crate::radiometry::merge::{BracketMerge, FrameRole, MergeError};
use crate::radiometry::mosaic::Mosaic;
use crate::radiometry::sensor::SensorNoise;

/// A sensor behind its lens, and how it is exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Photographer {
    /// Bits of a count, 8..=16.
    pub bit_depth: u32,
    /// Electrons that fill a pixel and give the largest count, > 0.
    pub full_well_e: f64,
    /// Read noise, electrons.
    pub read_noise_e: f64,
    /// Exposures, each 4 times as long as the one before, 1..=8. With one, the brightest
    /// 2% of the sample clip; with more, the shortest clips nothing.
    pub exposures: u32,
    /// Frames averaged per exposure, at least 1.
    pub frames: u32,
    /// Key of the noise.
    pub seed: u64,
}

/// Ratio of neighbouring exposures.
const RATIO: f64 = 4.0;

impl Photographer {
    /// The image of light number `light` as this sensor gives it, with the merge's own
    /// variance and mask, to which the render's variance is added.
    pub fn take(&self, image: &RadianceImage, light: u32) -> Result<RadianceImage, MergeError> {
        let planes: Vec<_> = (0..3)
            .map(|channel| self.plane(image, light, channel))
            .collect::<Result<_, _>>()?;
        let planes = [&planes[0], &planes[1], &planes[2]];
        let mut taken =
            crate::radiometry::plane::MergedPlane::to_rgb(planes).unwrap_or_else(|| image.clone());
        for (variance, rendered) in taken.variance.iter_mut().zip(&image.variance) {
            for (v, r) in variance.iter_mut().zip(rendered) {
                *v += r;
            }
        }
        Ok(taken)
    }

    fn plane(
        &self,
        image: &RadianceImage,
        light: u32,
        channel: usize,
    ) -> Result<crate::radiometry::plane::MergedPlane, MergeError> {
        // The brightest level that shall not be saturated.
        let radiance: Vec<f32> = image.mean.iter().map(|rgb| rgb[channel]).collect();
        let mut lit: Vec<f32> = radiance.iter().copied().filter(|&r| r > 0.0).collect();
        lit.sort_by(f32::total_cmp);
        let quantile = if self.exposures == 1 { 0.98 } else { 1.0 };
        let at = (quantile * lit.len().saturating_sub(1) as f64) as usize;
        let bright = f64::from(lit.get(at).copied().unwrap_or(1.0));

        // The sensor, as it is and as it is calibrated.
        let black_level_dn = 16.0;
        let full_scale_dn = (1u64 << self.bit_depth) as f64 - 1.0;
        let gain_dn_per_e = (full_scale_dn - black_level_dn) / self.full_well_e;
        let config = SensorConfig {
            responsivity: 1.0,
            dark_current_e_s: 0.0,
            dsnu_e_s: 0.0,
            offset_dsnu_e: 0.0,
            prnu: 0.0,
            read_noise_e: self.read_noise_e,
            full_well_e: self.full_well_e,
            gain_dn_per_e,
            black_level_dn,
            bit_depth: self.bit_depth,
            hot_fraction: 0.0,
            ..SensorConfig::typical([image.width as u32, image.height as u32], self.seed)
        };
        let noise = SensorNoise {
            linear_max_dn: 0.98 * full_scale_dn,
            ..SensorNoise::ideal(
                gain_dn_per_e,
                self.read_noise_e,
                black_level_dn,
                self.bit_depth,
            )
        };
        let sensor = SensorModel::new(config);

        // The bracket.
        let shortest_s = 0.85 * self.full_well_e / bright;
        let mut merge = BracketMerge::new(&noise, Mosaic::None, image.width, image.height)?;
        for exposure in 0..self.exposures {
            let exposure_s = shortest_s * RATIO.powi(exposure as i32);
            for repeat in 0..self.frames {
                let frame = FrameKey {
                    light: 3 * light + channel as u32,
                    exposure,
                    repeat,
                    kind: 0,
                };
                let key = NoiseKey {
                    seed: self.seed,
                    frame,
                };
                let counts = sensor.expose(&radiance, exposure_s, 1.0, key);
                merge.add(FrameRole::Light, exposure_s, &counts)?;
            }
        }
        merge.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> RadianceImage {
        let mut image = RadianceImage::new(32, 32);
        for (p, rgb) in image.mean.iter_mut().enumerate() {
            *rgb = [10f32.powf(-3.0 * p as f32 / 1024.0); 3];
        }
        image
    }

    fn photographer(exposures: u32) -> Photographer {
        Photographer {
            bit_depth: 12,
            full_well_e: 10_000.0,
            read_noise_e: 3.0,
            exposures,
            frames: 1,
            seed: 4,
        }
    }

    /// Squared deviations in stated variances average to 1: of 3 × 1024 values, within 10%
    /// (4 standard deviations of a χ² mean).
    #[test]
    fn the_stated_variance_is_the_noise() {
        let image = gradient();
        let taken = photographer(4).take(&image, 0).unwrap();
        let mut sum = 0.0;
        for (p, rgb) in taken.mean.iter().enumerate() {
            assert!(taken.valid[p]);
            for (c, value) in rgb.iter().enumerate() {
                let deviation = f64::from(value - image.mean[p][c]);
                sum += deviation * deviation / f64::from(taken.variance[p][c]);
            }
        }
        let mean = sum / (3.0 * 1024.0);
        assert!((0.9..1.1).contains(&mean), "{mean}");
    }

    #[test]
    fn one_exposure_clips_the_brightest() {
        let taken = photographer(1).take(&gradient(), 0).unwrap();
        let invalid = taken.valid.iter().filter(|v| !**v).count();
        assert!((1..60).contains(&invalid), "{invalid}");
    }
}
