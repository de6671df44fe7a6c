//! Where the sample appears in the camera's image: its silhouette as polygons.
//!
//! Rays through a grid over the image tell where the sample is seen; its border is refined
//! along the grid's lines and joined to closed polygons. Lens and pose of the scene's camera
//! are in the rays.

use std::collections::HashMap;

use glam::DVec2;
use serde::Serialize;

use crate::config::{BuildError, RigConfig};
use crate::geometry::topology::chains;
use crate::transport::{Camera, Scene};

/// Cells of the grid along the longer side of the image.
const CELLS: usize = 256;
/// Halvings of a grid's line that the border crosses: 1/64 of a cell remains.
const HALVINGS: usize = 6;
/// Points of all polygons together, at most.
pub const MOST_POINTS: usize = 200;
/// Rays keep this distance from the image's border, pixels.
const INSIDE_PX: f64 = 1e-6;

/// The sample's silhouette.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outline {
    /// Pixels per row of the camera's full frame.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Closed polygons, holes among them, by x to the right and y down, pixels from the top
    /// left corner of the frame. Empty where the sample is out of view.
    pub polygons: Vec<Vec<[f64; 2]>>,
}

/// The outline of a rig's sample as its camera sees it.
///
/// # Errors
/// A mesh or table of the rig's scene that cannot be read.
pub fn outline(rig: &RigConfig) -> Result<Outline, BuildError> {
    let scene = rig.geometry.scene(&[])?;
    Ok(outline_of(&scene, &rig.geometry.camera))
}

/// The outline of a scene's sample in a camera's image, of [`MOST_POINTS`] at most.
pub fn outline_of(scene: &Scene, camera: &Camera) -> Outline {
    let [width, height] = camera.resolution_px;
    let rings = Grid::over(camera, scene).rings();
    let mut tolerance_px = 0.25;
    let mut polygons: Vec<_> = rings.iter().map(|r| simplified(r, tolerance_px)).collect();
    while polygons.iter().map(Vec::len).sum::<usize>() > MOST_POINTS {
        tolerance_px *= 1.5;
        polygons = rings.iter().map(|r| simplified(r, tolerance_px)).collect();
        // What has become a line or a point encloses nothing.
        polygons.retain(|polygon| polygon.len() >= 3);
    }
    let rounded = |p: &DVec2| (*p * 100.0).round() / 100.0;
    Outline {
        width,
        height,
        polygons: polygons
            .iter()
            .map(|polygon| polygon.iter().map(|p| rounded(p).to_array()).collect())
            .collect(),
    }
}

/// Points of a grid over the image, one beyond it on each side, which see nothing.
struct Grid<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    cell_px: f64,
    columns: usize,
    rows: usize,
    /// Whether a point sees the sample, row by row.
    seen: Vec<bool>,
}

impl<'a> Grid<'a> {
    fn over(camera: &'a Camera, scene: &'a Scene) -> Self {
        let [width, height] = camera.resolution_px;
        let cell_px = (width.max(height) as f64 / CELLS as f64).max(1.0);
        let points = |side: usize| (side as f64 / cell_px).ceil() as usize + 3;
        let mut grid = Self {
            scene,
            camera,
            cell_px,
            columns: points(width),
            rows: points(height),
            seen: Vec::new(),
        };
        grid.seen = (0..grid.columns * grid.rows)
            .map(|point| grid.sees(grid.position(point)))
            .collect();
        grid
    }

    /// Of a point of the grid, pixels.
    fn position(&self, point: usize) -> DVec2 {
        let (column, row) = (point % self.columns, point / self.columns);
        (DVec2::new(column as f64, row as f64) - 1.0) * self.cell_px
    }

    /// Whether the sample is seen there; on the image's border as just inside.
    fn sees(&self, position_px: DVec2) -> bool {
        let [width, height] = self.camera.resolution_px.map(|side| side as f64);
        let most = DVec2::new(width, height) - INSIDE_PX;
        let inside = position_px.clamp(DVec2::splat(INSIDE_PX), most);
        if inside.distance(position_px) > 2.0 * INSIDE_PX {
            return false;
        }
        let ray = self.camera.ray(inside, DVec2::ZERO);
        let hit = self.scene.intersect(&ray);
        hit.is_some_and(|surface| surface.is_sample())
    }

    /// Where the border crosses the line from a point that sees the sample to one that
    /// doesn't.
    fn crossing(&self, from: usize, to: usize) -> DVec2 {
        let ends = [from, to].map(|point| self.position(point));
        let [mut inside, mut outside] = match self.seen[from] {
            true => ends,
            false => [ends[1], ends[0]],
        };
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside + outside);
            match self.sees(middle) {
                true => inside = middle,
                false => outside = middle,
            }
        }
        0.5 * (inside + outside)
    }

    /// The closed lines along the border (marching squares).
    fn rings(&self) -> Vec<Vec<DVec2>> {
        let mut crossings: HashMap<[usize; 2], u32> = HashMap::new();
        let mut points = Vec::new();
        let mut edges = Vec::new();
        for row in 0..self.rows - 1 {
            for column in 0..self.columns - 1 {
                let corner = row * self.columns + column;
                // Around the cell, so that neighbours in this list share a line.
                let corners = [
                    corner,
                    corner + 1,
                    corner + 1 + self.columns,
                    corner + self.columns,
                ];
                let crossed: Vec<u32> = (0..4)
                    .map(|side| (corners[side], corners[(side + 1) % 4]))
                    .filter(|&(from, to)| self.seen[from] != self.seen[to])
                    .map(|(from, to)| {
                        let line = [from.min(to), from.max(to)];
                        *crossings.entry(line).or_insert_with(|| {
                            points.push(self.crossing(from, to));
                            points.len() as u32 - 1
                        })
                    })
                    .collect();
                match (crossed.as_slice(), self.seen[corner]) {
                    ([a, b], _) => edges.push([*a, *b]),
                    // Two corners opposite each other: what sees the sample stays apart.
                    ([a, b, c, d], true) => edges.extend([[*d, *a], [*b, *c]]),
                    ([a, b, c, d], false) => edges.extend([[*a, *b], [*c, *d]]),
                    _ => {}
                }
            }
        }
        let ring = |chain: Vec<u32>| chain.iter().map(|&at| points[at as usize]).collect();
        chains(edges.into_iter()).into_iter().map(ring).collect()
    }
}

