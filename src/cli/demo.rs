//! `rig demo`: the main job on the simulated rig.

use std::path::PathBuf;

use super::capture::{self, CaptureArgs};
use super::context::Context;
use super::error::CliError;

/// Captures four lights on the simulated rig, then merges, fits and reports
///
/// stdout's last line is the session's folder; its report.html shows the result.
#[derive(clap::Args, Debug)]
pub struct DemoArgs {
    /// Folder that receives the session's folder
    #[arg(long, value_name = "DIR", default_value = "sessions")]
    out: PathBuf,
    /// Each event as a JSON line on stdout, for other programs, instead of the path
    #[arg(long)]
    events: bool,
}

/// `rig demo`.
pub fn run(args: &DemoArgs, context: &Context) -> Result<(), CliError> {
    let capture = CaptureArgs::on_simulated_rig(4, args.out.clone(), args.events);
    capture::run(&capture, context)
}
