//! Keyed random streams: the numbers depend on (seed, purpose, light, pixel,
//! sample) alone, never on the thread that asks, so that every result is
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
    /// Seeds of the paths that tell how images change with the bench.
    BenchDerivative = 16,
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

/// Dimensions of [`Stratified`].
pub const STRATIFIED_DIMENSIONS: usize = 5;

/// A keyed low-discrepancy sequence in five dimensions: Sobol' points (direction numbers
/// of Joe & Kuo 2008) with nested uniform scrambling by hashes (Owen 1995; Burley 2020).
/// Each point is uniform in [0, 1)⁵; the points of one key fill it evenly, those of two
/// keys are independent. Means of smooth integrands converge faster than with [`Stream`].
#[derive(Clone, Debug)]
pub struct Stratified {
    order: u32,
    scrambles: [u32; STRATIFIED_DIMENSIONS],
}

/// Direction numbers: dimension 0 is the radical inverse in base 2.
const SOBOL: [[u32; 32]; STRATIFIED_DIMENSIONS] = [
    sobol_directions(0, 0, [1, 0, 0]),
    sobol_directions(1, 0, [1, 0, 0]),
    sobol_directions(2, 1, [1, 3, 0]),
    sobol_directions(3, 1, [1, 3, 1]),
    sobol_directions(3, 2, [1, 1, 1]),
];

/// From the degree and inner coefficients of the primitive polynomial, and its first numbers.
const fn sobol_directions(degree: usize, coefficients: u32, first: [u32; 3]) -> [u32; 32] {
    let mut v = [0u32; 32];
    let mut i = 0;
    while i < 32 {
        v[i] = if degree == 0 {
            1 << (31 - i)
        } else if i < degree {
            first[i] << (31 - i)
        } else {
            let mut value = v[i - degree] ^ (v[i - degree] >> degree);
            let mut k = 1;
            while k < degree {
                if (coefficients >> (degree - 1 - k)) & 1 == 1 {
                    value ^= v[i - k];
                }
                k += 1;
            }
            value
        };
        i += 1;
    }
    v
}

/// Hash in which a bit depends only on itself and the lower ones (Laine & Karras 2011).
fn scramble_upwards(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

impl Stratified {
    /// The sequence that `key` begins; two numbers drawn from equal streams are equal.
    pub fn new(mut key: Stream) -> Self {
        Self {
            order: key.bits() as u32,
            scrambles: std::array::from_fn(|_| (key.bits() >> 32) as u32),
        }
    }

    /// Point `index`; the first 2ᵏ are stratified for every k.
    pub fn point(&self, index: u32) -> [f32; STRATIFIED_DIMENSIONS] {
        // Visiting order shuffled within aligned blocks of every power of two.
        let index = scramble_upwards(index.reverse_bits(), self.order).reverse_bits();
        std::array::from_fn(|d| {
            let mut bits = 0u32;
            let (mut rest, mut k) = (index, 0);
            while rest != 0 {
                if rest & 1 == 1 {
                    bits ^= SOBOL[d][k];
                }
                rest >>= 1;
                k += 1;
            }
            let scrambled = scramble_upwards(bits.reverse_bits(), self.scrambles[d]).reverse_bits();
            (scrambled >> 8) as f32 * (1.0 / (1u32 << 24) as f32)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every elementary interval of the first two dimensions (a (0, 2)-sequence) and every
    /// half, quarter, … of each single one holds its share of 2^k points, for several keys.
    #[test]
    fn stratified_points_fill_every_elementary_interval() {
        for key in 0..20 {
            let points = Stratified::new(stream(5, Purpose::Experiment, 0, key, 0));
            let points: Vec<_> = (0..256).map(|i| points.point(i)).collect();
            for d in 0..STRATIFIED_DIMENSIONS {
                let mut seen = [false; 256];
                points
                    .iter()
                    .for_each(|p| seen[(p[d] * 256.0) as usize] = true);
                assert!(seen.iter().all(|&s| s), "key {key}, dimension {d}");
            }
            for across in [2usize, 4, 16, 64, 128] {
                let mut seen = vec![0; 256];
                for p in &points {
                    let (x, y) = (
                        (p[0] * across as f32) as usize,
                        (p[1] * (256 / across) as f32) as usize,
                    );
                    seen[x * (256 / across) + y] += 1;
                }
                assert!(seen.iter().all(|&n| n == 1), "key {key}, {across} across");
            }
        }
    }

    /// Means of single points over keys: uniform, so ½ within 5 standard errors.
    #[test]
    fn each_stratified_point_is_uniform_over_the_keys() {
        let n = 20_000;
        for index in [0, 1, 7, 100] {
            let mut sums = [0.0f64; STRATIFIED_DIMENSIONS];
            for key in 0..n {
                let key = stream(6, Purpose::Experiment, 0, key, 0);
                let point = Stratified::new(key).point(index);
                sums.iter_mut()
                    .zip(point)
                    .for_each(|(s, x)| *s += f64::from(x));
            }
            for (d, sum) in sums.iter().enumerate() {
                let off = (sum / n as f64 - 0.5) * (12.0 * n as f64).sqrt();
                assert!(
                    off.abs() < 5.0,
                    "point {index}, dimension {d}: {off} errors"
                );
            }
        }
    }

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
