//! The format and size of a stream, agreed with the driver.

use v4l::video::Capture;
use v4l::{Device, FourCC};

use super::{V4lConfig, device_error};
use crate::device::DeviceError;
use crate::device::pixel_format::{PixelFormat, best_of, of_fourcc};

/// Sets format and size without leftovers of the old ones, and believes only
/// what comes back.
pub(super) fn set_format(
    device: &Device,
    config: &V4lConfig,
) -> Result<(PixelFormat, [u32; 2], u32), DeviceError> {
    let failed = |error| device_error(&config.device, error);
    let refused = |command: String, reason: String| DeviceError::Refused {
        device: config.device.clone(),
        command,
        reason,
    };
    let offered: Vec<[u8; 4]> = device
        .enum_formats()
        .map_err(failed)?
        .iter()
        .map(|description| description.fourcc.repr)
        .collect();
    let names = |codes: &[[u8; 4]]| codes.iter().map(name_of).collect::<Vec<_>>().join(", ");
    let mut wanted = match config.format {
        Some(code) => of_fourcc(code).ok_or_else(|| {
            refused(
                format!("format {}", names(&[code])),
                "not a format that can be read".to_owned(),
            )
        })?,
        None => best_of(&offered, config.bit_depth, config.preview)
            .ok_or_else(|| compressed(&config.device, &offered))?,
    };
    let bits = config.bit_depth.unwrap_or(wanted.bits);
    if !(1..=wanted.bits).contains(&bits) {
        let reason = format!("its samples have 1 to {} bits", wanted.bits);
        return Err(refused(format!("{bits} bits of {}", wanted.name()), reason));
    }
    wanted.bits = bits;
    let mut format = device.format().map_err(failed)?;
    if let Some([width, height]) = config.resolution_px {
        (format.width, format.height) = (width, height);
    }
    (format.fourcc, format.stride, format.size) = (FourCC::new(&wanted.fourcc), 0, 0);
    let (width, height) = (format.width, format.height);
    let applied = device.set_format(&format).map_err(failed)?;
    if applied.fourcc.repr != wanted.fourcc {
        let reason = format!("the camera offers {}", names(&offered));
        return Err(refused(format!("format {}", wanted.name()), reason));
    }
    if (applied.width, applied.height) != (width, height) {
        return Err(DeviceError::NotApplied {
            device: config.device.clone(),
            what: "the resolution".to_owned(),
            is: format!("{} × {}", applied.width, applied.height),
            wanted: format!("{width} × {height}"),
        });
    }
    Ok((wanted, [applied.width, applied.height], applied.stride))
}

fn name_of(code: &[u8; 4]) -> String {
    String::from_utf8_lossy(code).trim_end().to_owned()
}

fn compressed(device: &str, offered: &[[u8; 4]]) -> DeviceError {
    DeviceError::Compressed {
        device: device.to_owned(),
        offered: offered.iter().map(name_of).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_of_compressed_formats_says_which_it_offers() {
        let said = compressed("/dev/video0", &[*b"MJPG", *b"H264"]).to_string();
        assert!(said.ends_with("it offers MJPG, H264"), "{said}");
        let said = compressed("/dev/video0", &[]).to_string();
        assert!(said.ends_with("it offers none at all"), "{said}");
    }
}
