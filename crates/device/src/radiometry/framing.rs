//! What helps to frame, focus and expose: histogram, clipping and sharpness of
//! one raw frame.

use serde::Serialize;

use super::mosaic::Mosaic;

/// Bins of the histogram.
pub const BINS: usize = 64;

/// Figures of one frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Framing {
    /// Smallest count, DN.
    pub minimum_dn: u16,
    /// Mean count, DN.
    pub mean_dn: f64,
    /// Largest count, DN.
    pub maximum_dn: u16,
    /// Pixels at the largest count that the bit depth allows.
    pub clipped_pixels: usize,
    /// Pixels at 0: the black level is too low to see the noise.
    pub zero_pixels: usize,
    /// Pixels in [`BINS`] equal parts of the bit depth's range.
    pub histogram: Vec<u64>,
    /// Root mean square difference of neighbours of the same colour in the middle
    /// half of the frame, over the mean count there. It grows with sharpness, and
    /// compares frames of one scene alone; noise and clipping raise it too.
    pub sharpness: f64,
}

/// Largest count of a bit depth from 1 to 16.
pub fn saturation_dn(bit_depth: u32) -> u16 {
    ((1_u32 << bit_depth.clamp(1, 16)) - 1) as u16
}

impl Framing {
    /// The figures of `counts`, row by row, `width` in a row.
    pub fn of(counts: &[u16], width: usize, bit_depth: u32, mosaic: Mosaic) -> Self {
        let saturation = saturation_dn(bit_depth);
        let mut histogram = vec![0_u64; BINS];
        let (mut clipped_pixels, mut zero_pixels, mut sum) = (0, 0, 0_u64);
        for &count in counts {
            clipped_pixels += usize::from(count >= saturation);
            zero_pixels += usize::from(count == 0);
            sum += u64::from(count);
            let bin = usize::from(count) * BINS / (usize::from(saturation) + 1);
            histogram[bin.min(BINS - 1)] += 1;
        }
        Self {
            minimum_dn: counts.iter().min().copied().unwrap_or(0),
            mean_dn: sum as f64 / counts.len().max(1) as f64,
            maximum_dn: counts.iter().max().copied().unwrap_or(0),
            clipped_pixels,
            zero_pixels,
            histogram,
            sharpness: sharpness(counts, width, mosaic),
        }
    }
}

fn sharpness(counts: &[u16], width: usize, mosaic: Mosaic) -> f64 {
    let height = counts.len().checked_div(width).unwrap_or(0);
    let step = if mosaic == Mosaic::None { 1 } else { 2 };
    let (mut squares, mut sum, mut pixels) = (0.0, 0.0, 0.0);
    let (rows, columns) = (height / 4..height * 3 / 4, width / 4..width * 3 / 4);
    for y in rows.clone().filter(|y| y + step < height) {
        for x in columns.clone().filter(|x| x + step < width) {
            let count = |x: usize, y: usize| f64::from(counts[y * width + x]);
            let here = count(x, y);
            squares += (count(x + step, y) - here).powi(2) + (count(x, y + step) - here).powi(2);
            sum += here;
            pixels += 1.0;
        }
    }
    if sum > 0.0 {
        f64::sqrt(squares / pixels) / (sum / pixels)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sine of this contrast, 8 pixels long, around 1000.
    fn sine(contrast: f64, scale: f64) -> Vec<u16> {
        let count = |i: usize| {
            let phase = (i % 32) as f64 * std::f64::consts::TAU / 8.0;
            (scale * 1000.0 * (1.0 + contrast * phase.sin())).round() as u16
        };
        (0..32 * 32).map(count).collect()
    }

    #[test]
    fn sharpness_is_the_slope_of_a_sine_whatever_the_exposure() {
        let of =
            |contrast, scale| Framing::of(&sine(contrast, scale), 32, 12, Mosaic::None).sharpness;
        // Neighbours of a sine of amplitude a differ by 2a·sin(π/8) times a cosine.
        let expected = 0.5 * 2.0 * (std::f64::consts::PI / 8.0).sin() / f64::sqrt(2.0);
        assert!((of(0.5, 1.0) - expected).abs() < 1e-3, "{}", of(0.5, 1.0));
        assert!((of(0.5, 2.0) - expected).abs() < 1e-3);
        assert!((of(0.25, 1.0) - expected / 2.0).abs() < 1e-3);
    }

    /// A colour filter's checkerboard is no detail.
    #[test]
    fn neighbours_are_of_the_same_colour() {
        let counts: Vec<u16> = (0..64)
            .map(|i| if (i / 8 + i) % 2 == 0 { 100 } else { 900 })
            .collect();
        assert_eq!(Framing::of(&counts, 8, 10, Mosaic::Rggb).sharpness, 0.0);
        assert!(Framing::of(&counts, 8, 10, Mosaic::None).sharpness > 1.0);
    }

    #[test]
    fn counts_are_sorted_into_bins_and_ends() {
        let framing = Framing::of(&[0, 0, 15, 16, 1022, 1023], 3, 10, Mosaic::None);
        assert_eq!(framing.histogram[..2], [3, 1]);
        assert_eq!(framing.histogram[63], 2);
        assert_eq!((framing.clipped_pixels, framing.zero_pixels), (1, 2));
        assert_eq!((framing.minimum_dn, framing.maximum_dn), (0, 1023));
        let deep = Framing::of(&[65535], 1, 16, Mosaic::None);
        assert_eq!(
            (deep.histogram[63], deep.clipped_pixels, deep.sharpness),
            (1, 1, 0.0)
        );
        assert_eq!(Framing::of(&[], 0, 8, Mosaic::None).mean_dn, 0.0);
    }
}
