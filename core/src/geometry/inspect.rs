//! What a mesh file holds, and where its sample should lie: size, openings, rim, axis, and
//! the placement that brings the rim to the sample's datum.

use std::collections::HashMap;
use std::path::Path;

use glam::{DQuat, DVec3};
use serde::Serialize;

use super::files;
use super::mesh::Mesh;
use super::mesh_error::MeshError;
use super::placement::{Placement, angles_xyz_deg};
use super::topology::{Groups, Topology, chains};
use crate::frames::Rigid;

/// Units that a file's coordinates may be in, by the names that configurations give them,
/// with their millimetres; the likeliest first.
pub const UNITS: [(&str, f64); 6] = [
    ("mm", 1.0),
    ("m", 1000.0),
    ("in", 25.4),
    ("cm", 10.0),
    ("um", 1e-3),
    ("ft", 304.8),
];

/// Largest extents that samples have, millimetres.
const USUAL_MM: std::ops::RangeInclusive<f64> = 2.0..=400.0;
/// A rim is plane if no corner is farther off its plane, of its extent.
const PLANE: f64 = 0.02;
/// A plane face counts as one if it has this part of the whole area: rings of narrow facets
/// around a pole do not.
const LEAST_FACE: f64 = 0.01;
/// Facets that turn by less are of one plane, radians.
const COPLANAR_RAD: f32 = 1e-3;

/// What a mesh file holds. Lengths are in the file's unit, positions on its axes.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// Vertices that facets use.
    pub vertices: usize,
    /// Facets with area, polygons cut into triangles.
    pub facets: usize,
    /// Least coordinates.
    pub low: [f64; 3],
    /// Largest coordinates.
    pub high: [f64; 3],
    /// Sum of the facets' areas, square units.
    pub area: f64,
    /// Whether normals for smooth shading are in the file.
    pub has_normals: bool,
    /// Whether it has no opening.
    pub is_closed: bool,
    /// Borders of the surface, the widest first; at most eight.
    pub openings: Vec<Opening>,
    /// Edges at which neighbours face opposite ways.
    pub turned_edges: usize,
    /// Edges of more than two facets.
    pub crowded_edges: usize,
    /// Whether fronts are on the wrong side: within a body, or outside a hollow. `None` where
    /// it cannot be determined.
    pub is_inside_out: Option<bool>,
    /// The hollow, where there is one with a plane rim.
    pub hollow: Option<Hollow>,
    /// What was left out or is remarkable.
    pub remarks: Vec<String>,
    /// How a configuration should place it.
    pub suggestion: Suggestion,
    /// The same for an open surface that is meant to be seen from outside: a dome.
    pub as_dome: Option<Suggestion>,
}

/// A closed line around an opening.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Opening {
    /// Corners.
    pub corners: usize,
    /// Length around.
    pub length: f64,
    /// Middle of its area.
    pub centre: [f64; 3],
    /// Unit vector across its plane; on its side the fronts of an open surface are.
    pub normal: [f64; 3],
    /// Area that it encloses, square units.
    pub area: f64,
    /// Largest distance of a corner from its plane.
    pub off_plane: f64,
}

/// A surface that bends away from a plane rim.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hollow {
    /// Its rim.
    pub rim: Opening,
    /// Unit vector out of the hollow through the rim: where the camera belongs.
    pub axis: [f64; 3],
    /// Of the deepest vertex below the rim's plane.
    pub depth: f64,
}

/// Keys of `[sample]` or `[geometry.sample]` that place the mesh.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Suggestion {
    /// By the mesh's size.
    pub mesh_unit: &'static str,
    /// Millimetres across in this unit.
    pub size_mm: f64,
    /// Whether facets must be turned.
    pub flip_facets: bool,
    /// About the fixed axes x, y, z in this order; `None` where it cannot be determined.
    pub rotate_deg: Option<[f64; 3]>,
    /// Then.
    pub translate_mm: Option<[f64; 3]>,
}

