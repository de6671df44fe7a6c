//! The flat field: relative response of each pixel, from many frames of a
//! steady uniform light and as many dark frames at the same exposure.

use super::pixel_map::{grey_counts, grey_png};
use super::record::{FlatValues, MapFile, Measured};
use super::sensor::Exposed;
use crate::checksum::sha256_hex;
use crate::radiometry::sensor::{FlatField, SensorNoise};

/// Frames of one exposure, summed.
#[derive(Clone, Debug)]
pub struct FlatFrames<'a> {
    noise: &'a SensorNoise,
    exposure_s: f64,
    lit: Sum,
    /// Frames without the light.
    dark: Sum,
    /// Whether those saw all other light.
    is_ambient: bool,
}

/// A flat field.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatFit {
    /// Response of each pixel.
    pub flat: FlatField,
    /// Mean signal of the light, electrons per second, to which a response of 1
    /// corresponds.
    pub rate_e_s: f64,
    /// Other light over the light itself, where it was measured. Its uncertainty
    /// is that of the black level common to all pixels.
    pub ambient: Option<Measured>,
}

impl FlatFit {
    /// Electrons per second for unit radiance, under a light of this radiance, with the
    /// sensor's gain (DN per electron).
    pub fn responsivity_e_s(&self, radiance: Measured, gain: Measured) -> Measured {
        let value = self.rate_e_s / radiance.value;
        let relative = (radiance.std / radiance.value).hypot(gain.std / gain.value);
        Measured::new(value, value * relative)
    }

    /// Standard deviation of the response between pixels, relative.
    pub fn nonuniformity(&self) -> f64 {
        let response = &self.flat.response;
        let squares = response.iter().map(|&r| f64::from(r - 1.0).powi(2));
        (squares.sum::<f64>() / response.len().max(1) as f64).sqrt()
    }
}

#[derive(Clone, Debug)]
struct Sum {
    frames: u32,
    counts: Vec<u64>,
}

/// Why frames do not make a flat field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum FlatError {
    #[error("the frame has {found} pixels, the flat field {expected}")]
    FrameSize { found: usize, expected: usize },
    #[error("{lit} flats and {dark} dark frames; at least one of each is needed")]
    TooFew { lit: u32, dark: u32 },
    /// Too little or too much light.
    #[error("the flats reach {percent:.0}% of the usable range; from {low}% to {high}% is needed")]
    Exposure { percent: f64, low: u32, high: u32 },
    /// A pixel that sees no light.
    #[error("pixel ({column}, {row}) has no response")]
    DeadPixel {
        /// From 0.
        column: usize,
        /// From 0.
        row: usize,
    },
    /// A map that is no PNG of the right size.
    #[error("{file}: {problem}")]
    Map { file: String, problem: String },
}

/// Flats between these parts of the usable range: photon noise is low, and no
/// pixel clips.
const EXPOSURE_PERCENT: [u32; 2] = [20, 85];

/// Uncertainty of the black level common to all pixels, DN.
const BLACK_LEVEL_STD_DN: f64 = 0.25;

/// A PNG's counts are this fraction of a response: 65535 is twice the mean.
const RESPONSE_PER_COUNT: f64 = 2.0 / 65_535.0;

impl<'a> FlatFrames<'a> {
    /// No frames yet, of `pixels` pixels at one exposure.
    pub fn new(noise: &'a SensorNoise, exposure_s: f64, pixels: usize) -> Self {
        let empty = Sum {
            frames: 0,
            counts: vec![0; pixels],
        };
        Self {
            noise,
            exposure_s,
            lit: empty.clone(),
            dark: empty,
            is_ambient: false,
        }
    }

