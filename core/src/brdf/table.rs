//! Isotropic BRDFs tabulated over half and difference angles, as MERL does.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::Vec3;
use rayon::prelude::*;

use super::half_difference::HalfDifference;
use super::{Brdf, BrdfError};

/// Cells of MERL's tables in θh, θd, φd.
pub const MERL_SHAPE: [usize; 3] = [90, 90, 180];

/// A BRDF given at nodes and interpolated linearly in between.
///
/// Node (i, j, k) of a shape (I, J, K) is at θh = 90°·(i/I)², θd = 90°·j/J,
/// φd = 180°·k/K, which is the lower corner of the MERL cell of that index. θh is
/// interpolated in √θh; φd wraps at 180°, so the table is reciprocal by
/// construction; beyond the last θh and θd node its value is kept. A shape with K = 1
/// is a bivariate table.
///
/// ```
/// use rig_core::brdf::{Brdf, TabulatedBrdf, source};
///
/// let paint = source::load("ggx:0.4,1.5")?;
/// let table = TabulatedBrdf::from_brdf([90, 90, 1], paint.as_ref());
///
/// let (to_light, to_viewer) = (glam::Vec3::Z, glam::Vec3::new(0.6, 0.0, 0.8));
/// let [exact, ..] = paint.eval(to_light, to_viewer);
/// let [looked_up, ..] = table.eval(to_light, to_viewer);
/// assert!((looked_up / exact - 1.0).abs() < 0.01);
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct TabulatedBrdf {
    shape: [usize; 3],
    /// f_r of R, G, B, 1/sr, φd fastest.
    values: Vec<[f32; 3]>,
    gaps: Gaps,
}

/// Nodes above the horizon that came without a value, and took their neighbour's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Gaps {
    /// Those with a negative value: not measured.
    pub negative: usize,
    /// Those with an infinite or undefined value.
    pub not_finite: usize,
    /// All nodes, also those below the horizon.
    pub nodes: usize,
}

impl Gaps {
    /// Whether it is still a measured table: every value is a number, and at most half of the
    /// nodes were not measured (the published tables lack some at grazing angles).
    pub fn are_few(&self) -> bool {
        self.not_finite == 0 && 2 * self.negative <= self.nodes
    }
}

impl TabulatedBrdf {
    /// From values in order θh, θd, φd (fastest), 1/sr. Values that are negative or
    /// not finite mark directions below the horizon (or not measured) and take
    /// the value of the next smaller θd. Refused: an axis of length 0, or a count of values that is not
    /// the shape's.
    pub fn new(shape: [usize; 3], mut values: Vec<[f32; 3]>) -> Result<Self, BrdfError> {
        let cells = shape.iter().try_fold(1usize, |n, &k| n.checked_mul(k));
        if cells != Some(values.len()) || values.is_empty() {
            let fact = format!("{} values for a shape of {shape:?}", values.len());
            return Err(BrdfError::Table { fact });
        }
        let [_, n_d, n_phi] = shape;
        let mut gaps = Gaps {
            nodes: values.len(),
            ..Gaps::default()
        };
        for (i, slab) in values.chunks_exact_mut(n_d * n_phi).enumerate() {
            for at in 0..slab.len() {
                let is_number = slab[at].iter().all(|v| v.is_finite());
                if !is_number || slab[at].iter().any(|&v| v < 0.0) {
                    let (to_light, to_viewer) =
                        node(shape, [i, at / n_phi, at % n_phi]).to_directions();
                    if to_light.z > 0.0 && to_viewer.z > 0.0 {
                        gaps.negative += usize::from(is_number);
                        gaps.not_finite += usize::from(!is_number);
                    }
                }
                let nearer = at.checked_sub(n_phi).map_or([0.0; 3], |at| slab[at]);
                for (value, nearer) in slab[at].iter_mut().zip(nearer) {
                    if !(*value >= 0.0 && value.is_finite()) {
                        *value = nearer;
                    }
                }
            }
        }
        Ok(Self {
            shape,
            values,
            gaps,
        })
    }

