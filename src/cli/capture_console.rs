//! `--console`: this process becomes the operator's console, and the same capture runs as
//! its child.

use std::ffi::{OsStr, OsString};

use super::console::{self, ListenArgs};
use super::context::Context;
use super::error::CliError;

/// The console around a capture.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Console")]
pub struct ConsoleOptions {
    /// Shows the capture in a browser, at the address that is printed first, and lets it be
    /// paused and stopped there; stays until Ctrl-C
    #[arg(long, conflicts_with = "events")]
    console: bool,
    #[command(flatten)]
    listen: Option<ListenArgs>,
}

impl ConsoleOptions {
    /// Whether `--console` is given.
    ///
    /// # Errors
    /// Options of its server without it.
    pub(super) fn is_wanted(&self) -> Result<bool, CliError> {
        if self.listen.is_some() && !self.console {
            let fact = "--listen, --port and --host-name are of the console";
            return Err(CliError::new(fact).hint("add --console, or leave them out"));
        }
        Ok(self.console)
    }

    /// Runs the capture of these arguments, less the program's name, below a console.
    pub(super) fn run(
        &self,
        arguments: impl IntoIterator<Item = OsString>,
        context: &Context,
    ) -> Result<(), CliError> {
        let listen = self.listen.clone().unwrap_or_default();
        console::run_with_capture(arguments_of_child(arguments), &listen, context)
    }

    /// Likewise for `rig demo`, which is a capture of so many lights on this simulated rig.
    pub(super) fn run_demo(
        &self,
        arguments: impl IntoIterator<Item = OsString>,
        rig: &str,
        lights: usize,
        context: &Context,
    ) -> Result<(), CliError> {
        self.run(capture_of_demo(arguments, rig, lights), context)
    }
}

/// The arguments of this process for the child: without `--console` and the options of its
/// server, with `--events`.
fn arguments_of_child(arguments: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    /// Options of the server, all of which take a value.
    const OF_THE_SERVER: [&str; 3] = ["--listen", "--port", "--host-name"];
    let mut kept = without(arguments, &OF_THE_SERVER);
    for argument in &mut kept {
        if argument == "--console" {
            *argument = "--events".into();
        }
    }
    kept
}

/// Arguments without these options, each of which takes a value.
fn without(arguments: impl IntoIterator<Item = OsString>, options: &[&str]) -> Vec<OsString> {
    let mut kept = Vec::new();
    let mut arguments = arguments.into_iter();
    while let Some(argument) = arguments.next() {
        let name = name_of(&argument);
        if !options.iter().any(|option| name == *option) {
            kept.push(argument);
        } else if name == argument {
            arguments.next();
        }
    }
    kept
}

fn capture_of_demo(
    arguments: impl IntoIterator<Item = OsString>,
    rig: &str,
    lights: usize,
) -> Vec<OsString> {
    let mut arguments = without(arguments, &["--bench"]);
    if let Some(at) = arguments.iter().position(|argument| argument == "demo") {
        let lights = lights.to_string();
        let capture = ["capture", "--rig", rig, "--lights", &lights];
        arguments.splice(at..=at, capture.map(OsString::from));
    }
    arguments
}

/// `--port` of `--port=80`.
fn name_of(argument: &OsStr) -> &OsStr {
    match argument.to_str().and_then(|text| text.split_once('=')) {
        Some((name, _)) if name.starts_with("--") => OsStr::new(name),
        _ => argument,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_child_gets_the_same_capture_without_the_console() {
        let of = |line: &str| {
            let given = line.split(' ').map(OsString::from);
            let arguments = arguments_of_child(capture_of_demo(given, "simulated", 4));
            let words: Vec<_> = arguments
                .iter()
                .map(|word| word.to_str().unwrap())
                .collect();
            words.join(" ")
        };
        for (given, expected) in [
            (
                "-q capture --console --lights 4 --port 8080 --sample a",
                "-q capture --events --lights 4 --sample a",
            ),
            (
                "capture --listen=0.0.0.0 --light -40,35 --host-name bench --console",
                "capture --light -40,35 --events",
            ),
            (
                "capture --console --out=--port --lights 2",
                "capture --events --out=--port --lights 2",
            ),
            (
                "--quiet demo --bench tilted --out demo --console --port=1",
                "--quiet capture --rig simulated --lights 4 --out demo --events",
            ),
        ] {
            assert_eq!(of(given), expected);
        }
    }
}
