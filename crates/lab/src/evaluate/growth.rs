//! Time and memory of a fit by the size of its images, cells, paths, lights and threads: the program
//! itself is run on images of each size, so that reading counts and memory is its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use glam::{DVec2, DVec3};
use serde::Serialize;

use super::experiment::{EvaluateError, Row, Table};
use crate::brdf::source;
use crate::geometry::Shape;
use crate::plot::{Axis, Chart, Figure, Mark, Series, charts};
use crate::radiance_image::{RadianceImage, exr};
use crate::random::{Purpose, stream};
use crate::transport::{Camera, Light, RenderOptions, Scene, Shading, render, suited_proposal};
use crate::whole_file;

/// Sizes of the images, pixels. The largest is what a Bayer sensor of 20 MP merges to.
const SIZES: [[usize; 2]; 4] = [[64, 48], [640, 480], [1280, 1024], [2736, 1824]];

/// The size at which everything else is varied.
const USUAL: [usize; 2] = SIZES[1];

/// Pixels of the render that all sizes are sampled from.
const RENDERED: [usize; 2] = [320, 240];

/// Field of view and radius of the bowl, mm.
const EXTENT_MM: [f64; 2] = [29.3, 22.0];
const RADIUS_MM: f32 = 10.0;

/// Directions to the lights.
const TO_LIGHT: [[f64; 3]; 4] = [
    [0.0, 0.0, 1.0],
    [0.5, 0.0, 0.87],
    [-0.25, 0.43, 0.87],
    [-0.25, -0.43, 0.87],
];

/// Standard deviation of a pixel's noise, relative, and as part of the image's mean.
const NOISE: [f64; 2] = [0.005, 2e-4];

/// A fit that is run.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Case {
    /// What is varied: `pixels`, `cells`, `paths`, `lights`, `threads` or `bench`.
    pub varied: &'static str,
    /// Width and height of the images, pixels.
    pub resolution_px: [usize; 2],
    /// Images.
    pub lights: usize,
    /// Most cells, as requested.
    pub cells: usize,
    /// Paths per cell.
    pub paths: u32,
    /// Threads.
    pub threads: usize,
    /// Whether the bench is refined.
    pub refined: bool,
}

/// Time and memory of a fit.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Cost {
    /// The fit.
    #[serde(flatten)]
    pub case: Case,
    /// Processor time of the program, s.
    pub cpu_s: f64,
    /// From its start to its end, s.
    pub wall_s: f64,
    /// Its peak memory, MB.
    pub memory_mb: f64,
}

fn cases(threads: usize) -> Vec<Case> {
    let defaults = crate::transport::CacheOptions::default();
    let usual = Case {
        varied: "pixels",
        resolution_px: USUAL,
        lights: 4,
        cells: crate::cells::DEFAULT_CELLS,
        paths: defaults.samples_per_cell,
        threads,
        refined: false,
    };
    let mut cases: Vec<Case> = SIZES
        .map(|resolution_px| Case {
            resolution_px,
            ..usual
        })
        .to_vec();
    let varied = |varied| Case { varied, ..usual };
    cases.extend([600, 1200, 5000, 10_000].map(|cells| Case {
        cells,
        ..varied("cells")
    }));
    cases.extend([40, 80, 320, 640].map(|paths| Case {
        paths,
        ..varied("paths")
    }));
    cases.extend([1, 2].map(|lights| Case {
        lights,
        ..varied("lights")
    }));
    let others = (0..).map(|k| 1 << k).take_while(|&n| n < threads);
    cases.extend(others.map(|threads| Case {
        threads,
        ..varied("threads")
    }));
    cases.push(Case {
        refined: true,
        ..varied("bench")
    });
    cases
}

/// What [`run`] found.
#[derive(Debug)]
pub struct Growth {
    /// Every fit.
    pub costs: Vec<Cost>,
    /// The figure, a PNG.
    pub figure: PathBuf,
}

