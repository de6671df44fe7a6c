//! Scores of estimates next to what their dictionary can reach.

use super::{Lab, Material};
use crate::brdf::score::{brdf_errors, cells};
use crate::brdf::{Brdf, Mixture};
use crate::evaluate::error::EvaluateError;
use crate::result_table::Row;

/// Environment, BRDF and cube-root error of one estimate over all channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// Environment error, mean of the maps.
    pub environment: f64,
    /// Relative BRDF error.
    pub brdf: f64,
    /// Cube-root BRDF error.
    pub cube_root: f64,
}

/// What a dictionary can reach of a material: the reference projection's scores and the
/// environment error's floor.
#[derive(Clone, Debug)]
pub struct Scored {
    /// Scores of the reference projection.
    pub reference: Figures,
    /// The reference projection.
    pub projection: Mixture,
    /// Least environment error of any mixture.
    pub environment_floor: f64,
}

impl Lab {
    /// Scores of an estimate.
    pub fn score(&self, estimate: &dyn Brdf, truth: &dyn Brdf) -> Figures {
        let environment = self.environment().error(estimate, truth).mean.all;
        self.figures(estimate, truth, environment)
    }

    fn figures(&self, estimate: &dyn Brdf, truth: &dyn Brdf, environment: f64) -> Figures {
        let cells = cells(self.settings.azimuths.max(1));
        let errors = brdf_errors(estimate, truth, &cells);
        Figures {
            environment,
            brdf: errors.relative.all,
            cube_root: errors.cube_root.all,
        }
    }

    /// Reference projection and floor of one of the run's materials, computed once.
    pub fn reachable(&self, material: &Material) -> Result<&Scored, EvaluateError> {
        let scored = self.reachable[material.index].get_or_init(|| {
            let compute = || -> Result<Scored, EvaluateError> {
                let truth = &*material.brdf;
                let projection = self.cells().reference_projection(truth)?;
                let spheres = self.environment().of(truth);
                let environment = spheres.error(&projection).mean.all;
                Ok(Scored {
                    reference: self.figures(&projection, truth, environment),
                    environment_floor: spheres.floor()?.0.mean.all,
                    projection,
                })
            };
            compute().map_err(|error| error.to_string())
        });
        scored
            .as_ref()
            .map_err(|fact| EvaluateError::Fact(format!("{}: {fact}", material.name)))
    }

    /// The columns that every table of estimates has: environment error, BRDF errors,
    /// the reference projection's and the floor.
    pub fn score_row(
        &self,
        estimate: &dyn Brdf,
        material: &Material,
    ) -> Result<Row, EvaluateError> {
        let reachable = self.reachable(material)?;
        let figures = self.score(estimate, &*material.brdf);
        Ok(Row::new()
            .with("environment_error", figures.environment)
            .with("reference_projection", reachable.reference.environment)
            .with("floor", reachable.environment_floor)
            .with(
                "ratio_to_reference",
                figures.environment / reachable.reference.environment,
            )
            .with("brdf_error", figures.brdf)
            .with("brdf_error_reference", reachable.reference.brdf)
            .with("cube_root_error", figures.cube_root)
            .with("cube_root_error_reference", reachable.reference.cube_root))
    }
}
