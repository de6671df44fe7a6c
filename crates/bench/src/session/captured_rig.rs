//! The rig that a session was captured with, as the session itself holds it.

use std::path::{Path, PathBuf};

use super::{Session, SessionError, layout::CALIBRATION_FOLDER};
use crate::brdf::{Dictionary, fitted};
use crate::config::reflectance::BrdfSpec;
use crate::config::view::SurfaceSpec;
use crate::config::{ConfigError, RigConfig};
use crate::outside_file;
use crate::units::StageAngles;

/// Largest file that is copied into a session, bytes: what readers of meshes take.
const LARGEST_FILE_BYTES: u64 = 4 << 30;

/// A mesh or table that a rig file names cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
#[allow(missing_docs)]
pub struct SceneFileError {
    pub path: PathBuf,
    pub source: std::io::Error,
}

impl Session {
    /// The rig as it was: relative paths begin where its rig file is, but the files that
    /// describe the scene are the session's own copies.
    ///
    /// # Errors
    /// The recorded rig file is not valid.
    pub fn rig(&self) -> Result<RigConfig, ConfigError> {
        let record = self.record();
        let folder = Path::new(&record.rig).parent().unwrap_or(Path::new(""));
        let mut config = RigConfig::parse(&record.rig, folder, &record.config)?;
        for (name, path) in scene_paths(&mut config) {
            let copy = self.root().join(CALIBRATION_FOLDER).join(name);
            // Sessions of older versions have none.
            if copy.exists() {
                *path = copy;
            }
        }
        Ok(config)
    }

    /// Where the stage stood for each light, as read back; as planned where no frame tells.
    ///
    /// # Errors
    /// A frame's sidecar that cannot be read or has changed.
    pub fn stage_positions(&self) -> Result<Vec<StageAngles>, SessionError> {
        let mut positions = self.record().plan.lights.clone();
        let mut known = vec![false; positions.len()];
        for entry in self.frames() {
            let light = entry.key.light as usize;
            if light < positions.len() && !known[light] {
                let (_, sidecar) = self.read_frame(&entry)?;
                positions[light] = sidecar.stage_position;
                known[light] = true;
            }
        }
        Ok(positions)
    }

    /// The lights of which there are frames, and whether all of them.
    pub fn begun_lights(&self) -> Vec<(StageAngles, bool)> {
        let has_frames = |light: u32| self.frames().any(|frame| frame.key.light == light);
        (0..)
            .zip(&self.record().plan.lights)
            .filter(|&(light, _)| has_frames(light))
            .map(|(light, &angles)| (angles, self.light_is_finished(light)))
            .collect()
    }
}

/// The files that describe what lies under the camera (the meshes of sample and holder, the
/// holder's reflectance), by the names of their copies: later fits must see what was
/// captured, wherever the session lies then.
///
/// # Errors
/// The first that cannot be read.
pub fn scene_files(config: &RigConfig) -> Result<Vec<(String, Vec<u8>)>, SceneFileError> {
    let mut files = Vec::new();
    for (name, path) in scene_paths(&mut config.clone()) {
        // A fit is a folder, of which the material is kept.
        let parts = match path.is_dir() {
            true => fitted::files(path)
                .into_iter()
                .map(|part| (format!("{name}/{part}"), path.join(part)))
                .collect(),
            false => vec![(name, path.clone())],
        };
        for (name, path) in parts {
            match outside_file::read_regular(&path, LARGEST_FILE_BYTES) {
                Ok(bytes) => files.push((name, bytes)),
                Err(source) => return Err(SceneFileError { path, source }),
            }
        }
    }
    Ok(files)
}

/// The paths of these files and folders, with the names of their copies.
fn scene_paths(config: &mut RigConfig) -> Vec<(String, &mut PathBuf)> {
    let geometry = &mut config.geometry;
    let mut files = Vec::new();
    add_mesh(&mut files, "sample", &mut geometry.sample.surface);
    for (number, body) in geometry.bodies.iter_mut().enumerate() {
        let body_name = format!("body-{number}");
        add_mesh(&mut files, &body_name, &mut body.surface);
        let mut add = |what: &str, path| add(&mut files, &format!("{body_name}-{what}"), path);
        match &mut body.brdf {
            BrdfSpec::Mixture(_) => {}
            BrdfSpec::Table(path) | BrdfSpec::Fit(path) => add("brdf", path),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_material_of_a_fit_is_kept_with_or_without_a_discrepancy() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut config = RigConfig::load(&root.join("rig-configs/rehearsal-ball.toml")).unwrap();
        let fit = tempfile::tempdir().unwrap();
        let names = |config: &RigConfig| -> Vec<String> {
            let files = scene_files(config).unwrap().into_iter();
            files
                .map(|(name, _)| name)
                .filter(|name| name.contains("brdf"))
                .collect()
        };
        config.geometry.bodies[0].brdf = BrdfSpec::Fit(fit.path().to_owned());
        let missing = scene_files(&config).unwrap_err();
        assert!(missing.path.ends_with("weights.csv"), "{missing}");
        std::fs::write(fit.path().join("weights.csv"), "kind\n").unwrap();
        std::fs::write(fit.path().join("fit.toml"), "").unwrap();
        assert_eq!(names(&config), ["body-0-brdf/weights.csv"]);
        std::fs::write(fit.path().join("discrepancy.csv"), "theta_h_deg\n").unwrap();
        let kept = ["body-0-brdf/weights.csv", "body-0-brdf/discrepancy.csv"];
        assert_eq!(names(&config), kept);
    }
}
