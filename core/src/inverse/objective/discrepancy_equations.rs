//! The comparison with a material that has a model discrepancy (docs/adr/0032).

use nalgebra::{DMatrix, DVector};

use super::Objective;
use crate::brdf::discrepancy::{Material, Prior};
use crate::transport::direct_discrepancy::DirectDiscrepancy;
use crate::transport::evaluate::Discrepancies;
use crate::transport::{CellRows, Scene};

/// The discrepancy as it changes the images of a mixture.
pub struct DiscrepancyModel {
    /// Factors of f at the places of the table, per channel group.
    factors: Vec<Vec<f32>>,
    /// Light that is reflected once.
    pub direct: DirectDiscrepancy,
}

impl DiscrepancyModel {
    /// Of `material`, for the cells that `objective` compares.
    pub fn of_compared(
        objective: &Objective<'_>,
        scene: &Scene,
        material: &Material,
        prior: &Prior,
        seed: u64,
    ) -> Self {
        let wanted = objective.compared_pixels();
        Self::new(objective, scene, material, prior, &wanted, seed)
    }

    /// Of `material`, for all cells.
    pub fn of_all(
        objective: &Objective<'_>,
        scene: &Scene,
        material: &Material,
        prior: &Prior,
        seed: u64,
    ) -> Self {
        let wanted = vec![true; objective.cells.len()];
        Self::new(objective, scene, material, prior, &wanted, seed)
    }

    fn new(
        objective: &Objective<'_>,
        scene: &Scene,
        material: &Material,
        prior: &Prior,
        wanted: &[bool],
        seed: u64,
    ) -> Self {
        let of_set = |group: usize| material.discrepancies[group].factors();
        Self {
            factors: (0..objective.groups()).map(of_set).collect(),
            direct: DirectDiscrepancy::new(scene, objective.cells, material, prior, wanted, seed),
        }
    }
}

impl<'a> Objective<'a> {
    /// The same comparison with the discrepancy applied.
    pub fn with_discrepancy(&self, model: &'a DiscrepancyModel) -> Self {
        Self {
            values: self.values.clone(),
            discrepancy: Some(model),
            ..*self
        }
    }

    /// What a discrepancy makes of the mixture's light that is reflected once.
    pub(in crate::inverse) fn direct_factor(
        &self,
        cell: usize,
        light: usize,
        channel: usize,
    ) -> f64 {
        self.discrepancy
            .map_or(1.0, |d| f64::from(d.direct.factor(cell, light, channel)))
    }

