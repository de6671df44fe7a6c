//! What a fit cannot explain, and what would explain it.
//!
//! Every cause that is considered has images of its own: what the residual would look like to
//! first order if that were wrong. The residual of the material, as it departs from its mixture,
//! in standard deviations of noise and model error, is regressed on them after the part that
//! other weights could make has been taken out of both. What is left to say is how much of the
//! mean square residual each cause accounts for (docs/adr/0010).

use glam::{DVec2, DVec3};
use nalgebra::{Cholesky, DMatrix, DVector};

use super::bench::derivatives::{DerivativeImages, DerivativeOptions};
use super::objective::{ModelImage, Modelled, Objective};
use crate::brdf::departure::Departed;
use crate::brdf::half_difference::HalfDifference;
use crate::frames::{Rigid, Sample};
use crate::transport::{Proposal, Scene, Steering};

/// What can be wrong with a sample or a bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cause {
    /// Light that comes neither from the lamp nor by way of the sample: the same in every pixel.
    StrayLight,
    /// The sample is not where, or not of the shape that, the scene says.
    ShapeOrPose,
    /// The material differs between places.
    NonUniform,
    /// Light leaves beside where it entered, or the image is blurred.
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

/// Standard deviations beyond which a value counts as this much: a few pixels on the peak
/// of a narrow lobe, or dust, are not what the images look like.
const WILD: f64 = 4.0;

/// How well the images are explained.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// Mean square residual in variances of noise and model error, no value counted as more
    /// than four deviations.
    pub mean_square: f64,
    /// The part of `mean_square` that each cause accounts for, beyond what as many
    /// random images would; in the order of [`Cause::ALL`], can be slightly negative.
    pub explained: [f64; 5],
    /// Mean product of the residuals of neighbouring pixels over `mean_square`: 0 for
    /// noise, towards 1 for smooth structure.
    pub correlation: f64,
}

/// Below this mean square residual nothing is named: the noise and the model explain the
/// images. Sound captures of materials in the dictionary's span stay below 1.
const NOTABLE_MEAN_SQUARE: f64 = 1.1;

/// Part of the mean square residual from which a fault of bench or sample is named.
const NOTABLE_PART: f64 = 0.25;

/// Part from which the dictionary is named, which has the most images and explains a
/// little of anything.
const NOTABLE_DICTIONARY_PART: f64 = 0.5;

/// Mean square residual from which images count as unexplained where no cause is named.
const UNEXPLAINED_MEAN_SQUARE: f64 = 1.3;

/// How much more the dictionary must account for than any other cause to be the most
/// likely one: on a round sample almost everything depends on the angles.
const DICTIONARY_LEAD: f64 = 1.25;

impl Diagnosis {
    /// The most likely cause of a misfit, if there is one (docs/adr/0010 has the rates).
    pub fn finding(&self) -> Option<Cause> {
        if self.mean_square < NOTABLE_MEAN_SQUARE {
            return None;
        }
        let [.., dictionary] = self.explained;
        let (other, part) = Cause::ALL[..4]
            .iter()
            .zip(self.explained)
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        if dictionary > DICTIONARY_LEAD * part {
            (dictionary > NOTABLE_DICTIONARY_PART).then_some(Cause::Dictionary)
        } else {
            (part > NOTABLE_PART).then_some(*other)
        }
    }

    /// Whether the images are not explained, and look as no cause would that can be named.
    pub fn is_unexplained(&self) -> bool {
        self.mean_square >= UNEXPLAINED_MEAN_SQUARE && self.finding().is_none()
    }
}

/// Fields of position that a non-uniform material may follow, over [−1, 1]².
const FIELDS: usize = 9;
/// Powers of the angles that a missing lobe may follow.
const ANGLES: usize = 10;
/// Displacements of the sample whose images are compared.
const SHAPES: usize = 9;
/// Radii of blur, pixels.
const BLURS: [f64; 2] = [0.7, 1.5];

