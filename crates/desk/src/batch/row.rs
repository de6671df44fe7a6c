//! The row of a job in the table: what does not depend on when, where and after what it was
//! done.

use glam::DVec3;

use super::{Job, JobFailure};
use crate::brdf::check::directional_albedo;
use crate::result_table::{Row, Value};
use crate::session::fit_record::FitRecord;

/// Angle of incidence at which the reflectance is stated: that of the instruments which measure
/// it with an integrating sphere (8°:d, CIE 130).
pub const INCIDENCE_DEG: f64 = 8.0;
/// Directions per technique of the integral.
const DIRECTIONS: u32 = 4096;

/// How a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Status {
    Done,
    Failed,
    Open,
}

impl Status {
    pub fn name(self) -> &'static str {
        match self {
            Status::Done => "done",
            Status::Failed => "failed",
            Status::Open => "open",
        }
    }
}

/// Sample and fit of a job, as far as they are known.
#[derive(Default)]
pub(super) struct Found<'a> {
    pub sample: Option<&'a str>,
    pub simulated: Option<bool>,
    pub fit: Option<&'a FitRecord>,
    pub failure: Option<&'a str>,
}

/// The row of a job.
///
/// # Errors
/// The fit states no material.
pub(super) fn row(job: &Job, status: Status, found: &Found<'_>) -> Result<Row, JobFailure> {
    let fit = found.fit;
    let verdict = fit.map(|fit| fit.verdict().name());
    let reflectance = match fit {
        Some(fit) => {
            let (sin, cos) = INCIDENCE_DEG.to_radians().sin_cos();
            let to_light = DVec3::new(sin, 0.0, cos);
            directional_albedo(&*fit.material()?, to_light, DIRECTIONS).map(Some)
        }
        None => [None; 3],
    };
    let error = fit.and_then(|fit| fit.score.as_ref());
    let first_warning = fit.and_then(|fit| fit.warnings.first());
    let mut row = Row::new()
        .with("job", job.number)
        .with("session", job.session_name())
        .with("sample", text(found.sample))
        .with(
            "simulated",
            text(found.simulated.map(|is| if is { "yes" } else { "no" })),
        )
        .with("status", status.name())
        .with("verdict", text(verdict))
        .with(
            "worst_chi_square",
            fit.and_then(FitRecord::worst_reduced_chi_square),
        );
    for (channel, value) in ["r", "g", "b"].iter().zip(reflectance) {
        row = row.with(format!("reflectance_8_{channel}"), value);
    }
    Ok(row
        .with(
            "constrained_share",
            fit.map(|fit| fit.table.constrained_share()),
        )
        .with(
            "discrepancy",
            fit.map(|fit| fit.discrepancy.as_ref().map_or(0.0, |d| d.amplitude)),
        )
        .with(
            "environment_error",
            error.map(|score| score.environment_error.estimate.overall),
        )
        .with("lights", count(fit.map(|fit| fit.reduced_chi_square.len())))
        .with("dictionary", text(fit.map(|fit| fit.dictionary.as_str())))
        .with(
            "paths_per_cell",
            count(fit.map(|fit| fit.settings.samples_per_pixel as usize)),
        )
        .with("options", job.options.as_str())
        .with("warnings", count(fit.map(|fit| fit.warnings.len())))
        .with(
            "reason",
            text(found.failure.or(first_warning.map(|w| w.what.as_str()))),
        ))
}

fn text(text: Option<&str>) -> Value {
    text.map_or(Value::Missing(()), Value::from)
}

fn count(count: Option<usize>) -> Value {
    count.map_or(Value::Missing(()), Value::from)
}
