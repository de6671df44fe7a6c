//! `rig fit`: weights and error bars from images.

use std::path::PathBuf;

use super::cell_images::{Source, UNSTATED_NOISE};
use super::pipeline::{FitArgs, FitPlan, fit_session};
use super::preflight::{Keys, check_scene};
use super::{CliError, Context, output, warnings};
use crate::config::scene::SceneFile;
use crate::radiance_image::exr::ExrRows;
use crate::session::fit_record;

/// Fits a BRDF to a session, or to images of a described scene.
#[derive(clap::Args, Debug)]
pub struct FitCommandArgs {
    /// The session's folder
    #[arg(value_name = "SESSION", required_unless_present = "scene", conflicts_with_all = ["scene", "image", "out"])]
    session: Option<PathBuf>,
    /// Scene file: camera, lights and the sample's shape
    #[arg(long, value_name = "S", requires = "image", requires = "out")]
    scene: Option<PathBuf>,
    /// Image (EXR: R, G, B and, where known, var.R, var.G, var.B), one per light of the scene, in its order;
    /// FILE:NAME names one of several parts or layers
    #[arg(long, value_name = "EXR", num_args = 1..)]
    image: Vec<PathBuf>,
    /// Folder for the result; it must not exist or be empty
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Record of the sample's pose, by `rig calibrate pose` (default: the session's copy, if
    /// its rig file named one); its covariance takes the place of rotation_deg and
    /// translation_mm
    #[arg(long, value_name = "RECORD", conflicts_with = "scene")]
    pose: Option<PathBuf>,
    /// The result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    fit: FitArgs,
}

/// `rig fit`.
pub fn run(args: &FitCommandArgs, context: &Context) -> Result<(), CliError> {
    let folder = match (&args.session, &args.scene, &args.out) {
        (Some(session), _, _) => fit_session(session, &args.fit, args.pose.as_deref(), context)?,
        (None, Some(scene), Some(out)) => {
            fit_scene(args, scene, out, context)?;
            out.clone()
        }
        _ => {
            return Err(CliError::new(
                "neither a session nor a scene with --out is given",
            ));
        }
    };
    if args.json {
        let record = fit_record::read(&folder)?;
        return output::write_json(&serde_json::json!({
            "fit": folder.display().to_string(),
            "dictionary": record.dictionary,
            "atoms": record.atoms,
            "weights": record.weights,
            "weight_deviations": record.weight_deviations,
            "verdict": record.verdict(),
            "reduced_chi_square": record.reduced_chi_square,
            "discrepancy": record.discrepancy.as_ref().map_or(0.0, |d| d.amplitude),
            "loss": record.loss,
            "termination": record.termination,
            "score": record.score,
            "timings": record.timings,
            "warnings": record.warnings,
            "remarks": record.remarks,
            "bench": record.bench,
        }));
    }
    output::write_path(&folder)
}

fn fit_scene(
    args: &FitCommandArgs,
    path: &std::path::Path,
    out: &std::path::Path,
    context: &Context,
) -> Result<(), CliError> {
    let file = SceneFile::load(path)?;
    fit_record::check_folder(out)?;
    let plan = FitPlan::new(&args.fit, None, &file.uncertainty, file.sample.form_error)?;
    let scene = file.scene()?;
    let size = Some(scene.camera.resolution_px);
    let (mut sources, mut remarks) = (Vec::new(), Vec::new());
    for path in &args.image {
        let open = || ExrRows::open(path, size);
        let source = open().and_then(|rows| Source::new(rows, path.display().to_string(), open));
        let source = source?;
        if source.mean_of_unstated.is_some() {
            let remark = format!(
                "{}: no variance is stated; a relative noise of {UNSTATED_NOISE} is assumed",
                path.display()
            );
            context.note(&remark);
            remarks.push(remark);
        }
        sources.push(source);
    }
    check_scene(&scene, Keys::scene(&file), context)?;
    let captured = plan.average(&scene, sources)?;
    let name = |image: usize| args.image[image].display().to_string();
    plan.check_images(&scene, &captured, name)?;
    let (mut record, images) = plan.run(&scene, &captured, false, None, context)?;
    record.remarks.extend(remarks);
    record.settings.scene = Some(path.display().to_string());
    record.settings.images = args.image.iter().map(|i| i.display().to_string()).collect();
    fit_record::write(out, &record, &images)?;
    warnings::tell(&record, context);
    Ok(())
}
