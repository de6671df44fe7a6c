//! Radiance over a pixel grid with its variance: what a merge gives, what a
//! render gives, what a fit compares.

pub mod exr;

use std::ops::Range;

/// The channels as messages name them.
pub const CHANNEL_NAMES: [&str; 3] = ["red", "green", "blue"];

/// Three channels of radiance with the variance of each value, and which
/// pixels are valid. Row 0 is the top.
///
/// ```
/// use std::path::Path;
/// use rig_core::radiance_image::{RadianceImage, exr};
///
/// let mut image = RadianceImage::new(4, 3);
/// image.mean[0] = [0.25, 0.5, 1.0];
/// image.variance[0] = [1e-4; 3];
/// image.valid[5] = false;
///
/// // `exr::write` and `exr::read` do the same with a file.
/// let bytes = exr::encode(&image, Path::new("example.exr"))?;
/// let file = exr::decode(&bytes, Path::new("example.exr"))?;
/// assert!(file.has_variance);
/// assert_eq!(file.image.mean[0], image.mean[0]);
/// assert_eq!(file.image.valid, image.valid);
/// # Ok::<(), rig_core::radiance_image::exr::ExrError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct RadianceImage {
    pub width: usize,
    pub height: usize,
    /// Mean radiance per pixel, R, G, B. Negative values are kept.
    pub mean: Vec<[f32; 3]>,
    /// Variance of each mean, same unit squared.
    pub variance: Vec<[f32; 3]>,
    /// `false` where the pixel holds no information (saturated in every exposure, hot).
    pub valid: Vec<bool>,
}

impl RadianceImage {
    /// All black, zero variance, all valid.
    pub fn new(width: usize, height: usize) -> Self {
        let pixels = width * height;
        Self {
            width,
            height,
            mean: vec![[0.0; 3]; pixels],
            variance: vec![[0.0; 3]; pixels],
            valid: vec![true; pixels],
        }
    }

    /// Adds these rows of another image of the same width below.
    ///
    /// # Panics
    /// The widths differ.
    pub fn extend(&mut self, other: &Self, rows: Range<usize>) {
        assert_eq!(self.width, other.width, "rows of one image");
        let pixels = rows.start * self.width..rows.end * self.width;
        self.height += rows.len();
        self.mean.extend_from_slice(&other.mean[pixels.clone()]);
        self.variance
            .extend_from_slice(&other.variance[pixels.clone()]);
        self.valid.extend_from_slice(&other.valid[pixels]);
    }

    /// Only these rows.
    #[must_use]
    pub fn rows(&self, rows: Range<usize>) -> Self {
        let pixels = rows.start * self.width..rows.end * self.width;
        Self {
            width: self.width,
            height: rows.len(),
            mean: self.mean[pixels.clone()].to_vec(),
            variance: self.variance[pixels.clone()].to_vec(),
            valid: self.valid[pixels].to_vec(),
        }
    }
}
