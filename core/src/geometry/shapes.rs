//! The sample shapes, each from its formula.
//!
//! All face the camera on the +z side. Curved ones are tessellated; with
//! `segments` facets around, neighbouring normals differ by 2π/segments.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

use super::mesh::{Mesh, MeshError};

/// A parametric sample. Lengths in millimetres.
///
/// ```
/// use rig_core::geometry::Shape;
///
/// // A corner of a room: three mutually orthogonal facets, apex at z = −depth.
/// let corner = Shape::Tetrahedron { radius_mm: 20.0, depth_mm: 20.0 * 0.5f32.sqrt() }.mesh()?;
/// assert_eq!(corner.triangles.len(), 3);
/// assert!(corner.face_normal(0).dot(corner.face_normal(1)).abs() < 1e-5);
/// # Ok::<(), rig_core::geometry::MeshError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// The inside of a hemisphere, rim in the plane z = 0, bottom at z = −radius.
    Bowl {
        /// Radius of the sphere.
        radius_mm: f32,
        /// Facets around, 8..=4096, a multiple of 4.
        segments: u32,
    },
    /// A whole sphere about the origin, seen from outside.
    Sphere {
        /// Radius.
        radius_mm: f32,
        /// Facets around, 8..=4096, a multiple of 4.
        segments: u32,
    },
    /// The upper part of a sphere, seen from outside, rim in the plane z = 0, top at
    /// z = radius · (1 − cos opening).
    Cap {
        /// Radius of the sphere.
        radius_mm: f32,
        /// Angle from the axis to the rim, seen from the sphere's centre, degrees, 5..=170:
        /// 90 is half a sphere, more a ball that stands on a flat.
        #[serde(default = "right_angle")]
        opening_deg: f32,
        /// Facets around, 8..=4096, a multiple of 4.
        segments: u32,
    },
    /// Three facets over an equilateral triangle in the plane z = 0 whose corners lie
    /// at `radius_mm` from the axis. Apex at z = −depth (a corner of a room,
    /// mutually orthogonal facets at depth = radius/√2) or, negative, at +|depth|.
    Tetrahedron {
        /// Distance of the base's corners from the axis.
        radius_mm: f32,
        /// Apex below (positive, concave) or above (negative, convex) the base.
        depth_mm: f32,
    },
    /// The paper's Section 6 shape: a convex arc that faces a concave wall such that
    /// coaxial light leaves coaxially after two mirror reflections, for every θd.
    Designed {
        /// Radius R of the convex arc.
        radius_mm: f32,
        /// C in units of R: 0 ends in a cusp, more raises the wall; 0..=2.
        offset: f32,
        /// Smallest angle of the arc's normal from +z that has a partner on the wall, degrees, 30..=60.
        phi_min_deg: f32,
        /// Extruded along y, or revolved about z.
        form: Form,
        /// Length along y of the extruded form; ignored by the revolved one.
        length_mm: f32,
        /// Steps along each part of the profile (and a quarter turn of the revolved form),
        /// 8..=4096, a multiple of 4.
        segments: u32,
    },
    /// A convex ridge within a concave moat, rim in the plane z = 0: the profile of
    /// [`RIDGE`], found by a search for what four images tell of a material where the camera
    /// is tilted by 54° from the axis.
    Ridge {
        /// From the axis to the rim.
        radius_mm: f32,
        /// Extruded along y, or revolved about z.
        form: Form,
        /// Length along y of the extruded form; ignored by the revolved one.
        length_mm: f32,
        /// Facets around the revolved form, and steps from the axis to the rim,
        /// 8..=4096, a multiple of 4.
        segments: u32,
    },
    /// A groove around the z axis, as a lathe cuts it, rims in the plane z = 0. With
    /// a = width/2, the profile in (x, z) is, round, the half circle
    /// (radius − a cos t, −a sin t), t = 0..180°, or, as a V, the lines from
    /// (radius − a, 0) over (radius, −depth) to (radius + a, 0).
    Groove {
        /// Distance of the groove's middle from the axis.
        radius_mm: f32,
        /// Width between the rims, less than 2 · radius.
        width_mm: f32,
        /// Round or V.
        profile: Profile,
        /// Facets around, 8..=4096, a multiple of 4.
        segments: u32,
    },
}

