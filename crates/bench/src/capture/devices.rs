//! The camera and the stage as a capture sees them: what state they are known
//! to be in, and the promise that the lamp is off when the capture ends.

use std::pin::Pin;
use std::time::{Duration, Instant};

use super::CaptureError;
use super::spent::{Spent, Stopwatch};
use super::worker::Worker;
use crate::device::guardian::Watchdog;
use crate::device::manual;
use crate::device::retake::{Retakes, grab_right};
use crate::device::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, LampState, LightStage, RawFrame,
    ReferenceCheck, StageInfo, StageStatus, Stated, StopHandle,
};
use crate::interrupt::{Interrupt, StopLevel};
use crate::units::{Seconds, StageAngles};

/// How often a waiting capture looks whether it shall stop at once.
const POLL: Duration = Duration::from_millis(20);
/// How often a lost camera is looked for.
const RETURN_POLL: Seconds = Seconds(0.5);
/// What a driver's reply may still take once a stop was requested; a person is not waited for.
const REPLY_GRACE: Duration = Duration::from_secs(1);
/// How long a stage's driver may take to notice that it was stopped.
const LET_GO: Duration = Duration::from_secs(2);
/// A lamp that is lit goes off so long after a request to stop, also where a frame is under
/// way that takes longer.
const LIT_GRACE: Duration = Duration::from_secs(3);
/// A lamp's temperature changes little within so long.
const READING_HOLDS: Duration = Duration::from_secs(10);
/// A stage that stands further than this from its target did not get there.
const POSITION_TOLERANCE_DEG: f64 = 0.25;

/// Both devices, each on its thread.
pub(super) struct Devices {
    /// First, because it is dropped first: the lamp goes off before anybody
    /// waits for a driver.
    guard: LampGuard,
    watchdog: Watchdog,
    camera: Worker<Box<dyn Camera>>,
    stage: Worker<Box<dyn LightStage>>,
    interrupt: Interrupt,
    pub(super) camera_info: CameraInfo,
    stage_info: StageInfo,
    known: Known,
    retakes: Retakes,
    spent: Spent,
    camera_is_lost: bool,
    sensor_c: Option<f64>,
    /// What the camera reported with the last frame.
    stated: Stated,
    /// The lamp's temperature, °C, and when it was read.
    lamp_c: Option<(f64, Instant)>,
}

/// What the devices said last; `None` where they have not received a command yet.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    homed: bool,
    position: Option<StageAngles>,
    lamp: Option<LampState>,
    settings: Option<(CameraSettings, CameraSettings)>,
    shutter_open: Option<bool>,
}

/// A change of the camera's settings.
pub(super) enum SettingsChange {
    /// It has them.
    None {
        /// Read back.
        applied: CameraSettings,
    },
    /// Sent, and the first frames after it are being thrown away.
    UnderWay {
        requested: CameraSettings,
        answer: Pin<Box<dyn Future<Output = Result<Applied, CaptureError>>>>,
    },
}

/// Settings read back, and the frames thrown away since.
type Applied = Result<(CameraSettings, Thrown), DeviceError>;

/// Frames that were thrown away.
#[derive(Default)]
pub(super) struct Thrown {
    frames: u32,
    retakes: Retakes,
    error: Option<DeviceError>,
}

/// Stops motion and lamp when dropped, on every way out except an orderly one.
struct LampGuard {
    handle: Box<dyn StopHandle>,
    armed: bool,
}

impl LampGuard {
    fn stop(&mut self) -> Result<(), DeviceError> {
        self.armed = false;
        self.handle.stop()
    }
}

/// While a panic unwinds; every other way out stops the stage and says whether
/// it did.
impl Drop for LampGuard {
    fn drop(&mut self) {
        if self.armed
            && let Err(error) = self.stop()
        {
            tracing::error!("the stage did not confirm that it stopped: {error}");
        }
    }
}

