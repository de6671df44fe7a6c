//! Scenes: from files, from arrays, and renders of them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use rig_core::geometry::Mesh;
use rig_core::transport::{
    RenderOptions, Shading, Steering, render_polarised, render_with_progress, suited_proposal,
};
use rig_setup::config::view::SurfaceSpec;
use rig_setup::config::{self, scene::SceneFile};

use crate::arrays;
use crate::brdf::Brdf;
use crate::errors::{Fault, check_room, input};
use crate::image::{BYTES_PER_PIXEL, image_record};
use crate::numbers::{Integer, either};
use crate::scene_parts::{camera_record, light_record, mesh_of, mesh_record};
use crate::work;

/// Camera, lights and sample. Immutable.
///
/// Scene(camera, lights, sample, *, irradiance=None, shading="flat", folder=".", **tables)
///
/// camera: a Camera.
/// lights: directions towards the lights, (L, 3), of any length; or L Light. Each gives one image.
/// sample: a Mesh; the path of a mesh file; or a built-in shape as scene files have it, such as
///     {"kind": "bowl", "radius_mm": 10.0}.
/// irradiance: on a plane that faces the light, where lights are directions; broadcast to (L, 3).
/// shading: "flat" (each facet has its own normal) or "smooth".
/// folder: of the paths.
/// tables: further tables of the scene file as dictionaries: brdf, render, uncertainty, and body,
///     a list of them.
///
/// Lengths are millimetres, in the sample's frame: z points out of the hollow. Raises SceneError
/// for values that no scene file may have, InputError for arrays of another shape.
#[pyclass(frozen, module = "rig_reflectometry")]
pub struct Scene {
    file: SceneFile,
    name: String,
    /// What the file says, and where its paths begin.
    text: String,
    folder: PathBuf,
}

impl Scene {
    /// As a text describes it, but for a sample that is given by its mesh.
    fn described(
        text: String,
        folder: PathBuf,
        name: String,
        mesh: Option<Mesh>,
    ) -> Result<Self, Fault> {
        let mut file = SceneFile::parse(&name, &folder, &text)?;
        if let Some(mesh) = mesh {
            file.sample.surface = SurfaceSpec::Made(Arc::new(mesh));
        }
        Ok(Self {
            file,
            name,
            text,
            folder,
        })
    }

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
    #[new]
    #[pyo3(signature = (camera, lights, sample, *, irradiance = None, shading = "flat", folder = PathBuf::from("."), **tables))]
    #[expect(clippy::too_many_arguments, reason = "keywords of a Python function")]
    fn new(
        py: Python<'_>,
        camera: &Bound<'_, PyAny>,
        lights: &Bound<'_, PyAny>,
        sample: &Bound<'_, PyAny>,
        irradiance: Option<&Bound<'_, PyAny>>,
        shading: &str,
        folder: PathBuf,
        tables: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let describe = py.import("rig_reflectometry.scenes")?.getattr("describe")?;
        let text = describe.call1((camera, lights, sample, irradiance, shading, tables))?;
        let mesh = mesh_of(sample)?;
        Ok(Self::described(
            text.extract()?,
            folder,
            UNNAMED.to_owned(),
            mesh,
        )?)
    }

