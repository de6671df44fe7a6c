//! Paths of two and more reflections, traced once and kept as records.
//!
//! Only reflections at the sample get a record. What known bodies reflect in between
//! is a constant: it is folded into the weight of the record before, so that
//! light which comes to the sample by way of a holder is a connection like any other.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use super::cell_footprints::Cells;
use super::continuation::{Continuations, PathMode, Steering};
use super::event::{Head, LaneAtoms, MAX_LIGHTS, Record};
use super::guide::Guide;
use super::points::{Sampler, SobolSampler};
use super::proposal::Proposal;
use super::scene::{Scene, Surface};
use crate::brdf::dictionary::Dictionary;
use crate::brdf::ggx::Cosines;
use crate::progress::Progress;
use crate::random::{Purpose, stream};

/// How paths are traced and kept.
#[derive(Clone, Debug)]
pub struct CacheOptions {
    /// Camera paths per cell, both halves together, at least 2.
    pub samples_per_cell: u32,
    /// Longest path in surface reflections, 2..=64.
    pub max_reflections: u32,
    /// Same seed, same paths.
    pub seed: u64,
    /// Where continuations go.
    pub proposal: Proposal,
    /// What leads them to light.
    pub steering: Steering,
    /// Fewer samples are traced if the records would take more than this.
    pub max_bytes: usize,
}

impl Default for CacheOptions {
    fn default() -> Self {
        Self {
            samples_per_cell: 160,
            max_reflections: 16,
            seed: 1,
            proposal: Proposal::default(),
            steering: Steering::default(),
            max_bytes: 512 << 20,
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
    /// More atoms that vary with the directions than the kernels take.
    #[error(
        "dictionary {name} has {atoms} atoms besides white and black; at most {limit} can be cached"
    )]
    TooManyAtoms {
        /// The dictionary.
        name: String,
        /// Its atoms that vary with the directions.
        atoms: usize,
        /// The limit.
        limit: usize,
    },
    /// A known body whose channels differ; the records' weights have one for all.
    #[error("body {body} is coloured; only grey bodies can stand next to a sample that is fitted")]
    ColouredBody {
        /// Index from 0.
        body: usize,
    },
}

/// Cells that are traced and evaluated together; fixed, so that sums are formed in
/// the same order for any number of threads.
pub const CHUNK_CELLS: usize = 32;

/// Records of consecutive cells. Each cell has two independent halves.
pub struct Chunk<const B: usize> {
    /// First cell.
    pub first_cell: usize,
    /// `records[start[2·p + h]..start[2·p + h + 1]]` is half h of the chunk's cell p.
    pub start: Vec<u32>,
    /// All records, path after path.
    pub records: Vec<Record<B>>,
}

/// Records by their number of blocks of eight atoms that vary with the directions.
pub enum Records {
    /// At most 8 atoms.
    Blocks1(Vec<Chunk<1>>),
    /// At most 16.
    Blocks2(Vec<Chunk<2>>),
    /// At most 24.
    Blocks3(Vec<Chunk<3>>),
    /// At most 40.
    Blocks5(Vec<Chunk<5>>),
    /// At most 64.
    Blocks8(Vec<Chunk<8>>),
}

/// Traced paths of a scene for a dictionary.
///
/// ```
/// # use glam::{DVec2, DVec3};
/// # use rig_core::geometry::Shape;
/// # use rig_core::transport::{Camera, Light, Scene, Shading};
/// # let camera = Camera::above([8, 8], DVec2::splat(16.0), 100.0);
/// # let light = Light::distant(DVec3::Z, [1.0; 3]);
/// # let bowl = Shape::Bowl { radius_mm: 10.0, segments: 32 }.mesh()?;
/// # let scene = Scene::new(bowl, Shading::Smooth, camera, vec![light]);
/// use rig_core::brdf::{Atom, Dictionary};
/// use rig_core::transport::{Cache, CacheOptions, Cells, Kernel};
///
/// let dictionary = Dictionary::new("greys", vec![Atom::Lambertian { albedo: 1.0 }, Atom::Black])?;
/// let cells = Cells::of_pixels(scene.camera.resolution_px);
/// let options = CacheOptions { samples_per_cell: 64, ..CacheOptions::default() };
/// let cache = Cache::trace(&scene, &cells, &dictionary, &options)?;
///
/// // Indirect light of all cells for an albedo, without tracing again.
/// let indirect = |albedo: f64| -> f32 {
///     let weights = [albedo, 1.0 - albedo];
///     let sums = cache.evaluate(Kernel::Portable, &[&weights], || 0.0, |sum, cell| {
///         *sum += 0.5 * (cell.value[0][0] + cell.value[1][0]);
///     });
///     sums.iter().sum()
/// };
/// // Light of two reflections grows with the square of the albedo, of more reflections faster.
/// assert!(indirect(0.8) > 4.0 * indirect(0.4));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Cache {
    /// The records.
    pub records: Arc<Records>,
    /// Lane layout of the dictionary.
    pub atoms: LaneAtoms,
    /// Camera paths per cell in each half.
    pub samples_per_half: u32,
    /// Lamps.
    pub lights: usize,
    /// Cells.
    pub cells: usize,
    /// Strength of each lamp per channel.
    pub strength: Vec<[f64; 3]>,
    /// Paths per cell that were requested; more than twice `samples_per_half` if
    /// memory did not suffice.
    pub samples_requested: u32,
}

