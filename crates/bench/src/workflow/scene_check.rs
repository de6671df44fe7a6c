//! Whether a scene can be measured at all, before anything is captured, read or traced.

use super::WorkflowError;
use super::notice::{Notice, Observer};
use crate::config::scene_concern::{DescribedIn, SceneConcern};
use crate::config::view::SurfaceSpec;
use crate::transport::Scene;
use crate::transport::visibility::Visibility;

/// Refuses a scene whose images can contain no information; reports what is only a remark.
///
/// # Errors
/// The first fatal concern.
pub fn check_scene(
    scene: &Scene,
    file: DescribedIn,
    surface: &SurfaceSpec,
    observer: &dyn Observer,
) -> Result<(), WorkflowError> {
    for remark in scene.remarks() {
        observer.notice(Notice::OfScene(&remark.to_string()));
    }
    for concern in SceneConcern::all(&Visibility::of(scene), file, surface) {
        if concern.concern.is_fatal() {
            return Err(Box::new(concern).into());
        }
        observer.notice(Notice::Scene(&concern));
    }
    Ok(())
}
