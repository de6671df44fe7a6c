//! How the devices of a rig are opened from the command line.

use std::sync::Arc;

use super::error::{CliError, HintExt};
use super::operator;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::capture::open::{OpenError, OpenOptions, PortDriver, Stopped};
use crate::config::RigConfig;
use crate::config::stage::StageDriver;
use crate::device::DeviceError;
use crate::device::manual::Operator;

/// This program as the keeper of another one that it runs.
#[cfg(feature = "reports")]
pub fn keeper() -> Result<std::process::Command, CliError> {
    let mut command = std::process::Command::new(std::env::current_exe()?);
    command.arg("keeper");
    Ok(command)
}

/// This program as guardian and keeper, the terminal as operator of a manual stage.
pub fn options(rig: &RigConfig) -> Result<OpenOptions, CliError> {
    options_for(rig, || operator::of_capture(None))
}

/// Likewise with this operator.
pub fn options_for(
    rig: &RigConfig,
    operator: impl FnOnce() -> Result<Arc<dyn Operator>, CliError>,
) -> Result<OpenOptions, CliError> {
    let mut options = of_port()?;
    if matches!(rig.stage.driver, StageDriver::Manual(_)) {
        options.operator = Some(operator()?);
    }
    Ok(options)
}

/// For a device without a rig file.
pub fn of_port() -> Result<OpenOptions, CliError> {
    Ok(OpenOptions {
        rig_program: Some(std::env::current_exe()?),
        ..OpenOptions::default()
    })
}

/// What a stop has achieved, for a person; advice where it failed.
pub fn stopped(outcome: Result<Stopped, OpenError>) -> Result<&'static str, CliError> {
    let stopped = match outcome {
        Err(error @ OpenError::Device(DeviceError::Busy { .. })) => {
            return Err(error).hint(
                "stop the program that uses it with Ctrl-C, twice; or use the emergency stop",
            );
        }
        Err(
            error @ OpenError::Device(DeviceError::NoReply { .. } | DeviceError::NotApplied { .. }),
        ) => return Err(error).hint("use the emergency stop"),
        outcome => outcome?,
    };
    Ok(match stopped {
        Stopped::LightsUnconfirmed => {
            "all lights were sent the command to go off; DMX does not confirm whether they did"
        }
        Stopped::AxesAndLamp => "the axes stand and the lamp is off",
        Stopped::AxesOnly => "the axes stand; which outputs are a lamp is only known with --rig",
        Stopped::Restarted => "the controller has restarted with its outputs off",
        Stopped::ByHand => "nothing: a manual stage is stopped by hand",
    })
}

/// Reads the name of a driver that a port is opened with.
pub fn port_driver() -> impl TypedValueParser<Value = PortDriver> {
    PossibleValuesParser::new([
        PossibleValue::new("grbl").help("GRBL 1.1 or grblHAL"),
        PossibleValue::new("zaber").help("Zaber ASCII; axes 1 and 2 of device 1"),
    ])
    .map(|name| match name.as_str() {
        "zaber" => PortDriver::Zaber,
        _ => PortDriver::Grbl,
    })
}
