//! The calibration records that a capture uses, and their copies in the session.

use jiff::Timestamp;

use super::findings::{Notice, PrepareError};
use crate::calibration::camera::CameraValues;
use crate::calibration::directions::DirectionsValues;
use crate::calibration::fitness::Concern;
use crate::calibration::glare::GlareValues;
use crate::calibration::noise::sensor_noise;
use crate::calibration::pose::PoseValues;
use crate::calibration::record::{
    FlatValues, LampValues, LightsValues, ScaleValues, SensorValues, Values,
};
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, Loaded, RecordError};
use crate::config::RigConfig;
use crate::radiometry::sensor::SensorNoise;

/// The calibration of a bench, as far as there are records of it.
pub struct Records {
    /// Where they were looked for.
    searched: String,
    sensor: Option<Loaded<SensorValues>>,
    flat: Option<Loaded<FlatValues>>,
    scale: Option<Loaded<ScaleValues>>,
    lights: Option<Loaded<LightsValues>>,
    lamp: Option<Loaded<LampValues>>,
    directions: Option<Loaded<DirectionsValues>>,
    focus: Option<Loaded<FocusValues>>,
    /// Only where the rig names it: it is valid until somebody touches the sample.
    pose: Option<Loaded<PoseValues>>,
    camera: Option<Loaded<CameraValues>>,
    glare: Option<Loaded<GlareValues>>,
}