/// The section of a groove.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// A half circle, as deep as half its width.
    Round,
    /// Two straight flanks; right-angled, and so a retroreflector of coaxial light, at
    /// depth = width/2.
    Vee {
        /// Depth of the bottom below the rims.
        depth_mm: f32,
    },
}

/// How a profile becomes a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// Along y.
    Extruded,
    /// About the z axis.
    Revolved,
}

/// The opening of a cap that states none: half a sphere.
fn right_angle() -> f32 {
    90.0
}

impl Shape {
    /// The tessellated surface, with exact normals at the corners where it is curved.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        match *self {
            Shape::Bowl {
                radius_mm,
                segments,
            } => {
                // From the rim down to the pole, inward normals.
                let profile = arc(radius_mm, segments / 4, |t| {
                    (Vec2::new(t.cos(), -t.sin()), -Vec2::new(t.cos(), -t.sin()))
                });
                revolve(&profile, segments)
            }
            Shape::Cap {
                radius_mm,
                opening_deg,
                segments,
            } => {
                let wide = f64::from(opening_deg) / 90.0;
                let steps = (f64::from(segments / 4) * wide).ceil() as u32;
                let rim = opening_deg.to_radians().cos();
                let rim = if opening_deg == 90.0 { 0.0 } else { rim };
                let profile = arc(radius_mm, steps, |t| {
                    let t = t * wide as f32;
                    let normal = Vec2::new(t.sin(), t.cos());
                    (normal - rim * Vec2::Y, normal)
                });
                revolve(&profile, segments)
            }
            Shape::Sphere {
                radius_mm,
                segments,
            } => {
                let profile = arc(radius_mm, segments / 2, |t| {
                    (
                        Vec2::new((2.0 * t).sin(), (2.0 * t).cos()),
                        Vec2::new((2.0 * t).sin(), (2.0 * t).cos()),
                    )
                });
                revolve(&profile, segments)
            }
            Shape::Tetrahedron {
                radius_mm,
                depth_mm,
            } => {
                let corner = |i: u8| {
                    let angle = FRAC_PI_2 + f32::from(i) * TAU / 3.0;
                    Vec3::new(radius_mm * angle.cos(), radius_mm * angle.sin(), 0.0)
                };
                let positions = vec![
                    corner(0),
                    corner(1),
                    corner(2),
                    Vec3::new(0.0, 0.0, -depth_mm),
                ];
                Mesh::new(positions, vec![[0, 1, 3], [1, 2, 3], [2, 0, 3]])
            }
            Shape::Designed {
                radius_mm,
                offset,
                phi_min_deg,
                form,
                length_mm,
                segments,
            } => {
                let profile =
                    designed_profile(radius_mm, offset, phi_min_deg.to_radians(), segments);
                match form {
                    Form::Extruded => extrude(&profile, length_mm),
                    Form::Revolved => revolve(&profile, 4 * segments),
                }
            }
            Shape::Ridge {
                radius_mm,
                form,
                length_mm,
                segments,
            } => of_knots(&RIDGE, radius_mm, form, length_mm, segments),
            Shape::Groove {
                radius_mm,
                width_mm,
                profile,
                segments,
            } => revolve(
                &groove_profile(radius_mm, 0.5 * width_mm, profile, segments / 2),
                segments,
            ),
        }
    }
}

/// A point of a profile in the (x, z) half plane and the normal there; a repeated
/// point with another normal makes a crease.
type ProfilePoint = (Vec2, Vec2);

fn arc(radius_mm: f32, steps: u32, at: impl Fn(f32) -> ProfilePoint) -> Vec<ProfilePoint> {
    (0..=steps)
        .map(|i| {
            let (p, n) = at(FRAC_PI_2 * i as f32 / steps as f32);
            let snap = |v: Vec2| Vec2::select(v.abs().cmplt(Vec2::splat(1e-7)), Vec2::ZERO, v);
            (snap(p) * radius_mm, n)
        })
        .collect()
}

