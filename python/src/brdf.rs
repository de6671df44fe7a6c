//! BRDFs: loaded, mixed, evaluated, drawn, written.

use std::path::{self, Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rayon::prelude::*;
use rig_bench::session::fit_record;
use rig_core::brdf::discrepancy::{Discrepancy, Material, VALUES};
use rig_core::brdf::environment::{self, EnvironmentMap};
use rig_core::brdf::sphere::sphere_image;
use rig_core::brdf::{Atom, Brdf as _, Dictionary, HalfDifference, Mixture, check, fitted, nbrdf};
use rig_desk::export::{self, TableFormat};
use rig_desk::material::{self, Angles};
use rig_setup::config::reflectance::BrdfSpec;

use crate::arrays::{self, Columns, Pairs};
use crate::errors::{Fault, check_room, input};
use crate::numbers::Integer;
use crate::records::record;
use crate::{score, work};

/// Pairs of directions from which on they are shared among processors.
const MANY: usize = 4096;
/// Three angles twice, with f, and f alone.
const BYTES_PER_ANGLES: usize =
    3 * size_of::<f64>() + size_of::<Angles>() + size_of::<material::Evaluated>() + 12;

/// How much light a surface reflects, f(wi, wo) in 1/sr, in R, G and B. Isotropic, without the
/// cosine.
///
/// Made by Brdf.load or Brdf.mixture, and by fits. Immutable; may be used from several threads.
#[pyclass(frozen, module = "rig_reflectometry")]
pub struct Brdf {
    brdf: Arc<dyn rig_core::brdf::Brdf>,
    name: String,
    origin: Origin,
}

/// What another process can make it of.
enum Origin {
    /// A name or file that [`material::load`] takes.
    Spec(String),
    /// Its atoms, their weights, and the discrepancy from their mixture.
    Parts(Box<Material>),
}

impl Brdf {
    /// What `spec` names, as [`material::load`].
    fn loaded(spec: &str, name: String) -> Result<Self, Fault> {
        if Path::new(spec).is_dir() {
            let record = fit_record::find(Path::new(spec))?;
            return Ok(Self::of_parts(record.fitted()?, name));
        }
        let brdf = material::load(spec)?;
        let parts = brdf.as_mixture().cloned();
        let origin = match parts {
            Some(mixture) => Origin::Parts(Box::new(mixture.into())),
            None => Origin::Spec(spec.to_owned()),
        };
        Ok(Self { brdf, name, origin })
    }

    /// The material of a scene file.
    pub fn of_scene(spec: &BrdfSpec, name: String) -> Result<Self, Fault> {
        match spec {
            BrdfSpec::Table(path) => Self::loaded(&text_of(path, "table")?, name),
            BrdfSpec::Fit(folder) => Ok(Self::of_parts(fitted::read(folder)?, name)),
            spec => {
                let brdf = spec.load()?;
                let mixture = brdf.as_mixture().cloned();
                let mixture = mixture.ok_or_else(|| input(format!("{name} is no mixture")))?;
                Ok(Self::of_parts(mixture.into(), name))
            }
        }
    }

    /// A mixture with the discrepancy from it.
    pub fn of_parts(parts: Material, name: String) -> Self {
        let brdf: Arc<dyn rig_core::brdf::Brdf> = match parts.as_mixture() {
            Some(mixture) => Arc::new(mixture.clone()),
            None => Arc::new(parts.clone()),
        };
        let origin = Origin::Parts(Box::new(parts));
        Self { brdf, name, origin }
    }

    pub fn inner(&self) -> &Arc<dyn rig_core::brdf::Brdf> {
        &self.brdf
    }
}

#[pymethods]
impl Brdf {
    /// Load a BRDF by name or file, as `rig brdf` does.
    ///
    /// spec: "nbrdf:NAME" (an embedded measured material), "ggx:ALPHA,ETA", "lambertian:ALBEDO",
    ///     a MERL "FILE.binary", an RGL "FILE.bsdf", "DICTIONARY:WEIGHTS.csv", the folder of a
    ///     fit, or a session (its latest fit).
    ///
    /// Raises InputError for a name that stands for nothing or a file that holds something else,
    /// MissingFileError or FileError for a file that cannot be read, NoFitError for a folder
    /// without a fit.
    #[staticmethod]
    fn load(py: Python<'_>, spec: PathBuf) -> PyResult<Self> {
        let spec = text_of(&spec, "spec")?;
        Ok(work::detached(py, || Self::loaded(&spec, spec.clone()))??)
    }

    /// Mix closed forms.
    ///
    /// dictionary: "rig65", "rig26", "paper42", a dictionary file, or a list of N Atom.
    /// weights: (N,), or (3, N) for R, G and B; each ≥ 0, and they sum to 1 (add
    ///     Atom("black") for light that is absorbed).
    /// name: what repr and exports call it.
    ///
    /// Raises InputError for weights of another shape or sum, and atoms out of range.
    #[staticmethod]
    #[pyo3(signature = (dictionary, weights, *, name = None))]
    fn mixture(
        dictionary: &Bound<'_, PyAny>,
        weights: &Bound<'_, PyAny>,
        name: Option<String>,
    ) -> PyResult<Self> {
        let dictionary = Arc::new(dictionary_of(dictionary)?);
        let array = arrays::numbers(weights, "weights")?;
        let array = arrays::readable(&array, "weights")?;
        let array = array.as_array();
        let atoms = dictionary.len();
        let weights: [Vec<f64>; 3] = match array.shape() {
            [n] if *n == atoms => std::array::from_fn(|_| array.iter().copied().collect()),
            [3, n] if *n == atoms => std::array::from_fn(|channel| {
                let row = array.index_axis(numpy::ndarray::Axis(0), channel);
                row.iter().copied().collect()
            }),
            shape => {
                let shape = arrays::shown(shape);
                let message =
                    format!("weights has shape {shape}, but must be ({atoms},) or (3, {atoms})");
                return Err(input(message).into());
            }
        };
        let name = name.unwrap_or_else(|| format!("mixture of {}", dictionary.name()));
        let mixture = Mixture::new(dictionary, weights).map_err(Fault::from)?;
        Ok(Self::of_parts(mixture.into(), name))
    }

    /// As it was named when it was loaded.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// The atoms that it is mixed of, list[Atom]; None if it is no mixture.
    #[getter]
    fn atoms(&self, py: Python<'_>) -> PyResult<Option<Vec<Py<PyAny>>>> {
        let Some(mixture) = self.brdf.as_mixture() else {
            return Ok(None);
        };
        let atoms = mixture.dictionary().atoms().iter();
        atoms
            .map(|atom| atom_record(py, atom))
            .collect::<PyResult<_>>()
            .map(Some)
    }

    /// Weights of its atoms in R, G and B, (3, N) float64; None if it is no mixture.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
        let mixture = self.brdf.as_mixture();
        mixture
            .map(|mixture| by_channel(py, mixture.weights()))
            .transpose()
    }

    /// f at pairs of directions.
    ///
    /// wi, wo: directions to light and viewer, (..., 3), unit vectors of which z is the normal;
    ///     the shapes are broadcast.
    ///
    /// Returns float32 (..., 3), 1/sr in R, G and B, without the cosine; 0 below the horizon.
    /// Directions are rounded to float32. Raises InputError for other shapes and for vectors
    /// that are not of length one within 0.001.
    fn __call__<'py>(
        &self,
        py: Python<'py>,
        wi: &Bound<'py, PyAny>,
        wo: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let Pairs {
            to_light,
            to_viewer,
            shape,
        } = Pairs::of(wi, wo)?;
        let eval = |(i, o): (&Vec3, &Vec3)| self.brdf.eval(*i, *o);
        let values = if to_light.len() < MANY {
            to_light.iter().zip(&to_viewer).map(eval).collect()
        } else {
            work::detached(py, || {
                to_light.par_iter().zip(&to_viewer).map(eval).collect()
            })?
        };
        arrays::triples(py, values, &shape[..shape.len() - 1])
    }

    /// f at angles in degrees, as `rig brdf eval` takes them.
    ///
    /// theta_i_deg, theta_o_deg: polar angles of light and viewer, 0 to 90.
    /// phi_deg: azimuth between the two. The three are broadcast.
    ///
    /// Returns float32 (..., 3), 1/sr. Raises InputError for angles out of range.
    fn at<'py>(
        &self,
        py: Python<'py>,
        theta_i_deg: &Bound<'py, PyAny>,
        theta_o_deg: &Bound<'py, PyAny>,
        phi_deg: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let names = ["theta_i_deg", "theta_o_deg", "phi_deg"];
        let given = [
            arrays::numbers(theta_i_deg, names[0])?,
            arrays::numbers(theta_o_deg, names[1])?,
            arrays::numbers(phi_deg, names[2])?,
        ];
        let ranges = [0.0..=90.0, 0.0..=90.0, -1e6..=1e6];
        let Columns { columns, shape } = Columns::of(&given, names, ranges, BYTES_PER_ANGLES)?;
        let [theta_i, theta_o, phi] = columns;
        let angles = theta_i.into_iter().zip(theta_o).zip(phi);
        let angles = angles.map(|((theta_i_deg, theta_o_deg), phi_deg)| Angles {
            theta_i_deg,
            theta_o_deg,
            phi_deg,
        });
        let angles = angles.collect();
        let evaluated = py.detach(|| material::evaluate(&*self.brdf, angles));
        let values = evaluated.into_iter().map(|evaluated| evaluated.f);
        arrays::triples(py, values.collect(), &shape)
    }

    /// f over half angle (H values) and difference angle (D values), degrees within 0 and 90, at
    /// a difference azimuth of 90°, where every pair of angles exists: the table of a fit.
    ///
    /// Returns float32 (H, D, 3), 1/sr. The table of a fit with its interval is Fit.table.
    fn table<'py>(
        &self,
        py: Python<'py>,
        theta_h_deg: &Bound<'py, PyAny>,
        theta_d_deg: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let half = arrays::list_within(theta_h_deg, "theta_h_deg", 0.0..=90.0)?;
        let difference = arrays::list_within(theta_d_deg, "theta_d_deg", 0.0..=90.0)?;
        let shape = [half.len(), difference.len()];
        check_room(arrays::product(&shape), 2 * size_of::<[f32; 3]>())?;
        let values = py.detach(|| {
            let rows = half.iter().flat_map(|h| {
                difference.iter().map(|d| {
                    let (to_light, to_viewer) = HalfDifference {
                        theta_h_rad: h.to_radians(),
                        theta_d_rad: d.to_radians(),
                        phi_d_rad: std::f64::consts::FRAC_PI_2,
                    }
                    .to_directions();
                    self.brdf.eval(to_light.as_vec3(), to_viewer.as_vec3())
                })
            });
            rows.collect()
        });
        arrays::triples(py, values, &shape)
    }

    /// A sphere of the material under an environment map, as errors between BRDFs are measured.
    ///
    /// map: "city", "forest", "studio", "sunset", or an OpenEXR file of latitudes and longitudes.
    /// size: pixels a side, 8 to 512.
    ///
    /// Returns linear radiance, float32 (size, size, 3), 0 outside the sphere; row 0 is the top.
    #[pyo3(signature = (map = PathBuf::from("studio"), size = Integer::from(128)), text_signature = "($self, map='studio', size=128)")]
    fn environment_sphere<'py>(
        &self,
        py: Python<'py>,
        map: PathBuf,
        size: Integer,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let size = score::sphere_size(size)?;
        let map = match map.to_str().and_then(EnvironmentMap::embedded) {
            Some(embedded) => embedded,
            None if map.extension().is_none() => {
                let known = environment::NAMES.join(", ");
                let map = map.display();
                return Err(input(format!("no environment map {map:?}; known: {known}")).into());
            }
            None => EnvironmentMap::read(&map).map_err(Fault::from)?,
        };
        let image = work::detached(py, || sphere_image(&*self.brdf, &map, size))?;
        arrays::triples(py, image.radiance, &[size, size])
    }

    /// Spheres under the four embedded maps side by side, each exposed for itself, to look at:
    /// the picture of `rig brdf plot`.
    ///
    /// Returns sRGB, uint8 (size, 4 * size, 3).
    #[pyo3(signature = (size = (material::DRAWN_SPHERE_PX as u64).into()))]
    fn spheres<'py>(&self, py: Python<'py>, size: Integer) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
        let size = score::sphere_size(size)?;
        let picture = work::detached(py, || material::spheres(&*self.brdf, size))?;
        let shape = [picture.height() as usize, picture.width() as usize, 3];
        arrays::array(py, picture.into_raw(), &shape)
    }

    /// How far it is from a known truth; see Errors. Published figures use size = 128.
    #[pyo3(signature = (truth, *, size = (rig_core::brdf::score::SPHERE_SIZE as u64).into()))]
    fn errors(&self, py: Python<'_>, truth: &Self, size: Integer) -> PyResult<Py<PyAny>> {
        let size = score::sphere_size(size)?;
        let errors = work::detached(py, || {
            material::errors_between(&*self.brdf, &*truth.brdf, size)
        })?;
        score::errors_record(py, &errors)
    }

    /// What a dictionary can reach of it; see Projection.
    #[pyo3(signature = (dictionary = Dictionary::DEFAULT.to_owned(), *, size = (rig_core::brdf::score::SPHERE_SIZE as u64).into()))]
    fn project(&self, py: Python<'_>, dictionary: String, size: Integer) -> PyResult<Py<PyAny>> {
        let size = score::sphere_size(size)?;
        let projected = work::detached(py, || material::project(&*self.brdf, &dictionary, size))?;
        let projected = projected.map_err(Fault::from)?;
        let loaded = Arc::new(Dictionary::load(&dictionary).map_err(Fault::from)?);
        let mixture = Mixture::new(loaded, projected.weights.clone()).map_err(Fault::from)?;
        let name = format!("{} on {}", self.name, projected.dictionary);
        let brdf = Self::of_parts(mixture.into(), name);
        record!(
            py,
            "Projection",
            brdf = Py::new(py, brdf)?,
            errors = score::errors_record(py, &projected.reference_projection)?,
            floor = score::errors_record(py, &projected.floor)?,
        )
    }

    /// Whether it is physical; see Check.
    fn check(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let found = work::detached(py, || check::check(&*self.brdf))?;
        record!(
            py,
            "Check",
            passes = found.passes(),
            reciprocity = found.reciprocity,
            largest_albedo = found.largest_albedo,
            theta_deg = arrays::array(
                py,
                check::ALBEDO_ANGLES_DEG.to_vec(),
                &[check::ALBEDO_ANGLES_DEG.len()]
            )?,
            albedo = arrays::triples(py, found.albedo.clone(), &[found.albedo.len()])?,
            invalid = found.invalid,
        )
    }

    /// Write a table: "FILE.binary" in the MERL format, "FILE.bsdf" in the RGL format, which
    /// Mitsuba 3 reads as `measured`. A file of that name is replaced, whole or not at all.
    ///
    /// Raises InputError for another ending, FileError where the file cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let Some(format) = TableFormat::of(&path) else {
            let path = path.display();
            return Err(input(format!("{path} ends neither in .binary nor in .bsdf")).into());
        };
        work::detached(py, || export::table(&*self.brdf, &self.name, format, &path))?
            .map_err(Fault::from)?;
        Ok(())
    }

    fn __repr__(&self) -> String {
        format!("<Brdf {}>", self.name)
    }

    /// A name or a measured table's file is sent by its name, anything else by its values.
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let class = py.get_type::<Self>();
        match &self.origin {
            Origin::Spec(spec) => {
                let file = Path::new(spec);
                let absolute = file.exists().then(|| path::absolute(file)).transpose()?;
                let spec = absolute.unwrap_or_else(|| file.to_owned());
                Ok((
                    class.getattr("_loaded")?,
                    (spec, &self.name).into_pyobject(py)?,
                ))
            }
            Origin::Parts(parts) => {
                let [red, green, blue] = &parts.discrepancies;
                let discrepancies = [red, green, blue].map(|of| of.0.as_slice().to_vec());
                let atoms = parts.mixture.dictionary().atoms().iter();
                let atoms: Vec<_> = atoms
                    .map(|atom| atom_record(py, atom))
                    .collect::<Result<_, _>>()?;
                let weights = parts.mixture.weights().clone();
                let state = (atoms, weights, discrepancies, &self.name);
                Ok((class.getattr("_of_parts")?, state.into_pyobject(py)?))
            }
        }
    }

    /// As `load`, with another name: for pickle.
    #[staticmethod]
    fn _loaded(py: Python<'_>, spec: PathBuf, name: String) -> PyResult<Self> {
        let spec = text_of(&spec, "spec")?;
        Ok(work::detached(py, || Self::loaded(&spec, name))??)
    }

    /// Of its atoms, weights and discrepancies in R, G and B: for pickle.
    #[staticmethod]
    fn _of_parts(
        atoms: &Bound<'_, PyAny>,
        weights: [Vec<f64>; 3],
        discrepancies: [Vec<f64>; 3],
        name: String,
    ) -> PyResult<Self> {
        let dictionary = Arc::new(dictionary_of(atoms)?);
        let mixture = Mixture::new(dictionary, weights).map_err(Fault::from)?;
        let of_values = discrepancies.map(|values| Discrepancy::from_values(&values));
        let discrepancies: Option<Vec<_>> = of_values.into_iter().collect();
        let wrong = || {
            input(format!(
                "discrepancies have other than {VALUES} values each"
            ))
        };
        let discrepancies = discrepancies.ok_or_else(wrong)?;
        Ok(Self::of_parts(Material::new(mixture, &discrepancies), name))
    }
}

