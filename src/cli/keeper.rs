//! `rig keeper`, hidden: the process that ends a camera's program and removes its
//! files when the process that started both is gone. Its standard input is a pipe
//! that the system closes then.

use std::path::PathBuf;

use super::context::Context;
use super::error::CliError;
use super::guardian;
use crate::device::command_camera::keep;

/// Ends a camera's program when the process that started this one is gone
#[derive(clap::Args, Debug)]
#[command(hide = true)]
pub struct KeeperArgs {
    /// The program's files
    folder: PathBuf,
}

/// `rig keeper`.
pub fn run(args: &KeeperArgs, _: &Context) -> Result<(), CliError> {
    guardian::outlive_signals()?;
    Ok(keep(std::io::stdin().lock(), &args.folder)?)
}