impl Suggestion {
    /// The placement of these keys.
    pub fn placement(&self) -> Placement {
        let unit = UNITS.iter().find(|(name, _)| *name == self.mesh_unit);
        Placement {
            mm_per_unit: unit.map_or(1.0, |(_, mm)| *mm),
            flip_facets: self.flip_facets,
            sample_from_mesh: Rigid::new(
                super::placement::rotation_xyz(self.rotate_deg.unwrap_or_default()),
                DVec3::from_array(self.translate_mm.unwrap_or_default()),
            ),
        }
    }
}

/// Looks at a file.
///
/// # Errors
/// As [`files::read`].
pub fn inspect(path: &Path) -> Result<Inspection, MeshError> {
    // With its middle at the origin: coordinates far away keep few digits.
    let mut middle = DVec3::ZERO;
    let mesh = files::within(path, |draft| {
        middle = draft.middle();
        draft.mesh(&Placement {
            sample_from_mesh: Rigid::new(DQuat::IDENTITY, -middle),
            ..Placement::default()
        })
    })?;
    Ok(of(&mesh, middle))
}

/// Looks at a mesh whose coordinates are without those of `middle`.
fn of(mesh: &Mesh, middle: DVec3) -> Inspection {
    let topology = Topology::of(&mesh.positions_mm, &mesh.triangles);
    let at = |vertex: u32| mesh.positions_mm[vertex as usize].as_dvec3();
    let opening = |chain: &Vec<u32>| {
        let corners: Vec<DVec3> = chain.iter().map(|&v| at(v)).collect();
        Opening::of(&corners)
    };
    // Openings, the widest first, and the enclosed volume with its sign.
    let borders = topology.borders();
    let is_closed = borders.is_empty();
    let mut openings: Vec<Opening> = borders.iter().filter_map(opening).collect();
    openings.sort_by(|a, b| b.area.total_cmp(&a.area));
    let volume: f64 = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
            a.dot(b.cross(c)) / 6.0
        })
        .sum();

    // A hole in a plane face that all else is behind, else the widest border.
    let seat = hole_in_a_plane(mesh, &topology).or_else(|| openings.first().cloned());
    let bulk = centroid(mesh);
    let hollow = seat.and_then(|rim| Hollow::of(mesh, rim, bulk));
    // Which side the fronts are on.
    let is_inside_out = match (&hollow, is_closed) {
        (_, true) => Some(volume < 0.0),
        (Some(hollow), false) => Some(vector(hollow.rim.normal).dot(vector(hollow.axis)) < 0.0),
        (None, false) => None,
    };
    // The unit by the size, and the placement by the rim.
    let [low, high] = mesh.bounds_mm().map(|corner| corner.as_dvec3());
    let size = (high - low).max_element();
    let (mesh_unit, mm) = unit_of(size);
    let toward = |axis: DVec3, flip_facets: bool, origin: DVec3| Suggestion {
        mesh_unit,
        size_mm: size * mm,
        flip_facets,
        ..placed(axis, (origin + middle) * mm, size * mm)
    };
    let suggestion = match &hollow {
        Some(hollow) => toward(
            vector(hollow.axis),
            is_inside_out == Some(true),
            vector(hollow.rim.centre),
        ),
        None => Suggestion {
            mesh_unit,
            size_mm: size * mm,
            flip_facets: is_inside_out == Some(true),
            rotate_deg: None,
            translate_mm: None,
        },
    };
    let as_dome = match &hollow {
        Some(hollow) if !is_closed && is_inside_out == Some(true) => Some(toward(
            -vector(hollow.axis),
            false,
            vector(hollow.rim.centre),
        )),
        _ => None,
    };
    // In the file's coordinates, which the mesh has without `middle`.
    openings.truncate(8);
    let moved = |mut opening: Opening| {
        opening.centre = (vector(opening.centre) + middle).to_array();
        opening
    };
    Inspection {
        vertices: mesh.positions_mm.len(),
        facets: mesh.triangles.len(),
        low: (low + middle).to_array(),
        high: (high + middle).to_array(),
        area: (0..mesh.triangles.len())
            .map(|t| area(mesh, t).length())
            .sum(),
        has_normals: mesh.normals.is_some(),
        is_closed,
        openings: openings.into_iter().map(moved).collect(),
        turned_edges: topology.turned_edges(),
        crowded_edges: topology.crowded_edges(),
        is_inside_out,
        hollow: hollow.map(|hollow| Hollow {
            rim: moved(hollow.rim),
            ..hollow
        }),
        remarks: mesh.remarks.iter().map(|r| r.what.to_string()).collect(),
        suggestion,
        as_dome,
    }
}

