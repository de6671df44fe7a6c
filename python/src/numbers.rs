//! Numbers of any size as Python has them, until they are compared with their range.

use std::fmt::Display;
use std::ops::RangeInclusive;

use pyo3::exceptions::{PyOverflowError, PyTypeError};
use pyo3::prelude::*;

use crate::errors::{Fault, input};

/// An integer. One that no 128 bits hold is the largest or least of these.
#[derive(Clone, Copy, Debug)]
pub struct Integer(i128);

impl From<u64> for Integer {
    fn from(value: u64) -> Self {
        Self(value.into())
    }
}

impl<'py> FromPyObject<'_, 'py> for Integer {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        match value.extract::<i128>() {
            Err(error) if error.is_instance_of::<PyOverflowError>(value.py()) => {
                Ok(Self(if value.lt(0)? { i128::MIN } else { i128::MAX }))
            }
            found => found.map(Self),
        }
    }
}

impl Integer {
    /// The value, if it is in its range.
    pub fn within<T>(self, name: &str, range: RangeInclusive<T>) -> Result<T, Fault>
    where
        T: Copy + Display + TryFrom<i128>,
        i128: TryFrom<T>,
    {
        let [low, high] = [*range.start(), *range.end()];
        let end = |end: T| i128::try_from(end).unwrap_or_default();
        match (end(low)..=end(high)).contains(&self.0) {
            true => T::try_from(self.0).map_err(|_| self.outside(name, low, high)),
            false => Err(self.outside(name, low, high)),
        }
    }

    fn outside(self, name: &str, low: impl Display, high: impl Display) -> Fault {
        let found = match self.0 {
            i128::MIN => "less than any range has".to_owned(),
            i128::MAX => "more than any range has".to_owned(),
            value => value.to_string(),
        };
        input(format!(
            "{name} is {found}, but must be from {low} to {high}"
        ))
    }
}

/// What is given by the name of the command line's option or by that of earlier versions, with the
/// name.
///
/// # Errors
/// TypeError where both are given.
pub fn either<T>(
    function: &str,
    [first, second]: [(&'static str, Option<T>); 2],
) -> PyResult<Option<(&'static str, T)>> {
    Ok(match (first, second) {
        ((name, Some(value)), (_, None)) | ((_, None), (name, Some(value))) => Some((name, value)),
        ((_, None), (_, None)) => None,
        ((name, Some(_)), (other, Some(_))) => {
            return Err(PyTypeError::new_err(format!(
                "{function}() got both '{name}' and '{other}', which are two names of one keyword"
            )));
        }
    })
}

/// A real number. One that no float64 holds is infinite.
#[derive(Clone, Copy, Debug)]
pub struct Real(pub f64);

impl<'py> FromPyObject<'_, 'py> for Real {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        match value.extract::<f64>() {
            Err(error) if error.is_instance_of::<PyOverflowError>(value.py()) => {
                let sign = if value.lt(0)? { -1.0 } else { 1.0 };
                Ok(Self(sign * f64::INFINITY))
            }
            found => found.map(Self),
        }
    }
}

impl Real {
    /// The value, if it is in its range.
    pub fn within(self, name: &str, range: RangeInclusive<f64>) -> Result<f64, Fault> {
        match range.contains(&self.0) {
            true => Ok(self.0),
            false => Err(input(format!(
                "{name} is {}, but must be from {} to {}",
                self.0,
                range.start(),
                range.end()
            ))),
        }
    }
}
