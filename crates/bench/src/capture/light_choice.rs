//! Light directions chosen by how much they tell: before anything is known of the material,
//! or after a fit.

use nalgebra::DVector;

use super::CaptureError;
use super::directions::{Aim, plan_order};
use super::findings::{Notice, PrepareError};
use super::reach::StageReach;
use crate::brdf::Dictionary;
use crate::config::RigConfig;
use crate::inverse::light_selection::{
    Choice, PRIOR_MATERIALS, Prospects, SelectionOptions, prior_materials,
};
use crate::session::{Session, fit_record};
use crate::transport::Scene;
use crate::units::StageAngles;

/// Directions that are compared: the first of the evenly spread ones.
pub const CANDIDATES: usize = 60;
/// Pixels along the longer side of the images that are compared.
const RESOLUTION_PX: usize = 24;
/// Cosine of the angle within which a direction counts as taken already, 1°.
const NEAR_COSINE: f64 = 0.999_848;

/// A direction and what it is expected to add.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Ranked {
    /// The direction.
    #[serde(flatten)]
    pub light: StageAngles,
    /// Part of the BRDF's variance without images that is left after it and all before it,
    /// 0 to 1.
    #[serde(rename = "expected_variance_left")]
    pub remaining: f64,
}

/// The best of some directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// Directions that were compared.
    pub compared: usize,
    /// Best first.
    pub best: Vec<Ranked>,
}

/// What more lights are expected to add to a fitted session.
#[derive(Clone, Debug, PartialEq)]
pub struct NextLights {
    /// The fit that says what the material is.
    pub fit: u32,
    /// Lights that the session holds.
    pub taken: usize,
    /// Part of the BRDF's variance without images that these leave, 0 to 1.
    pub remaining: f64,
    /// Directions to add, best first.
    pub next: Vec<Ranked>,
}

/// The best `count` directions within reach for a material of which nothing is known,
/// best first.
///
/// # Errors
/// More lights than candidates; a dictionary or scene that cannot be used.
pub fn best(
    config: &RigConfig,
    reach: &StageReach,
    count: usize,
    notice: &mut dyn FnMut(Notice<'_>),
) -> Result<Ranking, PrepareError> {
    let candidates = plan_order(reach, Aim::of(&config.geometry), CANDIDATES, 0.0);
    if candidates.len() < count {
        return Err(CaptureError::TooManyLights {
            wanted: count,
            reachable: candidates.len(),
            blocked: reach.blocked().len(),
        }
        .into());
    }
    let dictionary = Dictionary::load(config.fit.dictionary())?;
    let options = options(config);
    let materials = prior_materials(&dictionary, PRIOR_MATERIALS, options.seed);
    notice(Notice::Comparing {
        directions: candidates.len(),
    });
    let scene = coarse(config.geometry.scene(&candidates)?);
    let prospects = Prospects::new(scene, &dictionary, &materials, &options)
        .map_err(PrepareError::LightSelection)?;
    Ok(Ranking {
        compared: candidates.len(),
        best: ranked(&prospects.best(count), &candidates),
    })
}

/// The `count` directions that would add most to a fitted session, best first.
///
/// # Errors
/// [`PrepareError::NoFit`], or files of the session that cannot be used.
pub fn next(
    session: &Session,
    count: usize,
    notice: &mut dyn FnMut(Notice<'_>),
) -> Result<NextLights, PrepareError> {
    // The material as fitted.
    let record = session.record();
    let number = fit_record::numbers_in(session).pop().ok_or_else(|| {
        let session = session.root().to_owned();
        PrepareError::NoFit { session }
    })?;
    let mixture = fit_record::read_in(session, number)?.mixture()?;
    let config = session.rig()?;

    // The lights taken come first among the candidates.
    let planned = record.plan.lights.iter().enumerate();
    let mut candidates: Vec<StageAngles> = planned
        .filter(|(index, _)| session.light_is_finished(*index as u32))
        .map(|(_, &angles)| angles)
        .collect();
    let taken: Vec<usize> = (0..candidates.len()).collect();
    let reach = StageReach::of_rig(&config)?;
    let spread = plan_order(&reach, Aim::of(&config.geometry), CANDIDATES, 0.0);
    candidates.extend(spread.into_iter().filter(|angles| {
        let near = |other: &StageAngles| other.to_light().dot(angles.to_light()) > NEAR_COSINE;
        !record.plan.lights.iter().any(near)
    }));

    notice(Notice::Comparing {
        directions: candidates.len(),
    });
    let materials: Vec<DVector<f64>> = mixture
        .weights()
        .iter()
        .map(|weights| DVector::from_column_slice(weights))
        .collect();
    let scene = coarse(config.geometry.scene(&candidates)?);
    let prospects = Prospects::new(scene, mixture.dictionary(), &materials, &options(&config))
        .map_err(PrepareError::LightSelection)?;
    Ok(NextLights {
        fit: number,
        taken: taken.len(),
        remaining: prospects.remaining(&taken),
        next: ranked(&prospects.greedy(&taken, count), &candidates),
    })
}

fn ranked(choices: &[Choice], candidates: &[StageAngles]) -> Vec<Ranked> {
    let of = |choice: &Choice| Ranked {
        light: candidates[choice.candidate],
        remaining: choice.remaining,
    };
    choices.iter().map(of).collect()
}

fn options(config: &RigConfig) -> SelectionOptions {
    SelectionOptions {
        seed: config.fit.seed(),
        ..SelectionOptions::default()
    }
}

/// The same view in fewer pixels.
fn coarse(mut scene: Scene) -> Scene {
    let longer = scene.camera.resolution_px.into_iter().max().unwrap_or(1);
    let scale = (RESOLUTION_PX as f64 / longer as f64).min(1.0);
    scene.camera.point_spread_px *= scale;
    scene.camera.resolution_px = scene
        .camera
        .resolution_px
        .map(|pixels| ((pixels as f64 * scale).round() as usize).max(1));
    scene
}
