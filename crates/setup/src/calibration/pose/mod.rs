//! Where the sample truly is: its known mesh is aligned to the images of a session.
//!
//! The material is not known yet, so nothing is assumed of it but that the radiance of
//! each smooth, evenly lit region changes gently. Regions are predicted from mesh,
//! camera and lights by casting rays; in small patches of the images where regions meet,
//! the radiance of each region is eliminated, and what remains determines where outline,
//! creases and edges of cast shadows are. Pose, directions of the lights and blur are
//! found together by Gauss–Newton within the rig file's uncertainty; directions are
//! then marginalised. Which of the six numbers the images do not determine is found from the
//! spectrum of the information; those stay at the prior (docs/adr/0009).
//!
//! | file | what it does |
//! |---|---|
//! | `pieces` | the mesh taken apart at creases |
//! | `regions` | what each pixel sees |
//! | `patches` | normal equations from small patches of the images |
//! | `pyramid` | images on coarse and fine pixels |
//! | `align` | the rounds, from coarse pixels to fine |
//! | `slope` | how much the images really say |
//! | `search` | where to begin if the description is far off |
//! | `values` | what the record holds |
//! | `figure` | what the operator sees |

mod align;
#[cfg(feature = "figures")]
mod figure;
mod patches;
mod pieces;
mod pyramid;
mod regions;
mod search;
mod slope;
mod values;

#[cfg(test)]
mod tests;

use super::record::Measured;
use crate::shown::nth;

pub use align::{align, find};
#[cfg(feature = "figures")]
pub use figure::figure;
pub use values::PoseValues;

/// How a pose is sought.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseOptions {
    /// Rays along one side of a pixel that shows an edge, 2..=16.
    pub subsamples: u32,
    /// Images with more pixels across are binned to at most this many, 32..=4096.
    pub widest_px: usize,
    /// Most rounds on each size of pixels, 2..=50.
    pub rounds: usize,
}

impl PoseOptions {
    /// Usual [`Self::widest_px`].
    pub const WIDEST_PX: u32 = 512;
}

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            subsamples: 5,
            widest_px: Self::WIDEST_PX as usize,
            rounds: 12,
        }
    }
}

/// A pose against the description, with its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseEstimate {
    /// Rotation about x, y and z (vector, radians), then translation (mm): the sample is
    /// turned about its datum, then moved.
    pub values: [f64; 6],
    /// Their covariance.
    pub covariance: [[f64; 6]; 6],
    /// Their standard deviations before the images.
    pub prior: [f64; 6],
    /// What the images do not determine, by name: as described.
    pub held: Vec<String>,
    /// Variance of the images' blur beyond the pixels themselves, square pixels.
    pub blur_px2: Measured,
    /// Squared residuals over noise; what is above 1 has widened the covariance.
    pub reduced_chi2: f64,
    /// Part of the contrast in the patches with edges that the predicted regions explain.
    pub explained: f64,
    /// Patches with edges, and what each would still move.
    pub shifts: Vec<ResidualShift>,
    /// The camera's pixels along a side of the pixels that were compared.
    pub pixel_px: usize,
    /// Rounds that were taken.
    pub rounds: usize,
    /// Whether the last step was short.
    pub settled: bool,
    /// Whether the description was too far off, so that the pose was searched for, of the
    /// poses that look alike the nearest.
    pub searched: bool,
}

/// A patch with edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualShift {
    /// Its middle, the camera's pixels.
    pub at_px: [f64; 2],
    /// How far it would move the sample, along the direction that it sees best.
    pub shift_px: f64,
    /// Standard uncertainty by its noise alone.
    pub std_px: f64,
}

/// Why images give no pose.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum PoseError {
    #[error("{images} images for {lights} lights")]
    ImageCount { images: usize, lights: usize },
    #[error("the image of {light} is not {width} × {height} pixels as the camera's are", light = nth("light", *light))]
    ImageSize {
        /// From 0.
        light: usize,
        width: usize,
        height: usize,
    },
    #[error(
        "uncertainty.rotation_deg or uncertainty.translation_mm is 0: the pose is exactly known"
    )]
    Exact,
    /// Fewer pixels than a few patches.
    #[error("the images are too small to compare edges")]
    TooSmall,
    #[error("{percent:.0}% of the sample's mesh lies in the camera's view")]
    OutsideView { percent: f64 },
    /// Nothing to align.
    #[error("no edge of the sample or of its shadows stands out in the images")]
    NoEdges,
    /// Edges are elsewhere.
    #[error(
        "the sample's predicted outline, creases and shadows explain {percent:.0}% of the contrast around them"
    )]
    NotThere { percent: f64 },
    /// The images contradict the rig file.
    #[error("the {what} is {value:.3} {unit}, {deviations:.1} times its stated uncertainty")]
    TooFar {
        /// Such as `rotation about x`.
        what: String,
        value: f64,
        unit: &'static str,
        deviations: f64,
    },
}
