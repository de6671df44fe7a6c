//! All atoms of a dictionary at one pair of directions: each lobe's D·G once per distinct
//! distribution and width, each Fresnel factor and each coat once per distinct index.

use super::atom::{Atom, Diffuse, Distribution, Facets};
use super::ggx::{self, Cosines};
use super::{beckmann, coat};

/// Most atoms a dictionary may have.
pub const MAX_ATOMS: usize = 256;

/// Evaluates several atoms at once.
#[derive(Clone, Debug)]
pub struct Evaluator {
    /// Distinct widths: those of GGX first, then those of Beckmann, so that each kind is one
    /// loop without a branch, which the compiler does several lanes at a time.
    alphas: Vec<f32>,
    /// How many are of GGX.
    ggx: usize,
    /// Distinct indices of facets.
    etas: Vec<f32>,
    /// Distinct indices of coats, with their norms, 1/sr.
    coats: Vec<(f32, f32)>,
    terms: Vec<Term>,
}

/// An atom by the positions of its parts.
#[derive(Clone, Copy, Debug)]
enum Term {
    /// In `alphas` and `etas`.
    Facets(usize, usize),
    /// In `coats`.
    Coat(usize),
    /// 1/sr.
    Constant(f32),
}

impl Evaluator {
    /// For these atoms, at most [`MAX_ATOMS`].
    pub fn new<'a>(atoms: impl Iterator<Item = &'a Atom> + Clone) -> Self {
        fn index_in<T: PartialEq>(values: &mut Vec<T>, value: T) -> usize {
            values.iter().position(|v| *v == value).unwrap_or_else(|| {
                values.push(value);
                values.len() - 1
            })
        }
        let mut lobes = Vec::new();
        for facets in atoms.clone().filter_map(Atom::facets) {
            index_in(&mut lobes, lobe(&facets));
        }
        lobes.sort_by_key(|&(distribution, _)| distribution != Distribution::Ggx);
        let (mut etas, mut coats) = (Vec::new(), Vec::new());
        let terms = atoms
            .map(|atom| match (atom.facets(), atom.diffuse()) {
                (Some(facets), _) => Term::Facets(
                    index_in(&mut lobes, lobe(&facets)),
                    index_in(&mut etas, facets.eta as f32),
                ),
                (None, Some(Diffuse::Coated { eta })) => {
                    Term::Coat(index_in(&mut coats, (eta as f32, coat::norm(eta) as f32)))
                }
                (None, Some(Diffuse::Lambertian(albedo))) => {
                    Term::Constant(albedo as f32 * std::f32::consts::FRAC_1_PI)
                }
                (None, None) => Term::Constant(0.0),
            })
            .collect();
        Self {
            ggx: lobes.partition_point(|&(distribution, _)| distribution == Distribution::Ggx),
            alphas: lobes.into_iter().map(|(_, alpha)| alpha).collect(),
            etas,
            coats,
            terms,
        }
    }

    /// Writes f_r of each atom, 1/sr; `values` is one per atom.
    #[inline]
    pub fn eval(&self, at: &Cosines<f32>, values: &mut [f32]) {
        let (mut lobes, mut fresnel) = ([0.0; MAX_ATOMS], [0.0; MAX_ATOMS]);
        let mut coats = [0.0; MAX_ATOMS];
        let (ggx, beckmann) = self.alphas.split_at(self.ggx);
        for (value, &alpha) in lobes.iter_mut().zip(ggx) {
            *value = ggx::d_g(alpha, at.cos_i, at.cos_o, at.sin2_h);
        }
        for (value, &alpha) in lobes[self.ggx..].iter_mut().zip(beckmann) {
            *value = beckmann::d_g(alpha, at.cos_i, at.cos_o, at.sin2_h);
        }
        for (value, &eta) in fresnel.iter_mut().zip(&self.etas) {
            *value = ggx::fresnel(eta, at.cos_d);
        }
        for (value, &(eta, norm)) in coats.iter_mut().zip(&self.coats) {
            *value = coat::eval(eta, norm, at.cos_i, at.cos_o);
        }
        for (value, term) in values.iter_mut().zip(&self.terms) {
            *value = match *term {
                Term::Facets(lobe, eta) => lobes[lobe] * fresnel[eta],
                Term::Coat(coat) => coats[coat],
                Term::Constant(value) => value,
            };
        }
    }
}

/// What of facets decides D·G.
fn lobe(facets: &Facets) -> (Distribution, f32) {
    (facets.distribution, facets.alpha as f32)
}
