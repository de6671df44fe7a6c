//! A fit as its record keeps it.

use std::collections::BTreeMap;
use std::time::Instant;

use super::fit_plan::FitPlan;
use super::{FitRequest, WorkflowError};
use crate::brdf::score::SPHERE_SIZE;
use crate::brdf::{Brdf, Mixture};
use crate::inverse::{Fit, intervals};
use crate::scores::score;
use crate::session::fit_record::{
    AngleTable, BudgetRecord, DiscrepancyRecord, FitRecord, FitSettings, PosteriorRecord, Timing,
    TracePoint,
};

/// The record of a fit by `plan`, still without warnings, remarks, bench and truncated light.
/// `truth`: name and BRDF, where known.
///
/// # Errors
/// The truth cannot be compared with the dictionary.
pub(super) fn of_fit(
    plan: &FitPlan,
    fit: &Fit,
    simulated: bool,
    truth: Option<(&str, &dyn Brdf)>,
) -> Result<FitRecord, WorkflowError> {
    let mixture = &fit.material.mixture;
    let dictionary = mixture.dictionary();

    // The comparison with the truth takes time of its own.
    let clock = Instant::now();
    let score = match truth {
        Some((name, brdf)) => {
            let start = Mixture::new(plan.dictionary.clone(), fit.start.clone())?;
            let material = &fit.material;
            Some(score(
                name,
                brdf,
                &plan.dictionary,
                material,
                &start,
                SPHERE_SIZE,
            )?)
        }
        None => None,
    };
    let scoring = ("score", clock.elapsed().as_secs_f64());

    // The optimiser's steps; the last one's loss is the fit's.
    let trace: Vec<TracePoint> = (0..)
        .zip(&fit.trace)
        .map(|(step, (seconds, point))| TracePoint {
            step,
            loss: point.loss.iter().sum(),
            seconds: *seconds,
        })
        .collect();

    let timings = fit.timings.iter().copied().chain([scoring]);
    Ok(FitRecord {
        simulated,
        weight_deviations: intervals::weight_deviations(&fit.posterior_samples, dictionary.len()),
        settings: settings(plan, fit),
        loss: trace.last().map_or(0.0, |last| last.loss),
        reduced_chi_square: fit.comparison.reduced_chi2(),
        outlier_fraction: fit.outlier_fraction.clone(),
        discrepancy: (fit.discrepancy > 0.0).then(|| DiscrepancyRecord {
            amplitude: fit.discrepancy,
            by_channel: fit.material.discrepancies.clone(),
        }),
        termination: fit.termination.to_string(),
        trace,
        timings: timings
            .map(|(stage, seconds)| Timing {
                stage: stage.to_owned(),
                seconds,
            })
            .collect(),
        versions: BTreeMap::from([("rig".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
        score,
        table: AngleTable::of(fit),
        posterior: PosteriorRecord::of(fit),
        budget: BudgetRecord::of(fit),
        ..FitRecord::of_mixture(mixture)
    })
}

/// How the fit was run.
fn settings(plan: &FitPlan, fit: &Fit) -> FitSettings {
    let options = &plan.options;
    let [traced, requested] = fit.samples.map(u64::from);
    let paths_mib = (options.cache.max_bytes >> 20) as u64;
    let mask = plan.mask.as_ref();
    FitSettings {
        optimizer: options.optimizer.name().to_owned(),
        samples_per_pixel: traced,
        samples_requested: Some(requested),
        adapted_paths: Some(options.adapt_paths),
        asked: FitRequest {
            mask: mask.map(|path| path.display().to_string().into()),
            memory_mib: plan.memory_mib.or(Some(paths_mib)),
            job: plan.job.clone(),
            ..FitRequest::recorded(options)
        },
        session: None,
        scene: None,
        images: Vec::new(),
        max_reflections: options.cache.max_reflections,
        seed: options.cache.seed,
        kernel: fit.kernel.to_string(),
    }
}
