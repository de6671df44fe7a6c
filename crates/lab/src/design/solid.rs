//! Closed blocks that carry a surface: what is cut or printed.

use glam::{DVec2, DVec3, Vec3};

use super::profile::{Limits, Profile};
use crate::geometry::shapes::Form;
use crate::geometry::{Mesh, MeshError};

/// Least thickness of a block, in radii of the sample.
const WALL: f64 = 0.3;

/// What is made for a design.
pub struct Part {
    /// Of its file, without the ending.
    pub name: &'static str,
    /// Closed, fronts outward, mm.
    pub solid: Mesh,
}

/// The parts of a design, with `segments` steps from the axis to the rim: one block that is painted,
/// or the two halves of a former for a sheet. Under its paint or sheet of
/// [`Limits::thickness_mm`] the block is that much lower along the surface's normal.
///
/// # Errors
/// More facets than a mesh can have.
pub fn parts(profile: &Profile, limits: &Limits, segments: u32) -> Result<Vec<Part>, MeshError> {
    let section = |depth_mm: f64| profile.section(limits.radius_mm, depth_mm, segments);
    let wall_mm = WALL * limits.radius_mm;
    let level = |line: &[DVec2], z: f64| line.iter().map(|p| DVec2::new(p.x, z)).collect();
    let carrying = section(limits.thickness_mm);
    let floor = carrying.iter().map(|p| p.y).fold(f64::INFINITY, f64::min) - wall_mm;
    let under: Vec<DVec2> = level(&carrying, floor);
    match limits.form {
        Form::Revolved => Ok(vec![Part {
            name: "sample",
            // A disc needs no rows.
            solid: turned(&[under[0], under[under.len() - 1]], &carrying, 2 * segments)?,
        }]),
        Form::Extruded => {
            let pressing = section(0.0);
            let ceiling = pressing.iter().map(|p| p.y).fold(0.0, f64::max) + wall_mm;
            let over: Vec<DVec2> = level(&pressing, ceiling);
            let length_mm = 2.0 * limits.radius_mm;
            Ok(vec![
                Part {
                    name: "former-lower",
                    solid: prism(&under, &carrying, length_mm)?,
                },
                Part {
                    name: "former-upper",
                    solid: prism(&pressing, &over, length_mm)?,
                },
            ])
        }
    }
}

/// Between two lines of as many points, from x = 0 outward, mirrored about x = 0; along y over
/// `length_mm`.
fn prism(lower: &[DVec2], upper: &[DVec2], length_mm: f64) -> Result<Mesh, MeshError> {
    let whole = |half: &[DVec2]| -> Vec<DVec2> {
        let mirrored = half.iter().skip(1).rev().map(|p| DVec2::new(-p.x, p.y));
        mirrored.chain(half.iter().copied()).collect()
    };
    let (lower, upper) = (whole(lower), whole(upper));
    let columns = lower.len() as u32;
    let mut positions = Vec::new();
    for (low, high) in lower.iter().zip(&upper) {
        for (p, side) in [(low, -0.5), (low, 0.5), (high, -0.5), (high, 0.5)] {
            positions.push(Vec3::new(p.x as f32, (side * length_mm) as f32, p.y as f32));
        }
    }
    // Corners of a column: below and above, each in front and behind.
    let mut faces = Vec::new();
    for k in 0..columns - 1 {
        let [a, b] = [4 * k, 4 * (k + 1)];
        faces.push([a, a + 1, b + 1, b]);
        faces.push([a + 2, b + 2, b + 3, a + 3]);
        faces.push([a, b, b + 2, a + 2]);
        faces.push([a + 1, a + 3, b + 3, b + 1]);
    }
    let last = 4 * (columns - 1);
    faces.push([0, 2, 3, 1]);
    faces.push([last, last + 1, last + 3, last + 2]);
    Mesh::new(positions, halves(&faces))
}

