//! The calibration records that a capture goes by, and their copies in the session.

use super::CliError;
use crate::calibration::record::{FlatValues, LightsValues, ScaleValues, SensorValues, Values};
use crate::calibration::{Library, Loaded, noise::sensor_noise};
use crate::config::RigConfig;
use crate::radiometry::sensor::SensorNoise;

/// The calibration that a capture goes by.
pub(super) struct Records {
    sensor: Loaded<SensorValues>,
    flat: Option<Loaded<FlatValues>>,
    scale: Option<Loaded<ScaleValues>>,
    lights: Option<Loaded<LightsValues>>,
}

impl Records {
    /// The records that the rig names, else the newest; each must be the camera's.
    pub(super) fn load(library: &Library, config: &RigConfig) -> Result<Self, CliError> {
        let ids = &config.calibration;
        let serial = config.camera.serial.as_deref().unwrap_or_default();
        let records = Self {
            sensor: sensor(library, ids.sensor.as_deref())?,
            flat: library.load(ids.flat.as_deref())?,
            scale: library.load(ids.scale.as_deref())?,
            lights: library.load(ids.lights.as_deref())?,
        };
        records.sensor.check_camera(serial, &config.camera)?;
        if let Some(flat) = &records.flat {
            flat.check_camera(serial, &config.camera)?;
        }
        Ok(records)
    }

    /// The copies in a session.
    pub(super) fn load_copies(library: &Library) -> Result<Self, CliError> {
        Ok(Self {
            sensor: sensor(library, None)?,
            flat: library.load(None)?,
            scale: library.load(None)?,
            lights: library.load(None)?,
        })
    }

    pub(super) fn noise(&self, config: &RigConfig) -> Result<SensorNoise, CliError> {
        let scale = self.scale.as_ref().map(|loaded| &loaded.record.values);
        let sensor = &self.sensor.record.values;
        Ok(sensor_noise(
            sensor,
            self.flat.as_ref(),
            scale,
            config.camera.resolution_px,
        )?)
    }

    /// `<kind>/<file>`, whether it is the record itself, and its bytes.
    pub(super) fn copies(&self) -> Vec<(String, bool, Vec<u8>)> {
        let mut copies = Vec::new();
        add_copies(&mut copies, Some(&self.sensor));
        add_copies(&mut copies, self.flat.as_ref());
        add_copies(&mut copies, self.scale.as_ref());
        add_copies(&mut copies, self.lights.as_ref());
        copies
    }
}

fn sensor(library: &Library, id: Option<&str>) -> Result<Loaded<SensorValues>, CliError> {
    let found = library.load::<SensorValues>(id)?;
    found.ok_or_else(|| {
        CliError::new(format!("there is no sensor record in {}", library.place()))
            .hint("measure the sensor once with `rig calibrate sensor`")
    })
}

fn add_copies<V: Values>(copies: &mut Vec<(String, bool, Vec<u8>)>, loaded: Option<&Loaded<V>>) {
    let files = loaded.iter().flat_map(|loaded| &loaded.files);
    for (index, (name, bytes)) in files.enumerate() {
        let name = format!("{}/{name}", V::KIND.folder());
        copies.push((name, index == 0, bytes.clone()));
    }
}
