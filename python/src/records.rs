//! The dataclasses of `rig_reflectometry.records`, made from here.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Serialize;

/// A record with these fields.
pub fn new<'py>(py: Python<'py>, name: &str, fields: &Bound<'py, PyDict>) -> PyResult<Py<PyAny>> {
    let class = py.import("rig_reflectometry.records")?.getattr(name)?;
    Ok(class.call((), Some(fields))?.unbind())
}

/// `record!(py, "Name", field = value, …)`.
macro_rules! record {
    ($py:expr, $name:literal, $($field:ident = $value:expr),* $(,)?) => {{
        let fields = pyo3::types::PyDict::new($py);
        $(fields.set_item(stringify!($field), $value)?;)*
        $crate::records::new($py, $name, &fields)
    }};
}
pub(crate) use record;

/// Plain data as Python's dictionaries, lists, strings and numbers.
pub fn plain<'py>(py: Python<'py>, data: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(data)
        .map_err(|error| pyo3::exceptions::PyValueError::new_err(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}
