//! Errors between BRDFs, as Python's Errors.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rig_core::brdf::score::PerChannel;
use rig_desk::material::Errors;

use crate::errors::Fault;
use crate::numbers::Integer;
use crate::records::record;

/// Pixels a side of a sphere, checked.
pub fn sphere_size(size: Integer) -> Result<usize, Fault> {
    Ok(size.within("size", 8..=512u32)? as usize)
}

/// Python's Errors.
pub fn errors_record(py: Python<'_>, errors: &Errors) -> PyResult<Py<PyAny>> {
    let maps = PyDict::new(py);
    for (map, error) in &errors.environment.maps {
        maps.set_item(map, error)?;
    }
    record!(
        py,
        "Errors",
        environment = per_channel(py, &errors.environment.mean)?,
        maps = maps,
        brdf = per_channel(py, &errors.brdf.relative)?,
        cube_root = per_channel(py, &errors.brdf.cube_root)?,
    )
}

fn per_channel(py: Python<'_>, error: &PerChannel) -> PyResult<Py<PyAny>> {
    let [red, green, blue] = error.channels;
    record!(
        py,
        "PerChannel",
        all = error.all,
        red = red,
        green = green,
        blue = blue,
    )
}