/// Runs this program for every case, on all cores, and leaves `growth.csv`, `growth.svg` and
/// `growth.png` in `folder`, which is made if it is missing and holds a temporary folder of
/// images meanwhile; `note` is given each case's name as it begins.
///
/// # Errors
/// A file that cannot be written, or a fit that fails, with its error.
pub fn run(folder: &Path, note: &dyn Fn(&str)) -> Result<Growth, EvaluateError> {
    let io = |path: &Path| EvaluateError::io(path.to_owned());
    fs::create_dir_all(folder).map_err(io(folder))?;
    let program = std::env::current_exe().map_err(io(Path::new("this program")))?;
    let images = whole_file::Part::folder(&folder.join("images")).map_err(io(folder))?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let costs = measure(&program, images.path(), threads, note)?;
    let figure = figure(&costs);
    let csv = to_csv(&costs);
    for (name, bytes) in [
        ("growth.csv", csv.as_bytes()),
        ("growth.svg", figure.svg()?.as_bytes()),
        ("growth.png", &figure.png()?),
    ] {
        let path = folder.join(name);
        whole_file::replace(&path, |out| out.write_all(bytes)).map_err(io(&path))?;
    }
    Ok(Growth {
        costs,
        figure: folder.join("growth.png"),
    })
}

/// Runs `program` (rig itself) for every case, with up to `threads` threads, in `folder`, which
/// holds some 200 MB of images meanwhile; `note` is given each case's name as it begins.
///
/// # Errors
/// A file that cannot be written, or a fit that fails, with its error.
fn measure(
    program: &Path,
    folder: &Path,
    threads: usize,
    note: &dyn Fn(&str),
) -> Result<Vec<Cost>, EvaluateError> {
    note("render");
    let rendered = rendered()?;
    let mut costs = Vec::new();
    let mut written = None;
    for case in cases(threads) {
        if written != Some(case.resolution_px) {
            for (light, image) in rendered.iter().enumerate() {
                let path = folder.join(image_name(light));
                exr::write(&path, &noisy(image, case.resolution_px, light))
                    .map_err(|error| EvaluateError::Fact(error.to_string()))?;
            }
            written = Some(case.resolution_px);
        }
        let [width, height] = case.resolution_px;
        note(&format!("{}: {width} × {height}", case.varied));
        costs.push(case.run(program, folder)?);
    }
    Ok(costs)
}

fn image_name(light: usize) -> String {
    format!("light-{light}.exr")
}

/// The images without noise.
fn rendered() -> Result<Vec<RadianceImage>, EvaluateError> {
    let mesh = Shape::Bowl {
        radius_mm: RADIUS_MM,
        segments: 192,
    };
    let camera = Camera::above(RENDERED, DVec2::from(EXTENT_MM), 200.0);
    let lights = TO_LIGHT.map(|to_light| Light::distant(DVec3::from(to_light), [1.0; 3]));
    let scene = Scene::new(mesh.mesh()?, Shading::Smooth, camera, lights.to_vec());
    let brdf = source::load("nbrdf:dark-red-paint")?;
    let mut options = RenderOptions {
        samples_per_pixel: 32,
        max_reflections: 16,
        ..RenderOptions::default()
    };
    options.proposal = suited_proposal(&scene, brdf.as_ref(), &options);
    Ok(render(&scene, brdf.as_ref(), &options))
}

/// The image at another size, without interpolation, with noise.
fn noisy(image: &RadianceImage, [width, height]: [usize; 2], light: usize) -> RadianceImage {
    let mut noisy = RadianceImage::new(width, height);
    let sum: f64 = image.mean.iter().map(|value| f64::from(value[1])).sum();
    let floor = NOISE[1] * sum / image.mean.len() as f64;
    for pixel in 0..width * height {
        let [x, y] = [pixel % width, pixel / width];
        let from = (y * image.height / height) * image.width + x * image.width / width;
        let mut numbers = stream(1, Purpose::Experiment, light as u64, pixel as u64, 0);
        for c in 0..3 {
            let value = f64::from(image.mean[from][c]);
            let deviation = (NOISE[0] * value).hypot(floor);
            noisy.mean[pixel][c] = (value + deviation * numbers.normal()) as f32;
            noisy.variance[pixel][c] = (deviation * deviation) as f32;
        }
    }
    noisy
}

