//! The flat field: relative response of each pixel, from many frames of a
//! steady uniform light and as many dark frames at the same exposure.

use super::pixel_map::{grey_counts, grey_png, sha256};
use super::record::{FlatValues, MapFile};
use crate::radiometry::sensor::{FlatField, SensorNoise};

/// Frames of one exposure, summed.
#[derive(Clone, Debug)]
pub struct FlatFrames<'a> {
    noise: &'a SensorNoise,
    exposure_s: f64,
    lit: Sum,
    dark: Sum,
}

#[derive(Clone, Debug)]
struct Sum {
    frames: u32,
    counts: Vec<u64>,
}

/// Why frames do not make a flat field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FlatError {
    /// A frame of another size.
    #[error("the frame has {found} pixels, the flat field {expected}")]
    FrameSize {
        /// Pixels of the frame.
        found: usize,
        /// Pixels of the flat field.
        expected: usize,
    },
    /// No flats or no dark frames.
    #[error("{lit} flats and {dark} dark frames; at least one of each is needed")]
    TooFew {
        /// Flats.
        lit: u32,
        /// Dark frames.
        dark: u32,
    },
    /// Too little or too much light.
    #[error("the flats reach {percent:.0}% of the usable range; from {low}% to {high}% is needed")]
    Exposure {
        /// Mean over the pixels, percent.
        percent: f64,
        /// Lower limit, percent.
        low: u32,
        /// Upper limit, percent.
        high: u32,
    },
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
    Map {
        /// The map's name.
        file: String,
        /// What is wrong.
        problem: String,
    },
}

/// Flats between these parts of the usable range: photon noise is low, and no
/// pixel clips.
const EXPOSURE_PERCENT: [u32; 2] = [20, 85];

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
        }
    }

    /// Adds a flat.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn add_lit(&mut self, counts: &[u16]) -> Result<(), FlatError> {
        self.lit.add(counts)
    }

    /// Adds a dark frame.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn add_dark(&mut self, counts: &[u16]) -> Result<(), FlatError> {
        self.dark.add(counts)
    }

    /// Response (mean 1 over the pixels that are not hot; 1 at hot ones) and
    /// its standard deviation from photon and read noise.
    ///
    /// # Errors
    /// Too few frames, the wrong exposure, or a pixel without response.
    pub fn solve(&self, width: usize) -> Result<FlatField, FlatError> {
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
            let electrons = signal_dn[p] / self.noise.gain_dn_per_e + dark_e;
            let variance_dn2 = self.noise.mean_count_variance_dn2(electrons, lit.frames)
                + self.noise.mean_count_variance_dn2(dark_e, dark.frames);
            flat.response[p] = (signal_dn[p] / mean_dn) as f32;
            flat.std_dev[p] = (variance_dn2.sqrt() / mean_dn) as f32;
        }
        Ok(flat)
    }

    /// Mean electrons per second of the light over the pixels that are not hot.
    pub fn mean_rate_e_s(&self) -> f64 {
        let (signal_dn, good) = self.signal_dn();
        let mean_dn = good.iter().map(|&p| signal_dn[p]).sum::<f64>() / good.len().max(1) as f64;
        mean_dn / (self.noise.gain_dn_per_e * self.exposure_s)
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

/// A flat field as a 16-bit grey PNG, and what its record says; the checksum
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
            sha256: sha256(&png),
        },
        response_per_count: RESPONSE_PER_COUNT,
        std: (square / flat.std_dev.len().max(1) as f64 + rounding).sqrt(),
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
