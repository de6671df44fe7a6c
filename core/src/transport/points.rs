//! Samplers: the random numbers of camera paths, independent (Monte Carlo) or quasi-random.
//!
//! [`SobolSampler`] draws the positions in a cell and the continuations of its paths from a
//! Sobol sequence with hashed Owen scrambling (Burley 2020), four dimensions per reflection.
//! Each point alone is uniform, so estimates are unbiased; together they fill the space of
//! paths more evenly, so that their mean scatters less. The two halves of a cell's paths, and
//! different cells, have scrambles of their own and are independent of each other.

use glam::DVec2;

use super::camera::Camera;
use super::cell_footprints::Cells;
use crate::geometry::Ray;
use crate::random::{Purpose, Stream, Uniform, stream};

/// The random numbers of one path, by what they are for.
pub trait Sampler: Uniform {
    /// Where on an extended lamp a reflection is connected to, in [0, 1)².
    fn on_lamp(&mut self) -> [f32; 2];
    /// Goes on to the next reflection.
    fn advance(&mut self);
}

/// Independent random numbers.
pub struct IndependentSampler {
    directions: Stream,
    lamps: Stream,
}

impl IndependentSampler {
    /// Begins path number `sample` of a pixel: its numbers and its ray.
    pub fn begin(camera: &Camera, seed: u64, pixel: usize, sample: u32) -> (Self, Ray) {
        let (numbers, [position, lens]) = Self::new(seed, pixel as u64, sample);
        (numbers, camera.ray_of_pixel(pixel, position, lens))
    }

    /// The same of a cell.
    pub fn begin_in(
        camera: &Camera,
        cells: &Cells,
        seed: u64,
        cell: usize,
        sample: u32,
    ) -> (Self, Ray) {
        let (numbers, [position, lens]) = Self::new(seed, cells.key(cell), sample);
        (numbers, cells.ray(camera, cell, position, lens))
    }

    /// The numbers, and where the path begins in its footprint and on the lens.
    fn new(seed: u64, key: u64, sample: u32) -> (Self, [DVec2; 2]) {
        let key = |purpose| stream(seed, purpose, 0, key, u64::from(sample));
        let mut in_pixel = key(Purpose::PixelPosition);
        let mut lamps = key(Purpose::LightAndLens);
        let position = DVec2::new(in_pixel.uniform(), in_pixel.uniform());
        let lens = DVec2::new(lamps.uniform(), lamps.uniform());
        let numbers = Self {
            directions: key(Purpose::PathDirection),
            lamps,
        };
        (numbers, [position, lens])
    }
}

impl Uniform for IndependentSampler {
    #[inline]
    fn uniform_f32(&mut self) -> f32 {
        self.directions.uniform_f32()
    }
}

impl Sampler for IndependentSampler {
    #[inline]
    fn on_lamp(&mut self) -> [f32; 2] {
        [self.lamps.uniform_f32(), self.lamps.uniform_f32()]
    }

    #[inline]
    fn advance(&mut self) {}
}

/// Points of one sequence; further ones get another scramble.
const LENGTH: u32 = 1 << 16;

/// The quasi-random numbers of one path.
pub struct SobolSampler {
    scramble: u32,
    index: u32,
    /// The next four dimensions.
    set: u32,
    point: [f32; 4],
    used: usize,
    /// Numbers beyond the sequence's.
    others: Stream,
    lamps: Stream,
}

impl SobolSampler {
    /// Begins the path `index` of a pixel: its numbers and its ray. `part` selects the
    /// scramble: paths of different parts are independent.
    pub fn begin(camera: &Camera, seed: u64, pixel: usize, part: u32, index: u32) -> (Self, Ray) {
        let mut numbers = Self::new(seed, pixel as u64, part, index);
        let [position, lens] = numbers.on_sensor();
        (numbers, camera.ray_of_pixel(pixel, position, lens))
    }

    /// The same of a cell's paths.
    pub fn begin_in(
        camera: &Camera,
        cells: &Cells,
        seed: u64,
        cell: usize,
        part: u32,
        index: u32,
    ) -> (Self, Ray) {
        let mut numbers = Self::new(seed, cells.key(cell), part, index);
        let [position, lens] = numbers.on_sensor();
        (numbers, cells.ray(camera, cell, position, lens))
    }

    fn new(seed: u64, pixel: u64, part: u32, index: u32) -> Self {
        let key = |purpose, sample| stream(seed, purpose, u64::from(part), pixel, sample);
        Self {
            scramble: key(Purpose::PathPoints, u64::from(index / LENGTH)).bits() as u32,
            index: index % LENGTH,
            set: 0,
            point: [0.0; 4],
            used: 4,
            others: key(Purpose::PathDirection, u64::from(index)),
            lamps: key(Purpose::LightAndLens, u64::from(index)),
        }
    }

    /// Where the path begins in the pixel and on the lens, in [0, 1)² each; the first numbers of a path.
    fn on_sensor(&mut self) -> [DVec2; 2] {
        self.advance();
        [(); 2].map(|()| {
            let mut next = || f64::from(self.uniform_f32());
            DVec2::new(next(), next())
        })
    }
}

impl Uniform for SobolSampler {
    #[inline]
    fn uniform_f32(&mut self) -> f32 {
        match self.point.get(self.used) {
            Some(&number) => {
                self.used += 1;
                number
            }
            None => self.others.uniform_f32(),
        }
    }
}

impl Sampler for SobolSampler {
    #[inline]
    fn on_lamp(&mut self) -> [f32; 2] {
        [self.lamps.uniform_f32(), self.lamps.uniform_f32()]
    }

