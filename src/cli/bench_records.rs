//! What records say about the bench itself: its lens and how sharp it is, where its lights
//! are and how bright. A fit goes by them rather than by the rig file.

use std::path::Path;

use super::{CliError, Context};
use crate::calibration::camera::CameraValues;
use crate::calibration::directions::DirectionsValues;
use crate::calibration::record::LightsValues;
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, Loaded};
use crate::config::RigConfig;
use crate::config::geometry::GeometryConfig;
use crate::inverse::BenchPriors;
use crate::session::layout::CALIBRATION_FOLDER;
use crate::transport::Scene;
use crate::units::StageAngles;

/// A session's records of its lens and lights.
pub(super) struct BenchRecords {
    irradiance: Option<Loaded<LightsValues>>,
    directions: Option<Loaded<DirectionsValues>>,
    focus: Option<Loaded<FocusValues>>,
    camera: Option<Loaded<CameraValues>>,
}

/// A bench as the rig file and the records together have it.
pub(super) struct KnownBench {
    pub geometry: GeometryConfig,
    pub priors: BenchPriors,
    /// The stage's angles as they were read back.
    places: Vec<StageAngles>,
    /// How bright the lights are against each other, and over the sample.
    intensities: Option<LightsValues>,
}

impl KnownBench {
    /// The scene with the lamp at each of these angles, in the captured lights' order.
    pub fn scene(&mut self, angles: &[StageAngles], context: &Context) -> Result<Scene, CliError> {
        let mut scene = self.geometry.scene(angles)?;
        if let Some(intensities) = &self.intensities {
            let left = intensities.shape(&mut scene, &self.places, &mut self.priors);
            if left > 0 {
                context.warn(format_args!(
                    "intensities of {left} of {} lights were not measured: they count as the mean \
                     of the others; run `rig calibrate white SESSION` with all of them",
                    angles.len()
                ));
            }
        }
        Ok(scene)
    }
}

impl BenchRecords {
    /// The copies in a session.
    pub fn load(session: &Path) -> Result<Self, CliError> {
        let library = Library::Folder(session.join(CALIBRATION_FOLDER));
        Ok(Self {
            irradiance: library.load(None)?,
            directions: library.load(None)?,
            focus: library.load(None)?,
            camera: library.load(None)?,
        })
    }

    /// The same without the irradiance, for who is about to measure it.
    pub fn without_irradiance(session: &Path) -> Result<Self, CliError> {
        Ok(Self {
            irradiance: None,
            ..Self::load(session)?
        })
    }

    /// Whether the irradiance was measured.
    pub fn has_irradiance(&self) -> bool {
        self.irradiance.is_some()
    }

    /// The bench by these records, and the stage's angles as they truly were. Says which
    /// records it went by.
    pub fn apply(
        &self,
        config: &RigConfig,
        angles: &mut [StageAngles],
        context: &Context,
    ) -> KnownBench {
        let as_captured = angles.to_vec();
        let mut geometry = config.geometry.clone();
        let mut priors = config.uncertainty.clone();
        if let Some(loaded) = &self.camera {
            go_by_lens(loaded, &mut geometry, context);
        }
        if let Some(loaded) = &self.irradiance {
            loaded.record.values.apply(&mut geometry);
            loaded.record.values.inform(&mut priors);
            context.note(format_args!("irradiance by record {}", loaded.record.id));
        }
        if let Some(loaded) = &self.directions {
            let unmeasured = loaded.record.values.apply(&mut geometry, angles);
            match unmeasured {
                0 => {
                    loaded.record.values.inform(&mut priors);
                    context.note(format_args!(
                        "light directions by record {}",
                        loaded.record.id
                    ));
                }
                // What the rig file says is uncertain by what the rig file says.
                n => context.warn(format_args!(
                    "record {} has no direction of {n} of {} lights: the rig file's are believed; \
                     run `rig calibrate lights` with all of them",
                    loaded.record.id,
                    angles.len()
                )),
            }
        }
        if let Some(loaded) = &self.focus {
            loaded.record.values.apply(&mut geometry);
            context.note(format_args!("sharpness by record {}", loaded.record.id));
        }
        KnownBench {
            geometry,
            priors,
            places: as_captured,
            intensities: self
                .irradiance
                .as_ref()
                .map(|loaded| loaded.record.values.clone()),
        }
    }
}

/// Gives the geometry the lens of a record, and the camera's place if that was measured.
pub(super) fn go_by_lens(
    loaded: &Loaded<CameraValues>,
    geometry: &mut GeometryConfig,
    context: &Context,
) {
    match loaded.record.values.apply(geometry) {
        Ok(()) => context.note(format_args!("lens by record {}", loaded.record.id)),
        // A record that was checked when it was read folds nothing.
        Err(folded) => context.warn(format!("record {}: {folded}", loaded.record.id)),
    }
}