    /// Adds a flat.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn add_lit(&mut self, counts: &[u16]) -> Result<(), FlatError> {
        self.lit.add(counts)
    }

    /// Adds a frame without the light, dark or ambient.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn add_unlit(&mut self, exposed: Exposed, counts: &[u16]) -> Result<(), FlatError> {
        self.is_ambient |= exposed == Exposed::Ambient;
        self.dark.add(counts)
    }

    /// Response (mean 1 over the pixels that are not hot; 1 at hot ones) and
    /// its standard deviation from photon and read noise.
    ///
    /// # Errors
    /// Too few frames, the wrong exposure, or a pixel without response.
    pub fn solve(&self, width: usize) -> Result<FlatFit, FlatError> {
        let (lit, dark) = (&self.lit, &self.dark);
        if lit.frames == 0 || dark.frames == 0 {
            return Err(FlatError::TooFew {
                lit: lit.frames,
                dark: dark.frames,
            });
        }
        let (signal_dn, good) = self.signal_dn();
        let mean_dn = good.iter().map(|&p| signal_dn[p]).sum::<f64>() / good.len().max(1) as f64;
        let percent = 100.0 * mean_dn / self.noise.usable_range_dn();
        let [low, high] = EXPOSURE_PERCENT;
        if !(f64::from(low)..=f64::from(high)).contains(&percent) {
            return Err(FlatError::Exposure { percent, low, high });
        }
        let dark_e = self.noise.dark_current_e_s * self.exposure_s;
        let unlit = |p: usize| self.noise.signal_dn(dark.mean(p)) / self.noise.gain_dn_per_e;
        let unlit_e = match self.is_ambient {
            true => good.iter().map(|&p| unlit(p)).sum::<f64>() / good.len().max(1) as f64,
            false => dark_e,
        };
        let mut flat = FlatField {
            response: vec![1.0; signal_dn.len()],
            std_dev: vec![0.0; signal_dn.len()],
        };
        for &p in &good {
            if signal_dn[p] <= 0.0 {
                return Err(FlatError::DeadPixel {
                    column: p % width,
                    row: p / width,
                });
            }
            let electrons = signal_dn[p] / self.noise.gain_dn_per_e + unlit_e;
            let variance_dn2 = self.noise.mean_count_variance_dn2(electrons, lit.frames)
                + self.noise.mean_count_variance_dn2(unlit_e, dark.frames);
            flat.response[p] = (signal_dn[p] / mean_dn) as f32;
            flat.std_dev[p] = (variance_dn2.sqrt() / mean_dn) as f32;
        }
        let signal_e = mean_dn / self.noise.gain_dn_per_e;
        Ok(FlatFit {
            flat,
            rate_e_s: mean_dn / (self.noise.gain_dn_per_e * self.exposure_s),
            ambient: self.is_ambient.then(|| Measured {
                value: (unlit_e - dark_e) / signal_e,
                std: BLACK_LEVEL_STD_DN / mean_dn,
            }),
        })
    }

    /// Flats less dark frames, and the pixels that are not hot.
    fn signal_dn(&self) -> (Vec<f64>, Vec<usize>) {
        let hot = |p: usize| self.noise.hot_pixels.as_ref().is_some_and(|hot| hot[p]);
        let pixels = 0..self.lit.counts.len();
        let signal = |sum: &Sum, p: usize| self.noise.signal_dn(sum.mean(p));
        let signal_dn = pixels
            .clone()
            .map(|p| signal(&self.lit, p) - signal(&self.dark, p));
        (signal_dn.collect(), pixels.filter(|&p| !hot(p)).collect())
    }
}

impl Sum {
    fn add(&mut self, counts: &[u16]) -> Result<(), FlatError> {
        if counts.len() != self.counts.len() {
            return Err(FlatError::FrameSize {
                found: counts.len(),
                expected: self.counts.len(),
            });
        }
        self.frames += 1;
        for (sum, &count) in self.counts.iter_mut().zip(counts) {
            *sum += u64::from(count);
        }
        Ok(())
    }

