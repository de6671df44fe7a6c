//! Light directions chosen by how much they tell: before anything is known of the material,
//! or after a fit.

use std::sync::Arc;

use super::CaptureError;
use super::directions::{Aim, plan_order};
use super::findings::{Notice, PrepareError};
use super::reach::StageReach;
use crate::brdf::discrepancy::Prior;
use crate::config::RigConfig;
use crate::inverse::expected_error::{
    Choice, PredictionOptions, Prospects, Subject, USUAL, coarse,
};
use crate::session::{Session, fit_record};
use crate::units::StageAngles;

/// Directions that are compared: the first of the evenly spread ones.
pub const CANDIDATES: usize = 60;
/// Cosine of the angle within which a direction counts as taken already, 1°.
const NEAR_COSINE: f64 = 0.999_848;

/// A direction and what it is expected to add.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Ranked {
    /// The direction.
    #[serde(flatten)]
    pub light: StageAngles,
    /// Environment error that is expected with it and all before it.
    #[serde(rename = "expected_error")]
    pub error: f64,
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
    /// Environment error that is expected with these.
    pub error: f64,
    /// Directions to add, best first.
    pub next: Vec<Ranked>,
}

/// The best `count` directions within reach for a material of which nothing is known,
/// best first.
///
/// # Errors
/// More lights than candidates; a scene that cannot be used.
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
    notice(Notice::Comparing {
        directions: candidates.len(),
    });
    let scene = coarse(config.geometry.scene(&candidates)?);
    let usual = USUAL.into_iter().filter_map(Subject::embedded);
    let usual: Vec<Arc<Subject>> = usual.map(Arc::new).collect();
    let prospects = Prospects::new(scene, &usual, &options(config))?;
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
    let material = fit_record::read_in(session, number)?.material()?;
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
    let prior = Prior::without(&[]);
    let fitted = (0..3).map(|channel| Subject::new("fitted", &*material, channel, prior.clone()));
    let fitted: Vec<Arc<Subject>> = fitted.map(Arc::new).collect();
    let scene = coarse(config.geometry.scene(&candidates)?);
    let prospects = Prospects::new(scene, &fitted, &options(&config))?;
    Ok(NextLights {
        fit: number,
        taken: taken.len(),
        error: prospects.error(&taken),
        next: ranked(&prospects.greedy(&taken, count), &candidates),
    })
}

fn ranked(choices: &[Choice], candidates: &[StageAngles]) -> Vec<Ranked> {
    let of = |choice: &Choice| Ranked {
        light: candidates[choice.candidate],
        error: choice.error,
    };
    choices.iter().map(of).collect()
}

fn options(config: &RigConfig) -> PredictionOptions {
    PredictionOptions {
        seed: config.fit.seed(),
        ..PredictionOptions::default()
    }
}
