//! Veiling glare: light of the image that the lens scatters elsewhere in it.
//!
//! Of a scene that a perfect lens would show as L the camera sees
//! I = (1 − u − h) L + u ⟨L⟩ + h K∗L, with ⟨L⟩ the mean over the frame and K a halo that falls as
//! e^(−r/w). Both parts are smooth, so they are found on blocks of pixels, which are summed while
//! the image is read, and taken from every cell. An even field that goes on beyond the frame is
//! not changed. What lies outside the frame is taken to be black, and pixels that are not valid,
//! such as clipped ones, as bright as the valid ones of their block.

use glam::DVec2;

use super::Captured;
use crate::radiance_image::RadianceImage;

/// Where a lens puts the light that it scatters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glare {
    /// Share that is spread evenly over the frame, u.
    pub uniform: f64,
    /// Share that goes into the halo, h.
    pub halo: f64,
    /// Length w over which the halo falls to 1/e, part of the image's diagonal.
    pub halo_width: f64,
    /// Covariance of the two shares.
    pub covariance: [[f64; 2]; 2],
}

/// Blocks along the longer side of an image.
const BLOCKS: usize = 48;
/// Steps of the inversion: each leaves the share of what the one before left.
const STEPS: usize = 5;
/// Points along each side of a block by which the halo is averaged over it.
const POINTS: usize = 8;

/// An image's light by blocks, summed while its rows come by.
#[derive(Clone, Debug)]
pub struct BlockSums {
    size_px: [usize; 2],
    side_px: usize,
    /// Blocks along rows and columns.
    count: [usize; 2],
    sums: Vec<[f64; 3]>,
    valid: Vec<usize>,
    next_row: usize,
}

/// What a lens scattered in an image.
#[derive(Clone, Debug)]
pub struct Scattered {
    glare: Glare,
    side_px: f64,
    count: [usize; 2],
    /// ⟨L⟩.
    mean: [f64; 3],
    /// K∗L at the middles of the blocks.
    halo: Vec<[f64; 3]>,
}

impl BlockSums {
    /// Of an image of this width and height, none of whose rows has come by.
    pub fn new(size_px: [usize; 2]) -> Self {
        let side_px = size_px[0].max(size_px[1]).div_ceil(BLOCKS).max(1);
        let count = size_px.map(|n| n.div_ceil(side_px));
        Self {
            size_px,
            side_px,
            count,
            sums: vec![[0.0; 3]; count[0] * count[1]],
            valid: vec![0; count[0] * count[1]],
            next_row: 0,
        }
    }

    /// Adds the next rows.
    pub fn add(&mut self, rows: &RadianceImage) {
        let width = rows.width.max(1);
        for (pixel, radiance) in rows.mean.iter().enumerate() {
            let [x, y] = [pixel % width, self.next_row + pixel / width];
            let block = y / self.side_px * self.count[0] + x / self.side_px;
            if rows.valid[pixel] && radiance.iter().all(|v| v.is_finite()) {
                self.valid[block] += 1;
                for (sum, &value) in self.sums[block].iter_mut().zip(radiance) {
                    *sum += f64::from(value);
                }
            }
        }
        self.next_row += rows.height;
    }

    /// The part of the image that each block covers, in whole blocks.
    fn weight(&self, block: usize) -> f64 {
        let corner = [block % self.count[0], block / self.count[0]];
        let side = |axis: usize| {
            let left = self.size_px[axis] - corner[axis] * self.side_px;
            left.min(self.side_px) as f64 / self.side_px as f64
        };
        side(0) * side(1)
    }

    /// What a lens with this glare scattered.
    pub fn scattered(&self, glare: &Glare) -> Scattered {
        // Mean of each block; of one without a valid pixel, that of the image.
        let total: usize = self.valid.iter().sum();
        let of_all: [f64; 3] = std::array::from_fn(|c| {
            self.sums.iter().map(|sum| sum[c]).sum::<f64>() / total.max(1) as f64
        });
        let blocks = self.sums.iter().zip(&self.valid);
        let seen: Vec<[f64; 3]> = blocks
            .map(|(sum, &valid)| match valid {
                0 => of_all,
                valid => sum.map(|v| v / valid as f64),
            })
            .collect();
        let weights: Vec<f64> = (0..seen.len()).map(|block| self.weight(block)).collect();
        let area: f64 = weights.iter().sum();
        let kernel = self.kernel(glare.halo_width);

        // I = (1 − u − h) L + u ⟨L⟩ + h K∗L, by fixed point.
        let kept = 1.0 - glare.uniform - glare.halo;
        let mut light = seen.clone();
        let (mut mean, mut halo) = ([0.0; 3], Vec::new());
        for step in 0..=STEPS {
            mean = std::array::from_fn(|c| {
                let terms = light.iter().zip(&weights).map(|(v, w)| v[c] * w);
                terms.sum::<f64>() / area
            });
            halo = self.convolved(&light, &weights, &kernel);
            if step < STEPS {
                for ((light, seen), halo) in light.iter_mut().zip(&seen).zip(&halo) {
                    *light = std::array::from_fn(|c| {
                        (seen[c] - glare.uniform * mean[c] - glare.halo * halo[c]) / kept
                    });
                }
            }
        }
        Scattered {
            glare: *glare,
            side_px: self.side_px as f64,
            count: self.count,
            mean,
            halo,
        }
    }