    /// One pass over the paths with the light of `mixture` and its discrepancy, if any, with the
    /// derivatives along these modes of a discrepancy if wanted.
    pub(in crate::inverse) fn evaluate<T: Send>(
        &self,
        mixture: &[DVector<f64>],
        modes: Option<&DMatrix<f64>>,
        group: impl Fn() -> T + Sync,
        visit: impl Fn(&mut T, &CellRows<'_>) + Sync,
    ) -> Vec<T> {
        let slices: Vec<&[f64]> = mixture.iter().map(|w| w.as_slice()).collect();
        let discrepancies = Discrepancies {
            factors: self.discrepancy.map_or(&[][..], |d| &d.factors),
            modes,
        };
        self.cache
            .evaluate_with_discrepancy(self.kernel, &slices, &discrepancies, group, visit)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::discrepancy::{Discrepancy, NODES, nodes};
    use crate::brdf::{Atom, Dictionary, Mixture};
    use crate::cells::Captured;
    use crate::inverse::form::tests::bowl;
    use crate::inverse::objective::ModelImage;
    use crate::inverse::options::FitOptions;
    use crate::inverse::solve::Paths;
    use crate::transport::{Proposal, RenderOptions, render};

    /// Images and their derivatives by g₀ and by g₁, around a material with a discrepancy, against
    /// what the same paths make of discrepancies a little to either side, and against what the
    /// renderer does, which shares nothing with the cache but the table.
    #[test]
    fn images_of_discrepancy_materials_are_as_rendered() {
        let scene = bowl(8);
        let atoms = vec![
            Atom::Lambertian { albedo: 1.0 },
            Atom::Ggx {
                alpha: 0.3,
                eta: 3.0,
            },
        ];
        let dictionary = Arc::new(Dictionary::new("two", atoms).unwrap());
        let mixture = Mixture::grey(dictionary.clone(), vec![0.5, 0.5]).unwrap();
        // Strong, so that their images stand above the noise: of g₀ alone, of g₁ alone.
        let mut modes = DMatrix::zeros(2 * NODES, 2);
        for (k, node) in nodes().enumerate() {
            let [h, d] = [node.theta_h_deg, node.theta_d_deg].map(f64::to_radians);
            modes[(k, 0)] = (2.0 * h).cos() - 0.5 * d;
            modes[(NODES + k, 1)] = 2.0 * (h.sin() * d.sin()).powi(2);
        }
        let prior = Prior::of_modes(modes);
        let modes = prior.modes();
        let discrepancy = |along: [f64; 2]| {
            let [a, b] = [0, 1].map(|k| modes.column(k) * along[k]);
            Discrepancy(a + b)
        };
        let rendered = |along: [f64; 2]| {
            let g = discrepancy(along);
            let discrepancy = Material::new(mixture.clone(), &[g]);
            let options = RenderOptions {
                samples_per_pixel: 8192,
                max_reflections: 4,
                seed: 5,
                proposal: Proposal::resembling(&mixture, 0.3),
                ..RenderOptions::default()
            };
            render(&scene, &discrepancy, &options)
        };
        let (at, step) = ([0.5, -0.5], 0.05);
        let captured = rendered(at);

        let mut options = FitOptions::default();
        options.cache.samples_per_cell = 4096;
        options.cache.max_reflections = 4;
        let compared = Captured::of_pixels(&captured, |_| true);
        let paths =
            Paths::trace(&scene, &compared.cells, &dictionary, None, &options, &()).unwrap();
        let objective = paths.objective(&compared, &options);
        let model_at = |along: [f64; 2]| {
            let material = Material::new(mixture.clone(), &[discrepancy(along)]);
            DiscrepancyModel::of_compared(&objective, &scene, &material, &prior, 3)
        };
        let model = model_at(at);
        let plain = &objective;
        let objective = objective.with_discrepancy(&model);
        let weights = vec![DVector::from_vec(vec![0.5, 0.5]); 3];

        // Relative deviations over the compared cells, root mean square.
        let compare = |predicted: &dyn Fn(usize, usize) -> f64,
                       seen: &dyn Fn(usize, usize) -> f64| {
            let (mut square, mut error) = (0.0, 0.0);
            for (light, cell) in (0..2).flat_map(|l| (0..64).map(move |p| (l, p))) {
                if objective.is_compared(light, cell) {
                    let seen = seen(light, cell);
                    square += seen * seen;
                    error += (predicted(light, cell) - seen).powi(2);
                }
            }
            (error / square).sqrt()
        };
        let modelled: Vec<ModelImage> = objective.modelled(&weights);
        let image = |l: usize, p: usize| f64::from(captured[l].mean[p][1]);
        let error = compare(&|l, p| modelled[l][p][1].value(), &image);
        println!("images: {error:.4}");
        assert!(error < 0.01, "images: {error}");

        let mut by_modes = vec![vec![DVector::zeros(modes.ncols()); 64]; 2];
        let none = Vec::new;
        let parts = objective.evaluate(&weights, Some(modes), none, |rows: &mut Vec<_>, cell| {
            for light in 0..2 {
                let row = (light * 3 + 1) * modes.ncols();
                let along = DVector::from_fn(modes.ncols(), |k, _| {
                    let of_half = |half: usize| f64::from(cell.by_modes[half][row + k]);
                    0.5 * (of_half(0) + of_half(1))
                });
                rows.push((light, cell.cell, along));
            }
        });
        for (light, cell, by_paths) in parts.into_iter().flatten() {
            let direct = model.direct.by_modes(cell, light, 1).iter();
            let direct = DVector::from_iterator(modes.ncols(), direct.map(|&v| f64::from(v)));
            let direct_light = objective.direct_light(cell, light, 1, &weights[1]);
            by_modes[light][cell] = by_paths + direct_light * direct;
        }
        for mode in 0..2 {
            let sides = [step, -step].map(|step| {
                let mut to = at;
                to[mode] += step;
                to
            });
            let [more, less] = sides.map(|to| {
                let model = model_at(to);
                plain.with_discrepancy(&model).modelled(&weights)
            });
            let of_paths =
                |l: usize, p: usize| (more[l][p][1].value() - less[l][p][1].value()) / (2.0 * step);
            let error = compare(&|l, p| by_modes[l][p][mode], &of_paths);
            println!("mode {mode}, the same paths: {error:.4}");
            assert!(error < 0.003, "mode {mode}, the same paths: {error}");

            let [more, less] = sides.map(&rendered);
            let seen = |l: usize, p: usize| {
                f64::from(more[l].mean[p][1] - less[l].mean[p][1]) / (2.0 * step)
            };
            // Two renders' noise, which is a part of the images and not of how they change: as for
            // the images themselves.
            let of_change = compare(&|l, p| by_modes[l][p][mode], &seen);
            let change = compare(&|l, p| image(l, p) + seen(l, p), &image);
            let error = of_change * change;
            println!("mode {mode}: {error:.4} of the image, {of_change:.4} of its change");
            assert!(change > 0.02, "mode {mode} changes images by {change}");
            assert!(error < 0.01, "mode {mode}: {error}");
        }
    }
}
