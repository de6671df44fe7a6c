//! A captured session as fits and calibrations start from it: images, positions of the stage,
//! pose of the sample.

use std::path::Path;

use super::WorkflowError;
use crate::calibration::pose::PoseValues;
use crate::calibration::{Library, Loaded, record_in};
use crate::config::RigConfig;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::ExrRows;
use crate::session::{Session, layout};
use crate::units::StageAngles;

/// A captured session as a fit starts from it; its images are yet to be read.
pub(super) struct CapturedSession {
    pub session: Session,
    pub config: RigConfig,
    /// Angles of the stage for each light, as read back.
    pub positions: Vec<StageAngles>,
}

/// A session with all that a calibration by it starts from.
#[allow(missing_docs)]
pub struct SessionImages {
    pub session: Session,
    pub config: RigConfig,
    /// Angles of the stage for each light, as read back.
    pub places: Vec<StageAngles>,
    /// The merged image of each light.
    pub captured: Vec<RadianceImage>,
}

/// Opens a session.
pub(super) fn captured_session(root: &Path) -> Result<CapturedSession, WorkflowError> {
    let session = Session::open(root)?;
    let config = session.rig()?;
    let positions = session.stage_positions()?;
    Ok(CapturedSession {
        session,
        config,
        positions,
    })
}

impl CapturedSession {
    /// Opens the merged image of each light; each must have the checksum that the journal states.
    pub fn image_rows(&self, root: &Path) -> Result<Vec<ExrRows>, WorkflowError> {
        let size = self.config.geometry.image_camera().resolution_px;
        let lights = 0..self.positions.len() as u32;
        let open = |light: u32| {
            let name = layout::radiance_file(light);
            let opened = self.session.open_file(&name).map_err(WorkflowError::from);
            opened
                .and_then(|file| Ok(ExrRows::of_file(file, &root.join(&name), Some(size))?))
                .map_err(|source| WorkflowError::MergedImage {
                    session: root.to_owned(),
                    source: Box::new(source),
                })
        };
        lights.map(open).collect()
    }
}

/// The merged images of a session with what is known about them.
///
/// # Errors
/// A session that cannot be read, or an image that is missing or damaged.
pub fn session_images(root: &Path) -> Result<SessionImages, WorkflowError> {
    let captured = captured_session(root)?;
    let rows = captured.image_rows(root)?.into_iter();
    let whole = |mut rows: ExrRows| rows.next_rows(rows.size()[1]);
    let images = rows.map(whole).collect::<Result<_, _>>()?;
    let CapturedSession {
        session,
        config,
        positions,
    } = captured;
    Ok(SessionImages {
        session,
        config,
        places: positions,
        captured: images,
    })
}

/// The pose of the sample: of the record that is named, else of the session's copy.
pub(super) fn measured_pose(
    root: &Path,
    named: Option<&Path>,
) -> Result<Option<PoseValues>, WorkflowError> {
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
