//! Still cameras, tethered by the program `gphoto2`: their shutter speeds are those that the
//! body lists, and each raw file must state the exposure that was set.
//!
//! Programs instead of libraries, because libgphoto2 and every raw decoder are under the
//! LGPL: a program behind a pipe binds nobody to its licence.

mod body_choice;
mod program;
mod raw_file;
mod speeds;

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::time::{Duration, Instant};

use self::body_choice::{BodyChoice, Times};
use self::program::{GPHOTO2, Gphoto, SETTINGS_TIME};
use self::raw_file::{RAW_IDENTIFY, RawReader, Stated, UNPROCESSED_RAW};
use self::speeds::Speed;
use super::command_camera::{Workplace, program as program_file};
use super::described::{Description, Driver, FoundCamera};
use super::{Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame};
use crate::units::Seconds;

/// `camera.driver = "gphoto2"`.
pub const DRIVER: Driver = Driver {
    name: "gphoto2",
    key: "body",
    allowed: body_choice::ALLOWED,
    is_path: false,
    accepts: |text| BodyChoice::parse(&text.to_string_lossy()).is_some(),
    ready: |_| {
        for program in [GPHOTO2, UNPROCESSED_RAW, RAW_IDENTIFY] {
            if let Some(fault) = program_file::fault(program) {
                let program = program.to_owned();
                return Err(DeviceError::Program { program, fault });
            }
        }
        Ok("frames come from gphoto2".to_owned())
    },
    open: |text, description| Ok(Box::new(StillCamera::open(text, description)?)),
    find: detected,
};

/// How long a body that went away is waited for during a capture.
const RETURNS_WITHIN: Seconds = Seconds(30.0);
/// Names that makers give the shutter speed.
const SPEED_NAMES: [&str; 3] = ["shutterspeed", "shutterspeed2", "exptime"];

/// The bodies that gphoto2 detects on USB, without opening any.
fn detected() -> Result<Vec<FoundCamera>, DeviceError> {
    if program_file::fault(GPHOTO2).is_some() {
        return Ok(Vec::new());
    }
    let bodies = program::detect(&Workplace::new(None)?)?;
    let found = bodies.into_iter().map(|(model, port)| FoundCamera {
        address: format!("port={port}"),
        model,
        serial: String::new(),
        problem: None,
    });
    Ok(found.collect())
}

/// A still camera.
#[derive(Debug)]
pub struct StillCamera {
    choice: BodyChoice,
    gphoto: Gphoto,
    workplace: Workplace,
    info: CameraInfo,
    timeout: Seconds,
    speed_name: String,
    speeds: Vec<Speed>,
    /// Sensitivities that the body lists, and its own words for them; empty: it has none.
    isos: Vec<(f64, String)>,
    /// Exposures that raw files state, by the label of the speed.
    known: BTreeMap<String, Seconds>,
    set: Option<Set>,
}

/// What was set last.
#[derive(Clone, Debug)]
struct Set {
    speed: Speed,
    iso: Option<(f64, String)>,
    applied: CameraSettings,
}

