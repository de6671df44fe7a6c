//! Whether a sampler draws from the density that it states: a χ² test over cells of the
//! half vector.

use glam::{DVec3, Vec3};

use super::{Brdf, LobeTable};
use crate::random::{Purpose, Stream, stream};

/// Rings of the half vector, θh = 90°·(ring/RINGS)²: their edges, and those of the
/// midpoints below, are also the edges of a [`LobeTable`]'s cells, where its density jumps.
const RINGS: usize = 32;
const SECTORS: usize = 8;
/// Midpoints per cell along θh and azimuth.
const STEPS: [usize; 2] = [32, 16];
/// Error of the density's integral by these midpoints, where the horizon cuts cells.
const INTEGRAL_ERROR: f64 = 5e-4;

/// What the test found.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ChiSquare {
    /// χ² as a standard normal deviate (Wilson & Hilferty 1931): large where sampler and
    /// density disagree.
    pub deviate: f64,
    /// Integral of the density over directions above the horizon, at most 1.
    pub total: f64,
}

/// Compares `samples` draws for the local `from` (unit, above the horizon) with `pdf` (1/sr,
/// cosine excluded). Draws of `None` and below the horizon are one more cell.
pub fn chi_square(
    from: DVec3,
    samples: u64,
    key: u64,
    mut sample: impl FnMut(&mut Stream) -> Option<DVec3>,
    pdf: impl Fn(DVec3) -> f64,
) -> ChiSquare {
    let mut observed = vec![0u64; RINGS * SECTORS];
    let mut lost = 0;
    for draw in 0..samples {
        let mut numbers = stream(2024, Purpose::Experiment, key, 1, draw);
        match sample(&mut numbers) {
            Some(to) if to.z > 0.0 => observed[cell((from + to).normalize())] += 1,
            _ => lost += 1,
        }
    }
    let probability = expected(from, pdf);
    let total: f64 = probability.iter().sum();
    let (mut chi2, mut freedom) = (0.0, -1.0);
    let mut add = |observed: f64, expected: f64, variance: f64| {
        chi2 += (observed - expected).powi(2) / variance;
        freedom += 1.0;
    };
    // Cells that expect fewer than five are pooled.
    let (mut rest, mut rest_expected) = (0.0, 0.0);
    for (&o, &p) in observed.iter().zip(&probability) {
        let e = p * samples as f64;
        if e < 5.0 {
            rest += o as f64;
            rest_expected += e;
        } else {
            add(o as f64, e, e);
        }
    }
    // A pool that expects next to nothing but was drawn from counts in full.
    if rest_expected > 1.0 || rest > 10.0 {
        let expected = rest_expected.max(1.0);
        add(rest, expected, expected);
    }
    let none = (1.0 - total).max(0.0) * samples as f64;
    let systematic = INTEGRAL_ERROR * samples as f64;
    add(lost as f64, none, none.max(1.0) + systematic * systematic);
    ChiSquare {
        deviate: normal_deviate(chi2, f64::max(freedom, 1.0)),
        total,
    }
}

/// χ² with `freedom` degrees of freedom as a standard normal deviate (Wilson & Hilferty 1931).
pub fn normal_deviate(chi2: f64, freedom: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    ((chi2 / freedom).cbrt() - (1.0 - spread)) / spread.sqrt()
}

/// The sampler of measured materials, [`LobeTable`], at angles of the viewer in degrees.
pub fn check_lobes(brdf: &dyn Brdf, angles_deg: &[f64], samples: u64) -> Vec<ChiSquare> {
    let table = LobeTable::new(brdf);
    angles_deg
        .iter()
        .zip(0..)
        .map(|(angle, key)| {
            let (sin, cos) = angle.to_radians().sin_cos();
            let from = DVec3::new(sin, 0.0, cos);
            chi_square(
                from,
                samples,
                key,
                |numbers| {
                    let u = [0; 4].map(|_| numbers.uniform());
                    table.sample(from.as_vec3(), u).map(Vec3::as_dvec3)
                },
                |to| f64::from(table.pdf(from.as_vec3(), to.as_vec3())),
            )
        })
        .collect()
}

fn cell(h: DVec3) -> usize {
    let theta = h.x.hypot(h.y).atan2(h.z);
    let ring = ((theta / std::f64::consts::FRAC_PI_2).sqrt() * RINGS as f64) as usize;
    let sector = (h.y.atan2(h.x) / std::f64::consts::TAU + 1.0).fract() * SECTORS as f64;
    ring.min(RINGS - 1) * SECTORS + (sector as usize).min(SECTORS - 1)
}

/// Probability of each cell by midpoints; dω = 4 (from·h) dω_h.
fn expected(from: DVec3, pdf: impl Fn(DVec3) -> f64) -> Vec<f64> {
    let mut cells = vec![0.0; RINGS * SECTORS];
    let edge = |step: usize| {
        let theta = std::f64::consts::FRAC_PI_2 * (step as f64 / (RINGS * STEPS[0]) as f64).powi(2);
        2.0 * (0.5 * theta).sin().powi(2)
    };
    let width = std::f64::consts::TAU / (SECTORS * STEPS[1]) as f64;
    for step in 0..RINGS * STEPS[0] {
        let (inner, outer) = (edge(step), edge(step + 1));
        let versine = 0.5 * (inner + outer);
        let sin = (versine * (2.0 - versine)).sqrt();
        for turn in 0..SECTORS * STEPS[1] {
            let (y, x) = (width * (turn as f64 + 0.5)).sin_cos();
            let h = DVec3::new(sin * x, sin * y, 1.0 - versine);
            let cos_d = from.dot(h);
            let to = 2.0 * cos_d * h - from;
            if cos_d > 0.0 && to.z > 0.0 {
                cells[step / STEPS[0] * SECTORS + turn / STEPS[1]] +=
                    pdf(to) * 4.0 * cos_d * (outer - inner) * width;
            }
        }
    }
    cells
}
