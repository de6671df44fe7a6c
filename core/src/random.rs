//! Keyed random streams: the numbers depend on (seed, purpose, light, pixel,
//! sample) alone, never on the thread, so that every result is
//! bit-identical for any number of threads.

/// What a stream is for; distinct purposes never share numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Positions inside a pixel.
    PixelPosition = 1,
    /// Directions of path continuations.
    PathDirection = 2,
    /// Points on an extended light or lens.
    LightAndLens = 3,
    /// The simulated bench's perturbations.
    BenchPerturbation = 4,
    /// Samples drawn inside statistical tests and experiments.
    Experiment = 5,
    /// Bootstrap or posterior draws.
    Posterior = 6,
    /// Seeds of the paths for the derivatives of images by the bench's parameters.
    BenchDerivative = 16,
    /// Deviations of a surface from its mesh, and the paths that measure their effect.
    FormError = 17,
    /// Mirror paths of the photon guide.
    Guide = 18,
    /// Scrambles of the quasi-random points of paths.
    PathPoints = 19,
}

/// Where uniform numbers come from.
pub trait Uniform {
    /// Uniform in [0, 1).
    fn uniform_f32(&mut self) -> f32;
}

impl Uniform for Stream {
    #[inline]
    fn uniform_f32(&mut self) -> f32 {
        Stream::uniform_f32(self)
    }
}

/// A small counter-based stream of random numbers.
///
/// The state is a 64-bit hash of the key; each draw advances it by an odd
/// constant and mixes it (the SplitMix64 finaliser, Steele et al. 2014).
#[derive(Clone, Debug)]
pub struct Stream {
    state: u64,
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The stream of one key.
///
/// ```
/// use rig_core::random::{Purpose, stream};
///
/// // Keyed by seed, purpose, light, pixel and sample: the same numbers on any thread.
/// let mut numbers = stream(7, Purpose::PixelPosition, 0, 1234, 0);
/// let first = numbers.uniform();
/// assert!((0.0..1.0).contains(&first));
/// assert_eq!(stream(7, Purpose::PixelPosition, 0, 1234, 0).uniform(), first);
/// assert_ne!(stream(7, Purpose::PixelPosition, 0, 1235, 0).uniform(), first);
/// ```
pub fn stream(seed: u64, purpose: Purpose, light: u64, pixel: u64, sample: u64) -> Stream {
    let mut state = mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15));
    for word in [purpose as u64, light, pixel, sample] {
        state = mix(state ^ mix(word.wrapping_add(0x9e37_79b9_7f4a_7c15)).rotate_left(17));
    }
    Stream { state }
}

impl Stream {
    /// 64 uniform bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.state)
    }

    /// Uniform in [0, 1), a multiple of 2⁻²⁴.
    pub fn uniform_f32(&mut self) -> f32 {
        (self.bits() >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
    }

    /// Uniform in [0, 1), a multiple of 2⁻⁵³.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Standard normal (Box–Muller, one of the pair).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_keys_give_equal_numbers_and_others_do_not() {
        let key =
            |light, pixel, sample| stream(7, Purpose::PathDirection, light, pixel, sample).bits();
        assert_eq!(key(1, 2, 3), key(1, 2, 3));
        let all = [
            key(1, 2, 3),
            key(2, 1, 3),
            key(3, 2, 1),
            key(0, 2, 3),
            key(1, 2, 4),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(all.iter().skip(i + 1).all(|b| a != b));
        }
    }

    /// Chi-square on 64 equal bins over neighbouring keys, 2^16 draws; the
    /// bounds are the 1e-6 tails of χ²(63).
    #[test]
    fn neighbouring_keys_fill_the_unit_interval_evenly() {
        let mut counts = [0u32; 64];
        for pixel in 0..(1u64 << 14) {
            let mut numbers = stream(0, Purpose::PixelPosition, 0, pixel, 0);
            for _ in 0..4 {
                counts[(numbers.uniform() * 64.0) as usize] += 1;
            }
        }
        let expected = f64::from(1u32 << 16) / 64.0;
        let chi2: f64 = counts
            .iter()
            .map(|&c| (f64::from(c) - expected).powi(2) / expected)
            .sum();
        assert!(
            (23.0..131.0).contains(&chi2),
            "chi2 {chi2} over 63 degrees of freedom"
        );
    }

    #[test]
    fn normal_has_zero_mean_and_unit_variance() {
        let mut numbers = stream(3, Purpose::Experiment, 0, 0, 0);
        let n = 200_000;
        let (mut sum, mut sum2) = (0.0, 0.0);
        for _ in 0..n {
            let x = numbers.normal();
            sum += x;
            sum2 += x * x;
        }
        let mean = sum / f64::from(n);
        let variance = sum2 / f64::from(n) - mean * mean;
        assert!(mean.abs() < 5.0 / f64::from(n).sqrt(), "mean {mean}");
        assert!(
            (variance - 1.0).abs() < 5.0 * (2.0 / f64::from(n)).sqrt(),
            "variance {variance}"
        );
    }
}
