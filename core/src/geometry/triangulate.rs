//! Polygons cut into triangles by clipping ears (Meisters 1975).
//!
//! Corners in line with their neighbours are kept, as the polygon next door uses them
//! too: a triangle that left them out would leave a gap between the two. That is why no
//! library for drawings is used here; these drop such corners.

use glam::{DVec2, DVec3};

/// Most corners of a polygon that is cut.
pub const MAX_CORNERS: usize = 10_000;

/// Twice the area, over the squared extent, that counts as none.
const FLAT: f64 = 1e-12;
/// The triangles of an outline that crosses itself have another area than the polygon, by
/// more than this part.
const CROSSING: f64 = 1e-6;

/// How a polygon was cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// Into triangles of its whole area.
    Whole,
    /// Its outline crosses itself.
    Crossing,
    /// It has no area.
    NoArea,
}

/// Cuts the polygon with these corners, which may be a little out of plane; the triangles'
/// corners are indices into it, in its sense of rotation.
pub fn triangulate(corners: &[DVec3], triangles: &mut Vec<[usize; 3]>) -> Cut {
    match corners.len() {
        0..3 => return Cut::NoArea,
        3 => {
            triangles.push([0, 1, 2]);
            return Cut::Whole;
        }
        _ => {}
    }
    let Some(flat) = Flat::of(corners) else {
        return Cut::NoArea;
    };
    let n = corners.len();
    let is_convex = (0..n).all(|i| flat.turns_left([(i + n - 1) % n, i, (i + 1) % n]))
        && (2..n).all(|i| flat.turns_left([0, i - 1, i]));
    if is_convex {
        triangles.extend((2..n).map(|i| [0, i - 1, i]));
        return Cut::Whole;
    }
    let before = triangles.len();
    flat.clip_ears(triangles);
    let areas = triangles[before..].iter().map(|t| flat.doubled_area(*t));
    match (areas.sum::<f64>() - flat.doubled).abs() > CROSSING * flat.doubled {
        true => Cut::Crossing,
        false => Cut::Whole,
    }
}

/// The polygon in its plane, counter-clockwise.
struct Flat {
    points: Vec<DVec2>,
    /// Twice the area.
    doubled: f64,
    /// Twice the area that counts as none.
    none: f64,
}

impl Flat {
    /// `None` if the polygon has no area.
    fn of(corners: &[DVec3]) -> Option<Self> {
        // Newell's normal, from the middle for the sake of precision.
        let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let next = corners.iter().cycle().skip(1);
        let normal: DVec3 = corners
            .iter()
            .zip(next)
            .map(|(a, b)| (*a - middle).cross(*b - middle))
            .sum();
        let extent = corners
            .iter()
            .map(|c| c.distance_squared(middle))
            .fold(0.0, f64::max);
        if !normal.is_finite() || normal.length() <= FLAT * extent {
            return None;
        }
        let (u, v) = normal.normalize().any_orthonormal_pair();
        let point = |c: &DVec3| DVec2::new((*c - middle).dot(u), (*c - middle).dot(v));
        Some(Self {
            points: corners.iter().map(point).collect(),
            doubled: normal.length(),
            none: FLAT * extent,
        })
    }

    /// Twice the area of a triangle, positive if it runs counter-clockwise.
    fn doubled_area(&self, [a, b, c]: [usize; 3]) -> f64 {
        let [a, b, c] = [a, b, c].map(|i| self.points[i]);
        (b - a).perp_dot(c - a)
    }

    fn turns_left(&self, corner: [usize; 3]) -> bool {
        self.doubled_area(corner) > self.none
    }

    fn clip_ears(&self, triangles: &mut Vec<[usize; 3]>) {
        let mut ring: Vec<usize> = (0..self.points.len()).collect();
        let mut start = 0;
        while ring.len() > 3 {
            let n = ring.len();
            let corner = |i: usize| [ring[(i + n - 1) % n], ring[i % n], ring[(i + 1) % n]];
            let ear = (start..start + n).find(|&i| self.is_ear(corner(i), &ring));
            // What has no ear crosses or touches itself. A corner that only goes there and
            // back again is no loss; else the widest one is taken.
            let at = ear.unwrap_or_else(|| {
                let area = |i: &usize| self.doubled_area(corner(*i));
                let spike = (0..n).find(|i| area(i).abs() <= self.none);
                spike.unwrap_or_else(|| {
                    let widest = (0..n).max_by(|i, j| area(i).total_cmp(&area(j)));
                    widest.unwrap_or(0)
                })
            });
            if self.turns_left(corner(at)) {
                triangles.push(corner(at));
            }
            ring.remove(at % n);
            // Not the same corner again and again, which would make a fan of slivers.
            start = (at + 1) % (n - 1);
        }
        if let &[a, b, c] = ring.as_slice()
            && self.turns_left([a, b, c])
        {
            triangles.push([a, b, c]);
        }
    }

