//! A fit's scores beside what its dictionary could reach.

use std::sync::Arc;

use crate::brdf::environment::EnvironmentMap;
use crate::brdf::score::{self, BrdfErrors, PerChannel};
use crate::brdf::{Brdf, Dictionary, Mixture};
use crate::inverse::projection::{CellMatrix, EnvironmentMatrix, ProjectionError};
use crate::session::fit_record::{ChannelScore, MetricScores, ScoreSheet};

/// Azimuths φd of the BRDF errors' cells: isotropic materials change little with φd, and
/// all of MERL's 180 would take minutes.
const AZIMUTHS: usize = 9;

/// Scores `estimate` (of `dictionary`, or refined from it) and its single-bounce `start` against
/// `truth`: environment error with spheres of `sphere_px` pixels, BRDF error and its
/// cube-root version, each beside the reference projection and the metric's floor.
pub fn score(
    name: &str,
    truth: &dyn Brdf,
    dictionary: &Arc<Dictionary>,
    estimate: &dyn Brdf,
    start: &Mixture,
    sphere_px: usize,
) -> Result<ScoreSheet, ProjectionError> {
    let cells = CellMatrix::new(dictionary.clone(), AZIMUTHS);
    let reference = cells.reference_projection(truth)?;
    let relative_floor = cells.relative_floor(truth)?;
    let cube_root_floor = cells.cube_root_floor_from(&reference, truth)?;

    let maps = EnvironmentMap::all();
    let spheres = EnvironmentMatrix::new(dictionary.clone(), &maps, sphere_px);
    let spheres = spheres.of(truth);
    let environment = |brdf: &dyn Brdf| {
        // The dictionary's spheres lack atoms of a refined estimate, and what departs.
        channels(&match brdf.as_mixture() {
            Some(mixture) if mixture.dictionary() == dictionary => spheres.error(mixture).mean,
            _ => score::environment_error(brdf, truth, &maps, sphere_px).mean,
        })
    };
    let environment_error = MetricScores {
        estimate: environment(estimate),
        reference_projection: environment(&reference),
        floor: channels(&spheres.floor()?.0.mean),
        single_bounce_start: Some(environment(start)),
    };

    let scored = score::cells(AZIMUTHS);
    let errors = |brdf: &dyn Brdf| score::brdf_errors(brdf, truth, &scored);
    let [estimate, reference, start] = [estimate, &reference, start].map(errors);
    let metric = |of: fn(&BrdfErrors) -> &PerChannel, floor: &Mixture| MetricScores {
        estimate: channels(of(&estimate)),
        reference_projection: channels(of(&reference)),
        floor: channels(of(&errors(floor))),
        single_bounce_start: Some(channels(of(&start))),
    };
    Ok(ScoreSheet {
        truth: name.to_owned(),
        environment_error,
        brdf_error: metric(|e| &e.relative, &relative_floor),
        brdf_cube_root_error: Some(metric(|e| &e.cube_root, &cube_root_floor)),
    })
}

fn channels(score: &PerChannel) -> ChannelScore {
    ChannelScore {
        channels: score.channels,
        overall: score.all,
    }
}
