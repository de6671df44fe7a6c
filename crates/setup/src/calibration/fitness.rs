//! Whether a record may be used today, on this camera, at this gain.

use jiff::Timestamp;

use super::record::Kind;
use super::{Loaded, RecordError, Seal};
use crate::config::CameraConfig;

/// What speaks against a record.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum Concern {
    /// It belongs to another camera or setting: a capture refuses it.
    #[error(transparent)]
    Other(#[from] RecordError),
    /// Its values are not those that were measured.
    #[error("record {id} was changed after the measurement: its checksum is of other values")]
    Changed { id: String },
    /// Its own date of expiry has passed.
    #[error("record {id} was valid until {until}")]
    Expired {
        id: String,
        /// UTC, RFC 3339.
        until: String,
    },
    #[error("record {id} is {days:.0} days old; such records usually hold for {usual_days:.0}")]
    Old {
        id: String,
        days: f64,
        usual_days: f64,
    },
    #[error("record {id} was measured with the sensor at {then_c:.1} °C; it has {now_c:.1} °C now")]
    Temperature { id: String, then_c: f64, now_c: f64 },
    /// It was made in the future: a clock is wrong.
    #[error("record {id} is dated {date}, which is in the future")]
    Future {
        id: String,
        /// UTC, RFC 3339.
        date: String,
    },
}

impl Kind {
    /// How long such a measurement usually holds on an untouched bench, days: a
    /// sensor ages slowly, dust and lamps do not wait.
    pub fn usual_days(self) -> f64 {
        match self {
            Kind::Sensor | Kind::Response | Kind::Camera => 365.0,
            Kind::Scale => 180.0,
            Kind::Flat | Kind::Directions | Kind::Focus | Kind::Glare => 90.0,
            Kind::Lights | Kind::Lamp => 30.0,
            // Until the sample is touched.
            Kind::Pose => 7.0,
        }
    }

    /// The part of `rig calibrate` that measures it.
    pub fn command(self) -> &'static str {
        match self {
            Kind::Scale => "flat --radiance L --radiance-std U",
            Kind::Lights => "white",
            Kind::Directions => "lights",
            Kind::Pose => "pose SESSION",
            Kind::Focus => "focus EXR… --heights MM,…",
            Kind::Camera => "camera VIEWS --squares N,M --square MM",
            other => other.folder(),
        }
    }

    /// Whether it belongs to one camera at its settings.
    pub fn is_of_the_camera(self) -> bool {
        matches!(
            self,
            Kind::Sensor
                | Kind::Flat
                | Kind::Scale
                | Kind::Pose
                | Kind::Focus
                | Kind::Camera
                | Kind::Glare
        )
    }
}

impl<V> Loaded<V> {
    /// What speaks against using this record now; nothing if it fits. An
    /// empty `serial` (the camera has none) matches every record.
    fn concerns(&self, serial: &str, camera: &CameraConfig, now: Timestamp) -> Vec<Concern> {
        let record = &self.record;
        let mut concerns = Vec::new();
        if record.kind.is_of_the_camera()
            && let Err(error) = self.check_camera(serial, camera)
        {
            concerns.push(error.into());
        }
        let id = || record.id.clone();
        if self.seal == Seal::Broken {
            concerns.push(Concern::Changed { id: id() });
        }
        if self.is_expired(now) {
            let until = record.valid_until.clone().unwrap_or_default();
            concerns.push(Concern::Expired { id: id(), until });
        }
        let days = self.age_days(now);
        let usual_days = record.kind.usual_days();
        // A clock may be a day off, as time zones are.
        if days < -1.0 {
            let date = record.date.clone();
            concerns.push(Concern::Future { id: id(), date });
        } else if record.valid_until.is_none() && days > usual_days {
            concerns.push(Concern::Old {
                id: id(),
                days,
                usual_days,
            });
        }
        concerns
    }

    /// As `concerns`; a simulated bench does not age.
    pub fn concerns_on(
        &self,
        is_simulated: bool,
        serial: &str,
        camera: &CameraConfig,
        now: Timestamp,
    ) -> Vec<Concern> {
        let ages = |c: &Concern| matches!(c, Concern::Old { .. } | Concern::Future { .. });
        let mut concerns = self.concerns(serial, camera, now);
        concerns.retain(|concern| !(is_simulated && ages(concern)));
        concerns
    }

    /// Whether the sensor's temperature, `now_c`, differs from that of the measurement by
    /// more than `allowed_c`, as far as both are known. A lamp is cold before every
    /// capture, so its temperature is not compared.
    pub fn temperature_concern(&self, now_c: Option<f64>, allowed_c: f64) -> Option<Concern> {
        let (then_c, now_c) = (self.record.settings.sensor_c?, now_c?);
        ((then_c - now_c).abs() > allowed_c).then(|| Concern::Temperature {
            id: self.record.id.clone(),
            then_c,
            now_c,
        })
    }

    /// Days since it was measured.
    pub fn age_days(&self, now: Timestamp) -> f64 {
        let date = self.record.date.parse::<Timestamp>().unwrap_or(now);
        (now.as_second() - date.as_second()) as f64 / 86_400.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Library;
    use crate::calibration::record::SensorValues;

    #[test]
    fn age_end_and_other_devices_speak_against_a_record() {
        let root = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
        let rig = crate::config::RigConfig::load(&root.join("rig-configs/simulated.toml")).unwrap();
        let library = Library::Folder(root.join("calibration/simulated"));
        let mut loaded: Loaded<SensorValues> = library.load(None).unwrap().unwrap();
        let date: Timestamp = loaded.record.date.parse().unwrap();
        let later = |days: i64| date + jiff::SignedDuration::from_hours(24 * days);
        let facts = |loaded: &Loaded<SensorValues>, serial: &str, now| {
            let concerns = loaded.concerns_on(false, serial, &rig.camera, now);
            concerns.iter().map(Concern::to_string).collect::<Vec<_>>()
        };
        assert!(facts(&loaded, "SIM-0001", later(10)).is_empty());
        let other = facts(&loaded, "SIM-0002", later(10));
        assert!(
            other.len() == 1 && other[0].contains("SIM-0002"),
            "{other:?}"
        );
        let old = facts(&loaded, "SIM-0001", later(400));
        assert!(old.len() == 1 && old[0].contains("400 days old"), "{old:?}");
        assert!(
            loaded
                .concerns_on(true, "", &rig.camera, later(400))
                .is_empty()
        );
        let early = facts(&loaded, "SIM-0001", later(-3));
        assert!(early.len() == 1 && early[0].contains("future"), "{early:?}");
        let warmer = |loaded: &Loaded<SensorValues>, now_c| {
            let concern = loaded.temperature_concern(now_c, 10.0);
            concern.map(|concern| concern.to_string())
        };
        loaded.record.settings.sensor_c = None;
        assert_eq!(warmer(&loaded, Some(80.0)), None);
        loaded.record.settings.sensor_c = Some(31.0);
        assert_eq!(warmer(&loaded, None), None);
        assert_eq!(warmer(&loaded, Some(40.9)), None);
        assert_eq!(warmer(&loaded, Some(21.1)), None);
        for now_c in [41.1, 20.9] {
            let text = warmer(&loaded, Some(now_c)).unwrap();
            assert!(text.contains("31.0 °C"), "{text}");
        }
        loaded.record.valid_until = Some(later(30).to_string());
        assert!(facts(&loaded, "SIM-0001", later(29)).is_empty());
        let expired = facts(&loaded, "SIM-0001", later(400));
        assert!(
            expired.len() == 1 && expired[0].contains("valid until"),
            "{expired:?}"
        );
    }
}