    /// Light that arrives at a block's middle from another so many columns and rows away.
    fn kernel(&self, halo_width: f64) -> Vec<f64> {
        let [width, height] = self.size_px.map(|n| n as f64);
        let blocks = halo_width * width.hypot(height) / self.side_px as f64;
        let norm = 1.0 / (std::f64::consts::TAU * blocks * blocks * (POINTS * POINTS) as f64);
        let within = |point: usize| (point as f64 + 0.5) / POINTS as f64 - 0.5;
        (0..self.count[0] * self.count[1])
            .map(|offset| {
                let x = (offset % self.count[0]) as f64;
                let y = (offset / self.count[0]) as f64;
                let points = (0..POINTS * POINTS).map(|k| {
                    let r = (x + within(k % POINTS)).hypot(y + within(k / POINTS));
                    (-r / blocks).exp()
                });
                norm * points.sum::<f64>()
            })
            .collect()
    }

    fn convolved(&self, light: &[[f64; 3]], weights: &[f64], kernel: &[f64]) -> Vec<[f64; 3]> {
        let columns = self.count[0];
        (0..light.len())
            .map(|to| {
                let mut sum = [0.0; 3];
                for (from, (light, weight)) in light.iter().zip(weights).enumerate() {
                    let x = (from % columns).abs_diff(to % columns);
                    let y = (from / columns).abs_diff(to / columns);
                    let factor = weight * kernel[y * columns + x];
                    for (sum, light) in sum.iter_mut().zip(light) {
                        *sum += factor * light;
                    }
                }
                sum
            })
            .collect()
    }
}

impl Scattered {
    /// ⟨L⟩ and K∗L at a place, pixels from the top left corner.
    pub fn at(&self, place_px: DVec2) -> [[f64; 3]; 2] {
        let along = |at: f64, count: usize| {
            let at = (at / self.side_px - 0.5).clamp(0.0, count as f64 - 1.0);
            let low = (at as usize).min(count.saturating_sub(2));
            (low, (low + 1).min(count - 1), at - low as f64)
        };
        let (left, right, x) = along(place_px.x, self.count[0]);
        let (top, bottom, y) = along(place_px.y, self.count[1]);
        let halo = |column: usize, row: usize| self.halo[row * self.count[0] + column];
        let halo = std::array::from_fn(|c| {
            let upper = (1.0 - x) * halo(left, top)[c] + x * halo(right, top)[c];
            let lower = (1.0 - x) * halo(left, bottom)[c] + x * halo(right, bottom)[c];
            (1.0 - y) * upper + y * lower
        });
        [self.mean, halo]
    }

    /// Radiance at a place without the glare, and its derivatives by the two shares.
    fn without(&self, seen: [f64; 3], place_px: DVec2) -> [[f64; 3]; 3] {
        let [mean, halo] = self.at(place_px);
        let kept = 1.0 - self.glare.uniform - self.glare.halo;
        let light: [f64; 3] = std::array::from_fn(|c| {
            (seen[c] - self.glare.uniform * mean[c] - self.glare.halo * halo[c]) / kept
        });
        let [by_uniform, by_halo] =
            [mean, halo].map(|part| std::array::from_fn(|c| (light[c] - part[c]) / kept));
        [light, by_uniform, by_halo]
    }

    /// What one standard deviation of the shares does to the light, given its derivatives by them:
    /// two independent errors.
    fn errors(&self, [by_uniform, by_halo]: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
        let [[uniform, _], [halo_with, halo]] = self.glare.deviations();
        [
            std::array::from_fn(|c| uniform * by_uniform[c] + halo_with * by_halo[c]),
            by_halo.map(|v| halo * v),
        ]
    }
}

