//! Where the sample truly lies, and whether it is uniform and isotropic, from sessions.

use std::path::{Path, PathBuf};

use super::{CalibratingError, Kept, Place, session_of};
use crate::calibration::pose::{PoseEstimate, PoseOptions, PoseValues, find};
use crate::calibration::rotation::{RotationError, RotationTest, Turn, compare};
use crate::config::RigConfig;
use crate::units::StageAngles;
use crate::workflow::{BenchRecords, Observer, SessionImages, session_images};

/// A session whose sample still lies as it did.
pub struct PoseRequest<'a> {
    /// The bench.
    pub rig: &'a RigConfig,
    /// The session's folder.
    pub session: &'a Path,
    /// How the pose is sought.
    pub options: PoseOptions,
}

/// The pose as measured.
pub struct MeasuredPose {
    /// What the record holds.
    pub values: PoseValues,
    /// How it was found.
    pub found: PoseEstimate,
    source: String,
    method: String,
    /// Of the sensor.
    resolution_px: [u32; 2],
    #[cfg(feature = "figures")]
    image_px: [usize; 2],
}

impl PoseRequest<'_> {
    /// Aligns the sample to the session's images; reports the records that were used.
    ///
    /// # Errors
    /// A session that cannot be read, or images that give no pose.
    pub fn measure(&self, observer: &dyn Observer) -> Result<MeasuredPose, CalibratingError> {
        let mut session = session_of(self.session, &self.rig.name)?;
        // The lens and the lights as they were measured: shadows determine the tilt only as well as
        // the lights are known.
        let records = BenchRecords::load(self.session)?;
        let bench = records.apply(&session.config, &mut session.places, observer);
        let scene = bench.geometry.scene(&session.places)?;
        let found = find(&scene, &session.captured, &bench.priors, &self.options)?;
        let values = PoseValues::new(&found);
        Ok(MeasuredPose {
            source: format!("session {}", self.session.display()),
            method: format!(
                "edges of {} patches in {} images, {} rounds",
                values.patches,
                session.captured.len(),
                found.rounds
            ),
            resolution_px: session.config.camera.resolution_px,
            #[cfg(feature = "figures")]
            image_px: scene.camera.resolution_px,
            values,
            found,
        })
    }
}

impl MeasuredPose {
    /// Keeps the record with its figure.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep(&self, place: Place) -> Result<Kept, CalibratingError> {
        let place = place.measured_from(self.source.clone(), self.resolution_px);
        let kept = place.keep(self.values.clone(), &self.method, &[])?;
        #[cfg(feature = "figures")]
        let kept = place.draw(
            kept,
            &crate::calibration::pose::figure(&self.found, self.image_px),
        )?;
        Ok(kept)
    }
}

/// A session, and by how much the sample was turned counterclockwise for it.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnedSession {
    /// Its folder.
    pub root: PathBuf,
    /// The turn, degrees.
    pub angle_deg: f64,
}

/// Two lights further apart are others, degrees.
const SAME_LIGHT_DEG: f64 = 1.0;

/// Compares the sample of `first` (0 degrees) with itself in `others`; `repeatability` is the
/// relative standard deviation of a region's radiance when the sample is seated again. Reports
/// the records that were used.
///
/// # Errors
/// Sessions that cannot be read, or cannot be compared.
pub fn compare_turns(
    first: &Path,
    others: &[TurnedSession],
    repeatability: f64,
    observer: &dyn Observer,
) -> Result<RotationTest, CalibratingError> {
    let mut session = session_images(first)?;
    let bench = BenchRecords::load(first)?.apply(&session.config, &mut session.places, observer);
    let scene = bench.geometry.scene(&session.places)?;
    // The turned sessions, under the same lights.
    let planned = |images: &SessionImages| images.session.record().plan.lights.clone();
    let is_same = |a: &StageAngles, b: &StageAngles| {
        a.to_light().angle_between(b.to_light()).to_degrees() < SAME_LIGHT_DEG
    };
    let mut turned = Vec::new();
    for (index, other) in (1..).zip(others) {
        let images = session_images(&other.root)?;
        let pairs = || images.places.iter().zip(&session.places);
        let same =
            images.places.len() == session.places.len() && pairs().all(|(a, b)| is_same(a, b));
        // What was read back has the offset of the records, which the first has lost to them.
        if !same && planned(&images) != planned(&session) {
            return Err(RotationError::Differs { index }.into());
        }
        turned.push((other.angle_deg, images.captured));
    }
    let first = Turn {
        angle_deg: 0.0,
        images: &session.captured,
    };
    let others = turned.iter().map(|(angle_deg, images)| Turn {
        angle_deg: *angle_deg,
        images,
    });
    let turns: Vec<Turn> = std::iter::once(first).chain(others).collect();
    Ok(compare(&scene, &turns, repeatability)?)
}
