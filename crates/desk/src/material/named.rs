//! A BRDF with its name and, where it is a fit, with its intervals.

use std::path::Path;
use std::sync::Arc;

use super::{MaterialError, load};
use crate::brdf::Brdf;
use crate::session::fit_record::{self, AngleTable};

/// A BRDF as it is compared and drawn.
pub struct Named {
    /// As it was named.
    pub label: String,
    /// Its values.
    pub brdf: Arc<dyn Brdf>,
    /// Of a fit, its 95% intervals and what the images constrain.
    pub table: Option<AngleTable>,
}

impl Named {
    /// The BRDF that `spec` names, as [`load`] takes it.
    ///
    /// # Errors
    /// As [`load`].
    pub fn load(spec: &str) -> Result<Self, MaterialError> {
        let folder = Path::new(spec);
        let label = spec.trim_end_matches('/').to_owned();
        if !folder.is_dir() {
            let brdf = load(spec)?;
            return Ok(Self {
                label,
                brdf,
                table: None,
            });
        }
        let record = fit_record::find(folder)?;
        Ok(Self {
            label,
            brdf: record.material()?,
            table: Some(record.table).filter(|table| !table.cells.is_empty()),
        })
    }

    /// Whether the images constrain it at these angles, degrees; what is no fit always is.
    pub fn is_constrained(&self, theta_h_deg: f64, theta_d_deg: f64) -> bool {
        let table = self.table.as_ref();
        table.is_none_or(|table| table.is_constrained(theta_h_deg, theta_d_deg))
    }
}
