//! A material as a convex mixture of dictionary atoms, per colour channel.

use std::sync::Arc;

use glam::Vec3;

use super::dictionary::{Atom, Dictionary};
use super::evaluator::{Evaluator, MAX_ATOMS};
use super::ggx::{self, Cosines, Mueller};
use super::{Brdf, BrdfError};

/// Dictionary atoms with weights per channel; each channel's weights are
/// non-negative and sum to one.
///
/// ```
/// use std::sync::Arc;
/// use rig_core::brdf::{Atom, Dictionary, Mixture};
///
/// let atoms = vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black];
/// let dictionary = Arc::new(Dictionary::new("greys", atoms)?);
/// // Albedo 0.6 in red, 0.2 in green, 0.1 in blue.
/// let weights = [0.6, 0.2, 0.1].map(|albedo| vec![albedo, 1.0 - albedo]);
/// let mixture = Mixture::new(dictionary.clone(), weights)?;
/// assert_eq!(mixture.weights()[1], [0.2, 0.8]);
///
/// // Weights that do not sum to one are refused.
/// assert!(Mixture::grey(dictionary, vec![0.6, 0.6]).is_err());
/// # Ok::<(), rig_core::brdf::BrdfError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Mixture {
    dictionary: Arc<Dictionary>,
    weights: [Vec<f64>; 3],
    /// Atoms with any weight, for evaluation.
    used: Vec<(Atom, [f32; 3])>,
    /// Of the same.
    evaluator: Evaluator,
}

/// Largest deviation of a channel's weights from a sum of one.
pub const SUM_TOLERANCE: f64 = 1e-6;

impl Mixture {
    /// Weights of R, G, B, one per atom, each ≥ 0 (down to −1e-9 is taken as
    /// 0) and summing to 1 within [`SUM_TOLERANCE`]; anything else is refused.
    pub fn new(dictionary: Arc<Dictionary>, weights: [Vec<f64>; 3]) -> Result<Self, BrdfError> {
        let mut weights = weights;
        for (channel, weights) in ["R", "G", "B"].iter().zip(&mut weights) {
            let refuse = |fact: String| Err(BrdfError::Weights { channel, fact });
            if weights.len() != dictionary.len() {
                return refuse(format!(
                    "{} weights for the {} atoms of {}",
                    weights.len(),
                    dictionary.len(),
                    dictionary.name()
                ));
            }
            for (atom, weight) in weights.iter_mut().enumerate() {
                if !(-1e-9..=1.0 + SUM_TOLERANCE).contains(weight) {
                    return refuse(format!("weight {weight} of atom {atom}, allowed is 0 to 1"));
                }
                *weight = weight.max(0.0);
            }
            let sum: f64 = weights.iter().sum();
            if (sum - 1.0).abs() > SUM_TOLERANCE {
                return refuse(format!("the weights sum to {sum}, not 1"));
            }
        }
        let used: Vec<(Atom, [f32; 3])> = (0..dictionary.len())
            .map(|k| {
                (
                    dictionary.atoms()[k],
                    [0, 1, 2].map(|c| weights[c][k] as f32),
                )
            })
            .filter(|(_, w)| w.iter().any(|&w| w > 0.0))
            .collect();
        Ok(Self {
            dictionary,
            weights,
            evaluator: Evaluator::new(used.iter().map(|(atom, _)| atom)),
            used,
        })
    }

    /// The same weights in all three channels.
    pub fn grey(dictionary: Arc<Dictionary>, weights: Vec<f64>) -> Result<Self, BrdfError> {
        Self::new(dictionary, [weights.clone(), weights.clone(), weights])
    }

    /// The dictionary the weights belong to.
    pub fn dictionary(&self) -> &Arc<Dictionary> {
        &self.dictionary
    }

    /// Weights of R, G, B, indexed as the dictionary's atoms.
    pub fn weights(&self) -> &[Vec<f64>; 3] {
        &self.weights
    }

    /// f per channel from the values of all atoms, in the dictionary's order.
    pub fn of_atoms(&self, atoms: &[f64]) -> [f64; 3] {
        let sum = |weights: &Vec<f64>| weights.iter().zip(atoms).map(|(w, f)| w * f).sum();
        self.weights.each_ref().map(sum)
    }

    /// f_r for polarised light, 1/sr: facets are smooth dielectrics, diffuse reflection
    /// depolarises. `ii` is [`Brdf::eval`].
    pub fn mueller(&self, to_light: Vec3, to_viewer: Vec3) -> [Mueller; 3] {
        let mut sum = [Mueller::default(); 3];
        let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) else {
            return sum;
        };
        for (atom, weights) in &self.used {
            let diffuse = atom.diffuse().map_or(0.0, |diffuse| diffuse.eval(&at));
            let (scale, facet) = atom.facets().map_or_else(Default::default, |facets| {
                (
                    facets.distribution.d_g(facets.alpha as f32, &at),
                    ggx::fresnel_mueller(facets.eta as f32, at.cos_d),
                )
            });
            for (sum, weight) in sum.iter_mut().zip(weights) {
                let lobe = weight * scale;
                sum.ii += lobe * facet.ii + weight * diffuse;
                sum.iq += lobe * facet.iq;
                sum.qq += lobe * facet.qq;
                sum.uu += lobe * facet.uu;
            }
        }
        sum
    }
}

impl Brdf for Mixture {
    fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
        let mut sum = [0.0f32; 3];
        if let Some(at) = Cosines::new(to_light.to_array(), to_viewer.to_array()) {
            let mut values = [0.0; MAX_ATOMS];
            self.evaluator.eval(&at, &mut values);
            for ((_, weights), f) in self.used.iter().zip(values) {
                for (sum, weight) in sum.iter_mut().zip(weights) {
                    *sum += weight * f;
                }
            }
        }
        sum
    }

    fn as_mixture(&self) -> Option<&Mixture> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Arc<Dictionary> {
        let atoms = vec![
            Atom::Ggx {
                alpha: 0.2,
                eta: 1.5,
            },
            Atom::Lambertian { albedo: 1.0 },
        ];
        Arc::new(Dictionary::new("two", atoms).unwrap())
    }

    #[test]
    fn is_the_weighted_sum_of_its_atoms() {
        let weights = [vec![0.25, 0.75], vec![1.0, 0.0], vec![0.0, 1.0]];
        let mixture = Mixture::new(two(), weights).unwrap();
        let (i, o) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.48, 0.36, 0.8));
        let atoms = two().eval(i, o);
        let [r, g, b] = mixture.eval(i, o);
        assert!((r - (0.25 * atoms[0] + 0.75 * atoms[1])).abs() < 1e-7);
        assert_eq!([g, b], [atoms[0], atoms[1]]);
        assert_eq!(mixture.eval(i, -o), [0.0; 3]);
    }

    #[test]
    fn weights_off_the_simplex_are_refused() {
        for (weights, said) in [
            (vec![0.5], "1 weights"),
            (vec![0.5, 0.6], "sum to 1.1"),
            (vec![-0.5, 1.5], "-0.5"),
            (vec![f64::NAN, 1.0], "NaN"),
        ] {
            let error = Mixture::grey(two(), weights).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
