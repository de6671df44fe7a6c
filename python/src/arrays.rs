//! NumPy arrays in and out.
//!
//! What goes in is copied once, into the library's own layout: the interpreter's lock is released
//! while it is used, and meanwhile Python may write to the array. What comes out is handed over,
//! not copied.

use std::ops::RangeInclusive;

use glam::Vec3;
use numpy::{Element, IntoPyArray, PyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;

use crate::errors::{Fault, check_room, input};

/// Two directions and a value.
const BYTES_PER_PAIR: usize = 3 * size_of::<Vec3>();
/// Largest difference of a direction's length from one.
const UNIT_TOLERANCE: f64 = 1e-3;

/// Real numbers of any type as f64; anything else is refused, and so are masked values.
pub fn numbers<'py>(
    value: &Bound<'py, PyAny>,
    name: &str,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    if masked(value)?.is_some() {
        return Err(input(format!(
            "{name} has masked values, which have no meaning here"
        ))
        .into());
    }
    converted(value, name, "float64")
}

/// Where a masked array is masked, as an array of its shape; `None` where nothing is.
pub fn masked<'py>(value: &Bound<'py, PyAny>) -> PyResult<Option<Bound<'py, PyArrayDyn<bool>>>> {
    let ma = value.py().import("numpy.ma")?;
    if !value.is_instance(&ma.getattr("MaskedArray")?)? {
        return Ok(None);
    }
    let mask = ma.call_method1("getmaskarray", (value,))?;
    let mask = mask.cast_into::<PyArrayDyn<bool>>();
    let mask = mask.map_err(|_| input("a structured mask has no meaning here"))?;
    let is_masked = readable(&mask, "mask")?
        .as_array()
        .iter()
        .any(|&masked| masked);
    Ok(is_masked.then_some(mask))
}

/// Real numbers as f32, masked or not; those that f32 cannot hold become infinite.
pub fn singles<'py>(
    value: &Bound<'py, PyAny>,
    name: &str,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    converted(value, name, "float32")
}

fn converted<'py, T: Element>(
    value: &Bound<'py, PyAny>,
    name: &str,
    dtype: &str,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let numpy = value.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (value,)).map_err(|error| {
        match error.is_instance_of::<PyMemoryError>(value.py()) {
            true => error,
            false => input(format!("{name} is no array: {error}")).into(),
        }
    })?;
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        let found = array.getattr("dtype")?;
        return Err(input(format!(
            "{name} is of type {found}; real numbers are needed"
        ))
        .into());
    }
    let options = pyo3::types::PyDict::new(value.py());
    options.set_item("copy", false)?;
    let array = array.call_method("astype", (dtype,), Some(&options))?;
    Ok(array.cast_into::<PyArrayDyn<T>>()?)
}

/// The array, to be read; refused where other Rust code is writing to it.
pub fn readable<'py, T: Element>(
    array: &Bound<'py, PyArrayDyn<T>>,
    name: &str,
) -> Result<PyReadonlyArrayDyn<'py, T>, Fault> {
    array
        .try_readonly()
        .map_err(|_| input(format!("{name} is being written to")))
}

/// Two arrays of unit vectors, (…, 3), broadcast against each other.
pub struct Pairs {
    pub to_light: Vec<Vec3>,
    pub to_viewer: Vec<Vec3>,
    /// Of the result: (…, 3).
    pub shape: Vec<usize>,
}

impl Pairs {
    /// # Errors
    /// Shapes that don't broadcast or don't end in 3; vectors that are not of length one.
    pub fn of(to_light: &Bound<'_, PyAny>, to_viewer: &Bound<'_, PyAny>) -> PyResult<Self> {
        let arrays = [numbers(to_light, "wi")?, numbers(to_viewer, "wo")?];
        for (array, name) in arrays.iter().zip(["wi", "wo"]) {
            let shape = readable(array, name)?.as_array().shape().to_vec();
            if shape.last() != Some(&3) {
                let message = format!("{name} has shape {}, but must be (…, 3)", shown(&shape));
                return Err(input(message).into());
            }
        }
        let [to_light, to_viewer] = broadcast(&arrays, ["wi", "wo"])?;
        let shape = readable(&to_light, "wi")?.as_array().shape().to_vec();
        check_room(product(&shape[..shape.len() - 1]), BYTES_PER_PAIR)?;
        Ok(Self {
            to_light: unit_vectors(&to_light, "wi")?,
            to_viewer: unit_vectors(&to_viewer, "wo")?,
            shape,
        })
    }
}

/// Views of these arrays with one shape.
pub fn broadcast<'py, const N: usize>(
    arrays: &[Bound<'py, PyArrayDyn<f64>>; N],
    names: [&str; N],
) -> PyResult<[Bound<'py, PyArrayDyn<f64>>; N]> {
    let py = arrays[0].py();
    let numpy = py.import("numpy")?;
    let views = pyo3::types::PyTuple::new(py, arrays)?;
    let views = numpy.call_method1("broadcast_arrays", views).map_err(|_| {
        let shapes = arrays.iter().zip(names).map(|(array, name)| {
            let shape = array.getattr("shape").map(|shape| shape.to_string());
            format!("{name} {}", shape.unwrap_or_default())
        });
        let shapes = shapes.collect::<Vec<_>>().join(", ");
        input(format!("shapes that don't broadcast together: {shapes}"))
    })?;
    let views: Vec<Bound<'py, PyArrayDyn<f64>>> = views
        .try_iter()?
        .map(|view| Ok(view?.cast_into()?))
        .collect::<PyResult<_>>()?;
    views
        .try_into()
        .map_err(|_| input("numpy.broadcast_arrays gave another number of arrays").into())
}

