//! `rig_reflectometry._native`: what the library does, for Python. Arguments are parsed into the
//! library's types, arrays cross as NumPy's, and what takes more than a moment runs without the
//! interpreter's lock, can be interrupted and reports how far it is ([`work`]).
//!
//! | file | what it holds |
//! |---|---|
//! | [`arrays`] | NumPy arrays in and out |
//! | [`errors`] | which exception an error becomes |
//! | [`numbers`] | integers and real numbers of any size, and their ranges |
//! | [`records`] | the dataclasses of `rig_reflectometry.records` |
//! | [`work`] | long work: the lock released, Ctrl-C, progress, forked processes |
//! | [`brdf`], [`score`] | BRDFs, and how far one is from another |
//! | [`image`], [`merge`] | radiance images, and brackets merged into one |
//! | [`scene`], [`scene_parts`] | scenes from files and arrays, and renders |
//! | [`fit`], [`fit_options`], [`session`] | fits and captured sessions |

use pyo3::prelude::*;

mod arrays;
mod brdf;
mod errors;
mod fit;
mod fit_options;
mod image;
mod merge;
mod numbers;
mod records;
mod scene;
mod scene_parts;
mod score;
mod session;
mod work;

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::brdf::{Brdf, materials};
    #[pymodule_export]
    use super::fit::{Fit, fit};
    #[pymodule_export]
    use super::image::{read_exr, write_exr};
    #[pymodule_export]
    use super::merge::merge;
    #[pymodule_export]
    use super::scene::Scene;
    #[pymodule_export]
    use super::session::Session;

    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}