impl Case {
    fn scene(&self) -> String {
        let [width, height] = self.resolution_px;
        let spread = 0.7 * width as f64 / USUAL[0] as f64;
        let mut text = format!(
            "[camera]\nmodel = \"orthographic\"\nresolution_px = [{width}, {height}]\n\
             extent_mm = {EXTENT_MM:?}\npoint_spread_px = {spread}\n\
             position_mm = [0.0, 0.0, 200.0]\n\n[sample]\nshading = \"smooth\"\n\
             shape = {{ kind = \"bowl\", radius_mm = {RADIUS_MM:?}, segments = 192 }}\n"
        );
        for to_light in &TO_LIGHT[..self.lights] {
            text += &format!(
                "\n[[light]]\nkind = \"directional\"\nto_light = {to_light:?}\nirradiance = 1.0\n"
            );
        }
        text
    }

    fn run(&self, program: &Path, folder: &Path) -> Result<Cost, EvaluateError> {
        let io = |path: PathBuf| EvaluateError::io(path);
        let scene = folder.join("scene.toml");
        fs::write(&scene, self.scene()).map_err(io(scene.clone()))?;
        let out = folder.join("fit");
        if out.exists() {
            fs::remove_dir_all(&out).map_err(io(out.clone()))?;
        }
        let said = folder.join("said.txt");
        let stderr = fs::File::create(&said).map_err(io(said.clone()))?;
        let mut command = Command::new(program);
        command
            .current_dir(folder)
            .args(["fit", "--scene", "scene.toml", "--out", "fit", "--image"])
            .args((0..self.lights).map(image_name))
            .args(["--cells", &self.cells.to_string()])
            .args(["--spp", &self.paths.to_string()])
            .args(self.refined.then_some("--refine-bench"))
            .env("RAYON_NUM_THREADS", self.threads.to_string())
            .stdout(Stdio::null())
            .stderr(stderr);

        let (cpu_s, begun) = (cpu_of_ended_children_s(), Instant::now());
        let mut child = command.spawn().map_err(io(program.to_owned()))?;
        let status = PathBuf::from(format!("/proc/{}/status", child.id()));
        let mut memory_mb: f64 = 0.0;
        let ended = loop {
            memory_mb = memory_mb.max(peak_memory_mb(&status).unwrap_or(0.0));
            match child.try_wait().map_err(io(program.to_owned()))? {
                Some(ended) => break ended,
                None => std::thread::sleep(Duration::from_millis(10)),
            }
        };
        let wall_s = begun.elapsed().as_secs_f64();
        if !ended.success() {
            let said = fs::read_to_string(&said).unwrap_or_default();
            let line = said.lines().find(|line| line.starts_with("error: "));
            return Err(EvaluateError::Fact(format!(
                "the fit of {} at {:?} pixels ended with {ended}: {}",
                self.varied,
                self.resolution_px,
                line.unwrap_or("it gave no reason")
            )));
        }
        Ok(Cost {
            case: *self,
            cpu_s: cpu_of_ended_children_s() - cpu_s,
            wall_s,
            memory_mb,
        })
    }
}

/// Processor time of all children that have been waited for, s (`proc(5)`, cutime and cstime).
fn cpu_of_ended_children_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name before may hold spaces and ends with the last bracket.
    let fields = stat.rsplit_once(") ").map_or("", |(_, fields)| fields);
    let ticks: u64 = fields
        .split(' ')
        .skip(13)
        .take(2)
        .filter_map(|field| field.parse::<u64>().ok())
        .sum();
    ticks as f64 / rustix::param::clock_ticks_per_second() as f64
}

/// Peak memory of a process so far, MB (`proc(5)`, `VmHWM` in KiB).
fn peak_memory_mb(status: &Path) -> Option<f64> {
    let status = fs::read_to_string(status).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib * 1024.0 / 1e6)
}