    /// The first four numbers of a reflection are of the sequence.
    #[inline]
    fn advance(&mut self) {
        self.used = 4;
        if self.set < sobol_burley::NUM_DIMENSION_SETS_4D {
            self.point = sobol_burley::sample_4d(self.index, self.set, self.scramble);
            self.set += 1;
            self.used = 0;
        }
    }
}

/// Ratio of the variance of a pixel's mean over quasi-random paths to that over as many
/// independent ones (Monte Carlo), estimated from the pixels of an image.
#[derive(Clone, Copy, Debug, Default)]
pub struct VarianceReduction {
    ratios: f64,
    pixels: f64,
}

/// Pseudo-count of pixels with ratio 1, which shrinks the estimate towards 1 where an image
/// has few pixels.
const PRIOR_PIXELS: f64 = 32.0;

impl VarianceReduction {
    /// Adds a pixel: `of_halves` is the variance of its mean as estimated from the difference
    /// of its two halves (one sample of it), `of_paths` as estimated from the scatter of its
    /// paths as if they were independent.
    pub fn add(&mut self, of_halves: f64, of_paths: f64) {
        if of_paths > 0.0 {
            self.ratios += of_halves / of_paths;
            self.pixels += 1.0;
        }
    }

    /// Adds the pixels of another estimate.
    pub fn join(&mut self, other: &Self) {
        self.ratios += other.ratios;
        self.pixels += other.pixels;
    }

    /// The factor for the variance of independent paths, above 0.
    pub fn factor(&self) -> f64 {
        (PRIOR_PIXELS + self.ratios) / (PRIOR_PIXELS + self.pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eight dimensions of 4096 paths of each half, 16 even bins: a Sobol point set fills
    /// them alike; and one path of each of 4096 pixels, which are independent: χ²(15), with
    /// the tail of 1e-4 in 16 tests.
    #[test]
    fn numbers_are_uniform_within_and_between_pixels() {
        const CRITICAL: f64 = 50.0;
        let numbers = |pixel, half, index| {
            let mut numbers = SobolSampler::new(3, pixel, half, index);
            let [position, lens] = numbers.on_sensor();
            numbers.advance();
            let mut next = || f64::from(numbers.uniform_f32());
            [
                position.x,
                position.y,
                lens.x,
                lens.y,
                next(),
                next(),
                next(),
                next(),
            ]
        };
        for half in 0..2 {
            let (mut within, mut between) = ([[0u32; 16]; 8], [[0u32; 16]; 8]);
            for k in 0..4096 {
                for (counts, all) in [
                    (&mut within, numbers(5, half, k)),
                    (&mut between, numbers(u64::from(k), half, 9)),
                ] {
                    for (counts, number) in counts.iter_mut().zip(all) {
                        counts[(number * 16.0) as usize] += 1;
                    }
                }
            }
            assert_eq!(within, [[256; 16]; 8], "half {half}");
            for (d, counts) in between.iter().enumerate() {
                let chi2: f64 = counts
                    .iter()
                    .map(|&n| (f64::from(n) - 256.0).powi(2) / 256.0)
                    .sum();
                assert!(chi2 < CRITICAL, "half {half}, dimension {d}: {chi2}");
            }
        }
    }

    /// The halves of one pixel, and further sequences, are independent of each other.
    #[test]
    fn halves_do_not_share_points() {
        let first = |half, index| SobolSampler::new(1, 7, half, index).on_sensor()[0].x;
        let mut products = [0.0; 2];
        for index in 0..1024 {
            let centred = [first(0, index), first(1, index), first(0, index + LENGTH)]
                .map(|u| 12f64.sqrt() * (u - 0.5));
            products[0] += centred[0] * centred[1] / 1024.0;
            products[1] += centred[0] * centred[2] / 1024.0;
        }
        // Standard deviation 1/32 if they are.
        assert!(products.iter().all(|p| p.abs() < 0.12), "{products:?}");
    }

    /// The mean of x·y over 64 points of either half against ¼: the halves' difference is
    /// right about the scatter, which is far below that of independent points.
    #[test]
    fn halves_tell_the_scatter_of_their_mean() {
        let (mut reduction, mut squares, mut of_paths) = (VarianceReduction::default(), 0.0, 0.0);
        const PIXELS: u32 = 2000;
        for pixel in 0..PIXELS {
            let halves = [0, 1].map(|half| {
                let values = (0..64).map(|index| {
                    let mut numbers = SobolSampler::new(2, u64::from(pixel), half, index);
                    let position = numbers.on_sensor()[0];
                    position.x * position.y
                });
                values.sum::<f64>() / 64.0
            });
            let mean = 0.5 * (halves[0] + halves[1]);
            squares += (mean - 0.25).powi(2);
            // E(x²y²) − E(xy)² = 1/9 − 1/16, of 128 paths.
            let independent = (1.0 / 9.0 - 1.0 / 16.0) / 128.0;
            of_paths += independent;
            reduction.add(0.25 * (halves[0] - halves[1]).powi(2), independent);
        }
        let found = squares / of_paths;
        assert!(found < 0.1, "{found}");
        // PRIOR_PIXELS adds 32 of 2000; chi-square of 2000 has a deviation of 3%.
        let expected =
            (PRIOR_PIXELS + f64::from(PIXELS) * found) / (PRIOR_PIXELS + f64::from(PIXELS));
        let estimated = reduction.factor();
        assert!(
            (estimated / expected - 1.0).abs() < 0.15,
            "{estimated} for {expected}"
        );
    }
}
