//! What the images would look like, to first order, if something were wrong.

use std::f64::consts::SQRT_2;

use glam::{DVec2, DVec3};

use super::Examined;
use crate::brdf::half_difference::HalfDifference;
use crate::frames::{Rigid, Sample};
use crate::inverse::nuisance::derivatives::{DerivativeImages, DerivativeOptions};
use crate::transport::cell_footprints::FIELD_PARTS;
use crate::transport::{Cells, Proposal, Scene, Steering};

/// Fields of position that a non-uniform material may follow, over [−1, 1]².
pub(super) const FIELDS: usize = 9;
/// Powers of the angles that a missing lobe may follow.
pub(super) const ANGLES: usize = 10;
/// Displacements of the sample whose images are compared.
pub(super) const SHAPES: usize = 9;
/// Radii of blur, in units of [`blur_unit`].
pub(super) const BLURS: [f64; 2] = [0.7, 1.5];

/// Low-order fields over the image.
pub(super) fn fields(at: DVec2) -> [f64; FIELDS] {
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

/// Powers of the angles of the first reflection per light and cell; zero in shadow.
pub(super) fn first_angles(scene: &Scene, cells: &Cells) -> Vec<[f64; ANGLES]> {
    let mut all = Vec::with_capacity(scene.lights.len() * cells.len());
    for light in 0..scene.lights.len() {
        for cell in cells.iter() {
            let centre = cell.middle_px();
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

/// Change of the direct reflection, `[displacement][light · cells + cell][channel]`, when the
/// sample moves, turns or is scaled a little. What comes by way of other surfaces is left out:
/// few paths are noise that hides the rest (docs/adr/0010).
pub(super) fn displaced_images(fit: &Examined<'_>) -> Vec<Vec<[f64; 3]>> {
    let (scene, objective) = (fit.scene, fit.objective);
    let mesh = scene.sample();
    let [low, high] = mesh.bounds_mm().map(|v| v.as_dvec3());
    let (centre, size) = (0.5 * (low + high), (high - low).max_element());
    let (lights, cells) = (objective.lights(), objective.cells().len());
    let wanted = objective.compared_pixels();
    let options = DerivativeOptions {
        samples_per_half: 0,
        max_reflections: 1,
        seed: fit.seed,
        proposal: Proposal::default(),
        steering: Steering::NONE,
        direct_strata: 2,
        average: 0.0,
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
        let images = DerivativeImages::of_shapes(
            scene,
            objective.cells(),
            deformed,
            fit.material,
            &wanted,
            &options,
        );
        let mut changes = vec![vec![[0.0; 3]; lights * cells]; shapes];
        for cell in 0..cells {
            for (shape, light, change) in images.at(cell) {
                changes[shape][light * cells + cell] = change.halves[0].map(f64::from);
            }
        }
        displaced.extend(changes);
    }
    displaced
}

/// Displacement over the sample's size; angle in radians; relative scale.
const STEP: f64 = 2e-3;

/// Unit of the radii of blur, part of the image's width: that of [`FIELD_PARTS`], or the side of
/// half of the cells where they are larger, because a blur within a cell is not seen.
pub(super) fn blur_unit(cells: &Cells) -> f64 {
    let mut sides: Vec<u32> = (0..cells.len()).map(|k| cells.cell(k).side_px).collect();
    let middle = sides.len() / 2;
    let side_px = match sides.is_empty() {
        true => 0,
        false => *sides.select_nth_unstable(middle).1,
    };
    (f64::from(side_px) / cells.resolution_px()[0] as f64).max(1.0 / FIELD_PARTS)
}

/// What a cell would show under a Gaussian blur of this radius, part of the image's width. All
/// pixels that no cell covers are black: light that is spread beyond the sample is lost to it.
pub(super) fn blurred(
    cells: &Cells,
    cell: usize,
    radius: f64,
    value: impl Fn(usize) -> f64,
) -> f64 {
    let [width, height] = cells.resolution_px();
    let radius_px = radius * width as f64;
    let middle_px = cells.cell(cell).middle_px();
    // Part of the Gaussian in an interval of pixels.
    let along = |middle: f64, from: f64, to: f64| {
        let below = |at: f64| libm::erf((at - middle) / (radius_px * SQRT_2));
        0.5 * (below(to) - below(from))
    };
    let inside = |corner: DVec2, size: DVec2| {
        let end = corner + size;
        along(middle_px.x, corner.x, end.x) * along(middle_px.y, corner.y, end.y)
    };
    let reach = BLUR_REACH * radius + cells.largest_side();
    let near = cells.within(cell, reach).map(|other| {
        let other_cell = cells.cell(other);
        let side_px = f64::from(other_cell.side_px);
        let corner_px = other_cell.middle_px() - 0.5 * side_px;
        // Cells at the silhouette are not whole squares.
        let covered = other_cell.pixels() as f64 / (side_px * side_px);
        covered * inside(corner_px, DVec2::splat(side_px)) * value(other)
    });
    // What lies beyond the image is not known to be black.
    near.sum::<f64>() / inside(DVec2::ZERO, DVec2::new(width as f64, height as f64))
}

/// Standard deviations of a Gaussian that count.
const BLUR_REACH: f64 = 3.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::cell_footprints::Cell;

    /// Along a line of light that ends, half of it is left at the end and nearly all of it
    /// inside, whatever the cells' sizes; at the image's border nothing is lost.
    #[test]
    fn a_blur_loses_light_to_what_no_cell_covers() {
        let mut squares: Vec<Cell> = (0..8)
            .flat_map(|y| (0..32).map(move |x| Cell::square([x, y], 1)))
            .filter(|cell| cell.middle_px().x > 8.0)
            .collect();
        squares.extend(
            (0..16)
                .map(|k| Cell::square([2 * k, 8], 2))
                .filter(|cell| cell.middle_px().x > 8.0),
        );
        squares.extend(
            (0..8)
                .map(|k| Cell::square([4 * k, 10], 4))
                .filter(|cell| cell.middle_px().x > 8.0),
        );
        let cells = Cells::new([32, 14], squares);
        let radius_px = 1.5;
        for k in 0..cells.len() {
            let x = cells.cell(k).middle_px().x;
            let is = blurred(&cells, k, radius_px / 32.0, |_| 2.0);
            let should = 1.0 + libm::erf((x - 8.0) / (radius_px * SQRT_2));
            assert!(
                (is - should).abs() < 0.006,
                "{:?}: {is} for {should}",
                cells.cell(k)
            );
        }
    }
}
