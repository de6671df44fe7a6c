//! A bench that is not exactly known: directions and intensities of the lights, the
//! sample's pose and stray light are refined together with the weights, within stated
//! priors (docs/adr/0009).
//!
//! | file | what it does |
//! |---|---|
//! | `parameters` | what may differ, how well it is known, the scene with the differences |
//! | `derivatives` | how the images change with each, by tracing shared random numbers again |
//! | `system` | normal equations of weights and bench together, the weights eliminated |
//! | `spectrum` | information of the images in units of the prior; unobservable directions, by name |
//! | `refine` | the rounds, and the fit at the refined bench |

pub mod derivatives;
pub mod parameters;
pub mod refine;
pub mod spectrum;
pub mod system;

#[cfg(test)]
mod tests;

pub use parameters::{Axis, Nuisance, Parameter, with_sample_at};
pub use refine::{BenchEstimate, Estimated, RefineOptions, RefinedBench, refine_bench};
pub use system::{BenchCoupling, BenchLinearisation};
