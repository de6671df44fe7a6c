//! GenICam cameras (GigE Vision, USB3 Vision) through Aravis.
//!
//! Everything automatic is switched off and every setting is read back as the camera rounds
//! it. Each frame is triggered by software, so that it begins after it was requested and none
//! is thrown away. Names of features are those of the Standard Features Naming Convention.

mod choice;
mod features;
mod find;
mod link;
pub mod pixels;
mod settings;

use std::ffi::OsStr;
use std::time::{Duration, Instant};

use aravis::{Buffer, BufferStatus};

use self::choice::Choice;
use self::link::Link;
use self::pixels::PixelFormat;
use super::described::{Description, Driver};
use super::retake::FrameFault;
use super::{Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame};
use crate::units::Seconds;

/// `camera.driver = "genicam"`.
pub const DRIVER: Driver = Driver {
    name: "genicam",
    offer: "a genicam camera that is not connected now",
    only_practice: false,
    key: "device",
    allowed: choice::ALLOWED,
    is_path: false,
    accepts: |text| Choice::parse(&text.to_string_lossy()).is_some(),
    ready: |text| Ok(format!("GenICam camera {}", text.to_string_lossy())),
    open: |text, description| Ok(Box::new(GenicamCamera::open(text, description)?)),
    find: find::find,
};

/// How long a camera that was unplugged, or lost to another program, is waited for.
const RETURN_TIMEOUT: Seconds = Seconds(30.0);
/// Aravis sends a command five times, 0.5 s each, before it gives a camera up; a frame may
/// need one before its trigger, the trigger, and one after its time-out.
const COMMANDS_PER_FRAME: Seconds = Seconds(3.0 * 5.0 * 0.5);
/// The camera is sought anew in the same step if giving it up took less.
const PATIENCE: Duration = Duration::from_secs(4);

/// A camera that waits for triggers.
pub struct GenicamCamera {
    choice: Choice,
    info: CameraInfo,
    timeout: Seconds,
    format: PixelFormat,
    /// `None` while it is sought.
    link: Option<Link>,
    settings: Option<CameraSettings>,
    last: LastFrame,
    /// An earlier frame did not come whole and may still be on its way.
    is_disturbed: bool,
    frames_lost: u64,
}

/// What the next frame is compared with.
#[derive(Clone, Copy, Debug, Default)]
struct LastFrame {
    /// Of the last frame; `None` where the next one's is not known.
    number: Option<u64>,
    /// When the last frame began, ns.
    start_ns: Option<u64>,
    /// The camera's clock after a frame that failed, ns: what began earlier is that one.
    failed_ns: Option<u64>,
}

impl GenicamCamera {
    /// Opens the camera that the rig file names, takes control and prepares it. No frame is
    /// taken.
    fn open(text: &OsStr, description: Description) -> Result<Self, DeviceError> {
        let text = text.to_string_lossy();
        let choice = Choice::parse(&text).ok_or_else(|| DeviceError::NotFound {
            device: text.to_string(),
        })?;
        let link = Link::open(&choice.name)?;
        let (info, format) = settings::prepare(&link.features, &choice, &description.info)?;
        Ok(Self {
            choice,
            info,
            timeout: description.timeout,
            format,
            link: Some(link),
            settings: None,
            last: LastFrame::default(),
            is_disturbed: false,
            frames_lost: 0,
        })
    }

    fn gone(&self) -> DeviceError {
        DeviceError::Disconnected {
            device: self.choice.name.clone(),
        }
    }

    fn bad_frame(&self, fault: FrameFault) -> DeviceError {
        DeviceError::BadFrame {
            device: self.choice.name.clone(),
            fault,
        }
    }

    /// Ends what is still under way; nothing that began before now counts.
    fn settle(&mut self, link: &mut Link) -> Result<(), DeviceError> {
        if self.is_disturbed {
            link.stop()?;
            link.close_stream();
            self.last.number = None;
            self.last.failed_ns = link.clock_ns();
        }
        link.start()
    }

    fn take(&mut self, link: &mut Link) -> Result<RawFrame, DeviceError> {
        let settings = self.settings.ok_or_else(|| {
            let reason = "it is not configured";
            link.features.refused("a frame", reason)
        })?;
        self.settle(link)?;
        self.is_disturbed = true;
        let timeout = Seconds(settings.exposure.0 + self.timeout.0);
        let deadline = Instant::now() + timeout.to_duration();
        let is_on_network = link.features.is_on_network();
        let taken = link.take(deadline, |buffer| self.read(buffer, is_on_network))?;
        if let Some(frame) = taken {
            self.is_disturbed = false;
            return Ok(frame);
        }
        // Whether it is still there, and this process' own.
        match link.features.has_control() {
            false => Err(self.gone()),
            true => Err(DeviceError::NoReply {
                device: self.choice.name.clone(),
                timeout,
                sent: "TriggerSoftware".to_owned(),
            }),
        }
    }

