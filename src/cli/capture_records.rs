//! The calibration records that a capture goes by, and their copies in the session.

use jiff::Timestamp;

use super::CliError;
use crate::calibration::camera::CameraValues;
use crate::calibration::directions::DirectionsValues;
use crate::calibration::fitness::Concern;
use crate::calibration::pose::PoseValues;
use crate::calibration::record::{
    FlatValues, LampValues, LightsValues, ScaleValues, SensorValues, Values,
};
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, Loaded, noise::sensor_noise};
use crate::config::RigConfig;
use crate::radiometry::sensor::SensorNoise;

/// The calibration that a capture goes by.
pub(super) struct Records {
    /// Where they were looked for.
    place: String,
    sensor: Option<Loaded<SensorValues>>,
    flat: Option<Loaded<FlatValues>>,
    scale: Option<Loaded<ScaleValues>>,
    lights: Option<Loaded<LightsValues>>,
    lamp: Option<Loaded<LampValues>>,
    directions: Option<Loaded<DirectionsValues>>,
    focus: Option<Loaded<FocusValues>>,
    /// Only where the rig names it: it holds until somebody touches the sample.
    pose: Option<Loaded<PoseValues>>,
    camera: Option<Loaded<CameraValues>>,
}

impl Records {
    /// The records that the rig names, else the newest; each must be the camera's.
    pub(super) fn load(library: &Library, config: &RigConfig) -> Result<Self, CliError> {
        let ids = &config.calibration;
        let serial = config.camera.serial.as_deref().unwrap_or_default();
        let gain = config.camera.gain;
        let records = Self {
            place: library.place(),
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
        Ok(records)
    }

    /// The copies in a session.
    pub(super) fn load_copies(library: &Library) -> Result<Self, CliError> {
        Ok(Self {
            place: library.place(),
            sensor: library.load(None)?,
            flat: library.load(None)?,
            scale: library.load(None)?,
            lights: library.load(None)?,
            lamp: library.load(None)?,
            directions: library.load(None)?,
            focus: library.load(None)?,
            pose: library.load(None)?,
            camera: library.load(None)?,
        })
    }

    /// What merge and exposure planning believe of the sensor.
    ///
    /// # Errors
    /// No sensor record, or a map that cannot be used.
    pub(super) fn noise(&self, config: &RigConfig) -> Result<SensorNoise, CliError> {
        let sensor = self.sensor.as_ref().ok_or_else(|| self.no_sensor())?;
        let scale = self.scale.as_ref().map(|loaded| &loaded.record.values);
        Ok(sensor_noise(
            sensor,
            self.flat.as_ref(),
            scale,
            config.camera.resolution_px,
        )?)
    }

    /// The record of the sensor's noise, if there is one.
    pub(super) fn sensor_id(&self) -> Option<&str> {
        self.sensor.as_ref().map(|loaded| loaded.record.id.as_str())
    }

    fn no_sensor(&self) -> CliError {
        CliError::new(format!("there is no sensor record in {}", self.place))
            .hint("measure the sensor once with `rig calibrate sensor`")
    }

    /// What is known of the camera's sharpness.
    pub(super) fn focus(&self) -> Option<&FocusValues> {
        self.focus.as_ref().map(|loaded| &loaded.record.values)
    }

    /// What speaks against these records now, with what to run.
    pub(super) fn concerns(&self, config: &RigConfig, now: Timestamp) -> Vec<String> {
        let mut concerns = Vec::new();
        add_concerns(&mut concerns, self.sensor.as_ref(), config, now);
        add_concerns(&mut concerns, self.flat.as_ref(), config, now);
        add_concerns(&mut concerns, self.scale.as_ref(), config, now);
        add_concerns(&mut concerns, self.lights.as_ref(), config, now);
        add_concerns(&mut concerns, self.lamp.as_ref(), config, now);
        add_concerns(&mut concerns, self.directions.as_ref(), config, now);
        add_concerns(&mut concerns, self.focus.as_ref(), config, now);
        add_concerns(&mut concerns, self.pose.as_ref(), config, now);
        add_concerns(&mut concerns, self.camera.as_ref(), config, now);
        if let Some(lamp) = &self.lamp {
            let needed_s = lamp.record.values.warm_up_time_s;
            let waited_s = config.capture.lamp_warm_up.0;
            if waited_s < needed_s {
                concerns.push(format!(
                    "lamp: it takes {needed_s:.0} s to warm up and capture.lamp_warm_up_s is \
                     {waited_s:.0}; set it to {:.0}",
                    needed_s.ceil()
                ));
            }
        }
        concerns
    }

    /// The records of the camera that were measured with a warmer or colder sensor than
    /// `sensor_c`.
    pub(super) fn temperature_concerns(
        &self,
        config: &RigConfig,
        sensor_c: Option<f64>,
    ) -> Vec<String> {
        let allowed_c = config.limits.record_differs_c;
        let concerns = [
            doubt(&self.sensor, sensor_c, allowed_c),
            doubt(&self.flat, sensor_c, allowed_c),
            doubt(&self.scale, sensor_c, allowed_c),
            doubt(&self.lamp, sensor_c, allowed_c),
        ];
        let known = concerns.into_iter().flatten();
        known
            .map(|concern| {
                format!("{concern}; let the camera warm up as it had then, or calibrate anew")
            })
            .collect()
    }

    /// `<kind>/<file>`, whether it is the record itself, and its bytes.
    pub(super) fn copies(&self) -> Vec<(String, bool, Vec<u8>)> {
        let mut copies = Vec::new();
        add_copies(&mut copies, self.sensor.as_ref());
        add_copies(&mut copies, self.flat.as_ref());
        add_copies(&mut copies, self.scale.as_ref());
        add_copies(&mut copies, self.lights.as_ref());
        add_copies(&mut copies, self.lamp.as_ref());
        add_copies(&mut copies, self.directions.as_ref());
        add_copies(&mut copies, self.focus.as_ref());
        add_copies(&mut copies, self.pose.as_ref());
        add_copies(&mut copies, self.camera.as_ref());
        copies
    }
}

/// What else to do about a record that does not match its checksum.
pub(super) const CHANGED_ON_PURPOSE: &str =
    ", or remove the record's line `checksum` if it was changed on purpose";

fn add_concerns<V: Values>(
    concerns: &mut Vec<String>,
    loaded: Option<&Loaded<V>>,
    config: &RigConfig,
    now: Timestamp,
) {
    let serial = config.camera.serial.as_deref().unwrap_or_default();
    if let Some(loaded) = loaded {
        for concern in loaded.concerns_on(config.is_simulated(), serial, &config.camera, now) {
            let (kind, command) = (V::KIND.folder(), V::KIND.command());
            let otherwise = match concern {
                Concern::Changed { .. } => CHANGED_ON_PURPOSE,
                _ => "",
            };
            concerns.push(format!(
                "{kind}: {concern}; run `rig calibrate {command}`{otherwise}"
            ));
        }
    }
}

fn doubt<V>(loaded: &Option<Loaded<V>>, sensor_c: Option<f64>, allowed_c: f64) -> Option<Concern> {
    loaded.as_ref()?.temperature_concern(sensor_c, allowed_c)
}

fn add_copies<V: Values>(copies: &mut Vec<(String, bool, Vec<u8>)>, loaded: Option<&Loaded<V>>) {
    let files = loaded.iter().flat_map(|loaded| &loaded.files);
    for (index, (name, bytes)) in files.enumerate() {
        let name = format!("{}/{name}", V::KIND.folder());
        copies.push((name, index == 0, bytes.clone()));
    }
}
