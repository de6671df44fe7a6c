//! Fitting image files of a described scene.

use std::path::Path;

use super::cell_images::Source;
use super::fit_plan::FitPlan;
use super::notice::{Notice, Observer};
use super::scene_check::check_scene;
use super::scene_concern::DescribedIn;
use super::{FitOutcome, FitRequest, WorkflowError};
use crate::config::scene::SceneFile;
use crate::radiance_image::exr::ExrRows;
use crate::session::fit_record;

/// The files of such a fit.
#[derive(Clone, Copy, Debug)]
pub struct ImageFit<'a, P> {
    /// Scene file: camera, lights and the sample's shape.
    pub scene: &'a Path,
    /// OpenEXR images, one per light of the scene, in its order.
    pub images: &'a [P],
    /// Folder for the result; it must not exist, or be empty.
    pub out: &'a Path,
}

/// Fits images of a scene and writes the result's folder.
///
/// # Errors
/// A scene, image or choice that cannot be used; images that cannot be the scene's; too little
/// memory; a folder that is not empty or cannot be written. Nothing is written then.
pub fn fit_images<P: AsRef<Path>>(
    files: ImageFit<'_, P>,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<FitOutcome, WorkflowError> {
    let file = SceneFile::load(files.scene)?;
    fit_record::check_folder(files.out)?;
    let sample = &file.sample;
    let plan = FitPlan::new(request, None, &file.uncertainty, sample.form_error)?;
    let scene = file.scene()?;

    // Opened before the work, so that a missing one ends it at once.
    let names = files.images.iter().map(AsRef::as_ref);
    let names: Vec<String> = names.map(|path| path.display().to_string()).collect();
    let (mut sources, mut remarks) = (Vec::new(), Vec::new());
    for (path, name) in files.images.iter().zip(&names) {
        let open = || ExrRows::open(path.as_ref(), Some(scene.camera.resolution_px));
        let source = Source::new(open()?, name.clone(), open)?;
        if source.mean_of_unstated.is_some() {
            let notice = Notice::AssumedNoise { file: name };
            observer.notice(notice);
            remarks.push(notice.to_string());
        }
        sources.push(source);
    }
    check_scene(&scene, DescribedIn::Scene, &sample.surface, observer)?;

    let captured = plan.average(&scene, sources)?;
    let (mut record, images) = plan.run(&scene, &captured, false, None, observer)?;
    record.remarks.extend(remarks);
    record.settings.scene = Some(files.scene.display().to_string());
    record.settings.images = names;
    fit_record::write(files.out, &record, &images)?;
    Ok(FitOutcome {
        folder: files.out.to_owned(),
        record,
    })
}
