//! `rig demo`: the main job on the simulated rig.

use std::path::PathBuf;

use super::capture::{self, CaptureArgs};
#[cfg(feature = "console")]
use super::capture_console::ConsoleOptions;
use super::context::Context;
use super::error::CliError;
use crate::session::layout::SESSIONS_FOLDER;

/// Captures four lights on the simulated rig, then merges, fits and reports
///
/// stdout's last line is the session's folder; its report.html shows the result.
#[derive(clap::Args, Debug)]
pub struct DemoArgs {
    /// Folder that receives the session's folder
    #[arg(long, value_name = "DIR", default_value = SESSIONS_FOLDER)]
    out: PathBuf,
    /// Each event as a JSON line on stdout, for other programs, instead of the path
    #[arg(long)]
    events: bool,
    #[cfg(feature = "console")]
    #[command(flatten)]
    console: ConsoleOptions,
}

/// Lights of the demonstration.
const LIGHTS: usize = 4;

/// `rig demo`.
pub fn run(args: &DemoArgs, context: &Context) -> Result<(), CliError> {
    #[cfg(feature = "console")]
    if args.console.is_wanted()? {
        return args
            .console
            .run_demo(std::env::args_os().skip(1), LIGHTS, context);
    }
    let capture = CaptureArgs::on_simulated_rig(LIGHTS, args.out.clone(), args.events);
    capture::run(&capture, context)
}
