//! Fitting images of a described scene: files, or images in memory.

use std::path::Path;

use super::cell_images::{MemoryRows, Rows, Source};
use super::fit_plan::FitPlan;
use super::fit_run::Run;
use super::notice::{Notice, Observer};
use super::scene_check::check_scene;
use super::{FitOutcome, FitRequest, WorkflowError, image_order};
use crate::cells::AverageError;
use crate::config::scene::SceneFile;
use crate::config::scene_concern::DescribedIn;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::ExrRows;
use crate::session::fit_record::{self, FitImages, FitRecord};
use crate::transport::Scene;

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
    let plan = plan(&file, request)?;
    let scene = file.scene()?;

    // Opened before the work, so that a missing one ends it at once.
    let names = files.images.iter().map(AsRef::as_ref);
    let names: Vec<String> = names.map(|path| path.display().to_string()).collect();
    let mut sources = Vec::new();
    for (path, name) in files.images.iter().zip(&names) {
        let open = || ExrRows::open(path.as_ref(), Some(scene.camera.resolution_px));
        let rows = open()?;
        let has_variance = rows.has_variance();
        sources.push(Source::new(rows, name.clone(), has_variance, open)?);
    }
    let (mut record, images) = fit(&file, &scene, &plan, sources, observer)?;
    record.settings.scene = Some(files.scene.display().to_string());
    record.settings.images = names;
    fit_record::write(files.out, &record, &images)?;
    Ok(FitOutcome {
        folder: files.out.to_owned(),
        record,
    })
}

/// An image in memory.
#[derive(Clone, Debug)]
pub struct NamedImage {
    /// Its name in messages and in the record.
    pub name: String,
    /// The image.
    pub image: RadianceImage,
    /// Whether its variances are stated; else they are ignored, and a relative noise of
    /// [`UNSTATED_NOISE`](super::UNSTATED_NOISE) is assumed.
    pub has_variance: bool,
}

/// Fits images in memory, one per light of the scene, in its order. The result is that of
/// [`fit_images`] by files of the same content, and nothing is written.
///
/// # Errors
/// As [`fit_images`].
pub fn fit_images_in_memory(
    file: &SceneFile,
    images: &[NamedImage],
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<(FitRecord, FitImages), WorkflowError> {
    let plan = plan(file, request)?;
    let scene = file.scene()?;
    let sources = sources_of(images, scene.camera.resolution_px)?;
    let (mut record, fit_images) = fit(file, &scene, &plan, sources, observer)?;
    record.settings.images = images.iter().map(|image| image.name.clone()).collect();
    Ok((record, fit_images))
}

/// Images in memory, about to be read.
///
/// # Errors
/// One of another size than the camera's.
pub(super) fn sources_of(
    images: &[NamedImage],
    expected: [usize; 2],
) -> Result<Vec<Source<MemoryRows<'_>>>, WorkflowError> {
    let mut sources = Vec::new();
    for (index, NamedImage { name, image, .. }) in images.iter().enumerate() {
        let (width, height) = (image.width, image.height);
        if [width, height] != expected {
            let error = AverageError::ImageSize {
                image: index,
                width,
                height,
                expected,
            };
            return Err(error.into());
        }
        let rows = || MemoryRows::of(image);
        let has_variance = images[index].has_variance;
        let source = Source::new(rows(), name.clone(), has_variance, || Ok(rows()))?;
        sources.push(source);
    }
    Ok(sources)
}

fn plan(file: &SceneFile, request: &FitRequest) -> Result<FitPlan, WorkflowError> {
    FitPlan::new(request, None, &file.uncertainty, file.sample.form_error)
}

fn fit<R: Rows>(
    file: &SceneFile,
    scene: &Scene,
    plan: &FitPlan,
    sources: Vec<Source<R>>,
    observer: &dyn Observer,
) -> Result<(FitRecord, FitImages), WorkflowError> {
    let remarks = remarks_on(&sources, observer);
    check_scene(scene, DescribedIn::Scene, &file.sample.surface, observer)?;
    let captured = plan.average(scene, sources)?;
    let Run {
        mut record, fit, ..
    } = plan.run(scene, &captured, false, None, observer)?;
    record.remarks.extend(remarks);
    Ok((record, FitImages::from(&fit.comparison)))
}

/// What is to be known of images before they are fitted: reported, and for the fit's record.
pub(super) fn remarks_on<R>(sources: &[Source<R>], observer: &dyn Observer) -> Vec<String> {
    let mut remarks = Vec::new();
    let names: Vec<&str> = sources.iter().map(|source| &source.file[..]).collect();
    if let Some(given) = &image_order::disorder(&names) {
        let notice = Notice::ImageOrder { given };
        observer.notice(notice);
        remarks.push(notice.to_string());
    }
    let unstated = sources.iter().filter(|s| s.mean_of_unstated.is_some());
    for Source { file, .. } in unstated {
        let notice = Notice::AssumedNoise { file };
        observer.notice(notice);
        remarks.push(notice.to_string());
    }
    remarks
}
