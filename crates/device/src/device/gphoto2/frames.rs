//! A frame of a still camera: settings sent, the file fetched, and compared with them.

use std::time::Instant;

use super::camera::StillCamera;
use super::finding::must_be;
use super::raw_file::{RawReader, Stated};
use super::speeds::{self, Speed};
use crate::device::{DeviceError, RawFrame};
use crate::units::Seconds;

impl StillCamera {
    /// The sensitivity nearest to a gain, and the gain that it is.
    pub(super) fn iso_for(&self, gain: f64) -> (Option<(f64, String)>, f64) {
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
    pub(super) fn send(
        &self,
        speed: &Speed,
        iso: Option<&(f64, String)>,
    ) -> Result<(), DeviceError> {
        let mut values = vec![(self.speed_name.as_str(), speed.label.as_str())];
        values.extend(iso.map(|(_, label)| ("iso", label.as_str())));
        let applied = self.gphoto.set(&self.workplace, &values)?;
        for ((name, wanted), is) in values.iter().zip(applied) {
            must_be(&self.gphoto.port, name, &is.current, wanted)?;
        }
        Ok(())
    }

    /// A frame and what its file states.
    pub(super) fn take(&self, exposure: Seconds) -> Result<(Stated, RawFrame), DeviceError> {
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
    pub(super) fn take_as_set(
        &mut self,
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
        &mut self,
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
        let noted = self.serials.note_file(&stated.serial);
        noted.map_err(|wanted| DeviceError::OtherCamera {
            device: self.gphoto.port.clone(),
            is: stated.serial.clone(),
            wanted,
        })
    }
}
