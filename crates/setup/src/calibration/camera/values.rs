//! A camera's record, and the geometry of a rig file with it.

use glam::{DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::CameraFit;
use crate::calibration::record::{BadValue, Kind, Values, must};
use crate::config::geometry::GeometryConfig;
use crate::frames::Rigid;
use crate::transport::distortion::Folded;
use crate::transport::{Camera, Coefficients, LensSpec, Projection};

/// The lens, and where one view showed the sample's datum. Pixels are the sensor's, counted
/// from the image's top left corner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct CameraValues {
    /// "perspective" or "orthographic", as in rig files.
    pub model: LensModel,
    /// Width and height of the sensor, pixels.
    pub resolution_px: [u32; 2],
    /// Focal length across and down, pixels; of a telecentric lens pixels per millimetre.
    pub scale: [f64; 2],
    pub principal_point_px: [f64; 2],
    /// k₁, k₂, k₃ in units of the focal length, or of half the field's width.
    pub radial: [f64; 3],
    /// p₁, p₂, the same.
    pub tangential: [f64; 2],
    /// What was fitted, not fixed: fx, fy (mx, my), cx, cy, k1, k2, k3, p1, p2.
    pub found: Vec<String>,
    /// Covariance of these, one row each.
    pub covariance: Vec<Vec<f64>>,
    pub views: u32,
    /// Corners that counted, and those that were left out.
    pub corners: [u32; 2],
    /// Root mean square distance of the corners, pixels.
    pub residual_px: f64,
    /// χ² over its degrees of freedom by the corners' own uncertainty; the covariance is
    /// widened by it where it is above 1.
    pub reduced_chi2: f64,
    /// Where the camera stands, if a view showed the board at the sample's datum.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub pose: Option<CameraPose>,
}

/// Kinds of lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LensModel {
    /// A pinhole with distortion.
    Perspective,
    /// Telecentric.
    Orthographic,
}

/// Where a camera stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraPose {
    /// Rotation vector from camera to sample, degrees.
    pub rotation_deg: [f64; 3],
    /// The camera in the sample's frame, millimetres.
    pub position_mm: [f64; 3],
    /// Covariance of a further turn about the sample's axes (degrees) and of the position
    /// (millimetres).
    pub covariance: [[f64; 6]; 6],
}

impl CameraValues {
    /// The values of a fit to images whose pixels are `cell_px` of the sensor's wide.
    pub fn new(fit: &CameraFit, camera: &Camera, cell_px: usize) -> Self {
        let cell = cell_px as f64;
        let size = DVec2::from_array(camera.resolution_px.map(|n| n as f64)) * cell;
        let lens = &fit.lens;
        let (model, scale) = match fit.projection {
            Projection::Orthographic { extent_mm } => (LensModel::Orthographic, size / extent_mm),
            Projection::Perspective { fov_rad } => {
                let across = 0.5 * size.x / (0.5 * fov_rad).tan();
                (
                    LensModel::Perspective,
                    DVec2::new(across, across * lens.aspect),
                )
            }
        };
        // Scale and principal point are in pixels of the image.
        let unit = |name: &str| match name {
            "fx" | "fy" | "mx" | "my" | "cx" | "cy" => cell,
            _ => 1.0,
        };
        let rows = fit.names.iter().enumerate().map(|(i, a)| {
            let row = fit.names.iter().enumerate();
            row.map(|(j, b)| fit.covariance[(i, j)] * unit(a) * unit(b))
                .collect()
        });
        let used = fit.residuals.iter().filter(|r| r.used).count();
        let deg = |i: usize| if i < 3 { 1f64.to_degrees() } else { 1.0 };
        Self {
            model,
            resolution_px: size.as_uvec2().to_array(),
            scale: scale.to_array(),
            principal_point_px: ((lens.principal_offset + 0.5) * size).to_array(),
            radial: lens.distortion.radial,
            tangential: lens.distortion.tangential,
            found: fit.names.iter().map(|name| (*name).to_owned()).collect(),
            covariance: rows.collect(),
            views: fit.views as u32,
            corners: [used as u32, (fit.residuals.len() - used) as u32],
            residual_px: fit.rms_px * cell,
            reduced_chi2: fit.reduced_chi2,
            pose: fit.pose.as_ref().map(|(pose, covariance)| CameraPose {
                rotation_deg: pose
                    .rotation
                    .to_scaled_axis()
                    .to_array()
                    .map(f64::to_degrees),
                position_mm: pose.translation_mm.to_array(),
                covariance: std::array::from_fn(|i| {
                    std::array::from_fn(|j| covariance[(i, j)] * deg(i) * deg(j))
                }),
            }),
        }
    }

