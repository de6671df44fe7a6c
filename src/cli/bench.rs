//! `rig bench`: the inner loops on this machine.

use std::time::Instant;

use glam::{DVec2, DVec3, Vec3};
use serde::Serialize;

use super::{CliError, Context, output};
use crate::brdf::Dictionary;
use crate::geometry::{Bvh, Mesh, Ray, Shape};
use crate::out;
use crate::random::{Purpose, stream};
use crate::transport::{Cache, CacheOptions, Camera, Kernel, Light, Projection, Scene, Shading};

/// Measures tracing, evaluating and ray queries.
#[derive(clap::Args, Debug)]
pub struct BenchArgs {
    /// The figures as JSON
    #[arg(long)]
    json: bool,
    /// Threads, 1 to 256
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=256))]
    threads: u64,
    /// Repetitions of each case, 1 to 1000; medians are printed
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    repeat: u64,
}

#[derive(Serialize)]
struct Case {
    name: String,
    cpu_ms_median: f64,
    wall_ms_median: f64,
    #[serde(flatten)]
    facts: serde_json::Value,
}

/// `rig bench`.
pub fn run(args: &BenchArgs, context: &Context) -> Result<(), CliError> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads as usize)
        .build()
        .map_err(|error| CliError::new(format!("{} threads: {error}", args.threads)))?;
    let cases = pool.install(|| measure(args, context))?;
    if args.json {
        return output::write_json(&serde_json::json!({ "cases": cases }));
    }
    out!("{:16} {:>12} {:>12}", "case", "CPU ms", "wall ms")?;
    for case in cases {
        out!(
            "{:16} {:12.2} {:12.2}",
            case.name,
            case.cpu_ms_median,
            case.wall_ms_median
        )?;
    }
    Ok(())
}

fn measure(args: &BenchArgs, context: &Context) -> Result<Vec<Case>, CliError> {
    let mut cases = Vec::new();
    let bowl = Shape::Bowl {
        radius_mm: 1.0,
        segments: 200,
    };
    let corner = Shape::Tetrahedron {
        radius_mm: 1.0,
        depth_mm: std::f32::consts::FRAC_1_SQRT_2,
    };
    for (name, shape, light_deg) in [("bowl", bowl, 0.0f64), ("corner", corner, 25.0)] {
        let mesh = shape.mesh()?;
        let triangles = mesh.triangles.len();
        let scene = scene(mesh, light_deg);
        let dictionary = Dictionary::grid42();
        let options = CacheOptions {
            samples_per_pixel: 256,
            max_reflections: 8,
            ..CacheOptions::default()
        };
        context.note(format!("trace/{name}"));
        let mut cache = None;
        let traced = timed(args.repeat.min(3), || {
            cache = Some(Cache::trace(&scene, &dictionary, &options))
        });
        let Some(cache) = cache else { continue };
        let cache = cache?;
        let (records, bytes) = cache.size();
        let facts = serde_json::json!({
            "triangles": triangles, "dictionary": dictionary.name(), "light_deg": light_deg,
            "resolution_px": [64, 64], "samples_per_pixel": 2 * cache.samples_per_half,
            "max_reflections": 8, "records": records, "bytes": bytes,
            "threads": rayon::current_num_threads(), "kernel": Kernel::detect().to_string(),
        });
        cases.push(case(format!("trace/{name}"), traced, facts.clone()));
        context.note(format!("evaluate/{name}"));
        let n = dictionary.len();
        let weights = vec![1.0 / n as f64; n];
        let mut mean = 0.0;
        let evaluated = timed(args.repeat, || {
            let sums = cache.evaluate(
                Kernel::detect(),
                &[&weights],
                || (0.0f64, vec![0.0f64; n]),
                |(value, gradient), rows| {
                    *value += 0.5 * f64::from(rows.value[0][0] + rows.value[1][0]);
                    for (sum, (a, b)) in gradient
                        .iter_mut()
                        .zip(rows.jacobian[0].iter().zip(rows.jacobian[1]))
                    {
                        *sum += f64::from(a + b);
                    }
                },
            );
            mean = sums.iter().map(|s| s.0).sum::<f64>() / cache.pixels as f64;
        });
        let mut facts = facts;
        facts["mean_radiance"] = mean.into();
        cases.push(case(format!("evaluate/{name}"), evaluated, facts));
    }
    cases.extend(rays(args)?);
    cases.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(cases)
}

