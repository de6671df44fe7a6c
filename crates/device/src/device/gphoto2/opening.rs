//! Opening a body: its names, the rig file's settings, its lists.

use std::collections::BTreeMap;
use std::ffi::OsStr;

use super::body_choice::BodyChoice;
use super::camera::StillCamera;
use super::finding::{find, must_be, programs_are_there};
use super::speeds;
use crate::device::command_camera::Workplace;
use crate::device::described::Description;
use crate::device::{CameraInfo, DeviceError};
use crate::units::Seconds;

/// Names that makers give the shutter speed.
const SPEED_NAMES: [&str; 3] = ["shutterspeed", "shutterspeed2", "exptime"];

impl StillCamera {
    /// Finds the body, sets what the rig file asks for, and reads its lists.
    pub(super) fn open(text: &OsStr, description: Description) -> Result<Self, DeviceError> {
        programs_are_there()?;
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
}
