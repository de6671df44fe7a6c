//! Black level and full well of the sensor, for marks on a histogram.

use serde::Serialize;

use crate::calibration::record::SensorValues;
use crate::calibration::{Library, Loaded};
use crate::config::{CameraConfig, ResolvedRig};

/// Gains that differ by less, relatively, are one.
const SAME_GAIN: f64 = 1e-3;

/// The sensor's levels as its calibration record states them; both `None` without a record
/// that belongs to the gain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SensorLevels {
    /// Mean count without light at zero exposure, DN.
    pub black_dn: Option<f64>,
    /// Count at which a pixel's well is full, DN: black level and system gain times the full
    /// well of the record, at most the largest count of the bit depth.
    pub full_well_dn: Option<f64>,
}

/// The rig's sensor records, from which [`SensorLevels`] come.
#[derive(Clone, Debug)]
pub struct SensorRecords {
    library: Library,
    named: Option<String>,
    camera: CameraConfig,
}

impl SensorRecords {
    /// Those of a rig.
    pub fn of(rig: &ResolvedRig) -> Self {
        Self {
            library: Library::of_rig(rig),
            named: rig.config.calibration.sensor.clone(),
            camera: rig.config.camera.clone(),
        }
    }

    /// The levels at a gain, a factor. A record that cannot be read, or is another camera's,
    /// gives none: `rig doctor` reports it.
    pub fn levels(&self, gain: f64) -> SensorLevels {
        let loaded = self
            .library
            .load_for::<SensorValues>(self.named.as_deref(), gain);
        match loaded {
            Ok(Some(loaded)) if self.belongs(&loaded, gain) => levels_of(&loaded.record.values),
            _ => SensorLevels::default(),
        }
    }

    fn belongs(&self, loaded: &Loaded<SensorValues>, gain: f64) -> bool {
        let own = loaded.record.settings.gain;
        let serial = self.camera.serial.as_deref().unwrap_or_default();
        // The gain is that of the live picture, which may not be the rig file's.
        let camera = CameraConfig {
            gain: own.unwrap_or(gain),
            ..self.camera.clone()
        };
        loaded.check_camera(serial, &camera).is_ok()
            && own.is_none_or(|own| (own - gain).abs() <= SAME_GAIN * own)
    }
}

fn levels_of(values: &SensorValues) -> SensorLevels {
    let black_dn = values.black_level_dn.value;
    let full_well_dn = black_dn + values.gain_dn_per_e.value * values.full_well_e.value;
    let largest_dn = f64::from((1_u32 << values.bit_depth) - 1);
    SensorLevels {
        black_dn: Some(black_dn),
        full_well_dn: Some(full_well_dn.min(largest_dn)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Surroundings, resolve_rig};

    #[test]
    fn the_simulated_rig_has_levels_at_the_gain_of_its_record_alone() {
        let surroundings = Surroundings::of_process();
        let rig = resolve_rig(Some("simulated"), &surroundings, Vec::new).unwrap();
        let records = SensorRecords::of(&rig);
        let levels = records.levels(rig.config.camera.gain);
        let (black_dn, full_well_dn) = (levels.black_dn.unwrap(), levels.full_well_dn.unwrap());
        assert!((10.0..200.0).contains(&black_dn), "{black_dn}");
        assert!((2000.0..=4095.0).contains(&full_well_dn), "{full_well_dn}");
        let other = records.levels(7.0 * rig.config.camera.gain);
        assert_eq!(other, SensorLevels::default());
    }
}
