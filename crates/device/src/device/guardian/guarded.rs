//! A stage and a camera whose every call is a step that the guardian knows of.

use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use super::{DEADLINE, PortStop, Watchdog};
use crate::device::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, LampState, LightStage, RawFrame,
    ReferenceCheck, StageActivity, StageInfo, StageStatus, StageStep, Stated, StopHandle,
};
use crate::units::{Seconds, StageAngles};

/// A guardian that has been dismissed takes no longer.
const END: Duration = Duration::from_secs(2 * DEADLINE.as_secs() + 2);
/// A stop from another thread takes no longer.
const STOP: Duration = Duration::from_secs(20);
/// Settings are sent to a camera, or it is sought again, in this time.
const CAMERA: Duration = Duration::from_secs(20);

/// A stage whose guardian lives as long as it does. When it is dropped and the
/// stage does not report that its lamp is off and that it stands, the guardian
/// stops it.
pub struct GuardedStage {
    /// Always there until the drop.
    stage: Option<Box<dyn LightStage>>,
    info: StageInfo,
    watchdog: Watchdog,
    /// A motion has begun that did not come to its end.
    may_go_on: bool,
    /// Whether the last command about the lamp turned it off.
    told_off: bool,
    /// The lamp was lit and not turned off since, as far as this process knows.
    is_lit: bool,
    /// The last step had no answer that could be read.
    is_mute: bool,
}

impl GuardedStage {
    /// Starts a guardian for the stage, where it has a port to stop it by.
    /// `command` gives the program and all its arguments but the exchanges, which
    /// are added, each after `--exchange`, and `--unverified` where the lamp is not
    /// reported. It shall call [`stand_guard`](super::stand_guard) with its standard
    /// input and output, which are the socket and the port.
    pub fn guard(
        stage: Box<dyn LightStage>,
        command: impl FnOnce(&str) -> Command,
    ) -> Result<Box<dyn LightStage>, DeviceError> {
        let Some(stop) = stage.port_stop()? else {
            return Ok(stage);
        };
        let mut command = command(&stop.name);
        for exchange in &stop.exchanges {
            command.arg("--exchange").arg(exchange.to_string());
        }
        if !stop.reports_lamp {
            command.arg("--unverified");
        }
        let (name, gate) = (stop.name.clone(), stop.gate.clone());
        let handle = stage.stop_handle()?;
        let watchdog = spawn(command, stop)
            .and_then(|(link, child)| Watchdog::start(name.clone(), link, child, handle))
            .map_err(|source| DeviceError::Io {
                device: format!("the guardian of {name}"),
                source,
            })?;
        gate.keep(watchdog.clone());
        Ok(Box::new(Self {
            info: stage.info().clone(),
            stage: Some(stage),
            watchdog,
            may_go_on: false,
            told_off: false,
            is_lit: false,
            is_mute: false,
        }))
    }

    /// One step; one that moves the stage or switches the lamp is a risk until it
    /// has succeeded, and a lamp that is lit is one.
    fn step<T>(
        &mut self,
        step: StageStep,
        act: impl FnOnce(&mut dyn LightStage) -> Result<T, DeviceError>,
    ) -> Result<T, DeviceError> {
        self.watchdog.check()?;
        let stage = self
            .stage
            .as_deref_mut()
            .expect("it is there until the drop");
        if step != StageStep::Query {
            self.watchdog.set_at_risk(true);
        }
        let under_way = self.watchdog.step(stage.longest(step));
        let result = act(stage);
        drop(under_way);
        self.is_mute = result.as_ref().is_err_and(DeviceError::is_without_answer);
        // Whatever the driver met, this is why.
        self.watchdog.check()?;
        result
    }

    /// After a step that has succeeded.
    fn stands(&self) {
        self.watchdog.set_at_risk(self.is_lit);
    }

    fn is_safe(&self, status: &StageStatus) -> bool {
        let is_off = match status.lamp {
            Some(lamp) => lamp == LampState::Off,
            None => self.told_off,
        };
        let stands = match status.activity {
            StageActivity::Idle | StageActivity::Alarm => true,
            // What is held goes on where somebody lets it.
            StageActivity::Held => !self.may_go_on,
            StageActivity::Moving | StageActivity::Homing => false,
        };
        stands && is_off
    }

    /// Its state at the end. A lamp that the stage reports nothing of is turned off first:
    /// who lit it, and whether, is not known.
    fn last_status(&mut self) -> Result<StageStatus, DeviceError> {
        let status = self.status()?;
        if status.lamp.is_none() && !self.told_off {
            self.set_lamp(LampState::Off)?;
            return self.status();
        }
        Ok(status)
    }
}

/// Whether a motion may still be under way: not where it was refused.
fn may_go_on<T>(moved: &Result<T, DeviceError>) -> bool {
    !matches!(
        moved,
        Ok(_)
            | Err(DeviceError::Firmware { .. }
                | DeviceError::NotHomed { .. }
                | DeviceError::OutOfReach { .. })
    )
}

/// The guardian, and this end of the socket between it and this process.
fn spawn(mut command: Command, stop: PortStop) -> std::io::Result<(UnixStream, Child)> {
    let (link, its_link) = UnixStream::pair()?;
    let child = command
        .stdin(Stdio::from(OwnedFd::from(its_link)))
        .stdout(Stdio::from(stop.port))
        // Ctrl-C and a closed terminal are meant for this process alone.
        .process_group(0)
        .current_dir("/")
        .spawn()?;
    Ok((link, child))
}

