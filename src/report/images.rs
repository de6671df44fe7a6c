//! Images for the page: radiance to sRGB, residuals and tables to colour maps,
//! PNG files as `data:` addresses.

use base64::Engine;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::radiance_image::RadianceImage;

/// Larger images are reduced to at most this many pixels a side.
const LARGEST_PX: usize = 512;

/// 8-bit sRGB with opacity; row 0 is the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// R, G, B, opacity.
    pub pixels: Vec<[u8; 4]>,
}

impl Picture {
    /// From a function of column and row.
    pub fn from_fn(width: usize, height: usize, pixel: impl Fn(usize, usize) -> [u8; 4]) -> Self {
        let at = |index: usize| pixel(index % width.max(1), index / width.max(1));
        Self {
            width,
            height,
            pixels: (0..width * height).map(at).collect(),
        }
    }

    /// One pixel wide, the first colour at the bottom: a colour bar.
    pub fn column(colors: &[[u8; 3]]) -> Self {
        Self::from_fn(1, colors.len(), |_, y| opaque(colors[colors.len() - 1 - y]))
    }
}

fn opaque([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
}

/// The picture as a PNG in a `data:` address. An empty picture gives an empty address.
pub fn data_uri(picture: &Picture) -> String {
    let mut png = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive);
    let (width, height) = (picture.width as u32, picture.height as u32);
    let seen_through = picture.pixels.iter().any(|pixel| pixel[3] != 255);
    let written = if seen_through {
        let bytes = picture.pixels.as_flattened();
        encoder.write_image(bytes, width, height, ExtendedColorType::Rgba8)
    } else {
        let bytes: Vec<u8> = picture
            .pixels
            .iter()
            .flat_map(|&[r, g, b, _]| [r, g, b])
            .collect();
        encoder.write_image(&bytes, width, height, ExtendedColorType::Rgb8)
    };
    match written {
        Ok(()) => format!(
            "data:image/png;base64,{}",
            base64::engine::general_purpose::STANDARD.encode(png)
        ),
        Err(_) => String::new(),
    }
}

/// Linear to 8-bit sRGB (IEC 61966-2-1); clipped to 0..=1.
pub fn srgb(linear: f32) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    (encoded * 255.0).round() as u8
}

/// The radiance shown as white: the 99.5th percentile of all valid values, at
/// least a tiny positive number.
pub fn white_level(image: &RadianceImage) -> f32 {
    let mut values: Vec<f32> = image
        .mean
        .iter()
        .zip(&image.valid)
        .filter(|(_, valid)| **valid)
        .flat_map(|(mean, _)| *mean)
        .filter(|value| value.is_finite())
        .collect();
    if values.is_empty() {
        return f32::MIN_POSITIVE;
    }
    let at = (values.len() - 1) * 995 / 1000;
    let white = *values.select_nth_unstable_by(at, f32::total_cmp).1;
    white.max(f32::MIN_POSITIVE)
}

/// How many pixels a side become one on the page.
fn reduction(image: &RadianceImage) -> usize {
    image.width.max(image.height).div_ceil(LARGEST_PX).max(1)
}

/// The pixels of the block that becomes pixel (x, y) of the page.
fn block(image: &RadianceImage, x: usize, y: usize) -> impl Iterator<Item = usize> {
    let (step, width) = (reduction(image), image.width);
    let columns = x * step..((x + 1) * step).min(width);
    let rows = y * step..((y + 1) * step).min(image.height);
    rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
}

fn reduced(
    image: &RadianceImage,
    pixel: impl Fn(&mut dyn Iterator<Item = usize>) -> [u8; 4],
) -> Picture {
    let step = reduction(image);
    let (width, height) = (image.width.div_ceil(step), image.height.div_ceil(step));
    Picture::from_fn(width, height, |x, y| pixel(&mut block(image, x, y)))
}

/// The image as the page has room for it: blocks of pixels become the mean of those that
/// are valid, and are invalid where none is. Variances are left out.
pub fn averaged_down(image: &RadianceImage) -> RadianceImage {
    let step = reduction(image);
    let mut small = RadianceImage::new(image.width.div_ceil(step), image.height.div_ceil(step));
    for at in 0..small.mean.len() {
        let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
        let pixels = block(image, at % small.width, at / small.width);
        for pixel in pixels.filter(|&pixel| image.valid[pixel]) {
            (0..3).for_each(|c| sum[c] += image.mean[pixel][c]);
            count += 1.0;
        }
        small.valid[at] = count > 0.0;
        small.mean[at] = sum.map(|value| value / count.max(1.0));
    }
    small
}

/// Radiance over `white` as sRGB; brighter values clip. Untrustworthy pixels
/// are left out (see-through), larger images are averaged down.
pub fn tone_mapped(image: &RadianceImage, white: f32) -> Picture {
    let small = averaged_down(image);
    Picture::from_fn(small.width, small.height, |x, y| {
        let at = y * small.width + x;
        match small.valid[at] {
            true => opaque(small.mean[at].map(|value| srgb(value / white))),
            false => [0; 4],
        }
    })
}