/// A copy of a record's file for a session.
pub struct RecordCopy {
    /// `<kind>/<file>`.
    pub name: String,
    /// Whether it is the record itself, not a file that the record names.
    pub is_record: bool,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl Records {
    /// The records that the rig names, else the newest; each must be the camera's.
    ///
    /// # Errors
    /// A record that cannot be read or belongs to another camera.
    pub fn load(library: &Library, config: &RigConfig) -> Result<Self, RecordError> {
        let ids = &config.calibration;
        let serial = config.camera.serial.as_deref().unwrap_or_default();
        let gain = config.camera.gain;
        let records = Self {
            searched: library.place(),
            sensor: library.load_for(ids.sensor.as_deref(), gain)?,
            flat: library.load_for(ids.flat.as_deref(), gain)?,
            scale: library.load_for(ids.scale.as_deref(), gain)?,
            lights: library.load(ids.lights.as_deref())?,
            lamp: library.load(None)?,
            directions: library.load(ids.directions.as_deref())?,
            focus: library.load(ids.focus.as_deref())?,
            pose: match &ids.pose {
                Some(id) => library.load(Some(id))?,
                None => None,
            },
            camera: library.load(ids.camera.as_deref())?,
            glare: library.load(ids.glare.as_deref())?,
        };
        if let Some(sensor) = &records.sensor {
            sensor.check_camera(serial, &config.camera)?;
        }
        if let Some(flat) = &records.flat {
            flat.check_camera(serial, &config.camera)?;
        }
        if let Some(camera) = &records.camera {
            camera.check_camera(serial, &config.camera)?;
        }
        if let Some(glare) = &records.glare {
            glare.check_camera(serial, &config.camera)?;
        }
        Ok(records)
    }

    /// The sensor's noise by the copies in a session.
    ///
    /// # Errors
    /// As [`Self::noise`], or a copy that cannot be read.
    pub fn noise_of_copies(
        copies: &Library,
        config: &RigConfig,
    ) -> Result<SensorNoise, PrepareError> {
        noise(
            copies.load(None)?.as_ref(),
            copies.load(None)?.as_ref(),
            copies.load(None)?.as_ref(),
            copies.place(),
            config,
        )
    }

    /// The sensor's noise, for the merge and the choice of exposures.
    ///
    /// # Errors
    /// No sensor record, or a map that cannot be used.
    pub fn noise(&self, config: &RigConfig) -> Result<SensorNoise, PrepareError> {
        noise(
            self.sensor.as_ref(),
            self.flat.as_ref(),
            self.scale.as_ref(),
            self.searched.clone(),
            config,
        )
    }

    /// Id of the record of the sensor's noise, if there is one.
    pub fn sensor_id(&self) -> Option<&str> {
        self.sensor.as_ref().map(|loaded| loaded.record.id.as_str())
    }

    /// What is known of the camera's sharpness.
    pub fn focus(&self) -> Option<&FocusValues> {
        self.focus.as_ref().map(|loaded| &loaded.record.values)
    }

    /// Reports what speaks against these records now.
    pub fn check(&self, config: &RigConfig, now: Timestamp, notice: &mut dyn FnMut(Notice<'_>)) {
        for record in self.all() {
            for concern in record.concerns(config, now) {
                let kind = record.kind();
                notice(Notice::Record { kind, concern });
            }
        }
        let stated_s = config.capture.lamp_warm_up.0;
        let needed_s = (self.lamp.as_ref()).map_or(0.0, |lamp| lamp.record.values.warm_up_time_s);
        if stated_s < needed_s {
            notice(Notice::WarmUp { needed_s, stated_s });
        }
    }

    /// Reports the records that were measured with the sensor warmer or colder than
    /// `sensor_c`, by more than the rig file allows.
    pub fn check_temperature(
        &self,
        config: &RigConfig,
        sensor_c: Option<f64>,
        notice: &mut dyn FnMut(Notice<'_>),
    ) {
        fn of<V>(record: &Option<Loaded<V>>, is_c: Option<f64>, allowed_c: f64) -> Option<Concern> {
            record.as_ref()?.temperature_concern(is_c, allowed_c)
        }
        let allowed_c = config.limits.record_differs_c;
        let concerns = [
            of(&self.sensor, sensor_c, allowed_c),
            of(&self.flat, sensor_c, allowed_c),
            of(&self.scale, sensor_c, allowed_c),
            of(&self.lamp, sensor_c, allowed_c),
        ];
        for concern in concerns.into_iter().flatten() {
            notice(Notice::Temperature(concern));
        }
    }

    /// Copies of all their files.
    pub fn copies(&self) -> Vec<RecordCopy> {
        self.all()
            .into_iter()
            .flat_map(|record| record.copies())
            .collect()
    }

    fn all(&self) -> Vec<&dyn AnyRecord> {
        fn of<V: Values>(record: &Option<Loaded<V>>) -> Option<&dyn AnyRecord> {
            record.as_ref().map(|record| record as &dyn AnyRecord)
        }
        let records = [
            of(&self.sensor),
            of(&self.flat),
            of(&self.scale),
            of(&self.lights),
            of(&self.lamp),
            of(&self.directions),
            of(&self.focus),
            of(&self.pose),
            of(&self.camera),
            of(&self.glare),
        ];
        records.into_iter().flatten().collect()
    }
}

fn noise(
    sensor: Option<&Loaded<SensorValues>>,
    flat: Option<&Loaded<FlatValues>>,
    scale: Option<&Loaded<ScaleValues>>,
    searched: String,
    config: &RigConfig,
) -> Result<SensorNoise, PrepareError> {
    let sensor = sensor.ok_or(PrepareError::NoSensorRecord { searched })?;
    let scale = scale.map(|loaded| &loaded.record.values);
    Ok(sensor_noise(
        sensor,
        flat,
        scale,
        config.camera.resolution_px,
    )?)
}

/// A record of whatever kind.
trait AnyRecord {
    fn kind(&self) -> crate::calibration::record::Kind;
    fn concerns(&self, config: &RigConfig, now: Timestamp) -> Vec<Concern>;
    fn copies(&self) -> Vec<RecordCopy>;
}

impl<V: Values> AnyRecord for Loaded<V> {
    fn kind(&self) -> crate::calibration::record::Kind {
        V::KIND
    }

    fn concerns(&self, config: &RigConfig, now: Timestamp) -> Vec<Concern> {
        let serial = config.camera.serial.as_deref().unwrap_or_default();
        self.concerns_on(config.is_simulated(), serial, &config.camera, now)
    }

    fn copies(&self) -> Vec<RecordCopy> {
        let copy = |(index, (name, bytes)): (usize, &(String, Vec<u8>))| RecordCopy {
            name: format!("{}/{name}", V::KIND.folder()),
            is_record: index == 0,
            bytes: bytes.clone(),
        };
        self.files.iter().enumerate().map(copy).collect()
    }
}
