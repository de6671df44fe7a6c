//! The profile of a sample, and what tools, paint and sheets can make of it.

use glam::DVec2;
use nalgebra::{DMatrix, DVector};

use crate::geometry::shapes::{Form, knot_height, of_knots};
use crate::geometry::{Mesh, MeshError};

/// Knots from the axis to the rim.
pub const KNOTS: usize = 6;
/// Heights that are free: the rim is at 0.
pub const HEIGHTS: usize = KNOTS - 1;
/// Places from the axis to the rim at which limits are checked.
const CHECKED: usize = 120;

/// What a workshop and a lens allow.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Limits {
    /// Turned about its axis, or drawn along y over twice the radius: a sheet can be pressed over the latter
    /// alone.
    pub form: Form,
    /// From the axis, or the middle plane, to the rim, mm, 1..=1000.
    pub radius_mm: f64,
    /// Steepest slope, degrees from the rim's plane, 5..=85. As a height over the plane a profile
    /// has no overhang.
    pub max_slope_deg: f64,
    /// Smallest radius of curvature on the hollow side, mm: in a moat of the surface, a tool's tip;
    /// on a ridge of what is beneath the paint or sheet, to which a sheet must bend.
    pub min_radius_mm: f64,
    /// Of the paint or the sheet, mm, 0..=100.
    pub thickness_mm: f64,
    /// Depth that is sharp along the camera's axis, mm.
    pub depth_of_field_mm: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            form: Form::Revolved,
            radius_mm: 10.0,
            max_slope_deg: 70.0,
            min_radius_mm: 1.0,
            thickness_mm: 0.0,
            depth_of_field_mm: 20.0,
        }
    }
}

/// Heights over the rim's plane, between knots a cubic polynomial, with continuous curvature; lengths in units of the radius.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Height and slope at evenly spaced distances from the axis.
    pub knots: [[f64; 2]; KNOTS],
}

impl Profile {
    /// The cubic spline through heights at the knots before the rim, level on the axis, straight
    /// at the rim.
    pub fn through(heights: &[f64; HEIGHTS]) -> Self {
        let last = KNOTS - 1;
        let z = |k: usize| heights.get(k).copied().unwrap_or(0.0);
        let triple = 3.0 * last as f64;
        let mut matrix = DMatrix::identity(KNOTS, KNOTS);
        let mut right = DVector::zeros(KNOTS);
        for k in 1..last {
            (matrix[(k, k - 1)], matrix[(k, k)], matrix[(k, k + 1)]) = (1.0, 4.0, 1.0);
            right[k] = triple * (z(k + 1) - z(k - 1));
        }
        (matrix[(last, last - 1)], matrix[(last, last)]) = (1.0, 2.0);
        right[last] = triple * (z(last) - z(last - 1));
        let slopes = matrix.lu().solve(&right).unwrap_or(right);
        Self {
            knots: std::array::from_fn(|k| [z(k), slopes[k]]),
        }
    }

    /// Height and slope at `r` = 0..=1.
    pub fn at(&self, r: f64) -> [f64; 2] {
        knot_height(&self.knots, r)
    }

    fn checked(&self) -> impl Iterator<Item = [f64; 3]> {
        (0..=CHECKED).map(|k| {
            let r = k as f64 / CHECKED as f64;
            let [z, slope] = self.at(r);
            [r, z, slope]
        })
    }

    /// Steepest slope, degrees.
    pub fn steepest_deg(&self) -> f64 {
        let slopes = self.checked().map(|[.., slope]| slope.abs());
        slopes.fold(0.0, f64::max).atan().to_degrees()
    }

    /// Smallest radii of curvature of a moat and of a ridge, in radii.
    pub fn tightest(&self) -> [f64; 2] {
        let slopes: Vec<f64> = self.checked().map(|[.., slope]| slope).collect();
        let curvature = slopes.windows(2).map(|pair| {
            let middle = 0.5 * (pair[0] + pair[1]);
            (pair[1] - pair[0]) * CHECKED as f64 / (1.0 + middle * middle).powf(1.5)
        });
        let most = curvature.fold([1e-9f64; 2], |[moat, ridge], bend| {
            [moat.max(bend), ridge.max(-bend)]
        });
        most.map(f64::recip)
    }

    /// Smallest radius on the hollow side, mm ([`Limits::min_radius_mm`]).
    pub fn smallest_radius_mm(&self, limits: &Limits) -> f64 {
        let [moat, ridge] = self.tightest().map(|radius| radius * limits.radius_mm);
        moat.min(ridge - limits.thickness_mm)
    }