fn vector(v: [f64; 3]) -> DVec3 {
    DVec3::from_array(v)
}

/// A facet's area along its normal.
fn area(mesh: &Mesh, triangle: usize) -> DVec3 {
    let [a, b, c] = mesh.corners(triangle).map(|p| p.as_dvec3());
    0.5 * (b - a).cross(c - a)
}

/// Middle of the surface.
fn centroid(mesh: &Mesh) -> DVec3 {
    let (mut sum, mut all) = (DVec3::ZERO, 0.0);
    for triangle in 0..mesh.triangles.len() {
        let weight = area(mesh, triangle).length();
        let [a, b, c] = mesh.corners(triangle).map(|p| p.as_dvec3());
        sum += (a + b + c) * (weight / 3.0);
        all += weight;
    }
    sum / all
}

impl Opening {
    /// `None` if the line encloses no area.
    fn of(corners: &[DVec3]) -> Option<Self> {
        let n = corners.len();
        let mean = corners.iter().sum::<DVec3>() / n as f64;
        let sides = || (0..n).map(|i| [corners[i] - mean, corners[(i + 1) % n] - mean]);
        let area: DVec3 = sides().map(|[a, b]| 0.5 * a.cross(b)).sum();
        let normal = area.try_normalize()?;
        let weighted: DVec3 = sides()
            .map(|[a, b]| (a + b) / 3.0 * (0.5 * a.cross(b)).dot(normal))
            .sum();
        let off = corners.iter().map(|c| (*c - mean).dot(normal).abs());
        Some(Self {
            corners: n,
            length: sides().map(|[a, b]| a.distance(b)).sum(),
            centre: (mean + weighted / area.length()).to_array(),
            normal: normal.to_array(),
            area: area.length(),
            off_plane: off.fold(0.0, f64::max),
        })
    }
}

impl Hollow {
    /// What bends away from a rim; `None` where that is not plane, or nothing is below it.
    fn of(mesh: &Mesh, rim: Opening, bulk: DVec3) -> Option<Self> {
        let (centre, normal) = (vector(rim.centre), vector(rim.normal));
        let axis = match (centre - bulk).dot(normal) >= 0.0 {
            true => normal,
            false => -normal,
        };
        let depths = mesh.positions_mm.iter();
        let depth = depths
            .map(|p| (centre - p.as_dvec3()).dot(axis))
            .fold(0.0, f64::max);
        let is_plane = rim.off_plane <= PLANE * rim.area.sqrt();
        (is_plane && depth > PLANE * rim.area.sqrt()).then(|| Self {
            axis: axis.to_array(),
            depth,
            rim,
        })
    }
}