    /// Evaluates `f` at all nodes whose directions are above the horizon, in parallel.
    pub fn tabulate(shape: [usize; 3], f: impl Fn(HalfDifference) -> [f32; 3] + Sync) -> Self {
        let shape = shape.map(|n| n.max(1));
        let [n_h, n_d, n_phi] = shape;
        let values = (0..n_h * n_d)
            .into_par_iter()
            .flat_map_iter(|row| {
                let f = &f;
                (0..n_phi).map(move |k| {
                    let angles = node(shape, [row / n_d, row % n_d, k]);
                    let (i, o) = angles.to_directions();
                    if i.z > 0.0 && o.z > 0.0 {
                        f(angles)
                    } else {
                        [f32::NAN; 3]
                    }
                })
            })
            .collect();
        Self::new(shape, values).expect("one value per node")
    }

    /// Samples any BRDF at the nodes, averaging the two orders of the directions.
    pub fn from_brdf(shape: [usize; 3], brdf: &dyn Brdf) -> Self {
        Self::tabulate(shape, |angles| {
            let (i, o) = angles.to_directions();
            let (i, o) = (i.as_vec3(), o.as_vec3());
            let (there, back) = (brdf.eval(i, o), brdf.eval(o, i));
            [0, 1, 2].map(|c| 0.5 * (there[c] + back[c]))
        })
    }

    /// What it came without.
    pub fn gaps(&self) -> Gaps {
        self.gaps
    }

    /// Number of nodes in θh, θd, φd.
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// f_r of R, G, B at the nodes, 1/sr, in order θh, θd, φd (fastest).
    pub fn values(&self) -> &[[f32; 3]] {
        &self.values
    }

    /// Interpolated f_r of R, G, B, 1/sr; the horizon is not looked at.
    pub fn lookup(&self, theta_h_rad: f32, theta_d_rad: f32, phi_d_rad: f32) -> [f32; 3] {
        let [n_h, n_d, n_phi] = self.shape;
        let quarter = std::f32::consts::FRAC_PI_2;
        let (h, h1, th) = bracket((theta_h_rad / quarter).max(0.0).sqrt() * n_h as f32, n_h);
        let (d, d1, td) = bracket(theta_d_rad / quarter * n_d as f32, n_d);
        let turn = (phi_d_rad * std::f32::consts::FRAC_1_PI).rem_euclid(1.0) * n_phi as f32;
        let tp = turn.fract();
        let (p, p1) = (turn as usize % n_phi, (turn as usize + 1) % n_phi);
        let at = |h: usize, d: usize, p: usize| &self.values[(h * n_d + d) * n_phi + p];
        let corners = [
            (at(h, d, p), (1.0 - th) * (1.0 - td) * (1.0 - tp)),
            (at(h, d, p1), (1.0 - th) * (1.0 - td) * tp),
            (at(h, d1, p), (1.0 - th) * td * (1.0 - tp)),
            (at(h, d1, p1), (1.0 - th) * td * tp),
            (at(h1, d, p), th * (1.0 - td) * (1.0 - tp)),
            (at(h1, d, p1), th * (1.0 - td) * tp),
            (at(h1, d1, p), th * td * (1.0 - tp)),
            (at(h1, d1, p1), th * td * tp),
        ];
        let mut sum = [0.0; 3];
        for (value, weight) in corners {
            for c in 0..3 {
                sum[c] += weight * value[c];
            }
        }
        sum
    }
}

/// The angles of a node, see [`TabulatedBrdf`].
pub fn node([n_h, n_d, n_phi]: [usize; 3], [i, j, k]: [usize; 3]) -> HalfDifference {
    HalfDifference {
        theta_h_rad: FRAC_PI_2 * (i as f64 / n_h as f64).powi(2),
        theta_d_rad: FRAC_PI_2 * j as f64 / n_d as f64,
        phi_d_rad: PI * k as f64 / n_phi as f64,
    }
}