    /// Distance from the axis and height, mm, in `segments` steps to the rim, of the surface that lies
    /// `depth_mm` beneath along the normal.
    pub fn section(&self, radius_mm: f64, depth_mm: f64, segments: u32) -> Vec<DVec2> {
        let at = |k: u32| {
            let r = f64::from(k) / f64::from(segments);
            let [z, slope] = self.at(r);
            radius_mm * DVec2::new(r, z) - depth_mm * DVec2::new(-slope, 1.0).normalize()
        };
        (0..=segments).map(at).collect()
    }

    /// Extent along the axis of a camera that is tilted by this angle, in radii.
    pub fn depth(&self, tilt_deg: f64) -> f64 {
        let (sin, cos) = tilt_deg.to_radians().sin_cos();
        let ends = self
            .checked()
            .flat_map(|[r, z, _]| [z * cos + r * sin, z * cos - r * sin]);
        let [low, high] = ends.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], end| {
            [low.min(end), high.max(end)]
        });
        high - low
    }

    /// Whether it keeps the limits before a camera that is tilted by this angle.
    pub fn keeps(&self, limits: &Limits, tilt_deg: f64) -> bool {
        self.steepest_deg() <= limits.max_slope_deg
            && self.smallest_radius_mm(limits) >= limits.min_radius_mm
            && self.depth(tilt_deg) * limits.radius_mm <= limits.depth_of_field_mm
    }

    /// Flattened until it keeps the limits; flat if the tilt alone breaks them.
    pub fn flattened(&self, limits: &Limits, tilt_deg: f64) -> Self {
        let scaled = |by: f64| Self {
            knots: self.knots.map(|knot| knot.map(|v| by * v)),
        };
        let tries = (0..200).map(|k| scaled(0.95f64.powi(k)));
        let found = tries.into_iter().find(|p| p.keeps(limits, tilt_deg));
        found.unwrap_or_else(|| scaled(0.0))
    }

    /// Its surface, as large and in the form that the limits state.
    pub fn mesh(&self, limits: &Limits, segments: u32) -> Result<Mesh, MeshError> {
        let radius_mm = limits.radius_mm as f32;
        let length_mm = 2.0 * radius_mm;
        of_knots(&self.knots, radius_mm, limits.form, length_mm, segments)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The spline has continuous curvature, and its figures are those of dense differences.
    #[test]
    fn profiles_keep_what_limits_ask_for() {
        let profile = Profile::through(&[0.3, 0.35, 0.1, -0.3, -0.4]);
        let slope = |r: f64| profile.at(r)[1];
        for knot in [0.2, 0.4, 0.6, 0.8] {
            let bend = |side: f64| (slope(knot + side) - slope(knot)) / side;
            assert!((bend(1e-5) - bend(-1e-5)).abs() < 1e-2, "{knot}");
        }
        assert_eq!((slope(0.0), profile.at(1.0)[0]), (0.0, 0.0));

        let limits = Limits::default();
        let steep = Profile::through(&[3.0, 1.0, -1.0, 1.0, -2.0]);
        assert!(!steep.keeps(&limits, 30.0));
        let kept = steep.flattened(&limits, 30.0);
        // No flatter than it must be.
        let steeper = Profile {
            knots: kept.knots.map(|knot| knot.map(|v| v / 0.95)),
        };
        assert!(kept.keeps(&limits, 30.0) && !steeper.keeps(&limits, 30.0));
        assert!(kept.steepest_deg() > 5.0, "{}", kept.steepest_deg());
        // A flat sample at 60° is 2 sin 60° radii deep.
        let flat = Profile::through(&[0.0; HEIGHTS]);
        assert!((flat.depth(60.0) - 2.0 * 60f64.to_radians().sin()).abs() < 1e-9);
        assert!(flat.tightest().iter().all(|&radius| radius > 1e6));

        // Paint takes its thickness from what a ridge may bend to, not from a moat's radius.
        let arc =
            |side: f64| Profile::through(&[-0.5, -0.48, -0.42, -0.32, -0.18].map(|z| side * z));
        let painted = Limits {
            thickness_mm: 2.0,
            ..limits
        };
        let lost = |side: f64| {
            arc(side).smallest_radius_mm(&limits) - arc(side).smallest_radius_mm(&painted)
        };
        assert!(arc(1.0).tightest()[0] < arc(1.0).tightest()[1] - 1.0);
        assert!((lost(-1.0) - 2.0).abs() < 1e-9 && lost(1.0).abs() < 1e-9);
    }
}
