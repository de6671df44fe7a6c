//! How sharp the camera is over the sample's depth, from edges at known heights.

use std::path::PathBuf;

use super::{CalibratingError, Kept, Place, image_of};
use crate::calibration::mirror_sphere::Grey;
#[cfg(feature = "figures")]
use crate::calibration::slanted_edge::{Edge, Fitted, figure};
use crate::calibration::slanted_edge::{FocusRequest, FocusValues, check_counts, measure};
use crate::calibration::white::Region;
use crate::config::RigConfig;

/// Edges before the camera of a rig.
pub struct EdgesRequest<'a> {
    /// The bench.
    pub rig: &'a RigConfig,
    /// Radiance images or sessions: one for all edges, or one for each.
    pub input: &'a [PathBuf],
    /// Which light's image of a session is used, from 0.
    pub light: usize,
    /// The part of its image in which each edge is: none (all of it), one for all, or one for each.
    pub regions: &'a [Region],
    /// Height of each edge above the sample's datum, mm.
    pub heights_mm: &'a [f64],
    /// Standard uncertainty that all heights share, mm.
    pub height_std_mm: f64,
}

/// The sharpness as measured.
pub struct MeasuredFocus {
    /// What the record holds.
    pub values: FocusValues,
    source: String,
    method: String,
    /// Of the sensor.
    resolution_px: [u32; 2],
    #[cfg(feature = "figures")]
    drawn: (Vec<Edge>, Fitted),
}

impl EdgesRequest<'_> {
    /// Reads the images and finds point spread, focus and aperture.
    ///
    /// # Errors
    /// Images that cannot be read, or edges that do not determine the lens.
    pub fn measure(&self) -> Result<MeasuredFocus, CalibratingError> {
        let heights = self.heights_mm;
        check_counts(self.input.len(), self.regions.len(), heights.len())?;
        let read = |path: &PathBuf| Ok(Grey::of(&image_of(path, self.light, &self.rig.name)?));
        let images = self.input.iter().map(read);
        let images: Vec<Grey> = images.collect::<Result<_, CalibratingError>>()?;
        #[cfg_attr(
            not(feature = "figures"),
            expect(unused_variables, reason = "drawn alone")
        )]
        let (edges, found, values) = measure(&FocusRequest {
            images: &images,
            regions: self.regions,
            heights_mm: heights,
            height_std_mm: self.height_std_mm,
            camera: &self.rig.geometry.image_camera(),
            cell_px: self.rig.geometry.cell_px,
        })?;
        let names: Vec<_> = self.input.iter().map(|p| p.display().to_string()).collect();
        Ok(MeasuredFocus {
            values,
            source: names.join(", "),
            method: format!(
                "profiles of {} slanted edge(s) at heights from {} to {} mm",
                heights.len(),
                heights.iter().copied().fold(f64::INFINITY, f64::min),
                heights.iter().copied().fold(f64::NEG_INFINITY, f64::max)
            ),
            resolution_px: self.rig.camera.resolution_px,
            #[cfg(feature = "figures")]
            drawn: (edges, found),
        })
    }
}

impl MeasuredFocus {
    /// Keeps the record with its figure.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, place: Place) -> Result<Kept, CalibratingError> {
        let place = place.measured_from(self.source.clone(), self.resolution_px);
        let kept = place.keep(self.values.clone(), &self.method, &[])?;
        #[cfg(feature = "figures")]
        let kept = place.draw(kept, &figure(&self.drawn.0, &self.drawn.1))?;
        Ok(kept)
    }
}
