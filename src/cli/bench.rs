//! `rig bench`: the inner loops on this machine.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use glam::{DVec2, DVec3, Vec3};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;
use serde_json::{Value, json};

use super::{CliError, Context, output};
use crate::brdf::{Dictionary, Mixture};
use crate::evaluate::growth;
use crate::geometry::bvh::offset_origin;
use crate::geometry::{Bvh, Mesh, Ray, Shape};
use crate::inverse::{BenchPriors, Captured, CellOptions, FitError, FitOptions, fit};
use crate::out;
use crate::random::{Purpose, stream};
use crate::transport::{
    Cache, CacheOptions, Camera, Cells, DirectMatrix, Kernel, Lens, Light, Projection, Proposal,
    RenderOptions, Scene, Shading, render,
};

/// Measures ray queries, tracing, evaluating and a whole fit.
#[derive(clap::Args, Debug)]
pub struct BenchArgs {
    /// The figures as JSON
    #[arg(long)]
    json: bool,
    /// Threads, 1 to 256; several numbers take turns and show how the work scales
    #[arg(long, value_name = "N,…", default_value = "1", value_delimiter = ',', value_parser = clap::value_parser!(u64).range(1..=256))]
    threads: Vec<u64>,
    /// Repetitions of each case, 1 to 1000 (short cases take ten times as many)
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    repeat: u64,
    /// Only cases whose name contains this
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Instead: what `rig fit` costs by the size of its images (64 × 48 to 20 MP), cells, paths,
    /// lights and threads; a table and a plot go into this folder
    #[arg(long, value_name = "DIR", conflicts_with_all = ["only", "repeat", "threads"])]
    growth: Option<PathBuf>,
}

/// A case at one number of threads.
#[derive(Serialize)]
struct Row {
    name: String,
    threads: usize,
    cpu_ms_min: f64,
    cpu_ms_median: f64,
    wall_ms_min: f64,
    wall_ms_median: f64,
    /// Median wall time with the first number of threads over this one's.
    speedup: f64,
    #[serde(flatten)]
    facts: Value,
}

/// `rig bench`.
pub fn run(args: &BenchArgs, context: &Context) -> Result<(), CliError> {
    if let Some(folder) = &args.growth {
        return run_growth(folder, args.json, context);
    }
    let pools = args
        .threads
        .iter()
        .map(|&threads| {
            ThreadPoolBuilder::new()
                .num_threads(threads as usize)
                .build()
                .map_err(|error| CliError::new(format!("{threads} threads: {error}")))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut bench = Bench {
        pools,
        args,
        context,
        rows: Vec::new(),
    };
    bench.rays()?;
    bench.paths()?;
    let lights = [[0.0, 0.0], [30.0, 0.0], [30.0, 120.0], [30.0, 240.0]];
    bench.fit("fit/four-lights", &lights)?;
    bench.fit("fit/one-light", &lights[1..2])?;
    let rows = bench.rows;
    if rows.is_empty() {
        return Err(
            CliError::new(format!("no case's name holds \"{}\"", args.only))
                .hint("`rig bench` without --only runs and names them all"),
        );
    }
    if args.json {
        return output::write_json(&json!({ "cases": rows }));
    }
    out!(
        "{:16} {:>7} {:>10} {:>10} {:>10} {:>10} {:>8}",
        "case",
        "threads",
        "CPU ms",
        "least",
        "wall ms",
        "least",
        "speed-up"
    )?;
    for row in rows {
        out!(
            "{:16} {:7} {:10.2} {:10.2} {:10.2} {:10.2} {:8.2}",
            row.name,
            row.threads,
            row.cpu_ms_median,
            row.cpu_ms_min,
            row.wall_ms_median,
            row.wall_ms_min,
            row.speedup
        )?;
    }
    Ok(())
}

/// Images of every size are in a temporary folder meanwhile.
fn run_growth(folder: &Path, json: bool, context: &Context) -> Result<(), CliError> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |error| CliError::new(format!("{}: {error}", path.display()))
    };
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    let program = std::env::current_exe().map_err(io(Path::new("this program")))?;
    let images = tempfile::tempdir_in(folder).map_err(io(folder))?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let costs = growth::measure(&program, images.path(), threads, &|name| context.note(name))?;
    let figure = growth::figure(&costs);
    let csv = growth::to_csv(&costs);
    for (name, bytes) in [
        ("growth.csv", csv.as_bytes()),
        ("growth.svg", figure.svg.as_bytes()),
        ("growth.png", &figure.png()?),
    ] {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(io(&path))?;
    }
    if json {
        return output::write_json(&json!({ "fits": costs }));
    }
    out!(
        "{:8} {:>12} {:>6} {:>6} {:>6} {:>7} {:>8} {:>8} {:>8}",
        "varied",
        "pixels",
        "lights",
        "cells",
        "paths",
        "threads",
        "CPU s",
        "wall s",
        "MB"
    )?;
    for cost in &costs {
        let case = &cost.case;
        let [width, height] = case.resolution_px;
        out!(
            "{:8} {:>12} {:6} {:6} {:6} {:7} {:8.1} {:8.1} {:8.0}",
            case.varied,
            format!("{width} × {height}"),
            case.lights,
            case.cells,
            case.paths,
            case.threads,
            cost.cpu_s,
            cost.wall_s,
            cost.memory_mb
        )?;
    }
    out!("{}", folder.join("growth.png").display())?;
    Ok(())
}

