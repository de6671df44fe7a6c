//! Fits: made from images, read from folders, looked at, exported.

use std::path::{Path, PathBuf};

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyFloat, PyTuple};
use rig_bench::rendering::deviations;
use rig_bench::session::Session;
use rig_bench::session::fit_record::{self, BudgetRecord, FitImages, FitRecord, Interval};
use rig_bench::workflow::{StatedResult, fit_images_in_memory};
use rig_core::progress::OnePhase;
use rig_core::transport::suited_proposal;
use rig_desk::export::{self, FORMATS, Format};

use crate::arrays::{self, Columns};
use crate::brdf::{Brdf, atom_record, by_channel};
use crate::errors::{Fault, check_room, input};
use crate::image::{image_record, images_of};
use crate::numbers::Integer;
use crate::records::{plain, record};
use crate::scene::{Scene, default_reflections, default_seed, render_options};
use crate::{fit_options, work};

/// Where the images of a fit are.
enum Images {
    Memory(Box<FitImages>),
    Folder(PathBuf),
    Session { root: PathBuf, number: u32 },
}

/// A BRDF found from images, with its uncertainty and what speaks against it. Immutable.
///
/// Made by rig.fit, Session.fit and Fit.load.
#[pyclass(frozen, module = "rig_reflectometry")]
pub struct Fit {
    record: FitRecord,
    images: Images,
    name: String,
}

/// Two moments of a pixel while samples are added, and the deviation.
const BYTES_PER_DEVIATION: usize = 3 * size_of::<[f32; 3]>();
/// Two angles, an interval, and the parts of it that go out.
const BYTES_PER_INTERVAL: usize = 2 * size_of::<[f64; 2]>() + 2 * size_of::<Interval>();

impl Fit {
    /// A fit of a session.
    pub fn in_session(session: &Session, number: u32) -> Result<Self, Fault> {
        let record = fit_record::read_in(session, number)?;
        let root = session.root().to_owned();
        let name = format!("{}, fit {number}", session.record().sample);
        Ok(Self {
            record,
            images: Images::Session { root, number },
            name,
        })
    }

    fn load_images(&self) -> Result<FitImages, Fault> {
        Ok(match &self.images {
            Images::Memory(images) => (**images).clone(),
            Images::Folder(folder) => fit_record::read_images(folder)?,
            Images::Session { root, number } => {
                fit_record::read_images_in(&Session::open(root)?, *number)?
            }
        })
    }
}

#[pymethods]
impl Fit {
    /// Read a fit from its folder (`rig fit --out`, Fit.save), from SESSION/fits/NUMBER, or from
    /// a session (its latest).
    ///
    /// Raises NoFitError for a folder without a fit, SessionError or FileError for a damaged one.
    #[staticmethod]
    fn load(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let name = folder.display().to_string();
        let record = py
            .detach(|| fit_record::find(&folder))
            .map_err(Fault::from)?;
        let images = match in_session(&folder) {
            Some((root, number)) => Images::Session { root, number },
            None => Images::Folder(folder),
        };
        Ok(Self {
            record,
            images,
            name,
        })
    }

    /// The fitted BRDF, with its model discrepancy.
    #[getter]
    fn brdf(&self) -> PyResult<Brdf> {
        let fitted = self.record.fitted().map_err(Fault::from)?;
        Ok(Brdf::of_parts(fitted, self.name.clone()))
    }

    /// The mixture of the weights: the closest one, where the fitted BRDF differs from all.
    #[getter]
    fn mixture(&self) -> PyResult<Brdf> {
        let mixture = self.record.mixture().map_err(Fault::from)?;
        let name = format!("mixture of {}", self.name);
        Ok(Brdf::of_parts(mixture.into(), name))
    }

    /// Name of the dictionary.
    #[getter]
    fn dictionary(&self) -> &str {
        &self.record.dictionary
    }

