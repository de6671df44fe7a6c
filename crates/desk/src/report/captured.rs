//! A merged image as the page shows it: figures of all its pixels, and a small picture, so
//! that no more than one image of full size is in memory.

use crate::plot::radiance as images;
use crate::radiance_image::RadianceImage;

/// A light's merged image.
#[derive(Clone, Debug, PartialEq)]
pub struct CapturedInput {
    /// Pixels per row, and rows.
    pub size_px: [usize; 2],
    /// What is bright in it ([`images::white_level`]).
    pub bright: f32,
    /// Pixels without a valid value.
    pub unusable: usize,
    /// Signal-to-noise ratio of its bright pixels.
    pub signal_to_noise: SignalToNoise,
    /// The image itself, averaged down where it is larger than the page shows.
    pub picture: RadianceImage,
}

impl CapturedInput {
    /// Summarises a merged image.
    pub fn of(image: &RadianceImage) -> Self {
        let bright = images::white_level(image);
        Self {
            size_px: [image.width, image.height],
            bright,
            unusable: image.valid.iter().filter(|valid| !**valid).count(),
            signal_to_noise: SignalToNoise::of(image, bright),
            picture: images::averaged_down(image),
        }
    }
}

/// Mean over standard deviation of the merged radiance, over the pixels
/// brighter than 5% of what is bright.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalToNoise {
    /// The 50th percentile, R, G, B.
    pub median: [f64; 3],
    /// The 5th percentile.
    pub low: [f64; 3],
}

impl SignalToNoise {
    fn of(image: &RadianceImage, bright: f32) -> Self {
        let sorted: [Vec<f64>; 3] = [0, 1, 2].map(|c| {
            let mut ratios: Vec<f64> = (0..image.mean.len())
                .filter(|&n| image.valid[n] && image.variance[n][c] > 0.0)
                .filter(|&n| image.mean[n][c] > 0.05 * bright)
                .map(|n| f64::from(image.mean[n][c]) / f64::from(image.variance[n][c]).sqrt())
                .collect();
            ratios.sort_by(f64::total_cmp);
            ratios
        });
        let at = |percent: usize| {
            sorted.each_ref().map(|ratios| match ratios.len() {
                0 => 0.0,
                count => ratios[(count - 1) * percent / 100],
            })
        };
        Self {
            median: at(50),
            low: at(5),
        }
    }
}