impl Glare {
    /// Takes it from an image; what is not known of its shares adds to the variances.
    pub fn remove_from(&self, image: &mut RadianceImage) {
        let mut sums = BlockSums::new([image.width, image.height]);
        sums.add(image);
        let scattered = sums.scattered(self);
        let width = image.width.max(1);
        let pixels = image.mean.iter_mut().zip(&mut image.variance);
        for (pixel, (mean, variance)) in pixels.enumerate() {
            let middle = DVec2::new((pixel % width) as f64, (pixel / width) as f64) + 0.5;
            let [light, by_shares @ ..] = scattered.without(mean.map(f64::from), middle);
            *mean = light.map(|v| v as f32);
            for error in scattered.errors(by_shares) {
                (0..3).for_each(|c| variance[c] += (error[c] * error[c]) as f32);
            }
        }
    }

    /// L with L Lᵀ the shares' covariance, lower triangle.
    fn deviations(&self) -> [[f64; 2]; 2] {
        let [[a, b], [_, d]] = self.covariance;
        let first = a.max(0.0).sqrt();
        let second = if first > 0.0 { b / first } else { 0.0 };
        [
            [first, 0.0],
            [second, (d - second * second).max(0.0).sqrt()],
        ]
    }
}

impl Captured {
    /// Takes from the image of each light what the lens scattered; what is not known of the
    /// shares becomes two errors that all values have in common.
    pub fn remove_glare(&mut self, of_lights: &[BlockSums], glare: &Glare) {
        let mut errors = [Vec::new(), Vec::new()];
        for (image, sums) in self.images.iter_mut().zip(of_lights) {
            let scattered = sums.scattered(glare);
            let mut of_light = [Vec::new(), Vec::new()];
            for (cell, mean) in image.mean.iter_mut().enumerate() {
                let place_px = self.cells.cell(cell).middle_px();
                let [light, by_shares @ ..] = scattered.without(*mean, place_px);
                *mean = light;
                for (of_light, error) in of_light.iter_mut().zip(scattered.errors(by_shares)) {
                    of_light.push(error);
                }
            }
            for (errors, of_light) in errors.iter_mut().zip(of_light) {
                errors.push(of_light);
            }
        }
        self.common_errors.extend(errors);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GLARE: Glare = Glare {
        uniform: 0.01,
        halo: 0.02,
        halo_width: 0.1,
        covariance: [[4e-6, -2e-6], [-2e-6, 5e-6]],
    };

    /// A card with a hole, whose glare is summed pixel by pixel here, is as without it again.
    #[test]
    fn what_was_scattered_is_removed() {
        let side = 40usize;
        let truth = |pixel: usize| -> f64 {
            let [x, y] = [pixel % side, pixel / side];
            match (10..20).contains(&x) && (15..30).contains(&y) {
                true => 0.0,
                false => 1.0 + 0.01 * x as f64,
            }
        };
        let pixels = side * side;
        let mean = (0..pixels).map(truth).sum::<f64>() / pixels as f64;
        let width_px = GLARE.halo_width * side as f64 * 2f64.sqrt();
        let halo = |to: usize| -> f64 {
            let terms = (0..pixels).map(|from| {
                let x = (from % side).abs_diff(to % side) as f64;
                let y = (from / side).abs_diff(to / side) as f64;
                truth(from) * (-x.hypot(y) / width_px).exp()
            });
            terms.sum::<f64>() / (std::f64::consts::TAU * width_px * width_px)
        };
        let mut image = RadianceImage::new(side, side);
        for pixel in 0..pixels {
            let seen = 0.97 * truth(pixel) + 0.01 * mean + 0.02 * halo(pixel);
            image.mean[pixel] = [seen as f32; 3];
            image.valid[pixel] = true;
        }
        let before = f64::from(image.mean[20 * side + 15][0]);
        assert!(before > 0.01, "{before}");
        GLARE.remove_from(&mut image);
        let worst = (0..pixels)
            .map(|pixel| (f64::from(image.mean[pixel][1]) - truth(pixel)).abs())
            .fold(0.0, f64::max);
        assert!(worst < 2e-4, "{worst}");
    }

    #[test]
    fn the_deviations_make_the_covariance() {
        let [[a, _], [b, c]] = GLARE.deviations();
        let made = [[a * a, a * b], [a * b, b * b + c * c]];
        for (made, stated) in made.iter().flatten().zip(GLARE.covariance.iter().flatten()) {
            assert!((made - stated).abs() < 1e-18, "{made} {stated}");
        }
    }
}