/// Residuals of one channel reach full colour at this many standard deviations.
pub const RESIDUAL_RANGE: f32 = 5.0;

/// One channel of a residual image (standard deviations) in the diverging map;
/// pixels that the fit left out are see-through. A reduced image shows each
/// block's largest deviation, so that none is averaged away.
pub fn residual(image: &RadianceImage, channel: usize) -> Picture {
    reduced(image, |pixels| {
        pixels
            .filter(|&pixel| image.valid[pixel])
            .map(|pixel| image.mean[pixel][channel])
            .filter(|value| value.is_finite())
            .reduce(|a, b| if b.abs() > a.abs() { b } else { a })
            .map_or([0; 4], |value| opaque(diverging(value / RESIDUAL_RANGE)))
    })
}

fn blend(anchors: &[[u8; 3]], position: f32) -> [u8; 3] {
    let last = anchors.len() - 1;
    let scaled = position.clamp(0.0, 1.0) * last as f32;
    let at = (scaled as usize).min(last - 1);
    let part = scaled - at as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(anchors[at][c]), f32::from(anchors[at + 1][c]));
        (a + (b - a) * part).round() as u8
    })
}

/// Blue below, pale at zero, red above; −1..=1. The nine colours of "RdBu"
/// (C. Brewer, ColorBrewer 2.0), which people with colour-blindness can tell apart.
pub fn diverging(value: f32) -> [u8; 3] {
    const ANCHORS: [[u8; 3]; 9] = [
        [33, 102, 172],
        [67, 147, 195],
        [146, 197, 222],
        [209, 229, 240],
        [247, 247, 247],
        [253, 219, 199],
        [244, 165, 130],
        [214, 96, 77],
        [178, 24, 43],
    ];
    blend(&ANCHORS, (value + 1.0) / 2.0)
}

/// Dark blue to yellow with even steps of lightness; 0..=1. Nine samples of
/// "viridis" (S. van der Walt, N. Smith, CC0).
pub fn sequential(value: f32) -> [u8; 3] {
    const ANCHORS: [[u8; 3]; 9] = [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ];
    blend(&ANCHORS, value)
}

/// `steps` colours of a map from its lowest value to its highest.
pub fn steps(map: impl Fn(f32) -> [u8; 3], from: f32, to: f32, steps: usize) -> Vec<[u8; 3]> {
    (0..steps)
        .map(|n| map(from + (to - from) * n as f32 / (steps.max(2) - 1) as f32))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_ends_and_middle() {
        assert_eq!(
            [srgb(-1.0), srgb(0.0), srgb(1.0), srgb(9.0)],
            [0, 0, 255, 255]
        );
        // 18% grey is 118 in sRGB.
        assert_eq!(srgb(0.18), 118);
    }

    #[test]
    fn a_picture_comes_back_from_its_address() {
        let picture = Picture::from_fn(3, 2, |x, y| {
            [
                x as u8 * 100,
                y as u8 * 200,
                7,
                if x == 2 { 0 } else { 255 },
            ]
        });
        let uri = data_uri(&picture);
        let text = uri.strip_prefix("data:image/png;base64,").unwrap();
        let png = base64::engine::general_purpose::STANDARD
            .decode(text)
            .unwrap();
        let back = image::load_from_memory(&png).unwrap().to_rgba8();
        assert_eq!((back.width(), back.height()), (3, 2));
        assert_eq!(back.as_raw().as_slice(), picture.pixels.as_flattened());
    }

    #[test]
    fn masked_pixels_are_see_through_and_large_images_shrink() {
        let mut image = RadianceImage::new(1100, 4);
        image.valid[0] = false;
        image.mean[3] = [9.0, -2.0, 0.0];
        let picture = residual(&image, 1);
        assert_eq!((picture.width, picture.height), (367, 2));
        assert_eq!(
            picture.pixels[1],
            opaque(diverging(-0.4)),
            "the largest of its block"
        );
        let mut small = RadianceImage::new(2, 1);
        small.valid[0] = false;
        assert_eq!(
            tone_mapped(&small, 1.0).pixels,
            [[0, 0, 0, 0], [0, 0, 0, 255]]
        );
    }

    /// Lightness must rise (or fall towards both ends) so that the maps also
    /// read in grey print.
    #[test]
    fn colour_maps_are_ordered_by_lightness() {
        let luma = |[r, g, b]: [u8; 3]| {
            0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
        };
        let viridis: Vec<f64> = steps(sequential, 0.0, 1.0, 64)
            .into_iter()
            .map(luma)
            .collect();
        assert!(viridis.windows(2).all(|pair| pair[1] > pair[0]));
        let rdbu: Vec<f64> = steps(diverging, 0.0, 1.0, 64)
            .into_iter()
            .map(luma)
            .collect();
        assert!(rdbu.windows(2).all(|pair| pair[1] < pair[0]));
    }
}
