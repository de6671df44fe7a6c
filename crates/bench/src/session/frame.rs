//! A raw frame's two files: 16-bit PNG of the counts, and the sidecar that says
//! how it was taken.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError};
use serde::{Deserialize, Serialize};

use crate::device::retake::Retakes;
use crate::device::{CameraSettings, FrameKey, LampState, Mosaic, RawFrame};
use crate::units::{Seconds, StageAngles};

/// How a raw frame was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sidecar {
    /// Its place in the plan.
    pub key: FrameKey,
    /// Whether it served to choose the exposures and is no part of the bracket.
    pub pilot: bool,
    /// As the stage read it back.
    pub lamp: LampState,
    /// Settings requested.
    pub requested: CameraSettings,
    /// Settings read back from the camera.
    pub applied: CameraSettings,
    /// Count without light, DN, after the sensor's calibration.
    pub black_level_dn: f64,
    /// Significant bits of a count.
    pub bit_depth: u32,
    /// Colour filters.
    pub mosaic: Mosaic,
    /// The camera's serial number.
    pub camera_serial: String,
    /// Where the stage was sent.
    pub stage_target: StageAngles,
    /// Where it reports it is.
    pub stage_position: StageAngles,
    /// Frames thrown away after the last change of settings, before this one.
    pub frames_discarded: u32,
    /// Signal per exposure time over that of the frame before at other settings
    /// (of a light's last frames: over its first at the same), where both say
    /// enough; 1 if the exposures are what they claim and the lamp is steady.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_ratio: Option<f64>,
    /// Standard uncertainty of that ratio from noise, where it compares the lamp with itself:
    /// in a light's last frames, and in those of the first light's second visit. Absent in
    /// sessions of before it was recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lamp_ratio_std: Option<f64>,
    /// What a repetition of the same capture does not share.
    pub time: FrameTimes,
}

impl Sidecar {
    /// Of a frame that another program has taken, as the merge needs it: at the zenith, by a
    /// sensor of 12 bits without colour filters and a black level of 64 DN, as requested.
    pub fn of_frame(key: FrameKey, lamp: LampState, settings: CameraSettings) -> Self {
        let zenith = StageAngles::new(0.0, 90.0);
        Self {
            key,
            pilot: false,
            lamp,
            requested: settings,
            applied: settings,
            black_level_dn: 64.0,
            bit_depth: 12,
            mosaic: Mosaic::None,
            camera_serial: String::new(),
            stage_target: zenith,
            stage_position: zenith,
            frames_discarded: 0,
            exposure_ratio: None,
            lamp_ratio_std: None,
            time: FrameTimes {
                utc: String::new(),
                monotonic_s: Seconds(0.0),
                device_s: None,
                device_sequence: None,
                sensor_c: None,
                lamp_c: None,
                retakes: Retakes::default(),
            },
        }
    }
}

/// When a frame was taken, the device's running number, and what disturbed it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameTimes {
    /// When it arrived, RFC 3339, UTC.
    pub utc: String,
    /// When it arrived, since the start of the program's run.
    pub monotonic_s: Seconds,
    /// Start of the frame on the device's own clock, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device_s: Option<Seconds>,
    /// The device's running number, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device_sequence: Option<u64>,
    /// Temperature of the sensor when it arrived, °C, where the camera reports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_c: Option<f64>,
    /// Temperature of the lamp, °C, where the stage reports; at most some seconds old.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lamp_c: Option<f64>,
    /// What went wrong before the frame was right.
    #[serde(default, skip_serializing_if = "Retakes::is_none")]
    pub retakes: Retakes,
}

/// The counts as a greyscale PNG of 16 bits, quickly compressed.
///
/// # Errors
/// If the counts are not `width · height`, or the encoder says so.
pub fn encode_png(frame: &RawFrame) -> Result<Vec<u8>, String> {
    let pixels = frame.width as usize * frame.height as usize;
    if frame.counts.len() != pixels {
        return Err(format!(
            "a frame of {} x {} has {} counts",
            frame.width,
            frame.height,
            frame.counts.len()
        ));
    }
    let mut png = Vec::with_capacity(2 * pixels);
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub)
        .write_image(
            bytemuck::cast_slice(&frame.counts),
            frame.width,
            frame.height,
            ExtendedColorType::L16,
        )
        .map_err(|e| e.to_string())?;
    Ok(png)
}

/// Deflate (RFC 1951) makes at most 1032 bytes of one.
const MAX_EXPANSION: u64 = 1032;

/// The counts of a greyscale 16-bit PNG. A declared size that the file cannot
/// hold is refused before anything is allocated.
pub fn decode_png(png: &[u8]) -> Result<RawFrame, String> {
    let text = |e: ImageError| e.to_string();
    let decoder = PngDecoder::new(Cursor::new(png)).map_err(text)?;
    let (width, height) = decoder.dimensions();
    if decoder.color_type() != ColorType::L16 {
        return Err(format!("{:?} pixels instead of L16", decoder.color_type()));
    }
    let bytes = u64::from(width) * u64::from(height) * 2;
    if bytes > MAX_EXPANSION * png.len() as u64 {
        let held = png.len();
        return Err(format!(
            "{width} x {height} pixels cannot be held by {held} bytes"
        ));
    }
    let mut counts = vec![0u16; (bytes / 2) as usize];
    decoder
        .read_image(bytemuck::cast_slice_mut(&mut counts))
        .map_err(text)?;
    Ok(RawFrame::new(width, height, counts))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(width: u32, height: u32) -> RawFrame {
        RawFrame {
            width,
            height,
            counts: (0..width * height)
                .map(|i| (i * 4099 % 65536) as u16)
                .collect(),
            sequence: None,
            timestamp: None,
        }
    }

    #[test]
    fn counts_survive() {
        let frame = frame(37, 11);
        assert_eq!(decode_png(&encode_png(&frame).unwrap()).unwrap(), frame);
    }

    #[test]
    fn a_frame_of_the_wrong_size_is_refused() {
        let mut frame = frame(4, 4);
        frame.counts.pop();
        assert!(encode_png(&frame).is_err());
    }

    /// A header that declares 2³⁰ × 2³⁰ pixels, with its CRC right.
    #[test]
    fn a_declared_size_beyond_the_file_is_refused() {
        let mut png = encode_png(&frame(4, 4)).unwrap();
        png[16..24].copy_from_slice(&[0x40, 0, 0, 0, 0x40, 0, 0, 0]);
        let crc = crc32fast::hash(&png[12..29]);
        png[29..33].copy_from_slice(&crc.to_be_bytes());
        assert!(decode_png(&png).is_err());
    }

    proptest! {
        #[test]
        fn broken_files_never_panic(at in 0usize..400, garbage in any::<[u8; 4]>()) {
            let mut png = encode_png(&frame(9, 9)).unwrap();
            let at = at % (png.len() - 4);
            png[at..at + 4].copy_from_slice(&garbage);
            let _ = decode_png(&png);
            let _ = decode_png(&png[..at]);
        }
    }
}
