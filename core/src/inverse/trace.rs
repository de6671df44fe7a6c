//! What an optimiser reports while it works.

use crate::simplex::Quadratic;

/// One evaluated point.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// The optimiser's name.
    pub optimizer: &'static str,
    /// Loss ½ rᵀWr per channel group, with the prior where there is one. Estimated without bias, so
    /// it can be slightly negative.
    pub loss: Vec<f64>,
}

impl Step {
    /// From the local quadratics, whose constants are the loss.
    pub fn of(quadratics: &[Quadratic], optimizer: &'static str) -> Self {
        Self {
            optimizer,
            loss: quadratics.iter().map(|q| q.c).collect(),
        }
    }
}

/// Listens to an optimiser.
pub trait Observer {
    /// A point was evaluated.
    fn step(&mut self, step: &Step);
}

/// Listens to nothing.
impl Observer for () {
    fn step(&mut self, _: &Step) {}
}

/// Why an optimiser stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The loss stopped changing.
    Converged,
    /// The allowed steps were used up.
    StepLimit,
}

impl std::fmt::Display for Termination {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Termination::Converged => "converged",
            Termination::StepLimit => "step limit reached",
        })
    }
}
