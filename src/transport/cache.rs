//! Paths of two and more reflections, traced once and kept as records.

use glam::DVec2;
use rayon::prelude::*;

use super::event::{GeneralRecord, GridRecord, Head, LaneAtoms, MAX_LIGHTS, Record};
use super::proposal::Proposal;
use super::scene::Scene;
use crate::brdf::dictionary::Dictionary;
use crate::brdf::ggx::Cosines;
use crate::random::{Purpose, stream};

/// How paths are traced and kept.
#[derive(Clone, Debug)]
pub struct CacheOptions {
    /// Camera paths per pixel, both halves together, at least 2.
    pub samples_per_pixel: u32,
    /// Longest path in surface reflections, 2..=64.
    pub max_reflections: u32,
    /// Same seed, same paths.
    pub seed: u64,
    /// Where continuations go.
    pub proposal: Proposal,
    /// Fewer samples are traced if the records would take more than this.
    pub max_bytes: usize,
    /// Use the separable records where the dictionary is a grid.
    pub allow_grid: bool,
}

impl Default for CacheOptions {
    fn default() -> Self {
        Self {
            samples_per_pixel: 256,
            max_reflections: 16,
            seed: 1,
            proposal: Proposal::default(),
            max_bytes: 512 << 20,
            allow_grid: true,
        }
    }
}

/// Why paths cannot be cached.
#[derive(Debug, thiserror::Error)]
pub enum CacheError {
    /// More lamps than a record can name.
    #[error("{lights} lights; at most {MAX_LIGHTS} can be fitted together")]
    TooManyLights {
        /// Lamps of the scene.
        lights: usize,
    },
    /// More GGX atoms than the kernels take.
    #[error("dictionary {name} has {atoms} GGX atoms; at most {limit} can be cached")]
    TooManyAtoms {
        /// The dictionary.
        name: String,
        /// Its GGX atoms.
        atoms: usize,
        /// The limit.
        limit: usize,
    },
}

/// Pixels that are traced and evaluated together; fixed, so that sums are formed in
/// the same order for any number of threads.
pub const CHUNK_PIXELS: usize = 32;

/// Records of consecutive pixels. Each pixel has two independent halves.
pub struct Chunk<R> {
    /// First pixel.
    pub first_pixel: usize,
    /// `records[start[2·p + h]..start[2·p + h + 1]]` is half h of the chunk's pixel p.
    pub start: Vec<u32>,
    /// All records, path after path.
    pub records: Vec<R>,
}

/// Records by layout; general ones by their number of blocks.
pub enum Records {
    /// Separable.
    Grid(Vec<Chunk<GridRecord>>),
    /// At most 8 GGX atoms.
    General1(Vec<Chunk<GeneralRecord<1>>>),
    /// At most 16.
    General2(Vec<Chunk<GeneralRecord<2>>>),
    /// At most 24.
    General3(Vec<Chunk<GeneralRecord<3>>>),
    /// At most 40.
    General5(Vec<Chunk<GeneralRecord<5>>>),
    /// At most 64.
    General8(Vec<Chunk<GeneralRecord<8>>>),
}

/// Traced paths of a scene for a dictionary.
pub struct Cache {
    /// The records.
    pub records: Records,
    /// Lane layout of the dictionary.
    pub atoms: LaneAtoms,
    /// Camera paths per pixel in each half.
    pub samples_per_half: u32,
    /// Lamps.
    pub lights: usize,
    /// Pixels.
    pub pixels: usize,
    /// Strength of each lamp per channel.
    pub strength: Vec<[f64; 3]>,
    /// Paths per pixel that were asked for; more than twice `samples_per_half` if
    /// memory did not suffice.
    pub samples_requested: u32,
}

impl Cache {
    /// Traces the scene's paths of 2 to `max_reflections` reflections.
    pub fn trace(
        scene: &Scene,
        dictionary: &Dictionary,
        options: &CacheOptions,
    ) -> Result<Self, CacheError> {
        let lights = scene.lights.len();
        if lights > MAX_LIGHTS {
            return Err(CacheError::TooManyLights { lights });
        }
        let atoms = LaneAtoms::new(dictionary, options.allow_grid);
        let (samples_per_half, records) = if atoms.is_grid() {
            let (n, chunks) = trace_chunks::<5, GridRecord>(scene, &atoms, options);
            (n, Records::Grid(chunks))
        } else {
            macro_rules! general {
                ($b:literal, $variant:path) => {{
                    let (n, chunks) = trace_chunks::<$b, GeneralRecord<$b>>(scene, &atoms, options);
                    (n, $variant(chunks))
                }};
            }
            match atoms.blocks() {
                0 | 1 => general!(1, Records::General1),
                2 => general!(2, Records::General2),
                3 => general!(3, Records::General3),
                4 | 5 => general!(5, Records::General5),
                6..=8 => general!(8, Records::General8),
                blocks => {
                    return Err(CacheError::TooManyAtoms {
                        name: dictionary.name().to_owned(),
                        atoms: blocks * 8,
                        limit: 64,
                    });
                }
            }
        };
        Ok(Self {
            records,
            atoms,
            samples_per_half,
            lights,
            pixels: scene.camera.pixels(),
            strength: scene.lights.iter().map(|l| l.strength()).collect(),
            samples_requested: options.samples_per_pixel,
        })
    }