/// The widest hole in a plane face before which nothing of the mesh lies: the rim of a
/// hollow in a block or a flange, in the sense of that face's front.
fn hole_in_a_plane(mesh: &Mesh, topology: &Topology) -> Option<Opening> {
    let mut groups = Groups::new(mesh.triangles.len());
    for [one, two] in topology.pairs() {
        let [a, b] = [one, two].map(|side| mesh.face_normal(side.facet as usize));
        if a.angle_between(b) < COPLANAR_RAD {
            groups.join(one.facet, two.facet);
        }
    }
    // Edges around each plane face.
    let mut around: HashMap<u32, Vec<[u32; 2]>> = HashMap::new();
    for edge in topology.edges() {
        let roots: Vec<u32> = edge.iter().map(|side| groups.root(side.facet)).collect();
        for (side, root) in edge.iter().zip(&roots) {
            if roots.iter().filter(|other| *other == root).count() == 1 {
                around.entry(*root).or_default().push(side.ends());
            }
        }
    }
    let size = {
        let [low, high] = mesh.bounds_mm();
        f64::from((high - low).length())
    };
    let whole: f64 = (0..mesh.triangles.len())
        .map(|t| area(mesh, t).length())
        .sum();
    let mut best: Option<Opening> = None;
    for (root, edges) in around {
        let loops: Vec<Opening> = chains(edges.into_iter())
            .iter()
            .filter_map(|chain| {
                let corners = chain
                    .iter()
                    .map(|&v| mesh.positions_mm[v as usize].as_dvec3());
                Opening::of(&corners.collect::<Vec<_>>())
            })
            .collect();
        let front = mesh.face_normal(root as usize).as_dvec3();
        let sides = loops
            .iter()
            .map(|l| l.area * vector(l.normal).dot(front).signum());
        if loops.len() < 2 || sides.sum::<f64>() < LEAST_FACE * whole {
            continue;
        }
        let on = mesh.corners(root as usize)[0].as_dvec3();
        let heights = || {
            mesh.positions_mm
                .iter()
                .map(|p| (p.as_dvec3() - on).dot(front))
        };
        let is_outermost =
            heights().all(|h| h < 1e-3 * size) || heights().all(|h| h > -1e-3 * size);
        // Holes run the other way around than the outline.
        let holes = loops
            .into_iter()
            .filter(|l| vector(l.normal).dot(front) < 0.0);
        for mut hole in holes.filter(|_| is_outermost) {
            hole.normal = front.to_array();
            // By area, then position: the same for any order of the table.
            let key = |o: &Opening| (o.area, o.centre);
            if best.as_ref().is_none_or(|best| key(&hole) > key(best)) {
                best = Some(hole);
            }
        }
    }
    best
}

/// The first unit in which something of this extent is a usual sample, else millimetres.
fn unit_of(size: f64) -> (&'static str, f64) {
    let usual = UNITS.iter().find(|(_, mm)| USUAL_MM.contains(&(size * mm)));
    *usual.unwrap_or(&UNITS[0])
}

