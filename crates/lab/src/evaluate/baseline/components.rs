//! Principal components of log-relative BRDFs, and the linear reconstruction by them.
//!
//! The mapping, the mean, the scaled components Q = UΣ and the ridge are those of Nielsen,
//! Jensen and Ramamoorthi, "On Optimal, Minimal BRDF Sampling for Reflectance Acquisition"
//! (2015). Every colour channel of every training material is one column. As Q = XV for the
//! centred columns X, a component's value at any pair of directions follows from the training
//! materials there, and no component is interpolated.

use glam::Vec3;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rayon::prelude::*;

use crate::brdf::nbrdf::{NAMES, NeuralBrdf};
use crate::brdf::table::node;
use crate::brdf::{Brdf, BrdfError, TabulatedBrdf};

/// ε of the mapping, 1/sr, and least cosine weight.
pub const EPSILON: f64 = 0.001;

/// Components whose squared singular value is below this part of the largest are dropped: the
/// centred columns have one direction fewer than their number.
const RANK_TOLERANCE: f64 = 1e-10;

/// Materials to learn from, on one grid of half and difference angles.
pub struct Training {
    shape: [usize; 3],
    materials: Vec<(String, TabulatedBrdf)>,
}

impl Training {
    /// The embedded measured materials at the nodes of `shape` (θh, θd, φd).
    pub fn embedded(shape: [usize; 3]) -> Self {
        let tabulate = |name: &&str| {
            let network = NeuralBrdf::named(name)?;
            let table = TabulatedBrdf::tabulate(shape, |angles| network.at(angles));
            Some(((*name).to_owned(), table))
        };
        Self {
            shape,
            materials: NAMES.iter().filter_map(tabulate).collect(),
        }
    }

    /// The components of all materials but the one called `left_out`.
    pub fn without(&self, left_out: &str) -> Components<'_> {
        let kept = self.materials.iter().filter(|(name, _)| name != left_out);
        Components::new(self.shape, kept.map(|(_, table)| table).collect())
    }
}

/// Cosine weight of a pair of directions, max(cos θi cos θo, ε).
pub fn cosine_weight(to_light: Vec3, to_viewer: Vec3) -> f64 {
    f64::from(to_light.z * to_viewer.z).max(EPSILON)
}

/// ln((f w + ε) / (f_ref w + ε)).
pub fn log_relative(f: f64, reference: f64, weight: f64) -> f64 {
    ((f * weight + EPSILON) / (reference * weight + EPSILON)).ln()
}

/// The inverse of [`log_relative`]; 0 where that is negative.
pub fn from_log_relative(mapped: f64, reference: f64, weight: f64) -> f64 {
    ((mapped.exp() * (reference * weight + EPSILON) - EPSILON) / weight).max(0.0)
}

/// The training columns at one pair of directions.
struct Entry {
    weight: f64,
    /// Median over the columns, 1/sr.
    reference: f64,
    /// Mean of the mapped columns.
    mean: f64,
    /// Mapped columns less their mean.
    centred: Vec<f64>,
}

impl Entry {
    fn new(columns: &[f64], weight: f64) -> Self {
        let reference = median(columns);
        let mut centred: Vec<f64> = columns
            .iter()
            .map(|&f| log_relative(f, reference, weight))
            .collect();
        let mean = centred.iter().sum::<f64>() / centred.len() as f64;
        centred.iter_mut().for_each(|x| *x -= mean);
        Self {
            weight,
            reference,
            mean,
            centred,
        }
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    0.5 * (sorted[(n - 1) / 2] + sorted[n / 2])
}

/// Measured directions: what the columns say of each, and the scaled components there.
pub struct Rows {
    entries: Vec<Entry>,
    /// Directions × components, rows of UΣ.
    pub scaled: DMatrix<f64>,
}

/// Principal components of some training materials.
pub struct Components<'a> {
    shape: [usize; 3],
    tables: Vec<&'a TabulatedBrdf>,
    /// V: columns × components, by falling singular value.
    right: DMatrix<f64>,
    /// Σ², squares of the singular values.
    squares: DVector<f64>,
}

impl<'a> Components<'a> {
    /// The components of `tables`, all of one `shape`, with every node above the horizon
    /// counted alike.
    fn new(shape: [usize; 3], tables: Vec<&'a TabulatedBrdf>) -> Self {
        let mut components = Self {
            shape,
            right: DMatrix::zeros(3 * tables.len(), 0),
            squares: DVector::zeros(0),
            tables,
        };
        let columns = 3 * components.tables.len();
        // XᵀX by slabs of θh, added in their order.
        let slabs: Vec<DMatrix<f64>> = (0..shape[0])
            .into_par_iter()
            .map(|slab| {
                let entries: Vec<Entry> = components.slab(slab).flatten().collect();
                let x = DMatrix::from_fn(entries.len(), columns, |i, j| entries[i].centred[j]);
                x.tr_mul(&x)
            })
            .collect();
        let gram = slabs
            .into_iter()
            .fold(DMatrix::zeros(columns, columns), |sum, slab| sum + slab);
        let eigen = SymmetricEigen::new(gram);
        let mut order: Vec<usize> = (0..columns).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let least = RANK_TOLERANCE * order.first().map_or(0.0, |&k| eigen.eigenvalues[k]);
        order.retain(|&k| eigen.eigenvalues[k] > least);
        components.right = eigen.eigenvectors.select_columns(&order);
        components.squares = eigen.eigenvalues.select_rows(&order);
        components
    }