    /// Number of records and the bytes they take.
    pub fn size(&self) -> (usize, usize) {
        fn count<R>(chunks: &[Chunk<R>]) -> (usize, usize) {
            let records = chunks.iter().map(|c| c.records.len()).sum();
            (records, records * size_of::<R>())
        }
        match &self.records {
            Records::Grid(c) => count(c),
            Records::General1(c) => count(c),
            Records::General2(c) => count(c),
            Records::General3(c) => count(c),
            Records::General5(c) => count(c),
            Records::General8(c) => count(c),
        }
    }
}

/// Traces all chunks with as many samples as fit into memory; returns the samples per half.
fn trace_chunks<const B: usize, R: Record<B>>(
    scene: &Scene,
    atoms: &LaneAtoms,
    options: &CacheOptions,
) -> (u32, Vec<Chunk<R>>) {
    let pixels = scene.camera.pixels();
    let starts: Vec<usize> = (0..pixels).step_by(CHUNK_PIXELS).collect();
    let mut per_half = (options.samples_per_pixel / 2).max(1);
    // A spread of pixels at a few samples tells what the whole will take.
    let probe = per_half.min(16);
    let probed: usize = (0..pixels)
        .step_by((pixels / 256).max(1))
        .collect::<Vec<_>>()
        .par_iter()
        .map(|&pixel| {
            let mut records: Vec<R> = Vec::new();
            trace_pixel(scene, atoms, options, pixel, 0..probe, &mut records);
            records.len()
        })
        .sum();
    let probed_pixels = pixels.div_ceil((pixels / 256).max(1));
    let per_sample =
        probed as f64 * size_of::<R>() as f64 / f64::from(probe) / probed_pixels as f64;
    let wanted = per_sample * pixels as f64 * 2.0 * f64::from(per_half);
    if wanted > options.max_bytes as f64 {
        per_half = ((f64::from(per_half) * options.max_bytes as f64 / wanted) as u32).max(1);
    }
    let chunks = starts
        .into_par_iter()
        .map(|first_pixel| {
            let mut chunk = Chunk {
                first_pixel,
                start: vec![0],
                records: Vec::new(),
            };
            for pixel in first_pixel..(first_pixel + CHUNK_PIXELS).min(pixels) {
                for half in 0..2 {
                    let samples = half * per_half..(half + 1) * per_half;
                    trace_pixel(scene, atoms, options, pixel, samples, &mut chunk.records);
                    chunk.start.push(chunk.records.len() as u32);
                }
            }
            chunk.records.shrink_to_fit();
            chunk
        })
        .collect();
    (per_half, chunks)
}

fn trace_pixel<const B: usize, R: Record<B>>(
    scene: &Scene,
    atoms: &LaneAtoms,
    options: &CacheOptions,
    pixel: usize,
    samples: std::ops::Range<u32>,
    records: &mut Vec<R>,
) {
    let width = scene.camera.resolution_px[0];
    let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
    for sample in samples {
        let key = |purpose| stream(options.seed, purpose, 0, pixel as u64, u64::from(sample));
        let mut position = key(Purpose::PixelPosition);
        let mut directions = key(Purpose::PathDirection);
        let mut lamps = key(Purpose::LightAndLens);
        let ray = scene.camera.ray(
            corner + DVec2::new(position.uniform(), position.uniform()),
            DVec2::new(lamps.uniform(), lamps.uniform()),
        );
        let begin = records.len();
        // Up to here the path has contributed; records after it lead nowhere.
        let mut useful = begin;
        let Some((mut surface, mut to_viewer)) = scene.first(&ray) else {
            continue;
        };
        for _ in 1..options.max_reflections {
            let Some((direction, pdf)) = options.proposal.sample(to_viewer, &mut directions) else {
                break;
            };
            let Some(at) = Cosines::new(direction.to_array(), to_viewer.to_array()) else {
                break;
            };
            let Some(next) = scene.next(&surface, direction) else {
                break;
            };
            records.push(R::encode(Head::continuation(direction.z / pdf), atoms, &at));
            (surface, to_viewer) = next;
            for light in 0..scene.lights.len() {
                let u = [lamps.uniform_f32(), lamps.uniform_f32()];
                let Some(connection) = scene.connect(&surface, light, u) else {
                    continue;
                };
                let to_light = connection.to_light.to_array();
                if let Some(at) = Cosines::new(to_light, to_viewer.to_array()) {
                    records.push(R::encode(
                        Head::connection(connection.irradiance, light),
                        atoms,
                        &at,
                    ));
                    useful = records.len();
                }
            }
        }
        records.truncate(useful);
        if let Some(first) = records.get_mut(begin) {
            first.mark_first();
        }
    }
}
