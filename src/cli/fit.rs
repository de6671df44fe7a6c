//! `rig fit`: weights and error bars from images.

use std::path::PathBuf;

use super::pipeline::{FitArgs, FitPlan, check_images, fit_session};
use super::preflight::{Keys, check_scene};
use super::{CliError, Context, HintExt, output, warnings};
use crate::config::scene::SceneFile;
use crate::radiance_image::{RadianceImage, exr};
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
    /// Image (EXR: R, G, B and, where known, var.R, var.G, var.B), one per light of the scene, in its order
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

/// Relative noise that images without a stated variance are taken to have.
const UNSTATED_NOISE: f32 = 0.005;

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
            "departure": record.departure.as_ref().map_or(0.0, |d| d.amplitude),
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

/// States the relative noise of [`UNSTATED_NOISE`], of dark pixels that of a thousandth of the
/// mean radiance: nothing is known without any error.
fn assume_noise(image: &mut RadianceImage) {
    let values = image.mean.iter().flatten().filter(|v| v.is_finite());
    let mean = values.map(|v| v.abs()).sum::<f32>() / (3 * image.mean.len()).max(1) as f32;
    for (variance, mean_radiance) in image.variance.iter_mut().zip(&image.mean) {
        *variance = mean_radiance.map(|m| (UNSTATED_NOISE * m.abs().max(1e-3 * mean)).powi(2));
    }
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
    let (mut captured, mut remarks) = (Vec::new(), Vec::new());
    for path in &args.image {
        let file = exr::read_sized(path, scene.camera.resolution_px)
            .map_err(CliError::from)
            .hint("give one EXR image for each [[light]] of the scene, in its order, of its camera's resolution_px")?;
        let mut image = file.image;
        if !file.has_variance {
            let remark = format!(
                "{}: no variance is stated; a relative noise of {UNSTATED_NOISE} is assumed",
                path.display()
            );
            context.note(&remark);
            remarks.push(remark);
            assume_noise(&mut image);
        }
        captured.push(image);
    }
    let file = |image: usize| args.image[image].display().to_string();
    check_scene(&scene, Keys::Scene, context)?;
    let captured = plan.average(&scene, captured, file)?;
    check_images(&scene, &captured, file)?;
    let (mut record, images) = plan.run(&scene, &captured, false, None, context)?;
    record.remarks.extend(remarks);
    record.settings.scene = Some(path.display().to_string());
    record.settings.images = args.image.iter().map(|i| i.display().to_string()).collect();
    fit_record::write(out, &record, &images)?;
    warnings::tell(&record, context);
    Ok(())
}
