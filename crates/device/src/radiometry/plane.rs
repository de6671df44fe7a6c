//! The merged sensor: one radiance per pixel, and images made of it.

use std::ops::Range;

use super::agreement::ExposureAgreement;
use super::mosaic::Mosaic;
use crate::radiance_image::RadianceImage;

/// Radiance at every sensor pixel. Row 0 is the top.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct MergedPlane {
    pub width: usize,
    pub height: usize,
    /// Radiance in the unit of the sensor's responsivity; negative values are kept.
    pub mean: Vec<f32>,
    /// Variance of each mean.
    pub variance: Vec<f32>,
    /// `false` where the pixel is hot, clips in every exposure, or something moved.
    pub valid: Vec<bool>,
    /// How the light exposures agree, shortest first; of a mosaic those of red, then of green
    /// and blue.
    pub agreement: Vec<ExposureAgreement>,
}

impl MergedPlane {
    /// Only these rows; the agreement stays that of all.
    #[must_use]
    pub fn rows(&self, rows: Range<usize>) -> Self {
        let pixels = rows.start * self.width..rows.end * self.width;
        Self {
            width: self.width,
            height: rows.len(),
            mean: self.mean[pixels.clone()].to_vec(),
            variance: self.variance[pixels.clone()].to_vec(),
            valid: self.valid[pixels].to_vec(),
            agreement: self.agreement.clone(),
        }
    }

    /// The same radiance in all three channels.
    pub fn to_grey(&self) -> RadianceImage {
        RadianceImage {
            width: self.width,
            height: self.height,
            mean: self.mean.iter().map(|&x| [x; 3]).collect(),
            variance: self.variance.iter().map(|&x| [x; 3]).collect(),
            valid: self.valid.clone(),
        }
    }

    /// Red, green and blue from three planes of equal size (one per lamp
    /// channel); a pixel is valid where all three are. `None` if the sizes differ.
    pub fn to_rgb(planes: [&Self; 3]) -> Option<RadianceImage> {
        let [red, green, blue] = planes;
        let size = |plane: &Self| (plane.width, plane.height);
        if size(red) != size(green) || size(red) != size(blue) {
            return None;
        }
        let pixels = 0..red.mean.len();
        Some(RadianceImage {
            width: red.width,
            height: red.height,
            mean: pixels.clone().map(|p| planes.map(|c| c.mean[p])).collect(),
            variance: pixels
                .clone()
                .map(|p| planes.map(|c| c.variance[p]))
                .collect(),
            valid: pixels.map(|p| planes.iter().all(|c| c.valid[p])).collect(),
        })
    }

    /// A mosaic sensor at half resolution: every cell of 2 × 2 becomes one
    /// pixel, the two greens averaged; an odd last row or column is left out.
    /// Nothing is interpolated. A mono sensor keeps its resolution, in grey.
    pub fn binned(&self, mosaic: Mosaic) -> RadianceImage {
        if mosaic == Mosaic::None {
            return self.to_grey();
        }
        let (width, height) = (self.width / 2, self.height / 2);
        let mut image = RadianceImage::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let (mut mean, mut variance, mut count) = ([0.0; 3], [0.0; 3], [0.0f32; 3]);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let pixel = (2 * y + dy) * self.width + 2 * x + dx;
                    if let Some(channel) = mosaic.channel(dx, dy)
                        && self.valid[pixel]
                    {
                        mean[channel] += self.mean[pixel];
                        variance[channel] += self.variance[pixel];
                        count[channel] += 1.0;
                    }
                }
                let cell = y * width + x;
                image.valid[cell] = count.iter().all(|&n| n > 0.0);
                for c in 0..3 {
                    let n = count[c].max(1.0);
                    image.mean[cell][c] = mean[c] / n;
                    image.variance[cell][c] = variance[c] / (n * n);
                }
            }
        }
        image
    }

    /// A mosaic sensor at full resolution: a pixel keeps the colour that it
    /// measured and takes the mean of the nearest measured ones for the others,
    /// so that no value lies outside of what was measured around it. Neighbours
    /// that share measured values have correlated errors. Valid where the pixel
    /// is and has each colour among its neighbours. A mono sensor becomes grey.
    pub fn demosaiced(&self, mosaic: Mosaic) -> RadianceImage {
        if mosaic == Mosaic::None {
            return self.to_grey();
        }
        let mut image = RadianceImage::new(self.width, self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let pixel = y * self.width + x;
                let [mut sums, mut variances] = [[[0.0f32; 3]; 3]; 2];
                let mut counts = [[0.0f32; 3]; 3];
                for row in y.saturating_sub(1)..(y + 2).min(self.height) {
                    for column in x.saturating_sub(1)..(x + 2).min(self.width) {
                        let near = row * self.width + column;
                        if let Some(channel) = mosaic.channel(column, row)
                            && self.valid[near]
                        {
                            // 0: itself, 1: next to it, 2: across the corner.
                            let distance = row.abs_diff(y) + column.abs_diff(x);
                            sums[channel][distance] += self.mean[near];
                            variances[channel][distance] += self.variance[near];
                            counts[channel][distance] += 1.0;
                        }
                    }
                }
                for channel in 0..3 {
                    let nearest = counts[channel].iter().position(|&n| n > 0.0);
                    let Some(d) = nearest else {
                        image.valid[pixel] = false;
                        continue;
                    };
                    let n = counts[channel][d];
                    image.mean[pixel][channel] = sums[channel][d] / n;
                    image.variance[pixel][channel] = variances[channel][d] / (n * n);
                }
                image.valid[pixel] &= self.valid[pixel];
            }
        }
        image
    }
}