    /// Its N atoms, list[Atom].
    #[getter]
    fn atoms(&self, py: Python<'_>) -> PyResult<Vec<Py<PyAny>>> {
        let mixture = self.record.mixture().map_err(Fault::from)?;
        let atoms = mixture.dictionary().atoms().iter();
        atoms.map(|atom| atom_record(py, atom)).collect()
    }

    /// Weights in R, G and B, (3, N) float64. Not identifiable one by one: see table.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        by_channel(py, &self.record.weights)
    }

    /// Standard deviation of each weight, (3, N) float64.
    #[getter]
    fn weight_deviations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        by_channel(py, &self.record.weight_deviations)
    }

    /// f with its 95% interval over half and difference angle; see Table.
    #[getter]
    fn table(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let table = &self.record.table;
        let size = [table.theta_h_deg.len(), table.theta_d_deg.len()];
        let layer = |of: fn(&Interval) -> [f64; 3]| {
            arrays::triples(py, table.cells.iter().map(of).collect(), &size)
        };
        let constrained = table.cells.iter().map(|cell| cell.constrained).collect();
        record!(
            py,
            "Table",
            theta_h_deg = arrays::array(py, table.theta_h_deg.clone(), &size[..1])?,
            theta_d_deg = arrays::array(py, table.theta_d_deg.clone(), &size[1..])?,
            value = layer(|cell| cell.value)?,
            lower = layer(|cell| cell.lower)?,
            upper = layer(|cell| cell.upper)?,
            constrained = arrays::array(py, constrained, &size)?,
        )
    }

    /// f with its 95% interval at half and difference angles, degrees within 0 and 90, and
    /// difference azimuths phi_d_deg, degrees; see Interval. The three are broadcast:
    /// theta_h_deg[:, None] and theta_d_deg make a grid.
    ///
    /// In the cells of the table, which is at an azimuth of 90°, it is the table's; elsewhere f is
    /// the BRDF's, and the interval is as wide, relative to f, as there, interpolated between the
    /// cells. f is 0 where a direction lies below the horizon. Raises InputError for angles out of
    /// range.
    #[pyo3(signature = (theta_h_deg, theta_d_deg, phi_d_deg = None))]
    fn interval(
        &self,
        py: Python<'_>,
        theta_h_deg: &Bound<'_, PyAny>,
        theta_d_deg: &Bound<'_, PyAny>,
        phi_d_deg: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<PyAny>> {
        let names = ["theta_h_deg", "theta_d_deg", "phi_d_deg"];
        let right_angle = PyFloat::new(py, 90.0).into_any();
        let given = [
            arrays::numbers(theta_h_deg, names[0])?,
            arrays::numbers(theta_d_deg, names[1])?,
            arrays::numbers(phi_d_deg.unwrap_or(&right_angle), names[2])?,
        ];
        let ranges = [0.0..=90.0, 0.0..=90.0, -360.0..=360.0];
        let Columns { columns, shape } = Columns::of(&given, names, ranges, BYTES_PER_INTERVAL)?;
        let [half, difference, azimuth] = columns;
        let angles: Vec<_> = half
            .into_iter()
            .zip(difference)
            .zip(azimuth)
            .map(|((h, d), phi)| [h, d, phi])
            .collect();
        let found = py
            .detach(|| self.record.intervals(&angles))
            .map_err(Fault::from)?;
        let constrained = found.iter().map(|interval| interval.constrained).collect();
        let layer = |of: fn(&Interval) -> [f64; 3]| {
            arrays::triples(py, found.iter().map(of).collect(), &shape)
        };
        record!(
            py,
            "Interval",
            value = layer(|interval| interval.value)?,
            lower = layer(|interval| interval.lower)?,
            upper = layer(|interval| interval.upper)?,
            constrained = arrays::array(py, constrained, &shape)?,
        )
    }

    /// "explains", "reservations" or "not-to-be-trusted".
    #[getter]
    fn verdict(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        Ok(plain(py, &self.record.verdict())?.unbind())
    }

    /// Reasons not to trust the fit, or not in everything, the gravest first; list[FitWarning].
    #[getter]
    fn warnings(&self, py: Python<'_>) -> PyResult<Vec<Py<PyAny>>> {
        let warnings = self.record.warnings.iter();
        warnings
            .map(|warning| {
                record!(
                    py,
                    "FitWarning",
                    what = &warning.what,
                    likely_cause = &warning.likely_cause,
                    grade = plain(py, &warning.grade)?,
                )
            })
            .collect()
    }

    /// What to know of how the fit was made, list[str].
    #[getter]
    fn remarks(&self) -> Vec<String> {
        self.record.remarks.clone()
    }

    /// χ² per degree of freedom, (lights, 3) float64; about 1 where the material explains the
    /// images.
    #[getter]
    fn reduced_chi_square<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let values = self.record.reduced_chi_square.clone();
        let lights = values.len();
        arrays::triples(py, values, &[lights])
    }

    /// Final value of the objective, dimensionless.
    #[getter]
    fn loss(&self) -> f64 {
        self.record.loss
    }

    /// The loss after each step of the optimiser, (steps,) float64.
    #[getter]
    fn trace<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let losses: Vec<f64> = self.record.trace.iter().map(|point| point.loss).collect();
        let steps = losses.len();
        arrays::array(py, losses, &[steps])
    }

    /// Size of the model discrepancy, in units of what measured materials usually have; 0 where
    /// the images give no evidence of one.
    #[getter]
    fn discrepancy(&self) -> f64 {
        let discrepancy = self.record.discrepancy.as_ref();
        discrepancy.map_or(0.0, |discrepancy| discrepancy.amplitude)
    }

    /// Where the interval comes from, at a few angles; see Budget. None without an interval.
    #[getter]
    fn budget(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let budget = self.record.budget.as_ref();
        budget.map(|budget| budget_record(py, budget)).transpose()
    }

    /// Everything of fit.toml that has no attribute of its own (settings, timings, scores, bench
    /// as refined, versions), as dictionaries.
    #[getter]
    fn record<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        plain(py, &self.record)
    }

    /// Whether the images came from a simulated bench.
    #[getter]
    fn simulated(&self) -> bool {
        self.record.simulated
    }

    /// Images rendered from the fit, one RadianceImage per light, of at most 512 pixels a side.
    fn rendered(&self, py: Python<'_>) -> PyResult<Vec<Py<PyAny>>> {
        let images = py.detach(|| self.load_images())?.rendered;
        let records = images
            .into_iter()
            .map(|image| image_record(py, image, true));
        records.collect()
    }

    /// Captured minus rendered, in standard deviations, likewise.
    fn residual(&self, py: Python<'_>) -> PyResult<Vec<Py<PyAny>>> {
        let images = py.detach(|| self.load_images())?.residual;
        let records = images
            .into_iter()
            .map(|image| image_record(py, image, false));
        records.collect()
    }

    /// How sure the fit is of the images of its material in a scene: the standard deviation of each
    /// pixel over the posterior samples, as `rig render --fit --deviation` has it.
    ///
    /// scene: a Scene, or the path of its file.
    /// max_reflections, seed: as of Scene.render; as many paths are followed as a scatter needs.
    /// progress: called as progress(phase, done, total) with rows of pixels.
    ///
    /// Returns one array per light, (rows, columns, 3) float32, in the images' unit. Raises
    /// InputError for a fit without posterior samples.
    #[pyo3(signature = (scene, *, max_reflections = default_reflections(), seed = default_seed(), progress = None))]
    fn deviations<'py>(
        &self,
        py: Python<'py>,
        scene: &Bound<'py, PyAny>,
        max_reflections: Integer,
        seed: Integer,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Vec<Bound<'py, PyArrayDyn<f32>>>> {
        let scene = Scene::of(scene)?;
        let file = scene.get().file();
        let mut options = render_options(max_reflections, seed)?;
        let [width, height] = file.camera.resolution_px;
        let pixels = arrays::product(&[width, height, file.lights.len()]);
        check_room(pixels, BYTES_PER_DEVIATION)?;
        let samples = self.record.sampled_materials(usize::MAX);
        let samples = samples.map_err(Fault::from)?;
        if samples.len() < 2 {
            let what =
                "the fit has no posterior samples: it drew none, or an earlier version made it";
            return Err(input(what).into());
        }
        let found = work::interruptible(py, progress, |progress| {
            let (scene, material) = (file.scene()?, self.record.material()?);
            options.proposal = suited_proposal(&scene, &*material, &options);
            let progress = OnePhase::begun(progress, "rendering", height * samples.len());
            Ok(deviations(&scene, &samples, &options, &progress))
        })?;
        let found = found.map_err(|error: Fault| PyErr::from(error))?;
        let arrays = found.into_iter();
        arrays
            .map(|of_light| arrays::triples(py, of_light, &[height, width]))
            .collect()
    }

    /// Write the fit's folder, as `rig fit --out` does; it must not exist, or be empty, and
    /// appears whole or not at all. Raises FileError.
    fn save(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        py.detach(|| {
            let images = self.load_images()?;
            fit_record::write(&folder, &self.record, &images)?;
            Ok::<_, Fault>(())
        })?;
        Ok(())
    }

    /// Write the BRDF for another program, as `rig export` does; returns the files written.
    ///
    /// format: a name of a format of that command, such as "merl". "birdf", which states how the
    ///     sample was measured, is for the fits of a session.
    ///
    /// Raises InputError for another format, and for "birdf" without a session.
    fn export(&self, py: Python<'_>, path: PathBuf, format: &str) -> PyResult<Vec<PathBuf>> {
        let Some(format) = Format::named(format) else {
            let known: Vec<_> = FORMATS.iter().map(|format| format.name).collect();
            let known = known.join(", ");
            return Err(input(format!("format is {format:?}, but must be one of {known}")).into());
        };
        let written = work::detached(py, || match &self.images {
            Images::Session { root, number } if !format.needs_no_session() => {
                let result = StatedResult::load(root, Some(*number))?;
                Ok::<_, Fault>(export::export_session(&result, &format, &path)?)
            }
            _ => Ok(export::export(&self.record, &format, &path)?),
        })?;
        Ok(written?.files)
    }

    /// Sent with its images, as the files of its folder.
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let files = py.detach(|| {
            let images = self.load_images()?;
            Ok::<_, Fault>(fit_record::encode(Path::new(""), &self.record, &images)?)
        })?;
        let files = files
            .iter()
            .map(|(name, bytes)| (name, PyBytes::new(py, bytes)));
        let state = (files.collect::<Vec<_>>(), &self.name).into_pyobject(py)?;
        Ok((py.get_type::<Self>().getattr("_of_files")?, state))
    }

    /// Of the files of its folder: for pickle.
    #[staticmethod]
    fn _of_files(py: Python<'_>, files: Vec<(String, Vec<u8>)>, name: String) -> PyResult<Self> {
        let (record, images) = py
            .detach(|| fit_record::decode(&files))
            .map_err(Fault::from)?;
        let images = Images::Memory(Box::new(images));
        Ok(Self {
            record,
            images,
            name,
        })
    }

    fn __repr__(&self) -> String {
        let verdict = self.record.verdict().sentence();
        format!("<Fit {}: {verdict}>", self.name)
    }
}