impl Devices {
    /// Takes the devices over; nothing moves yet.
    pub(super) fn new(
        camera: Box<dyn Camera>,
        stage: Box<dyn LightStage>,
        interrupt: Interrupt,
    ) -> Result<Self, CaptureError> {
        let guard = LampGuard {
            handle: stage.stop_handle()?,
            armed: false,
        };
        Ok(Self {
            watchdog: stage.watchdog(),
            camera_info: camera.info().clone(),
            stage_info: stage.info().clone(),
            camera: Worker::spawn("camera", camera)?,
            stage: Worker::spawn("stage", stage)?,
            guard,
            interrupt,
            known: Known::default(),
            retakes: Retakes::default(),
            spent: Spent::default(),
            camera_is_lost: false,
            sensor_c: None,
            stated: Stated::default(),
            lamp_c: None,
        })
    }

    /// Who watches over the thread of this capture.
    pub(super) fn watchdog(&self) -> Watchdog {
        self.watchdog.clone()
    }

    /// Waits for an answer. Asked to stop meanwhile, it waits so much longer
    /// (without end for `None`), asked twice not at all: then stage and lamp are
    /// stopped, whatever their driver is doing.
    async fn answer<T>(
        &mut self,
        grace: Option<Duration>,
        answer: impl Future<Output = Result<T, CaptureError>>,
    ) -> Result<T, CaptureError> {
        let mut asked: Option<Instant> = None;
        tokio::pin!(answer);
        loop {
            tokio::select! {
                biased;
                result = &mut answer => return result,
                () = tokio::time::sleep(POLL) => {}
            }
            // The driver may be what hangs: its answer is not waited for.
            if let Err(error) = self.watchdog.check() {
                return Err(self.stop_after(error.into()));
            }
            let level = self.interrupt.level();
            if level == StopLevel::Continue {
                continue;
            }
            let asked = asked.get_or_insert_with(Instant::now);
            if level == StopLevel::Now || grace.is_some_and(|grace| asked.elapsed() >= grace) {
                return Err(self.stop_after(CaptureError::StoppedNow));
            }
        }
    }

    /// Stops motion and lamp at once, unless they are stopped already, and
    /// returns why; where the stage does not confirm it, that is the error.
    pub(super) fn stop_after(&mut self, why: CaptureError) -> CaptureError {
        let stopped = if self.guard.armed {
            self.guard.stop()
        } else {
            Ok(())
        };
        if stopped.is_err() {
            // Its driver would ask a mute stage in vain, which its guardian stops now.
            let is_guarded = self.watchdog.is_kept();
            let patience = if is_guarded { Duration::ZERO } else { LET_GO };
            self.stage.abandon(patience);
            self.camera.abandon(Duration::ZERO);
        } else if matches!(
            why,
            CaptureError::StoppedNow
                | CaptureError::Device(
                    DeviceError::Relieved { .. } | DeviceError::Unguarded { .. }
                )
        ) {
            // Nobody waits for a frame, or for a driver that hangs.
            self.stage.abandon(LET_GO);
            self.camera.abandon(Duration::ZERO);
        }
        match stopped {
            Ok(()) => why,
            Err(source) => CaptureError::NotStopped {
                cause: why.to_string(),
                source,
            },
        }
    }

