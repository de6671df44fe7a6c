//! The record of a camera's sharpness, and the geometry with it.

use serde::{Deserialize, Serialize};

use super::fit::Fitted;
use super::locate::Edge;
use crate::calibration::record::{BadValue, Kind, Measured, Values};
use crate::config::geometry::GeometryConfig;

/// How sharp a camera is, from slanted edges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FocusValues {
    /// Standard deviation of the point spread in focus along either axis, sensor pixels.
    pub point_spread_px: Measured,
    /// Focus and aperture; absent where edges at fewer than three heights were seen.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lens: Option<LensValues>,
    /// χ² per degree of freedom of the edges' common fit; above 1 it scales uncertainties.
    pub reduced_chi2: f64,
    /// The edges.
    pub edges: Vec<MeasuredEdge>,
}

/// Where a lens is sharp, and its aperture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LensValues {
    /// Distance from the camera along its axis at which it is sharp, millimetres.
    pub focus_mm: Measured,
    /// Numerical aperture on the sample's side.
    pub object_na: Measured,
    /// Covariance of point spread (sensor pixels), focus (mm) and numerical aperture.
    pub covariance: [[f64; 3]; 3],
}

/// One edge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredEdge {
    /// Height above the sample's datum, millimetres.
    pub height_mm: f64,
    /// Distance along the camera's axis, millimetres.
    pub depth_mm: f64,
    /// Angle to the nearer axis of the image, degrees.
    pub tilt_deg: f64,
    /// Standard deviation of a Gaussian that blurs as this edge is blurred, sensor pixels.
    pub width_px: Measured,
}

impl Values for FocusValues {
    const KIND: Kind = Kind::Focus;

    fn check(&self) -> Result<(), BadValue> {
        self.point_spread_px.check("point_spread_px", 0.0, 20.0)?;
        if let Some(lens) = &self.lens {
            lens.focus_mm.check("lens.focus_mm", 1e-3, 1e5)?;
            lens.object_na.check("lens.object_na", 0.0, 0.95)?;
        }
        Ok(())
    }
}

impl FocusValues {
    /// What was found on images of which a pixel is `cell_px` sensor pixels wide, of a
    /// target whose heights are all off by a common error of this standard deviation.
    pub fn new(edges: &[Edge], found: &Fitted, cell_px: usize, height_std_mm: f64) -> Self {
        let cell = cell_px as f64;
        let lens = &found.lens;
        let sigma_px = lens.spread_px2.sqrt();
        let tangent = lens.tangent2.max(0.0).sqrt();
        let object_na = tangent / (1.0 + lens.tangent2).sqrt();
        // Derivatives of (spread, focus, aperture) by (variance, focus, squared tangent).
        let by = [
            cell / (2.0 * sigma_px),
            1.0,
            1.0 / (2.0 * tangent.max(1e-12) * (1.0 + lens.tangent2).powf(1.5)),
        ];
        let mut covariance =
            [0, 1, 2].map(|i| [0, 1, 2].map(|j| by[i] * by[j] * found.covariance[(i, j)]));
        covariance[1][1] += height_std_mm * height_std_mm;
        let measured = |value: f64, i: usize| Measured {
            value,
            std: covariance[i][i].max(0.0).sqrt(),
        };
        Self {
            point_spread_px: measured(cell * sigma_px, 0),
            lens: found.defocus.then(|| LensValues {
                focus_mm: measured(lens.focus_mm, 1),
                object_na: measured(object_na, 2),
                covariance,
            }),
            reduced_chi2: found.reduced_chi2,
            edges: edges
                .iter()
                .zip(&found.edges)
                .map(|(edge, fit)| MeasuredEdge {
                    height_mm: edge.height_mm,
                    depth_mm: edge.depth_mm,
                    tilt_deg: edge.tilt_rad().to_degrees(),
                    width_px: Measured::new(cell * fit.width_px[0], cell * fit.width_px[1]),
                })
                .collect(),
        }
    }

    /// Makes the camera of a rig's geometry as sharp as it was measured.
    pub fn apply(&self, geometry: &mut GeometryConfig) {
        let camera = &mut geometry.camera;
        camera.point_spread_px = self.point_spread_px.value;
        if let Some(lens) = &self.lens {
            camera.focus_mm = lens.focus_mm.value;
            camera.object_na = lens.object_na.value;
        }
    }
}
