//! Scene files and renders of them.

use std::path::PathBuf;

use pyo3::prelude::*;
use rig::transport::{
    RenderOptions, Steering, render_polarised, render_with_progress, suited_proposal,
};
use rig_core::SceneFile;

use crate::arrays;
use crate::brdf::Brdf;
use crate::errors::{Fault, check_room, input};
use crate::image::{BYTES_PER_PIXEL, image_record};
use crate::numbers::Integer;
use crate::work;

/// Camera, lights and sample, as a scene file describes them. Immutable.
#[pyclass(frozen, module = "rig_reflectometry")]
pub struct Scene {
    file: SceneFile,
    name: String,
}

impl Scene {
    pub fn file(&self) -> &SceneFile {
        &self.file
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// A scene, or the scene of a file.
    pub fn of(value: &Bound<'_, PyAny>) -> PyResult<Py<Self>> {
        if let Ok(scene) = value.cast::<Self>() {
            return Ok(scene.clone().unbind());
        }
        match value.extract::<PathBuf>() {
            Ok(path) => Py::new(value.py(), Self::load(path)?),
            Err(_) => {
                let kind = value.get_type().name()?.to_string();
                let message =
                    format!("scene is a {kind}; a Scene or a scene file's path is needed");
                Err(input(message).into())
            }
        }
    }
}

#[pymethods]
impl Scene {
    /// Read a scene file (TOML); paths in it are relative to it.
    ///
    /// Raises SceneError for what is wrong in it, with its line, MissingFileError or FileError.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let file = SceneFile::load(&path).map_err(Fault::from)?;
        let name = path.display().to_string();
        Ok(Self { file, name })
    }

    /// Read a scene from text; paths in it are relative to `folder`. Raises SceneError.
    #[staticmethod]
    #[pyo3(signature = (text, folder = PathBuf::from(".")))]
    fn parse(text: &str, folder: PathBuf) -> PyResult<Self> {
        let name = "scene".to_owned();
        let file = SceneFile::parse(&name, &folder, text).map_err(Fault::from)?;
        Ok(Self { file, name })
    }

    /// Pixels of the camera: rows, columns.
    #[getter]
    fn shape(&self) -> (usize, usize) {
        let [width, height] = self.file.camera.resolution_px;
        (height, width)
    }

    /// Number of lights; each gives one image.
    #[getter]
    fn lights(&self) -> usize {
        self.file.lights.len()
    }

    /// The sample's material, if the file has a [brdf] table, else None.
    #[getter]
    fn brdf(&self, py: Python<'_>) -> PyResult<Option<Brdf>> {
        let Some(spec) = &self.file.brdf else {
            return Ok(None);
        };
        let loaded = work::detached(py, || spec.load())?.map_err(Fault::from)?;
        Ok(Some(Brdf::new(
            loaded,
            format!("material of {}", self.name),
        )))
    }

    /// Render one RadianceImage per light, with variances: the images of `rig render`.
    ///
    /// brdf: the sample's material; the file's own if None.
    /// samples_per_pixel: light paths, 2 to 1 000 000.
    /// max_reflections: of the longest path, 1 (direct light only) to 64.
    /// seed: of the light paths.
    /// polarised: follow polarisation; as the file says if None.
    /// progress: called as progress(phase, done, total) with rows of pixels.
    ///
    /// Raises InputError for choices out of range and a scene without a material, SceneError for
    /// a shape that cannot be had.
    #[pyo3(signature = (brdf = None, *, samples_per_pixel = u64::from(RenderOptions::default().samples_per_pixel).into(), max_reflections = u64::from(RenderOptions::default().max_reflections).into(), seed = RenderOptions::default().seed.into(), polarised = None, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of a Python function")]
    fn render(
        &self,
        py: Python<'_>,
        brdf: Option<&Brdf>,
        samples_per_pixel: Integer,
        max_reflections: Integer,
        seed: Integer,
        polarised: Option<bool>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Vec<Py<PyAny>>> {
        let samples_per_pixel = samples_per_pixel.within("samples_per_pixel", 2..=1_000_000)?;
        let max_reflections = max_reflections.within("max_reflections", 1..=64)?;
        let seed = seed.within("seed", 0..=u64::MAX)?;
        let [width, height] = self.file.camera.resolution_px;
        let pixels = arrays::product(&[width, height, self.file.lights.len()]);
        check_room(pixels, 2 * BYTES_PER_PIXEL)?;
        let brdf = match (brdf, &self.file.brdf) {
            (Some(brdf), _) => brdf.inner().clone(),
            (None, Some(own)) => work::detached(py, || own.load())?.map_err(Fault::from)?,
            (None, None) => {
                let message = format!("{} has no [brdf] table, and no brdf is given", self.name);
                return Err(input(message).into());
            }
        };
        let polarised = polarised.unwrap_or(self.file.polarised);
        let images = work::interruptible(py, progress, |progress| {
            let scene = self.file.scene()?;
            let mut options = RenderOptions {
                samples_per_pixel,
                max_reflections,
                seed,
                steering: Steering::default(),
                ..RenderOptions::default()
            };
            options.proposal = suited_proposal(&scene, &*brdf, &options);
            match polarised {
                true => Ok(render_polarised(&scene, &*brdf, &options, progress)?),
                false => Ok(render_with_progress(&scene, &*brdf, &options, progress)),
            }
        })?;
        let images = images.map_err(|error: Fault| PyErr::from(error))?;
        let records = images
            .into_iter()
            .map(|image| image_record(py, image, true));
        records.collect()
    }

    fn __repr__(&self) -> String {
        let [width, height] = self.file.camera.resolution_px;
        let lights = self.file.lights.len();
        format!(
            "<Scene {}: {lights} lights, {width} x {height} px>",
            self.name
        )
    }
}