/// What is examined: a fit, and what explains its images.
pub(super) struct Examined<'a> {
    /// What was fitted.
    pub scene: &'a Scene,
    /// The comparison, with the light of the material.
    pub objective: &'a Objective<'a>,
    /// The weights of least loss per set, few of them above zero: what they could make is no
    /// sign of a fault. All atoms of the reported mixture could make almost anything.
    pub mixture: &'a [DVector<f64>],
    /// The material, which may depart from its mixture.
    pub material: &'a Departed,
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
    let [width, height] = scene.camera.resolution_px;
    let (lights, atoms, sets) = (objective.lights(), objective.atoms(), objective.sets());
    let Scatter {
        mean_square,
        correlation,
        count,
    } = scatter(objective, model, [width, height]);
    let displaced = displaced_images(fit);
    let angles = first_angles(scene);
    let active: Vec<Vec<usize>> = mixture
        .iter()
        .map(|w| (0..atoms).filter(|&k| w[k] > ACTIVE).collect())
        .collect();
    // Columns: active atoms, the templates of all causes, the residual.
    let sizes = [lights, SHAPES, FIELDS, BLURS.len(), ANGLES];
    let templates: usize = sizes.iter().sum();
    let columns: Vec<usize> = active.iter().map(|a| a.len() + templates + 1).collect();
    let none = || -> Vec<_> {
        (0..3)
            .map(|c| DMatrix::zeros(columns[c.min(sets - 1)], columns[c.min(sets - 1)]))
            .collect()
    };
    let parts = objective.evaluate(mixture, false, none, |grams, rows| {
        let pixel = rows.pixel;
        let at = DVec2::new(
            (2 * (pixel % width) + 1) as f64 / width as f64 - 1.0,
            (2 * (pixel / width) + 1) as f64 / height as f64 - 1.0,
        );
        let mut by_weight = [vec![0.0; atoms], vec![0.0; atoms]];
        for light in (0..lights).filter(|&l| objective.is_compared(l, pixel)) {
            for (c, gram) in grams.iter_mut().enumerate() {
                let Some((z, sigma)) = objective.deviation(model, light, pixel, c) else {
                    continue;
                };
                let set = c.min(sets - 1);
                let value = model[light][pixel][c].value();
                let [first, second] = &mut by_weight;
                objective.derivatives(rows, light, c, [first, second]);
                let mut row = Vec::with_capacity(columns[set]);
                row.extend(active[set].iter().map(|&k| 0.5 * (first[k] + second[k])));
                row.extend((0..lights).map(|l| f64::from(u8::from(l == light))));
                let pixels = width * height;
                row.extend(displaced.iter().map(|d| d[light * pixels + pixel][c]));
                row.extend(fields(at).map(|f| f * value));
                row.extend(BLURS.map(|radius| {
                    blurred(&model[light], c, pixel, [width, height], radius) - value
                }));
                row.extend(angles[light * pixels + pixel].map(|f| f * value));
                row.iter_mut().for_each(|v| *v /= sigma);
                row.push(z.clamp(-WILD, WILD));
                for j in 0..row.len() {
                    for i in j..row.len() {
                        gram[(i, j)] += row[i] * row[j];
                    }
                }
            }
        }
    });
    let mut explained = [0.0; 5];
    for c in 0..3 {
        let set = c.min(sets - 1);
        let mut gram = DMatrix::zeros(columns[set], columns[set]);
        parts.iter().for_each(|p| gram += &p[c]);
        gram.fill_upper_triangle_with_lower_triangle();
        let first = active[set].len();
        let mut from = first;
        for (explained, &size) in explained.iter_mut().zip(&sizes) {
            let template: Vec<usize> = (from..from + size).collect();
            *explained += accounted_for(&gram, first, &template, columns[set] - 1) - size as f64;
            from += size;
        }
    }
    Diagnosis {
        mean_square,
        explained: explained.map(|e| e / count),
        correlation,
    }
}

/// How residuals scatter.
struct Scatter {
    mean_square: f64,
    correlation: f64,
    /// Values compared.
    count: f64,
}

