//! `rig demo`: the main job on the simulated rig.

use std::path::PathBuf;

use super::capture::{self, CaptureArgs};
#[cfg(feature = "console")]
use super::capture_console::ConsoleOptions;
use super::context::Context;
use super::error::CliError;
use crate::session::layout::SESSIONS_FOLDER;

/// Captures four lights on a simulated rig, then merges, fits and reports
///
/// stdout's last line is the session's folder; its report.html shows the result.
#[derive(clap::Args, Debug)]
pub struct DemoArgs {
    /// Folder that receives the session's folder
    #[arg(long, value_name = "DIR", default_value = SESSIONS_FOLDER)]
    out: PathBuf,
    /// Which simulated bench
    #[arg(long, value_enum, default_value_t = Bench::Bowl)]
    bench: Bench,
    /// Each event as a JSON line on stdout, for other programs, instead of the path
    #[arg(long)]
    events: bool,
    #[cfg(feature = "console")]
    #[command(flatten)]
    console: ConsoleOptions,
}

/// The simulated benches.
#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum Bench {
    /// A bowl under a camera on its axis
    Bowl,
    /// A ridge before a camera tilted by 54°
    Tilted,
    /// A ball before the tilted camera, with lamps behind it
    Ball,
}

impl Bench {
    /// Its rig.
    fn rig(self) -> &'static str {
        match self {
            Self::Bowl => "simulated",
            Self::Tilted => "simulated-tilted",
            Self::Ball => "simulated-ball",
        }
    }
}

/// Lights of the demonstration.
const LIGHTS: usize = 4;

/// `rig demo`.
pub fn run(args: &DemoArgs, context: &Context) -> Result<(), CliError> {
    #[cfg(feature = "console")]
    if args.console.is_wanted()? {
        return args.console.run_demo(
            std::env::args_os().skip(1),
            args.bench.rig(),
            LIGHTS,
            context,
        );
    }
    let rig = args.bench.rig();
    let capture = CaptureArgs::on_simulated_rig(rig, LIGHTS, args.out.clone(), args.events);
    capture::run(&capture, context)
}