/// Lower node, upper node and the fraction between, clamped to the last node.
fn bracket(position: f32, n: usize) -> (usize, usize, f32) {
    let last = n - 1;
    let lower = (position as usize).min(last);
    let fraction = (position - lower as f32).clamp(0.0, 1.0);
    (lower, (lower + 1).min(last), fraction)
}

impl Brdf for TabulatedBrdf {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        if !(to_light.z > 0.0 && to_viewer.z > 0.0) {
            return [0.0; 3];
        }
        let sum = to_light + to_viewer;
        let horizontal = sum.x.hypot(sum.y);
        let theta_h = horizontal.atan2(sum.z);
        let theta_d = (to_light - to_viewer).length().atan2(sum.length());
        let (cos_phi, sin_phi) = if horizontal > 0.0 {
            (sum.x / horizontal, sum.y / horizontal)
        } else {
            (1.0, 0.0)
        };
        // Half the difference vector has no component along h, so its azimuth about h is φd.
        let half = 0.5 * (to_light - to_viewer);
        let along = cos_phi * half.x + sin_phi * half.y;
        let across = cos_phi * half.y - sin_phi * half.x;
        let cos_h = sum.z / sum.length();
        let sin_h = horizontal / sum.length();
        let phi_d = across.atan2(cos_h * along - sin_h * half.z);
        self.lookup(theta_h, theta_d, phi_d)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::dictionary::Dictionary;
    use crate::brdf::mixture::Mixture;
    use crate::random::{Purpose, stream};
    use std::sync::Arc;

    fn smooth() -> Mixture {
        let dictionary = Arc::new(Dictionary::paper42());
        let mut weights = vec![0.0; 42];
        (weights[2], weights[40], weights[41]) = (0.5, 0.3, 0.2);
        Mixture::grey(dictionary, weights).unwrap()
    }

    #[test]
    fn a_tabulated_smooth_brdf_is_the_brdf() {
        let exact = smooth();
        let table = TabulatedBrdf::from_brdf([90, 90, 36], &exact);
        let mut numbers = stream(5, Purpose::Experiment, 0, 0, 0);
        for _ in 0..2000 {
            let mut direction = || {
                let d = crate::brdf::atom::cosine_direction([
                    numbers.uniform(),
                    0.85 * numbers.uniform(),
                ]);
                d.as_vec3()
            };
            let (i, o) = (direction(), direction());
            let (want, got) = (exact.eval(i, o)[0], table.eval(i, o)[0]);
            assert!(
                (want - got).abs() < 0.02 * want,
                "{i} {o}: {got} for {want}"
            );
            let swapped = table.eval(o, i)[0];
            assert!((swapped - got).abs() < 1e-3 * got, "{swapped} {got}");
        }
        assert_eq!(table.eval(Vec3::Z, -Vec3::Z), [0.0; 3]);
    }

    #[test]
    fn nodes_are_reproduced() {
        let shape = [5, 7, 4];
        let table = TabulatedBrdf::tabulate(shape, |a| {
            [
                a.theta_h_rad as f32,
                a.theta_d_rad as f32,
                a.phi_d_rad as f32,
            ]
        });
        let a = node(shape, [3, 2, 1]);
        let got = table.lookup(
            a.theta_h_rad as f32,
            a.theta_d_rad as f32,
            a.phi_d_rad as f32,
        );
        for (got, want) in got
            .into_iter()
            .zip([a.theta_h_rad, a.theta_d_rad, a.phi_d_rad])
        {
            assert!((f64::from(got) - want).abs() < 1e-5);
        }
    }

    #[test]
    fn wrong_counts_are_refused_and_holes_are_filled() {
        assert!(TabulatedBrdf::new([2, 2, 2], vec![[0.0; 3]; 7]).is_err());
        assert!(TabulatedBrdf::new([0, 2, 2], vec![]).is_err());
        assert!(TabulatedBrdf::new([usize::MAX, 2, 2], vec![]).is_err());
        let values = vec![[1.0; 3], [-1.0; 3], [f32::NAN; 3]];
        let table = TabulatedBrdf::new([1, 3, 1], values).unwrap();
        assert_eq!(table.values(), [[1.0; 3]; 3]);
    }
}
