//! The camera of a capture: speeds set, frames taken, found again after it was gone.

use std::collections::BTreeMap;
use std::time::Duration;

use super::body_choice::{BodyChoice, Times};
use super::finding::find;
use super::program::{Gphoto, SETTINGS_TIME};
use super::serial::Serials;
use super::speeds::{self, Speed};
use crate::device::command_camera::Workplace;
use crate::device::{Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame, Stated};
use crate::units::Seconds;

/// Time between two frames of a live picture: shutters wear.
const SHUTTER_PERIOD: Duration = Duration::from_secs(5);
/// How long a body that went away is waited for during a capture.
const RETURNS_WITHIN: Seconds = Seconds(30.0);
/// A still camera.
#[derive(Debug)]
pub struct StillCamera {
    pub(super) choice: BodyChoice,
    pub(super) gphoto: Gphoto,
    pub(super) workplace: Workplace,
    pub(super) info: CameraInfo,
    pub(super) timeout: Seconds,
    pub(super) speed_name: String,
    pub(super) speeds: Vec<Speed>,
    /// Sensitivities that the body lists, and its own words for them; empty: it has none.
    pub(super) isos: Vec<(f64, String)>,
    /// Exposures that raw files state, by the label of the speed.
    pub(super) known: BTreeMap<String, Seconds>,
    pub(super) set: Option<Set>,
    pub(super) serials: Serials,
}

/// What was set last.
#[derive(Clone, Debug)]
pub(super) struct Set {
    speed: Speed,
    iso: Option<(f64, String)>,
    applied: CameraSettings,
}

impl Camera for StillCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    /// Sets the longest speed of the body's list that is not longer than requested. The
    /// exposure that is returned is that of a raw file at this speed: at the first use of a
    /// speed a frame is taken for it.
    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.set = None;
        let [shortest, longest] = self.info.exposure_range;
        let wanted = Seconds(requested.exposure.0.clamp(shortest.0, longest.0));
        let speed = speeds::choose(&self.speeds, wanted).cloned();
        let speed = speed.ok_or_else(|| DeviceError::Refused {
            device: self.gphoto.port.clone(),
            command: self.speed_name.clone(),
            reason: "the body lists no shutter speed".to_owned(),
        })?;
        let (iso, gain) = self.iso_for(requested.gain);
        self.send(&speed, iso.as_ref())?;
        let stated = match self.known.get(&speed.label) {
            Some(&stated) => stated,
            None => {
                let (stated, _) = self.take_as_set(&speed, iso.as_ref())?;
                self.known.insert(speed.label.clone(), stated);
                stated
            }
        };
        let exposure = match self.choice.times {
            Times::Nominal => stated,
            Times::Stops => speeds::whole_stops(stated),
        };
        let applied = CameraSettings { exposure, gain };
        self.set = Some(Set {
            speed,
            iso,
            applied,
        });
        Ok(applied)
    }

    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, _key: FrameKey) -> Result<RawFrame, DeviceError> {
        let set = self.set.clone().ok_or_else(|| DeviceError::Refused {
            device: self.gphoto.port.clone(),
            command: "a frame".to_owned(),
            reason: "it is not configured".to_owned(),
        })?;
        let (_, frame) = self.take_as_set(&set.speed, set.iso.as_ref())?;
        Ok(frame)
    }

    /// Two frames and the settings between them, each with its time.
    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        let settings = 2.0 * Duration::as_secs_f64(&SETTINGS_TIME);
        Seconds(2.0 * (exposure.0 + self.timeout.0) + settings)
    }

    fn least_period(&self) -> Duration {
        SHUTTER_PERIOD
    }

    fn may_return_within(&self) -> Seconds {
        RETURNS_WITHIN
    }

    /// Where neither body nor rig file has a serial number, the files' stands for them.
    fn stated_with_frame(&self) -> Stated {
        let serial = self.serials.of_files.clone();
        Stated {
            serial: serial.filter(|_| self.info.serial.is_empty()),
            ..Stated::default()
        }
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        let mut wanted = self.serials.of_body.clone();
        if !self.info.serial.is_empty() {
            wanted.insert(0, self.info.serial.clone());
        }
        let found = find(&self.choice, &wanted, &self.workplace)?;
        // One that reports no number is known by its files.
        if let (false, Some(is)) = (found.is_proven, found.serials.first()) {
            return Err(match &self.choice.port {
                Some(port) => DeviceError::OtherCamera {
                    device: port.clone(),
                    is: is.clone(),
                    wanted: wanted.swap_remove(0),
                },
                None => DeviceError::Disconnected {
                    device: format!("the still camera {}", wanted[0]),
                },
            });
        }
        self.gphoto = found.gphoto;
        if let Some(set) = self.set.take() {
            self.configure(set.applied)?;
        }
        Ok(())
    }
}
