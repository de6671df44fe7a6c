//! `--rig`, for every command that works on a bench.

use std::path::Path;

use super::context::Context;
use super::error::CliError;
use crate::config::{Origin, ResolvedRig, Surroundings, resolve_rig};
use crate::device::discovery::usb_devices;

/// Which bench.
#[derive(clap::Args, Debug, Clone)]
pub struct RigArg {
    /// Rig file, or a name in rig-configs/ or built in; else RIG_CONFIG, else ./rig.toml,
    /// else the simulated rig
    #[arg(long, value_name = "RIG")]
    pub rig: Option<String>,
}

impl RigArg {
    /// The rig; a note on stderr where the simulated one stands in.
    pub fn resolve(&self, context: &Context) -> Result<ResolvedRig, CliError> {
        let rig = resolve_rig(self.rig.as_deref(), &Surroundings::of_process(), || {
            usb_devices(Path::new("/"))
        })?;
        if rig.origin == Origin::Fallback {
            context.note(
                "no rig is configured (--rig, RIG_CONFIG, ./rig.toml): using the simulated rig",
            );
        }
        Ok(rig)
    }
}