/// Names of the embedded measured materials, as Brdf.load takes them.
#[pyfunction]
pub fn materials() -> Vec<String> {
    nbrdf::specs()
}

/// A dictionary by name or file, or a list of atoms.
fn dictionary_of(value: &Bound<'_, PyAny>) -> PyResult<Dictionary> {
    if let Ok(name) = value.extract::<PathBuf>() {
        let name = text_of(&name, "dictionary")?;
        return Ok(Dictionary::load(&name).map_err(Fault::from)?);
    }
    let mut atoms = Vec::new();
    for atom in value.try_iter()? {
        atoms.push(atom_of(&atom?)?);
    }
    Ok(Dictionary::new("atoms", atoms).map_err(Fault::from)?)
}

fn atom_of(value: &Bound<'_, PyAny>) -> PyResult<Atom> {
    let kind: String = value.getattr("kind")?.extract()?;
    let number = |name: &str| value.getattr(name)?.extract::<Option<f64>>();
    Atom::from_parts(&kind, number("alpha")?, number("eta")?, number("albedo")?).ok_or_else(|| {
        input(format!(
            "{} is of an unknown kind or lacks a parameter",
            value
        ))
        .into()
    })
}

/// An atom as Python's Atom.
pub fn atom_record(py: Python<'_>, atom: &Atom) -> PyResult<Py<PyAny>> {
    record!(
        py,
        "Atom",
        kind = atom.kind(),
        alpha = atom.alpha(),
        eta = atom.eta(),
        albedo = atom.albedo(),
    )
}

/// Values of R, G and B as an array (3, N).
pub fn by_channel<'py>(
    py: Python<'py>,
    values: &[Vec<f64>; 3],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    arrays::array(py, values.concat(), &[3, values[0].len()])
}

/// A path as text, which the library's names are.
pub fn text_of(path: &Path, name: &str) -> Result<String, Fault> {
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| input(format!("{name} is {}, which is no UTF-8", path.display())))
}