    /// Number of training columns: materials times channels.
    pub fn columns(&self) -> usize {
        self.right.nrows()
    }

    /// Squares of the singular values, falling: sums over the grid of a scaled component's
    /// squares.
    pub fn squares(&self) -> &DVector<f64> {
        &self.squares
    }

    /// The entries of all nodes of one θh; `None` below the horizon.
    fn slab(&self, i: usize) -> impl Iterator<Item = Option<Entry>> + '_ {
        let [_, n_d, n_phi] = self.shape;
        (0..n_d * n_phi).map(move |at| {
            let (to_light, to_viewer) =
                node(self.shape, [i, at / n_phi, at % n_phi]).to_directions();
            if !(to_light.z > 0.0 && to_viewer.z > 0.0) {
                return None;
            }
            let index = i * n_d * n_phi + at;
            let columns: Vec<f64> = self
                .tables
                .iter()
                .flat_map(|table| table.values()[index].map(f64::from))
                .collect();
            let weight = cosine_weight(to_light.as_vec3(), to_viewer.as_vec3());
            Some(Entry::new(&columns, weight))
        })
    }

    /// The rows of some pairs (to light, to viewer) above the horizon.
    pub fn rows(&self, directions: &[(Vec3, Vec3)]) -> Rows {
        let entries: Vec<Entry> = directions
            .par_iter()
            .map(|&(to_light, to_viewer)| {
                let of = |table: &&TabulatedBrdf| table.eval(to_light, to_viewer).map(f64::from);
                let columns: Vec<f64> = self.tables.iter().flat_map(of).collect();
                Entry::new(&columns, cosine_weight(to_light, to_viewer))
            })
            .collect();
        let x = DMatrix::from_fn(entries.len(), self.columns(), |i, j| entries[i].centred[j]);
        Rows {
            scaled: x * &self.right,
            entries,
        }
    }

    /// How many components are fitted to `observations` values: as many as there are values,
    /// at most all, as the authors' program does.
    pub fn fitted(&self, observations: usize) -> usize {
        observations.min(self.right.ncols())
    }

    /// The BRDF whose values `f` (R, G, B, 1/sr) were measured at `rows`, by ridge regression
    /// c = (QᵀQ + ridge)⁻¹ Qᵀ(x − mean) of each channel, as a table on the training's grid.
    pub fn reconstruct(
        &self,
        rows: &Rows,
        f: &[[f64; 3]],
        ridge: f64,
    ) -> Result<TabulatedBrdf, BrdfError> {
        // The coefficients of the components, then of the training columns.
        let count = self.fitted(f.len());
        let q = rows.scaled.columns(0, count);
        let eigen = SymmetricEigen::new(q.tr_mul(&q));
        let least = RANK_TOLERANCE * eigen.eigenvalues.max();
        let combination = [0, 1, 2].map(|channel| {
            let residual = DVector::from_iterator(
                f.len(),
                rows.entries.iter().zip(f).map(|(entry, f)| {
                    log_relative(f[channel], entry.reference, entry.weight) - entry.mean
                }),
            );
            let mut along = eigen.eigenvectors.tr_mul(&q.tr_mul(&residual));
            for (along, &square) in along.iter_mut().zip(&eigen.eigenvalues) {
                *along = if square > least {
                    *along / (square + ridge)
                } else {
                    0.0
                };
            }
            self.right.columns(0, count) * (&eigen.eigenvectors * along)
        });
        // The table.
        let values: Vec<[f32; 3]> = (0..self.shape[0])
            .into_par_iter()
            .flat_map_iter(|slab| {
                let combination = &combination;
                self.slab(slab).map(move |entry| {
                    let Some(entry) = entry else {
                        return [f32::NAN; 3];
                    };
                    [0, 1, 2].map(|channel| {
                        let along: f64 = entry
                            .centred
                            .iter()
                            .zip(combination[channel].iter())
                            .map(|(x, a)| x * a)
                            .sum();
                        let mapped = entry.mean + along;
                        from_log_relative(mapped, entry.reference, entry.weight) as f32
                    })
                })
            })
            .collect();
        TabulatedBrdf::new(self.shape, values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::HalfDifference;

    const SHAPE: [usize; 3] = [12, 9, 4];

    fn material(albedo: [f32; 3], gloss: f32, width: f32) -> TabulatedBrdf {
        TabulatedBrdf::tabulate(SHAPE, |a: HalfDifference| {
            let peak = gloss * (-(a.theta_h_rad as f32 / width).powi(2)).exp();
            let rise = 1.0 + (a.theta_d_rad as f32).powi(3);
            albedo.map(|albedo| albedo / std::f32::consts::PI + peak * rise)
        })
    }

    fn training() -> Training {
        let of = |name: &str, table| (name.to_owned(), table);
        Training {
            shape: SHAPE,
            materials: vec![
                of("chalk", material([0.8, 0.7, 0.6], 0.01, 0.6)),
                of("paint", material([0.3, 0.1, 0.05], 0.8, 0.3)),
                of("gloss", material([0.05, 0.2, 0.4], 3.0, 0.15)),
            ],
        }
    }

    /// Every node of the grid above the horizon.
    fn everywhere() -> Vec<(Vec3, Vec3)> {
        let [n_h, n_d, n_phi] = SHAPE;
        (0..n_h * n_d * n_phi)
            .map(|at| node(SHAPE, [at / (n_d * n_phi), at / n_phi % n_d, at % n_phi]))
            .map(|angles| angles.to_directions())
            .map(|(i, o)| (i.as_vec3(), o.as_vec3()))
            .filter(|(i, o)| i.z > 0.05 && o.z > 0.05)
            .collect()
    }

    fn values(brdf: &dyn Brdf, directions: &[(Vec3, Vec3)]) -> Vec<[f64; 3]> {
        let of = |&(i, o): &(Vec3, Vec3)| brdf.eval(i, o).map(f64::from);
        directions.iter().map(of).collect()
    }

    /// Largest difference of values above 1e-2, relative.
    fn largest_difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        pairs
            .map(|(a, b)| (a - b).abs() / b.max(1e-2))
            .fold(0.0, f64::max)
    }

    /// By hand: f 0.5, reference 0.2, both cosines 0.6 and 0.8: ln(0.241 / 0.097).
    #[test]
    fn the_mapping_is_the_published_one() {
        let weight = cosine_weight(Vec3::new(0.8, 0.0, 0.6), Vec3::new(-0.6, 0.0, 0.8));
        assert!((weight - 0.48).abs() < 1e-7);
        let mapped = log_relative(0.5, 0.2, weight);
        assert!((mapped - 0.910_086).abs() < 1e-5, "{mapped}");
        assert_eq!(log_relative(0.2, 0.2, weight), 0.0);
        assert!((from_log_relative(mapped, 0.2, weight) - 0.5).abs() < 1e-12);
        // Below all cosines' ε the weight stays, and black is mapped to a finite value.
        assert_eq!(cosine_weight(Vec3::new(1.0, 0.0, 1e-6), Vec3::Z), EPSILON);
        assert!(log_relative(0.0, 0.2, weight).is_finite());
        // What no BRDF is mapped to is none.
        assert_eq!(from_log_relative(-9.0, 0.2, weight), 0.0);
        assert_eq!(median(&[4.0, 1.0, 3.0, 2.0]), 2.5);
    }

    #[test]
    fn a_material_in_the_span_is_found_back_as_the_ridge_goes() {
        let training = training();
        let components = training.without("");
        assert_eq!((components.columns(), components.right.nrows()), (9, 9));
        let truth = &training.materials[1].1;
        let all = everywhere();
        // From as many directions as there are components, spread over the grid, and not from
        // the whole grid that it is compared on.
        let few: Vec<_> = all.iter().step_by(all.len() / 24).copied().collect();
        let rows = components.rows(&few);
        let measured = values(truth, &few);
        let error = |ridge: f64| {
            let found = components.reconstruct(&rows, &measured, ridge).unwrap();
            largest_difference(&values(&found, &all), &values(truth, &all))
        };
        let [none, some, much] = [0.0, 0.1, 10.0].map(error);
        assert!(none < 1e-3, "{none}");
        assert!(none < some && some < much, "{none} {some} {much}");
    }

    #[test]
    fn one_value_fits_one_component() {
        let training = training();
        let components = training.without("");
        assert_eq!((components.fitted(1), components.fitted(400)), (1, 8));
        let one = [(Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.6, 0.0, 0.8))];
        let rows = components.rows(&one);
        let measured = [[0.4, 0.5, 0.6]];
        let found = components.reconstruct(&rows, &measured, 0.0).unwrap();
        let again = values(&found, &one);
        assert!(largest_difference(&again, &measured) < 0.05, "{again:?}");
    }

    /// What is left out changes nothing, whatever it is; what is kept does.
    #[test]
    fn the_left_out_material_is_not_learned_from() {
        let directions = &everywhere()[..20];
        let mut training = training();
        let scaled = |training: &Training| {
            let components = training.without("paint");
            assert_eq!(components.columns(), 6);
            components.rows(directions).scaled
        };
        let before = scaled(&training);
        training.materials[1].1 = material([0.9, 0.0, 0.9], 40.0, 0.1);
        assert_eq!(scaled(&training), before);
        training.materials[0].1 = material([0.9, 0.0, 0.9], 40.0, 0.1);
        assert_ne!(scaled(&training), before);
        // The embedded ones, by their names.
        let embedded = Training::embedded([4, 3, 2]);
        assert_eq!(embedded.without("pvc").columns(), 3 * (NAMES.len() - 1));
        assert_eq!(embedded.without("cream-satin").columns(), 3 * NAMES.len());
    }
}