    /// Read a scene file (TOML); paths in it are relative to it.
    ///
    /// Raises SceneError for what is wrong in it, with its line, MissingFileError or FileError.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let text = config::read_text(&path).map_err(Fault::from)?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Ok(Self::described(
            text,
            folder,
            path.display().to_string(),
            None,
        )?)
    }

    /// Read a scene from text; paths in it are relative to `folder`. Raises SceneError.
    #[staticmethod]
    #[pyo3(signature = (text, folder = PathBuf::from(".")))]
    fn parse(text: String, folder: PathBuf) -> PyResult<Self> {
        Ok(Self::described(text, folder, UNNAMED.to_owned(), None)?)
    }

    /// Pixels of the camera: rows, columns.
    #[getter]
    fn shape(&self) -> (usize, usize) {
        let [width, height] = self.file.camera.resolution_px;
        (height, width)
    }

    /// The camera, a Camera.
    #[getter]
    fn camera(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        camera_record(py, &self.file.camera)
    }

    /// The lights, list[Light]; each gives one image.
    #[getter]
    fn lights(&self, py: Python<'_>) -> PyResult<Vec<Py<PyAny>>> {
        let lights = self.file.lights.iter();
        lights.map(|light| light_record(py, light)).collect()
    }

    /// The sample's surface, a Mesh, as it is shaded; of a mesh file, as it is placed.
    #[getter]
    fn mesh(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let sample = &self.file.sample;
        let mesh = py.detach(|| sample.surface.mesh(sample.shading, None));
        mesh_record(py, mesh.map_err(Fault::from)?)
    }

    /// "flat" or "smooth".
    #[getter]
    fn shading(&self) -> &'static str {
        match self.file.sample.shading {
            Shading::Flat => "flat",
            Shading::Smooth => "smooth",
        }
    }

    /// The sample's material, if the file has a [brdf] table, else None.
    #[getter]
    fn brdf(&self, py: Python<'_>) -> PyResult<Option<Brdf>> {
        let Some(spec) = &self.file.brdf else {
            return Ok(None);
        };
        let name = format!("material of {}", self.name);
        Ok(Some(work::detached(py, || Brdf::of_scene(spec, name))??))
    }

    /// Render one RadianceImage per light, with variances: the images of `rig render`.
    ///
    /// brdf: the sample's material; the scene's own if None.
    /// spp: light paths per pixel, 2 to 1 000 000; samples_per_pixel is the same.
    /// max_reflections: of the longest path, 1 (direct light only) to 64.
    /// seed: of the light paths.
    /// polarised: follow polarisation; as the scene says if None.
    /// progress: called as progress(phase, done, total) with rows of pixels.
    ///
    /// Raises InputError for choices out of range and a scene without a material, SceneError for
    /// a shape that cannot be had.
    #[pyo3(signature = (brdf = None, *, spp = None, max_reflections = default_reflections(), seed = default_seed(), polarised = None, progress = None, samples_per_pixel = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of a Python function")]
    fn render(
        &self,
        py: Python<'_>,
        brdf: Option<&Brdf>,
        spp: Option<Integer>,
        max_reflections: Integer,
        seed: Integer,
        polarised: Option<bool>,
        progress: Option<Py<PyAny>>,
        samples_per_pixel: Option<Integer>,
    ) -> PyResult<Vec<Py<PyAny>>> {
        let mut options = render_options(max_reflections, seed)?;
        let names = [("spp", spp), ("samples_per_pixel", samples_per_pixel)];
        if let Some((name, spp)) = either("render", names)? {
            options.samples_per_pixel = spp.within(name, 2..=1_000_000)?;
        }
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

    /// Sent as its text, with a mesh that no file holds.
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let mesh = match &self.file.sample.surface {
            SurfaceSpec::Made(mesh) => Some(mesh_record(py, (**mesh).clone())?),
            _ => None,
        };
        // Of the empty path there is no absolute one.
        let folder = std::path::absolute(Path::new(".").join(&self.folder))?;
        let state = (&self.text, folder, &self.name, mesh).into_pyobject(py)?;
        Ok((py.get_type::<Self>().getattr("_described")?, state))
    }

    /// Of what a text says and, where it is not None, of a Mesh: for pickle.
    #[staticmethod]
    fn _described(
        text: String,
        folder: PathBuf,
        name: String,
        mesh: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        Ok(Self::described(text, folder, name, mesh_of(mesh)?)?)
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

/// What errors call a scene without a file.
const UNNAMED: &str = "scene";

/// Default of `max_reflections`.
pub fn default_reflections() -> Integer {
    u64::from(RenderOptions::default().max_reflections).into()
}

/// Default of `seed`.
pub fn default_seed() -> Integer {
    RenderOptions::default().seed.into()
}

/// Options of a render by what is checked here.
///
/// # Errors
/// InputError for choices out of range.
pub fn render_options(max_reflections: Integer, seed: Integer) -> Result<RenderOptions, Fault> {
    Ok(RenderOptions {
        max_reflections: max_reflections.within("max_reflections", 1..=64)?,
        seed: seed.within("seed", 0..=u64::MAX)?,
        steering: Steering::default(),
        ..RenderOptions::default()
    })
}
