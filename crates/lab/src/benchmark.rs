//! How fast the inner loops are on this machine: ray queries, tracing, evaluating, and a
//! whole fit.

use std::sync::Arc;
use std::time::Instant;

use glam::{DVec2, DVec3, Vec3};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;
use serde_json::{Value, json};

use crate::bench_priors::BenchPriors;
use crate::brdf::{BrdfError, Dictionary, Mixture};
use crate::cells::{Captured, CellOptions};
use crate::geometry::bvh::offset_origin;
use crate::geometry::{Bvh, Mesh, MeshError, Ray, Shape};
use crate::inverse::{FitError, FitOptions, fit};
use crate::random::{Purpose, stream};
use crate::transport::cache::CacheError;
use crate::transport::{
    Cache, CacheOptions, Camera, Cells, DirectMatrix, Kernel, Light, Proposal, RenderOptions,
    Scene, Shading, render,
};

/// Why nothing was measured.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum BenchmarkError {
    /// The threads could not be started.
    #[error("{threads} threads: {source}")]
    Threads {
        threads: usize,
        source: rayon::ThreadPoolBuildError,
    },
    #[error("no case's name holds \"{only}\"")]
    NoCase { only: String },
    /// The case's mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The case's dictionary.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// The case's paths.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// The case's fit.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct BenchmarkRequest {
    /// Numbers of threads, 1..=256 each; they take turns and show how the work scales.
    pub threads: Vec<usize>,
    /// Repetitions of each case, 1..=1000; short cases take ten times as many.
    pub repeat: u64,
    /// Only cases whose name contains this; empty for all.
    pub only: String,
}

impl BenchmarkRequest {
    /// Repetitions unless others are asked for.
    pub const REPEAT: u64 = 5;
}

impl Default for BenchmarkRequest {
    fn default() -> Self {
        Self {
            threads: vec![1],
            repeat: Self::REPEAT,
            only: String::new(),
        }
    }
}

/// A case at one number of threads.
#[derive(Clone, Debug, Serialize)]
pub struct BenchmarkRow {
    /// The case.
    pub name: String,
    /// Threads.
    pub threads: usize,
    /// Least processor time, ms.
    pub cpu_ms_min: f64,
    /// Median processor time, ms.
    pub cpu_ms_median: f64,
    /// Least time, ms.
    pub wall_ms_min: f64,
    /// Median time, ms.
    pub wall_ms_median: f64,
    /// Median wall time with the first number of threads over this one's.
    pub speedup: f64,
    /// What was measured: sizes, dictionary, kernel, rates.
    #[serde(flatten)]
    pub facts: Value,
}

/// Measures; `progress` is given the name of each case as it begins.
///
/// # Errors
/// Threads that cannot be started, or no case that is wanted.
pub fn benchmark(
    request: &BenchmarkRequest,
    progress: &dyn Fn(&str),
) -> Result<Vec<BenchmarkRow>, BenchmarkError> {
    let pool = |&threads: &usize| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build();
        pool.map_err(|source| BenchmarkError::Threads { threads, source })
    };
    let mut cases = Benchmark {
        pools: request.threads.iter().map(pool).collect::<Result<_, _>>()?,
        request,
        progress,
        rows: Vec::new(),
    };
    cases.rays()?;
    cases.paths()?;
    let lights = [[0.0, 0.0], [30.0, 0.0], [30.0, 120.0], [30.0, 240.0]];
    cases.fit("fit/four-lights", &lights)?;
    cases.fit("fit/one-light", &lights[1..2])?;
    match cases.rows.is_empty() {
        true => Err(BenchmarkError::NoCase {
            only: request.only.clone(),
        }),
        false => Ok(cases.rows),
    }
}

/// A benchmark in progress.
struct Benchmark<'a> {
    pools: Vec<ThreadPool>,
    request: &'a BenchmarkRequest,
    progress: &'a dyn Fn(&str),
    rows: Vec<BenchmarkRow>,
}

impl Benchmark<'_> {
    fn wanted(&self, name: &str) -> bool {
        name.contains(&self.request.only)
    }

    /// Measures `work` with every number of threads, in turns so that a change of the
    /// machine's load affects all of them; `facts` is given the median CPU milliseconds.
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
        (self.progress)(name);
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
            self.rows.push(BenchmarkRow {
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
    fn paths(&mut self) -> Result<(), BenchmarkError> {
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
            let of_kernel = |kernel| format!("{evaluate}/{kernel}");
            let passes = Kernel::available().iter().map(of_kernel);
            if !passes
                .chain([trace.clone(), direct.clone()])
                .any(|name| self.wanted(&name))
            {
                continue;
            }
            // The scene and its paths.
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
            // Tracing, direct light, and a pass over the paths.
            let repeat = self.request.repeat;
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
            let weights = vec![1.0 / dictionary.len() as f64; dictionary.len()];
            for &kernel in Kernel::available() {
                let pass = || pass(&cache, kernel, &weights);
                let facts = |ms: f64| {
                    let mut facts = facts.clone();
                    facts["kernel"] = kernel.to_string().into();
                    facts["mean_radiance"] = pass().into();
                    facts["ns_per_record"] = (1e6 * ms / records as f64).into();
                    facts
                };
                // A fit takes the fastest.
                let case = match kernel == Kernel::detect() {
                    true => evaluate.clone(),
                    false => format!("{evaluate}/{kernel}"),
                };
                self.case(&case, 10 * repeat, || mean = pass(), facts);
            }
            std::hint::black_box(mean);
        }
        Ok(())
    }

    /// A fit of three channels to so many images with the defaults, tracing included.
    fn fit(&mut self, name: &str, lights: &[[f64; 2]]) -> Result<(), BenchmarkError> {
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
            self.request.repeat.min(3),
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
        failed.map_or(Ok(()), |error: FitError| Err(error.into()))
    }

    /// Incoherent bounces inside a bowl: closest hits and any hits, on one thread.
    fn rays(&mut self) -> Result<(), BenchmarkError> {
        let names = ["rays/build", "rays/closest", "rays/any"];
        if !names.iter().any(|name| self.wanted(name)) {
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
        let repeat = self.request.repeat;
        let build = || drop(std::hint::black_box(Bvh::new(&mesh)));
        self.case(
            "rays/build",
            repeat,
            build,
            |_| json!({ "mesh": "bowl", "triangles": triangles }),
        );
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
    let camera = Camera::above([64, 64], DVec2::splat(2.2), 5.0);
    let lights = lights_deg
        .iter()
        .map(|[from_axis, azimuth]| {
            let (sin, cos) = from_axis.to_radians().sin_cos();
            let (sin_azimuth, cos_azimuth) = azimuth.to_radians().sin_cos();
            Light::distant(
                DVec3::new(sin * cos_azimuth, sin * sin_azimuth, cos),
                [1.0; 3],
            )
        })
        .collect();
    Scene::new(mesh, Shading::Flat, camera, lights)
}

/// CPU time of the whole process.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