/// The rotation and translation that bring `axis` to +z and `origin_mm` to the origin.
fn placed(axis: DVec3, origin_mm: DVec3, size_mm: f64) -> Suggestion {
    let rotation = DQuat::from_rotation_arc(axis, DVec3::Z);
    let rounded = |v: f64, digits: i32| {
        let unit = 10f64.powi(digits);
        (v * unit).round() / unit + 0.0
    };
    let rotate_deg = angles_xyz_deg(rotation).map(|angle| rounded(angle, 5));
    let turned = super::placement::rotation_xyz(rotate_deg) * origin_mm;
    // A hundred-thousandth of the size.
    let digits = (5.0 - size_mm.log10()).ceil() as i32;
    Suggestion {
        mesh_unit: "mm",
        size_mm,
        flip_facets: false,
        rotate_deg: Some(rotate_deg),
        translate_mm: Some((-turned).to_array().map(|v| rounded(v, digits))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::placement::rotation_xyz;
    use crate::geometry::{MeshRemark, Shape};

    fn bowl() -> Mesh {
        Mesh {
            normals: None,
            ..Shape::Bowl {
                radius_mm: 10.0,
                segments: 32,
            }
            .mesh()
            .unwrap()
        }
    }

    /// Writes the mesh in `unit`, turned by a rotation and moved, and looks at the file.
    fn of_file(mesh: &Mesh, mm: f64, angles: [f64; 3], moved: DVec3) -> (Inspection, Mesh) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let to_file: Rigid<crate::frames::MeshFile, crate::frames::Sample> =
            Rigid::new(rotation_xyz(angles), moved);
        let mut written = mesh.transformed(&to_file);
        written
            .positions_mm
            .iter_mut()
            .for_each(|p| *p /= mm as f32);
        files::write(&path, &written).unwrap();
        let found = inspect(&path).unwrap();
        let placed = files::read(&path, &found.suggestion.placement()).unwrap();
        (found, placed)
    }

    #[test]
    fn a_bowl_as_it_should_be_needs_nothing() {
        let (found, _) = of_file(&bowl(), 1.0, [0.0; 3], DVec3::ZERO);
        assert!(!found.is_closed && found.openings.len() == 1);
        assert_eq!(found.is_inside_out, Some(false));
        let suggestion = found.suggestion;
        assert_eq!(
            (suggestion.mesh_unit, suggestion.flip_facets),
            ("mm", false)
        );
        assert_eq!(suggestion.rotate_deg, Some([0.0; 3]));
        assert_eq!(suggestion.translate_mm, Some([0.0; 3]));
        assert!(found.as_dome.is_none());
        assert!((found.hollow.unwrap().depth - 10.0).abs() < 1e-4);
    }

    /// In metres, turned, moved and inside out: what is suggested brings it back, up to a
    /// rotation about the axis.
    #[test]
    fn a_bowl_of_another_program_is_brought_back() {
        for (angles, seed) in [([140.0, 25.0, -70.0], 1.0), ([180.0, 0.0, 0.0], -2.0)] {
            let mut inside_out = bowl();
            inside_out.triangles.iter_mut().for_each(|t| t.swap(1, 2));
            let moved = DVec3::new(300.0, -20.0 * seed, 7.0);
            let (found, placed) = of_file(&inside_out, 1000.0, angles, moved);
            assert_eq!(found.suggestion.mesh_unit, "m");
            assert!(found.suggestion.flip_facets);
            for (p, was) in placed.positions_mm.iter().zip(&bowl().positions_mm) {
                assert!((p.z - was.z).abs() < 1e-3, "{p} {was}");
                assert!((p.truncate().length() - was.truncate().length()).abs() < 1e-3);
            }
            assert_eq!(placed.triangles, bowl().triangles);
            let dome = found.as_dome.unwrap();
            assert!(!dome.flip_facets);
        }
    }

    /// A hollow in a block: the block is closed, its top has a hole.
    #[test]
    fn a_hollow_in_a_block_is_found() {
        let mut positions = bowl().positions_mm;
        let mut triangles = bowl().triangles;
        let rim: Vec<u32> = Topology::of(&positions, &triangles).borders().remove(0);
        let first = positions.len() as u32;
        for z in [0.0, -15.0] {
            for [x, y] in [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]] {
                positions.push(glam::Vec3::new(15.0 * x, 15.0 * y, z));
            }
        }
        // The top: from each side of the rim to the corner of its quarter, and between them.
        let quarter = |v: u32| {
            let p = positions[v as usize];
            match (p.x > 0.0 || (p.x.abs() < 1e-3 && p.y < 0.0), p.y > 0.0) {
                (true, true) => first,
                (false, true) => first + 1,
                (false, false) => first + 2,
                (true, false) => first + 3,
            }
        };
        let mut top = Vec::new();
        for (i, &a) in rim.iter().enumerate() {
            let b = rim[(i + 1) % rim.len()];
            top.push([b, a, quarter(a)]);
            if quarter(a) != quarter(b) {
                top.push([b, quarter(a), quarter(b)]);
            }
        }
        triangles.extend(top);
        let [t, u] = [first, first + 4];
        for i in 0..4 {
            let j = (i + 1) % 4;
            triangles.push([t + i, u + i, u + j]);
            triangles.push([t + i, u + j, t + j]);
        }
        triangles.push([u, u + 2, u + 1]);
        triangles.push([u, u + 3, u + 2]);
        let block = Mesh::new(positions, triangles).unwrap();
        let (found, _) = of_file(&block, 25.4, [90.0, 0.0, 0.0], DVec3::new(0.0, 50.0, 0.0));
        assert_eq!(found.turned_edges, 0);
        assert!(
            found.is_closed && found.is_inside_out == Some(false),
            "{found:?}"
        );
        let hollow = found.hollow.unwrap();
        assert_eq!(hollow.rim.corners, 32);
        assert!((hollow.depth - 15.0 / 25.4).abs() < 1e-3);
        assert!((vector(hollow.axis) - rotation_xyz([90.0, 0.0, 0.0]) * DVec3::Z).length() < 1e-4);
    }

    #[test]
    fn a_sphere_has_no_rim() {
        let shape = Shape::Sphere {
            radius_mm: 3.0,
            segments: 16,
        };
        let (found, _) = of_file(&shape.mesh().unwrap(), 1.0, [0.0; 3], DVec3::ZERO);
        assert!(found.is_closed && found.hollow.is_none());
        assert_eq!(found.is_inside_out, Some(false));
        assert_eq!(found.suggestion.rotate_deg, None);
        assert!(!found.remarks.contains(&MeshRemark::NoEnd.to_string()));
    }
}