/// Numbers of N arrays that are broadcast against each other.
pub struct Columns<const N: usize> {
    pub columns: [Vec<f64>; N],
    /// Of the result.
    pub shape: Vec<usize>,
}

impl<const N: usize> Columns<N> {
    /// # Errors
    /// Shapes that don't broadcast, numbers out of their range, and a result of so many bytes each
    /// for which there is no room.
    pub fn of(
        arrays: &[Bound<'_, PyArrayDyn<f64>>; N],
        names: [&str; N],
        ranges: [RangeInclusive<f64>; N],
        bytes_each: usize,
    ) -> PyResult<Self> {
        let views = broadcast(arrays, names)?;
        let mut shape = Vec::new();
        let mut columns = [(); N].map(|()| Vec::new());
        for (index, (view, column)) in views.iter().zip(&mut columns).enumerate() {
            let (name, range) = (names[index], &ranges[index]);
            let array = readable(view, name)?;
            let array = array.as_array();
            shape = array.shape().to_vec();
            check_room(product(&shape), bytes_each)?;
            column.extend(array.iter().copied());
            check_within(column, name, range)?;
        }
        Ok(Self { columns, shape })
    }
}

fn check_within(values: &[f64], name: &str, range: &RangeInclusive<f64>) -> Result<(), Fault> {
    match values.iter().find(|value| !range.contains(value)) {
        None => Ok(()),
        Some(bad) => {
            let (low, high) = (range.start(), range.end());
            let message = format!("{name} has {bad}, but must be within {low} and {high}");
            Err(input(message))
        }
    }
}

fn unit_vectors(array: &Bound<'_, PyArrayDyn<f64>>, name: &str) -> Result<Vec<Vec3>, Fault> {
    let array = readable(array, name)?;
    let array = array.as_array();
    let mut vectors = Vec::with_capacity(array.len() / 3);
    for row in array.rows() {
        let vector = glam::DVec3::new(row[0], row[1], row[2]);
        let deviation = (vector.length() - 1.0).abs();
        if deviation.is_nan() || deviation > UNIT_TOLERANCE {
            let index = vectors.len();
            return Err(input(format!(
                "vector {index} of {name} is ({}, {}, {}), of length {}; unit vectors are needed",
                row[0],
                row[1],
                row[2],
                vector.length()
            )));
        }
        vectors.push(vector.as_vec3());
    }
    Ok(vectors)
}

/// Numbers of a one-dimensional array, each within `range`.
pub fn list_within(
    value: &Bound<'_, PyAny>,
    name: &str,
    range: RangeInclusive<f64>,
) -> PyResult<Vec<f64>> {
    let array = numbers(value, name)?;
    let array = readable(&array, name)?;
    let array = array.as_array();
    check_room(Some(array.len()), size_of::<f64>())?;
    if array.ndim() > 1 {
        let shape = shown(array.shape());
        return Err(input(format!("{name} has shape {shape}, but must be a list")).into());
    }
    let values: Vec<f64> = array.iter().copied().collect();
    check_within(&values, name, &range)?;
    Ok(values)
}

/// Rows of three numbers, the shape (N, 3).
pub fn rows_of_three(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f64; 3]>> {
    let array = numbers(value, name)?;
    let array = readable(&array, name)?;
    let array = array.as_array();
    let [rows, 3] = *array.shape() else {
        let shape = shown(array.shape());
        return Err(input(format!("{name} has shape {shape}, but must be (N, 3)")).into());
    };
    check_room(Some(rows), 2 * size_of::<[f64; 3]>())?;
    let rows = array.rows().into_iter();
    Ok(rows.map(|row| [row[0], row[1], row[2]]).collect())
}

/// Elements of an array of this shape; `None` beyond what can be counted.
pub fn product(shape: &[usize]) -> Option<usize> {
    shape
        .iter()
        .try_fold(1usize, |product, side| product.checked_mul(*side))
}

/// A shape as Python shows it.
pub fn shown(shape: &[usize]) -> String {
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    match sizes.as_slice() {
        [one] => format!("({one},)"),
        sizes => format!("({})", sizes.join(", ")),
    }
}

/// Values as an array of this shape, which takes them over.
pub fn array<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    values.into_pyarray(py).reshape(shape)
}

/// Triples as an array of shape (…, 3), which takes them over.
pub fn triples<'py, T: Element>(
    py: Python<'py>,
    values: Vec<[T; 3]>,
    leading: &[usize],
) -> PyResult<Bound<'py, PyArray<T, numpy::IxDyn>>> {
    let shape = [leading, &[3]].concat();
    array(py, values.into_flattened(), &shape)
}