    fn mean(&self, pixel: usize) -> f64 {
        self.counts[pixel] as f64 / f64::from(self.frames.max(1))
    }
}

/// A flat field as a 16-bit grey PNG, and its record's values; the checksum
/// belongs to these bytes. Responses of 2 and more become 2.
///
/// # Errors
/// A size that is not `width` times rows.
pub fn to_map(
    flat: &FlatField,
    width: usize,
    file: &str,
) -> Result<(FlatValues, Vec<u8>), FlatError> {
    let counts: Vec<u16> = flat
        .response
        .iter()
        .map(|&r| {
            (f64::from(r) / RESPONSE_PER_COUNT)
                .round()
                .clamp(0.0, 65_535.0) as u16
        })
        .collect();
    let png = grey_png(counts, width).map_err(|problem| FlatError::Map {
        file: file.to_owned(),
        problem,
    })?;
    let square: f64 = flat.std_dev.iter().map(|&s| f64::from(s).powi(2)).sum();
    let rounding = RESPONSE_PER_COUNT * RESPONSE_PER_COUNT / 12.0;
    let values = FlatValues {
        map: MapFile {
            file: file.to_owned(),
            sha256: sha256_hex(&png),
        },
        response_per_count: RESPONSE_PER_COUNT,
        std: (square / flat.std_dev.len().max(1) as f64 + rounding).sqrt(),
        ambient: None,
    };
    Ok((values, png))
}

/// The flat field of a record from its map's bytes.
///
/// # Errors
/// No PNG, or another size than the sensor's.
pub fn from_map(
    values: &FlatValues,
    png: &[u8],
    resolution_px: [u32; 2],
) -> Result<FlatField, FlatError> {
    let counts = grey_counts(png, resolution_px).map_err(|problem| FlatError::Map {
        file: values.map.file.clone(),
        problem,
    })?;
    let response: Vec<f32> = counts
        .into_iter()
        .map(|count| (f64::from(count) * values.response_per_count) as f32)
        .collect();
    if let Some(dead) = response.iter().position(|&r| r <= 0.0) {
        let width = resolution_px[0] as usize;
        return Err(FlatError::DeadPixel {
            column: dead % width,
            row: dead / width,
        });
    }
    Ok(FlatField {
        std_dev: vec![values.std as f32; response.len()],
        response,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flats of these counts less dark frames at the black level, four pixels wide.
    fn solve(lit: &[u16]) -> Result<FlatFit, FlatError> {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        let mut frames = FlatFrames::new(&noise, 0.01, lit.len());
        frames.add_lit(lit)?;
        frames.add_unlit(Exposed::Dark, &vec![64; lit.len()])?;
        frames.solve(4)
    }

    #[test]
    fn flats_that_are_too_dark_or_too_bright_are_refused() {
        assert!(solve(&[2000; 8]).is_ok());
        for (count, percent) in [(300, "6%"), (4000, "98%")] {
            let fact = solve(&[count; 8]).unwrap_err().to_string();
            assert!(fact.contains(percent), "{fact}");
            assert!(fact.contains("from 20% to 85%"), "{fact}");
        }
        let mut dead = [2000; 8];
        dead[6] = 64;
        let fact = solve(&dead).unwrap_err().to_string();
        assert_eq!(fact, "pixel (2, 1) has no response");
    }

    #[test]
    fn frames_of_another_size_and_missing_ones_are_refused() {
        let noise = SensorNoise::ideal(0.4, 2.5, 64.0, 12);
        let mut frames = FlatFrames::new(&noise, 0.01, 8);
        let fact = frames.add_lit(&[2000; 7]).unwrap_err().to_string();
        assert_eq!(fact, "the frame has 7 pixels, the flat field 8");
        frames.add_lit(&[2000; 8]).unwrap();
        let fact = frames.solve(4).unwrap_err().to_string();
        assert!(fact.contains("1 flats and 0 dark frames"), "{fact}");
    }
}
