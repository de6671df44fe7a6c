//! Light directions chosen by how much they tell: before anything is known of the material,
//! or after a fit.

use std::sync::Arc;

use super::CaptureError;
use super::directions::{Aim, plan_order};
use super::findings::{Notice, PrepareError};
use super::reach::StageReach;
use crate::brdf::Brdf;
use crate::brdf::discrepancy::Prior;
use crate::config::RigConfig;
use crate::config::simulation::MaterialSpec;
use crate::inverse::expected_error::{
    Choice, PredictionOptions, Prospects, Subject, USUAL, coarse,
};
pub use crate::session::Ranked;
use crate::session::{Session, fit_record};
use crate::units::{StageAngles, percent};

/// Directions that are compared: the first of the evenly spread ones.
pub const CANDIDATES: usize = 60;
/// Cosine of the angle within which a direction counts as taken already, 1°.
const NEAR_COSINE: f64 = 0.999_848;

/// The best of some directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// Directions that were compared.
    pub compared: usize,
    /// Best first.
    pub best: Vec<Ranked>,
}

impl std::fmt::Display for Ranking {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { compared, best } = self;
        write!(
            out,
            "best of {compared} directions; expected environment error after each: "
        )?;
        let left = best.iter().map(|best| percent(best.error));
        out.write_str(&left.collect::<Vec<_>>().join(", "))
    }
}

/// What more lights are expected to add to a fitted session.
#[derive(Clone, Debug, PartialEq)]
pub struct NextLights {
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

/// The `count` directions that would add most to a fitted session, best first, and the number of
/// the fit that says what the material is.
///
/// # Errors
/// [`PrepareError::NoFit`], or files of the session that cannot be used.
pub fn next(
    session: &Session,
    count: usize,
    notice: &mut dyn FnMut(Notice<'_>),
) -> Result<(u32, NextLights), PrepareError> {
    let number = fit_record::numbers_in(session).pop().ok_or_else(|| {
        let session = session.root().to_owned();
        PrepareError::NoFit { session }
    })?;
    let material = fit_record::read_in(session, number)?.material()?;
    Ok((number, after(session, &*material, count, notice)?))
}

/// The `count` directions that would add most to the lights of a session whose sample is of this
/// material, best first; with a `count` of 0 only what is expected without them.
///
/// # Errors
/// Files of the session that cannot be used.
pub fn after(
    session: &Session,
    material: &dyn Brdf,
    count: usize,
    notice: &mut dyn FnMut(Notice<'_>),
) -> Result<NextLights, PrepareError> {
    let record = session.record();
    let config = session.rig()?;

    // The lights taken come first among the candidates.
    let planned = record.plan.lights.iter().enumerate();
    let mut candidates: Vec<StageAngles> = planned
        .filter(|(index, _)| session.light_is_finished(*index as u32))
        .map(|(_, &angles)| angles)
        .collect();
    let taken: Vec<usize> = (0..candidates.len()).collect();
    let reach = StageReach::of_rig(&config)?;
    let most = if count == 0 { 0 } else { CANDIDATES };
    let spread = plan_order(&reach, Aim::of(&config.geometry), most, 0.0);
    candidates.extend(spread.into_iter().filter(|angles| {
        let near = |other: &StageAngles| other.to_light().dot(angles.to_light()) > NEAR_COSINE;
        !record.plan.lights.iter().any(near)
    }));

    notice(Notice::Comparing {
        directions: candidates.len(),
    });
    // The prior is not to know what a simulated bench measures.
    let simulated = config.simulation.as_ref().map(|bench| &bench.material);
    let prior = match simulated {
        Some(MaterialSpec::Bundled { name, .. }) => Prior::without(std::slice::from_ref(name)),
        _ => Prior::without(&[]),
    };
    let fitted = (0..3).map(|channel| Subject::new("fitted", material, channel, prior.clone()));
    let fitted: Vec<Arc<Subject>> = fitted.map(Arc::new).collect();
    let scene = coarse(config.geometry.scene(&candidates)?);
    let prospects = Prospects::new(scene, &fitted, &options(&config))?;
    Ok(NextLights {
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
