//! Statistical and physical tests of the dictionaries' atoms.

use std::sync::Arc;

use glam::DVec3;
use rig::brdf::check::{check, check_with};
use rig::brdf::dictionary::{Atom, Dictionary, cosine_direction};
use rig::brdf::nbrdf::{NAMES, NeuralBrdf};
use rig::brdf::{Mixture, ggx};
use rig::random::{Purpose, stream};

/// Angles of incidence of the sampler tests, radians.
const ANGLES: [f64; 4] = [0.0, 0.6, 1.2, 1.5];
const RINGS: usize = 12;
const SECTORS: usize = 16;
const SAMPLES: u64 = 40_000;

fn direction(theta: f64, phi: f64) -> DVec3 {
    let (sin, cos) = theta.sin_cos();
    DVec3::new(sin * phi.cos(), sin * phi.sin(), cos)
}

/// Bin of a half vector: the rings are equally likely for GGX of this width
/// at normal incidence, t = tan²θ/(α² + tan²θ).
fn bin(alpha: f64, h: DVec3) -> usize {
    let tan2 = (h.x * h.x + h.y * h.y) / (h.z * h.z);
    let t = tan2 / (alpha * alpha + tan2);
    let sector = (h.y.atan2(h.x) / std::f64::consts::TAU + 1.0).fract();
    let ring = ((t * RINGS as f64) as usize).min(RINGS - 1);
    ring * SECTORS + ((sector * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// Probability of each bin, by integrating the stated density over the half
/// vectors by midpoints; dω_o = 4 (i·h) dω_h.
fn expected(alpha: f64, from: DVec3) -> Vec<f64> {
    const STEPS: usize = 64;
    const TURNS: usize = 8;
    let mut bins = vec![0.0; RINGS * SECTORS];
    for ring in 0..RINGS {
        // Even steps of w = √(1 − t) resolve the tail; tan²θ = α²·t/(1 − t).
        let w_at = |t: usize| (1.0 - t as f64 / RINGS as f64).sqrt();
        let (from_w, to_w) = (w_at(ring), w_at(ring + 1));
        let cos_at = |step: f64| {
            let w = from_w + (to_w - from_w) * step / STEPS as f64;
            w / (w * w + alpha * alpha * (1.0 - w * w)).sqrt()
        };
        for step in 0..STEPS {
            let step = step as f64;
            let band = cos_at(step) - cos_at(step + 1.0);
            let cos = cos_at(step + 0.5);
            for turn in 0..SECTORS * TURNS {
                let width = std::f64::consts::TAU / (SECTORS * TURNS) as f64;
                let h = direction(cos.acos(), width * (turn as f64 + 0.5));
                let cos_d = from.dot(h).max(0.0);
                let density = ggx::pdf_visible(alpha, from.z, 1.0 - cos * cos);
                bins[ring * SECTORS + turn / TURNS] += density * 4.0 * cos_d * band * width;
            }
        }
    }
    bins
}

/// χ² as a standard normal deviate (Wilson & Hilferty 1931), pooling bins that
/// expect fewer than five.
fn deviate(observed: &[u64], probability: &[f64], samples: u64) -> f64 {
    let (mut chi2, mut freedom) = (0.0, -1.0);
    let (mut rest, mut rest_expected) = (0.0, 0.0);
    for (&o, &p) in observed.iter().zip(probability) {
        let e = p * samples as f64;
        if e < 5.0 {
            rest += o as f64;
            rest_expected += e;
        } else {
            chi2 += (o as f64 - e).powi(2) / e;
            freedom += 1.0;
        }
    }
    if rest_expected > 1.0 {
        chi2 += (rest - rest_expected).powi(2) / rest_expected;
        freedom += 1.0;
    }
    let spread: f64 = 2.0 / (9.0 * freedom);
    ((chi2 / freedom).cbrt() - (1.0 - spread)) / spread.sqrt()
}

/// The deviate of the sampler for width `sampled` against the density of `stated`.
fn sampler_deviate(sampled: f64, stated: f64, theta: f64, key: u64) -> f64 {
    let from = direction(theta, 0.0);
    let probability = expected(stated, from);
    let total: f64 = probability.iter().sum();
    assert!(
        (total - 1.0).abs() < 2e-3,
        "alpha {stated}, {theta}: density integrates to {total}"
    );
    let mut observed = vec![0; probability.len()];
    for sample in 0..SAMPLES {
        let mut numbers = stream(2024, Purpose::Experiment, key, 0, sample);
        let u = [numbers.uniform(), numbers.uniform()];
        let to = DVec3::from_array(ggx::sample_visible(sampled, from.to_array(), u));
        observed[bin(stated, (from + to).normalize())] += 1;
    }
    deviate(&observed, &probability, SAMPLES)
}

/// All distinct lobes of the published dictionary and the ends of the range,
/// at four angles; family-wise significance 0.01 by Šidák over 39 + 2 widths × 4
/// angles (164 tests): each at 6.1e-5, that is 3.84 standard deviations.
#[test]
fn visible_normal_sampling_has_its_density() {
    const CRITICAL: f64 = 3.84;
    let mut alphas: Vec<f64> = Dictionary::paper42()
        .atoms()
        .iter()
        .zip(Dictionary::paper42().duplicate_of())
        .filter(|(_, duplicate)| duplicate.is_none())
        .filter_map(|(atom, _)| match atom {
            Atom::Ggx { alpha, .. } => Some(*alpha),
            _ => None,
        })
        .collect();
    assert_eq!(alphas.len(), 39);
    alphas.extend([0.005, 1.0]);
    let mut worst = (f64::MIN, 0.0, 0.0);
    for (k, &alpha) in alphas.iter().enumerate() {
        for (a, &theta) in ANGLES.iter().enumerate() {
            let z = sampler_deviate(alpha, alpha, theta, (k * ANGLES.len() + a) as u64);
            if z > worst.0 {
                worst = (z, alpha, theta);
            }
        }
    }
    assert!(
        worst.0 < CRITICAL,
        "deviate {} at alpha {}, {} rad",
        worst.0,
        worst.1,
        worst.2
    );
}

/// The same test must notice a width that is 5% off, and alpha² for alpha.
#[test]
fn the_sampler_test_has_power() {
    for theta in ANGLES {
        for (sampled, stated) in [(0.105, 0.1), (0.09, 0.3), (0.0105, 0.01)] {
            let z = sampler_deviate(sampled, stated, theta, 1000);
            assert!(
                z > 3.84,
                "width {sampled} for {stated} at {theta} rad: only {z}"
            );
        }
    }
}

#[test]
fn cosine_sampling_has_its_density() {
    let mut observed = vec![0; RINGS * SECTORS];
    for sample in 0..SAMPLES {
        let mut numbers = stream(2025, Purpose::Experiment, 0, 0, sample);
        let d = cosine_direction([numbers.uniform(), numbers.uniform()]);
        // sin²θ is uniform; tan²/(1 + tan²) is sin².
        observed[bin(1.0, d)] += 1;
    }
    let uniform = vec![1.0 / observed.len() as f64; observed.len()];
    let z = deviate(&observed, &uniform, SAMPLES);
    assert!(z < 3.0, "{z}");
}

/// Monte Carlo through each atom's own sampler gives the albedo of the quadrature:
/// sample, density and value belong together, the part below the horizon included.
#[test]
fn atoms_are_physical_and_their_samplers_give_their_albedo() {
    for dictionary in [Dictionary::paper42(), Dictionary::grid42()] {
        let dictionary = Arc::new(dictionary);
        for (index, atom) in dictionary.atoms().iter().enumerate() {
            let mut weights = vec![0.0; dictionary.len()];
            weights[index] = 1.0;
            let alone = Mixture::grey(dictionary.clone(), weights).unwrap();
            let found = check(&alone);
            assert!(
                found.reciprocity < 2e-3 && found.invalid == 0,
                "{atom:?}: {found:?}"
            );
            assert!(found.largest_albedo < 1.005, "{atom:?}: {found:?}");
            let from = direction(rig::brdf::check::ALBEDO_ANGLES_DEG[4].to_radians(), 0.0);
            let (mut sum, mut sum2) = (0.0, 0.0);
            let n = 4000;
            for sample in 0..n {
                let mut numbers = stream(2026, Purpose::Experiment, index as u64, 0, sample);
                let u = [numbers.uniform(), numbers.uniform()];
                let value = atom.sample(from, u).map_or(0.0, |(to, pdf)| {
                    let at = ggx::Cosines::new(from.to_array(), to.to_array()).unwrap();
                    atom.eval(&at) * to.z / pdf
                });
                sum += value;
                sum2 += value * value;
            }
            let mean = sum / n as f64;
            let error = ((sum2 / n as f64 - mean * mean).max(0.0) / n as f64).sqrt();
            let expected = found.albedo[4][0];
            assert!(
                (mean - expected).abs() <= 5.0 * error + 4e-3 * expected,
                "{atom:?}: {mean} ± {error} against {expected}"
            );
        }
    }
}

#[test]
fn measured_materials_are_physical() {
    for name in NAMES {
        let found = check_with(&NeuralBrdf::named(name).unwrap(), 128, 2000);
        assert!(found.passes(), "{name}: {found:?}");
    }
}
