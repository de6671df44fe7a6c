//! The numbers of camera paths: independent ones, or points that fill the space of paths more
//! evenly, so that their mean scatters less.
//!
//! The places in a cell and the continuations of its paths are points of a Sobol sequence
//! under a hashed Owen scramble (Burley 2020), four dimensions per reflection. Each point
//! alone is uniform, so nothing is biased. Parts of a cell's paths have scrambles of their
//! own and are independent of each other, as cells are.

use glam::DVec2;

use super::camera::Camera;
use super::cells::Cells;
use crate::geometry::Ray;
use crate::random::{Purpose, Stream, Uniform, stream};

/// The numbers of one path, by what they are for.
pub trait Numbers: Uniform {
    /// Where on an extended lamp a reflection is connected to, in [0, 1)².
    fn on_lamp(&mut self) -> [f32; 2];
    /// Goes on to the next reflection.
    fn advance(&mut self);
}

/// Independent numbers.
pub struct Independent {
    directions: Stream,
    lamps: Stream,
}

impl Independent {
    /// Begins path number `sample` of a pixel: its numbers and its ray.
    pub fn begin(camera: &Camera, seed: u64, pixel: usize, sample: u32) -> (Self, Ray) {
        let (numbers, [place, lens]) = Self::new(seed, pixel as u64, sample);
        (numbers, camera.ray_of_pixel(pixel, place, lens))
    }

    /// The same of a cell.
    pub fn begin_in(
        camera: &Camera,
        cells: &Cells,
        seed: u64,
        cell: usize,
        sample: u32,
    ) -> (Self, Ray) {
        let (numbers, [place, lens]) = Self::new(seed, cells.key(cell), sample);
        (numbers, cells.ray(camera, cell, place, lens))
    }

    /// The numbers, and where the path begins in its footprint and on the lens.
    fn new(seed: u64, key: u64, sample: u32) -> (Self, [DVec2; 2]) {
        let key = |purpose| stream(seed, purpose, 0, key, u64::from(sample));
        let mut position = key(Purpose::PixelPosition);
        let mut lamps = key(Purpose::LightAndLens);
        let place = DVec2::new(position.uniform(), position.uniform());
        let lens = DVec2::new(lamps.uniform(), lamps.uniform());
        let numbers = Self {
            directions: key(Purpose::PathDirection),
            lamps,
        };
        (numbers, [place, lens])
    }
}

impl Uniform for Independent {
    #[inline]
    fn uniform_f32(&mut self) -> f32 {
        self.directions.uniform_f32()
    }
}

impl Numbers for Independent {
    #[inline]
    fn on_lamp(&mut self) -> [f32; 2] {
        [self.lamps.uniform_f32(), self.lamps.uniform_f32()]
    }

    #[inline]
    fn advance(&mut self) {}
}

/// Points of one sequence; further ones get another scramble.
const LENGTH: u32 = 1 << 16;

/// The numbers of one path.
pub struct PathNumbers {
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

impl PathNumbers {
    /// Begins the path `index` of a part of a pixel's paths: its numbers and its ray.
    pub fn begin(camera: &Camera, seed: u64, pixel: usize, part: u32, index: u32) -> (Self, Ray) {
        let mut numbers = Self::new(seed, pixel as u64, part, index);
        let [place, lens] = numbers.on_sensor();
        (numbers, camera.ray_of_pixel(pixel, place, lens))
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
        let [place, lens] = numbers.on_sensor();
        (numbers, cells.ray(camera, cell, place, lens))
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

    /// Where the path begins in the pixel and on the lens, in [0, 1)² each; asked for first.
    fn on_sensor(&mut self) -> [DVec2; 2] {
        self.advance();
        [(); 2].map(|()| {
            let mut next = || f64::from(self.uniform_f32());
            DVec2::new(next(), next())
        })
    }
}

impl Uniform for PathNumbers {
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

impl Numbers for PathNumbers {
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

/// How much less the mean of a pixel's paths scatters than that of as many independent
/// ones, over the pixels of an image.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evenness {
    ratios: f64,
    pixels: f64,
}

/// Pixels without gain that are added to an image's: a few pixels tell too little.
const DOUBT: f64 = 32.0;

impl Evenness {
    /// Takes a pixel into account: the variance of the mean that the difference of its
    /// halves tells, a single draw of it, and the one that the paths' scatter tells as if
    /// they were independent.
    pub fn add(&mut self, of_halves: f64, of_paths: f64) {
        if of_paths > 0.0 {
            self.ratios += of_halves / of_paths;
            self.pixels += 1.0;
        }
    }

    /// Takes other pixels into account.
    pub fn join(&mut self, other: &Self) {
        self.ratios += other.ratios;
        self.pixels += other.pixels;
    }

    /// By what the variance of independent paths is to be multiplied.
    pub fn factor(&self) -> f64 {
        (DOUBT + self.ratios) / (DOUBT + self.pixels)
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
            let mut numbers = PathNumbers::new(3, pixel, half, index);
            let [place, lens] = numbers.on_sensor();
            numbers.advance();
            let mut next = || f64::from(numbers.uniform_f32());
            [
                place.x,
                place.y,
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
        let first = |half, index| PathNumbers::new(1, 7, half, index).on_sensor()[0].x;
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
        let (mut evenness, mut squares, mut of_paths) = (Evenness::default(), 0.0, 0.0);
        const PIXELS: u32 = 2000;
        for pixel in 0..PIXELS {
            let halves = [0, 1].map(|half| {
                let values = (0..64).map(|index| {
                    let mut numbers = PathNumbers::new(2, u64::from(pixel), half, index);
                    let place = numbers.on_sensor()[0];
                    place.x * place.y
                });
                values.sum::<f64>() / 64.0
            });
            let mean = 0.5 * (halves[0] + halves[1]);
            squares += (mean - 0.25).powi(2);
            // E(x²y²) − E(xy)² = 1/9 − 1/16, of 128 paths.
            let independent = (1.0 / 9.0 - 1.0 / 16.0) / 128.0;
            of_paths += independent;
            evenness.add(0.25 * (halves[0] - halves[1]).powi(2), independent);
        }
        let found = squares / of_paths;
        assert!(found < 0.1, "{found}");
        // DOUBT adds 32 of 2000; chi-square of 2000 has a deviation of 3%.
        let expected = (DOUBT + f64::from(PIXELS) * found) / (DOUBT + f64::from(PIXELS));
        let told = evenness.factor();
        assert!(
            (told / expected - 1.0).abs() < 0.15,
            "{told} for {expected}"
        );
    }
}
