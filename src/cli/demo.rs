//! `rig demo`: the whole pipeline on the simulated rig.

use std::path::PathBuf;

use super::capture::{self, CaptureArgs};
use super::{CliError, Context};

/// Captures four lights on the simulated rig, then merges, fits and reports
///
/// stdout's last line is the session's folder; `report.html` in it is the result.
#[derive(clap::Args, Debug)]
pub struct DemoArgs {
    /// Folder that receives the session's folder
    #[arg(long, value_name = "DIR", default_value = "sessions")]
    out: PathBuf,
    /// The result as JSON
    #[arg(long)]
    json: bool,
}

/// `rig demo`.
pub fn run(args: &DemoArgs, context: &Context) -> Result<(), CliError> {
    let capture = CaptureArgs::of_demo(args.out.clone(), args.json);
    capture::run(&capture, context)
}
