//! A fit's scores beside what its dictionary could reach.

use std::sync::Arc;

use crate::brdf::environment::EnvironmentMap;
use crate::brdf::score::{self, BrdfErrors, PerChannel};
use crate::brdf::sphere::SphereImage;
use crate::brdf::{Brdf, Dictionary, Mixture};
use crate::inverse::projection::{CellMatrix, EnvironmentMatrix, ProjectionError};
use crate::session::fit_record::{ChannelScore, MetricScores, ScoreSheet};

/// Azimuths φd of the BRDF errors' cells: isotropic materials change little with φd, and
/// all of MERL's 180 would take minutes.
const AZIMUTHS: usize = 9;

/// Scores `estimate` (of `dictionary`, or refined from it) and its single-bounce `start` (of it) against
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
    // All in one pass over the spheres. The dictionary's lack atoms of a refined estimate,
    // and its discrepancy from every mixture: such an estimate is rendered like the truth.
    let mixture = estimate.as_mixture();
    let mixture = mixture.filter(|mixture| mixture.dictionary() == dictionary);
    let rendered: &[&dyn Brdf] = match mixture {
        Some(_) => &[truth],
        None => &[truth, estimate],
    };
    let (matrix, images) =
        EnvironmentMatrix::with_images(dictionary.clone(), &maps, sphere_px, rendered);
    let spheres = matrix.of_images(images.iter().map(|under| &under[0]));
    let of_mixture = |mixture: &Mixture| channels(&spheres.error(mixture).mean);
    let environment_error = MetricScores {
        estimate: match mixture {
            Some(mixture) => of_mixture(mixture),
            None => {
                let error = |under: &Vec<SphereImage>| score::image_error(&under[1], &under[0]);
                let errors: Vec<PerChannel> = images.iter().map(error).collect();
                channels(&score::summarise(&maps, &errors).mean)
            }
        },
        reference_projection: of_mixture(&reference),
        floor: channels(&spheres.floor()?.0.mean),
        single_bounce_start: Some(of_mixture(start)),
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
