//! From images to weights: the objective, the simplex, the optimisers and what
//! they can say about their own error.

pub mod projection;
pub mod simplex;
