//! From images to weights: the objective, the simplex, the optimisers and what
//! they can say about their own error.

mod average;
pub mod bench;
mod brightest;
pub mod budget;
pub mod cells;
pub mod comparison;
pub mod diagnosis;
mod discrepancy;
mod estimate;
pub mod exponentiated_gradient;
pub mod findings;
pub mod fit;
mod form;
pub mod gauss_newton;
pub mod intervals;
pub mod light_selection;
pub mod memory;
mod normal_equations;
pub mod objective;
pub mod options;
pub mod plausibility;
mod posterior;
pub mod projection;
pub mod ridge;
mod segment;
pub mod simplex;
mod solve;
pub mod sparse;
pub mod trace;
pub mod uncertainty;
pub mod variance_shares;

pub use bench::{BenchPriors, RefineOptions, refine_bench};
pub use cells::{Captured, CellOptions};
pub use fit::{Fit, fit, fit_with_progress};
pub use intervals::Interval;
pub use objective::Channels;
pub use options::{FitError, FitOptions, Optimizer};
