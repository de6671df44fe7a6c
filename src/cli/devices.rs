//! `rig devices`: what is connected, and whether it may be used.

use std::path::Path;

use super::output::write_json;
use super::{CliError, Context};
use crate::device::discovery::{DeviceKind, FoundDevice, find_devices};
use crate::out;

/// Lists cameras and serial ports, also those without permission, and why
///
/// Nothing is opened: opening a port resets many controllers.
#[derive(clap::Args, Debug)]
pub struct DevicesArgs {
    /// The list as JSON
    #[arg(long)]
    json: bool,
}

/// `rig devices`.
pub fn run(args: &DevicesArgs, context: &Context) -> Result<(), CliError> {
    let found = find_devices(Path::new("/"));
    if args.json {
        return write_json(&found);
    }
    if found.is_empty() {
        context.note("no camera and no USB serial port is connected");
    }
    found.iter().try_for_each(print)
}

fn print(device: &FoundDevice) -> Result<(), CliError> {
    let kind = match device.kind {
        DeviceKind::Camera => "camera",
        DeviceKind::Serial => "serial",
    };
    let mut line = format!("{kind}  {}", device.path.display());
    if device.path != device.node {
        line += &format!(" -> {}", device.node.display());
    }
    if !device.model.is_empty() {
        line += &format!("  {}", device.model);
    }
    if !device.serial.is_empty() {
        line += &format!("  serial number {}", device.serial);
    }
    out!("{line}")?;
    match &device.problem {
        Some(problem) => out!("        cannot be opened: {problem}"),
        None => Ok(()),
    }
}