/// Session and number where `folder` is a session, or SESSION/fits/NUMBER.
fn in_session(folder: &std::path::Path) -> Option<(PathBuf, u32)> {
    if let Ok(session) = Session::open(folder) {
        let latest = fit_record::numbers_in(&session).pop()?;
        return Some((folder.to_owned(), latest));
    }
    let folder = folder.canonicalize().ok()?;
    let number = folder.file_name()?.to_str()?.parse().ok()?;
    let root = folder.parent()?.parent()?;
    let session = Session::open(root).ok()?;
    let is_there = fit_record::numbers_in(&session).contains(&number);
    is_there.then(|| (root.to_owned(), number))
}

fn budget_record(py: Python<'_>, budget: &BudgetRecord) -> PyResult<Py<PyAny>> {
    let rows = budget.row.len();
    let column = |of: fn(&fit_record::BudgetRow) -> f64| {
        arrays::array(py, budget.row.iter().map(of).collect(), &[rows])
    };
    let share: Vec<f64> = budget
        .row
        .iter()
        .flat_map(|row| row.share.clone())
        .collect();
    record!(
        py,
        "Budget",
        sources = budget.sources.clone(),
        theta_h_deg = column(|row| row.theta_h_deg)?,
        theta_d_deg = column(|row| row.theta_d_deg)?,
        value = column(|row| row.value)?,
        relative_std = column(|row| row.relative_std)?,
        share = arrays::array(py, share, &[rows, budget.sources.len()])?,
    )
}