    /// Whether the triangle at a corner can be cut off: it turns left, and no other corner of
    /// the ring is in it or on its rim.
    fn is_ear(&self, [a, b, c]: [usize; 3], ring: &[usize]) -> bool {
        if !self.turns_left([a, b, c]) {
            return false;
        }
        let [pa, pb, pc] = [a, b, c].map(|i| self.points[i]);
        !ring.iter().any(|&i| {
            let p = self.points[i];
            // Corners met twice, as where a cut leads to a hole.
            p != pa
                && p != pb
                && p != pc
                && [[a, b, i], [b, c, i], [c, a, i]]
                    .iter()
                    .all(|side| self.doubled_area(*side) >= -self.none)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The triangles' doubled areas about z, each positive.
    fn areas(points: &[DVec3], triangles: &[[usize; 3]]) -> Vec<f64> {
        let area = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|i| points[i]);
            (b - a).cross(c - a).z
        };
        triangles.iter().map(area).collect()
    }

    fn polygon(text: &[(f64, f64)]) -> Vec<DVec3> {
        text.iter().map(|&(x, y)| DVec3::new(x, y, 0.0)).collect()
    }

    fn check(points: &[DVec3], doubled_area: f64) {
        for turn in 0..points.len() {
            let mut points = points.to_vec();
            points.rotate_left(turn);
            let mut triangles = Vec::new();
            assert_eq!(triangulate(&points, &mut triangles), Cut::Whole);
            let areas = areas(&points, &triangles);
            assert!(areas.iter().all(|a| *a > 0.0), "{turn}: {areas:?}");
            let sum: f64 = areas.iter().sum();
            assert!((sum - doubled_area).abs() < 1e-9, "{turn}: {sum}");
        }
    }

    #[test]
    fn hollow_and_straight_corners_are_cut_whole() {
        // An arrow, an L, a comb, a square with corners on two edges, one with a hole.
        check(
            &polygon(&[(0.0, 0.0), (4.0, -4.0), (1.0, 0.0), (4.0, 4.0)]),
            8.0,
        );
        check(
            &polygon(&[
                (0.0, 0.0),
                (2.0, 0.0),
                (2.0, 1.0),
                (1.0, 1.0),
                (1.0, 2.0),
                (0.0, 2.0),
            ]),
            6.0,
        );
        check(
            &polygon(&[
                (0.0, 0.0),
                (5.0, 0.0),
                (5.0, 3.0),
                (4.0, 3.0),
                (4.0, 1.0),
                (3.0, 1.0),
                (3.0, 3.0),
                (2.0, 3.0),
                (2.0, 1.0),
                (1.0, 1.0),
                (1.0, 3.0),
                (0.0, 3.0),
            ]),
            22.0,
        );
        check(
            &polygon(&[
                (0.0, 0.0),
                (1.0, 0.0),
                (2.0, 0.0),
                (2.0, 1.0),
                (2.0, 2.0),
                (0.0, 2.0),
            ]),
            8.0,
        );
        check(
            &polygon(&[
                (0.0, 0.0),
                (3.0, 0.0),
                (3.0, 3.0),
                (0.0, 3.0),
                (0.0, 0.0),
                (1.0, 1.0),
                (1.0, 2.0),
                (2.0, 2.0),
                (2.0, 1.0),
                (1.0, 1.0),
            ]),
            16.0,
        );
    }

    #[test]
    fn every_corner_is_used() {
        let square = polygon(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]);
        let mut triangles = Vec::new();
        triangulate(&square, &mut triangles);
        assert_eq!(triangles.len(), 3);
        for corner in 0..5 {
            assert!(triangles.iter().any(|t| t.contains(&corner)), "{corner}");
        }
    }

    #[test]
    fn what_is_no_polygon_is_named() {
        let mut triangles = Vec::new();
        let line = polygon(&[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (3.0, 3.0)]);
        assert_eq!(triangulate(&line, &mut triangles), Cut::NoArea);
        assert_eq!(triangulate(&line[..2], &mut triangles), Cut::NoArea);
        let eight = polygon(&[(0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 3.0)]);
        assert_eq!(triangulate(&eight, &mut triangles), Cut::Crossing);
        let broken = vec![DVec3::NAN; 5];
        assert_eq!(triangulate(&broken, &mut triangles), Cut::NoArea);
    }

    proptest! {
        /// Star-shaped polygons of any raggedness, tilted and a little out of plane.
        #[test]
        fn the_triangles_have_the_polygons_area(
            radii in proptest::collection::vec(0.05f64..1.0, 4..40),
            tilt in -1.0f64..1.0,
        ) {
            let n = radii.len() as f64;
            let flat: Vec<DVec2> = radii.iter().enumerate().map(|(i, r)| {
                DVec2::from_angle(std::f64::consts::TAU * i as f64 / n) * *r
            }).collect();
            let points: Vec<DVec3> = flat.iter().enumerate().map(|(i, p)| {
                DVec3::new(p.x, p.y, tilt * p.x + 1e-6 * (i % 3) as f64)
            }).collect();
            let mut triangles = Vec::new();
            prop_assert_eq!(triangulate(&points, &mut triangles), Cut::Whole);
            let areas = areas(&points, &triangles);
            let whole: f64 = (0..flat.len())
                .map(|i| flat[i].perp_dot(flat[(i + 1) % flat.len()]))
                .sum();
            prop_assert!(areas.iter().all(|a| *a > -1e-4));
            prop_assert!((areas.iter().sum::<f64>() - whole).abs() < 1e-6);
        }
    }
}
