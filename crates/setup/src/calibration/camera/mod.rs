//! The lens from views of a checkerboard: focal length or magnification, principal point
//! and distortion, with their covariance.
//!
//! Corners are found by the ChESS detector, placed to hundredths of a pixel by a fit of two
//! crossing edges each, and explained together: camera and the board's pose in each view
//! by Levenberg–Marquardt from Zhang's start, wrong corners losing their weight.

mod bundle;
mod corner;
#[cfg(feature = "figures")]
mod figure;
mod grid;
pub mod model;
mod result;
mod start;
mod values;
mod views;

use glam::DVec2;
use nalgebra::DMatrix;

pub use self::bundle::{CameraOptions, calibrate};
#[cfg(feature = "figures")]
pub use self::figure::figure;
pub use self::model::Terms;
pub use self::values::{CameraPose, CameraValues, LensModel};
pub use self::views::{Seen, View, find};
use crate::config::geometry::GeometryConfig;
use crate::frames::{self, Rigid, Sample};
use crate::transport::{Camera, LensSpec, Projection};

/// A flat checkerboard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Squares along its two sides, from 4 on.
    pub squares: [u32; 2],
    /// Side of a square, millimetres.
    pub square_mm: f64,
    /// Standard uncertainty of that, common to all squares, millimetres.
    pub square_std_mm: f64,
    /// Standard uncertainty of its tilt where it is laid flat, degrees.
    pub tilt_std_deg: f64,
}

impl Board {
    /// Usual standard uncertainty of the tilt of a board that is laid flat, degrees.
    pub const TILT_STD_DEG: f64 = 0.5;

    /// Inner corners along its two sides.
    pub fn corners(&self) -> [i32; 2] {
        self.squares.map(|n| n as i32 - 1)
    }

    /// Position of a corner on the board, from its middle, millimetres: x along its columns, y
    /// along its rows, z out of its front.
    pub fn corner_mm(&self, node: [i32; 2]) -> DVec2 {
        let [columns, rows] = self.corners();
        let at = |i: i32, n: i32| (f64::from(i) - 0.5 * f64::from(n - 1)) * self.square_mm;
        DVec2::new(at(node[0], columns), at(node[1], rows))
    }
}

/// The camera whose pixels an image of this size has, the sensor's or those of merged
/// images; and the sensor's pixels along one side of one of these.
pub fn described(geometry: &GeometryConfig, size_px: [usize; 2]) -> (Camera, usize) {
    match size_px == geometry.camera.resolution_px {
        true => (geometry.camera, 1),
        false => (geometry.image_camera(), geometry.cell_px),
    }
}

/// Why views of a board do not determine the lens.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum CameraError {
    /// A board or image for which nothing can be found.
    #[error("{what} is {value}, but must be {allowed}")]
    Impossible {
        what: &'static str,
        value: String,
        allowed: &'static str,
    },
    #[error("no board in view {}: {found} of its corners found", index + 1)]
    NotFound {
        /// The image, from 0.
        index: usize,
        found: usize,
    },
    #[error(
        "view {} shows a board of {} × {} corners, the stated one has {} × {}",
        index + 1, found[0], found[1], stated[0], stated[1]
    )]
    OtherBoard {
        /// The image, from 0.
        index: usize,
        found: [i32; 2],
        stated: [i32; 2],
    },
    #[error("view {} does not show the board along both of its sides", index + 1)]
    NotWhole {
        /// The image, from 0.
        index: usize,
    },
    #[error("{found} views show the board, {needed} are needed")]
    TooFewViews { found: usize, needed: usize },
    #[error("the board's corners cover {percent:.0}% of the image, {needed:.0}% are needed")]
    Uncovered { percent: f64, needed: f64 },
    /// Focal length and distance cannot be distinguished.
    #[error("the board's tilts differ by at most {found_deg:.1}°, {needed_deg:.0}° are needed")]
    SameTilt {
        /// Largest angle between the board's normals in two views.
        found_deg: f64,
        needed_deg: f64,
    },
    #[error(
        "the corners are {rms_px:.2} pixels (root mean square) from where a board of this kind would show them, {rejected} of {corners} are left out"
    )]
    Unexplained {
        rms_px: f64,
        rejected: usize,
        corners: usize,
    },
    #[error("the corners are explained by a distortion that no lens has: {0}")]
    Folded(#[from] crate::transport::distortion::Folded),
}

/// A corner and how far off it was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Number of the image.
    pub view: usize,
    /// Where it was seen, pixels.
    pub at_px: DVec2,
    /// Seen against explained, pixels.
    pub off_px: DVec2,
    /// Whether it counted.
    pub used: bool,
}

/// A camera fitted to views of a board.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct CameraFit {
    /// The lens.
    pub projection: Projection,
    /// Its deviation from an ideal one.
    pub lens: LensSpec,
    /// Names of the numbers that were found, in the order of the covariance.
    pub names: Vec<&'static str>,
    /// The numbers: pixels of the image, or millimetres per pixel; the rest as in
    /// [`crate::transport::Coefficients`].
    pub numbers: Vec<f64>,
    pub covariance: DMatrix<f64>,
    /// Pose by the view whose board lies at the sample's datum, and its covariance: rotation
    /// (radians, about the sample's axes) and translation (millimetres).
    pub pose: Option<(Rigid<Sample, frames::Camera>, DMatrix<f64>)>,
    /// Corners.
    pub residuals: Vec<Residual>,
    /// Root mean square distance of the corners that counted, pixels.
    pub rms_px: f64,
    /// χ² over its degrees of freedom, by the corners' own uncertainty.
    pub reduced_chi2: f64,
    /// Part of the image that corners cover.
    pub coverage: f64,
    pub views: usize,
}

impl CameraFit {
    /// The camera, where `described` stands and with its pixels.
    pub fn camera(&self, described: &Camera) -> Result<Camera, CameraError> {
        let mut camera = Camera {
            projection: self.projection,
            ..*described
        };
        if let Some((pose, _)) = &self.pose {
            camera.sample_from_camera = *pose;
        }
        Ok(camera.with_lens(self.lens)?)
    }
}

#[cfg(test)]
mod tests;
