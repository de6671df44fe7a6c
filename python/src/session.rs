//! Captured sessions.

use std::path::{Path, PathBuf};

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rig_bench::session::fit_record;
use rig_bench::session::{SessionState, layout};
use rig_bench::workflow::fit_session;
use rig_core::radiance_image::exr::{self, ExrRows};
use rig_device::device::FrameKind;

use crate::arrays;
use crate::errors::{Fault, input};
use crate::fit::{Fit, fit_keywords};
use crate::image::{self, image_record};
use crate::numbers::Integer;
use crate::records::{plain, record};
use crate::{fit_options, work};

/// A captured session. Every file that is read must have the checksum of the session's journal;
/// what is added to the session meanwhile, such as a fit, is seen.
#[pyclass(frozen, module = "rig_reflectometry")]
pub struct Session {
    root: PathBuf,
}

impl Session {
    fn open(&self) -> Result<rig_bench::session::Session, Fault> {
        Ok(rig_bench::session::Session::open(&self.root)?)
    }
}

#[pymethods]
impl Session {
    /// Open the session in a folder. Raises SessionError for a folder that is none or is damaged.
    #[new]
    fn new(root: PathBuf) -> PyResult<Self> {
        let session = Self { root };
        session.open()?;
        Ok(session)
    }

    /// Its folder.
    #[getter]
    fn path(&self) -> &Path {
        &self.root
    }

    /// The sample's name.
    #[getter]
    fn sample(&self) -> PyResult<String> {
        Ok(self.open()?.record().sample.clone())
    }

    /// Whether any device was a simulated one.
    #[getter]
    fn simulated(&self) -> PyResult<bool> {
        Ok(self.open()?.record().simulated)
    }

    /// Whether the capture ran to its end.
    #[getter]
    fn complete(&self) -> PyResult<bool> {
        Ok(self.open()?.state() == SessionState::Complete)
    }

    /// session.toml (what was planned and with what), as dictionaries.
    #[getter]
    fn record<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        plain(py, self.open()?.record())
    }

    /// Directions of the lights as asked for, azimuth and elevation in degrees, (lights, 2)
    /// float64.
    #[getter]
    fn lights_deg<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let session = self.open()?;
        let lights = &session.record().plan.lights;
        let angles = lights.iter().flat_map(|l| [l.azimuth_deg, l.elevation_deg]);
        arrays::array(py, angles.collect(), &[lights.len(), 2])
    }

    /// The raw frames in the order in which they were taken, list[Frame].
    #[getter]
    fn frames(&self, py: Python<'_>) -> PyResult<Vec<Py<PyAny>>> {
        let session = self.open()?;
        let frames = session.frames().map(|entry| {
            record!(
                py,
                "Frame",
                light = entry.key.light,
                exposure = entry.key.exposure,
                repeat = entry.key.repeat,
                kind = kind_name(entry.key.kind),
                file = entry.image.path,
            )
        });
        frames.collect()
    }

    /// Counts of a Frame, (rows, columns) uint16 in DN, and how it was taken (exposure times in
    /// seconds, lamp, stage, temperatures), as dictionaries.
    fn read_frame<'py>(
        &self,
        py: Python<'py>,
        frame: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<u16>>, Bound<'py, PyAny>)> {
        let file: String = frame.getattr("file")?.extract()?;
        let session = self.open()?;
        let entry = session.frames().find(|entry| entry.image.path == file);
        let entry = entry.ok_or_else(|| input(format!("the session has no frame {file}")))?;
        let read = py.detach(|| session.read_frame(&entry));
        let (frame, sidecar) = read.map_err(Fault::from)?;
        let size = [frame.height as usize, frame.width as usize];
        Ok((
            arrays::array(py, frame.counts, &size)?,
            plain(py, &sidecar)?,
        ))
    }

    /// The merged image of a light, a RadianceImage.
    ///
    /// Raises InputError for a light that is not in the plan, SessionError for one that was not
    /// captured.
    fn radiance(&self, py: Python<'_>, light: Integer) -> PyResult<Py<PyAny>> {
        let session = self.open()?;
        let lights = session.record().plan.lights.len();
        let last = lights.saturating_sub(1) as u32;
        let light = light.within("light", 0..=last)?;
        let name = layout::radiance_file(light);
        let path = self.root.join(&name);
        let open = || Ok::<_, Fault>(session.open_file(&name)?);
        image::check_size_of(&ExrRows::of_file(open()?, &path, None).map_err(Fault::from)?)?;
        let read = py.detach(|| Ok::<_, Fault>(exr::read_opened(open()?, &path, None)?));
        let file = read?;
        image_record(py, file.image, file.has_variance)
    }

    /// Its fits, the first one first; list[Fit].
    #[getter]
    fn fits(&self) -> PyResult<Vec<Fit>> {
        let session = self.open()?;
        let numbers = fit_record::numbers_in(&session);
        let fits = numbers.into_iter().map(|n| Fit::in_session(&session, n));
        Ok(fits.collect::<Result<_, _>>()?)
    }

    /// Its latest fit. Raises NoFitError if there is none.
    #[getter]
    fn latest_fit(&self) -> PyResult<Fit> {
        let session = self.open()?;
        let latest = fit_record::numbers_in(&session).pop();
        let latest = latest.ok_or_else(|| {
            Fault::from(fit_record::FitRecordError::NoFit {
                folder: self.root.clone(),
            })
        })?;
        Ok(Fit::in_session(&session, latest)?)
    }

    #[doc = concat!("fit($self, *, ", fit_keywords!(), ", pose=None, progress=None)\n--\n")]
    /// Fit the merged images and add the fit to the session, as `rig fit SESSION` does.
    ///
    /// Keywords are those of rig.fit; what is left out is as the session's rig file has it.
    /// pose: record of the sample's pose, by `rig calibrate pose`.
    ///
    /// Raises SessionError, and what rig.fit raises; nothing is written then.
    #[pyo3(signature = (*, progress = None, **options), text_signature = None)]
    fn fit(
        &self,
        py: Python<'_>,
        progress: Option<Py<PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Fit> {
        let request = fit_options::request("fit", options)?;
        let fitted = work::interruptible(py, progress, |progress| {
            fit_session(&self.root, &request, progress)
        })?;
        fitted.map_err(Fault::from)?;
        self.latest_fit()
    }

    fn __getnewargs__(&self) -> std::io::Result<(PathBuf,)> {
        Ok((std::path::absolute(&self.root)?,))
    }

    fn __repr__(&self) -> String {
        format!("<Session {}>", self.root.display())
    }
}

fn kind_name(kind: FrameKind) -> &'static str {
    match kind {
        FrameKind::Light => "light",
        FrameKind::Ambient => "ambient",
        FrameKind::Dark => "dark",
    }
}
