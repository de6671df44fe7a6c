//! The devices of a rig, real or simulated, behind their traits.

use std::any::Any;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use crate::config::BuildError;
use crate::config::{CameraDriver, RigConfig};
use crate::device::described::Description;
use crate::device::guardian::GuardedStage;
use crate::device::manual::{Nobody, Operator};
use crate::device::simulated_camera::RadianceSource;
use crate::device::{Camera, CameraInfo, DeviceError, LightStage, Mosaic};
use crate::simulation::room::Room;
use crate::units::StageAngles;

/// What opening devices needs beyond the rig file.
#[derive(Clone, Default)]
pub struct OpenOptions {
    /// The program `rig`, which is started again as the guardian of a real stage (see
    /// [`crate::device::guardian`]) and as the keeper of a camera's program (see
    /// [`crate::device::command_camera`]). `None`: neither is started, so that a lamp stays
    /// on when this process is killed.
    pub rig_program: Option<PathBuf>,
    /// Who places and switches the light of a manual stage.
    pub operator: Option<Arc<dyn Operator>>,
    /// What a simulated camera sees; `None`: the rig's true scene.
    pub sees: Option<Arc<dyn RadianceSource>>,
    /// Lights of which a session holds frames, and whether all of them: a simulated lamp
    /// drifts from visit to visit.
    pub begun: Vec<(StageAngles, bool)>,
}

/// The stage and the camera of a rig.
pub struct Devices {
    /// The stage. It ends before its simulated firmware does.
    pub stage: Box<dyn LightStage>,
    /// The camera.
    pub camera: Box<dyn Camera>,
    pub(super) bench: SimulatedFirmware,
}

/// What must outlive the devices of a simulated rig; nothing for real ones.
pub(super) type SimulatedFirmware = Option<Box<dyn Any + Send>>;

/// A rig's stage alone.
pub struct Stage {
    /// The stage. It ends before its simulated firmware does.
    pub stage: Box<dyn LightStage>,
    bench: SimulatedFirmware,
    rig_program: Option<PathBuf>,
}

/// Which controller is on a port of which no rig file is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PortDriver {
    /// GRBL 1.1 or grblHAL.
    Grbl,
    /// Zaber ASCII; axes 1 and 2 of device 1.
    Zaber,
}

/// What stopping a stage has achieved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopped {
    /// All lights were switched off over a line that confirms nothing.
    LightsUnconfirmed,
    /// The axes stand and the lamp is off.
    AxesAndLamp,
    /// The axes stand; which outputs are a lamp is not known.
    AxesOnly,
    /// The controller has restarted with its outputs off.
    Restarted,
    /// Nothing: the stage is moved by hand.
    ByHand,
}