/// The keywords of the options of a fit, as signatures state them.
macro_rules! fit_keywords {
    () => {
        "dictionary=None, optimizer=None, spp=None, max_reflections=None, seed=None, shared_weights=None, model_error=None, mask=None, cells=None, memory=None, kernel=None, refine_bench=None, uncertainty=None, leave_out=None, samples_per_cell=None, memory_mib=None"
    };
}
pub(crate) use fit_keywords;

#[doc = concat!("fit(scene, images, *, ", fit_keywords!(), ", out=None, progress=None)\n--\n")]
/// Fit a BRDF to images of a scene; the result of `rig fit --scene`.
///
/// scene: a Scene, or the path of its file.
/// images: one per light of the scene, in its order: RadianceImage, an array of mean radiances
///     (rows, columns, 3), or an OpenEXR file. Without a variance a relative noise of 0.5% is
///     assumed. Arrays are copied.
/// dictionary: "rig65" (the default), "rig26", "paper42" or a dictionary file.
/// optimizer: "gauss-newton" (the default), "exponentiated-gradient", "single-bounce".
/// spp: light paths per cell, 2 to 65536. max_reflections: 2 to 64. seed: of the paths.
/// shared_weights: the same weights for all channels. model_error: 0 to 1.
/// mask: PNG of the images' size, white where pixels are compared.
/// cells: most cells that are compared. memory: for the whole fit, MiB.
/// kernel: "portable", "avx2", "avx512" or "auto".
/// refine_bench: refine lights and pose too, within the scene file's uncertainty, of which
///     uncertainty, a dictionary such as {"light_deg": 0.5}, replaces values.
/// leave_out: names of bundled materials that the prior of the model discrepancy is not learned
///     from: the truth of simulated images.
/// out: folder in which to keep the fit, as Fit.save.
/// samples_per_cell, memory_mib: the same as spp and memory.
/// progress: called as progress(phase, done, total) with thousandths of the fit's time.
///
/// Raises InputError for arrays and choices that cannot be used, SceneError, FitError for images
/// that cannot be the scene's and for too little memory, MissingFileError or FileError.
#[pyfunction]
#[pyo3(
    signature = (scene, images, *, out = None, progress = None, **options),
    text_signature = None
)]
pub fn fit(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    images: &Bound<'_, PyAny>,
    out: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Fit> {
    let scene = Scene::of(scene)?;
    let scene = scene.get();
    let request = fit_options::request("fit", options)?;
    if let Some(out) = &out {
        fit_record::check_folder(out).map_err(Fault::from)?;
    }
    let images = images_of(images)?;
    let fitted = work::interruptible(py, progress, |progress| {
        fit_images_in_memory(scene.file(), &images, &request, progress)
    })?;
    let (mut record, images) = fitted.map_err(Fault::from)?;
    record.settings.scene = Some(scene.name().to_owned());
    let name = match &out {
        Some(folder) => {
            fit_record::write(folder, &record, &images).map_err(Fault::from)?;
            folder.display().to_string()
        }
        None => format!("of {}", scene.name()),
    };
    Ok(Fit {
        record,
        images: Images::Memory(Box::new(images)),
        name,
    })
}
