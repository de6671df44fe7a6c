//! Random numbers that depend on a key alone, so that the simulated world is
//! the same for any number of threads and any order of calls.

/// A counter-based stream: each draw advances the state by an odd constant and
/// mixes it (the SplitMix64 finaliser, Steele et al. 2014).
#[derive(Clone, Debug)]
pub struct Stream {
    state: u64,
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// One word from many; different words, orders or counts give unrelated results.
pub fn hash(key: &[u64]) -> u64 {
    key.iter().fold(mix(key.len() as u64), |state, &word| {
        mix(state ^ mix(word.wrapping_add(GOLDEN)).rotate_left(17))
    })
}

/// The stream of one key.
pub fn stream(key: &[u64]) -> Stream {
    Stream { state: hash(key) }
}

impl Stream {
    /// 64 uniform bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN);
        mix(self.state)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Standard normal (Box–Muller, one of the pair).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Poisson with this mean; exact in distribution for every mean.
    ///
    /// Below 10 by counting uniforms whose product stays above exp(−mean)
    /// (Knuth); from 10 on by transformed rejection with squeeze (PTRS,
    /// Hörmann 1993, "The transformed rejection method for generating Poisson
    /// random variables").
    pub fn poisson(&mut self, mean: f64) -> f64 {
        if mean.is_nan() || mean <= 0.0 {
            return 0.0;
        }
        if mean < 10.0 {
            let threshold = (-mean).exp();
            let mut product = self.uniform();
            let mut count = 0.0;
            while product > threshold {
                product *= self.uniform();
                count += 1.0;
            }
            return count;
        }
        let b = 0.931 + 2.53 * mean.sqrt();
        let a = -0.059 + 0.024_83 * b;
        let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
        let v_r = 0.9277 - 3.6224 / (b - 2.0);
        let ln_mean = mean.ln();
        loop {
            let u = self.uniform() - 0.5;
            let v = 1.0 - self.uniform();
            let u_s = 0.5 - u.abs();
            let k = ((2.0 * a / u_s + b) * u + mean + 0.43).floor();
            if u_s >= 0.07 && v <= v_r {
                return k;
            }
            if k < 0.0 || (u_s < 0.013 && v > u_s) {
                continue;
            }
            if v.ln() + inverse_alpha.ln() - (a / (u_s * u_s) + b).ln()
                <= k * ln_mean - mean - ln_factorial(k)
            {
                return k;
            }
        }
    }
}

/// ln k!, to 1e-12: a table below 16, Stirling's series above.
fn ln_factorial(k: f64) -> f64 {
    if k < 16.0 {
        return (2..=k as u32).map(|i| f64::from(i).ln()).sum();
    }
    let n = k + 1.0;
    (n - 0.5) * n.ln() - n
        + 0.5 * std::f64::consts::TAU.ln()
        + (1.0 / 12.0 - (1.0 / 360.0 - 1.0 / 1260.0 / (n * n)) / (n * n)) / n
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ln_factorial_agrees_with_the_sum_of_logarithms() {
        for k in [0_u32, 1, 5, 15, 16, 17, 40, 170, 3000] {
            let sum: f64 = (2..=k).map(|i| f64::from(i).ln()).sum();
            assert!(
                (ln_factorial(f64::from(k)) - sum).abs() <= 1e-10 * sum.max(1.0),
                "k = {k}"
            );
        }
    }

    /// Pearson's chi-square against the Poisson probabilities, 2^16 draws for
    /// each mean, cells pooled to an expectation of at least 20. The bound is
    /// the normal approximation's 5 sigma (one-sided 3e-7, below 1e-5 with the
    /// skew of chi-square, for 7 means together).
    #[test]
    fn poisson_follows_its_distribution() {
        for (case, mean) in [0.05, 1.0, 9.9, 10.0, 33.3, 400.0, 20_000.0]
            .into_iter()
            .enumerate()
        {
            let draws = 1_u32 << 16;
            let mut numbers = stream(&[17, case as u64]);
            let mut counts = std::collections::BTreeMap::<u64, f64>::new();
            for _ in 0..draws {
                *counts.entry(numbers.poisson(mean) as u64).or_default() += 1.0;
            }
            let half_width = 12.0 * mean.sqrt() + 20.0;
            let low = (mean - half_width).max(0.0) as u64;
            let high = (mean + half_width) as u64;
            assert!(counts.keys().all(|&k| (low..=high).contains(&k)));
            let (mut chi2, mut cells) = (0.0, 0.0);
            let (mut observed, mut expected) = (0.0, 0.0);
            for k in low..=high {
                let k_f = k as f64;
                let probability = (k_f * mean.ln() - mean - ln_factorial(k_f)).exp();
                expected += probability * f64::from(draws);
                observed += counts.get(&k).copied().unwrap_or(0.0);
                if expected >= 20.0 {
                    chi2 += (observed - expected) * (observed - expected) / expected;
                    cells += 1.0;
                    (observed, expected) = (0.0, 0.0);
                }
            }
            let dof = f64::max(cells - 1.0, 1.0);
            assert!(
                chi2 < dof + 5.0 * (2.0 * dof).sqrt() + 10.0,
                "mean {mean}: chi2 {chi2} over {dof} degrees of freedom"
            );
        }
    }

    #[test]
    fn normal_has_unit_variance_and_kurtosis_three() {
        let mut numbers = stream(&[4]);
        let n = 200_000;
        let (mut m1, mut m2, mut m4) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = numbers.normal();
            m1 += x;
            m2 += x * x;
            m4 += x.powi(4);
        }
        let n = f64::from(n);
        // Five standard deviations of each moment's estimate: 1, 2 and 96 over n.
        assert!((m1 / n).abs() < 5.0 * (1.0 / n).sqrt());
        assert!((m2 / n - 1.0).abs() < 5.0 * (2.0 / n).sqrt());
        assert!((m4 / n - 3.0).abs() < 5.0 * (96.0 / n).sqrt());
    }
}
