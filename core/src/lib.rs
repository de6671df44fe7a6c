//! The core of `rig`: BRDFs, light transport in concave samples, and the fit of a
//! dictionary's weights to images of them. It needs no hardware and no system package.
//!
//! The modules are floors; a floor imports only from floors below it
//! (`tests/floors.rs` checks that from the source):
//!
//! | floor | modules |
//! |---|---|
//! | 0 | [`units`], [`frames`], [`random`], [`shown`], [`radiance_image`], [`outside_file`], [`outside_text`], [`outside_table`], [`file_system`], [`whole_file`], [`progress`], [`statistics`], [`least_squares`] |
//! | 1 | [`brdf`], [`geometry`] |
//! | 2 | [`transport`] |
//! | 3 | [`inverse`] |
//! | 4 | [`config`] |
//! | 5 | [`example`] |

pub mod file_system;
pub mod frames;
pub mod least_squares;
pub mod outside_file;
pub mod outside_table;
pub mod outside_text;
pub mod progress;
pub mod radiance_image;
pub mod random;
pub mod shown;
pub mod statistics;
pub mod units;
pub mod whole_file;

pub mod brdf;
pub mod geometry;

pub mod transport;

pub mod inverse;

pub mod config;

pub mod example;

pub use brdf::{Brdf, Dictionary, Mixture};
pub use config::scene::SceneFile;
pub use geometry::{Mesh, Shape};
pub use inverse::{Captured, CellOptions, Fit, FitOptions, Interval, fit};
pub use progress::Progress;
pub use radiance_image::RadianceImage;
pub use transport::{Camera, Light, RenderOptions, Scene, Shading, render};
