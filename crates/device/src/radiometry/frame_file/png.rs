//! Frames as PNG files, their counts as they are.

use std::io::Cursor;

use png::{BitDepth, ColorType, Decoder, Info, Limits, Transformations};

use super::{FrameFile, FrameFileError, Tone, check_size, most_bytes, planes};

/// Gamma of counts that are proportional to light, as a PNG states it.
const LINEAR: f32 = 1.0;

/// Decodes a PNG of grey or RGB counts of 8 or 16 bits.
pub(super) fn decode(bytes: &[u8], size: Option<[usize; 2]>) -> Result<FrameFile, FrameFileError> {
    let limits = Limits {
        bytes: most_bytes(bytes) as usize,
    };
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(FrameFileError::damaged)?;
    let info = reader.info();
    let [width, height] = [info.width as usize, info.height as usize];
    check_size([width, height], size)?;
    if let Some(animation) = info.animation_control.filter(|a| a.num_frames > 1) {
        return Err(FrameFileError::Pages {
            count: animation.num_frames as usize,
            what: "pictures of an animation",
            sizes: format!("{width} x {height} pixels"),
        });
    }
    let channels = match (info.color_type, info.bit_depth) {
        (ColorType::Grayscale, BitDepth::Eight | BitDepth::Sixteen) => 1,
        (ColorType::Rgb, BitDepth::Eight | BitDepth::Sixteen) => 3,
        _ => return Err(FrameFileError::Samples(samples(info))),
    };
    let bits = info.bit_depth as u32;
    let tone = match (info.srgb, info.source_gamma) {
        (Some(_), _) => Tone::Gamma,
        (None, Some(gamma)) if (gamma.into_value() - LINEAR).abs() > 0.01 => Tone::Gamma,
        _ => Tone::Unstated,
    };
    let length = reader.output_buffer_size();
    let length = length.ok_or_else(|| FrameFileError::damaged("its image has no length"))?;
    let mut raw = vec![0; length];
    reader
        .next_frame(&mut raw)
        .map_err(FrameFileError::damaged)?;
    let planes = match bits {
        8 => planes(raw, channels),
        _ => {
            let pairs = raw.as_chunks().0.iter();
            planes(
                pairs.map(|&pair| u16::from_be_bytes(pair)).collect(),
                channels,
            )
        }
    };
    Ok(FrameFile {
        width,
        height,
        bits,
        planes,
        tone,
    })
}

/// What the pixels are, for messages.
fn samples(info: &Info) -> String {
    let bits = info.bit_depth as u32;
    match info.color_type {
        ColorType::Grayscale => format!("{bits}-bit samples"),
        ColorType::Rgb => format!("{bits}-bit RGB samples"),
        ColorType::Indexed => format!("{bits}-bit numbers of the colours in a palette"),
        ColorType::GrayscaleAlpha => "2 samples per pixel (grey and alpha)".into(),
        ColorType::Rgba => "4 samples per pixel (red, green, blue and alpha)".into(),
    }
}
