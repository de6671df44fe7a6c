//! What a fit cannot explain, and what would explain it.
//!
//! Every cause that is considered has images of its own: what the residual would look like to
//! first order if that were wrong. The residual of the material, with its discrepancy,
//! in standard deviations of noise and model error, is regressed on them after the part that
//! other weights could make has been taken out of both. What is left to say is how much of the
//! mean square residual each cause accounts for (docs/adr/0010).

use glam::DVec2;
use nalgebra::{Cholesky, DMatrix, DVector};

use super::normal_equations::{IN_USE, Marginal};
use super::objective::{ModelImage, Objective};
use crate::brdf::Brdf;
use crate::brdf::discrepancy::Material;
use crate::outer_products::Squares;
use crate::transport::Scene;

mod templates;

use templates::{
    ANGLES, BLURS, FIELDS, SHAPES, blur_unit, blurred, displaced_images, fields, first_angles,
};

/// What can be wrong with a sample or a bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cause {
    /// Light that comes neither from the lamp nor by way of the sample: the same in every cell.
    StrayLight,
    /// The sample is not where, or not of the shape that, the scene says.
    ShapeOrPose,
    /// The material differs between places.
    NonUniform,
    /// Light leaves at some distance from where it entered, or the image is blurred.
    Translucency,
    /// The material reflects as no mixture of the dictionary does.
    Dictionary,
}

impl Cause {
    /// All of them.
    pub const ALL: [Cause; 5] = [
        Cause::StrayLight,
        Cause::ShapeOrPose,
        Cause::NonUniform,
        Cause::Translucency,
        Cause::Dictionary,
    ];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Cause::StrayLight => "stray light",
            Cause::ShapeOrPose => "shape or pose",
            Cause::NonUniform => "non-uniform material",
            Cause::Translucency => "translucency or blur",
            Cause::Dictionary => "dictionary",
        }
    }
}

/// Standard deviations beyond which a value counts as this much: a few cells on the peak
/// of a narrow lobe, or dust, are not what the images look like.
const MAX_DEVIATION: f64 = 4.0;

/// How well the images are explained.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// Mean square residual in variances of noise and model error, no value counted as more
    /// than four deviations.
    pub mean_square: f64,
    /// The part of `mean_square` that each cause accounts for, beyond what as many
    /// random images would; in the order of [`Cause::ALL`], can be slightly negative. All 0 where
    /// noise and model error explain the images and nothing is asked.
    pub explained: [f64; 5],
    /// Mean product of the residuals of neighbouring cells over `mean_square`: 0 for
    /// noise, towards 1 for smooth structure.
    pub correlation: f64,
    /// Whether the material has a discrepancy from every mixture, a sign of the dictionary: no
    /// fault of the bench was found to cause one.
    pub has_discrepancy: bool,
}

/// Below this mean square residual nothing is named: the noise and the model explain the
/// images. Sound captures of materials in the dictionary's span stay below 1.
const NOTABLE_MEAN_SQUARE: f64 = 1.1;

/// Part of the mean square residual from which a fault of bench or sample is named.
const NOTABLE_PART: f64 = 0.25;

/// Part from which the dictionary is named without a discrepancy: it has the most images and
/// explains a little of anything.
const NOTABLE_DICTIONARY_PART: f64 = 0.5;

/// Mean square residual from which images count as unexplained where no cause is named.
const UNEXPLAINED_MEAN_SQUARE: f64 = 1.3;

/// How much more the dictionary must account for there than any other cause to be the most
/// likely one: on a round sample almost everything depends on the angles.
const DICTIONARY_LEAD: f64 = 1.25;

impl Diagnosis {
    /// The most likely cause of an excess error, if there is one (docs/adr/0010 has the rates).
    pub fn finding(&self) -> Option<Cause> {
        if self.mean_square < NOTABLE_MEAN_SQUARE {
            return None;
        }
        let [.., dictionary] = self.explained;
        let (other, part) = Cause::ALL[..4]
            .iter()
            .zip(self.explained)
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        let [lead, notable] = if self.has_discrepancy {
            [1.0, NOTABLE_PART]
        } else {
            [DICTIONARY_LEAD, NOTABLE_DICTIONARY_PART]
        };
        if dictionary > lead * part {
            (dictionary > notable).then_some(Cause::Dictionary)
        } else {
            (part > NOTABLE_PART).then_some(*other)
        }
    }

    /// Whether the images are not explained, and look as no cause would that can be named.
    pub fn is_unexplained(&self) -> bool {
        self.mean_square >= UNEXPLAINED_MEAN_SQUARE && self.finding().is_none()
    }
}

