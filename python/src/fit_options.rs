//! The keywords of a fit as the library's request. They are the command line's names, and the
//! longer names of earlier versions.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rig_core::brdf::nbrdf::NAMES;
use rig_setup::config::fit::{FitRequest, Source};
use rig_setup::config::uncertainty::Deviation;

use crate::brdf::text_of;
use crate::errors::input;
use crate::numbers::{Integer, Real, either};

/// The library's keys that have two names here: the command line's, and that of earlier versions.
const TWO_NAMES: [(&str, [&str; 2]); 2] = [
    ("samples_per_cell", ["spp", "samples_per_cell"]),
    ("memory_mib", ["memory", "memory_mib"]),
];

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

    /// The name under which the value of a key of the library is given, and the value.
    fn take_key<T: FromPyObjectOwned<'py>>(
        &self,
        key: &'static str,
    ) -> PyResult<Option<(&'static str, T)>> {
        match TWO_NAMES.iter().find(|(known, _)| *known == key) {
            None => Ok(self.take(key)?.map(|value| (key, value))),
            Some(&(_, [name, other])) => either(
                self.function,
                [(name, self.take(name)?), (other, self.take(other)?)],
            ),
        }
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

impl Source for Keywords<'_, '_> {
    type Error = PyErr;

    fn integer(&mut self, key: &'static str, range: RangeInclusive<u64>) -> PyResult<Option<u64>> {
        let value = self.take_key::<Integer>(key)?;
        let value = value.map(|(name, value)| value.within(name, range));
        Ok(value.transpose()?)
    }

    fn number(&mut self, key: &'static str, range: RangeInclusive<f64>) -> PyResult<Option<f64>> {
        let value = self.take::<Real>(key)?;
        Ok(value.map(|value| value.within(key, range)).transpose()?)
    }

    fn flag(&mut self, key: &'static str) -> PyResult<Option<bool>> {
        self.take(key)
    }

    /// A text, or a path.
    fn text(&mut self, key: &'static str) -> PyResult<Option<String>> {
        let path = self.take::<PathBuf>(key)?;
        Ok(path.map(|path| text_of(&path, key)).transpose()?)
    }

    fn choice<T: Clone>(
        &mut self,
        key: &'static str,
        choices: &[(&'static str, T)],
    ) -> PyResult<Option<T>> {
        let Some(name) = self.take::<String>(key)? else {
            return Ok(None);
        };
        let chosen = choices.iter().find(|(known, _)| *known == name);
        let Some((_, chosen)) = chosen else {
            let known: Vec<String> = choices
                .iter()
                .map(|(name, _)| format!("{name:?}"))
                .collect();
            let known = match &known[..] {
                [others @ .., last] => format!("{} or {last}", others.join(", ")),
                [] => String::new(),
            };
            return Err(input(format!("{key} is {name:?}, but must be {known}")).into());
        };
        Ok(Some(chosen.clone()))
    }
}

/// The request that these keywords of `function` make.
///
/// # Errors
/// TypeError for keywords that don't exist or are of the wrong type, InputError for values out
/// of their range.
pub fn request(function: &str, options: Option<&Bound<'_, PyDict>>) -> PyResult<FitRequest> {
    let left = options.map(|options| options.copy()).transpose()?;
    let mut keywords = Keywords { function, left };
    let request = FitRequest::read(&mut keywords)?.read_machine(&mut keywords)?;
    let uncertainty = keywords.take::<Bound<'_, PyDict>>("uncertainty")?;
    let request = FitRequest {
        mask: keywords.take("mask")?,
        uncertainty: match uncertainty {
            Some(uncertainty) => deviations(&uncertainty)?,
            None => Vec::new(),
        },
        pose: keywords.take("pose")?,
        left_out: embedded(keywords.take("leave_out")?.unwrap_or_default())?,
        ..request
    };
    keywords.finish()?;
    Ok(request)
}

/// Names of embedded materials.
fn embedded(names: Vec<String>) -> PyResult<Vec<String>> {
    // `materials()` has them as `Brdf.load` takes them.
    let plain = |name: &String| name.strip_prefix("nbrdf:").unwrap_or(name).to_owned();
    let names: Vec<String> = names.iter().map(plain).collect();
    let unknown = names.iter().find(|name| !NAMES.contains(&name.as_str()));
    match unknown {
        None => Ok(names),
        Some(name) => Err(input(format!(
            "leave_out names {name:?}, but must name bundled materials (materials())"
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
