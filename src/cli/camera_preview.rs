//! `rig camera preview`: live pictures for framing and focusing.

use std::time::Instant;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use super::context::Context;
use super::error::{CliError, HintExt};
use super::output::write_json;
use super::preview_server::{PreviewServer, Shown};
use crate::device::retake::{Retakes, grab_right};
use crate::device::{Camera, CameraInfo, CameraSettings, FrameKey, FrameKind, RawFrame};
use crate::out;
use crate::radiometry::framing::{Framing, saturation_dn};
use crate::radiometry::mosaic::Mosaic;

/// The picture is at most so wide and high, pixels.
const LARGEST_PX: usize = 1024;

/// Takes frames and serves them until the process ends.
pub fn serve(
    mut camera: Box<dyn Camera>,
    settings: CameraSettings,
    port: u16,
    context: &Context,
) -> Result<(), CliError> {
    let server = PreviewServer::start(port)
        .map_err(|error| CliError::new(format!("127.0.0.1:{port}: {error}")))
        .hint("choose another --port, or 0 for a free one")?;
    out!("http://{}/", server.address())?;
    context.note("the page is for this machine alone; Ctrl-C ends it");
    let info = camera.info().clone();
    let mut last = Instant::now();
    let mut rate_per_s = 0.0;
    for number in 1.. {
        let frame = grab(&mut *camera, number)?;
        let interval_s = last.elapsed().as_secs_f64().max(1e-6);
        last = Instant::now();
        // Smoothed over about five frames; the first interval is no measure.
        rate_per_s = match number {
            1 => 0.0,
            2 => 1.0 / interval_s,
            _ => 0.8 * rate_per_s + 0.2 / interval_s,
        };
        let mut figures = figures(&frame, &info, settings);
        figures["number"] = number.into();
        figures["frames_per_s"] = rate_per_s.into();
        server.show(Shown {
            number,
            picture: picture(&frame, &info).map_err(CliError::new)?,
            figures: figures.to_string(),
        });
    }
    Ok(())
}

/// One frame's figures as JSON on stdout.
pub fn measure(
    camera: &mut dyn Camera,
    settings: CameraSettings,
    discard: u32,
) -> Result<(), CliError> {
    for number in 0..discard {
        grab(camera, number.into())?;
    }
    let frame = grab(camera, discard.into())?;
    write_json(&figures(&frame, camera.info(), settings))
}

fn grab(camera: &mut dyn Camera, number: u64) -> Result<RawFrame, CliError> {
    let key = FrameKey {
        light: 0,
        exposure: 0,
        repeat: number as u32,
        kind: FrameKind::Ambient,
    };
    Ok(grab_right(camera, key, &mut Retakes::default())?)
}

fn figures(frame: &RawFrame, info: &CameraInfo, settings: CameraSettings) -> serde_json::Value {
    let framing = Framing::of(
        &frame.counts,
        frame.width as usize,
        info.bit_depth,
        info.mosaic,
    );
    let mut figures = serde_json::json!({
        "model": info.model,
        "width": frame.width,
        "height": frame.height,
        "bit_depth": info.bit_depth,
        "saturation_dn": saturation_dn(info.bit_depth),
        "exposure_s": settings.exposure,
        "gain": settings.gain,
        "sequence": frame.sequence,
    });
    if let (Some(all), Ok(serde_json::Value::Object(more))) =
        (figures.as_object_mut(), serde_json::to_value(framing))
    {
        all.extend(more);
    }
    figures
}

/// The frame as an 8-bit PNG for the eye: blocks of pixels averaged until it is
/// small enough (over whole cells of colour filters), square root of the counts,
/// blocks with a saturated pixel chequered red and white, blocks of zeros blue
/// and black.
fn picture(frame: &RawFrame, info: &CameraInfo) -> Result<Vec<u8>, String> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let mut block = width.max(height).div_ceil(LARGEST_PX).max(1);
    if info.mosaic != Mosaic::None {
        block = block.next_multiple_of(2);
    }
    let (columns, rows) = (width.div_ceil(block), height.div_ceil(block));
    let saturation = saturation_dn(info.bit_depth);
    let mut pixels = Vec::with_capacity(3 * columns * rows);
    for row in 0..rows {
        for column in 0..columns {
            let (mut sum, mut count, mut largest) = (0_u64, 0_u64, 0);
            for y in row * block..((row + 1) * block).min(height) {
                for &dn in
                    &frame.counts[y * width..][column * block..((column + 1) * block).min(width)]
                {
                    sum += u64::from(dn);
                    count += 1;
                    largest = largest.max(dn);
                }
            }
            let is_odd = (row + column) % 2 == 1;
            pixels.extend(match (largest, is_odd) {
                (dn, true) if dn >= saturation => [255, 40, 40],
                (dn, false) if dn >= saturation => [255; 3],
                (0, true) => [30, 60, 200],
                (0, false) => [0; 3],
                _ => {
                    let part = sum as f64 / count as f64 / f64::from(saturation);
                    [(255.0 * part.sqrt()).round() as u8; 3]
                }
            });
        }
    }
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub)
        .write_image(
            &pixels,
            columns as u32,
            rows as u32,
            ExtendedColorType::Rgb8,
        )
        .map_err(|error| error.to_string())?;
    Ok(png)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Seconds;

    fn info(size: [u32; 2], mosaic: Mosaic) -> CameraInfo {
        CameraInfo {
            driver: "test".to_owned(),
            model: "test".to_owned(),
            serial: String::new(),
            resolution_px: size,
            bit_depth: 12,
            mosaic,
            exposure_range: [Seconds(1e-3), Seconds(1.0)],
            exposure_step: Seconds(1e-3),
        }
    }

    fn shown(size: [u32; 2], counts: Vec<u16>, mosaic: Mosaic) -> image::RgbImage {
        let frame = RawFrame {
            width: size[0],
            height: size[1],
            counts,
            sequence: None,
            timestamp: None,
        };
        let png = picture(&frame, &info(size, mosaic)).unwrap();
        image::load_from_memory(&png).unwrap().to_rgb8()
    }

    #[test]
    fn clipped_and_empty_pixels_are_marked_and_the_rest_is_grey() {
        let picture = shown([4, 1], vec![4095, 4095, 1024, 0], Mosaic::None);
        let at = |x| picture.get_pixel(x, 0).0;
        assert_eq!([at(0), at(1), at(2)], [[255; 3], [255, 40, 40], [128; 3]]);
        assert_eq!(at(3), [30, 60, 200]);
    }

    #[test]
    fn large_frames_are_averaged_and_one_clipped_pixel_still_shows() {
        let size = [2050, 1026];
        let mut counts = vec![1024; 2050 * 1026];
        counts[1025 * 2050 + 2049] = 4095;
        for mosaic in [Mosaic::None, Mosaic::Rggb] {
            let picture = shown(size, counts.clone(), mosaic);
            let (width, height) = picture.dimensions();
            assert!(width <= 1024 && height <= 1024 && width > 500, "{width}");
            assert_eq!(picture.get_pixel(5, 5).0, [128; 3]);
            let last = picture.get_pixel(width - 1, height - 1).0;
            assert!(last == [255; 3] || last == [255, 40, 40], "{last:?}");
        }
        // A cell of colour filters is one block.
        let bayer = shown([2, 2], vec![0, 4094, 0, 4094], Mosaic::Rggb);
        assert_eq!(bayer.dimensions(), (1, 1));
    }
}
