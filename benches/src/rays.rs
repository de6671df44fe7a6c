//! Rays for measuring ray queries: bounces of camera paths, and rays aimed at edges.

use glam::Vec3;
use rig::geometry::bvh::offset_origin;
use rig::geometry::{Bvh, Mesh, Ray};
use rig::random::{Purpose, Stream, stream};

/// The rays that leave the surface along camera paths with cosine-distributed
/// directions, in the order of the paths: neighbours have nothing in common.
/// The camera is telecentric along −z over the mesh's bounds.
pub fn bounces(mesh: &Mesh, bvh: &Bvh, count: usize) -> Vec<Ray> {
    const LONGEST: usize = 8;
    let [low, high] = mesh.bounds_mm();
    let mut numbers = stream(1, Purpose::Experiment, 0, 0, 0);
    let mut rays = Vec::with_capacity(count);
    while rays.len() < count {
        let across = Vec3::new(numbers.uniform_f32(), numbers.uniform_f32(), 0.0);
        let mut ray = Ray {
            origin_mm: (low + (high - low) * across).with_z(high.z + 5.0),
            direction: Vec3::NEG_Z,
            limit_mm: f32::INFINITY,
        };
        for _ in 0..LONGEST {
            let Some(hit) = bvh.closest(&ray) else { break };
            let triangle = hit.triangle as usize;
            let normal = mesh.face_normal(triangle);
            if normal.dot(ray.direction) >= 0.0 {
                break;
            }
            let [a, b, c] = mesh.corners(triangle);
            let [u, v] = hit.barycentric;
            ray = Ray {
                origin_mm: offset_origin(a + (b - a) * u + (c - a) * v, normal),
                direction: cosine(normal, &mut numbers),
                limit_mm: f32::INFINITY,
            };
            rays.push(ray);
        }
    }
    rays.truncate(count);
    rays
}

/// Rays from inside a closed mesh about the origin, in turn at a vertex and at a point
/// of an edge: every one must hit.
pub fn aimed_at_edges(mesh: &Mesh, count: usize) -> Vec<Ray> {
    let mut numbers = stream(11, Purpose::Experiment, 0, 0, 0);
    (0..count)
        .map(|sample| {
            let triangle = (numbers.bits() % mesh.triangles.len() as u64) as usize;
            let [a, b, _] = mesh.corners(triangle);
            let target = if sample % 2 == 0 {
                a
            } else {
                a.lerp(b, numbers.uniform_f32())
            };
            let origin_mm = sphere(&mut numbers) * 0.7 * numbers.uniform_f32();
            Ray {
                origin_mm,
                direction: (target - origin_mm).normalize(),
                limit_mm: f32::INFINITY,
            }
        })
        .collect()
}

fn cosine(normal: Vec3, numbers: &mut Stream) -> Vec3 {
    let r2 = numbers.uniform_f32();
    let (sin, cos) = (std::f32::consts::TAU * numbers.uniform_f32()).sin_cos();
    let (x, y) = normal.any_orthonormal_pair();
    ((x * cos + y * sin) * r2.sqrt() + normal * (1.0 - r2).sqrt()).normalize()
}

fn sphere(numbers: &mut Stream) -> Vec3 {
    let z = 2.0 * numbers.uniform_f32() - 1.0;
    let (sin, cos) = (std::f32::consts::TAU * numbers.uniform_f32()).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, z)
}
