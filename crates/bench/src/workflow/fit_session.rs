//! Fitting a captured session.

use std::path::Path;
use std::sync::Arc;

use super::cell_images::Source;
use super::fit_plan::FitPlan;
use super::notice::{Notice, Observer};
use super::scene_check::check_scene;
use super::session_images::{CapturedSession, captured_session, measured_pose};
use super::{BenchRecords, FitOutcome, FitRequest, FitWork, WorkflowError, fit_memory, lamp_drift};
use crate::calibration::glare::GlareValues;
use crate::calibration::record::Record;
use crate::config::RigConfig;
use crate::config::scene_concern::DescribedIn;
use crate::config::simulation::MaterialSpec;
use crate::inverse::nuisance::with_sample_at;
use crate::radiance_image::exr::ExrRows;
use crate::session::commit::SystemDisk;
use crate::session::fit_record::{self, FitImages, FitRecord, Grade, Warning};
use crate::session::{LampDrift, Session, SessionWriter, layout};
use crate::transport::Scene;
use crate::units::StageAngles;

/// Fits a session's merged images, on the bench as rig file and calibration records describe
/// it, into the session's next `fits/<n>`.
///
/// # Errors
/// A session, record, image or choice that cannot be used; images that cannot be the scene's;
/// too little memory; a disk that takes no more. Nothing is written then.
pub fn fit_session(
    root: &Path,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<FitOutcome, WorkflowError> {
    // Before a fit that may take hours, and released until it is there.
    SessionWriter::open(Arc::new(SystemDisk), root)?.check_writable(layout::FITS_FOLDER)?;
    let (record, images) = fit_captured(root, request, observer)?;
    let mut writer = SessionWriter::open(Arc::new(SystemDisk), root)?;
    let folder = fit_record::commit(&mut writer, &record, &images)?;
    writer.refresh_manifest()?;
    Ok(FitOutcome { folder, record })
}

/// Likewise into a folder outside the session, of which nothing is locked or changed: it may lie
/// where nothing can be written.
///
/// # Errors
/// As [`fit_session`]; `out` exists and is not empty.
pub fn fit_session_into(
    root: &Path,
    out: &Path,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<FitOutcome, WorkflowError> {
    fit_record::check_folder(out)?;
    let (mut record, images) = fit_captured(root, request, observer)?;
    record.settings.session = Some(root.display().to_string());
    fit_record::write(out, &record, &images)?;
    Ok(FitOutcome {
        folder: out.to_owned(),
        record,
    })
}

/// A captured session as a fit is made of it: the bench as measured, the plan, the images still
/// unread.
pub(super) struct Prepared {
    pub session: Session,
    pub config: RigConfig,
    pub scene: Scene,
    pub plan: FitPlan,
    pub images: Vec<ExrRows>,
    drift: LampDrift,
    is_scale_described: bool,
    pub glare_remark: Option<String>,
}

/// Reads what a fit of a session by this request starts from.
///
/// # Errors
/// A session, record or choice that cannot be used, a scene whose images say nothing.
pub(super) fn prepared(
    root: &Path,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<Prepared, WorkflowError> {
    let captured = captured_session(root)?;
    let images = captured.image_rows(root)?;
    let CapturedSession {
        session,
        config,
        mut positions,
    } = captured;

    // The bench as measured, and how well it is known.
    let records = BenchRecords::load(root)?;
    let is_scale_described = !config.is_simulated() && !records.has_irradiance();
    if is_scale_described {
        observer.notice(Notice::ScaleAsDescribed);
    }
    let mut bench = records.apply(&config, &mut positions, observer);
    let mut scene = bench.scene(&positions, observer)?;
    let mut uncertainty = bench.priors;
    if let Some(pose) = measured_pose(root, request.pose.as_deref())? {
        let [rotation_rad, translation_mm] = pose.pose();
        scene = with_sample_at(scene, rotation_rad, translation_mm);
        uncertainty.pose_covariance = Some(pose.covariance_rad_mm());
    }
    let drift = session.lamp_drift()?;
    uncertainty.intensity = match uncertainty.intensity {
        known if known > 0.0 => known.hypot(drift.of_intensities()),
        exact => exact,
    };
    let sample = &config.geometry.sample;
    let mut plan = FitPlan::new(request, Some(&config.fit), &uncertainty, sample.form_error)?;
    // The prior is not to know what a simulated bench measures.
    let simulated = config.simulation.as_ref().map(|bench| &bench.material);
    if let Some(MaterialSpec::Bundled { name, .. }) = simulated {
        plan.options.left_out.push(name.clone());
    }
    let glare = records.glare();
    plan.glare = glare.map(|loaded| loaded.record.values.glare());
    let glare_remark = glare.map(|loaded| glare_remark(&loaded.record));
    if let Some(remark) = &glare_remark {
        observer.notice(Notice::Remark(remark));
    }
    check_scene(&scene, DescribedIn::Rig, &sample.surface, observer)?;
    Ok(Prepared {
        session,
        config,
        scene,
        plan,
        images,
        drift,
        is_scale_described,
        glare_remark,
    })
}

/// Which glare was taken off, for the fit's record.
fn glare_remark(record: &Record<GlareValues>) -> String {
    let total = record.values.total();
    format!(
        "veiling glare of {:.2} ± {:.2}% of the light is taken off the images, by record {}",
        100.0 * total.value,
        100.0 * total.std,
        record.id
    )
}

pub(super) fn fit_captured(
    root: &Path,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<(FitRecord, FitImages), WorkflowError> {
    let prepared = prepared(root, request, observer)?;

    // The images, and the truth where the bench is simulated.
    let sources = (0..).zip(prepared.images).map(|(light, rows)| Source {
        rows,
        file: root
            .join(layout::radiance_file(light))
            .display()
            .to_string(),
        mean_of_unstated: None,
    });
    let captured = prepared.plan.average(&prepared.scene, sources.collect())?;
    let truth = match &prepared.config.simulation {
        Some(simulation) => Some(simulation.material.load()?),
        None => None,
    };
    let record = prepared.session.record();
    let name = record.true_material.as_deref();
    let name = name.unwrap_or("simulated material");
    let truth = truth.as_ref().map(|brdf| (name, &**brdf));

    // The fit, and what the session adds to what is to be known of it.
    let scene = &prepared.scene;
    let run = prepared
        .plan
        .run(scene, &captured, record.simulated, truth, observer)?;
    let (mut fit, found) = (run.record, run.fit);
    if prepared.is_scale_described {
        fit.remarks.push(Notice::ScaleAsDescribed.to_string());
    }
    fit.remarks.extend(prepared.glare_remark);
    fit.warnings
        .extend(prepared.session.journal().suspicion().map(|what| Warning {
            what,
            likely_cause: "an axis that slipped or was blocked: the fit takes the lights to be where they were asked for; capture anew".to_owned(),
            grade: Grade::Reservation,
        }));
    if let Some(remark) = lamp_drift::remark(&prepared.drift) {
        observer.notice(Notice::Remark(&remark));
        fit.remarks.push(remark);
    }
    Ok((fit, FitImages::from(&found.comparison)))
}

/// How much a fit without any request will have to do, of images under these lights.
///
/// # Errors
/// A rig whose scene cannot be built.
pub fn work_of(config: &RigConfig, lights: &[StageAngles]) -> Result<FitWork, WorkflowError> {
    expected(config, lights, &FitRequest::default()).map(|expected| expected.work)
}

/// What a fit is going to take.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// How much there is to do.
    pub work: FitWork,
    /// With this as [`FitRequest::memory_mib`], memory keeps no path from being traced: what a
    /// fit takes at most where nothing limits it.
    pub memory_mib: u64,
}

/// What a fit by this request is going to take, of images under these lights.
///
/// # Errors
/// A rig whose scene cannot be built, or a request that cannot be met.
pub fn expected(
    config: &RigConfig,
    lights: &[StageAngles],
    request: &FitRequest,
) -> Result<Expected, WorkflowError> {
    let form_error = config.geometry.sample.form_error;
    let plan = FitPlan::new(request, Some(&config.fit), &config.uncertainty, form_error)?;
    let scene = config.geometry.scene(lights)?;
    let work = plan.work(plan.cells_of(&scene), lights.len());
    Ok(Expected {
        work,
        memory_mib: fit_memory::ample_mib(&plan, &work),
    })
}
