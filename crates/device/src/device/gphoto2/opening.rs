//! Opening a body: its names, the rig file's settings, its lists.

use std::collections::BTreeMap;
use std::ffi::OsStr;

use super::body_choice::BodyChoice;
use super::camera::StillCamera;
use super::finding::{Body, find, must_be, programs_are_there};
use super::serial::{self, Serials};
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
        let of_rig_file = description.info.serial.clone();
        let wanted: Vec<String> = (!of_rig_file.is_empty())
            .then(|| of_rig_file.clone())
            .into_iter()
            .collect();
        let Body {
            gphoto,
            names,
            serials,
            is_proven,
        } = find(&choice, &wanted, &workplace)?;
        // Model and serial number; by the rig file's, records are the body's.
        let named = |name: &str| {
            let is_it = |path: &&String| path.rsplit('/').next() == Some(name);
            names.iter().find(is_it).map(String::as_str)
        };
        let model = match named("cameramodel") {
            Some(path) => gphoto.get(&workplace, &[path])?.swap_remove(0).current,
            None => String::new(),
        };
        let serial = match of_rig_file.is_empty() {
            true => serials.first().cloned().unwrap_or_default(),
            false => of_rig_file,
        };
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
        let mut camera = Self {
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
            serials: Serials {
                of_body: serials,
                of_files: None,
            },
        };
        if !is_proven {
            camera.prove_by_file()?;
        }
        Ok(camera)
    }

    /// The rig file's serial number is none of those that the body reports: the one in its
    /// files can be it, which a frame shows.
    fn prove_by_file(&mut self) -> Result<(), DeviceError> {
        let wanted = self.info.serial.clone();
        let other = |is: String| DeviceError::OtherCamera {
            device: self.gphoto.port.clone(),
            is,
            wanted: wanted.clone(),
        };
        let reported = self.serials.of_body.first().cloned().unwrap_or_default();
        let stated = self.speeds.first().map(|speed| {
            self.send(speed, self.isos.first())?;
            self.take(speed.nominal)
        });
        let stated = match stated {
            Some(Ok((stated, _))) => stated,
            Some(Err(error)) if reported.is_empty() => return Err(error),
            _ => return Err(other(reported)),
        };
        if !serial::is_same(&stated.serial, &wanted) {
            let is = match reported.is_empty() {
                true => stated.serial,
                false => reported,
            };
            return Err(other(is));
        }
        self.serials.of_files = Some(stated.serial);
        Ok(())
    }
}
