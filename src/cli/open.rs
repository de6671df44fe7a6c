//! The devices of a rig, real or simulated, behind the traits.

use std::sync::Arc;

use mock_devices::RadianceSource;

use super::CliError;
use crate::config::{CameraDriver, RigConfig};
use crate::device::command_camera::{CommandCamera, CommandConfig};
use crate::device::folder_camera::{FolderCamera, FolderConfig};
use crate::device::{Camera, CameraInfo, LightStage};
use crate::units::{Seconds, StageAngles};

/// The stage and the camera of a rig.
pub struct Devices {
    /// The stage. It ends before its simulated firmware does.
    pub stage: Box<dyn LightStage>,
    /// The camera.
    pub camera: Box<dyn Camera>,
    _bench: Option<Box<dyn std::any::Any + Send>>,
}

/// A rig's stage alone.
pub struct Stage {
    /// The stage. It ends before its simulated firmware does.
    pub stage: Box<dyn LightStage>,
    bench: Option<Box<dyn std::any::Any + Send>>,
}

impl Stage {
    /// The same with a guardian, before it is moved or lit; a simulated stage
    /// ends with this process and has none.
    pub fn guarded(self) -> Result<Self, CliError> {
        if self.bench.is_some() {
            return Ok(self);
        }
        Ok(Self {
            stage: super::guardian::guarded(self.stage)?,
            bench: None,
        })
    }
}

/// What speaks on a port of which no rig file is given.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum PortDriver {
    /// GRBL 1.1 or grblHAL
    Grbl,
    /// Zaber ASCII; axes 1 and 2 of device 1
    Zaber,
}

#[cfg(feature = "serial")]
pub use with_serial::{open_devices, open_port, open_stage, stop_port, stop_stage};
#[cfg(not(feature = "serial"))]
pub use without_serial::{open_devices, open_port, open_stage, stop_port, stop_stage};

#[cfg(feature = "serial")]
mod with_serial {
    use super::*;
    use crate::cli::guardian::guarded;
    use crate::cli::operator::Terminal;
    use crate::config::stage::StageDriver;
    use crate::device::DeviceError;
    use crate::device::dome::{self, DomeStage, DomeWiring};
    use crate::device::grbl::{self, GrblConfig, GrblStage};
    use crate::device::guardian::guarded_camera;
    use crate::device::manual::ManualStage;
    use crate::device::simulated::SimulatedBench;
    use crate::device::zaber::{self, ZaberConfig, ZaberStage};

    /// Opens both devices. `source` is asked only for a simulated rig: what its
    /// camera sees. `begun` are the lights that a session holds frames of, and whether
    /// all of them: a simulated stage must know.
    pub fn open_devices(
        rig: &RigConfig,
        begun: &[(StageAngles, bool)],
        source: impl FnOnce() -> Result<Arc<dyn RadianceSource>, CliError>,
    ) -> Result<Devices, CliError> {
        match rig.simulated_bench() {
            Some(config) => {
                let bench = SimulatedBench::start(config)?;
                bench.count_visits(begun);
                Ok(Devices {
                    stage: Box::new(bench.open_stage()?),
                    camera: Box::new(bench.open_camera(source()?)),
                    _bench: Some(Box::new(bench)),
                })
            }
            None => {
                let stage = guarded(open_real_stage(rig)?)?;
                let camera = super::open_real_camera(rig)?;
                Ok(Devices {
                    camera: guarded_camera(camera, stage.watchdog()),
                    stage,
                    _bench: None,
                })
            }
        }
    }

    /// Opens the stage alone.
    pub fn open_stage(rig: &RigConfig) -> Result<Stage, CliError> {
        match rig.simulated_bench() {
            Some(config) => {
                let bench = SimulatedBench::start(config)?;
                Ok(Stage {
                    stage: Box::new(bench.open_stage()?),
                    bench: Some(Box::new(bench)),
                })
            }
            None => Ok(Stage {
                stage: open_real_stage(rig)?,
                bench: None,
            }),
        }
    }

