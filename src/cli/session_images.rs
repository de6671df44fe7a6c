//! What a session has of each light: its merged image, and where the stage stood.

use super::{CliError, HintExt};
use crate::radiance_image::{RadianceImage, exr};
use crate::session::{Session, layout};
use crate::units::StageAngles;

/// The merged images of the first `lights` lights; only what the journal vouches for.
pub(super) fn radiances(session: &Session, lights: usize) -> Result<Vec<RadianceImage>, CliError> {
    let root = session.root();
    let read = |light| {
        let name = layout::radiance_file(light as u32);
        let image = session
            .read_file(&name)
            .map_err(CliError::from)
            .and_then(|bytes| Ok(exr::decode(&bytes, &root.join(&name))?))
            .hint(format!(
                "`rig capture --resume {}` takes what is missing and merges the raw frames again",
                root.display()
            ))?;
        Ok(image.image)
    };
    (0..lights).map(read).collect()
}

/// Where the stage stood for each light, as read back; as planned where no frame tells.
pub(super) fn places(session: &Session) -> Result<Vec<StageAngles>, CliError> {
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
