//! Are these numbers draws from the standard normal distribution?

use std::f64::consts::{PI, SQRT_2};

/// Φ(z), with small relative errors in the lower tail.
pub fn normal_cdf(z: f64) -> f64 {
    let x = z.abs() / SQRT_2;
    let tail = if x < 2.5 {
        // erf x = 2/√π e^(−x²) Σ 2ⁿ x^(2n+1) / (2n+1)!!
        let (mut term, mut sum) = (x, x);
        for n in 1..80 {
            term *= 2.0 * x * x / f64::from(2 * n + 1);
            sum += term;
        }
        0.5 * (1.0 - 2.0 / PI.sqrt() * (-x * x).exp() * sum)
    } else {
        // The continued fraction of erfc.
        let fraction = (1..80).rev().fold(x, |f, n| x + 0.5 * f64::from(n) / f);
        0.5 * (-x * x).exp() / (PI.sqrt() * fraction)
    };
    if z < 0.0 { tail } else { 1.0 - tail }
}

/// Probability that |z| or more happens by chance.
pub fn two_sided(z: f64) -> f64 {
    2.0 * normal_cdf(-z.abs())
}

/// The standard normal deviate as rare as Student's `t` of `freedom` degrees (Wallace
/// 1959, within 0.02 from ten degrees on).
pub fn normal_score(t: f64, freedom: f64) -> f64 {
    let shrink = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0);
    t.signum() * shrink * (freedom * (t * t / freedom).ln_1p()).sqrt()
}

/// p of Anderson and Darling's A² of `z` against the standard normal, nothing fitted, by
/// the limiting distribution of Marsaglia & Marsaglia 2004.
pub fn anderson_darling(z: &[f64]) -> f64 {
    let mut z = z.to_vec();
    z.sort_by(f64::total_cmp);
    let n = z.len();
    let floor = f64::MIN_POSITIVE;
    let sum: f64 = (0..n)
        .map(|i| {
            let below = normal_cdf(z[i]).max(floor).ln();
            let above = normal_cdf(-z[n - 1 - i]).max(floor).ln();
            (2.0 * i as f64 + 1.0) * (below + above)
        })
        .sum();
    let a = -(n as f64) - sum / n as f64;
    let horner = |c: [f64; 6]| c.iter().rev().fold(0.0, |sum, c| sum * a + c);
    let cdf = if a < 2.0 {
        let c = [
            2.00012, 0.247105, -0.0649821, 0.0347962, -0.0116720, 0.00168691,
        ];
        (-1.2337141 / a).exp() / a.sqrt() * horner(c)
    } else {
        let c = [1.0776, -2.30695, 0.43424, -0.082433, 0.008056, -0.0003146];
        (-horner(c).exp()).exp()
    };
    (1.0 - cdf).clamp(0.0, 1.0)
}

/// A χ² of `freedom` degrees as a standard normal deviate (Wilson & Hilferty 1931).
pub fn chi2_score(chi2: f64, freedom: f64) -> f64 {
    let k = 2.0 / (9.0 * freedom);
    ((chi2 / freedom).cbrt() - (1.0 - k)) / k.sqrt()
}

/// Significance of each of `tests` tests whose family has significance `family` (Šidák).
pub fn sidak(family: f64, tests: usize) -> f64 {
    1.0 - (1.0 - family).powf(1.0 / tests as f64)
}

/// Mean and standard error of the mean of equally long rows, per column.
pub fn mean_and_error(rows: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
    let n = rows.len() as f64;
    (0..rows[0].len())
        .map(|k| {
            let mean = rows.iter().map(|r| r[k]).sum::<f64>() / n;
            let squares: f64 = rows.iter().map(|r| (r[k] - mean).powi(2)).sum();
            (mean, (squares / (n - 1.0) / n).sqrt())
        })
        .unzip()
}

#[test]
fn the_distributions_have_their_published_values() {
    assert!((normal_cdf(-1.959963984540054) - 0.025).abs() < 1e-12);
    assert!((normal_cdf(-6.0) / 9.865_876_450_376_98e-10 - 1.0).abs() < 1e-9);
    assert!((normal_cdf(3.6) + normal_cdf(-3.6) - 1.0).abs() < 1e-12);
    // t of 15 degrees: 2.947 is exceeded with 0.5%, as 2.5758 is by the normal.
    assert!((normal_score(2.947, 15.0) - 2.5758).abs() < 0.01);
    assert!((sidak(0.01, 10) - 0.0010045).abs() < 1e-6);
}

#[test]
fn normal_deviates_pass_and_others_do_not() {
    use rig_core::random::{Purpose, stream};
    let mut numbers = stream(11, Purpose::Experiment, 0, 0, 0);
    let z: Vec<f64> = (0..1500).map(|_| numbers.normal()).collect();
    assert!(anderson_darling(&z) > 0.01);
    let wrong = |f: fn(f64) -> f64| anderson_darling(&z.iter().map(|&z| f(z)).collect::<Vec<_>>());
    assert!(wrong(|z| z + 0.15) < 1e-4);
    assert!(wrong(|z| 1.2 * z) < 1e-4);
    assert!(wrong(|z| z + 0.2 * (z * z - 1.0)) < 1e-4);
}
