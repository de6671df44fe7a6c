//! What pixels see of a radiance: its mean over their area, behind a lens that blurs.

use glam::DVec2;

/// Places along a pixel's side.
const SUB: usize = 3;

/// The means over the pixels of an image of this size, row by row, of the radiance at each
/// place (pixels from the top left corner), blurred by a Gaussian of this standard
/// deviation.
pub fn means(size: [usize; 2], blur_px: f64, radiance: impl Fn(DVec2) -> f64) -> Vec<f64> {
    let [width, height] = size.map(|n| n * SUB);
    let place = |i: usize| DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
    let fine: Vec<f64> = (0..width * height)
        .map(|i| radiance(place(i) / SUB as f64))
        .collect();
    let sigma = blur_px * SUB as f64;
    let along_rows = blurred(&fine, 1, width, sigma);
    let blurred = blurred(&along_rows, width, height, sigma);
    let mut means = vec![0.0; size[0] * size[1]];
    for (i, value) in blurred.iter().enumerate() {
        means[i / width / SUB * size[0] + i % width / SUB] += value / (SUB * SUB) as f64;
    }
    means
}

/// Blurs along one axis: lines of `length` values, `stride` apart; beyond its ends a line
/// goes on as it ends.
fn blurred(values: &[f64], stride: usize, length: usize, sigma: f64) -> Vec<f64> {
    let reach = (4.0 * sigma).ceil() as usize;
    let kernel: Vec<f64> = (0..=2 * reach)
        .map(|k| (-0.5 * ((k as f64 - reach as f64) / sigma.max(1e-9)).powi(2)).exp())
        .collect();
    let sum: f64 = kernel.iter().sum();
    let mut blurred = vec![0.0; values.len()];
    for line in 0..values.len() / length {
        let start = if stride == 1 { line * length } else { line };
        let padded: Vec<f64> = (0..length + 2 * reach)
            .map(|i| values[start + i.saturating_sub(reach).min(length - 1) * stride])
            .collect();
        for (i, window) in padded.windows(kernel.len()).enumerate() {
            let weighted = window.iter().zip(&kernel).map(|(v, k)| v * k);
            blurred[start + i * stride] = weighted.sum::<f64>() / sum;
        }
    }
    blurred
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The image of an edge across a row is the integral of blur and pixel.
    #[test]
    fn an_edge_is_spread_by_blur_and_pixel() {
        let sigma: f64 = 0.8;
        let seen = means([21, 5], sigma, |at| f64::from(u8::from(at.x > 10.0)));
        let row = &seen[42..63];
        assert!((row.iter().sum::<f64>() - 11.0).abs() < 1e-9);
        // Variance of the line spread: blur, pixel, and the places' own rounding.
        let middle = 10.0;
        let variance: f64 = (0..20)
            .map(|x| {
                let step = row[x + 1] - row[x];
                step * ((x as f64 + 1.0 - middle).powi(2))
            })
            .sum();
        let expected = sigma * sigma + 1.0 / 12.0 + 1.0 / 12.0;
        assert!((variance - expected).abs() < 0.02, "{variance} {expected}");
    }
}
