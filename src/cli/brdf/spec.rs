//! How a command line names a BRDF.

use std::sync::Arc;

use crate::brdf::{Brdf, BrdfError, nbrdf};
use crate::cli::CliError;
use crate::material::{self, MaterialError};

/// The BRDF that a text names.
pub fn load(spec: &str) -> Result<Arc<dyn Brdf>, CliError> {
    material::load(spec).map_err(advise)
}

/// An error with what to do about it.
pub fn advise(error: MaterialError) -> CliError {
    match error {
        MaterialError::Fit(error) => error.into(),
        MaterialError::Brdf(error) => match &error {
            BrdfError::UnknownSource { spec, .. } if nbrdf::NAMES.contains(&spec.as_str()) => {
                let hint = format!("the embedded material is nbrdf:{spec}");
                CliError::from(error).hint(hint)
            }
            BrdfError::UnknownSource { .. }
            | BrdfError::Dictionary { .. }
            | BrdfError::Weights { .. } => {
                CliError::from(error).hint("`rig brdf --help` lists what names a BRDF")
            }
            _ => error.into(),
        },
        MaterialError::UnknownMaterial { .. } => {
            CliError::from(error).hint(format!("known are {}", nbrdf::NAMES.join(", ")))
        }
        MaterialError::Angles { .. } => {
            CliError::from(error).hint("the columns are theta_i_deg,theta_o_deg,phi_deg")
        }
        MaterialError::Projection(error) => error.into(),
        MaterialError::File { .. } => error.into(),
    }
}
