//! The command line: one file per command, and what they share: errors with
//! hints, exit codes, output, signals.
//!
//! A command is a file with `pub struct XArgs` (`clap::Args`) and
//! `pub fn run(args: &XArgs, context: &Context) -> Result<(), CliError>`, a
//! `pub mod` line and one line in `commands!` below.

mod as_model;
#[cfg(feature = "reports")]
pub mod batch;
#[cfg(feature = "console")]
mod bench_ports;
pub mod benchmark;
mod bracket_files;
pub mod brdf;
pub mod calibrate;
pub mod camera;
mod camera_preview;
pub mod capture;
#[cfg(feature = "console")]
mod capture_console;
mod capture_notices;
mod capture_progress;
mod capture_queue;
mod capture_run;
pub mod catalogue;
pub mod completions;
#[cfg(feature = "console")]
pub mod console;
#[cfg(feature = "console")]
mod console_address;
pub mod context;
pub mod demo;
pub mod design;
pub mod devices;
pub mod doctor;
pub mod error;
#[cfg(feature = "experiments")]
pub mod evaluate;
pub mod exit;
pub mod export;
pub mod fit;
mod fit_progress;
pub mod guardian;
pub mod hints;
pub mod init;
pub mod interrupt;
pub mod keeper;
pub mod light_choice;
pub mod merge;
mod merge_sensor;
mod merge_warnings;
mod notices;
mod number;
pub mod open;
mod operator;
pub mod output;
mod preflight;
pub mod progress;
pub mod render;
mod repeatability;
#[cfg(feature = "reports")]
pub mod report;
pub mod rig_choice;
pub mod session;
pub mod shape;
mod shape_inspect;
#[cfg(any(feature = "reports", feature = "experiments"))]
mod slurm_args;
pub mod stage;
pub mod stderr;
mod table;
mod trace;
pub mod validate;

use std::ffi::OsString;
use std::io::IsTerminal;
use std::process::ExitCode;

use clap::{Args, ColorChoice, CommandFactory, FromArgMatches, Parser, Subcommand};

pub use context::Context;
pub use error::{CliError, HintExt};
use exit::Exit;
use output::write_stderr;

