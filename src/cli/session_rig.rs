//! The rig that a session was captured with, as the session itself has it.

use std::path::Path;

use super::{CliError, HintExt};
use crate::config::view::SurfaceSpec;
use crate::config::{ConfigError, RigConfig};
use crate::session::SessionRecord;
use crate::session::layout::CALIBRATION_FOLDER;

/// Name of the copy of a rig file's mesh, without its extension.
const MESH: &str = "sample-mesh";

/// The sample's mesh, where the rig file names one, as a file for the session: later fits
/// must see the sample that was captured, wherever the session lies then.
pub(super) fn mesh_copy(config: &RigConfig) -> Result<Option<(String, Vec<u8>)>, CliError> {
    let SurfaceSpec::Mesh(path) = &config.geometry.sample.surface else {
        return Ok(None);
    };
    let bytes = std::fs::read(path)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("`mesh` in the rig file is relative to that file")?;
    Ok(Some((name(path), bytes)))
}

/// The session's rig: other relative paths begin where its rig file is, the mesh is the
/// session's copy.
pub(super) fn session_rig(root: &Path, record: &SessionRecord) -> Result<RigConfig, ConfigError> {
    let folder = Path::new(&record.rig).parent().unwrap_or(Path::new(""));
    let mut config = RigConfig::parse(&record.rig, folder, &record.config)?;
    if let SurfaceSpec::Mesh(path) = &mut config.geometry.sample.surface {
        let copy = root.join(CALIBRATION_FOLDER).join(name(path));
        // Sessions of older versions have none.
        if copy.is_file() {
            *path = copy;
        }
    }
    Ok(config)
}

fn name(mesh: &Path) -> String {
    match mesh.extension() {
        Some(extension) => format!("{MESH}.{}", extension.to_string_lossy()),
        None => MESH.to_owned(),
    }
}