struct Bench<'a> {
    pools: Vec<ThreadPool>,
    args: &'a BenchArgs,
    context: &'a Context,
    rows: Vec<Row>,
}

impl Bench<'_> {
    fn wanted(&self, name: &str) -> bool {
        name.contains(&self.args.only)
    }

    /// Measures `work` with every number of threads, in turns so that a change of the
    /// machine's load meets all of them; `facts` gets the median CPU milliseconds.
    fn case(
        &mut self,
        name: &str,
        repeat: u64,
        mut work: impl FnMut() + Send,
        facts: impl Fn(f64) -> Value,
    ) {
        if !self.wanted(name) {
            return;
        }
        self.context.note(name);
        let mut times = vec![[Vec::new(), Vec::new()]; self.pools.len()];
        for _ in 0..repeat {
            for (pool, [cpu, wall]) in self.pools.iter().zip(&mut times) {
                pool.install(|| {
                    let (cpu0, wall0) = (cpu_seconds(), Instant::now());
                    work();
                    wall.push(1e3 * wall0.elapsed().as_secs_f64());
                    cpu.push(1e3 * (cpu_seconds() - cpu0));
                });
            }
        }
        let mut one = None;
        for (pool, mut of_pool) in self.pools.iter().zip(times) {
            of_pool.iter_mut().for_each(|t| t.sort_by(f64::total_cmp));
            let [cpu, wall] = of_pool;
            let middle = cpu.len() / 2;
            let one = *one.get_or_insert(wall[middle]);
            self.rows.push(Row {
                name: name.to_owned(),
                threads: pool.current_num_threads(),
                cpu_ms_min: cpu[0],
                cpu_ms_median: cpu[middle],
                wall_ms_min: wall[0],
                wall_ms_median: wall[middle],
                speedup: one / wall[middle],
                facts: facts(cpu[middle]),
            });
        }
    }

    /// Tracing the cache and one pass over it: image, gradient and Jacobian.
    fn paths(&mut self) -> Result<(), CliError> {
        let corner = Shape::Tetrahedron {
            radius_mm: 1.0,
            depth_mm: std::f32::consts::FRAC_1_SQRT_2,
        };
        for (name, shape, light_deg) in [("bowl", bowl(), 0.0f64), ("corner", corner, 25.0)] {
            let (trace, direct, evaluate) = (
                format!("trace/{name}"),
                format!("direct/{name}"),
                format!("evaluate/{name}"),
            );
            if ![&trace, &direct, &evaluate].iter().any(|n| self.wanted(n)) {
                continue;
            }
            let mesh = shape.mesh()?;
            let triangles = mesh.triangles.len();
            let scene = scene(mesh, &[[light_deg, 0.0]]);
            let dictionary = Dictionary::load(Dictionary::DEFAULT)?;
            let options = CacheOptions {
                samples_per_cell: 256,
                max_reflections: 8,
                ..CacheOptions::default()
            };
            let cells = Cells::of_pixels(scene.camera.resolution_px);
            let cache = Cache::trace(&scene, &cells, &dictionary, &options)?;
            let (records, bytes) = cache.size();
            let facts = json!({
                "mesh": name, "triangles": triangles, "dictionary": dictionary.name(),
                "light_deg": light_deg, "resolution_px": scene.camera.resolution_px,
                "samples_per_pixel": 2 * cache.samples_per_half,
                "paths": 2 * cache.samples_per_half as usize * cache.cells,
                "max_reflections": options.max_reflections, "records": records, "bytes": bytes,
            });
            let repeat = self.args.repeat;
            self.case(
                &trace,
                repeat.min(3),
                || {
                    std::hint::black_box(
                        Cache::trace(&scene, &cells, &dictionary, &options).is_ok(),
                    );
                },
                |_| facts.clone(),
            );
            self.case(
                &direct,
                repeat.min(3),
                || {
                    std::hint::black_box(DirectMatrix::new(&scene, &cells, &dictionary, 16, 1));
                },
                |_| facts.clone(),
            );
            let mut mean = 0.0;
            let kernel = Kernel::detect();
            let weights = vec![1.0 / dictionary.len() as f64; dictionary.len()];
            let pass = || pass(&cache, kernel, &weights);
            let facts = |ms: f64| {
                let mut facts = facts.clone();
                facts["kernel"] = kernel.to_string().into();
                facts["mean_radiance"] = pass().into();
                facts["ns_per_record"] = (1e6 * ms / records as f64).into();
                facts
            };
            self.case(&evaluate, 10 * repeat, || mean = pass(), facts);
            std::hint::black_box(mean);
        }
        Ok(())
    }

    /// A fit of three channels to so many images with the defaults, tracing included.
    fn fit(&mut self, name: &str, lights: &[[f64; 2]]) -> Result<(), CliError> {
        if !self.wanted(name) {
            return Ok(());
        }
        let mesh = bowl().mesh()?;
        let triangles = mesh.triangles.len();
        let scene = scene(mesh, lights);
        let dictionary = Arc::new(Dictionary::load(Dictionary::DEFAULT)?);
        let n = dictionary.len();
        // Half Lambertian (the last but one atom), the rest spread over the GGX atoms.
        let truth = [3usize, 5, 7].map(|step| {
            let mut weights = vec![0.0; n];
            let chosen: Vec<usize> = (0..n - 2).step_by(2 * step).collect();
            chosen
                .iter()
                .for_each(|&k| weights[k] = 0.4 / chosen.len() as f64);
            (weights[n - 2], weights[n - 1]) = (0.5, 0.1);
            weights
        });
        let truth = Mixture::new(dictionary.clone(), truth)?;
        let options = RenderOptions {
            samples_per_pixel: 64,
            max_reflections: 16,
            seed: 9,
            proposal: Proposal::resembling(&truth, 0.2),
            ..RenderOptions::default()
        };
        let captured = render(&scene, &truth, &options);
        let options = FitOptions::default();
        let cells = CellOptions::new(&dictionary, &BenchPriors::EXACT);
        let captured = Captured::new(&scene, &captured, &cells).map_err(FitError::from)?;
        let mut failed = None;
        let mut records = 0;
        self.case(
            name,
            self.args.repeat.min(3),
            || match fit(&scene, &captured, &dictionary, &options) {
                Ok(fit) => records = fit.cache_size.0,
                Err(error) => failed = Some(error),
            },
            |_| {
                json!({
                    "mesh": "bowl", "triangles": triangles, "dictionary": dictionary.name(),
                    "light_deg": lights, "resolution_px": scene.camera.resolution_px,
                    "samples_per_pixel": options.cache.samples_per_cell,
                    "max_reflections": options.cache.max_reflections,
                    "kernel": options.kernel.to_string(),
                })
            },
        );
        for row in self.rows.iter_mut().filter(|row| row.name == name) {
            row.facts["records"] = records.into();
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// Incoherent bounces inside a bowl: closest hits and any hits, on one thread.
    fn rays(&mut self) -> Result<(), CliError> {
        if !self.wanted("rays/closest") && !self.wanted("rays/any") {
            return Ok(());
        }
        let mesh = bowl().mesh()?;
        let bvh = Bvh::new(&mesh);
        let rays = bounces(&mesh, 500_000);
        let mut hits = [0usize; 2];
        let triangles = mesh.triangles.len();
        let facts = |ms: f64| {
            json!({
                "mesh": "bowl", "triangles": triangles, "rays": rays.len(),
                "mrays_per_s": rays.len() as f64 / ms / 1e3,
            })
        };
        let repeat = self.args.repeat;
        self.case(
            "rays/closest",
            repeat,
            || hits[0] = rays.iter().filter(|r| bvh.closest(r).is_some()).count(),
            facts,
        );
        self.case(
            "rays/any",
            repeat,
            || hits[1] = rays.iter().filter(|r| bvh.any(r)).count(),
            facts,
        );
        std::hint::black_box(hits);
        Ok(())
    }
}

/// Image, gradient of its sum and every pixel's Jacobian; returns the mean radiance.
fn pass(cache: &Cache, kernel: Kernel, weights: &[f64]) -> f64 {
    let sums = cache.evaluate(
        kernel,
        &[weights],
        || (0.0f64, vec![0.0f64; weights.len()]),
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
    sums.iter().map(|s| s.0).sum::<f64>() / cache.cells as f64
}

fn bowl() -> Shape {
    Shape::Bowl {
        radius_mm: 1.0,
        segments: 200,
    }
}

/// Rays that leave the middles of random facets, cosine-distributed.
fn bounces(mesh: &Mesh, count: usize) -> Vec<Ray> {
    let mut numbers = stream(1, Purpose::Experiment, 0, 0, 0);
    (0..count)
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
                origin_mm: offset_origin((a + b + c) / 3.0, normal),
                direction: Vec3::normalize(direction),
                limit_mm: f32::INFINITY,
            }
        })
        .collect()
}

