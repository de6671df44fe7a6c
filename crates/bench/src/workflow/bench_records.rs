//! The bench as calibration records measured it: lens and sharpness, directions and intensities
//! of the lights. They take precedence over the rig file.

use std::path::Path;

use super::WorkflowError;
use super::notice::{Notice, Observer};
use crate::bench_priors::BenchPriors;
use crate::calibration::camera::CameraValues;
use crate::calibration::directions::DirectionsValues;
use crate::calibration::glare::GlareValues;
use crate::calibration::record::LightsValues;
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, Loaded};
use crate::config::RigConfig;
use crate::config::geometry::GeometryConfig;
use crate::session::Session;
use crate::session::layout::CALIBRATION_FOLDER;
use crate::transport::Scene;
use crate::units::StageAngles;

/// A session's records of its lens and lights.
pub struct BenchRecords {
    irradiance: Option<Loaded<LightsValues>>,
    directions: Option<Loaded<DirectionsValues>>,
    focus: Option<Loaded<FocusValues>>,
    camera: Option<Loaded<CameraValues>>,
    glare: Option<Loaded<GlareValues>>,
}

/// Radiance of a white diffuser at the stage's centre that faces the lamp (R, G, B, W/(m² sr)), by
/// a session's rig file and its record of the irradiance.
///
/// # Errors
/// The recorded rig file or the record is not valid.
pub fn white_radiance(session: &Session) -> Result<[f64; 3], WorkflowError> {
    let mut geometry = session.rig()?.geometry;
    let library = Library::Folder(session.root().join(CALIBRATION_FOLDER));
    if let Some(loaded) = library.load::<LightsValues>(None)? {
        loaded.record.values.apply(&mut geometry);
    }
    let irradiance = geometry.light.irradiance_w_m2;
    Ok(irradiance.map(|irradiance| irradiance / std::f64::consts::PI))
}

/// A bench as the rig file and the records together describe it.
pub struct KnownBench {
    /// Camera, lights and sample.
    pub geometry: GeometryConfig,
    /// How well they are known.
    pub priors: BenchPriors,
    /// The stage's angles as they were read back.
    as_captured: Vec<StageAngles>,
    /// Intensities of the lights relative to each other, and over the sample.
    intensities: Option<LightsValues>,
}

impl KnownBench {
    /// The scene with the lamp at each of these angles, in the captured lights' order.
    pub fn scene(
        &mut self,
        angles: &[StageAngles],
        observer: &dyn Observer,
    ) -> Result<Scene, WorkflowError> {
        let mut scene = self.geometry.scene(angles)?;
        if let Some(intensities) = &self.intensities {
            let left = intensities.shape(&mut scene, &self.as_captured, &mut self.priors);
            if left > 0 {
                observer.notice(Notice::UnmeasuredIntensities {
                    lights: left,
                    of: angles.len(),
                });
            }
        }
        Ok(scene)
    }
}

impl BenchRecords {
    /// The copies in a session.
    ///
    /// # Errors
    /// A record that cannot be used.
    pub fn load(session: &Path) -> Result<Self, WorkflowError> {
        let library = Library::Folder(session.join(CALIBRATION_FOLDER));
        Ok(Self {
            irradiance: library.load(None)?,
            directions: library.load(None)?,
            focus: library.load(None)?,
            camera: library.load(None)?,
            glare: library.load(None)?,
        })
    }

    /// The same without the irradiance, which is about to be measured.
    pub fn without_irradiance(session: &Path) -> Result<Self, WorkflowError> {
        Ok(Self {
            irradiance: None,
            ..Self::load(session)?
        })
    }

    /// Whether the irradiance was measured.
    pub fn has_irradiance(&self) -> bool {
        self.irradiance.is_some()
    }

    /// The lens' glare, which is not of the images' merge but of their fit.
    pub fn glare(&self) -> Option<&Loaded<GlareValues>> {
        self.glare.as_ref()
    }

    /// The bench by these records; `angles`, as read back from the stage, become those of the
    /// light as measured. Reports which records were used.
    pub fn apply(
        &self,
        config: &RigConfig,
        angles: &mut [StageAngles],
        observer: &dyn Observer,
    ) -> KnownBench {
        let as_captured = angles.to_vec();
        let mut geometry = config.geometry.clone();
        let mut priors = config.uncertainty.clone();
        if let Some(loaded) = &self.camera {
            apply_lens(loaded, &mut geometry, observer);
        }
        if let Some(loaded) = &self.irradiance {
            loaded.record.values.apply(&mut geometry);
            loaded.record.values.inform(&mut priors);
            by_record("irradiance", loaded, observer);
        }
        if let Some(loaded) = &self.directions {
            match loaded.record.values.apply(&mut geometry, angles) {
                0 => {
                    loaded.record.values.inform(&mut priors);
                    by_record("light directions", loaded, observer);
                }
                // Where the rig file's directions are used, so is their uncertainty.
                unmeasured => observer.notice(Notice::UnmeasuredDirections {
                    id: &loaded.record.id,
                    lights: unmeasured,
                    of: angles.len(),
                }),
            }
        }
        if let Some(loaded) = &self.focus {
            loaded.record.values.apply(&mut geometry);
            by_record("sharpness", loaded, observer);
        }
        KnownBench {
            geometry,
            priors,
            as_captured,
            intensities: self
                .irradiance
                .as_ref()
                .map(|loaded| loaded.record.values.clone()),
        }
    }
}

/// Gives the geometry the lens of a record, and the camera's pose if that was measured.
pub fn apply_lens(
    loaded: &Loaded<CameraValues>,
    geometry: &mut GeometryConfig,
    observer: &dyn Observer,
) {
    match loaded.record.values.apply(geometry) {
        Ok(()) => by_record("lens", loaded, observer),
        // Not of a record that was checked when it was read.
        Err(folded) => observer.notice(Notice::UnusableLens {
            id: &loaded.record.id,
            fact: &folded.to_string(),
        }),
    }
}

fn by_record<V>(what: &'static str, loaded: &Loaded<V>, observer: &dyn Observer) {
    let id = &loaded.record.id;
    observer.notice(Notice::ByRecord { what, id });
}
