//! The noise model that a rig's records stand for.

use super::flat::{FlatError, from_map};
use super::pixel_map::{MapError, PixelMap};
use super::record::{FlatValues, MapFile, ScaleValues, SensorValues};
use super::{Library, Loaded, RecordError};
use crate::config::ResolvedRig;
use crate::radiometry::linearity::Linearity;
use crate::radiometry::sensor::{DarkPattern, SensorNoise};

/// A record's map that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum NoiseError {
    /// The flat field.
    #[error(transparent)]
    Flat(#[from] FlatError),
    /// A map of the dark pattern.
    #[error(transparent)]
    Dark(#[from] MapError),
}

/// The noise model for merge and exposure planning, from a sensor's records.
/// Without a scale, radiances are in electrons per second.
///
/// # Errors
/// A map that is unreadable or of another size than `resolution_px`.
pub fn sensor_noise(
    sensor: &Loaded<SensorValues>,
    flat: Option<&Loaded<FlatValues>>,
    scale: Option<&ScaleValues>,
    resolution_px: [u32; 2],
) -> Result<SensorNoise, NoiseError> {
    let mut noise = noise_without_maps(&sensor.record.values, scale, resolution_px);
    if let Some(loaded) = flat {
        let values = &loaded.record.values;
        let bytes = bytes_of(&loaded.files, &values.map);
        noise.flat_field = Some(from_map(values, bytes, resolution_px)?);
    }
    if let Some(dark) = &sensor.record.values.dark_pattern {
        let read = |map: &PixelMap| map.read(bytes_of(&sensor.files, &map.map), resolution_px);
        let [[offset_dn2, remaining_covariance], [_, dark_e2_s2]] = dark.covariance;
        noise.dark_pattern = Some(DarkPattern {
            offset_dn: read(&dark.offset_dn)?,
            dark_current_e_s: read(&dark.dark_current_e_s)?,
            remaining_covariance,
        });
        noise.black_level_spread_dn = offset_dn2.sqrt();
        noise.dark_current_spread_e_s = dark_e2_s2.sqrt();
    }
    Ok(noise)
}

/// Why a rig's records describe no frames.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum FrameNoiseError {
    #[error("there is no sensor record in {place}")]
    NoSensor { place: String },
    #[error(
        "the frames have {} x {} pixels, the rig's camera {} x {}",
        frames[0], frames[1], camera[0], camera[1]
    )]
    OtherSize { frames: [u32; 2], camera: [u32; 2] },
    /// A record.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A map.
    #[error(transparent)]
    Map(#[from] NoiseError),
}

/// The noise model of frames of this size that the camera of a rig took.
pub fn noise_of_frames(
    rig: &ResolvedRig,
    frames: [u32; 2],
) -> Result<SensorNoise, FrameNoiseError> {
    let library = Library::of_rig(rig);
    let (pins, config) = (&rig.config.calibration, &rig.config.camera);
    let sensor = library.load_for(pins.sensor.as_deref(), config.gain)?;
    let sensor = sensor.ok_or_else(|| FrameNoiseError::NoSensor {
        place: library.place(),
    })?;
    let flat = library.load_for::<FlatValues>(pins.flat.as_deref(), config.gain)?;
    let scale = library.load_for::<ScaleValues>(pins.scale.as_deref(), config.gain)?;
    let camera = config.resolution_px;
    if frames != camera {
        return Err(FrameNoiseError::OtherSize { frames, camera });
    }
    let scale = scale.as_ref().map(|loaded| &loaded.record.values);
    Ok(sensor_noise(&sensor, flat.as_ref(), scale, frames)?)
}

/// The same without what single pixels do, apart from hot ones.
pub fn noise_without_maps(
    sensor: &SensorValues,
    scale: Option<&ScaleValues>,
    resolution_px: [u32; 2],
) -> SensorNoise {
    let [width, height] = resolution_px.map(|n| n as usize);
    let mut hot = vec![false; width * height];
    for &[column, row] in &sensor.hot_pixels {
        let (column, row) = (column as usize, row as usize);
        if column < width && row < height {
            hot[row * width + column] = true;
        }
    }
    SensorNoise {
        gain_dn_per_e: sensor.gain_dn_per_e.value,
        read_noise_e: sensor.read_noise_e.value,
        black_level_dn: sensor.black_level_dn.value,
        black_level_std_dn: sensor.black_level_dn.std,
        black_level_spread_dn: sensor.black_level_spread_dn.value,
        saturation_dn: sensor.saturation_dn,
        linear_max_dn: sensor.linear_max_dn,
        linearity: sensor.linearity.unwrap_or(Linearity::NONE),
        dark_current_e_s: sensor.dark_current_e_s.value,
        dark_current_spread_e_s: sensor.dark_current_spread_e_s.value,
        bit_depth: sensor.bit_depth,
        responsivity_e_s: scale.map_or(1.0, |scale| scale.responsivity_e_s.value),
        flat_field: None,
        dark_pattern: None,
        hot_pixels: Some(hot),
    }
}

/// A record's file; empty where it has none of that name.
fn bytes_of<'a>(files: &'a [(String, Vec<u8>)], map: &MapFile) -> &'a [u8] {
    let found = files.iter().find(|(file, _)| *file == map.file);
    found.map_or(&[], |(_, bytes)| bytes)
}