    /// Standard uncertainty of a number that was found, by name.
    pub fn std(&self, name: &str) -> Option<f64> {
        let index = self.found.iter().position(|found| found == name)?;
        Some(self.covariance.get(index)?.get(index)?.max(0.0).sqrt())
    }

    /// Gives a rig's camera the measured lens and, where it was measured, its pose.
    ///
    /// # Errors
    /// [`Folded`] where the record's distortion folds the image.
    pub fn apply(&self, geometry: &mut GeometryConfig) -> Result<(), Folded> {
        geometry.camera = self.camera(&geometry.camera)?;
        Ok(())
    }

    fn camera(&self, described: &Camera) -> Result<Camera, Folded> {
        let size = DVec2::from_array(self.resolution_px.map(f64::from));
        let scale = DVec2::from_array(self.scale);
        let (projection, aspect) = match self.model {
            LensModel::Orthographic => {
                let extent_mm = size / scale;
                (Projection::Orthographic { extent_mm }, 1.0)
            }
            LensModel::Perspective => {
                let fov_rad = 2.0 * (0.5 * size.x / scale.x).atan();
                (Projection::Perspective { fov_rad }, scale.y / scale.x)
            }
        };
        let mut camera = Camera {
            projection,
            ..*described
        };
        if let Some(pose) = &self.pose {
            let turn = DVec3::from_array(pose.rotation_deg.map(f64::to_radians));
            camera.sample_from_camera = Rigid::new(
                DQuat::from_scaled_axis(turn),
                DVec3::from_array(pose.position_mm),
            );
        }
        camera.with_lens(LensSpec {
            principal_offset: DVec2::from_array(self.principal_point_px) / size - 0.5,
            aspect,
            distortion: Coefficients {
                radial: self.radial,
                tangential: self.tangential,
            },
        })
    }
}

impl Values for CameraValues {
    const KIND: Kind = Kind::Camera;

    fn check(&self) -> Result<(), BadValue> {
        let mut sides = self.resolution_px.iter();
        let possible = sides.all(|n| (1..=100_000).contains(n));
        let value = format!("{:?}", self.resolution_px);
        must(possible, "resolution_px", value, "from 1 to 100000")?;
        let possible = self.scale.iter().all(|s| (1e-6..=1e9).contains(s));
        let value = format!("{:?}", self.scale);
        must(possible, "scale", value, "from 1e-6 to 1e9")?;
        let inside = |i: usize| {
            (0.0..=f64::from(self.resolution_px[i])).contains(&self.principal_point_px[i])
        };
        let value = format!("{:?}", self.principal_point_px);
        let key = "principal_point_px";
        must(inside(0) && inside(1), key, value, "within the image")?;
        let n = self.found.len();
        let square = self.covariance.len() == n && self.covariance.iter().all(|r| r.len() == n);
        let finite = self.covariance.iter().flatten().all(|v| v.is_finite());
        let possible = square && finite && (0..n).all(|i| self.covariance[i][i] >= 0.0);
        let allowed = "one finite row and column for each of values.found";
        must(possible, "covariance", "another matrix", allowed)?;
        let described = Camera {
            resolution_px: self.resolution_px.map(|n| n as usize),
            projection: Projection::Perspective { fov_rad: 1.0 },
            lens: crate::transport::Lens::IDEAL,
            sample_from_camera: Rigid::identity(),
            focus_mm: 1.0,
            object_na: 0.0,
            point_spread_px: 0.0,
        };
        let folded = self.camera(&described).err();
        let allowed = folded.as_ref().map_or(String::new(), ToString::to_string);
        let value = format!("{:?}", self.radial);
        must(folded.is_none(), "radial", value, allowed)
    }
}
