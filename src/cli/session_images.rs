//! A captured session as fits and calibrations start from it: images, where the lamp
//! stood, where the sample lies.

use std::path::Path;

use super::session_rig::session_rig;
use super::{CliError, HintExt};
use crate::calibration::pose::PoseValues;
use crate::calibration::{Library, Loaded, record_in};
use crate::config::RigConfig;
use crate::radiance_image::{RadianceImage, exr};
use crate::session::{Session, layout};
use crate::units::StageAngles;

/// What a fit of a session, or a calibration by it, starts from.
pub(super) struct SessionImages {
    /// The session.
    pub session: Session,
    /// The rig as it was.
    pub config: RigConfig,
    /// Where the stage stood for each light.
    pub places: Vec<StageAngles>,
    /// The merged image of each light.
    pub captured: Vec<RadianceImage>,
}

/// The merged images of a session with what is known about them.
pub(super) fn session_images(root: &Path) -> Result<SessionImages, CliError> {
    let session = Session::open(root)?;
    let record = session.record();
    let config = session_rig(root, record)?;
    let places = places(&session)?;
    let size = config.geometry.image_camera().resolution_px;
    let mut captured = Vec::new();
    for light in 0..places.len() {
        let name = layout::radiance_file(light as u32);
        // Only what the journal vouches for is fitted.
        let image = session
            .read_file(&name)
            .map_err(CliError::from)
            .and_then(|bytes| Ok(exr::decode_sized(&bytes, &root.join(&name), size)?))
            .hint(format!(
                "`rig capture --resume {}` takes what is missing and merges the raw frames again",
                root.display()
            ))?;
        captured.push(image.image);
    }
    Ok(SessionImages {
        session,
        config,
        places,
        captured,
    })
}

/// The pose to go by: of the record that is named, else of the session's copy.
pub(super) fn measured_pose(
    root: &Path,
    named: Option<&Path>,
) -> Result<Option<PoseValues>, CliError> {
    let values = match named {
        Some(path) => Some(record_in(path)?.values),
        None => {
            let copies = Library::Folder(root.join(layout::CALIBRATION_FOLDER));
            let copy: Option<Loaded<PoseValues>> = copies.load(None)?;
            copy.map(|copy| copy.record.values)
        }
    };
    Ok(values)
}

/// Where the stage stood for each light, as read back; as planned where no frame tells.
fn places(session: &Session) -> Result<Vec<StageAngles>, CliError> {
    let mut places = session.record().plan.lights.clone();
    let mut known = vec![false; places.len()];
    for entry in session.frames() {
        let light = entry.key.light as usize;
        if light < places.len() && !known[light] {
            let (_, sidecar) = session.read_frame(&entry)?;
            places[light] = sidecar.stage_position;
            known[light] = true;
        }
    }
    Ok(places)
}