fn scatter(
    objective: &Objective<'_>,
    model: &[ModelImage],
    [width, height]: [usize; 2],
) -> Scatter {
    let (mut square, mut count) = (0.0, 0usize);
    let (mut neighbours, mut pairs) = (0.0, 0usize);
    for light in 0..objective.lights() {
        let z = |pixel, c| {
            let z = objective
                .deviation(model, light, pixel, c)
                .map_or(0.0, |d| d.0);
            z.clamp(-WILD, WILD)
        };
        for pixel in (0..width * height).filter(|&p| objective.is_compared(light, p)) {
            count += 3;
            square += (0..3).map(|c| z(pixel, c).powi(2)).sum::<f64>();
            let right = pixel + 1;
            if !right.is_multiple_of(width) && objective.is_compared(light, right) {
                neighbours += (0..3).map(|c| z(pixel, c) * z(right, c)).sum::<f64>();
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

/// Weight above which an atom counts as part of the fit.
const ACTIVE: f64 = 1e-6;

/// Squared length of the projection of column `z` on the template columns, both freed
/// of columns `0..known`; from the columns' inner products.
fn accounted_for(gram: &DMatrix<f64>, known: usize, template: &[usize], z: usize) -> f64 {
    let solve = |rows: &[usize], rhs: &DMatrix<f64>, matrix: &DMatrix<f64>| -> DMatrix<f64> {
        // Scaled to a unit diagonal, with a ridge: columns can be nearly equal.
        let n = rows.len();
        let scale: Vec<f64> = (0..n)
            .map(|i| 1.0 / matrix[(i, i)].max(f64::MIN_POSITIVE).sqrt())
            .collect();
        let scaled = DMatrix::from_fn(n, n, |i, j| {
            let ridge = if i == j { 1e-6 } else { 0.0 };
            matrix[(i, j)] * scale[i] * scale[j] + ridge
        });
        let mut x = DMatrix::from_fn(n, rhs.ncols(), |i, j| rhs[(i, j)] * scale[i]);
        match Cholesky::new(scaled) {
            Some(factor) => factor.solve_mut(&mut x),
            None => x.fill(0.0),
        }
        DMatrix::from_fn(n, rhs.ncols(), |i, j| x[(i, j)] * scale[i])
    };
    let atoms: Vec<usize> = (0..known).collect();
    let pick =
        |a: &[usize], b: &[usize]| DMatrix::from_fn(a.len(), b.len(), |i, j| gram[(a[i], b[j])]);
    let both: Vec<usize> = template.iter().copied().chain([z]).collect();
    let cross = pick(&atoms, &both);
    let freed =
        pick(&both, &both) - cross.transpose() * solve(&atoms, &cross, &pick(&atoms, &atoms));
    let k = template.len();
    // A template that other weights can make says nothing.
    let own: Vec<usize> = (0..k)
        .filter(|&i| freed[(i, i)] > 1e-4 * gram[(template[i], template[i])])
        .collect();
    let matrix = DMatrix::from_fn(own.len(), own.len(), |i, j| freed[(own[i], own[j])]);
    let rhs = DMatrix::from_fn(own.len(), 1, |i, _| freed[(own[i], k)]);
    let x = solve(&own, &rhs, &matrix);
    (rhs.transpose() * x)[(0, 0)]
}

/// Low-order fields over the image.
fn fields(at: DVec2) -> [f64; FIELDS] {
    let (x, y) = (at.x, at.y);
    [
        x,
        y,
        x * y,
        x * x - y * y,
        x * x + y * y,
        x * x * x,
        y * y * y,
        x * x * y,
        x * y * y,
    ]
}

/// Powers of the angles of the first reflection per light and pixel; zero in shadow.
fn first_angles(scene: &Scene) -> Vec<[f64; ANGLES]> {
    let [width, height] = scene.camera.resolution_px;
    let mut all = Vec::with_capacity(scene.lights.len() * width * height);
    for light in 0..scene.lights.len() {
        for pixel in 0..width * height {
            let centre = DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            let angles = scene
                .first(&scene.camera.ray(centre, DVec2::ZERO))
                .and_then(|(surface, viewer)| {
                    let lamp = scene.connect(&surface, light, [0.5; 2])?;
                    Some(HalfDifference::from_directions(
                        lamp.to_light.as_dvec3(),
                        viewer.as_dvec3(),
                    ))
                });
            all.push(angles.map_or([0.0; ANGLES], |a| {
                let [h, d] = [a.theta_h_rad, a.theta_d_rad];
                // Even in θh, and fine near the peak.
                let near = |width: f64| (-(h / width).powi(2)).exp();
                [
                    1.0,
                    near(0.1),
                    near(0.2),
                    near(0.4),
                    near(0.8),
                    d * d,
                    d * d * near(0.4),
                    d.powi(4),
                    h * h,
                    (h * d).powi(2),
                ]
            }));
        }
    }
    all
}

/// Change of the direct reflection, `[displacement][light · pixels + pixel][channel]`, when the
/// sample moves, turns or is scaled a little. What comes by way of other surfaces is left out:
/// few paths are noise that hides the rest (docs/adr/0010).
fn displaced_images(fit: &Examined<'_>) -> Vec<Vec<[f64; 3]>> {
    let (scene, objective) = (fit.scene, fit.objective);
    let mesh = scene.sample();
    let [low, high] = mesh.bounds_mm().map(|v| v.as_dvec3());
    let (centre, size) = (0.5 * (low + high), (high - low).max_element());
    let (lights, pixels) = (objective.lights(), scene.camera.pixels());
    let wanted: Vec<bool> = (0..pixels)
        .map(|pixel| (0..lights).any(|light| objective.is_compared(light, pixel)))
        .collect();
    let options = DerivativeOptions {
        samples_per_half: 0,
        max_reflections: 1,
        seed: fit.seed,
        proposal: Proposal::default(),
        steering: Steering::NONE,
        direct_strata: 2,
        average_px: 0,
    };
    let mut displaced = Vec::with_capacity(SHAPES);
    // One axis at a time, which bounds the memory.
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let shift = |step: f64| {
            let to = Rigid::<Sample, Sample>::from_rotation_vector(DVec3::ZERO, step * size * axis);
            mesh.transformed(&to)
        };
        let turn = |step: f64| {
            let about = Rigid::<Sample, Sample>::from_rotation_vector(step * axis, DVec3::ZERO);
            // Turned about the sample's middle.
            let back = centre - about.point(centre);
            let to = Rigid::<Sample, Sample>::from_rotation_vector(step * axis, back);
            mesh.transformed(&to)
        };
        let scale = |step: f64| {
            let mut scaled = mesh.clone();
            let factor = DVec3::ONE + step * axis;
            for p in &mut scaled.positions_mm {
                *p = (centre + (p.as_dvec3() - centre) * factor).as_vec3();
            }
            for n in scaled.normals.iter_mut().flatten() {
                *n = (n.as_dvec3() / factor).normalize().as_vec3();
            }
            scaled
        };
        let deformed = vec![
            [STEP, -STEP].map(shift),
            [STEP, -STEP].map(turn),
            [STEP, -STEP].map(scale),
        ];
        let shapes = deformed.len();
        let images = DerivativeImages::of_shapes(scene, deformed, fit.material, &wanted, &options);
        let mut changes = vec![vec![[0.0; 3]; lights * pixels]; shapes];
        for pixel in 0..pixels {
            for (shape, light, [change, _]) in images.at(pixel) {
                changes[shape][light * pixels + pixel] = change.map(f64::from);
            }
        }
        displaced.extend(changes);
    }
    displaced
}

/// Displacement over the sample's size; angle in radians; relative scale.
const STEP: f64 = 2e-3;

/// The model's pixel after a Gaussian blur.
fn blurred(
    model: &[[Modelled; 3]],
    channel: usize,
    pixel: usize,
    [width, height]: [usize; 2],
    radius_px: f64,
) -> f64 {
    let reach = (2.5 * radius_px).ceil() as usize;
    let (x, y) = (pixel % width, pixel / width);
    let (mut sum, mut total) = (0.0, 0.0);
    for j in y.saturating_sub(reach)..=(y + reach).min(height - 1) {
        for i in x.saturating_sub(reach)..=(x + reach).min(width - 1) {
            let d2 = (i.abs_diff(x).pow(2) + j.abs_diff(y).pow(2)) as f64;
            let weight = (-0.5 * d2 / (radius_px * radius_px)).exp();
            sum += weight * model[j * width + i][channel].value();
            total += weight;
        }
    }
    sum / total
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagnosis(mean_square: f64, explained: [f64; 5]) -> Diagnosis {
        Diagnosis {
            mean_square,
            explained,
            correlation: 0.0,
        }
    }

    /// The dictionary explains a little of anything, so it must lead; what nothing explains is
    /// said to be so, and what noise explains is nothing.
    #[test]
    fn the_leading_cause_is_named() {
        let pose = diagnosis(1.5, [0.0, 0.4, 0.1, 0.0, 0.45]);
        assert_eq!(pose.finding(), Some(Cause::ShapeOrPose));
        let lobe = diagnosis(1.5, [0.0, 0.4, 0.1, 0.0, 0.55]);
        assert_eq!(lobe.finding(), Some(Cause::Dictionary));
        assert!(!pose.is_unexplained() && !lobe.is_unexplained());
        let unclear = diagnosis(1.5, [0.1, 0.2, 0.1, 0.0, 0.4]);
        assert!(unclear.finding().is_none() && unclear.is_unexplained());
        let noise = diagnosis(1.0, [0.6, 0.0, 0.0, 0.0, 0.0]);
        assert!(noise.finding().is_none() && !noise.is_unexplained());
    }
}
