//! Frames that are each an image by itself: one exposure per light, as most photographs are.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::bracket_files::{BracketFile, FrameReader};
use super::bracket_merge::{BracketMergeError, MergeRequest, Merged, merge};
use super::merge::FrameRole;
use crate::progress::Progress;

/// An image to be made: of one light frame, with the dark and ambient frames of its exposure.
#[derive(Clone, Debug)]
pub struct SingleImage {
    /// The light frame first.
    files: Vec<BracketFile>,
    /// The image.
    pub out: PathBuf,
}

/// The images that `files` make in `folder`, each named as its light frame.
///
/// # Errors
/// Frames that cannot be read, differ in kind or are the same, or whose images would have one
/// name: all of it before anything is written.
pub fn plan(
    files: &[BracketFile],
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Vec<SingleImage>, BracketMergeError> {
    progress.begin("reading frames", Some(files.len()));
    let mut reader = FrameReader::default();
    for file in files {
        reader.read(&file.path)?;
        progress.advance(1);
    }
    let (lights, others): (Vec<&BracketFile>, Vec<_>) =
        files.iter().partition(|file| file.role == FrameRole::Light);
    let mut known = HashMap::new();
    lights
        .into_iter()
        .map(|light| {
            let mut name = light.path.file_stem().unwrap_or_default().to_owned();
            name.push(".exr");
            let out = folder.join(name);
            if let Some(other) = known.insert(out.clone(), &light.path) {
                return Err(BracketMergeError::OneName {
                    frames: [other.clone(), light.path.clone()],
                    out,
                });
            }
            let others = others.iter();
            let same = others.filter(|file| file.exposure_s == light.exposure_s);
            let files = [&light].into_iter().chain(same).map(|&file| file.clone());
            Ok(SingleImage {
                files: files.collect(),
                out,
            })
        })
        .collect()
}

impl SingleImage {
    /// Makes it as `request` asks, whose frames and image are replaced.
    ///
    /// # Errors
    /// See [`merge`].
    pub fn merge(
        &self,
        request: &MergeRequest,
        progress: &dyn Progress,
    ) -> Result<Merged, BracketMergeError> {
        let (files, out) = (&*self.files, &*self.out);
        let request = MergeRequest {
            files,
            out,
            ..request.clone()
        };
        merge(&request, progress)
    }
}
