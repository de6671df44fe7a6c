//! `rig calibrate pose`: where the sample truly is, from the images of a session.

use std::path::PathBuf;

use serde::Serialize;

use super::rotation;
use super::target::{self, CommonArgs, noted};
use crate::calibrating::{CalibratingError, PoseRequest, TurnedSession};
use crate::calibration::pose::{PoseError, PoseOptions, PoseValues};
use crate::calibration::record::Kind;
use crate::calibration::rotation::RotationTest;
use crate::cli::number::within;
use crate::cli::{CliError, Context};

#[derive(clap::Args, Debug)]
pub(super) struct PoseArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// The session's folder; the sample must still lie as it did there
    #[arg(value_name = "SESSION")]
    session: PathBuf,
    /// Wider images are binned to at most this many pixels across (32 to 4096); more takes longer
    #[arg(long, value_name = "PX", default_value_t = PoseOptions::WIDEST_PX, value_parser = clap::value_parser!(u32).range(32..=4096))]
    widest: u32,
    /// Tests instead whether the sample is uniform and isotropic: further sessions with the same
    /// lights, for which it was turned counterclockwise about its axis by so many degrees
    #[arg(long, value_name = "SESSION=DEG", value_parser = rotation::parse)]
    rotate: Vec<TurnedSession>,
    /// Relative standard deviation of a region's radiance when the sample is seated again, for
    /// --rotate (1e-4 to 0.5)
    #[arg(long, value_name = "R", default_value_t = RotationTest::REPEATABILITY, value_parser = within(1e-4, 0.5))]
    repeatability: f64,
    /// Chance that a good sample fails, for --rotate (1e-4 to 0.5)
    #[arg(long, value_name = "ALPHA", default_value_t = RotationTest::SIGNIFICANCE, value_parser = within(1e-4, 0.5))]
    significance: f64,
}

#[derive(Serialize)]
struct PoseReport<'a> {
    #[serde(flatten)]
    values: &'a PoseValues,
    /// Rounds that were taken, and whether the last step was short.
    rounds: usize,
    settled: bool,
}

/// What to do about it.
fn hint(error: &PoseError) -> &'static str {
    match error {
        PoseError::OutsideView { .. } => {
            "the camera's view or the sample's position in [geometry] is wrong; correct position_mm, \
             look_at_mm, extent_mm or the mesh"
        }
        PoseError::NoEdges | PoseError::TooSmall => {
            "the sample must stand out from what is behind it: use a dark, matt holder, lights from \
             the side that cast shadows, and more pixels"
        }
        PoseError::NotThere { .. } => {
            "no pose within 45° of the rig file's fits better, so the sample is of another shape or \
             the camera elsewhere: look at the radiance images, correct [geometry.sample] and \
             [geometry.camera]"
        }
        PoseError::TooFar { .. } => {
            "seat the sample again, correct [geometry], or state how far it may be off in \
             [uncertainty] (rotation_deg, translation_mm)"
        }
        PoseError::Exact => "state how well the pose is known in [uncertainty]",
        PoseError::ImageCount { .. } | PoseError::ImageSize { .. } => {
            "`rig session verify` says whether the session is whole"
        }
    }
}

pub(super) fn run(args: &PoseArgs, context: &Context) -> Result<(), CliError> {
    if !args.rotate.is_empty() {
        return rotation::run(
            &args.session,
            &args.rotate,
            args.repeatability,
            args.significance,
            args.common.json,
            context,
        );
    }
    let rig = args.common.rig.resolve(context)?;
    let request = PoseRequest {
        rig: &rig.config,
        session: &args.session,
        options: PoseOptions {
            widest_px: args.widest as usize,
            ..PoseOptions::default()
        },
    };
    let bar = context.spinner();
    bar.set_message("aligning");
    let measured = request.measure(context);
    bar.finish_and_clear();
    let measured = measured.map_err(|error| match error {
        CalibratingError::Pose(error) => {
            let hint = hint(&error);
            CliError::new(error.to_string()).hint(format!("{hint}; nothing was kept"))
        }
        error => target::advised(error),
    })?;
    let (values, found) = (&measured.values, &measured.found);
    let place = args.common.place(&rig, context)?;
    let id = place.measurement.id(Kind::Pose);
    if found.searched {
        let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        context.warn(format_args!(
            "the sample lies {:.1}° and {:.1} mm from where the rig file has it, beyond its stated \
             uncertainty: found by a search; of poses that look alike (turns of a symmetric sample, \
             depth under a telecentric lens) this is the nearest",
            norm(values.rotation_deg),
            norm(values.translation_mm)
        ));
    }
    let kept = noted(measured.keep(place)?, context);
    if !found.settled {
        context.warn("the last step was not short: the uncertainty may be too small".to_owned());
    }
    if !values.held.is_empty() {
        context.note(format_args!(
            "not determined by the images and left as the rig file has it: {}",
            values.held.join(", ")
        ));
    }
    context.note(format_args!(
        "use it with `rig fit {} --pose {}`; for further captures with the sample untouched set \
         pose = \"{}\" in the rig file's [calibration]",
        args.session.display(),
        kept.record.display(),
        id
    ));
    let report = PoseReport {
        values,
        rounds: found.rounds,
        settled: found.settled,
    };
    args.common.show(&kept, &report)
}
