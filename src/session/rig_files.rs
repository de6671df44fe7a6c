//! The rig that a session was captured with, as the session itself has it.

use std::path::{Path, PathBuf};

use super::SessionError;
use super::layout::CALIBRATION_FOLDER;
use super::record::SessionRecord;
use crate::brdf::Dictionary;
use crate::config::reflectance::BrdfSpec;
use crate::config::view::SurfaceSpec;
use crate::config::{ConfigError, RigConfig};
use crate::outside_file;

/// Largest such file, bytes: what readers of meshes take.
const LARGEST_FILE_BYTES: u64 = 4 << 30;

/// The files that describe what lies under the camera (the meshes of sample and holder, the
/// holder's reflectance), by name and content, for a new session: later fits must use what was
/// captured, wherever the session lies then.
///
/// # Errors
/// A file that cannot be read.
pub fn rig_files(config: &RigConfig) -> Result<Vec<(String, Vec<u8>)>, SessionError> {
    let mut copies = Vec::new();
    for (name, path) in files(&mut config.clone()) {
        let bytes = outside_file::read_regular(path, LARGEST_FILE_BYTES).map_err(|source| {
            SessionError::Io {
                path: path.clone(),
                operation: "read",
                source,
            }
        })?;
        copies.push((name, bytes));
    }
    Ok(copies)
}

/// The session's rig: the files under the camera are the session's copies, other relative paths
/// begin at the rig file's folder.
///
/// # Errors
/// A configuration that this version cannot read.
pub fn session_rig(root: &Path, record: &SessionRecord) -> Result<RigConfig, ConfigError> {
    let folder = Path::new(&record.rig).parent().unwrap_or(Path::new(""));
    let mut config = RigConfig::parse(&record.rig, folder, &record.config)?;
    for (name, path) in files(&mut config) {
        let copy = root.join(CALIBRATION_FOLDER).join(name);
        // Sessions of older versions have none.
        if copy.is_file() {
            *path = copy;
        }
    }
    Ok(config)
}

/// These files' paths, with the names of their copies.
fn files(config: &mut RigConfig) -> Vec<(String, &mut PathBuf)> {
    let geometry = &mut config.geometry;
    let mut files = Vec::new();
    add_mesh(&mut files, "sample", &mut geometry.sample.surface);
    for (number, body) in geometry.bodies.iter_mut().enumerate() {
        let body_name = format!("body-{number}");
        add_mesh(&mut files, &body_name, &mut body.surface);
        let mut add = |what: &str, path| add(&mut files, &format!("{body_name}-{what}"), path);
        match &mut body.brdf {
            BrdfSpec::Mixture(_) => {}
            BrdfSpec::Table(path) => add("brdf", path),
            BrdfSpec::Dictionary {
                dictionary,
                weights,
            } => {
                if !Dictionary::NAMES.contains(&&*dictionary.to_string_lossy()) {
                    add("dictionary", dictionary);
                }
                add("weights", weights);
            }
        }
    }
    files
}

fn add_mesh<'a>(
    files: &mut Vec<(String, &'a mut PathBuf)>,
    of: &str,
    surface: &'a mut SurfaceSpec,
) {
    if let SurfaceSpec::Mesh(spec) = surface {
        add(files, &format!("{of}-mesh"), &mut spec.path);
    }
}

fn add<'a>(files: &mut Vec<(String, &'a mut PathBuf)>, stem: &str, path: &'a mut PathBuf) {
    let name = match path.extension() {
        Some(extension) => format!("{stem}.{}", extension.to_string_lossy()),
        None => stem.to_owned(),
    };
    files.push((name, path));
}