impl StillCamera {
    /// Finds the body, sets what the rig file asks for, and reads its lists.
    fn open(text: &OsStr, description: Description) -> Result<Self, DeviceError> {
        (DRIVER.ready)(text)?;
        let choice = BodyChoice::parse(&text.to_string_lossy()).unwrap_or_default();
        let workplace = Workplace::new(description.keeper)?;
        let wanted_serial = description.info.serial.clone();
        let gphoto = find(&choice, &wanted_serial, &workplace)?;
        // Model and serial number.
        let names = gphoto.names(&workplace)?;
        let named = |name: &str| {
            let is_it = |path: &&String| path.rsplit('/').next() == Some(name);
            names.iter().find(is_it).map(String::as_str)
        };
        let of_body = |name| -> Result<String, DeviceError> {
            let Some(path) = named(name) else {
                return Ok(String::new());
            };
            let settings = gphoto.get(&workplace, &[path])?;
            Ok(settings
                .into_iter()
                .next()
                .map_or(String::new(), |setting| setting.current))
        };
        let model = of_body("cameramodel")?;
        let serial = of_body("serialnumber")?;
        // Settings of the rig file. A file stays in the body's memory only until it was fetched.
        let mut wanted = choice.settings.clone();
        if let Some(path) = named("capturetarget") {
            let target = gphoto.get(&workplace, &[path])?;
            let internal = target.iter().flat_map(|setting| &setting.choices);
            let internal = internal.filter(|choice| choice.contains("Internal"));
            wanted.extend(
                internal
                    .take(1)
                    .map(|value| (path.to_owned(), value.clone())),
            );
        }
        for (name, value) in &wanted {
            let is = gphoto.set(&workplace, &[(name, value)])?;
            must_be(&gphoto.port, name, &is[0].current, value)?;
        }
        // Its lists.
        let speed_name = SPEED_NAMES.iter().find_map(|name| named(name));
        let refuses = |command: &str, reason: &str| DeviceError::Refused {
            device: gphoto.port.clone(),
            command: command.to_owned(),
            reason: reason.to_owned(),
        };
        let speed_name =
            speed_name.ok_or_else(|| refuses("shutterspeed", "the body has no such setting"))?;
        let speed = gphoto.get(&workplace, &[speed_name])?.swap_remove(0);
        let speeds = speeds::of_list(speed.choices.iter().map(String::as_str));
        if speed.is_read_only || speeds.is_empty() {
            return Err(refuses(
                speed_name,
                "the body lets no shutter speed be set: its dial is not at manual exposure (M)",
            ));
        }
        let mut isos = Vec::new();
        if let Some(path) = named("iso") {
            let listed = gphoto.get(&workplace, &[path])?.swap_remove(0).choices;
            isos.extend(listed.into_iter().filter_map(|label| {
                let iso: f64 = label.parse().ok()?;
                (iso > 0.0).then_some((iso, label))
            }));
            isos.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        // The exposures that rig file and body share.
        let [from, to] = description.info.exposure_range;
        let [first, last] = [&speeds[0], &speeds[speeds.len() - 1]].map(|speed| speed.nominal);
        let range = [Seconds(from.0.max(first.0)), Seconds(to.0.min(last.0))];
        if range[0].0 > range[1].0 {
            return Err(refuses(
                speed_name,
                &format!("the body has speeds from {first} to {last}, the rig file {from} to {to}"),
            ));
        }
        let info = CameraInfo {
            model,
            serial,
            exposure_range: range,
            ..description.info
        };
        Ok(Self {
            speed_name: speed_name.to_owned(),
            choice,
            gphoto,
            workplace,
            info,
            timeout: description.timeout,
            speeds,
            isos,
            known: BTreeMap::new(),
            set: None,
        })
    }

    /// The sensitivity nearest to a gain, and the gain that it is.
    fn iso_for(&self, gain: f64) -> (Option<(f64, String)>, f64) {
        let Some(lowest) = self.isos.first() else {
            return (None, 1.0);
        };
        let base = self.choice.base_iso.unwrap_or(lowest.0);
        let off = |iso: f64| (iso / (base * gain)).ln().abs();
        let nearest = self
            .isos
            .iter()
            .min_by(|a, b| off(a.0).total_cmp(&off(b.0)));
        let nearest = nearest.unwrap_or(lowest);
        (Some(nearest.clone()), nearest.0 / base)
    }

    /// Sets speed and sensitivity and reads them back.
    fn send(&self, speed: &Speed, iso: Option<&(f64, String)>) -> Result<(), DeviceError> {
        let mut values = vec![(self.speed_name.as_str(), speed.label.as_str())];
        values.extend(iso.map(|(_, label)| ("iso", label.as_str())));
        let applied = self.gphoto.set(&self.workplace, &values)?;
        for ((name, wanted), is) in values.iter().zip(applied) {
            must_be(&self.gphoto.port, name, &is.current, wanted)?;
        }
        Ok(())
    }

    /// A frame and what its file states.
    fn take(&self, exposure: Seconds) -> Result<(Stated, RawFrame), DeviceError> {
        let time = Seconds(exposure.0 + self.timeout.0).to_duration();
        let deadline = Instant::now() + time;
        let place = self.workplace.place()?;
        let file = self.gphoto.capture(&self.workplace, place.path(), time)?;
        let reader = RawReader {
            workplace: &self.workplace,
            deadline,
            device: &self.gphoto.port,
        };
        let stated = reader.stated(&file)?;
        let frame = reader.counts(&file, self.info.resolution_px, self.info.bit_depth)?;
        Ok((stated, frame))
    }

    /// A frame whose file states what was set. Where it does not, the settings are sent once
    /// more, because a body can have missed them.
    fn take_as_set(
        &self,
        speed: &Speed,
        iso: Option<&(f64, String)>,
    ) -> Result<(Seconds, RawFrame), DeviceError> {
        let (stated, frame) = self.take(speed.nominal)?;
        if self.check(speed, iso, &stated).is_ok() {
            return Ok((stated.exposure, frame));
        }
        self.send(speed, iso)?;
        let (stated, frame) = self.take(speed.nominal)?;
        self.check(speed, iso, &stated)?;
        Ok((stated.exposure, frame))
    }

    fn check(
        &self,
        speed: &Speed,
        iso: Option<&(f64, String)>,
        stated: &Stated,
    ) -> Result<(), DeviceError> {
        let differs = |what: &str, is: String, wanted: String| {
            Err(DeviceError::NotApplied {
                device: self.gphoto.port.clone(),
                what: format!("the {what} in the raw file"),
                is,
                wanted,
            })
        };
        let known = self.known.get(&speed.label);
        let is_known = known.is_none_or(|known| (stated.exposure.0 / known.0 - 1.0).abs() < 1e-3);
        if !is_known || !speeds::agrees(speed, stated.exposure) {
            return differs("exposure", stated.exposure.to_string(), speed.label.clone());
        }
        if let (Some((wanted, label)), Some(is)) = (iso, stated.iso)
            && (is / wanted - 1.0).abs() > 0.01
        {
            return differs("sensitivity", format!("ISO {is}"), format!("ISO {label}"));
        }
        if !stated.serial.is_empty()
            && !self.info.serial.is_empty()
            && stated.serial != self.info.serial
        {
            return differs(
                "serial number",
                stated.serial.clone(),
                self.info.serial.clone(),
            );
        }
        Ok(())
    }
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

    fn may_return_within(&self) -> Seconds {
        RETURNS_WITHIN
    }

    fn reconnect(&mut self) -> Result<(), DeviceError> {
        let found = find(&self.choice, &self.info.serial, &self.workplace)?;
        // Its port is the same where the rig file names one; it must also answer.
        found.names(&self.workplace)?;
        self.gphoto = found;
        if let Some(set) = self.set.take() {
            self.configure(set.applied)?;
        }
        Ok(())
    }
}

/// The body that the rig file means.
fn find(choice: &BodyChoice, serial: &str, workplace: &Workplace) -> Result<Gphoto, DeviceError> {
    let at = |port: &str| Gphoto {
        port: port.to_owned(),
    };
    let serial_at = |port: &str| -> Result<String, DeviceError> {
        let setting = at(port).get(workplace, &["serialnumber"])?;
        Ok(setting
            .into_iter()
            .next()
            .map_or(String::new(), |setting| setting.current))
    };
    if let Some(port) = &choice.port {
        if !serial.is_empty() {
            must_be(port, "the serial number", &serial_at(port)?, serial)?;
        }
        return Ok(at(port));
    }
    let detected = program::detect(workplace)?;
    if serial.is_empty() {
        return match detected.as_slice() {
            [(_, port)] => Ok(at(port)),
            [] => Err(DeviceError::Disconnected {
                device: "the still camera".to_owned(),
            }),
            several => Err(DeviceError::WrongKind {
                device: "port = any".to_owned(),
                wanted: "single camera",
                why: format!("gphoto2 detects {} of them", several.len()),
            }),
        };
    }
    let mut held = None;
    for (_, port) in &detected {
        match serial_at(port) {
            Ok(found) if found == serial => return Ok(at(port)),
            Ok(_) => {}
            Err(error) => held = Some(error),
        }
    }
    Err(held.unwrap_or(DeviceError::Disconnected {
        device: format!("the still camera {serial}"),
    }))
}

fn must_be(device: &str, what: &str, is: &str, wanted: &str) -> Result<(), DeviceError> {
    if is == wanted {
        return Ok(());
    }
    Err(DeviceError::NotApplied {
        device: device.to_owned(),
        what: what.to_owned(),
        is: is.to_owned(),
        wanted: wanted.to_owned(),
    })
}