/// Between two lines from the z axis outward, turned about it.
fn turned(lower: &[DVec2], upper: &[DVec2], around: u32) -> Result<Mesh, MeshError> {
    let mut positions = Vec::new();
    let mut faces = Vec::new();
    let mut triangles = Vec::new();
    let mut rims = Vec::new();
    for (line, is_upper) in [(lower, false), (upper, true)] {
        let axis = positions.len() as u32;
        positions.push(Vec3::new(0.0, 0.0, line[0].y as f32));
        for p in &line[1..] {
            for j in 0..around {
                let (sin, cos) =
                    (std::f64::consts::TAU * f64::from(j) / f64::from(around)).sin_cos();
                positions.push(DVec3::new(p.x * cos, p.x * sin, p.y).as_vec3());
            }
        }
        let at = |row: u32, j: u32| axis + 1 + row * around + j % around;
        for j in 0..around {
            let [a, b] = [at(0, j), at(0, j + 1)];
            triangles.push(if is_upper { [axis, a, b] } else { [axis, b, a] });
        }
        for row in 0..line.len() as u32 - 2 {
            for j in 0..around {
                let mut face = [
                    at(row, j),
                    at(row + 1, j),
                    at(row + 1, j + 1),
                    at(row, j + 1),
                ];
                if !is_upper {
                    face.reverse();
                }
                faces.push(face);
            }
        }
        rims.push(at(line.len() as u32 - 2, 0));
    }
    let [below, above] = [rims[0], rims[1]];
    for j in 0..around {
        let next = (j + 1) % around;
        faces.push([below + j, below + next, above + next, above + j]);
    }
    triangles.extend(halves(&faces));
    Mesh::new(positions, triangles)
}

/// Two triangles of each quadrilateral.
fn halves(faces: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let both = |&[a, b, c, d]: &[u32; 4]| [[a, b, c], [a, c, d]];
    faces.iter().flat_map(both).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    /// Volume by the divergence theorem, mm³; panics where an edge is not shared by two triangles
    /// that run along it in opposite directions.
    fn volume_of_closed(mesh: &Mesh) -> f64 {
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
                assert!(a != b);
            }
        }
        assert!(edges.values().all(|&balance| balance == 0));
        let of = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.positions_mm[v as usize].as_dvec3());
            a.dot(b.cross(c)) / 6.0
        };
        mesh.triangles.iter().map(of).sum()
    }

    /// A block is closed, its volume that of Guldin's or Cavalieri's rule; between the halves of a
    /// former there is the sheet, as thick as stated along the normal.
    #[test]
    fn blocks_are_closed_and_leave_room_for_the_sheet() {
        let profile = Profile::through(&[0.3, 0.1, -0.2, -0.3, -0.1]);
        let limits = Limits {
            thickness_mm: 0.5,
            ..Limits::default()
        };
        let radius_mm = limits.radius_mm;
        let area = |section: &[DVec2], weight: fn(f64) -> f64, floor: f64| -> f64 {
            let each = section.windows(2).map(|pair| {
                let middle = 0.5 * (pair[0] + pair[1]);
                weight(middle.x) * (middle.y - floor) * (pair[1].x - pair[0].x)
            });
            each.sum()
        };
        let section = profile.section(radius_mm, 0.5, 128);
        let floor = section.iter().map(|p| p.y).fold(f64::INFINITY, f64::min) - 0.3 * radius_mm;
        let revolved = parts(&profile, &limits, 128).unwrap();
        assert_eq!(revolved.len(), 1);
        let expected = area(&section, |r| std::f64::consts::TAU * r, floor);
        let volume = volume_of_closed(&revolved[0].solid);
        assert!(
            (volume / expected - 1.0).abs() < 1e-3,
            "{volume} {expected}"
        );

        let limits = Limits {
            form: Form::Extruded,
            ..limits
        };
        let extruded = parts(&profile, &limits, 128).unwrap();
        let expected = 2.0 * area(&section, |_| 1.0, floor) * 2.0 * radius_mm;
        let volume = volume_of_closed(&extruded[0].solid);
        assert!(
            (volume / expected - 1.0).abs() < 1e-3,
            "{volume} {expected}"
        );
        assert!(volume_of_closed(&extruded[1].solid) > 0.0);
        for (bare, surface) in section.iter().zip(&profile.section(radius_mm, 0.0, 128)) {
            assert!((bare.distance(*surface) - 0.5).abs() < 1e-9);
        }
    }
}
