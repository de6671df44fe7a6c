//! How far an estimate is from a known truth, next to what its dictionary could reach:
//! environment error, BRDF error and cube-root BRDF error; and as albedo and height of the peak.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::brdf::environment::EnvironmentMap;
use crate::brdf::plain_error::{PlainErrors, plain_errors};
use crate::brdf::projection::{CellMatrix, EnvironmentMatrix, ProjectionError};
use crate::brdf::score::{self, BrdfErrors, PerChannel};
use crate::brdf::sphere::SphereImage;
use crate::brdf::{Brdf, Dictionary, Mixture};

/// One error, by channel and over all three.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelScore {
    /// R, G, B; relative, dimensionless.
    pub channels: [f64; 3],
    /// Over all channels together.
    pub overall: f64,
}

/// One metric of the estimate, and of what it is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetricScores {
    /// The fit.
    pub estimate: ChannelScore,
    /// The simplex weights that minimise the squared cube-root error to the truth.
    pub reference_projection: ChannelScore,
    /// The least value of this metric that any weights on the simplex reach.
    pub floor: ChannelScore,
    /// The single-bounce least-squares start of the fit (Eq. 13 of the paper).
    pub single_bounce_start: Option<ChannelScore>,
}

/// All scores of a fit whose true material is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoreSheet {
    /// Name of the true material.
    pub truth: String,
    /// Sphere under environment maps: mean over the maps of ‖a − b‖₂ / ‖b‖₂.
    pub environment_error: MetricScores,
    /// ‖cos θi (f − f̂)‖ / ‖cos θi f‖ over the table's cells.
    pub brdf_error: MetricScores,
    /// The same cells, mean |∛a − ∛b| over mean ∛b with a = cos θi f.
    pub brdf_cube_root_error: Option<MetricScores>,
    /// The fit's errors as albedo and as height of the peak.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plain: Option<PlainErrors>,
}

/// Azimuths φd of the BRDF errors' cells: isotropic materials change little with φd, and
/// all of MERL's 180 would take minutes.
const AZIMUTHS: usize = 9;

/// Scores `estimate` (of `dictionary`, or refined from it) and its single-bounce `start`
/// (of `dictionary`) against `truth`, called `name`: environment error with spheres of
/// `sphere_px` pixels, BRDF error and its cube-root version, each next to the scores of the
/// reference projection and the metric's floor.
///
/// # Errors
/// The truth could not be projected onto the dictionary.
pub fn score(
    name: &str,
    truth: &dyn Brdf,
    dictionary: &Arc<Dictionary>,
    estimate: &dyn Brdf,
    start: &Mixture,
    sphere_px: usize,
) -> Result<ScoreSheet, ProjectionError> {
    // The truth's projection and the floors of both BRDF errors.
    let cells = CellMatrix::new(dictionary.clone(), AZIMUTHS);
    let reference = cells.reference_projection(truth)?;
    let relative_floor = cells.relative_floor(truth)?;
    let cube_root_floor = cells.cube_root_floor_from(&reference, truth)?;

    // Environment errors, all in one pass over the spheres. An estimate with other atoms
    // than the dictionary's, or with a model discrepancy, is rendered like the truth.
    let maps = EnvironmentMap::all();
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

    // BRDF errors.
    let scored = score::cells(AZIMUTHS);
    let errors = |brdf: &dyn Brdf| score::brdf_errors(brdf, truth, &scored);
    let plain = plain_errors(estimate, truth);
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
        plain: Some(plain),
    })
}

fn channels(score: &PerChannel) -> ChannelScore {
    ChannelScore {
        channels: score.channels,
        overall: score.all,
    }
}
