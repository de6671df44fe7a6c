//! Measured materials as small neural networks.
//!
//! Sztrajman et al. 2021, "Neural BRDF Representation and Importance Sampling":
//! networks 6-21-21-3 over the half vector (φh = 0) and the difference vector, with
//! ReLU after both hidden layers and max(eˣ − 1, 0) at the end, trained on
//! materials of the MERL database. The 26 networks here are MIT-licensed, see
//! data/nbrdf/NOTICE.md.
//!
//! A network is not exactly reciprocal, so both orders of the directions are
//! averaged. As training left them, the materials are darker than real ones
//! (the brightest reflects 0.34 at normal incidence), mirror-like metals
//! unphysically so.

use glam::Vec3;

use super::Brdf;
use super::half_difference::HalfDifference;
use super::table::TabulatedBrdf;

/// Names of the embedded materials.
pub const NAMES: [&str; 26] = [
    "alum-bronze",
    "pink-jasper",
    "pvc",
    "red-plastic",
    "silver-paint",
    "white-diffuse-bball",
    "aluminium",
    "black-oxidized-steel",
    "black-phenolic",
    "blue-acrylic",
    "blue-metallic-paint",
    "blue-rubber",
    "brass",
    "cherry-235",
    "chrome",
    "dark-red-paint",
    "delrin",
    "gold-metallic-paint",
    "green-fabric",
    "green-latex",
    "ipswich-pine-221",
    "light-brown-fabric",
    "pearl-paint",
    "polyethylene",
    "teflon",
    "yellow-matte-plastic",
];

/// What [`super::source::load`] takes for each embedded material, sorted.
pub fn specs() -> Vec<String> {
    let mut specs = NAMES.map(|name| format!("nbrdf:{name}")).to_vec();
    specs.sort();
    specs
}

const HIDDEN: usize = 21;
const PARAMETERS: usize = 675;
static WEIGHTS: &[u8; 4 * PARAMETERS * NAMES.len()] =
    include_bytes!("../../data/nbrdf/merl_rgb.f32");

/// Nodes of the table that stands for a network in rendering: MERL's, with
/// φd every 3°, over which the networks are smooth.
pub const TABLE_SHAPE: [usize; 3] = [90, 90, 60];

/// One material's network.
#[derive(Clone, Debug)]
pub struct NeuralBrdf {
    w1: [[f32; HIDDEN]; 6],
    b1: [f32; HIDDEN],
    w2: [[f32; HIDDEN]; HIDDEN],
    b2: [f32; HIDDEN],
    w3: [[f32; 3]; HIDDEN],
    b3: [f32; 3],
}

impl NeuralBrdf {
    /// One of [`NAMES`]; `None` for any other.
    pub fn named(name: &str) -> Option<Self> {
        let index = NAMES.iter().position(|n| *n == name)?;
        let mut numbers = WEIGHTS.as_chunks::<4>().0[index * PARAMETERS..]
            .iter()
            .map(|word| f32::from_le_bytes(*word));
        let mut next = || numbers.next().unwrap_or(0.0);
        Some(Self {
            w1: std::array::from_fn(|_| std::array::from_fn(|_| next())),
            b1: std::array::from_fn(|_| next()),
            w2: std::array::from_fn(|_| std::array::from_fn(|_| next())),
            b2: std::array::from_fn(|_| next()),
            w3: std::array::from_fn(|_| std::array::from_fn(|_| next())),
            b3: std::array::from_fn(|_| next()),
        })
    }

    /// The network's output for one order of the directions, 1/sr.
    fn forward(&self, input: [f32; 6]) -> [f32; 3] {
        let first = relu(layer(&self.w1, &self.b1, &input));
        let second = relu(layer(&self.w2, &self.b2, &first));
        layer(&self.w3, &self.b3, &second).map(|x| (x.exp() - 1.0).max(0.0))
    }

    /// f_r of R, G, B, 1/sr, the mean of both orders; the horizon is not looked at.
    pub fn at(&self, angles: HalfDifference) -> [f32; 3] {
        let (sin_h, cos_h) = angles.theta_h_rad.sin_cos();
        let (sin_d, cos_d) = angles.theta_d_rad.sin_cos();
        let (sin_phi, cos_phi) = angles.phi_d_rad.sin_cos();
        let (x, y) = (sin_d * cos_phi, sin_d * sin_phi);
        let input = |sign: f64| [sin_h, 0.0, cos_h, sign * x, sign * y, cos_d].map(|v| v as f32);
        let (there, back) = (self.forward(input(1.0)), self.forward(input(-1.0)));
        [0, 1, 2].map(|c| 0.5 * (there[c] + back[c]))
    }

    /// The table that stands for the network where it is evaluated often, see [`TABLE_SHAPE`].
    pub fn tabulate(&self) -> TabulatedBrdf {
        TabulatedBrdf::tabulate(TABLE_SHAPE, |angles| self.at(angles))
    }
}

fn layer<const IN: usize, const OUT: usize>(
    weights: &[[f32; OUT]; IN],
    bias: &[f32; OUT],
    input: &[f32; IN],
) -> [f32; OUT] {
    let mut sum = *bias;
    for (row, x) in weights.iter().zip(input) {
        for (sum, w) in sum.iter_mut().zip(row) {
            *sum += w * x;
        }
    }
    sum
}

fn relu<const N: usize>(values: [f32; N]) -> [f32; N] {
    values.map(|x| x.max(0.0))
}

impl Brdf for NeuralBrdf {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        if !(to_light.z > 0.0 && to_viewer.z > 0.0) {
            return [0.0; 3];
        }
        self.at(HalfDifference::from_directions(
            to_light.as_dvec3(),
            to_viewer.as_dvec3(),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::atom::cosine_direction;
    use crate::random::{Purpose, stream};

    #[test]
    fn all_materials_are_finite_reciprocal_and_not_black() {
        let mut numbers = stream(6, Purpose::Experiment, 0, 0, 0);
        for name in NAMES {
            let brdf = NeuralBrdf::named(name).unwrap();
            let mut sum = 0.0;
            for _ in 0..200 {
                let i = cosine_direction([numbers.uniform(), numbers.uniform()]).as_vec3();
                let o = cosine_direction([numbers.uniform(), numbers.uniform()]).as_vec3();
                let (there, back) = (brdf.eval(i, o), brdf.eval(o, i));
                for c in 0..3 {
                    assert!(there[c].is_finite() && there[c] >= 0.0, "{name}");
                    assert!(
                        (there[c] - back[c]).abs() <= 1e-3 * there[c] + 1e-6,
                        "{name}"
                    );
                    sum += there[c];
                }
            }
            assert!(sum > 0.1, "{name} is black: {sum}");
        }
        assert!(NeuralBrdf::named("unobtainium").is_none());
    }

    #[test]
    fn red_plastic_is_red_and_blue_rubber_blue() {
        let diffuse = |name| {
            let i = Vec3::new(0.6, 0.0, 0.8);
            NeuralBrdf::named(name)
                .unwrap()
                .eval(i, Vec3::new(0.0, 0.6, 0.8))
        };
        let [r, g, b] = diffuse("red-plastic");
        assert!(r > 3.0 * g && r > 3.0 * b, "{r} {g} {b}");
        let [r, g, b] = diffuse("blue-rubber");
        assert!(b > r && b > g, "{r} {g} {b}");
    }
}
