//! Radiance images as pictures: radiance to sRGB, residuals to a colour map.

use super::Picture;
use super::colors::diverging;
use crate::brdf::sphere::srgb8;
use crate::radiance_image::RadianceImage;

/// Larger images are reduced to at most this many pixels a side.
const LARGEST_PX: usize = 512;

fn opaque([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
}

/// What is bright in an image, often shown as white: the 99.5th percentile of all valid values, at
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

/// The radiance shown as white (R, G, B): that of a white diffuser that faces the lamp. Where
/// that is not known, or so far from the image's values that nobody can have measured their
/// scale, what is bright in the image ([`white_level`]) is white.
pub fn white_of(diffuser: Option<[f64; 3]>, bright: f32) -> [f32; 3] {
    let diffuser = diffuser.map(|white| white.map(|white| white as f32));
    let is_plausible = |white: &[f32; 3]| {
        let mean = white.iter().sum::<f32>() / 3.0;
        white.iter().all(|white| *white > 0.0) && (0.01..10.0).contains(&(bright / mean))
    };
    diffuser.filter(is_plausible).unwrap_or([bright; 3])
}

/// How many pixels a side become one where the page has room for `largest_px`.
fn reduction(image: &RadianceImage, largest_px: usize) -> usize {
    image.width.max(image.height).div_ceil(largest_px).max(1)
}

/// The pixels of the block of `step` a side that becomes pixel (x, y).
fn block(image: &RadianceImage, step: usize, [x, y]: [usize; 2]) -> impl Iterator<Item = usize> {
    let width = image.width;
    let columns = x * step..((x + 1) * step).min(width);
    let rows = y * step..((y + 1) * step).min(image.height);
    rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
}

fn reduced(
    image: &RadianceImage,
    pixel: impl Fn(&mut dyn Iterator<Item = usize>) -> [u8; 4],
) -> Picture {
    let step = reduction(image, LARGEST_PX);
    let (width, height) = (image.width.div_ceil(step), image.height.div_ceil(step));
    Picture::from_fn(width, height, |x, y| pixel(&mut block(image, step, [x, y])))
}

/// The image as the page has room for it: blocks of pixels become the mean of those that
/// are valid, and are invalid where none is. Variances are left out.
pub fn averaged_down(image: &RadianceImage) -> RadianceImage {
    averaged_to(image, LARGEST_PX)
}

/// Likewise, for a page with room for `largest_px` pixels a side.
pub fn averaged_to(image: &RadianceImage, largest_px: usize) -> RadianceImage {
    let step = reduction(image, largest_px);
    let mut small = RadianceImage::new(image.width.div_ceil(step), image.height.div_ceil(step));
    for at in 0..small.mean.len() {
        let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
        let pixels = block(image, step, [at % small.width, at / small.width]);
        for pixel in pixels.filter(|&pixel| image.valid[pixel]) {
            (0..3).for_each(|c| sum[c] += image.mean[pixel][c]);
            count += 1.0;
        }
        small.valid[at] = count > 0.0;
        small.mean[at] = sum.map(|value| value / count.max(1.0));
    }
    small
}

/// Radiance over `white` as sRGB; brighter values clip. Invalid pixels are
/// transparent, larger images are averaged down.
pub fn tone_mapped(image: &RadianceImage, white: f32) -> Picture {
    white_balanced(image, [white; 3])
}

/// Likewise, where a white diffuser has this radiance (R, G, B).
pub fn white_balanced(image: &RadianceImage, white: [f32; 3]) -> Picture {
    let small = averaged_down(image);
    Picture::from_fn(small.width, small.height, |x, y| {
        let at = y * small.width + x;
        match small.valid[at] {
            true => opaque([0, 1, 2].map(|c| srgb8(small.mean[at][c] / white[c]))),
            false => [0; 4],
        }
    })
}

/// Residuals of one channel reach full colour at this many standard deviations.
pub const RESIDUAL_RANGE: f32 = 5.0;

/// One channel of a residual image (standard deviations) in the diverging map;
/// pixels that the fit left out are transparent. A reduced image shows each
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_white_diffuser_is_white_where_the_scale_is_known() {
        let diffuser = Some([1.0, 0.5, 0.25]);
        assert_eq!(white_of(diffuser, 0.1), [1.0, 0.5, 0.25]);
        // Counts, a rig file whose irradiance nobody measured, a lamp without blue.
        assert_eq!(white_of(diffuser, 4000.0), [4000.0; 3]);
        assert_eq!(white_of(diffuser, 1e-5), [1e-5; 3]);
        assert_eq!(white_of(Some([1.0, 0.5, 0.0]), 0.1), [0.1; 3]);
        assert_eq!(white_of(None, 0.1), [0.1; 3]);
    }

    #[test]
    fn masked_pixels_are_transparent_and_large_images_shrink() {
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
}