/// Point and normal of the wall's profile for an arc normal φ from +z:
/// t = (C + R cos φ)/sin²φ along the mirrored ray (sin 2φ, cos 2φ) from
/// R (sin φ, cos φ); the wall's normal is (−cos φ, sin φ).
pub fn designed_wall(radius_mm: f64, offset_mm: f64, phi_rad: f64) -> [f64; 2] {
    let (sin, cos) = phi_rad.sin_cos();
    let t = (offset_mm + radius_mm * cos) / (sin * sin);
    [
        radius_mm * sin + t * (2.0 * phi_rad).sin(),
        radius_mm * cos + t * (2.0 * phi_rad).cos(),
    ]
}

/// From the axis outwards: the arc φ = 0..90°, the vertical wall (R, 0) to (R, −C)
/// where C > 0 (invisible from above), the concave wall φ = 90°..φ_min.
fn designed_profile(
    radius_mm: f32,
    offset: f32,
    phi_min_rad: f32,
    steps: u32,
) -> Vec<ProfilePoint> {
    let (radius, offset_mm) = (f64::from(radius_mm), f64::from(offset * radius_mm));
    let mut profile = Vec::new();
    for i in 0..=steps {
        let (sin, cos) = (FRAC_PI_2 * i as f32 / steps as f32).sin_cos();
        let cos = if i == steps { 0.0 } else { cos };
        profile.push((radius_mm * Vec2::new(sin, cos), Vec2::new(sin, cos)));
    }
    if offset_mm > 0.0 {
        profile.push((Vec2::new(radius_mm, 0.0), Vec2::X));
        profile.push((Vec2::new(radius_mm, -offset_mm as f32), Vec2::X));
    }
    for i in 0..=steps {
        // Starts at (R, −C); without a wall this repeats the arc's end, a cusp.
        let s = f64::from(i) / f64::from(steps);
        let half_pi = std::f64::consts::FRAC_PI_2;
        let phi = half_pi + (f64::from(phi_min_rad) - half_pi) * s;
        let (sin, cos) = phi.sin_cos();
        let [x, z] = designed_wall(radius, offset_mm, phi);
        profile.push((
            Vec2::new(x as f32, z as f32),
            Vec2::new(-cos as f32, sin as f32),
        ));
    }
    profile.dedup();
    profile
}

/// Height above the rim and slope of the ridge's profile at r = 0, 0.2, … 1, everything in
/// units of the radius; between them z is the cubic polynomial with these values and slopes.
/// Highest 0.329 at r = 0.18, lowest −0.114 at r = 0.82, steepest 54°.
pub const RIDGE: [[f64; 2]; 6] = [
    [0.2785, 0.0],
    [0.3276, -0.1786],
    [0.1613, -1.0436],
    [-0.0117, -0.7358],
    [-0.1126, -0.1221],
    [0.0, 1.3996],
];

/// Height and slope at `r` = 0..=1 of a profile by its height and slope at evenly spaced knots,
/// at least two; everything in units of the radius.
pub fn knot_height(knots: &[[f64; 2]], r: f64) -> [f64; 2] {
    let step = 1.0 / (knots.len() - 1) as f64;
    let from = ((r / step) as usize).min(knots.len() - 2);
    let t = r / step - from as f64;
    let [[low, low_slope], [high, high_slope]] = [knots[from], knots[from + 1]];
    // Hermite's cubic, and its derivative by r.
    let rise = high - low;
    let curve = (1.0 - t) * (low_slope * step - rise) - t * (high_slope * step - rise);
    let bent =
        (1.0 - 2.0 * t) * curve + t * (1.0 - t) * (2.0 * rise - (low_slope + high_slope) * step);
    [low + t * rise + t * (1.0 - t) * curve, (rise + bent) / step]
}

/// The surface whose profile [`knot_height`] gives, from the axis to the rim at `radius_mm`, in
/// `segments` steps; `length_mm` is that of an extruded one.
pub fn of_knots(
    knots: &[[f64; 2]],
    radius_mm: f32,
    form: Form,
    length_mm: f32,
    segments: u32,
) -> Result<Mesh, MeshError> {
    let at = |i: u32| {
        let r = f64::from(i) / f64::from(segments);
        let [height, slope] = knot_height(knots, r);
        let point = Vec2::new(r as f32, height as f32);
        (radius_mm * point, Vec2::new(-slope as f32, 1.0).normalize())
    };
    let profile: Vec<ProfilePoint> = (0..=segments).map(at).collect();
    match form {
        Form::Extruded => extrude(&profile, length_mm),
        Form::Revolved => revolve(&profile, segments),
    }
}

