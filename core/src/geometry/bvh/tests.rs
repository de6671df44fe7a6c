use super::*;
use crate::geometry::Shape;
use crate::geometry::shapes::Form;
use crate::random::{Purpose, Stream, stream};

fn direction(numbers: &mut Stream) -> Vec3 {
    let z = 2.0 * numbers.uniform_f32() - 1.0;
    let phi = std::f32::consts::TAU * numbers.uniform_f32();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

fn sphere() -> Mesh {
    Shape::Sphere {
        radius_mm: 1.0,
        segments: 64,
    }
    .mesh()
    .unwrap()
}

/// Rays from inside a closed sphere at its vertices and edge points must all hit.
#[test]
fn no_ray_escapes_a_closed_sphere() {
    let mesh = sphere();
    for bvh in [Bvh::new(&mesh), Bvh::new(&mesh).without_simd()] {
        let mut numbers = stream(11, Purpose::Experiment, 0, 0, 0);
        let mut escaped = 0;
        for sample in 0..400_000 {
            let triangle = (numbers.bits() % mesh.triangles.len() as u64) as usize;
            let [a, b, _] = mesh.corners(triangle);
            let target = if sample % 2 == 0 {
                a
            } else {
                a.lerp(b, numbers.uniform_f32())
            };
            let origin = direction(&mut numbers) * 0.7 * numbers.uniform_f32();
            let ray = Ray {
                origin_mm: origin,
                direction: (target - origin).normalize(),
                limit_mm: f32::INFINITY,
            };
            if bvh.closest(&ray).is_none() || !bvh.any(&ray) {
                escaped += 1;
            }
        }
        assert_eq!(escaped, 0, "of 400000 rays");
    }
}

/// A triangle, an origin of rays that leave it, and its normal.
fn off_the_surface(mesh: &Mesh, numbers: &mut Stream) -> (usize, Vec3, Vec3) {
    let triangle = (numbers.bits() % mesh.triangles.len() as u64) as usize;
    let [a, b, c] = mesh.corners(triangle);
    let (mut u, mut v) = (numbers.uniform_f32(), numbers.uniform_f32());
    if u + v > 1.0 {
        (u, v) = (1.0 - u, 1.0 - v);
    }
    let outward = mesh.face_normal(triangle);
    let origin_mm = offset_origin(a + (b - a) * u + (c - a) * v, outward);
    (triangle, origin_mm, outward)
}

/// Rays that leave the surface never meet it at once: on a sphere the nearest other
/// point along a direction with cosine c to the normal is 2 c R away.
#[test]
fn no_ray_hits_the_surface_it_leaves() {
    let mesh = sphere();
    let bvh = Bvh::new(&mesh);
    let mut numbers = stream(12, Purpose::Experiment, 0, 0, 0);
    for _ in 0..200_000 {
        let (triangle, origin_mm, outward) = off_the_surface(&mesh, &mut numbers);
        let mut away = direction(&mut numbers);
        if away.dot(outward) < 0.0 {
            away = -away;
        }
        let ray = Ray {
            origin_mm,
            direction: away,
            limit_mm: f32::INFINITY,
        };
        assert!(!bvh.any(&ray), "triangle {triangle}, direction {away}");
    }
}

/// The same on strips as long as the sample and a few thousandths as wide, along each axis:
/// what is met is met where double precision says. Half of the rays go where distances in f32
/// put a tenth of the surface into a shadow of its own: mostly along the strips.
#[test]
fn no_ray_hits_the_strip_it_leaves() {
    let mut mesh = Shape::Designed {
        radius_mm: 1.0 / 3.12,
        offset: 0.5,
        phi_min_deg: 45.0,
        form: Form::Extruded,
        length_mm: 2.0,
        segments: 192,
    }
    .mesh()
    .unwrap();
    let mut along = Vec3::new(0.4747, 0.6224, 0.6223).normalize();
    for _ in 0..3 {
        let turned = |p: Vec3| Vec3::new(p.z, p.x, p.y);
        mesh.positions_mm.iter_mut().for_each(|p| *p = turned(*p));
        along = turned(along);
        let bvh = Bvh::new(&mesh);
        let mut numbers = stream(12, Purpose::Experiment, 1, 0, 0);
        let (mut free, mut wrong) = (0, 0);
        for sample in 0..4000 {
            let (_, origin_mm, outward) = off_the_surface(&mesh, &mut numbers);
            let mut away = if sample % 2 == 0 {
                along
            } else {
                direction(&mut numbers)
            };
            if away.dot(outward) < 0.0 {
                away = -away;
            }
            let ray = Ray {
                origin_mm,
                direction: away,
                limit_mm: f32::INFINITY,
            };
            let nearest = in_double_precision(&mesh, &ray);
            free += usize::from(nearest.is_infinite());
            let found = bvh
                .closest(&ray)
                .map_or(f64::INFINITY, |hit| f64::from(hit.distance_mm));
            // Far off, a rim may be met or missed by rounding; near by there is none.
            let is_off = found.min(nearest) < 1e-2 && (found - nearest).abs() > 1e-5;
            wrong += usize::from(is_off || bvh.any(&ray) != found.is_finite());
        }
        assert!(free > 1000, "{free} rays leave the sample");
        assert_eq!(wrong, 0, "of 4000 rays");
    }
}

/// The distance to the nearest triangle, all tested with the plain formula.
fn in_double_precision(mesh: &Mesh, ray: &Ray) -> f64 {
    let (o, d) = (ray.origin_mm.as_dvec3(), ray.direction.as_dvec3());
    let meet = |i: usize| {
        let [a, b, c] = mesh.corners(i).map(Vec3::as_dvec3);
        let (e1, e2) = (b - a, c - a);
        let p = d.cross(e2);
        let det = e1.dot(p);
        let s = o - a;
        let u = s.dot(p) / det;
        let q = s.cross(e1);
        let v = d.dot(q) / det;
        let t = e2.dot(q) / det;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
    };
    let distances = (0..mesh.triangles.len()).filter_map(meet);
    distances.fold(f64::INFINITY, f64::min)
}

/// Against testing every triangle with the plain double-precision formula.
#[test]
fn closest_agrees_with_brute_force() {
    let mesh = Shape::Bowl {
        radius_mm: 1.0,
        segments: 12,
    }
    .mesh()
    .unwrap();
    let bvh = Bvh::new(&mesh);
    let portable = Bvh::new(&mesh).without_simd();
    let mut numbers = stream(13, Purpose::Experiment, 0, 0, 0);
    let mut hits = 0;
    for _ in 0..4000 {
        let ray = Ray {
            origin_mm: direction(&mut numbers) * 2.0,
            direction: direction(&mut numbers),
            limit_mm: f32::INFINITY,
        };
        let brute = in_double_precision(&mesh, &ray);
        let found = bvh.closest(&ray);
        assert_eq!(
            found.map(|h| h.triangle),
            portable.closest(&ray).map(|h| h.triangle)
        );
        match found {
            Some(hit) => {
                hits += 1;
                assert!(
                    (f64::from(hit.distance_mm) - brute).abs() < 1e-5,
                    "{hit:?} {brute}"
                );
            }
            None => assert!(brute.is_infinite(), "missed a hit at {brute}"),
        }
        assert_eq!(bvh.any(&ray), found.is_some());
    }
    assert!(hits > 100, "only {hits} rays hit");
}

/// A tree that follows its mesh finds what a new one finds.
#[test]
fn a_refitted_tree_finds_what_a_new_one_does() {
    let mesh = sphere();
    let mut moved = mesh.clone();
    for p in &mut moved.positions_mm {
        *p = Vec3::new(1.02 * p.x + 0.1 * p.z, p.y - 0.03, 0.97 * p.z);
    }
    let (new, refitted) = (Bvh::new(&moved), Bvh::new(&mesh).refitted(&moved));
    let mut numbers = stream(13, Purpose::Experiment, 0, 0, 0);
    let mut hits = 0;
    for _ in 0..20_000 {
        let ray = Ray {
            origin_mm: 0.5 * direction(&mut numbers),
            direction: direction(&mut numbers),
            limit_mm: 0.9,
        };
        assert_eq!(refitted.closest(&ray), new.closest(&ray), "{ray:?}");
        assert_eq!(refitted.any(&ray), new.any(&ray), "{ray:?}");
        hits += usize::from(new.any(&ray));
    }
    assert!((5_000..15_000).contains(&hits), "{hits} hits");
}

/// Boxes of an unmoved mesh come out as they were built.
#[test]
fn refitting_without_a_change_changes_nothing() {
    let mesh = sphere();
    let built = Bvh::new(&mesh);
    let refitted = built.refitted(&mesh);
    for (a, b) in built.nodes.iter().zip(&refitted.nodes) {
        assert_eq!((a.bounds, a.child), (b.bounds, b.child));
    }
}