    /// What a buffer holds, if that is the frame that was requested.
    fn read(&mut self, buffer: &Buffer, is_on_network: bool) -> Result<RawFrame, DeviceError> {
        match buffer.status() {
            BufferStatus::Success => {}
            // Aravis gives a frame up whose packets did not come, or not in time.
            BufferStatus::MissingPackets | BufferStatus::Timeout if is_on_network => {
                return Err(self.bad_frame(FrameFault::LostPackets));
            }
            _ => return Err(self.bad_frame(FrameFault::Damaged)),
        }
        // Which frame. Numbers run on without gaps, from 65 535 to 1 on old links.
        let (number, start_ns) = (buffer.frame_id(), buffer.timestamp());
        let is_old = self.last.start_ns.is_some_and(|last| start_ns <= last);
        if is_old || self.last.failed_ns.is_some_and(|failed| start_ns < failed) {
            return Err(self.bad_frame(FrameFault::Late));
        }
        if let Some(last) = self.last.number {
            self.frames_lost += number.saturating_sub(last + 1);
        }
        self.last = LastFrame {
            number: Some(number),
            start_ns: Some(start_ns),
            failed_ns: None,
        };
        // Its size and format.
        let found = [buffer.image_width(), buffer.image_height()].map(|side| side as u32);
        let pixels = found[0] as usize * found[1] as usize;
        if found != self.info.resolution_px {
            return Err(self.bad_frame(FrameFault::Size {
                found,
                counts: pixels,
                expected: self.info.resolution_px,
            }));
        }
        if buffer.image_pixel_format().raw() != self.format.code {
            let fault = format!("its pixel format is not {}", self.format.name);
            return Err(self.bad_frame(FrameFault::Undecodable(fault)));
        }
        // Its counts.
        let bytes = buffer.image_data();
        let counts = self.format.decode(&bytes, pixels, self.info.bit_depth);
        let counts = counts.map_err(|fault| self.bad_frame(fault))?;
        Ok(RawFrame {
            width: found[0],
            height: found[1],
            counts,
            sequence: Some(number),
            timestamp: Some(Seconds(start_ns as f64 * 1e-9)),
        })
    }

    /// Does something with the link. Where the camera is gone, its settings are unknown.
    fn with_link<T>(
        &mut self,
        act: impl FnOnce(&mut Self, &mut Link) -> Result<T, DeviceError>,
    ) -> Result<T, DeviceError> {
        let mut link = self.link.take().ok_or_else(|| self.gone())?;
        let result = act(self, &mut link);
        self.link = Some(link);
        if let Err(DeviceError::Disconnected { .. }) = &result {
            self.settings = None;
        }
        result
    }
}

impl Camera for GenicamCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.settings = None;
        let applied = self.with_link(|_, link| {
            match settings::apply(&link.features, requested) {
                // Some cameras take settings only between acquisitions.
                Err(DeviceError::Refused { .. }) => {
                    link.stop()?;
                    settings::apply(&link.features, requested)
                }
                applied => applied,
            }
        })?;
        self.settings = Some(applied);
        Ok(applied)
    }

    /// Cameras have no shutter that GenICam could close.
    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, _: FrameKey) -> Result<RawFrame, DeviceError> {
        self.with_link(Self::take)
    }

    fn temperature_c(&mut self) -> Option<f64> {
        let link = self.link.as_ref()?;
        settings::temperature_c(&link.features)
    }

    fn frames_lost(&self) -> u64 {
        self.frames_lost
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        Seconds(exposure.0.max(0.0) + self.timeout.0 + COMMANDS_PER_FRAME.0)
    }

    fn may_return_within(&self) -> Seconds {
        RETURN_TIMEOUT
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        self.settings = None;
        // Control that this process still has would keep it from taking control again. A
        // camera that does not answer takes its time.
        let began = Instant::now();
        self.link = None;
        if began.elapsed() > PATIENCE {
            return Err(self.gone());
        }
        let link = match Link::open(&self.choice.name) {
            Ok(link) => link,
            // It may still come back.
            Err(DeviceError::NotFound { .. } | DeviceError::Controlled { .. }) => {
                return Err(self.gone());
            }
            Err(error) => return Err(error),
        };
        let (info, format) = settings::prepare(&link.features, &self.choice, &self.info)?;
        (self.info, self.format) = (info, format);
        self.link = Some(link);
        // Its clock may have begun anew.
        self.last = LastFrame::default();
        self.is_disturbed = false;
        Ok(())
    }
}