    fn open_real_stage(rig: &RigConfig) -> Result<Box<dyn LightStage>, CliError> {
        match &rig.stage.driver {
            StageDriver::Simulated(_) => Err(CliError::new("the rig's stage is simulated")),
            StageDriver::Grbl(config) => Ok(Box::new(GrblStage::open(config.clone())?)),
            StageDriver::Zaber(config) => Ok(Box::new(ZaberStage::open(config.clone())?)),
            StageDriver::Dome(config) => Ok(Box::new(DomeStage::open(config.clone())?)),
            StageDriver::Manual(config) => {
                let operator = Arc::new(Terminal::new()?);
                Ok(Box::new(ManualStage::new(config.clone(), operator)))
            }
        }
    }

    /// Opens whatever controller of this kind is on a port.
    pub fn open_port(driver: PortDriver, port: &str, baud: u32) -> Result<Stage, CliError> {
        let stage: Box<dyn LightStage> = match driver {
            PortDriver::Grbl => Box::new(GrblStage::open(GrblConfig::of_port(port, baud))?),
            PortDriver::Zaber => Box::new(ZaberStage::open(ZaberConfig::of_port(port, baud))?),
        };
        Ok(Stage { stage, bench: None })
    }

    /// Stops the stage of a rig, without asking it anything first; what that means.
    pub fn stop_stage(rig: &RigConfig) -> Result<&'static str, CliError> {
        match &rig.stage.driver {
            StageDriver::Simulated(_) => Err(CliError::new("the rig's stage is simulated")),
            StageDriver::Grbl(config) => stop_port(PortDriver::Grbl, &config.port, config.baud),
            StageDriver::Manual(_) => Ok("nothing: a manual stage is stopped by hand"),
            StageDriver::Dome(config) => {
                stopped(dome::stop_port(config))?;
                Ok(match config.wiring {
                    DomeWiring::Line => "all lights are off",
                    DomeWiring::Dmx { .. } => {
                        "all lights were told to go off; DMX does not say whether they did"
                    }
                })
            }
            StageDriver::Zaber(config) => {
                stopped(zaber::stop_port(config))?;
                Ok("the axes stand and the lamp is off")
            }
        }
    }

    /// Stops the controller on a port, without asking it anything first.
    pub fn stop_port(driver: PortDriver, port: &str, baud: u32) -> Result<&'static str, CliError> {
        match driver {
            PortDriver::Grbl => {
                let timeout = GrblConfig::of_port(port, baud).connect_timeout;
                stopped(grbl::stop_port(port, baud, timeout.to_duration()))?;
                Ok("the controller has restarted with its outputs off")
            }
            PortDriver::Zaber => {
                stopped(zaber::stop_port(&ZaberConfig::of_port(port, baud)))?;
                Ok("the axes stand; which outputs are a lamp is only known with --rig")
            }
        }
    }

    fn stopped(outcome: Result<(), DeviceError>) -> Result<(), CliError> {
        match outcome {
            Err(error @ DeviceError::Busy { .. }) => Err(CliError::from(error).hint(
                "stop the program that uses it with Ctrl-C, twice; or use the emergency stop",
            )),
            Err(error @ (DeviceError::NoReply { .. } | DeviceError::NotApplied { .. })) => {
                Err(CliError::from(error).hint("use the emergency stop"))
            }
            outcome => Ok(outcome?),
        }
    }
}

#[cfg(not(feature = "serial"))]
mod without_serial {
    use super::*;

    fn without() -> CliError {
        CliError::new("this program was built without serial ports, on which all stages are")
            .hint("build it with the feature `serial`")
    }

    /// Fails: there are no stages.
    pub fn open_devices(
        _: &RigConfig,
        _: &[(StageAngles, bool)],
        _: impl FnOnce() -> Result<Arc<dyn RadianceSource>, CliError>,
    ) -> Result<Devices, CliError> {
        Err(without())
    }