/// Incoherent bounces inside a bowl: closest hits, and any-hits towards a lamp.
fn rays(args: &BenchArgs) -> Result<Vec<Case>, CliError> {
    let mesh = Shape::Bowl {
        radius_mm: 1.0,
        segments: 200,
    }
    .mesh()?;
    let bvh = Bvh::new(&mesh);
    let count = 1_000_000u64;
    let mut numbers = stream(1, Purpose::Experiment, 0, 0, 0);
    let rays: Vec<Ray> = (0..count)
        .map(|_| {
            let triangle = (numbers.bits() % mesh.triangles.len() as u64) as usize;
            let [a, b, c] = mesh.corners(triangle);
            let normal = mesh.face_normal(triangle);
            let r = numbers.uniform_f32().sqrt();
            let phi = std::f32::consts::TAU * numbers.uniform_f32();
            let (x, y) = normal.any_orthonormal_pair();
            let direction =
                x * (r * phi.cos()) + y * (r * phi.sin()) + normal * (1.0 - r * r).sqrt();
            Ray {
                origin_mm: crate::geometry::bvh::offset_origin((a + b + c) / 3.0, normal),
                direction: Vec3::normalize(direction),
                limit_mm: f32::INFINITY,
            }
        })
        .collect();
    let mut hits = [0usize; 2];
    let closest = timed(args.repeat, || {
        hits[0] = rays.iter().filter(|r| bvh.closest(r).is_some()).count()
    });
    let any = timed(args.repeat, || {
        hits[1] = rays.iter().filter(|r| bvh.any(r)).count()
    });
    let facts = |hits: usize, ms: f64| {
        serde_json::json!({
            "triangles": mesh.triangles.len(), "rays": count, "hits": hits,
            "mrays_per_s": count as f64 / ms / 1e3, "threads": 1,
        })
    };
    Ok(vec![
        case(
            "rays/closest".to_owned(),
            closest,
            facts(hits[0], closest.0),
        ),
        case("rays/any".to_owned(), any, facts(hits[1], any.0)),
    ])
}

fn case(
    name: String,
    (cpu_ms_median, wall_ms_median): (f64, f64),
    facts: serde_json::Value,
) -> Case {
    Case {
        name,
        cpu_ms_median,
        wall_ms_median,
        facts,
    }
}

fn scene(mesh: Mesh, light_deg: f64) -> Scene {
    let camera = Camera {
        resolution_px: [64, 64],
        projection: Projection::Orthographic {
            extent_mm: DVec2::splat(2.2),
        },
        sample_from_camera: crate::frames::Rigid::new(
            glam::DQuat::from_rotation_x(std::f64::consts::PI),
            DVec3::new(0.0, 0.0, 5.0),
        ),
        focus_mm: 5.0,
        object_na: 0.0,
    };
    let (sin, cos) = light_deg.to_radians().sin_cos();
    let light = Light::Directional {
        to_light: DVec3::new(sin, 0.0, cos),
        irradiance: [1.0; 3],
        angular_radius_rad: 0.0,
    };
    Scene::new(mesh, Shading::Flat, camera, vec![light])
}

/// Median CPU and wall milliseconds of `repeat` runs.
fn timed(repeat: u64, mut work: impl FnMut()) -> (f64, f64) {
    let (mut cpu, mut wall) = (Vec::new(), Vec::new());
    for _ in 0..repeat {
        let (cpu0, wall0) = (cpu_seconds(), Instant::now());
        work();
        cpu.push(cpu_seconds() - cpu0);
        wall.push(wall0.elapsed().as_secs_f64());
    }
    let median = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        1e3 * values[values.len() / 2]
    };
    (median(&mut cpu), median(&mut wall))
}

/// CPU time of the whole process.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
