//! From images to weights: the objective, the simplex, the optimisers and what
//! they can say about their own error.

mod average;
pub mod budget;
pub mod comparison;
pub mod diagnosis;
mod discrepancy_fit;
mod estimate;
pub mod expected_error;
pub mod exponentiated_gradient;
pub mod findings;
pub mod fit;
mod form;
pub mod gauss_newton;
pub mod intervals;
pub mod memory;
mod normal_equations;
pub mod nuisance;
pub mod objective;
pub mod options;
mod posterior;
pub mod ridge;
mod segment;
mod solve;
pub mod sparse;
pub mod trace;
pub mod uncertainty;
mod unexplained;
pub mod variance_shares;

pub use fit::{Fit, fit, fit_with_progress};
pub use intervals::Interval;
pub use nuisance::{RefineOptions, refine_bench};
pub use objective::Channels;
pub use options::{FitError, FitOptions, Optimizer};
