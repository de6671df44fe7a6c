//! What the template takes.

use minijinja::value::{Serde, Value};
use serde::Serialize;

/// Anything that serde understands, as the template takes it.
pub(super) fn value(of: impl Serialize) -> Value {
    Value::from(Serde(of))
}

/// Each of them by `view`.
pub(super) fn values<T>(all: impl IntoIterator<Item = T>, view: impl Fn(T) -> Value) -> Value {
    all.into_iter().map(view).collect()
}
