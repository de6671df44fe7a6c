//! What the records of one calibration have in common: rig, device, time, origin.

use jiff::{SignedDuration, Timestamp};

use super::record::{Kind, Record, Settings, Values};
use crate::config::RigConfig;

/// A calibration whose values become records.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Name of the rig.
    pub rig: String,
    /// Serial number of the camera.
    pub device_serial: String,
    /// Name of its records; `None`: date and kind.
    pub id: Option<String>,
    /// When it was made.
    pub date: Timestamp,
    /// How long its records may be used, days; `None`: without end.
    pub valid_days: Option<u32>,
    /// What the values are found from: a session, files, the bench itself.
    pub source: String,
    /// Settings to which the values belong.
    pub settings: Settings,
}

impl Measurement {
    /// A measurement on a rig, now, at the settings of its camera.
    pub fn on(rig: &RigConfig) -> Self {
        Self {
            rig: rig.name.clone(),
            device_serial: rig.camera.serial.clone().unwrap_or_default(),
            id: None,
            date: Timestamp::now(),
            valid_days: None,
            source: match rig.is_simulated() {
                true => "rig calibrate, on the simulated bench".to_owned(),
                false => "rig calibrate".to_owned(),
            },
            settings: Settings {
                gain: Some(rig.camera.gain),
                bit_depth: Some(rig.camera.bit_depth),
                resolution_px: Some(rig.camera.resolution_px),
                ..Settings::default()
            },
        }
    }

    /// Name of its record of a kind.
    pub fn id(&self, kind: Kind) -> String {
        match &self.id {
            Some(id) => id.clone(),
            None => format!("{}-{}", self.date.strftime("%Y%m%dT%H%M%SZ"), kind.folder()),
        }
    }

    /// A record of values that were found by `method`.
    pub fn record<V: Values>(&self, values: V, method: &str) -> Record<V> {
        let written = |time: Timestamp| time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string();
        let until = |days: u32| self.date + SignedDuration::from_hours(24 * i64::from(days));
        Record {
            id: self.id(V::KIND),
            kind: V::KIND,
            rig: self.rig.clone(),
            device_serial: self.device_serial.clone(),
            date: written(self.date),
            valid_until: self.valid_days.map(|days| written(until(days))),
            method: method.to_owned(),
            source: self.source.clone(),
            settings: self.settings,
            values,
        }
    }
}
