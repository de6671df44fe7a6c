//! What a fit cannot explain, and what would explain it.
//!
//! Every cause that is considered has images of its own: what the residual would look
//! like to first order if that were wrong. The residual, in standard deviations of
//! noise and model error, is regressed on them after the part that other weights could
//! make has been taken out of both. What is left to say is how much of the mean square
//! residual each cause accounts for (docs/adr/0010).

use glam::{DVec2, DVec3};
use nalgebra::{Cholesky, DMatrix, DVector};

use super::objective::{Linearised, Modelled, Objective};
use crate::brdf::Dictionary;
use crate::brdf::half_difference::HalfDifference;
use crate::frames::{Rigid, Sample};
use crate::transport::{Cache, DirectMatrix, Scene};

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
}

/// Fields of position that a non-uniform material may follow, over [−1, 1]².
const FIELDS: usize = 9;
/// Powers of the angles that a missing lobe may follow.
const ANGLES: usize = 10;
/// Displacements of the sample whose images are compared.
const SHAPES: usize = 9;
/// Radii of blur, pixels.
const BLURS: [f64; 2] = [0.7, 1.5];

/// Examines the residual of a fit.
pub fn examine(
    scene: &Scene,
    dictionary: &Dictionary,
    objective: &Objective<'_>,
    cache: &Cache,
    mixture: &[DVector<f64>],
    pass: &Linearised,
) -> Diagnosis {
    let [width, height] = scene.camera.resolution_px;
    let lights = objective.lights();
    let atoms = dictionary.len();
    let displaced = displaced_images(scene, dictionary, mixture);
    let angles = first_angles(scene);
    let slices: Vec<&[f64]> = mixture.iter().map(|w| w.as_slice()).collect();
    let active: Vec<Vec<usize>> = mixture
        .iter()
        .map(|w| (0..atoms).filter(|&k| w[k] > ACTIVE).collect())
        .collect();
    let sets = mixture.len();
    // Columns: active atoms, the templates of all causes, the residual.
    let sizes = [lights, SHAPES, FIELDS, BLURS.len(), ANGLES];
    let templates: usize = sizes.iter().sum();
    let columns: Vec<usize> = active.iter().map(|a| a.len() + templates + 1).collect();
    let model = &pass.model;
    let parts = cache.evaluate(
        objective.kernel(),
        &slices,
        || {
            (0..3)
                .map(|c| DMatrix::zeros(columns[c.min(sets - 1)], columns[c.min(sets - 1)]))
                .collect::<Vec<_>>()
        },
        |grams, rows| {
            let pixel = rows.pixel;
            let at = DVec2::new(
                (2 * (pixel % width) + 1) as f64 / width as f64 - 1.0,
                (2 * (pixel / width) + 1) as f64 / height as f64 - 1.0,
            );
            for light in (0..lights).filter(|&l| objective.is_compared(l, pixel)) {
                for (c, gram) in grams.iter_mut().enumerate() {
                    let Some((z, sigma)) = objective.deviation(model, light, pixel, c) else {
                        continue;
                    };
                    let set = c.min(sets - 1);
                    let value = model[light][pixel][c].value();
                    let r = light * sets + set;
                    let direct = objective.direct().row(pixel, light);
                    let mut row = Vec::with_capacity(columns[set]);
                    for &k in &active[set] {
                        let indirect =
                            rows.jacobian[0][r * atoms + k] + rows.jacobian[1][r * atoms + k];
                        row.push(f64::from(direct[k]) + 0.5 * f64::from(indirect));
                    }
                    row.extend((0..lights).map(|l| f64::from(u8::from(l == light))));
                    row.extend(
                        (0..SHAPES).map(|s| displaced[s][(light * 3 + c) * width * height + pixel]),
                    );
                    row.extend(fields(at).map(|f| f * value));
                    row.extend(BLURS.map(|radius| {
                        blurred(&model[light], c, pixel, [width, height], radius) - value
                    }));
                    row.extend(angles[light * width * height + pixel].map(|f| f * value));
                    row.iter_mut().for_each(|v| *v /= sigma);
                    row.push(z.clamp(-WILD, WILD));
                    for j in 0..row.len() {
                        for i in j..row.len() {
                            gram[(i, j)] += row[i] * row[j];
                        }
                    }
                }
            }
        },
    );
    let mut explained = [0.0; 5];
    let (mut square, mut count) = (0.0, 0usize);
    for c in 0..3 {
        let set = c.min(sets - 1);
        let mut gram = DMatrix::zeros(columns[set], columns[set]);
        parts.iter().for_each(|p| gram += &p[c]);
        gram.fill_upper_triangle_with_lower_triangle();
        let last = columns[set] - 1;
        square += gram[(last, last)];
        let first = active[set].len();
        let mut from = first;
        for (h, &size) in sizes.iter().enumerate() {
            let template: Vec<usize> = (from..from + size).collect();
            explained[h] += accounted_for(&gram, first, &template, last) - size as f64;
            from += size;
        }
    }
    let (mut neighbours, mut pairs) = (0.0, 0usize);
    for light in 0..lights {
        for pixel in 0..width * height {
            if !objective.is_compared(light, pixel) {
                continue;
            }
            count += 3;
            let right = pixel + 1;
            if right % width == 0 || !objective.is_compared(light, right) {
                continue;
            }
            for c in 0..3 {
                let z = |p| {
                    let z = objective.deviation(model, light, p, c).map_or(0.0, |d| d.0);
                    z.clamp(-WILD, WILD)
                };
                neighbours += z(pixel) * z(right);
                pairs += 1;
            }
        }
    }
    let count = count.max(1) as f64;
    let mean_square = square / count;
    Diagnosis {
        mean_square,
        explained: explained.map(|e| e / count),
        correlation: neighbours / pairs.max(1) as f64 / mean_square.max(f64::MIN_POSITIVE),
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

/// Change of the direct reflection, `[displacement][(light · 3 + channel) · pixels + pixel]`,
/// when the sample moves, turns or is scaled a little.
fn displaced_images(
    scene: &Scene,
    dictionary: &Dictionary,
    mixture: &[DVector<f64>],
) -> Vec<Vec<f64>> {
    let mesh = scene.sample();
    let [low, high] = mesh.bounds_mm().map(|v| v.as_dvec3());
    let (centre, size) = (0.5 * (low + high), (high - low).max_element());
    let image = |scene: &Scene| -> Vec<f64> {
        let direct = DirectMatrix::new(scene, dictionary, 2, 1);
        let mut values = Vec::new();
        for light in 0..scene.lights.len() {
            for c in 0..3 {
                let weights = &mixture[c.min(mixture.len() - 1)];
                values.extend((0..scene.camera.pixels()).map(|p| -> f64 {
                    let row = direct.row(p, light);
                    row.iter()
                        .zip(weights)
                        .map(|(&d, &w)| f64::from(d) * w)
                        .sum()
                }));
            }
        }
        values
    };
    let still = image(scene);
    let displaced_by = |mesh| image(&scene.deformed(mesh));
    let mut displaced: Vec<Vec<f64>> = Vec::with_capacity(SHAPES);
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let shift = Rigid::<Sample, Sample>::from_rotation_vector(DVec3::ZERO, STEP * size * axis);
        let about = Rigid::<Sample, Sample>::from_rotation_vector(STEP * axis, DVec3::ZERO);
        // Turned about the sample's middle.
        let back = centre - about.point(centre);
        let turn = Rigid::<Sample, Sample>::from_rotation_vector(STEP * axis, back);
        let mut scaled = mesh.clone();
        let factor = DVec3::ONE + STEP * axis;
        for p in &mut scaled.positions_mm {
            *p = (centre + (p.as_dvec3() - centre) * factor).as_vec3();
        }
        for n in scaled.normals.iter_mut().flatten() {
            *n = (n.as_dvec3() / factor).normalize().as_vec3();
        }
        displaced.push(displaced_by(mesh.transformed(&shift)));
        displaced.push(displaced_by(mesh.transformed(&turn)));
        displaced.push(displaced_by(scaled));
    }
    for image in &mut displaced {
        image.iter_mut().zip(&still).for_each(|(v, s)| *v -= s);
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
