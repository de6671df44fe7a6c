//! All atoms of a dictionary at one pair of directions: each lobe's D·G once per distinct
//! distribution and width, each Fresnel factor and each coat once per distinct index.

use super::atom::{Atom, Diffuse, Distribution};
use super::ggx::{self, Cosines};
use super::{beckmann, coat};
use crate::widened::widened;

/// Most atoms a dictionary may have.
pub const MAX_ATOMS: usize = 256;

/// Numbers that are computed side by side.
const LANES: usize = 8;

/// Room for the factors of any dictionary, and of the usual ones; powers of two.
const MOST: usize = 2 * MAX_ATOMS;
const FEW: usize = 64;

/// Evaluates several atoms at once. Each is the product of a first factor (D·G of a lobe, a coat or
/// a constant) and a second one (Fresnel's, or one).
#[derive(Clone, Debug)]
pub struct Evaluator {
    /// Distinct widths of GGX.
    ggx: Vec<[f32; LANES]>,
    /// Distinct widths of Beckmann.
    beckmann: Vec<f32>,
    /// Distinct indices of coats, with their norms, 1/sr.
    coats: Vec<(f32, f32)>,
    /// Distinct constants, 1/sr.
    constants: Vec<f32>,
    /// Distinct indices of facets.
    etas: Vec<[f32; LANES]>,
    /// Of each atom, the places of its first factor, in the order above, and of its second one,
    /// of which the first [`LANES`] are one.
    factors: Vec<[u16; 2]>,
}

/// The first factor of an atom, by its place among those of its kind.
enum First {
    Ggx(usize),
    Beckmann(usize),
    Coat(usize),
    Constant(usize),
}

impl Evaluator {
    /// For these atoms, at most [`MAX_ATOMS`].
    pub fn new<'a>(atoms: impl Iterator<Item = &'a Atom>) -> Self {
        let (mut ggx, mut beckmann, mut etas) = (Vec::new(), Vec::new(), Vec::new());
        let (mut coats, mut constants) = (Vec::new(), Vec::new());
        let factors: Vec<(First, usize)> = atoms
            .map(|atom| match (atom.facets(), atom.diffuse()) {
                (Some(facets), _) => {
                    let alpha = facets.alpha as f32;
                    let lobe = match facets.distribution {
                        Distribution::Ggx => First::Ggx(place_in(&mut ggx, alpha)),
                        Distribution::Beckmann => First::Beckmann(place_in(&mut beckmann, alpha)),
                    };
                    (lobe, LANES + place_in(&mut etas, facets.eta as f32))
                }
                (None, Some(Diffuse::Coated { eta })) => {
                    let coat = (eta as f32, coat::norm(eta) as f32);
                    (First::Coat(place_in(&mut coats, coat)), 0)
                }
                (None, diffuse) => {
                    let albedo = match diffuse {
                        Some(Diffuse::Lambertian(albedo)) => albedo as f32,
                        _ => 0.0,
                    };
                    let constant = albedo * std::f32::consts::FRAC_1_PI;
                    (First::Constant(place_in(&mut constants, constant)), 0)
                }
            })
            .collect();
        let (ggx, etas) = (in_lanes(&ggx), in_lanes(&etas));
        let of_beckmann = LANES * ggx.len();
        let of_coats = of_beckmann + beckmann.len();
        let of_constants = of_coats + coats.len();
        let place = |first| match first {
            First::Ggx(k) => k,
            First::Beckmann(k) => of_beckmann + k,
            First::Coat(k) => of_coats + k,
            First::Constant(k) => of_constants + k,
        };
        let factors = factors.into_iter();
        Self {
            factors: factors
                .map(|(first, second)| [place(first) as u16, second as u16])
                .collect(),
            ggx,
            beckmann,
            coats,
            constants,
            etas,
        }
    }

    /// Writes f_r of each atom, 1/sr; `values` is one per atom.
    #[inline]
    pub fn eval(&self, at: &Cosines<f32>, values: &mut [f32]) {
        let firsts =
            LANES * self.ggx.len() + self.beckmann.len() + self.coats.len() + self.constants.len();
        match firsts.max(LANES * (1 + self.etas.len())) <= FEW {
            true => eval::<FEW>(self, at, values),
            false => eval::<MOST>(self, at, values),
        }
    }
}

/// The place of a value among distinct ones, to which it is added where it is new.
fn place_in<T: PartialEq>(distinct: &mut Vec<T>, value: T) -> usize {
    let known = distinct.iter().position(|v| *v == value);
    known.unwrap_or_else(|| {
        distinct.push(value);
        distinct.len() - 1
    })
}

/// Values in lanes, the last ones repeated in those that are left.
fn in_lanes(values: &[f32]) -> Vec<[f32; LANES]> {
    let lanes = |part: &[f32]| std::array::from_fn(|k| part[k.min(part.len() - 1)]);
    values.chunks(LANES).map(lanes).collect()
}

widened! {
    /// With room for `N` factors.
    #[allow(clippy::needless_range_loop, reason = "closures would not be compiled for AVX2")]
    fn eval<const N: usize>(of: &Evaluator, at: &Cosines<f32>, values: &mut [f32]) {
        let (mut first, mut second) = ([0.0f32; N], [1.0f32; N]);
        let (lobes, others) = first.split_at_mut(LANES * of.ggx.len());
        for (lobes, alphas) in lobes.chunks_exact_mut(LANES).zip(&of.ggx) {
            for k in 0..LANES {
                lobes[k] = ggx::d_g(alphas[k], at.cos_i, at.cos_o, at.sin2_h);
            }
        }
        let (lobes, others) = others.split_at_mut(of.beckmann.len());
        for (lobe, &alpha) in lobes.iter_mut().zip(&of.beckmann) {
            *lobe = beckmann::d_g(alpha, at.cos_i, at.cos_o, at.sin2_h);
        }
        let (coats, constants) = others.split_at_mut(of.coats.len());
        for (value, &(eta, norm)) in coats.iter_mut().zip(&of.coats) {
            *value = coat::eval(eta, norm, at.cos_i, at.cos_o);
        }
        constants[..of.constants.len()].copy_from_slice(&of.constants);
        let fresnel = second[LANES..].chunks_exact_mut(LANES);
        for (fresnel, etas) in fresnel.zip(&of.etas) {
            for k in 0..LANES {
                fresnel[k] = ggx::fresnel(etas[k], at.cos_d);
            }
        }
        for (value, [a, b]) in values.iter_mut().zip(&of.factors) {
            // N is a power of two: the places are all within.
            *value = first[usize::from(*a) % N] * second[usize::from(*b) % N];
        }
    }
}