impl Drop for GuardedStage {
    fn drop(&mut self) {
        // One that is mute is left to its guardian at once.
        let status = (!self.is_mute).then(|| self.last_status());
        let is_safe = !std::thread::panicking()
            && status.is_some_and(|status| status.is_ok_and(|status| self.is_safe(&status)));
        self.stage = None;
        self.watchdog.end(is_safe, END);
    }
}

impl LightStage for GuardedStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn home(&mut self) -> Result<StageStatus, DeviceError> {
        self.told_off = false;
        let homed = self.step(StageStep::Home, |stage| stage.home());
        self.may_go_on = may_go_on(&homed);
        let status = homed?;
        self.told_off = true;
        self.stands();
        Ok(status)
    }

    fn move_to(&mut self, target: StageAngles) -> Result<StageAngles, DeviceError> {
        let moved = self.step(StageStep::Move, |stage| stage.move_to(target));
        self.may_go_on = may_go_on(&moved);
        let reached = moved?;
        self.stands();
        Ok(reached)
    }

    fn set_lamp(&mut self, lamp: LampState) -> Result<LampState, DeviceError> {
        self.told_off = false;
        self.is_lit |= lamp != LampState::Off;
        let applied = self.step(StageStep::Lamp, |stage| stage.set_lamp(lamp))?;
        self.told_off = applied == LampState::Off;
        self.is_lit = !self.told_off;
        self.stands();
        Ok(applied)
    }

    fn status(&mut self) -> Result<StageStatus, DeviceError> {
        self.step(StageStep::Query, |stage| stage.status())
    }

    fn reports_lamp(&self) -> bool {
        self.stage
            .as_deref()
            .is_some_and(|stage| stage.reports_lamp())
    }

    fn temperature_c(&mut self) -> Option<f64> {
        let read = self.step(StageStep::Query, |stage| Ok(stage.temperature_c()));
        read.ok().flatten()
    }

    fn check_reference(&mut self) -> Result<Option<ReferenceCheck>, DeviceError> {
        let found = self.step(StageStep::Home, |stage| stage.check_reference())?;
        self.stands();
        Ok(found)
    }

    fn longest(&self, step: StageStep) -> Duration {
        self.stage
            .as_deref()
            .map_or(Duration::ZERO, |stage| stage.longest(step))
    }

    fn stop_handle(&self) -> Result<Box<dyn StopHandle>, DeviceError> {
        let handle = self
            .stage
            .as_deref()
            .expect("it is there until the drop")
            .stop_handle()?;
        Ok(Box::new(GuardedStop {
            handle,
            watchdog: self.watchdog.clone(),
        }))
    }

    fn watchdog(&self) -> Watchdog {
        self.watchdog.clone()
    }
}

struct GuardedStop {
    handle: Box<dyn StopHandle>,
    watchdog: Watchdog,
}

impl StopHandle for GuardedStop {
    fn stop(&mut self) -> Result<(), DeviceError> {
        if let Err(DeviceError::Relieved { .. }) = self.watchdog.check() {
            // The guardian does it, and reports itself whether it was confirmed.
            return Ok(());
        }
        let _step = self.watchdog.step(STOP);
        self.handle.stop()?;
        self.watchdog.set_at_risk(false);
        Ok(())
    }
}

/// A camera whose frames are steps of the watch that `watchdog` keeps over a
/// stage; where nobody keeps one, the camera as it is.
pub fn guarded_camera(camera: Box<dyn Camera>, watchdog: Watchdog) -> Box<dyn Camera> {
    if !watchdog.is_kept() {
        return camera;
    }
    Box::new(GuardedCamera {
        camera,
        watchdog,
        exposure: Seconds(0.0),
    })
}

struct GuardedCamera {
    camera: Box<dyn Camera>,
    watchdog: Watchdog,
    exposure: Seconds,
}

impl GuardedCamera {
    fn step<T>(
        &mut self,
        longest: Duration,
        act: impl FnOnce(&mut dyn Camera) -> Result<T, DeviceError>,
    ) -> Result<T, DeviceError> {
        self.watchdog.check()?;
        let under_way = self.watchdog.step(longest);
        let result = act(self.camera.as_mut());
        drop(under_way);
        self.watchdog.check()?;
        result
    }
}

impl Camera for GuardedCamera {
    fn info(&self) -> &CameraInfo {
        self.camera.info()
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        let applied = self.step(CAMERA, |camera| camera.configure(requested))?;
        self.exposure = applied.exposure;
        Ok(applied)
    }

    fn set_shutter(&mut self, open: bool) -> Result<bool, DeviceError> {
        self.step(CAMERA, |camera| camera.set_shutter(open))
    }

    fn grab(&mut self, key: FrameKey) -> Result<RawFrame, DeviceError> {
        let longest = self.longest_frame(self.exposure).to_duration();
        self.step(longest, |camera| camera.grab(key))
    }

    fn stated_with_frame(&self) -> Stated {
        self.camera.stated_with_frame()
    }

    fn temperature_c(&mut self) -> Option<f64> {
        let read = self.step(CAMERA, |camera| Ok(camera.temperature_c()));
        read.ok().flatten()
    }

    fn frames_lost(&self) -> u64 {
        self.camera.frames_lost()
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        self.camera.longest_frame(exposure)
    }

    fn least_period(&self) -> Duration {
        self.camera.least_period()
    }

    fn may_return_within(&self) -> Seconds {
        self.camera.may_return_within()
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        self.step(CAMERA, |camera| camera.reconnect())
    }
}
