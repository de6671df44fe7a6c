//! `rig guardian`, hidden: the process that [`guardian`](crate::device::guardian)
//! describes. Its standard input is the socket, its standard output the port.

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP};

use super::context::Context;
use super::error::CliError;
use super::output::write_stderr;
use crate::device::guardian::{Exchange, Watch, stand_guard};

/// Stops a stage when the process that started this one is gone or gives no sign of life
#[derive(clap::Args, Debug)]
#[command(hide = true)]
pub struct GuardianArgs {
    /// What the port is called
    #[arg(long, value_name = "NAME")]
    port: String,
    /// What is sent and expected, in hexadecimal; may be repeated
    #[arg(long, value_name = "BYTES=ANSWER,…")]
    exchange: Vec<Exchange>,
    /// The stage does not report whether its lamp is lit
    #[arg(long)]
    unverified: bool,
}

/// `rig guardian`.
pub fn run(args: &GuardianArgs, context: &Context) -> Result<(), CliError> {
    outlive_signals()?;
    let port = std::io::stdout().as_fd().try_clone_to_owned()?;
    let link = std::io::stdin().as_fd().try_clone_to_owned()?;
    let name = &args.port;
    let done = if args.unverified {
        "has sent it the command to turn off, which this stage does not confirm"
    } else {
        "has turned it off and ended all motion"
    };
    let say = |what: &str, stopped: std::io::Result<()>| match stopped {
        Ok(()) => {
            context.warn(format!("{name}: {what}; its guardian {done}"));
            Ok(())
        }
        Err(error) => Err(CliError::new(format!(
            "{name}: {what}, and the stage did not confirm that it stopped: {error}"
        ))
        .hint("use the emergency stop")),
    };
    let mut relieved = |stopped| {
        let what = "rig gave no sign of life for longer than it had announced, with the lamp lit or the stage moving";
        if let Err(error) = say(what, stopped) {
            write_stderr(&error.render(context.color));
        }
    };
    match stand_guard(link.into(), port, &args.exchange, &mut relieved) {
        Watch::Dismissed | Watch::Relieved => Ok(()),
        Watch::Acted(stopped) => say("rig ended without turning the lamp off", stopped),
    }
}

/// A process that calls this ends when the one that started it does, not when the
/// terminal or an init system asks both to end.
pub(super) fn outlive_signals() -> std::io::Result<()> {
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGTSTP] {
        signal_hook::flag::register(signal, Arc::new(AtomicBool::new(false)))?;
    }
    Ok(())
}