/// From the inner rim to the outer one.
fn groove_profile(
    radius_mm: f32,
    half_width_mm: f32,
    profile: Profile,
    steps: u32,
) -> Vec<ProfilePoint> {
    let (inner, outer) = (radius_mm - half_width_mm, radius_mm + half_width_mm);
    match profile {
        Profile::Round => (0..=steps)
            .map(|i| {
                let (sin, cos) = (std::f32::consts::PI * i as f32 / steps as f32).sin_cos();
                let sin = if i == steps { 0.0 } else { sin };
                let normal = Vec2::new(cos, sin);
                (Vec2::new(radius_mm, 0.0) - half_width_mm * normal, normal)
            })
            .collect(),
        Profile::Vee { depth_mm } => {
            let flank = Vec2::new(depth_mm, half_width_mm).normalize();
            let mirrored = Vec2::new(-flank.x, flank.y);
            let bottom = Vec2::new(radius_mm, -depth_mm);
            vec![
                (Vec2::new(inner, 0.0), flank),
                (bottom, flank),
                (bottom, mirrored),
                (Vec2::new(outer, 0.0), mirrored),
            ]
        }
    }
}

/// Sweeps a profile about z. The surface is fronted on the side of its normals.
fn revolve(profile: &[ProfilePoint], around: u32) -> Result<Mesh, MeshError> {
    let mut strip = Strip::default();
    let mut rows = Vec::new();
    for &(p, n) in profile {
        let count = if p.x == 0.0 { 1 } else { around };
        let row: Vec<u32> = (0..count)
            .map(|j| {
                let (sin, cos) = (TAU * j as f32 / around as f32).sin_cos();
                strip.push(
                    Vec3::new(p.x * cos, p.x * sin, p.y),
                    Vec3::new(n.x * cos, n.x * sin, n.y),
                )
            })
            .collect();
        rows.push(row);
    }
    for (k, pair) in rows.windows(2).enumerate() {
        if profile[k].0 == profile[k + 1].0 {
            continue;
        }
        for j in 0..around as usize {
            let at = |row: &[u32], j: usize| row[if row.len() == 1 { 0 } else { j % row.len() }];
            strip.quad([
                at(&pair[0], j),
                at(&pair[0], j + 1),
                at(&pair[1], j + 1),
                at(&pair[1], j),
            ]);
        }
    }
    strip.finish()
}

/// Sweeps a profile along y over `length_mm`, mirrored about x = 0 so that the arc is whole.
fn extrude(profile: &[ProfilePoint], length_mm: f32) -> Result<Mesh, MeshError> {
    let mirrored = profile
        .iter()
        .rev()
        .map(|&(p, n)| (Vec2::new(-p.x, p.y), Vec2::new(-n.x, n.y)));
    let mut whole: Vec<ProfilePoint> = mirrored.chain(profile.iter().copied()).collect();
    whole.dedup_by(|b, a| (b.0 - a.0).length() < 1e-9 && (b.1 - a.1).length() < 1e-6);
    let mut strip = Strip::default();
    let rows: Vec<[u32; 2]> = whole
        .iter()
        .map(|&(p, n)| {
            [-0.5, 0.5].map(|side| {
                strip.push(
                    Vec3::new(p.x, side * length_mm, p.y),
                    Vec3::new(n.x, 0.0, n.y),
                )
            })
        })
        .collect();
    for (k, pair) in rows.windows(2).enumerate() {
        if whole[k].0 != whole[k + 1].0 {
            strip.quad([pair[0][0], pair[0][1], pair[1][1], pair[1][0]]);
        }
    }
    strip.finish()
}

/// Vertices and faces under construction.
#[derive(Default)]
struct Strip {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Strip {
    fn push(&mut self, position: Vec3, normal: Vec3) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        (self.positions.len() - 1) as u32
    }

