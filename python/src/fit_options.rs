//! The keywords of a fit as the library's request.

use std::path::PathBuf;

use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rig::cells::BUDGET;
use rig::config::uncertainty::Deviation;
use rig::inverse::exponentiated_gradient::ExponentiatedGradient;
use rig::inverse::gauss_newton::GaussNewton;
use rig::inverse::{Channels, Optimizer};
use rig::transport::Kernel;
use rig::workflow::FitRequest;

use crate::brdf::text_of;
use crate::errors::input;
use crate::numbers::{Integer, Real};

/// Reads the keywords of `function`, each once.
struct Keywords<'a, 'py> {
    function: &'a str,
    left: Option<Bound<'py, PyDict>>,
}

impl<'py> Keywords<'_, 'py> {
    fn take<T: FromPyObjectOwned<'py>>(&self, name: &str) -> PyResult<Option<T>> {
        let Some(left) = &self.left else {
            return Ok(None);
        };
        let Some(value) = left.get_item(name)? else {
            return Ok(None);
        };
        left.del_item(name)?;
        if value.is_none() {
            return Ok(None);
        }
        let value = value.extract::<T>().map_err(|error| {
            let error: PyErr = error.into();
            PyTypeError::new_err(format!("{}() argument '{name}': {error}", self.function))
        });
        value.map(Some)
    }

    fn finish(self) -> PyResult<()> {
        match self.left.and_then(|left| left.keys().iter().next()) {
            None => Ok(()),
            Some(name) => Err(PyTypeError::new_err(format!(
                "{}() got an unexpected keyword argument '{name}'",
                self.function
            ))),
        }
    }
}

/// The request that these keywords of `function` make.
///
/// # Errors
/// TypeError for keywords that don't exist or are of the wrong type, InputError for values out
/// of their range.
pub fn request(function: &str, options: Option<&Bound<'_, PyDict>>) -> PyResult<FitRequest> {
    let left = options.map(|options| options.copy()).transpose()?;
    let keywords = Keywords { function, left };
    let dictionary = keywords.take::<PathBuf>("dictionary")?;
    let dictionary = dictionary.map(|name| text_of(&name, "dictionary"));
    let optimizer = keywords.take::<String>("optimizer")?;
    let kernel = keywords.take::<String>("kernel")?;
    let uncertainty = keywords.take::<Bound<'_, PyDict>>("uncertainty")?;
    let shared_weights = keywords.take::<bool>("shared_weights")?;
    let number = |name: &str, range| match keywords.take::<Integer>(name)? {
        Some(value) => PyResult::Ok(Some(value.within(name, range)?)),
        None => Ok(None),
    };
    let request = FitRequest {
        dictionary: dictionary.transpose()?,
        optimizer: optimizer.map(|name| optimizer_of(&name)).transpose()?,
        samples_per_cell: number("samples_per_cell", 2..=65_536)?.map(|count| count as u32),
        max_reflections: number("max_reflections", 2..=64)?.map(|count| count as u32),
        seed: number("seed", 0..=i64::MAX as u64)?,
        channels: (shared_weights == Some(true)).then_some(Channels::Shared),
        model_error: match keywords.take::<Real>("model_error")? {
            Some(error) => Some(error.within("model_error", 0.0..=1.0)?),
            None => None,
        },
        mask: keywords.take("mask")?,
        cells: number("cells", *BUDGET.start() as u64..=*BUDGET.end() as u64)?
            .map(|cells| cells as usize),
        memory_mib: number("memory_mib", 16..=1_048_576)?,
        kernel: kernel.map(|name| kernel_of(&name)).transpose()?,
        refine_bench: keywords.take("refine_bench")?,
        uncertainty: match uncertainty {
            Some(uncertainty) => deviations(&uncertainty)?,
            None => Vec::new(),
        },
        pose: keywords.take("pose")?,
        job: None,
    };
    keywords.finish()?;
    Ok(request)
}

fn optimizer_of(name: &str) -> PyResult<Optimizer> {
    match name {
        "gauss-newton" => Ok(Optimizer::GaussNewton(GaussNewton::default())),
        "exponentiated-gradient" => Ok(Optimizer::ExponentiatedGradient(
            ExponentiatedGradient::default(),
        )),
        "single-bounce" => Ok(Optimizer::SingleBounce),
        _ => Err(input(format!(
            "optimizer is {name:?}, but must be \"gauss-newton\", \"exponentiated-gradient\" or \"single-bounce\""
        ))
        .into()),
    }
}

fn kernel_of(name: &str) -> PyResult<Kernel> {
    match name {
        "portable" => Ok(Kernel::Portable),
        "avx2" => Ok(Kernel::Avx2),
        "avx512" => Ok(Kernel::Avx512),
        "auto" => Ok(Kernel::detect()),
        _ => Err(input(format!(
            "kernel is {name:?}, but must be \"portable\", \"avx2\", \"avx512\" or \"auto\""
        ))
        .into()),
    }
}

fn deviations(uncertainty: &Bound<'_, PyDict>) -> PyResult<Vec<Deviation>> {
    let mut deviations = Vec::new();
    for (key, value) in uncertainty {
        let (key, Real(value)): (String, Real) = (key.extract()?, value.extract()?);
        let deviation = format!("{key}={value}").parse();
        deviations.push(deviation.map_err(|fact: String| input(format!("uncertainty: {fact}")))?);
    }
    Ok(deviations)
}