/// What is examined: a fit, and what explains its images.
pub(super) struct Examined<'a> {
    /// What was fitted.
    pub scene: &'a Scene,
    /// The comparison, with the light of the material.
    pub objective: &'a Objective<'a>,
    /// The weights of least loss per channel group, few of them above zero: what they could make is no
    /// sign of a fault. All atoms of the reported mixture could make almost anything.
    pub mixture: &'a [DVector<f64>],
    /// The material, a mixture with or without a discrepancy.
    pub material: &'a Material,
    /// Its images.
    pub model: &'a [ModelImage],
    /// That of the fit's paths.
    pub seed: u64,
}

/// Examines the residual of a fit.
pub(super) fn examine(fit: &Examined<'_>) -> Diagnosis {
    let &Examined {
        scene,
        objective,
        mixture,
        model,
        ..
    } = fit;
    let cells = objective.cells();
    let (lights, atoms) = (objective.lights(), objective.atoms());
    let group = |channel| objective.channels().group(channel);
    let Scatter {
        mean_square,
        correlation,
        count,
    } = scatter(objective, model);
    let has_discrepancy = fit.material.as_mixture().is_none();
    if mean_square < NOTABLE_MEAN_SQUARE {
        return Diagnosis {
            mean_square,
            explained: [0.0; 5],
            correlation,
            has_discrepancy,
        };
    }
    let resolution_px = DVec2::from_array(cells.resolution_px().map(|n| n as f64));
    let displaced = displaced_images(fit);
    let blur_unit = blur_unit(cells);
    let angles = first_angles(scene, cells);
    let active: Vec<Vec<usize>> = mixture
        .iter()
        .map(|w| (0..atoms).filter(|&k| w[k] > IN_USE).collect())
        .collect();
    // Columns: active atoms, the templates of all causes, the residual.
    let sizes = [lights, SHAPES, FIELDS, BLURS.len(), ANGLES];
    let templates: usize = sizes.iter().sum();
    let columns: Vec<usize> = active.iter().map(|a| a.len() + templates + 1).collect();
    let none = || -> Vec<_> {
        let columns = (0..3).map(|c| columns[group(c)]);
        columns.map(Squares::zero).collect()
    };
    let grams: Vec<Squares> = objective.accumulate(
        mixture,
        &objective.inverse_variances(model),
        None,
        none,
        |grams, value| {
            let (cell, light, c) = (value.cell, value.light, value.channel);
            let middle_px = cells.cell(cell).middle_px();
            let at = 2.0 * middle_px / resolution_px - DVec2::ONE;
            let modelled = model[light][cell][c].value();
            let [first, second] = value.by_weights;
            let mut row = Vec::with_capacity(columns[value.group]);
            let active = active[value.group].iter();
            row.extend(active.map(|&k| 0.5 * (first[k] + second[k])));
            row.extend((0..lights).map(|l| f64::from(u8::from(l == light))));
            row.extend(displaced.iter().map(|d| d[light * cells.len() + cell][c]));
            row.extend(fields(at).map(|f| f * modelled));
            row.extend(BLURS.map(|radius| {
                blurred(cells, cell, radius * blur_unit, |k| {
                    model[light][k][c].value()
                }) - modelled
            }));
            row.extend(angles[light * cells.len() + cell].map(|f| f * modelled));
            let Some((z, sigma)) = objective.deviation(model, light, cell, c) else {
                return;
            };
            row.iter_mut().for_each(|v| *v /= sigma);
            row.push(z.clamp(-MAX_DEVIATION, MAX_DEVIATION));
            grams[c].add(1.0, &row);
        },
        |total, part| {
            let both = total.iter_mut().zip(part);
            both.for_each(|(sum, part)| sum.join(part));
        },
    );
    let mut explained = [0.0; 5];
    for (c, gram) in grams.into_iter().map(Squares::matrix).enumerate() {
        let group = group(c);
        let first = active[group].len();
        let mut from = first;
        for (explained, &size) in explained.iter_mut().zip(&sizes) {
            let template: Vec<usize> = (from..from + size).collect();
            *explained += accounted_for(&gram, first, &template, columns[group] - 1) - size as f64;
            from += size;
        }
    }
    Diagnosis {
        mean_square,
        explained: explained.map(|e| e / count),
        correlation,
        has_discrepancy,
    }
}

/// How residuals scatter.
struct Scatter {
    mean_square: f64,
    correlation: f64,
    /// Values compared.
    count: f64,
}