    /// A short command to the stage.
    async fn stage<T: Send + 'static>(
        &mut self,
        job: impl FnOnce(&mut dyn LightStage) -> Result<T, DeviceError> + Send + 'static,
    ) -> Result<T, CaptureError> {
        let grace = match self.stage_info.driver == manual::DRIVER {
            true => Duration::ZERO,
            false => REPLY_GRACE,
        };
        self.stage_within(grace, job).await
    }

    /// A command to the stage that may take this long after a stop was requested.
    async fn stage_within<T: Send + 'static>(
        &mut self,
        grace: Duration,
        job: impl FnOnce(&mut dyn LightStage) -> Result<T, DeviceError> + Send + 'static,
    ) -> Result<T, CaptureError> {
        // From the first command on, every way out must stop the stage.
        self.guard.armed = true;
        let watch = Stopwatch::start();
        let answer = self.stage.call(move |stage| job(stage.as_mut()));
        let result = self.answer(Some(grace), answer).await;
        watch.add_to(&mut self.spent.stage_s);
        Ok(result??)
    }

    async fn camera<T: Send + 'static>(
        &mut self,
        job: impl FnOnce(&mut dyn Camera) -> Result<T, DeviceError> + Send + 'static,
    ) -> Result<T, CaptureError> {
        let answer = self.camera.call(move |camera| job(camera.as_mut()));
        self.camera_is_lost = false;
        let watch = Stopwatch::start();
        let result = self.answer(self.frame_grace(), answer).await;
        watch.add_to(&mut self.spent.camera_s);
        let result = result?;
        self.camera_is_lost = matches!(result, Err(DeviceError::Disconnected { .. }));
        Ok(result?)
    }

    /// A frame ends before a capture that is to stop does, but not a long one under the lamp.
    fn frame_grace(&self) -> Option<Duration> {
        let is_dark = !self.guard.armed || self.known.lamp == Some(LampState::Off);
        (!is_dark).then_some(LIT_GRACE)
    }

    /// Whether the camera was gone when it was last used.
    pub(super) fn camera_is_lost(&self) -> bool {
        self.camera_is_lost
    }

    /// How long a lost camera is worth waiting for.
    pub(super) async fn may_return_within(&mut self) -> Result<Seconds, CaptureError> {
        self.camera(|camera| Ok(camera.may_return_within())).await
    }

    /// Waits for a lost camera with the lamp off; whether it came back. Its
    /// settings are unknown then.
    pub(super) async fn camera_returned(&mut self, within: Seconds) -> Result<bool, CaptureError> {
        self.lamp(LampState::Off, Seconds(0.0)).await?;
        self.known.settings = None;
        self.known.shutter_open = None;
        let deadline = Instant::now() + within.to_duration();
        loop {
            let back = self.camera(|camera| camera.reconnect()).await;
            match back {
                Ok(()) => {
                    self.retakes.reconnected += 1;
                    return Ok(true);
                }
                Err(error) if !self.camera_is_lost => return Err(error),
                Err(_) if Instant::now() >= deadline => return Ok(false),
                Err(_) if self.interrupt.level() >= StopLevel::AfterThisFrame => {
                    return Err(CaptureError::Interrupted);
                }
                Err(_) => self.pause(RETURN_POLL).await?,
            }
        }
    }

    /// Where the time went so far, without the whole.
    pub(super) fn spent(&self) -> Spent {
        self.spent
    }

    /// What went wrong since the last call.
    pub(super) fn take_retakes(&mut self) -> Retakes {
        std::mem::take(&mut self.retakes)
    }

    /// Waits; a request to stop ends the wait.
    pub(super) async fn pause(&mut self, time: Seconds) -> Result<(), CaptureError> {
        if time.0 > 0.0 {
            let watch = Stopwatch::start();
            let _step = self.watchdog.step(time.to_duration());
            let wait = tokio::time::sleep(time.to_duration());
            let waited = self
                .answer(Some(Duration::ZERO), async {
                    wait.await;
                    Ok(())
                })
                .await;
            watch.add_to(&mut self.spent.settling_s);
            waited?;
        }
        Ok(())
    }

    /// Whether this run has homed the stage.
    pub(super) fn is_homed(&self) -> bool {
        self.known.homed
    }

    /// Lamp off, then the reference switches are sought.
    pub(super) async fn home(&mut self) -> Result<StageStatus, CaptureError> {
        self.lamp(LampState::Off, Seconds(0.0)).await?;
        let status = self
            .stage_within(Duration::ZERO, |stage| stage.home())
            .await?;
        self.known.homed = true;
        Ok(status)
    }

    /// Lamp off, then the reference switches are sought with the steps counted;
    /// `None` where the stage cannot measure it, or was not moved in this run.
    pub(super) async fn check_reference(&mut self) -> Result<Option<ReferenceCheck>, CaptureError> {
        if !self.known.homed {
            return Ok(None);
        }
        self.lamp(LampState::Off, Seconds(0.0)).await?;
        self.known.position = None;
        self.stage_within(Duration::ZERO, |stage| stage.check_reference())
            .await
    }

    /// Moves and returns the position read back.
    pub(super) async fn move_to(
        &mut self,
        target: StageAngles,
    ) -> Result<StageAngles, CaptureError> {
        self.known.position = None;
        let position = self
            .stage_within(Duration::ZERO, move |stage| stage.move_to(target))
            .await?;
        let off_deg = position
            .to_light()
            .angle_between(target.to_light())
            .to_degrees();
        // A position that is not a number is not at the target either.
        if off_deg.is_nan() || off_deg > POSITION_TOLERANCE_DEG {
            return Err(self.stage_differs("the position", position, target).into());
        }
        self.known.position = Some(position);
        Ok(position)
    }

    /// Switches the lamp where it is not in this state, and waits `settle` after.
    pub(super) async fn lamp(
        &mut self,
        wanted: LampState,
        settle: Seconds,
    ) -> Result<(), CaptureError> {
        if self.known.lamp == Some(wanted) {
            return Ok(());
        }
        self.known.lamp = None;
        let switch = move |stage: &mut dyn LightStage| {
            let applied = stage.set_lamp(wanted)?;
            Ok((applied, stage.temperature_c()))
        };
        let (applied, lamp_c) = self.stage(switch).await?;
        self.lamp_c = lamp_c.map(|lamp_c| (lamp_c, Instant::now()));
        if applied != wanted {
            return Err(self.stage_differs("the lamp", applied, wanted).into());
        }
        self.known.lamp = Some(applied);
        self.pause(settle).await
    }

    /// The lamp's temperature, °C, read again where the last reading is old; `None` where
    /// the stage does not report.
    pub(super) async fn lamp_c(&mut self) -> Result<Option<f64>, CaptureError> {
        if let Some((_, read)) = self.lamp_c
            && read.elapsed() >= READING_HOLDS
        {
            let lamp_c = self.stage(|stage| Ok(stage.temperature_c())).await?;
            self.lamp_c = lamp_c.map(|lamp_c| (lamp_c, Instant::now()));
        }
        Ok(self.lamp_c.map(|(lamp_c, _)| lamp_c))
    }

    /// The sensor's temperature at the last frame, °C; `None` where the camera does not report.
    pub(super) fn sensor_c(&self) -> Option<f64> {
        self.sensor_c
    }

    /// What the camera reported with the last frame.
    pub(super) fn stated(&self) -> &Stated {
        &self.stated
    }

    fn stage_differs(
        &self,
        what: &str,
        is: impl std::fmt::Display,
        wanted: impl std::fmt::Display,
    ) -> DeviceError {
        DeviceError::NotApplied {
            device: self.stage_info.port.clone(),
            what: what.into(),
            is: is.to_string(),
            wanted: wanted.to_string(),
        }
    }

    /// Sends settings, unless the camera has them, and throws away so many frames
    /// that may still have the old ones, as `discards`. Nothing is waited for:
    /// stage and lamp do their part meanwhile.
    pub(super) fn begin_settings(
        &mut self,
        requested: CameraSettings,
        frames: u32,
        discards: FrameKey,
    ) -> SettingsChange {
        if let Some((before, applied)) = self.known.settings
            && before == requested
        {
            return SettingsChange::None { applied };
        }
        self.known.settings = None;
        self.camera_is_lost = false;
        let answer = self.camera.call(move |camera| {
            let camera = camera.as_mut();
            let applied = camera.configure(requested)?;
            let mut thrown = Thrown::default();
            while thrown.frames < frames && thrown.error.is_none() {
                thrown.error = grab_right(camera, discards, &mut thrown.retakes).err();
                thrown.frames += 1;
            }
            Ok((applied, thrown))
        });
        SettingsChange::UnderWay {
            requested,
            answer: Box::pin(answer),
        }
    }

    /// Settings read back once they are applied; `true` if they were others before.
    pub(super) async fn settings_applied(
        &mut self,
        change: SettingsChange,
    ) -> Result<(CameraSettings, bool), CaptureError> {
        let (requested, answer) = match change {
            SettingsChange::None { applied } => return Ok((applied, false)),
            SettingsChange::UnderWay { requested, answer } => (requested, answer),
        };
        let watch = Stopwatch::start();
        let result = self.answer(self.frame_grace(), answer).await;
        watch.add_to(&mut self.spent.camera_s);
        let failed = match result? {
            Ok((applied, thrown)) => {
                self.retakes.add(thrown.retakes);
                self.spent.exposures_s += f64::from(thrown.frames) * applied.exposure.0;
                if thrown.error.is_none() {
                    self.known.settings = Some((requested, applied));
                    return Ok((applied, true));
                }
                thrown.error
            }
            Err(error) => Some(error),
        };
        self.camera_is_lost = matches!(failed, Some(DeviceError::Disconnected { .. }));
        Err(failed.map_or(CaptureError::WorkerGone { name: "camera" }, Into::into))
    }

    /// Whether lamp and shutter are in this state already.
    pub(super) fn is_set(&self, lamp: LampState, shutter_open: bool) -> bool {
        self.known.lamp == Some(lamp) && self.known.shutter_open == Some(shutter_open)
    }

    /// Opens or closes the shutter; `false` if the camera has none.
    pub(super) async fn shutter(&mut self, open: bool) -> Result<bool, CaptureError> {
        if self.known.shutter_open == Some(open) {
            return Ok(true);
        }
        let has_shutter = self.camera(move |camera| camera.set_shutter(open)).await?;
        if has_shutter {
            self.known.shutter_open = Some(open);
        }
        Ok(has_shutter)
    }

    /// Sends the settings once more, after the images contradicted them.
    pub(super) async fn configure_again(&mut self) -> Result<Option<CameraSettings>, CaptureError> {
        let Some((requested, _)) = self.known.settings.take() else {
            return Ok(None);
        };
        self.retakes.exposure_ignored += 1;
        let applied = self
            .camera(move |camera| camera.configure(requested))
            .await?;
        self.known.settings = Some((requested, applied));
        Ok(Some(applied))
    }

    /// The next frame that is right; wrong ones are taken again.
    pub(super) async fn grab(&mut self, key: FrameKey) -> Result<RawFrame, CaptureError> {
        let grab = move |camera: &mut dyn Camera| {
            let mut retakes = Retakes::default();
            let frame = grab_right(camera, key, &mut retakes);
            let sensor_c = camera.temperature_c();
            Ok((frame, retakes, sensor_c, camera.stated_with_frame()))
        };
        let (frame, retakes, sensor_c, stated) = self.camera(grab).await?;
        self.sensor_c = sensor_c;
        self.stated = stated;
        self.retakes.add(retakes);
        if let Some((_, applied)) = self.known.settings {
            self.spent.exposures_s += applied.exposure.0;
        }
        self.camera_is_lost = matches!(frame, Err(DeviceError::Disconnected { .. }));
        Ok(frame?)
    }

    /// Lamp off, read back; nothing is taken for granted afterwards, because
    /// hands may move what stands without current.
    pub(super) async fn rest(&mut self) -> Result<(), CaptureError> {
        if self.guard.armed {
            self.known.lamp = None;
            self.lamp(LampState::Off, Seconds(0.0)).await?;
        }
        self.known = Known::default();
        Ok(())
    }

    /// Ends in good order: lamp off, read back. The stage keeps its position.
    pub(super) async fn shut_down(&mut self) -> Result<(), CaptureError> {
        if self.guard.armed {
            self.known.lamp = None;
            self.lamp(LampState::Off, Seconds(0.0)).await?;
            self.guard.armed = false;
        }
        Ok(())
    }
}
