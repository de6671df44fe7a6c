//! Whether a BRDF could be that of a real surface: finite, not negative,
//! reciprocal, and reflecting no more than arrives.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Brdf;
use super::atom::cosine_direction;
use super::quadrature;
use crate::random::{Purpose, stream};

/// Angles of incidence at which the directional albedo is measured, degrees.
pub const ALBEDO_ANGLES_DEG: [f64; 8] = [0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 80.0, 85.0];

/// Directions per technique of an albedo's quadrature.
const PER_TECHNIQUE: u32 = 2048;

/// Pairs of directions tried for reciprocity and sign.
const PAIRS: u64 = 20_000;

/// What was found.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct PhysicalCheck {
    /// Largest |f(i, o) − f(o, i)| over their mean, with the mean taken as at least 1e-3/sr;
    /// over random pairs, half of them near the mirror direction.
    pub reciprocity: f64,
    /// Directional albedo (reflected over incident power) at [`ALBEDO_ANGLES_DEG`], R, G, B.
    pub albedo: Vec<[f64; 3]>,
    /// The largest of them.
    pub largest_albedo: f64,
    /// Pairs with a negative, infinite or undefined value.
    pub invalid: u64,
    /// Pairs tried.
    pub pairs: u64,
}

impl PhysicalCheck {
    /// Whether reciprocity holds within 1%, the albedo stays below 1.005 (the quadrature's own
    /// error is below half a percent), and all values are valid.
    pub fn passes(&self) -> bool {
        self.reciprocity <= 0.01 && self.excess().is_none() && self.invalid == 0
    }

    /// Where more is reflected than arrives: the largest directional albedo if it is above
    /// 1.005, the angle of incidence in degrees and the channel.
    pub fn excess(&self) -> Option<(f64, f64, usize)> {
        let all = ALBEDO_ANGLES_DEG.iter().zip(&self.albedo);
        all.flat_map(|(&angle, albedo)| (0..3).map(move |c| (albedo[c], angle, c)))
            .filter(|(albedo, ..)| *albedo > 1.005)
            .max_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// Reflected over incident power for light from `to_light` (unit, z > 0), R, G, B,
/// by `per_technique` directions of each technique of [`quadrature`].
pub fn directional_albedo(brdf: &dyn Brdf, to_light: DVec3, per_technique: u32) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (to_viewer, weight) in quadrature::nodes(to_light, per_technique, [0.37, 0.61]) {
        let f = brdf.eval(to_light.as_vec3(), to_viewer.as_vec3());
        for c in 0..3 {
            sum[c] += weight * to_viewer.z * f64::from(f[c]);
        }
    }
    sum
}

/// Runs all checks; deterministic.
pub fn check(brdf: &dyn Brdf) -> PhysicalCheck {
    check_with(brdf, PER_TECHNIQUE, PAIRS)
}

/// [`check`] with a choice of the effort: directions per technique of each albedo, and pairs.
///
/// ```
/// use rig_core::brdf::{check, source};
///
/// let found = check::check_with(source::load("ggx:0.3,1.5")?.as_ref(), 64, 100);
/// assert!(found.passes(), "reciprocal, reflects no more than arrives, no bad values");
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
pub fn check_with(brdf: &dyn Brdf, per_technique: u32, pairs: u64) -> PhysicalCheck {
    let albedo: Vec<[f64; 3]> = ALBEDO_ANGLES_DEG
        .par_iter()
        .map(|theta_deg| {
            let (sin, cos) = theta_deg.to_radians().sin_cos();
            directional_albedo(brdf, DVec3::new(sin, 0.0, cos), per_technique)
        })
        .collect();
    let (reciprocity, invalid) = (0..pairs)
        .into_par_iter()
        .map(|pair| {
            let (i, o) = random_pair(pair);
            let (there, back) = (brdf.eval(i, o), brdf.eval(o, i));
            let invalid = there
                .iter()
                .chain(&back)
                .any(|f| !(f.is_finite() && *f >= 0.0));
            let worst = (0..3)
                .map(|c| {
                    let (a, b) = (f64::from(there[c]), f64::from(back[c]));
                    (a - b).abs() / (0.5 * (a + b)).max(1e-3)
                })
                .fold(0.0, f64::max);
            (worst, u64::from(invalid))
        })
        .reduce(|| (0.0, 0), |a, b| (a.0.max(b.0), a.1 + b.1));
    PhysicalCheck {
        reciprocity,
        largest_albedo: albedo.iter().flatten().copied().fold(0.0, f64::max),
        albedo,
        invalid,
        pairs,
    }
}

fn random_pair(pair: u64) -> (Vec3, Vec3) {
    let mut numbers = stream(1, Purpose::Experiment, 0, pair, 0);
    let mut u = || [numbers.uniform(), numbers.uniform()];
    let i = cosine_direction(u());
    let independent = cosine_direction(u());
    if pair.is_multiple_of(2) {
        return (i.as_vec3(), independent.as_vec3());
    }
    let mirror = DVec3::new(-i.x, -i.y, i.z);
    let near = (mirror + 0.05 * independent).normalize();
    (i.as_vec3(), near.as_vec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Formula(fn(Vec3, Vec3) -> f32);
    impl Brdf for Formula {
        fn eval(&self, i: Vec3, o: Vec3) -> [f32; 3] {
            [(self.0)(i, o); 3]
        }
    }

    #[test]
    fn faults_are_found() {
        use std::f32::consts::FRAC_1_PI;
        let grey = check(&Formula(|_, _| 0.8 * FRAC_1_PI));
        assert!(grey.passes(), "{grey:?}");
        for albedo in &grey.albedo {
            assert!((albedo[1] - 0.8).abs() < 4e-3, "{grey:?}");
        }
        let bright = check(&Formula(|_, _| 1.1 * FRAC_1_PI));
        assert!(!bright.passes() && bright.largest_albedo > 1.09);
        let (albedo, ..) = bright.excess().unwrap();
        assert_eq!(albedo, bright.largest_albedo);
        assert_eq!(grey.excess(), None);
        let lopsided = check(&Formula(|i, _| 0.5 * i.z * FRAC_1_PI));
        assert!(!lopsided.passes() && lopsided.reciprocity > 0.5);
        let negative = check(&Formula(|i, _| i.x.min(0.0)));
        assert!(!negative.passes() && negative.invalid > 1000);
    }
}