fn scatter(objective: &Objective<'_>, model: &[ModelImage]) -> Scatter {
    let cells = objective.cells();
    let (mut square, mut count) = (0.0, 0usize);
    let (mut neighbours, mut pairs) = (0.0, 0usize);
    for light in 0..objective.lights() {
        let z = |cell, c| {
            let z = objective
                .deviation(model, light, cell, c)
                .map_or(0.0, |d| d.0);
            z.clamp(-MAX_DEVIATION, MAX_DEVIATION)
        };
        for cell in (0..cells.len()).filter(|&p| objective.is_compared(light, p)) {
            count += 3;
            square += (0..3).map(|c| z(cell, c).powi(2)).sum::<f64>();
            let later = cells.around(cell).filter(|&other| other > cell);
            for other in later.filter(|&other| objective.is_compared(light, other)) {
                neighbours += (0..3).map(|c| z(cell, c) * z(other, c)).sum::<f64>();
                pairs += 3;
            }
        }
    }
    let count = count.max(1) as f64;
    let mean_square = square / count;
    Scatter {
        mean_square,
        correlation: neighbours / pairs.max(1) as f64 / mean_square.max(f64::MIN_POSITIVE),
        count,
    }
}

/// Squared length of the projection of column `z` on the template columns, both freed
/// of columns `0..known`; from the columns' inner products.
fn accounted_for(gram: &DMatrix<f64>, known: usize, template: &[usize], z: usize) -> f64 {
    let atoms: Vec<usize> = (0..known).collect();
    let pick =
        |a: &[usize], b: &[usize]| DMatrix::from_fn(a.len(), b.len(), |i, j| gram[(a[i], b[j])]);
    let both: Vec<usize> = template.iter().copied().chain([z]).collect();
    let inverse = regularised_inverse(&pick(&atoms, &atoms));
    let freed = Marginal::new(&pick(&both, &both), &pick(&both, &atoms), &inverse).information;
    let k = template.len();
    // A template that other weights can make is no evidence.
    let own: Vec<usize> = (0..k)
        .filter(|&i| freed[(i, i)] > 1e-4 * gram[(template[i], template[i])])
        .collect();
    let matrix = DMatrix::from_fn(own.len(), own.len(), |i, j| freed[(own[i], own[j])]);
    let rhs = DVector::from_fn(own.len(), |i, _| freed[(own[i], k)]);
    rhs.dot(&(regularised_inverse(&matrix) * &rhs))
}

/// Inverse of inner products, scaled to a unit diagonal with a ridge: columns can be nearly
/// equal. Zero for a column that is zero, as that of black is.
fn regularised_inverse(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    let scale = matrix
        .diagonal()
        .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let scaled = DMatrix::from_fn(n, n, |i, j| {
        let ridge = if i == j { 1e-6 } else { 0.0 };
        matrix[(i, j)] * scale[i] * scale[j] + ridge
    });
    let inverse = Cholesky::new(scaled).map_or_else(|| DMatrix::zeros(n, n), |c| c.inverse());
    DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagnosis(mean_square: f64, explained: [f64; 5]) -> Diagnosis {
        Diagnosis {
            mean_square,
            explained,
            correlation: 0.0,
            has_discrepancy: false,
        }
    }

    /// Columns: an atom, black, a template, the residual 2 · atom + 3 · template. Freed of the
    /// atom the template accounts for 9 times its own part orthogonal to it.
    #[test]
    fn a_template_accounts_for_its_part_in_the_residual() {
        let rows = DMatrix::from_row_slice(
            3,
            4,
            &[
                1.0, 0.0, 1.0, 5.0, //
                0.0, 0.0, 2.0, 6.0, //
                0.0, 0.0, 1.0, 3.0,
            ],
        );
        let gram = rows.tr_mul(&rows);
        let explained = accounted_for(&gram, 2, &[2], 3);
        assert!((explained / 45.0 - 1.0).abs() < 1e-4, "{explained}");
    }

    /// The dictionary explains a little of anything, so it must lead unless there is a discrepancy;
    /// what nothing explains is said to be so, and what noise explains is nothing.
    #[test]
    fn the_leading_cause_is_named() {
        let pose = diagnosis(1.5, [0.0, 0.4, 0.1, 0.0, 0.45]);
        assert_eq!(pose.finding(), Some(Cause::ShapeOrPose));
        let lobe = diagnosis(1.5, [0.0, 0.4, 0.1, 0.0, 0.55]);
        assert_eq!(lobe.finding(), Some(Cause::Dictionary));
        assert!(!pose.is_unexplained() && !lobe.is_unexplained());
        let unclear = diagnosis(1.5, [0.1, 0.2, 0.1, 0.0, 0.4]);
        assert!(unclear.finding().is_none() && unclear.is_unexplained());
        let with_discrepancy = Diagnosis {
            has_discrepancy: true,
            ..pose
        };
        assert_eq!(with_discrepancy.finding(), Some(Cause::Dictionary));
        let noise = diagnosis(1.0, [0.6, 0.0, 0.0, 0.0, 0.0]);
        assert!(noise.finding().is_none() && !noise.is_unexplained());
    }
}
