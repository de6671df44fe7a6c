//! The lens, from views of a checkerboard.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{CalibratingError, Kept, Place};
use crate::calibration::camera::{
    Board, CameraFit, CameraOptions, CameraValues, calibrate, described,
};
use crate::calibration::mirror_sphere::Grey;
use crate::config::RigConfig;
use crate::radiance_image::exr;
use crate::radiometry::bracket_files::read_picture;
use crate::workflow::session_images;

/// Views of a checkerboard.
#[allow(missing_docs)]
pub struct CameraRequest<'a> {
    pub rig: &'a RigConfig,
    /// Merged images, frames, or sessions, whose lights are averaged: one view each.
    pub views: &'a [PathBuf],
    pub board: Board,
    /// What is sought.
    pub options: CameraOptions,
}

/// A camera as measured.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct MeasuredCamera {
    #[serde(flatten)]
    pub values: CameraValues,
    /// Part of the image that corners cover.
    pub coverage: f64,
    /// Why views were left out.
    pub left_out: Vec<String>,
    /// The lens.
    #[serde(skip)]
    pub fit: CameraFit,
    #[serde(skip)]
    source: String,
    #[serde(skip)]
    method: String,
    /// Of the sensor.
    #[serde(skip)]
    resolution_px: [u32; 2],
    #[serde(skip)]
    #[cfg_attr(not(feature = "figures"), expect(dead_code, reason = "drawn alone"))]
    view_px: [usize; 2],
}

impl CameraRequest<'_> {
    /// Reads the views and finds the lens.
    ///
    /// # Errors
    /// A view that cannot be read, or views that do not determine the lens.
    pub fn measure(&self) -> Result<MeasuredCamera, CalibratingError> {
        let images: Vec<Grey> = self
            .views
            .iter()
            .map(|v| read(v))
            .collect::<Result<_, _>>()?;
        let geometry = &self.rig.geometry;
        let size_px = images
            .first()
            .map_or([0, 0], |image| [image.width, image.height]);
        let (described, cell_px) = described(geometry, size_px);
        let (fit, missed) = calibrate(&images, &described, &self.board, &self.options)?;
        let values = CameraValues::new(&fit, &described, cell_px);
        let names: Vec<_> = self.views.iter().map(|v| v.display().to_string()).collect();
        let [columns, rows] = self.board.squares;
        Ok(MeasuredCamera {
            coverage: fit.coverage,
            left_out: missed.iter().map(ToString::to_string).collect(),
            source: names.join(", "),
            method: format!(
                "{} views of a board of {columns} x {rows} squares of {} mm, corners within {:.3} px",
                fit.views, self.board.square_mm, values.residual_px
            ),
            resolution_px: self.rig.camera.resolution_px,
            view_px: described.resolution_px,
            values,
            fit,
        })
    }
}

fn read(path: &Path) -> Result<Grey, CalibratingError> {
    if path.is_dir() {
        let session = session_images(path)?;
        let images: Vec<Grey> = session.captured.iter().map(Grey::of).collect();
        return Grey::mean(&images).ok_or_else(|| CalibratingError::NoImages {
            session: path.to_owned(),
        });
    }
    // A layer may be named after the ending: view.exr:C.
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    if ending.to_string_lossy().split(':').next() == Some("exr") {
        return Ok(Grey::of(&exr::read(path)?.image));
    }
    Ok(Grey::of_picture(&read_picture(path, None)?))
}

impl MeasuredCamera {
    /// Keeps the record with its figure.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, place: &Place) -> Result<Kept, CalibratingError> {
        let place = place
            .clone()
            .measured_from(self.source.clone(), self.resolution_px);
        let kept = place.keep(self.values.clone(), &self.method, &[])?;
        #[cfg(feature = "figures")]
        let kept = place.draw(
            kept,
            &crate::calibration::camera::figure(&self.fit, self.view_px),
        )?;
        Ok(kept)
    }
}
