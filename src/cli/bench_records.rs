//! What records say about the bench itself: its lens, where its lights are and how bright. A
//! fit goes by them rather than by the rig file.

use std::path::Path;

use super::{CliError, Context};
use crate::calibration::camera::CameraValues;
use crate::calibration::directions::DirectionsValues;
use crate::calibration::record::LightsValues;
use crate::calibration::{Library, Loaded};
use crate::config::RigConfig;
use crate::config::geometry::GeometryConfig;
use crate::inverse::BenchPriors;
use crate::session::layout::CALIBRATION_FOLDER;
use crate::units::StageAngles;

/// A session's records of its lens and lights.
pub(super) struct BenchRecords {
    irradiance: Option<Loaded<LightsValues>>,
    directions: Option<Loaded<DirectionsValues>>,
    camera: Option<Loaded<CameraValues>>,
}

/// A bench as the rig file and the records together have it.
pub(super) struct KnownBench {
    pub geometry: GeometryConfig,
    pub priors: BenchPriors,
}

impl BenchRecords {
    /// The copies in a session.
    pub fn load(session: &Path) -> Result<Self, CliError> {
        let library = Library::Folder(session.join(CALIBRATION_FOLDER));
        Ok(Self {
            irradiance: library.load(None)?,
            directions: library.load(None)?,
            camera: library.load(None)?,
        })
    }

    /// The bench by these records, and the stage's angles as they truly were. Says which
    /// records it went by.
    pub fn apply(
        &self,
        config: &RigConfig,
        angles: &mut [StageAngles],
        context: &Context,
    ) -> KnownBench {
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
        KnownBench { geometry, priors }
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