impl Cache {
    /// Traces the scene's paths of 2 to `max_reflections` reflections whose first is at
    /// the sample.
    pub fn trace(
        scene: &Scene,
        cells: &Cells,
        dictionary: &Dictionary,
        options: &CacheOptions,
    ) -> Result<Self, CacheError> {
        let guide = options.steering.guide(scene, options.seed);
        Self::trace_guided(scene, cells, dictionary, options, guide, &())
    }

    /// [`Cache::trace`] with the guide that [`Steering::guide`] gave for the same scene;
    /// `progress` receives a [pulse](Progress::pulse) for each group of cells.
    pub fn trace_guided(
        scene: &Scene,
        cells: &Cells,
        dictionary: &Dictionary,
        options: &CacheOptions,
        guide: Option<Arc<Guide>>,
        progress: &dyn Progress,
    ) -> Result<Self, CacheError> {
        let lights = scene.lights.len();
        if lights > MAX_LIGHTS {
            return Err(CacheError::TooManyLights { lights });
        }
        if let Some(body) = scene.coloured_body() {
            return Err(CacheError::ColouredBody { body });
        }
        let atoms = LaneAtoms::new(dictionary);
        let tracer = Tracer {
            scene,
            cells,
            continuations: Continuations::new(&options.proposal, options.steering, guide),
            atoms: &atoms,
            options,
            progress,
        };
        macro_rules! traced {
            ($b:literal, $variant:path) => {{
                let (n, chunks) = tracer.chunks::<$b>();
                (n, $variant(chunks))
            }};
        }
        let (samples_per_half, records) = match atoms.blocks() {
            0 | 1 => traced!(1, Records::Blocks1),
            2 => traced!(2, Records::Blocks2),
            3 => traced!(3, Records::Blocks3),
            4 | 5 => traced!(5, Records::Blocks5),
            6..=8 => traced!(8, Records::Blocks8),
            blocks => {
                return Err(CacheError::TooManyAtoms {
                    name: dictionary.name().to_owned(),
                    atoms: blocks * 8,
                    limit: 64,
                });
            }
        };
        Ok(Self {
            records: Arc::new(records),
            atoms,
            samples_per_half,
            lights,
            cells: cells.len(),
            strength: scene.lights.iter().map(|l| l.strength()).collect(),
            samples_requested: options.samples_per_cell,
        })
    }

    /// The same paths for a dictionary of the first atoms of theirs.
    pub fn of_first(&self, dictionary: &Dictionary) -> Self {
        Self {
            // Atoms have their lanes in the order of the dictionary.
            atoms: LaneAtoms::new(dictionary),
            ..self.clone()
        }
    }

    /// Number of records and the bytes they take.
    pub fn size(&self) -> (usize, usize) {
        fn count<const B: usize>(chunks: &[Chunk<B>]) -> (usize, usize) {
            let records = chunks.iter().map(|c| c.records.len()).sum();
            (records, records * size_of::<Record<B>>())
        }
        match &*self.records {
            Records::Blocks1(c) => count(c),
            Records::Blocks2(c) => count(c),
            Records::Blocks3(c) => count(c),
            Records::Blocks5(c) => count(c),
            Records::Blocks8(c) => count(c),
        }
    }
}