/// 64 × 64 pixels of 2.2 mm along −z, and lamps at (angle from the axis, azimuth) in degrees.
fn scene(mesh: Mesh, lights_deg: &[[f64; 2]]) -> Scene {
    let camera = Camera {
        resolution_px: [64, 64],
        projection: Projection::Orthographic {
            extent_mm: DVec2::splat(2.2),
        },
        lens: Lens::IDEAL,
        sample_from_camera: crate::frames::Rigid::new(
            glam::DQuat::from_rotation_x(std::f64::consts::PI),
            DVec3::new(0.0, 0.0, 5.0),
        ),
        focus_mm: 5.0,
        object_na: 0.0,
        point_spread_px: 0.0,
    };
    let lights = lights_deg
        .iter()
        .map(|[from_axis, azimuth]| {
            let (sin, cos) = from_axis.to_radians().sin_cos();
            let (sin_azimuth, cos_azimuth) = azimuth.to_radians().sin_cos();
            Light::Directional {
                to_light: DVec3::new(sin * cos_azimuth, sin * sin_azimuth, cos),
                irradiance: [1.0; 3],
                angular_radius_rad: 0.0,
            }
        })
        .collect();
    Scene::new(mesh, Shading::Flat, camera, lights)
}

/// CPU time of the whole process.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