/// A line per case under a header; times in s, memory in MB.
fn to_csv(costs: &[Cost]) -> String {
    let row = |cost: &Cost| {
        let case = &cost.case;
        Row::new()
            .with("varied", case.varied)
            .with("width_px", case.resolution_px[0])
            .with("height_px", case.resolution_px[1])
            .with("lights", case.lights)
            .with("cells", case.cells)
            .with("paths", case.paths)
            .with("threads", case.threads)
            .with("refined", case.refined.to_string())
            .with("cpu_s", format!("{:.2}", cost.cpu_s))
            .with("wall_s", format!("{:.2}", cost.wall_s))
            .with("memory_mb", format!("{:.0}", cost.memory_mb))
    };
    let rows = costs.iter().map(row).collect();
    Table { rows }.to_csv()
}

/// Processor time and memory over pixels, cells, paths and lights, each on logarithmic axes.
fn figure(costs: &[Cost]) -> Figure {
    let usual = costs.iter().find(|cost| cost.case.resolution_px == USUAL);
    let mut panels = Vec::new();
    for (varied, label) in [
        ("pixels", "pixels of an image"),
        ("cells", "cells at most"),
        ("paths", "paths per cell"),
        ("lights", "lights"),
    ] {
        let mut chosen: Vec<&Cost> = costs
            .iter()
            .filter(|cost| cost.case.varied == varied)
            .collect();
        if varied != "pixels" {
            chosen.extend(usual);
        }
        let x = |cost: &Cost| match varied {
            "pixels" => cost.case.resolution_px.iter().product::<usize>() as f64,
            "cells" => cost.case.cells as f64,
            "paths" => f64::from(cost.case.paths),
            _ => cost.case.lights as f64,
        };
        chosen.sort_by(|a, b| x(a).total_cmp(&x(b)));
        let line = |label, color, value: &dyn Fn(&Cost) -> f64| {
            let points = chosen
                .iter()
                .map(|cost| [x(cost).log10(), value(cost).log10()]);
            Series::new(label, color, Mark::Points, points.collect())
        };
        let range = match (chosen.first(), chosen.last()) {
            (Some(first), Some(last)) => x(first).log10().floor()..x(last).log10().ceil(),
            _ => 0.0..1.0,
        };
        panels.push(Chart {
            title: String::new(),
            x: Axis::decades(range, label),
            y: Axis::decades(0.0..2.0, "s, 10 MB"),
            series: vec![
                line("processor time, s", 0, &|cost| cost.cpu_s),
                line("memory, 10 MB", 1, &|cost| cost.memory_mb / 10.0),
            ],
        });
    }
    charts("growth", 2, &panels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_as_large_as_its_variance_says() {
        let mut image = RadianceImage::new(2, 2);
        image.mean = vec![[1.0; 3]; 4];
        let noisy = noisy(&image, [100, 80], 0);
        let chi2: f64 = noisy
            .mean
            .iter()
            .zip(&noisy.variance)
            .map(|(mean, variance)| f64::from((mean[0] - 1.0).powi(2) / variance[0]))
            .sum();
        let count = noisy.mean.len() as f64;
        // Five deviations of a mean of 8000 squares.
        assert!(
            (chi2 / count - 1.0).abs() < 5.0 * (2.0 / count).sqrt(),
            "{}",
            chi2 / count
        );
    }

    #[test]
    fn memory_and_childrens_time_of_a_process_are_read() {
        let memory_mb = peak_memory_mb(Path::new("/proc/self/status")).unwrap();
        assert!((1.0..1e5).contains(&memory_mb), "{memory_mb}");
        let before = cpu_of_ended_children_s();
        let busy = "i=0; while [ $i -lt 100000 ]; do i=$((i+1)); done";
        Command::new("sh").args(["-c", busy]).status().unwrap();
        assert!(cpu_of_ended_children_s() > before);
    }

    #[test]
    fn every_case_is_one_change_of_the_usual_fit() {
        for case in cases(2) {
            let changes = [
                case.resolution_px != USUAL,
                case.cells != crate::cells::DEFAULT_CELLS,
                case.lights != 4,
                case.threads != 2,
                case.refined,
            ];
            assert!(changes.iter().filter(|&&changed| changed).count() <= 1);
            assert!(case.scene().contains("resolution_px"));
        }
    }
}