    /// Fails: there are no stages.
    pub fn open_stage(_: &RigConfig) -> Result<Stage, CliError> {
        Err(without())
    }

    /// Fails: there are no stages.
    pub fn open_port(_: PortDriver, _: &str, _: u32) -> Result<Stage, CliError> {
        Err(without())
    }

    /// Fails: there are no stages.
    pub fn stop_stage(_: &RigConfig) -> Result<&'static str, CliError> {
        Err(without())
    }

    /// Fails: there are no stages.
    pub fn stop_port(_: PortDriver, _: &str, _: u32) -> Result<&'static str, CliError> {
        Err(without())
    }
}

/// The camera of a rig whose devices are real.
pub fn open_real_camera(rig: &RigConfig) -> Result<Box<dyn Camera>, CliError> {
    let timeout = rig.camera.frame_timeout;
    match &rig.camera.driver {
        CameraDriver::Simulated => Err(CliError::new("the rig's camera is simulated")),
        CameraDriver::V4l { device, format } => open_v4l(rig, device, *format),
        CameraDriver::Command(command) => {
            let config = CommandConfig {
                info: described(rig, "command", command.first().map_or("", String::as_str)),
                command: command.clone(),
                timeout,
            };
            let keeper = super::keeper::command()?;
            Ok(Box::new(CommandCamera::new(config, Some(keeper))?))
        }
        CameraDriver::Folder(folder) => Ok(Box::new(FolderCamera::new(FolderConfig {
            info: described(rig, "folder", &folder.display().to_string()),
            folder: folder.clone(),
            timeout,
            stable: FILE_IS_STABLE,
        })?)),
    }
}

/// A file that has not changed for so long is read.
const FILE_IS_STABLE: Seconds = Seconds(0.5);

/// A camera that cannot be asked, as the rig file describes it.
fn described(rig: &RigConfig, driver: &str, model: &str) -> CameraInfo {
    let camera = &rig.camera;
    CameraInfo {
        driver: driver.to_owned(),
        model: model.to_owned(),
        serial: camera.serial.clone().unwrap_or_default(),
        resolution_px: camera.resolution_px,
        bit_depth: camera.bit_depth,
        mosaic: camera.mosaic,
        exposure_range: camera.exposure_range,
        exposure_step: camera.exposure_step,
    }
}

#[cfg(feature = "v4l")]
fn open_v4l(
    rig: &RigConfig,
    device: &str,
    format: Option<[u8; 4]>,
) -> Result<Box<dyn Camera>, CliError> {
    use crate::device::v4l::{V4lCamera, V4lConfig};

    let camera = V4lCamera::open(V4lConfig {
        serial: rig.camera.serial.clone(),
        format,
        bit_depth: Some(rig.camera.bit_depth),
        resolution_px: Some(rig.camera.resolution_px),
        frame_timeout: rig.camera.frame_timeout,
        return_timeout: rig.camera.return_timeout,
        controls: rig.camera.controls.clone(),
        temperature: rig.camera.temperature.clone(),
        ..V4lConfig::of_device(device)
    })?;
    let is = camera.info().mosaic;
    if is != rig.camera.mosaic {
        let wanted = rig.camera.mosaic;
        return Err(CliError::new(format!(
            "{device}: the format's colour filters are {is:?}, the rig file's {wanted:?}"
        ))
        .hint("correct camera.mosaic or camera.format in the rig file"));
    }
    Ok(Box::new(camera))
}

/// Fails: there is no Video4Linux.
#[cfg(not(feature = "v4l"))]
fn open_v4l(_: &RigConfig, _: &str, _: Option<[u8; 4]>) -> Result<Box<dyn Camera>, CliError> {
    Err(CliError::new("this program was built without Video4Linux")
        .hint("build it with the feature `v4l`"))
}
