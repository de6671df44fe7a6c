//! A captured session as fits and calibrations start from it: images, where the lamp
//! stood, where the sample lies.

use std::path::Path;

use super::{CliError, HintExt};
use crate::calibration::pose::PoseValues;
use crate::calibration::{Library, Loaded, record_in};
use crate::config::RigConfig;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::ExrRows;
use crate::session::{Session, layout};
use crate::units::StageAngles;

/// A captured session as a fit starts from it; its images are yet to be read.
pub(super) struct CapturedSession {
    /// The session.
    pub session: Session,
    /// The rig as it was.
    pub config: RigConfig,
    /// Where the stage stood for each light.
    pub places: Vec<StageAngles>,
}

/// A session with all that a calibration by it starts from.
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

/// Opens a session.
pub(super) fn captured_session(root: &Path) -> Result<CapturedSession, CliError> {
    let session = Session::open(root)?;
    let config = session.rig()?;
    let places = session.stage_positions()?;
    Ok(CapturedSession {
        session,
        config,
        places,
    })
}

impl CapturedSession {
    /// Opens the merged image of each light, once all are known to be whole: only what the
    /// journal vouches for is fitted.
    pub fn image_rows(&self, root: &Path) -> Result<Vec<ExrRows>, CliError> {
        let size = self.config.geometry.image_camera().resolution_px;
        let lights = 0..self.places.len() as u32;
        let open = |light: u32| {
            let name = layout::radiance_file(light);
            self.session
                .open_file(&name)
                .map_err(CliError::from)
                .and_then(|file| Ok(ExrRows::of_file(file, &root.join(&name), Some(size))?))
                .hint(format!(
                    "`rig capture --resume {}` takes what is missing and merges the raw frames again",
                    root.display()
                ))
        };
        lights.map(open).collect()
    }
}

/// The merged images of a session with what is known about them.
pub(super) fn session_images(root: &Path) -> Result<SessionImages, CliError> {
    let captured = captured_session(root)?;
    let rows = captured.image_rows(root)?.into_iter();
    let whole = |mut rows: ExrRows| rows.next_rows(rows.size()[1]);
    let images = rows.map(whole).collect::<Result<_, _>>()?;
    let CapturedSession {
        session,
        config,
        places,
    } = captured;
    Ok(SessionImages {
        session,
        config,
        places,
        captured: images,
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