/// The table of commands: `Name(arguments) => function`, in the order of `rig --help`.
macro_rules! commands {
    ($($(#[$attribute:meta])* $name:ident($arguments:ty) => $run:path,)*) => {
        #[derive(Subcommand, Debug)]
        enum Command { $($(#[$attribute])* $name($arguments),)* }

        impl Command {
            fn run(&self, context: &Context) -> Result<(), CliError> {
                match self { $($(#[$attribute])* Command::$name(arguments) => $run(arguments, context),)* }
            }
        }
    };
}

commands! {
    Demo(demo::DemoArgs) => demo::run,
    Capture(capture::CaptureArgs) => capture::run,
    #[cfg(feature = "console")]
    Console(console::ConsoleArgs) => console::run,
    Init(init::InitArgs) => init::run,
    Catalogue(catalogue::CatalogueArgs) => catalogue::run,
    Session(session::SessionArgs) => session::run,
    Devices(devices::DevicesArgs) => devices::run,
    Doctor(doctor::DoctorArgs) => doctor::run,
    Stage(stage::StageArgs) => stage::run,
    Camera(camera::CameraArgs) => camera::run,
    Calibrate(calibrate::CalibrateArgs) => calibrate::run,
    Merge(merge::MergeArgs) => merge::run,
    Fit(fit::FitCommandArgs) => fit::run,
    Validate(validate::ValidateArgs) => validate::run,
    Render(render::RenderArgs) => render::run,
    Brdf(brdf::BrdfArgs) => brdf::run,
    Shape(shape::ShapeArgs) => shape::run,
    Design(design::DesignArgs) => design::run,
    #[cfg(feature = "experiments")]
    Evaluate(evaluate::EvaluateArgs) => evaluate::run,
    #[cfg(feature = "reports")]
    Report(report::ReportArgs) => report::run,
    #[cfg(feature = "reports")]
    Batch(batch::BatchArgs) => batch::run,
    Export(export::ExportArgs) => export::run,
    Bench(benchmark::BenchArgs) => benchmark::run,
    Completions(completions::CompletionsArgs) => completions::run,
    Man(completions::ManArgs) => completions::run_man,
    Guardian(guardian::GuardianArgs) => guardian::run,
    Keeper(keeper::KeeperArgs) => keeper::run,
}

/// Measures how a material reflects light, from the interreflections of a concave sample
#[derive(Parser, Debug)]
#[command(
    name = "rig",
    version,
    arg_required_else_help = true,
    propagate_version = true,
    after_help = "Exit codes: 0 done, 1 failed or bad input, 2 internal error, 130/143/129 stopped by SIGINT/SIGTERM/SIGHUP."
)]
struct Cli {
    #[command(flatten)]
    global: GlobalArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Global options")]
struct GlobalArgs {
    /// Only errors on stderr: no progress, no notes
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// What happens inside, on stderr; twice for more
    #[arg(long, short, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// When to colour; also NO_COLOR is respected
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto")]
    color: ColorChoice,
}

/// The command line's definition, for parsing, completions and manual pages.
pub fn definition() -> clap::Command {
    Cli::command()
}

/// Parses the process's arguments, runs the command, prints its error and
/// returns the exit code.
pub fn main() -> ExitCode {
    ExitCode::from(guarded(|| run(std::env::args_os().collect())).code())
}

/// Runs `body`; a panic in it is reported in one line and becomes [`Exit::Internal`].
pub fn guarded(body: impl FnOnce() -> Exit + std::panic::UnwindSafe) -> Exit {
    install_panic_hook();
    interrupt::outlive_file_limits();
    let exit = std::panic::catch_unwind(body).unwrap_or(Exit::Internal);
    stderr::flush(stderr::LAST_WORDS);
    exit
}

fn run(arguments: Vec<OsString>) -> Exit {
    let choice = color_choice(&arguments);
    let color = use_color(choice);
    let subcommand = subcommand(&arguments);
    let parsed = definition()
        .color(choice)
        .try_get_matches_from(arguments)
        .and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) => return report_usage(&error, &subcommand, color),
    };
    trace::start(cli.global.quiet, cli.global.verbose, color);
    let context = Context::new(cli.global.quiet, color);
    match cli.command.run(&context) {
        Ok(()) => Exit::Done,
        Err(error) => {
            let error = match error.advice() {
                Some(_) => error,
                None => error.hint(format!("`{subcommand} --help` explains the command")),
            };
            write_stderr(&error.render(color));
            error.exit()
        }
    }
}

/// Help and version go to stdout with code 0; wrong usage is an error like any other.
fn report_usage(error: &clap::Error, subcommand: &str, color: bool) -> Exit {
    use clap::error::ErrorKind::*;
    match error.kind() {
        DisplayHelp | DisplayVersion => {
            let _ = error.print();
            Exit::Done
        }
        DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            Exit::Failed
        }
        _ => {
            let error = usage_error(&error.render().to_string(), subcommand);
            write_stderr(&error.render(color));
            error.exit()
        }
    }
}

/// `rig` and the commands that the arguments name, as far as they do.
fn subcommand(arguments: &[OsString]) -> String {
    let mut command = definition();
    let mut path = "rig".to_owned();
    for word in arguments.iter().skip(1).filter_map(|word| word.to_str()) {
        if let Some(found) = command.find_subcommand(word).cloned() {
            path = format!("{path} {word}");
            command = found;
        }
    }
    path
}

/// clap's paragraphs as one fact and one hint.
fn usage_error(rendered: &str, subcommand: &str) -> CliError {
    let fact = usage_fact(rendered);
    let taker = takers(&fact, subcommand);
    let lines = rendered.split("\n\n").skip(1).flat_map(str::lines);
    let tips = lines.filter_map(|line| line.trim().strip_prefix("tip: "));
    // Of an option that is none here: it is no typing error, and no file or sample is called so.
    let tips = tips.filter(|tip| taker.is_none() && !tip.starts_with("to pass '"));
    let help = format!("`{subcommand} --help` explains the arguments");
    let hints = taker.as_deref().into_iter().chain(tips);
    let hints: Vec<_> = hints.chain([&*help]).collect();
    CliError::new(&fact).hint(hints.join("; "))
}

/// The commands above and beside `subcommand` that have the option it rejects, if at most three do.
fn takers(fact: &str, subcommand: &str) -> Option<String> {
    let rest = fact.strip_prefix("unexpected argument '--")?;
    let (long, _) = rest.split_once('\'')?;
    let (above, _) = subcommand.rsplit_once(' ')?;
    let within = |command: clap::Command, word| command.find_subcommand(word).cloned();
    let parent = above.split(' ').skip(1).try_fold(definition(), within)?;
    let takes = |command: &&clap::Command| {
        let mut longs = command.get_arguments().map(clap::Arg::get_long);
        longs.any(|its| its == Some(long))
    };
    let itself = Some(&parent).filter(takes).map(|_| format!("`{above}`"));
    let beside = parent.get_subcommands().filter(takes);
    let beside = beside.map(|command| format!("`{above} {}`", command.get_name()));
    let all: Vec<_> = itself.into_iter().chain(beside).collect();
    (1..=3)
        .contains(&all.len())
        .then(|| format!("--{long} is of {}", all.join(" and ")))
}

/// What clap finds wrong, without its tips.
fn usage_fact(rendered: &str) -> String {
    let fact = rendered.split("\n\n").next().unwrap_or(rendered);
    crate::shown::line(fact.trim_start_matches("error: "))
}

/// `--color` as it is needed before anything is parsed.
fn color_choice(arguments: &[OsString]) -> ColorChoice {
    let words: Vec<_> = arguments
        .iter()
        .map(|word| word.to_string_lossy())
        .collect();
    let value = words.iter().enumerate().find_map(|(i, word)| {
        if word == "--color" {
            words.get(i + 1).map(|value| value.as_ref())
        } else {
            word.strip_prefix("--color=")
        }
    });
    match value {
        Some("always") => ColorChoice::Always,
        Some("never") => ColorChoice::Never,
        _ => ColorChoice::Auto,
    }
}

fn use_color(choice: ColorChoice) -> bool {
    match choice {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        ColorChoice::Auto => {
            std::io::stderr().is_terminal()
                && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
        }
    }
}

/// Reports a defect in one line, with a backtrace only where RUST_BACKTRACE is set.
fn install_panic_hook() {
    let with_backtrace = std::env::var_os("RUST_BACKTRACE").is_some_and(|value| value != "0");
    std::panic::set_hook(Box::new(move |panic| {
        let message = crate::shown::line(panic.payload_as_str().unwrap_or("no message"));
        let place = panic
            .location()
            .map(|place| format!(" ({}:{})", place.file(), place.line()))
            .unwrap_or_default();
        write_stderr(&format!(
            "internal error: {message}{place}\n\n\
             hint: this is a defect of rig {}; please report it with the command line and this message (RUST_BACKTRACE=1 adds a backtrace)\n",
            env!("CARGO_PKG_VERSION")
        ));
        if with_backtrace {
            let backtrace = std::backtrace::Backtrace::force_capture();
            write_stderr(&format!("\n{backtrace}\n"));
        }
    }));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        definition().debug_assert();
    }

    #[test]
    fn color_is_known_before_parsing() {
        let of =
            |words: &[&str]| color_choice(&words.iter().map(OsString::from).collect::<Vec<_>>());
        assert_eq!(of(&["rig", "--color", "never"]), ColorChoice::Never);
        assert_eq!(of(&["rig", "--color=always", "x"]), ColorChoice::Always);
        assert_eq!(of(&["rig"]), ColorChoice::Auto);
    }
}
