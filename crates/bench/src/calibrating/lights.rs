//! The directions of the lights, from mirror spheres.

use std::path::{Path, PathBuf};

use super::{CalibratingError, Kept, Place, session_of};
use crate::calibration::Library;
#[cfg(feature = "figures")]
use crate::calibration::figures;
use crate::calibration::mirror_sphere::lights::{DirectionsRequest, MeasuredDirections, measure};
use crate::calibration::mirror_sphere::outline::Stated;
use crate::calibration::mirror_sphere::{Circle, Grey};
use crate::config::geometry::GeometryConfig;
use crate::config::{ResolvedRig, RigConfig};
use crate::device::kinematics::Kinematics;
use crate::radiance_image::{RadianceImage, exr};
use crate::session::layout::CALIBRATION_FOLDER;
use crate::units::StageAngles;
use crate::workflow::{Observer, apply_lens};

/// Mirror spheres before the camera of a rig.
pub struct SpheresRequest<'a> {
    /// The bench whose record is made.
    pub rig: &'a ResolvedRig,
    /// A session, or for fixed lights a merged image of each.
    pub input: &'a [PathBuf],
    /// A merged image in which the outlines are found; else in all lights' images.
    pub outline: Option<&'a Path>,
    /// Radius and height of the spheres.
    pub stated: Stated,
    /// Where spheres roughly are in the image; empty: searched for.
    pub near: &'a [Circle],
    /// How many equal spheres there are, 1 or 2.
    pub spheres: usize,
}

/// The lights as measured.
pub struct MeasuredLights {
    /// Spheres, lights and stage.
    pub found: MeasuredDirections,
    source: String,
    method: String,
    #[cfg_attr(not(feature = "figures"), expect(dead_code, reason = "drawn alone"))]
    seen: (GeometryConfig, Vec<StageAngles>),
}

/// The bench and the pictures of the sphere on it.
struct Pictures {
    config: RigConfig,
    angles: Vec<StageAngles>,
    images: Vec<RadianceImage>,
    source: String,
}

impl SpheresRequest<'_> {
    /// Reads the images and finds the lights; reports whether a record of the lens was used.
    ///
    /// # Errors
    /// Images that cannot be read, or that do not determine the lights.
    pub fn measure(&self, observer: &dyn Observer) -> Result<MeasuredLights, CalibratingError> {
        let pictures = self.read()?;
        let mut geometry = pictures.config.geometry.clone();
        let lens = match self.input {
            [root] if root.is_dir() => Library::Folder(root.join(CALIBRATION_FOLDER)).load(None)?,
            _ => {
                let named = self.rig.config.calibration.camera.as_deref();
                Library::of_rig(self.rig).load(named)?
            }
        };
        if let Some(lens) = &lens {
            apply_lens(lens, &mut geometry, observer);
        }
        let images: Vec<Grey> = pictures.images.iter().map(Grey::of).collect();
        let size_px = geometry.image_camera().resolution_px;
        let outline = match self.outline {
            Some(path) => Some(Grey::of(&exr::read_sized(path, size_px)?.image)),
            None => None,
        };
        let found = measure(&DirectionsRequest {
            geometry: &geometry,
            kinematics: &pictures.config.stage.kinematics(),
            angles: &pictures.angles,
            images: &images,
            outline: outline.as_ref(),
            stated: self.stated,
            near: self.near,
            spheres: self.spheres,
        })?;
        Ok(MeasuredLights {
            method: format!(
                "highlights of {} lights on {} mirror sphere(s) of radius {} mm",
                found.lights.len(),
                found.spheres.len(),
                self.stated.radius_mm
            ),
            found,
            source: pictures.source,
            seen: (geometry, pictures.angles),
        })
    }

    fn read(&self) -> Result<Pictures, CalibratingError> {
        let rig = &self.rig.config;
        if let [root] = self.input
            && root.is_dir()
        {
            let session = session_of(root, &rig.name)?;
            let name = root.file_name().unwrap_or_default().to_string_lossy();
            return Ok(Pictures {
                config: session.config,
                angles: session.places,
                images: session.captured,
                source: format!("session {name}"),
            });
        }
        let Kinematics::FixedLights(lights) = rig.stage.kinematics() else {
            return Err(CalibratingError::NoAngles);
        };
        let (images, lights) = (self.input.len(), lights.directions);
        if images != lights.len() {
            let lights = lights.len();
            return Err(CalibratingError::ImageCount { images, lights });
        }
        let size = rig.geometry.image_camera().resolution_px;
        let read = |file: &PathBuf| Ok(exr::read_sized(file, size)?.image);
        let names: Vec<_> = self.input.iter().map(|f| f.display().to_string()).collect();
        Ok(Pictures {
            config: rig.clone(),
            angles: lights,
            images: (self.input.iter().map(read)).collect::<Result<_, CalibratingError>>()?,
            source: names.join(", "),
        })
    }
}

impl MeasuredLights {
    /// Keeps the record with its figure.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, mut place: Place) -> Result<Kept, CalibratingError> {
        place.measurement.source = self.source.clone();
        let kept = place.keep(self.found.values.clone(), &self.method, &[])?;
        #[cfg(feature = "figures")]
        let kept = {
            let (geometry, angles) = &self.seen;
            let (lights, stage) = (&self.found.lights, self.found.stage.as_ref());
            let figure = figures::light_directions(geometry, angles, lights, stage);
            place.draw(kept, &figure)?
        };
        Ok(kept)
    }
}
