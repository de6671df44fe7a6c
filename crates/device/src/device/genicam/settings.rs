//! Settings of a camera that waits for triggers: set, and read back as it rounds them.

use super::choice::Choice;
use super::features::Features;
use super::pixels::{self, PixelFormat};
use crate::device::{CameraInfo, CameraSettings, DeviceError};
use crate::units::Seconds;

/// Current name, and the one of SFNC 1.
const EXPOSURE: [&str; 2] = ["ExposureTime", "ExposureTimeAbs"];
const SERIAL: [&str; 2] = ["DeviceSerialNumber", "DeviceID"];
const GAIN: &str = "Gain";
/// Of SFNC 1: counts of no known unit.
const RAW_GAIN: &str = "GainRaw";
const TEMPERATURE: &str = "DeviceTemperature";
const US: f64 = 1e-6;
/// An exposure that is read back further from the one that was set, as a part of it and in
/// steps of the camera, was not set.
const ROUNDING: (f64, f64) = (0.2, 2.0);

/// Checks which camera it is, sets everything manual, a frame at each trigger, the rig
/// file's features and the pixel format. Returns what the camera is and its format.
///
/// # Errors
/// It is not the one that the rig file describes, or does not take a setting.
pub fn prepare(
    features: &Features,
    choice: &Choice,
    info: &CameraInfo,
) -> Result<(CameraInfo, PixelFormat), DeviceError> {
    // Which one.
    let serial = features.text(first_of(features, SERIAL));
    if !info.serial.is_empty() && info.serial != serial {
        return Err(features.not_applied("the camera's serial number", serial, &info.serial));
    }
    // Left from another program, it would lock the format.
    features.execute("AcquisitionStop")?;
    set_manual(features)?;
    for (feature, value) in &choice.features {
        features.set(feature, value)?;
    }
    // Format and size.
    let offered = features.choices("PixelFormat");
    let format = pixels::best_of(&offered, info.bit_depth, info.mosaic);
    let format = format.ok_or_else(|| {
        let wanted = format!(
            "a pixel format of {} bits and colour filters {}",
            info.bit_depth, info.mosaic
        );
        features.refused(&wanted, format!("it offers {}", offered.join(", ")))
    })?;
    features.choose("PixelFormat", format.name)?;
    let [width, height] = [features.integer("Width")?, features.integer("Height")?];
    if [width, height] != info.resolution_px.map(i64::from) {
        let wanted = format!("{} × {}", info.resolution_px[0], info.resolution_px[1]);
        let is = format!("{width} × {height}");
        return Err(features.not_applied("the size of a frame", is, &wanted));
    }
    // What it can do.
    let selector = "DeviceTemperatureSelector";
    if features
        .choices(selector)
        .iter()
        .any(|name| name == "Sensor")
    {
        features.choose(selector, "Sensor")?;
    }
    let exposure = first_of(features, EXPOSURE);
    if !features.has(exposure) {
        return Err(features.refused(exposure, "the camera has no such feature"));
    }
    let [shortest, longest] = features.bounds(exposure)?.map(|us| us * US);
    let [least, most] = info.exposure_range.map(|stated| stated.0);
    let range = [shortest.max(least), longest.min(most)];
    if range[0] > range[1] {
        let reason = format!("its exposures are {shortest} s to {longest} s");
        return Err(features.refused(&format!("exposures of {least} s to {most} s"), reason));
    }
    let stated = features.step(exposure).map(|us| Seconds(us * US));
    let info = CameraInfo {
        model: features.text("DeviceModelName"),
        serial,
        exposure_range: range.map(Seconds),
        exposure_step: stated.unwrap_or(info.exposure_step),
        ..info.clone()
    };
    Ok((info, format))
}

/// The first of these that the camera has, else the first.
fn first_of(features: &Features, names: [&'static str; 2]) -> &'static str {
    let has = |name: &&str| features.has(name);
    names.into_iter().find(has).unwrap_or(names[0])
}

/// Everything manual, a frame at each trigger.
fn set_manual(features: &Features) -> Result<(), DeviceError> {
    for automatic in [
        "ExposureAuto",
        "GainAuto",
        "BlackLevelAuto",
        "BalanceWhiteAuto",
    ] {
        features.choose(automatic, "Off")?;
    }
    features.switch_off("GammaEnable")?;
    // A fixed rate of frames limits exposures.
    features.switch_off("AcquisitionFrameRateEnable")?;
    features.choose("ExposureMode", "Timed")?;
    features.choose("AcquisitionMode", "Continuous")?;
    // No other event waits for a trigger of its own.
    for selector in features.choices("TriggerSelector") {
        features.choose("TriggerSelector", &selector)?;
        features.choose("TriggerMode", "Off")?;
    }
    features.choose("TriggerSelector", "FrameStart")?;
    let is_triggered =
        features.choose("TriggerSource", "Software")? && features.choose("TriggerMode", "On")?;
    match is_triggered {
        true => Ok(()),
        false => Err(features.refused(
            "TriggerSource = Software",
            "the camera cannot be triggered by software",
        )),
    }
}

/// Sets gain and exposure and returns them as the camera has them.
///
/// # Errors
/// A setting is refused, or an exposure stays that is not the rounded one.
pub fn apply(
    features: &Features,
    requested: CameraSettings,
) -> Result<CameraSettings, DeviceError> {
    let gain = set_gain(features, requested.gain)?;
    let exposure = first_of(features, EXPOSURE);
    let [low, high] = features.bounds(exposure)?;
    let wanted_us = (requested.exposure.0 / US).max(low).min(high);
    let is_us = features.set_float(exposure, wanted_us)?;
    let (part, steps) = ROUNDING;
    let step_us = features.step(exposure).unwrap_or(1.0);
    if (is_us - wanted_us).abs() > (part * wanted_us).max(steps * step_us) {
        let [is, wanted] = [is_us, wanted_us].map(|us| format!("{us} µs"));
        return Err(features.not_applied(exposure, is, &wanted));
    }
    Ok(CameraSettings::new(Seconds(is_us * US), gain))
}

/// Gain as a factor of the camera's lowest. Cameras state decibels, or a factor without a
/// unit whose lowest is 1.
fn set_gain(features: &Features, factor: f64) -> Result<f64, DeviceError> {
    if !features.has(GAIN) {
        if factor != 1.0 {
            return Err(features.refused(GAIN, "the camera has no such feature, so only 1"));
        }
        if features.has(RAW_GAIN) {
            features.set_lowest(RAW_GAIN)?;
        }
        return Ok(1.0);
    }
    let [lowest, _] = features.bounds(GAIN)?;
    match features.unit(GAIN).as_str() {
        "dB" | "" if lowest < 0.5 => {
            let db = features.set_float(GAIN, lowest + 20.0 * factor.log10())?;
            Ok(10_f64.powf((db - lowest) / 20.0))
        }
        _ if lowest > 0.0 => Ok(features.set_float(GAIN, lowest * factor)? / lowest),
        unit => {
            let reason = format!("its unit is {unit:?}, neither dB nor a factor");
            Err(features.refused(GAIN, reason))
        }
    }
}

/// The sensor's temperature, °C, where the camera measures it.
pub fn temperature_c(features: &Features) -> Option<f64> {
    let has = features.has(TEMPERATURE);
    has.then(|| features.float(TEMPERATURE).ok()).flatten()
}