/// The ring with fewer points, none of those left out farther than the tolerance from it
/// (Douglas and Peucker 1973), cut at its first point and the one farthest from that.
fn simplified(ring: &[DVec2], tolerance_px: f64) -> Vec<DVec2> {
    let Some(&first) = ring.first() else {
        return Vec::new();
    };
    let far = |at: &usize| ring[*at].distance_squared(first);
    let farthest = (0..ring.len()).max_by(|a, b| far(a).total_cmp(&far(b)));
    let farthest = farthest.unwrap_or(0);
    let back: Vec<DVec2> = ring[farthest..].iter().chain([&first]).copied().collect();
    let mut kept = Vec::new();
    for line in [&ring[..=farthest], &back] {
        kept.push(line[0]);
        keep_between(line, tolerance_px, &mut kept);
    }
    kept
}

/// Adds the points between the ends of a line that must be kept.
fn keep_between(line: &[DVec2], tolerance_px: f64, kept: &mut Vec<DVec2>) {
    let [first, between @ .., last] = line else {
        return;
    };
    let along = (*last - *first).normalize_or_zero();
    let distance = |p: &DVec2| match along == DVec2::ZERO {
        true => p.distance(*first),
        false => along.perp_dot(*p - *first).abs(),
    };
    let farthest = (0..between.len()).max_by(|&a, &b| {
        let [a, b] = [a, b].map(|at| distance(&between[at]));
        a.total_cmp(&b)
    });
    if let Some(at) = farthest.filter(|&at| distance(&between[at]) > tolerance_px) {
        keep_between(&line[..=at + 1], tolerance_px, kept);
        kept.push(between[at]);
        keep_between(&line[at + 1..], tolerance_px, kept);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::BUILT_IN;

    fn area(polygon: &[[f64; 2]]) -> f64 {
        let next = polygon.iter().cycle().skip(1);
        let sum: f64 = polygon
            .iter()
            .zip(next)
            .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
            .sum();
        0.5 * sum.abs()
    }

    /// A bowl of radius 10 mm in a field of 29.3 × 22 mm.
    #[test]
    fn the_bowl_is_a_disk_in_the_middle() {
        let rig = RigConfig::parse("simulated", Path::new(""), BUILT_IN[0].1).unwrap();
        let outline = outline(&rig).unwrap();
        assert_eq!([outline.width, outline.height], [640, 480]);
        let [disk] = outline.polygons.as_slice() else {
            panic!("{} polygons", outline.polygons.len());
        };
        assert!((20..=MOST_POINTS).contains(&disk.len()), "{}", disk.len());
        let expected = std::f64::consts::PI * (10.0 / 29.3 * 640.0) * (10.0 / 22.0 * 480.0);
        let part = area(disk) / expected;
        assert!((0.99..1.005).contains(&part), "{part}");
        let radius_px = 10.0 / 29.3 * 640.0;
        for [x, y] in disk {
            let distance = DVec2::new(*x, *y).distance(DVec2::new(320.0, 240.0));
            assert!((distance - radius_px).abs() < 1.0, "{distance}");
        }
    }

    /// Points of a polygon at the image's border lie on it.
    #[test]
    fn a_sample_larger_than_the_image_is_cut_at_its_border() {
        let mut rig = RigConfig::parse("simulated", Path::new(""), BUILT_IN[0].1).unwrap();
        let camera = &mut rig.geometry.camera;
        camera.projection = crate::transport::Projection::Orthographic {
            extent_mm: DVec2::new(4.0, 3.0),
        };
        let outline = outline(&rig).unwrap();
        let [all] = outline.polygons.as_slice() else {
            panic!("{:?}", outline.polygons);
        };
        let part = area(all) / (640.0 * 480.0);
        assert!((0.995..1.005).contains(&part), "{part}");
        assert!(all.len() <= 16, "{all:?}");
    }

    #[test]
    fn many_points_are_reduced_within_a_tolerance() {
        let ring: Vec<DVec2> = (0..1000)
            .map(|at| DVec2::from_angle(f64::from(at) * 0.002 * std::f64::consts::PI) * 100.0)
            .collect();
        let few = simplified(&ring, 1.0);
        assert!((12..60).contains(&few.len()), "{}", few.len());
        for p in &ring {
            let next = few.iter().cycle().skip(1);
            let near = few.iter().zip(next).any(|(a, b)| {
                let along = (*b - *a).normalize();
                let t = (*p - *a).dot(along).clamp(0.0, a.distance(*b));
                (*a + along * t).distance(*p) <= 1.0 + 1e-9
            });
            assert!(near, "{p}");
        }
        assert_eq!(simplified(&[], 1.0), []);
    }
}
