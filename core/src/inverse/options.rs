//! What a fit can be asked for, and why it may fail.

use super::exponentiated_gradient::ExponentiatedGradient;
use super::gauss_newton::GaussNewton;
use super::objective::Channels;
use crate::brdf::Dictionary;
use crate::brdf::projection::ProjectionError;
use crate::cells::AverageError;
use crate::geometry::FormError;
use crate::shown::nth;
use crate::simplex::SimplexError;
use crate::transport::cache::CacheError;
use crate::transport::{CacheOptions, Kernel};

/// Which optimiser.
#[derive(Clone, Debug, PartialEq)]
pub enum Optimizer {
    /// Gauss–Newton on the simplex.
    GaussNewton(GaussNewton),
    /// The paper's exponentiated gradient with Adam steps.
    ExponentiatedGradient(ExponentiatedGradient),
    /// The convex baseline of Eq. 13: the least squares that takes all light as reflected
    /// once.
    SingleBounce,
}

impl Optimizer {
    /// Name as on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Optimizer::GaussNewton(_) => "gauss-newton",
            Optimizer::ExponentiatedGradient(_) => "exponentiated-gradient",
            Optimizer::SingleBounce => "single-bounce",
        }
    }
}

/// All options of a fit.
#[derive(Clone, Debug)]
pub struct FitOptions {
    /// Paths: samples per cell, longest path, seed, memory.
    pub cache: CacheOptions,
    /// Direct reflection: square root of the samples per cell, 1..=64.
    pub direct_strata: u32,
    /// How the weights are found.
    pub optimizer: Optimizer,
    /// Weights of their own per channel, or shared.
    pub channels: Channels,
    /// Relative error of the model that the weighting allows for, 0..=1.
    pub model_error: f64,
    /// Rounds of residual weights, 1..=10.
    pub rounds: usize,
    /// Samples of the posterior, 0..=10 000.
    pub posterior_samples: usize,
    /// Trace again with directions proposed by a first solution from a quarter of the paths:
    /// less noise where the material is glossy.
    pub adapt_paths: bool,
    /// Deviation of the as-made sample from the scene's mesh; `None`: not at all.
    pub form_error: Option<FormError>,
    /// Embedded measured materials that the prior of the model discrepancy is not learned from,
    /// with their near duplicates: in an experiment, its truth. Other names leave nothing out.
    pub left_out: Vec<String>,
    /// Instructions to use.
    pub kernel: Kernel,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            cache: CacheOptions::default(),
            direct_strata: 10,
            optimizer: Optimizer::GaussNewton(GaussNewton::default()),
            channels: Channels::Separate,
            model_error: 0.02,
            rounds: 3,
            posterior_samples: 200,
            adapt_paths: true,
            form_error: None,
            left_out: Vec::new(),
            kernel: Kernel::detect(),
        }
    }
}

impl FitOptions {
    /// The first part of the dictionary, where the material is estimated by it as well and both
    /// estimates are averaged.
    pub fn second_estimate(&self, dictionary: &Dictionary) -> Option<Dictionary> {
        let averages =
            self.posterior_samples > 0 && matches!(self.optimizer, Optimizer::GaussNewton(_));
        dictionary.first_part().filter(|_| averages)
    }
}

/// Why a fit failed.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// Images of another number or size, or with nothing to compare.
    #[error(transparent)]
    Average(#[from] AverageError),
    /// Nothing to compare.
    #[error("no cell of {image} lies away from the edges of its light's shadow", image = nth("image", *image))]
    NothingToCompare {
        /// Index of the image.
        image: usize,
    },
    /// The paths.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// The quadratic programme.
    #[error(transparent)]
    Simplex(#[from] SimplexError),
    /// The weights of the mixture closest to the material.
    #[error(transparent)]
    Projection(#[from] ProjectionError),
}