/// Why a device was not opened.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum OpenError {
    /// The device itself.
    #[error("{0}")]
    Device(#[from] DeviceError),
    /// The true scene of a simulated rig.
    #[error("{0}")]
    Scene(#[from] BuildError),
    /// Only a real device can do this.
    #[error("the rig's {what} is simulated")]
    Simulated {
        /// `stage` or `camera`.
        what: &'static str,
    },
    #[error("the stage is manual, and no operator is given")]
    NoOperator,
    #[error("{device}: the format's colour filters are {is}, the rig file's {stated}")]
    Mosaic {
        device: String,
        is: Mosaic,
        stated: Mosaic,
    },
    /// The feature `serial` is off.
    #[error("this program was built without serial ports, on which all stages are")]
    NoSerial,
    /// The feature `v4l` is off.
    #[error("this program was built without Video4Linux")]
    NoVideo4Linux,
}

impl Devices {
    /// Devices of one's own, e.g. with a driver that is not among those of rig files.
    pub fn new(stage: Box<dyn LightStage>, camera: Box<dyn Camera>) -> Self {
        Self {
            stage,
            camera,
            bench: None,
        }
    }
}

impl Stage {
    /// The same with a guardian, before it is moved or lit. A simulated stage ends with
    /// this process and has none.
    ///
    /// # Errors
    /// The guardian cannot be started.
    pub fn guarded(mut self) -> Result<Self, OpenError> {
        if self.bench.is_none() {
            self.stage = guarded(self.stage, self.rig_program.as_deref())?;
        }
        Ok(self)
    }
}

/// The stage with a guardian next to it: this program once more.
fn guarded(
    stage: Box<dyn LightStage>,
    rig_program: Option<&Path>,
) -> Result<Box<dyn LightStage>, DeviceError> {
    let Some(program) = rig_program else {
        return Ok(stage);
    };
    GuardedStage::guard(stage, |port| {
        let mut command = Command::new(program);
        command.args(["guardian", "--port", port]);
        command
    })
}

/// Opens both devices; a real stage with its guardian.
///
/// # Errors
/// A device that cannot be opened or is not what the rig file says.
pub fn open_devices(rig: &RigConfig, options: &OpenOptions) -> Result<Devices, OpenError> {
    if rig.is_simulated() {
        return stages::open_simulated(rig, options);
    }
    let stage = guarded(
        stages::open_real(rig, options)?,
        options.rig_program.as_deref(),
    )?;
    let camera = open_real_camera(rig, options)?;
    Ok(Devices {
        camera: crate::device::guardian::guarded_camera(camera, stage.watchdog()),
        stage,
        bench: None,
    })
}

/// Opens the stage alone, without a guardian.
///
/// # Errors
/// As [`open_devices`].
pub fn open_stage(rig: &RigConfig, options: &OpenOptions) -> Result<Stage, OpenError> {
    let rig_program = options.rig_program.clone();
    let (stage, bench) = match rig.is_simulated() {
        true => stages::open_simulated_stage(rig, options)?,
        false => (stages::open_real(rig, options)?, None),
    };
    Ok(Stage {
        stage,
        bench,
        rig_program,
    })
}

/// Opens the controller on a port, without a guardian.
///
/// # Errors
/// Another device is there, or none.
pub fn open_port(
    driver: PortDriver,
    port: &str,
    baud: u32,
    options: &OpenOptions,
) -> Result<Stage, OpenError> {
    Ok(Stage {
        stage: stages::open_on_port(driver, port, baud)?,
        bench: None,
        rig_program: options.rig_program.clone(),
    })
}

pub use stages::{stop_port, stop_stage};

#[cfg(feature = "serial")]
mod stages {
    use super::*;
    use crate::config::stage::StageDriver;
    use crate::device::dome::{self, DomeStage};
    use crate::device::grbl::{self, GrblConfig, GrblStage};
    use crate::device::manual::ManualStage;
    use crate::device::simulated::SimulatedBench;
    use crate::device::simulated_hand;
    use crate::device::zaber::{self, ZaberConfig, ZaberStage};

    fn bench(rig: &RigConfig) -> Result<SimulatedBench, OpenError> {
        let config = rig
            .simulated_bench()
            .ok_or(OpenError::Simulated { what: "stage" })?;
        Ok(SimulatedBench::start(config)?)
    }

    pub(super) fn open_simulated(
        rig: &RigConfig,
        options: &OpenOptions,
    ) -> Result<Devices, OpenError> {
        let bench = bench(rig)?;
        bench.count_visits(&options.begun);
        let stage = stage_of(&bench, rig, options)?;
        let source: Arc<dyn RadianceSource> = match &options.sees {
            Some(source) => Arc::clone(source),
            None => rig
                .truth()?
                .ok_or(OpenError::Simulated { what: "camera" })?,
        };
        Ok(Devices {
            stage,
            camera: Box::new(bench.open_camera(source)),
            bench: Some(Box::new(bench)),
        })
    }

    pub(super) fn open_simulated_stage(
        rig: &RigConfig,
        options: &OpenOptions,
    ) -> Result<(Box<dyn LightStage>, SimulatedFirmware), OpenError> {
        let bench = bench(rig)?;
        Ok((stage_of(&bench, rig, options)?, Some(Box::new(bench))))
    }

    /// The stage of a simulated bench: its firmware's, or a person's.
    fn stage_of(
        bench: &SimulatedBench,
        rig: &RigConfig,
        options: &OpenOptions,
    ) -> Result<Box<dyn LightStage>, OpenError> {
        Ok(match &rig.stage.driver {
            StageDriver::Manual(config) => {
                let operator = options.operator.clone().ok_or(OpenError::NoOperator)?;
                Box::new(simulated_hand::open(bench, config.clone(), operator)?)
            }
            _ => Box::new(bench.open_stage()?),
        })
    }

    /// The drivers of stages.
    pub(super) fn open_real(
        rig: &RigConfig,
        options: &OpenOptions,
    ) -> Result<Box<dyn LightStage>, OpenError> {
        Ok(match &rig.stage.driver {
            StageDriver::Simulated(_) => return Err(OpenError::Simulated { what: "stage" }),
            StageDriver::Grbl(config) => Box::new(GrblStage::open(config.clone())?),
            StageDriver::Zaber(config) => Box::new(ZaberStage::open(config.clone())?),
            StageDriver::Dome(config) => Box::new(DomeStage::open(config.clone())?),
            StageDriver::Manual(config) => {
                let operator = options.operator.clone().ok_or(OpenError::NoOperator)?;
                Box::new(ManualStage::new(config.clone(), operator))
            }
        })
    }

    pub(super) fn open_on_port(
        driver: PortDriver,
        port: &str,
        baud: u32,
    ) -> Result<Box<dyn LightStage>, OpenError> {
        Ok(match driver {
            PortDriver::Grbl => Box::new(GrblStage::open(GrblConfig::of_port(port, baud))?),
            PortDriver::Zaber => Box::new(ZaberStage::open(ZaberConfig::of_port(port, baud))?),
        })
    }

    /// Stops the stage of a rig, without a query before.
    ///
    /// # Errors
    /// It did not confirm that it stopped.
    pub fn stop_stage(rig: &RigConfig) -> Result<Stopped, OpenError> {
        match &rig.stage.driver {
            StageDriver::Simulated(_) => Err(OpenError::Simulated { what: "stage" }),
            StageDriver::Grbl(config) => stop_port(PortDriver::Grbl, &config.port, config.baud),
            StageDriver::Manual(_) => Ok(Stopped::ByHand),
            StageDriver::Dome(config) => {
                dome::stop_port(config)?;
                Ok(Stopped::LightsUnconfirmed)
            }
            StageDriver::Zaber(config) => {
                zaber::stop_port(config)?;
                Ok(Stopped::AxesAndLamp)
            }
        }
    }

    /// Stops the controller on a port, without a query before.
    ///
    /// # Errors
    /// As [`stop_stage`].
    pub fn stop_port(driver: PortDriver, port: &str, baud: u32) -> Result<Stopped, OpenError> {
        match driver {
            PortDriver::Grbl => {
                let timeout = GrblConfig::of_port(port, baud).connect_timeout;
                grbl::stop_port(port, baud, timeout.to_duration())?;
                Ok(Stopped::Restarted)
            }
            PortDriver::Zaber => {
                zaber::stop_port(&ZaberConfig::of_port(port, baud))?;
                Ok(Stopped::AxesOnly)
            }
        }
    }
}

#[cfg(not(feature = "serial"))]
mod stages {
    use super::*;

    pub(super) fn open_simulated(_: &RigConfig, _: &OpenOptions) -> Result<Devices, OpenError> {
        Err(OpenError::NoSerial)
    }

    pub(super) fn open_simulated_stage(
        _: &RigConfig,
        _: &OpenOptions,
    ) -> Result<(Box<dyn LightStage>, SimulatedFirmware), OpenError> {
        Err(OpenError::NoSerial)
    }

    /// A manual stage needs no port, but all others do.
    pub(super) fn open_real(
        _: &RigConfig,
        _: &OpenOptions,
    ) -> Result<Box<dyn LightStage>, OpenError> {
        Err(OpenError::NoSerial)
    }

    pub(super) fn open_on_port(
        _: PortDriver,
        _: &str,
        _: u32,
    ) -> Result<Box<dyn LightStage>, OpenError> {
        Err(OpenError::NoSerial)
    }

    /// Fails: there are no stages.
    pub fn stop_stage(_: &RigConfig) -> Result<Stopped, OpenError> {
        Err(OpenError::NoSerial)
    }

    /// Fails: there are no stages.
    pub fn stop_port(_: PortDriver, _: &str, _: u32) -> Result<Stopped, OpenError> {
        Err(OpenError::NoSerial)
    }
}

/// Opens the camera of a rig whose devices are real, to measure with it.
///
/// # Errors
/// As [`open_devices`]; also where its exposure cannot be set.
pub fn open_real_camera(
    rig: &RigConfig,
    options: &OpenOptions,
) -> Result<Box<dyn Camera>, OpenError> {
    let camera = open_camera(rig, options)?;
    match camera.info().exposure_range[0].0.is_nan() {
        false => Ok(camera),
        true => Err(OpenError::Device(DeviceError::Refused {
            device: camera.info().model.clone(),
            command: "a measurement".to_owned(),
            reason: "the camera has no control for its exposure".to_owned(),
        })),
    }
}

/// Opens the camera of a rig to look through it; exposures of one without a control for them are
/// NaN. A simulated one sees the room's light alone, as while nobody uses its stage.
///
/// # Errors
/// As [`open_devices`].
pub fn open_camera_for_a_look(
    rig: &RigConfig,
    options: &OpenOptions,
) -> Result<Box<dyn Camera>, OpenError> {
    let Some(simulation) = &rig.simulation else {
        return open_camera(rig, options);
    };
    let room = Room {
        resolution_px: rig.camera.resolution_px,
        radiance_w_m2_sr: simulation.ambient_w_m2_sr as f32,
    };
    let options = OpenOptions {
        sees: Some(Arc::new(room)),
        operator: Some(Arc::new(Nobody)),
        ..OpenOptions::default()
    };
    Ok(open_devices(rig, &options)?.camera)
}

fn open_camera(rig: &RigConfig, options: &OpenOptions) -> Result<Box<dyn Camera>, OpenError> {
    let camera = &rig.camera;
    match &camera.driver {
        CameraDriver::Simulated => Err(OpenError::Simulated { what: "camera" }),
        CameraDriver::V4l { device, format } => open_v4l(rig, device, *format),
        CameraDriver::Described { driver, setting } => {
            let keeper = options.rig_program.as_ref().map(|program| {
                let mut command = Command::new(program);
                command.arg("keeper");
                command
            });
            let info = CameraInfo {
                driver: driver.name.to_owned(),
                model: String::new(),
                serial: camera.serial.clone().unwrap_or_default(),
                resolution_px: camera.resolution_px,
                bit_depth: camera.bit_depth,
                mosaic: camera.mosaic,
                exposure_range: camera.exposure_range,
                exposure_step: camera.exposure_step,
            };
            let timeout = camera.frame_timeout;
            let description = Description {
                info,
                timeout,
                keeper,
            };
            Ok((driver.open)(setting, description)?)
        }
    }
}

#[cfg(feature = "v4l")]
fn open_v4l(
    rig: &RigConfig,
    device: &str,
    format: Option<[u8; 4]>,
) -> Result<Box<dyn Camera>, OpenError> {
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
    let (is, stated) = (camera.info().mosaic, rig.camera.mosaic);
    if is != stated {
        let device = device.to_owned();
        return Err(OpenError::Mosaic { device, is, stated });
    }
    Ok(Box::new(camera))
}

#[cfg(not(feature = "v4l"))]
fn open_v4l(_: &RigConfig, _: &str, _: Option<[u8; 4]>) -> Result<Box<dyn Camera>, OpenError> {
    Err(OpenError::NoVideo4Linux)
}
