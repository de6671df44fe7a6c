//! The noise model that a rig's records stand for.

use super::Loaded;
use super::flat::{FlatError, from_map};
use super::record::{FlatValues, ScaleValues, SensorValues};
use crate::radiometry::linearity::Linearity;
use crate::radiometry::sensor::SensorNoise;

/// What merge and exposure planning believe of a sensor, from its records.
/// Without a scale, radiances are in electrons per second.
///
/// # Errors
/// A flat field whose map is unreadable or of another size than
/// `resolution_px`.
pub fn sensor_noise(
    sensor: &SensorValues,
    flat: Option<&Loaded<FlatValues>>,
    scale: Option<&ScaleValues>,
    resolution_px: [u32; 2],
) -> Result<SensorNoise, FlatError> {
    let [width, height] = resolution_px.map(|n| n as usize);
    let flat_field = match flat {
        None => None,
        Some(loaded) => {
            let name = &loaded.record.values.map.file;
            let bytes = loaded.files.iter().find(|(file, _)| file == name);
            let bytes = bytes.map_or(&[][..], |(_, bytes)| bytes);
            Some(from_map(&loaded.record.values, bytes, resolution_px)?)
        }
    };
    let mut hot = vec![false; width * height];
    for &[column, row] in &sensor.hot_pixels {
        let (column, row) = (column as usize, row as usize);
        if column < width && row < height {
            hot[row * width + column] = true;
        }
    }
    Ok(SensorNoise {
        gain_dn_per_e: sensor.gain_dn_per_e.value,
        read_noise_e: sensor.read_noise_e.value,
        black_level_dn: sensor.black_level_dn.value,
        black_level_spread_dn: sensor.black_level_spread_dn.value,
        saturation_dn: sensor.saturation_dn,
        linear_max_dn: sensor.linear_max_dn,
        linearity: sensor.linearity.unwrap_or(Linearity::NONE),
        dark_current_e_s: sensor.dark_current_e_s.value,
        dark_current_spread_e_s: sensor.dark_current_spread_e_s.value,
        bit_depth: sensor.bit_depth,
        responsivity_e_s: scale.map_or(1.0, |scale| scale.responsivity_e_s.value),
        flat_field,
        hot_pixels: Some(hot),
    })
}