    /// Two triangles, turned so that their front is on the side of the corners' normals.
    fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        for corners in [[a, b, c], [a, c, d]] {
            let [p, q, r] = corners.map(|v| self.positions[v as usize]);
            let face = (q - p).cross(r - p);
            if p == q || q == r || r == p {
                continue;
            }
            let normal: Vec3 = corners.iter().map(|&v| self.normals[v as usize]).sum();
            let [i, j, k] = corners;
            self.triangles.push(if face.dot(normal) >= 0.0 {
                [i, j, k]
            } else {
                [i, k, j]
            });
        }
    }

    fn finish(self) -> Result<Mesh, MeshError> {
        Mesh::new(self.positions, self.triangles)?.with_normals(self.normals)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Bvh, Ray};

    fn cap(opening_deg: f32) -> Shape {
        Shape::Cap {
            radius_mm: 2.0,
            opening_deg,
            segments: 32,
        }
    }

    fn ridge(form: Form) -> Shape {
        Shape::Ridge {
            radius_mm: 10.0,
            form,
            length_mm: 20.0,
            segments: 256,
        }
    }

    fn all() -> Vec<Shape> {
        let designed = |offset, form| Shape::Designed {
            radius_mm: 1.0,
            offset,
            phi_min_deg: 45.0,
            form,
            length_mm: 2.0,
            segments: 64,
        };
        let groove = |profile| Shape::Groove {
            radius_mm: 1.0,
            width_mm: 0.6,
            profile,
            segments: 64,
        };
        vec![
            Shape::Bowl {
                radius_mm: 2.0,
                segments: 32,
            },
            cap(90.0),
            cap(60.0),
            cap(150.0),
            ridge(Form::Revolved),
            ridge(Form::Extruded),
            Shape::Sphere {
                radius_mm: 2.0,
                segments: 32,
            },
            Shape::Tetrahedron {
                radius_mm: 1.0,
                depth_mm: 0.7,
            },
            Shape::Tetrahedron {
                radius_mm: 1.0,
                depth_mm: -0.7,
            },
            designed(0.5, Form::Extruded),
            designed(0.0, Form::Extruded),
            designed(0.5, Form::Revolved),
            groove(Profile::Round),
            groove(Profile::Vee { depth_mm: 0.2 }),
        ]
    }

    #[test]
    fn every_shape_is_a_valid_mesh_fronted_along_its_normals() {
        for shape in all() {
            let mesh = shape.mesh().unwrap_or_else(|e| panic!("{shape:?}: {e}"));
            let Some(normals) = &mesh.normals else {
                continue;
            };
            for (i, corners) in mesh.triangles.iter().enumerate() {
                for &v in corners {
                    let cos = mesh.face_normal(i).dot(normals[v as usize]);
                    assert!(cos > 0.9, "{shape:?}: triangle {i}, cosine {cos}");
                }
            }
        }
    }

    /// Area and height of a spherical cap, and where its rim is: 2π R² (1 − cos), R (1 − cos).
    #[test]
    fn a_cap_is_the_part_of_a_sphere_that_it_states() {
        for opening_deg in [20.0, 60.0, 90.0, 150.0f32] {
            let mesh = match cap(opening_deg) {
                Shape::Cap { radius_mm, .. } => Shape::Cap {
                    radius_mm,
                    opening_deg,
                    segments: 256,
                },
                other => other,
            };
            let mesh = mesh.mesh().unwrap();
            let [low, high] = mesh.bounds_mm();
            let part = 1.0 - opening_deg.to_radians().cos();
            assert!(
                (high.z - 2.0 * part).abs() < 1e-5 && low.z.abs() < 1e-5,
                "{low} {high}"
            );
            let widest = 2.0 * opening_deg.min(90.0).to_radians().sin();
            assert!(
                (high.x / widest - 1.0).abs() < 1e-3,
                "{opening_deg}: {high}"
            );
            let area: f32 = (0..mesh.triangles.len())
                .map(|i| mesh.corners(i))
                .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length())
                .sum();
            let expected = TAU * 4.0 * part;
            assert!(
                (area / expected - 1.0).abs() < 1e-3,
                "{opening_deg}: {area}"
            );
        }
        // What files of before say is half a sphere.
        let text = r#"{"kind": "cap", "radius_mm": 2.0, "segments": 32}"#;
        assert_eq!(serde_json::from_str::<Shape>(text).unwrap(), cap(90.0));
    }

    /// Heights and slopes of the table, slopes that are those of the heights, and the volume
    /// between rim and surface by the integral 2π ∫ r z dr.
    #[test]
    fn the_ridge_is_its_profile() {
        for (i, expected) in RIDGE.into_iter().enumerate() {
            let [height, slope] = knot_height(&RIDGE, 0.2 * i as f64);
            assert!((height - expected[0]).abs() < 1e-12, "{i}: {height}");
            assert!((slope - expected[1]).abs() < 1e-9, "{i}: {slope}");
        }
        let mut volume = 0.0;
        for i in 0..1000 {
            let r = (f64::from(i) + 0.5) / 1000.0;
            let [height, slope] = knot_height(&RIDGE, r);
            let rise = knot_height(&RIDGE, r + 1e-6)[0] - knot_height(&RIDGE, r - 1e-6)[0];
            assert!((rise / 2e-6 - slope).abs() < 1e-5, "{r}");
            volume += std::f64::consts::TAU * r * height / 1000.0;
        }
        let mesh = ridge(Form::Revolved).mesh().unwrap();
        let [low, high] = mesh.bounds_mm();
        assert!(
            (high.z - 3.291).abs() < 2e-3 && (low.z + 1.140).abs() < 2e-3,
            "{low} {high}"
        );
        // Signed volumes against the plane z = 0.
        let under = |[a, b, c]: [Vec3; 3]| (b - a).cross(c - a).z * (a.z + b.z + c.z) / 6.0;
        let found: f32 = (0..mesh.triangles.len())
            .map(|i| under(mesh.corners(i)))
            .sum();
        assert!(
            (f64::from(found) / 1e3 / volume - 1.0).abs() < 0.01,
            "{found} {volume}"
        );
    }

    #[test]
    fn what_the_camera_sees_is_a_front() {
        for shape in all() {
            let mesh = shape.mesh().unwrap();
            let bvh = Bvh::new(&mesh);
            let [low, high] = mesh.bounds_mm();
            let mut seen = 0;
            for i in 0..400 {
                let (u, v) = ((i % 20) as f32 + 0.37, (i / 20) as f32 + 0.61);
                let ray = Ray {
                    origin_mm: Vec3::new(
                        low.x + (high.x - low.x) * u / 20.0,
                        low.y + (high.y - low.y) * v / 20.0,
                        high.z + 1.0,
                    ),
                    direction: Vec3::NEG_Z,
                    limit_mm: f32::INFINITY,
                };
                if let Some(hit) = bvh.closest(&ray) {
                    seen += 1;
                    let z = mesh.face_normal(hit.triangle as usize).z;
                    assert!(
                        z > 0.0,
                        "{shape:?}: back face towards the camera, normal z {z}"
                    );
                }
            }
            assert!(seen > 100, "{shape:?}: only {seen} of 400 rays hit");
        }
    }

    /// The closed form of the wall against integrating its slope dz/dx = cot φ.
    #[test]
    fn designed_wall_agrees_with_integrating_the_normals() {
        for offset in [0.0, 0.3, 1.0] {
            let start = 85f64.to_radians();
            let [mut x, mut z] = designed_wall(1.0, offset, start);
            let steps = 200_000;
            let step = (45f64.to_radians() - start) / f64::from(steps);
            for i in 0..steps {
                let phi = start + step * f64::from(i);
                let [next_x, _] = designed_wall(1.0, offset, phi + step);
                // Midpoint rule on the slope; only x(φ) is taken from the closed form.
                z += (next_x - x) / (phi + 0.5 * step).tan();
                x = next_x;
            }
            let [_, expected] = designed_wall(1.0, offset, 45f64.to_radians());
            assert!(
                (z - expected).abs() < 1e-8,
                "C = {offset}: {z} against {expected}"
            );
        }
    }
}
