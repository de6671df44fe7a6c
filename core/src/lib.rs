//! The core of `rig`: BRDFs, light transport in concave samples, and the fit of a BRDF to images
//! of such a sample. It needs no hardware and no system package.
//!
//! # The problem
//!
//! A camera sees a concave sample, a bowl say, under one known light. Its shape is known, its
//! material is not. What a pixel sees is light that was reflected once, at directions that the
//! geometry fixes, and light that was reflected twice and more, between the walls of the bowl.
//! Each reflection multiplies by the BRDF f at other directions, so that one image depends on f
//! nearly everywhere: from the image, f can be found. The method is that of "Towards
//! Reflectometry from Interreflections" (Shem-Tov, Bangaru, Levin, Gkioulekas).
//!
//! # How it is solved
//!
//! f is taken as a mixture of known BRDFs, the atoms fₖ of a [`Dictionary`]:
//!
//! f(ωi, ωo) = Σₖ wₖ fₖ(ωi, ωo), with wₖ ≥ 0 and Σₖ wₖ = 1.
//!
//! Light paths from the camera are traced once, in directions that do not depend on w, and kept
//! ([`transport::Cache`]). Image and derivatives for any w are then sums over the kept paths, a
//! polynomial in w, and [`fit()`] minimises the squared difference to the captured images over the
//! simplex. Two independent halves of the paths make the loss unbiased. What the images leave
//! open is sampled from the posterior of w, from which [`Fit::interval`] gives an interval for f
//! at any angles.
//!
//! # Where to begin
//!
//! | to | see |
//! |---|---|
//! | load, evaluate, compare BRDFs | [`brdf`], [`brdf::load`], [`brdf::score`] |
//! | turn one into a material of OpenPBR, Blender or glTF | [`parametric`] |
//! | make or read a sample's shape | [`Shape`], [`Mesh`] |
//! | describe camera and lights | [`SceneFile`], [`Scene`], [`Camera`], [`Light`] |
//! | render | [`render()`], [`RenderOptions`] |
//! | fit | [`Captured`], [`fit()`], [`FitOptions`], [`Fit`] |
//! | show how far long work is | [`Progress`], [`transport::render_with_progress`], [`inverse::fit_with_progress`] |
//! | try something | [`example`] |
//!
//! ```
//! use rig_core::{Dictionary, FitOptions, example, fit};
//!
//! let (scene, captured) = example::captured_bowl();
//! let dictionary = Dictionary::load("paper42")?;
//! let found = fit(&scene, &captured, &dictionary, &FitOptions::default())?;
//! let f = found.interval(15.0, 10.0); // half and difference angle, degrees
//! println!("{:.3} 1/sr, between {:.3} and {:.3}", f.value[0], f.lower[0], f.upper[0]);
//! # Ok::<_, Box<dyn std::error::Error>>(())
//! ```
//!
//! `examples/paper.rs` has the paper's algorithm on one page, to be read next to the paper.
//!
//! # Conventions
//!
//! Lengths are millimetres, angles radians (degrees at the surface, and named so), f is in 1/sr
//! without the cosine, images are radiance in R, G, B with a variance. Transforms name both ends
//! (`sample_from_camera`, [`frames`]). Random numbers are keyed by what they are for
//! ([`random::stream`]): results are the same bits on any number of threads.
//!
//! # Floors
//!
//! The modules are floors; a floor imports only from floors below it, and no modules import each
//! other in a circle (`tests/source/floors.rs` checks that from the source):
//!
//! | floor | modules |
//! |---|---|
//! | 0 | [`units`], [`frames`], [`random`], [`shown`], [`radiance_image`], [`outside_file`], [`outside_text`], [`outside_table`], [`file_system`], [`whole_file`], [`progress`], [`statistics`], [`least_squares`], [`simplex`], [`bench_priors`] |
//! | 1 | [`brdf`], [`geometry`] |
//! | 2 | [`parametric`], [`transport`] |
//! | 3 | [`cells`], [`plausibility`] |
//! | 4 | [`inverse`] |
//! | 5 | [`config`], [`scores`] |
//! | 6 | [`example`] |

pub mod bench_priors;
pub mod file_system;
pub mod frames;
pub mod least_squares;
mod outer_products;
pub mod outside_file;
pub mod outside_table;
pub mod outside_text;
pub mod progress;
pub mod radiance_image;
pub mod random;
pub mod shown;
pub mod simplex;
pub mod statistics;
pub mod units;
pub mod whole_file;
mod widened;

pub mod brdf;
pub mod geometry;

pub mod parametric;
pub mod transport;

pub mod cells;
pub mod plausibility;

pub mod inverse;

pub mod config;
pub mod scores;

pub mod example;

pub use bench_priors::BenchPriors;
pub use brdf::{Brdf, Dictionary, Mixture};
pub use cells::{Captured, CellOptions};
pub use config::scene::SceneFile;
pub use geometry::{Mesh, Shape};
pub use inverse::{Fit, FitOptions, Interval, fit};
pub use progress::Progress;
pub use radiance_image::RadianceImage;
pub use transport::{Camera, Light, RenderOptions, Scene, Shading, render};