/// What tracing a cell needs.
struct Tracer<'a> {
    scene: &'a Scene,
    cells: &'a Cells,
    continuations: Continuations<'a>,
    atoms: &'a LaneAtoms,
    options: &'a CacheOptions,
    progress: &'a dyn Progress,
}

/// The end of a path that is being traced, and its random numbers.
struct Walk {
    surface: Surface,
    to_viewer: Vec3,
    reflections: u32,
    mode: PathMode,
    numbers: SobolSampler,
}

impl Tracer<'_> {
    /// Traces all chunks with as many samples as fit into memory; returns the samples per half.
    fn chunks<const B: usize>(&self) -> (u32, Vec<Chunk<B>>) {
        let options = self.options;
        let mut per_half = (options.samples_per_cell / 2).max(1);
        let wanted = self.probe::<B>() * f64::from(per_half);
        // Aims a little below, as the estimate has an error.
        let room = 0.97 * options.max_bytes as f64;
        if wanted > room {
            per_half = ((f64::from(per_half) * room / wanted) as u32).max(1);
        }
        loop {
            match self.trace_all::<B>(per_half) {
                Some(chunks) => return (per_half, chunks),
                None => per_half -= per_half.div_ceil(16),
            }
        }
    }

    /// Bytes of records that one sample per half of every cell takes, from a few samples of
    /// cells spread over the image.
    fn probe<const B: usize>(&self) -> f64 {
        const PROBES: usize = 24 * 24;
        let count = self.cells.len();
        let probes = count.min(PROBES);
        let samples = (self.options.samples_per_cell / 2).clamp(1, 8);
        let records: usize = (0..probes)
            .into_par_iter()
            .map(|probe| {
                // A cell anywhere in a stretch, so that no pattern of the image is met in step.
                let key = probe as u64;
                let mut numbers = stream(self.options.seed, Purpose::Experiment, 0, key, 0);
                let at = (probe as f64 + numbers.uniform()) / probes as f64;
                let cell = ((at * count as f64) as usize).min(count - 1);
                let mut records: Vec<Record<B>> = Vec::new();
                self.half(cell, 0, samples, &mut records);
                records.len()
            })
            .sum();
        let probed = probes.max(1) as f64 * f64::from(samples);
        2.0 * (records * size_of::<Record<B>>()) as f64 * count as f64 / probed
    }

    /// Traces all chunks; `None` as soon as they take more memory than allowed (unless
    /// fewer samples are impossible).
    fn trace_all<const B: usize>(&self, per_half: u32) -> Option<Vec<Chunk<B>>> {
        let cells = self.cells.len();
        let limit = match per_half {
            1 => usize::MAX,
            _ => self.options.max_bytes,
        };
        let bytes = AtomicUsize::new(0);
        let starts: Vec<usize> = (0..cells).step_by(CHUNK_CELLS).collect();
        starts
            .into_par_iter()
            // Chunks differ in cost: a thread that is done takes the next.
            .with_max_len(1)
            .map(|first_cell| {
                self.progress.pulse();
                let mut chunk = Chunk {
                    first_cell,
                    start: vec![0],
                    records: Vec::new(),
                };
                for cell in first_cell..(first_cell + CHUNK_CELLS).min(cells) {
                    for half in 0..2 {
                        self.half(cell, half, per_half, &mut chunk.records);
                        chunk.start.push(chunk.records.len() as u32);
                    }
                }
                chunk.records.shrink_to_fit();
                let own = chunk.records.len() * size_of::<Record<B>>();
                // The sum passes the limit or not whatever the order: so do all threads agree.
                (bytes.fetch_add(own, Ordering::Relaxed) + own <= limit).then_some(chunk)
            })
            .collect()
    }

    /// Traces one half, 0 or 1, of a cell's paths.
    fn half<const B: usize>(
        &self,
        cell: usize,
        half: u32,
        samples: u32,
        records: &mut Vec<Record<B>>,
    ) {
        let (scene, atoms, options) = (self.scene, self.atoms, self.options);
        for sample in 0..samples {
            let (numbers, ray) =
                SobolSampler::begin_in(&scene.camera, self.cells, options.seed, cell, half, sample);
            let begin = records.len();
            // Up to here the path has contributed; records after it reach no lamp.
            let mut useful = begin;
            let Some((surface, to_viewer)) = scene.first(&ray).filter(|(hit, _)| hit.is_sample())
            else {
                continue;
            };
            let mut walk = Walk {
                surface,
                to_viewer,
                reflections: 1,
                mode: self.continuations.begin(),
                numbers,
            };
            // Continue the path; each reflection stores its continuation and its connections.
            while walk.reflections < options.max_reflections {
                walk.numbers.advance();
                let Some((direction, pdf)) = self.continuations.draw(
                    &mut walk.mode,
                    &walk.surface,
                    walk.to_viewer,
                    &mut walk.numbers,
                ) else {
                    break;
                };
                let Some(at) = Cosines::new(direction.to_array(), walk.to_viewer.to_array()) else {
                    break;
                };
                let Some(next) = scene.next(&walk.surface, direction) else {
                    break;
                };
                (walk.surface, walk.to_viewer) = next;
                walk.reflections += 1;
                // Known bodies in between are followed here and end up in the weight.
                let mut weight = direction.z / pdf;
                if !walk.surface.is_sample() {
                    let before = records.len();
                    let back = self.detour(&at, weight, &mut walk, records);
                    if records.len() > before {
                        useful = records.len();
                    }
                    let Some(weight_back) = back else { break };
                    weight = weight_back;
                }
                records.push(Record::encode(Head::continuation(weight), atoms, &at));
                for light in 0..scene.lights.len() {
                    let u = walk.numbers.on_lamp();
                    let Some(connection) = scene.connect(&walk.surface, light, u) else {
                        continue;
                    };
                    let to_light = connection.to_light.to_array();
                    if let Some(at) = Cosines::new(to_light, walk.to_viewer.to_array()) {
                        let head = Head::connection(connection.irradiance, light);
                        records.push(Record::encode(head, atoms, &at));
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

    /// Follows a walk that has come to a known body until it is back at the sample.
    /// Lamps that light those bodies become connections of the reflection `at`
    /// that led there with `weight`; returns the weight of its continuation to where the
    /// walk is back at the sample, `None` if it ends before.
    #[cold]
    fn detour<const B: usize>(
        &self,
        at: &Cosines<f32>,
        mut weight: f32,
        walk: &mut Walk,
        records: &mut Vec<Record<B>>,
    ) -> Option<f32> {
        let mut arriving = vec![0.0f32; self.scene.lights.len()];
        let mut follow = || {
            while let Some(brdf) = self.scene.known(&walk.surface) {
                for (light, arriving) in arriving.iter_mut().enumerate() {
                    let u = walk.numbers.on_lamp();
                    if let Some(to) = self.scene.connect(&walk.surface, light, u) {
                        let [f, ..] = brdf.eval(to.to_light, walk.to_viewer);
                        *arriving += weight * f * to.irradiance;
                    }
                }
                if walk.reflections >= self.options.max_reflections {
                    return None;
                }
                let proposal = &self.options.proposal;
                walk.numbers.advance();
                let (direction, pdf) = proposal.sample(walk.to_viewer, &mut walk.numbers)?;
                let [f, ..] = brdf.eval(direction, walk.to_viewer);
                weight *= f * direction.z / pdf;
                if weight == 0.0 {
                    return None;
                }
                (walk.surface, walk.to_viewer) = self.scene.next(&walk.surface, direction)?;
                walk.reflections += 1;
            }
            Some(weight)
        };
        let back = follow();
        for (light, &arrived) in arriving.iter().enumerate() {
            if arrived > 0.0 {
                let head = Head::connection(arrived, light);
                records.push(Record::encode(head, self.atoms, at));
            }
        }
        back
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Also where the image's width is what a regular pattern of probes would step by, and
    /// the first column shows nothing.
    #[test]
    fn memory_is_bounded() {
        for resolution in [[64, 64], [256, 32], [16, 100]] {
            let scene = Scene::bowl(16, resolution, 2.4);
            let options = CacheOptions {
                samples_per_cell: 1024,
                max_reflections: 4,
                max_bytes: 4 << 20,
                ..CacheOptions::default()
            };
            let cache = Cache::trace(
                &scene,
                &Cells::of_pixels(scene.camera.resolution_px),
                &Dictionary::rig26(),
                &options,
            )
            .unwrap();
            let (_, bytes) = cache.size();
            assert!(cache.samples_per_half < 512, "{resolution:?}");
            assert!(bytes <= options.max_bytes, "{resolution:?}: {bytes}");
            assert!(
                5 * bytes >= 4 * options.max_bytes,
                "{resolution:?}: {bytes}"
            );
        }
    }
}
