//! Replays the corpus of the fuzzing programs (`fuzz/README.md`): inputs that
//! between them reach what fuzzing has found, and every input that ever broke a
//! parser. Alone in its process, because memory is counted.

#[path = "../../fuzz/targets.rs"]
mod targets;

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::{DVec2, DVec3};
use rig::brdf::{Atom, Dictionary, Mixture};
use rig::capture::{BracketSink, RadianceSink};
use rig::cells::Captured;
use rig::device::{CameraSettings, FrameKey, FrameKind, LampChannel, LampState, Mosaic, RawFrame};
use rig::geometry::Shape;
use rig::inverse::memory::Size;
use rig::inverse::{FitOptions, fit};
use rig::radiance_image::exr;
use rig::radiometry::sensor::SensorNoise;
use rig::random::{Purpose, Stream, stream};
use rig::report::CapturedInput;
use rig::session::Sidecar;
use rig::transport::{Camera, Light, RenderOptions, Scene, Shading, render};
use rig::units::Seconds;

/// One test at a time: what another allocates would count as well.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The inputs of a target, in the order of their names.
fn inputs(name: &str) -> Vec<Vec<u8>> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let entries = std::fs::read_dir(corpus.join(name)).unwrap().flatten();
    let mut paths: Vec<_> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "{name} has no input");
    paths
        .iter()
        .map(|path| std::fs::read(path).unwrap())
        .collect()
}

#[test]
fn no_input_breaks_a_parser() {
    let _turn = alone();
    let mut total_bytes = 0;
    for target in targets::TARGETS {
        for bytes in inputs(target.name) {
            targets::run(target.name, &bytes);
            // Cut off anywhere, it is an input as well.
            for part in 1..8 {
                targets::run(target.name, &bytes[..bytes.len() * part / 8]);
            }
            total_bytes += bytes.len();
        }
    }
    assert!(total_bytes < 1 << 20, "the corpus has {total_bytes} bytes");
}

/// `bytes` changed in one to four places, as memory and lines break them and as
/// somebody would who means harm.
fn broken(bytes: &[u8], random: &mut Stream) -> Vec<u8> {
    const ODD: [&[u8]; 8] = [
        b"\0",
        b"\xff",
        b"\xff\xff\xff\x7f",
        b"\x7f\xff\xff\xff",
        b"\xff\xff\xff\xff\xff\xff\xff\xff",
        b"-1",
        b"99999999999999999999",
        b"1e400",
    ];
    let mut bytes = bytes.to_vec();
    let mut below = |limit: usize| (random.uniform() * limit as f64) as usize;
    for _ in 0..=below(4) {
        let at = below(bytes.len() + 1);
        let end = (at + 1 + below(16)).min(bytes.len());
        match below(6) {
            0 if at < bytes.len() => bytes[at] ^= 1 << below(8),
            1 => bytes.truncate(at),
            2 => drop(bytes.drain(at..end.max(at))),
            3 => {
                let piece = bytes[at..end.max(at)].repeat(1 + below(8));
                bytes.splice(at..at, piece);
            }
            4 => drop(bytes.splice(at..at, ODD[below(8)].iter().copied())),
            _ => {
                let odd = ODD[below(8)];
                let end = (at + odd.len()).min(bytes.len());
                bytes.splice(at..end.max(at), odd.iter().copied());
            }
        }
    }
    bytes
}

/// Every input of the corpus, broken at random: `RIG_FUZZ_RUNS` times each.
#[test]
fn no_broken_input_breaks_a_parser() {
    let _turn = alone();
    let runs: u64 = std::env::var("RIG_FUZZ_RUNS").map_or(100, |text| text.parse().unwrap());
    for (number, target) in targets::TARGETS.iter().enumerate() {
        let began = std::time::Instant::now();
        let mut tried = 0;
        for (input, bytes) in inputs(target.name).iter().enumerate() {
            for run in 0..runs {
                let purpose = Purpose::Experiment;
                let mut random = stream(3, purpose, number as u64, input as u64, run);
                let bytes = broken(bytes, &mut random);
                let outcome = std::panic::catch_unwind(|| targets::run(target.name, &bytes));
                if outcome.is_err() {
                    let file = std::env::temp_dir().join(format!("{}-{run}", target.name));
                    std::fs::write(&file, &bytes).unwrap();
                    panic!("{}: {} breaks it", target.name, file.display());
                }
                tried += 1;
            }
        }
        println!("{}: {tried} inputs in {:?}", target.name, began.elapsed());
    }
}

/// A bowl under `lights` lamps around it.
fn bowl(side: usize, lights: usize) -> Scene {
    let camera = Camera::above([side; 2], DVec2::splat(2.2), 5.0);
    let light = |number: usize| {
        let (sin, cos) = (2.0 * number as f64).sin_cos();
        Light::distant(DVec3::new(0.5 * cos, 0.5 * sin, 1.0), [1.0; 3])
    };
    let shape = Shape::Bowl {
        radius_mm: 1.0,
        segments: 32,
    };
    let lights = (0..lights).map(light).collect();
    Scene::new(shape.mesh().unwrap(), Shading::Smooth, camera, lights)
}

/// Bytes that a fit with the fewest paths allocates at most at a time, and what is estimated.
fn memory_of_a_fit(side: usize, lights: usize, dictionary: &Dictionary) -> [f64; 2] {
    let scene = bowl(side, lights);
    let atom = Atom::Ggx {
        alpha: 0.25,
        eta: 2.0,
    };
    let material = Dictionary::new("material", vec![atom]).unwrap();
    let material = Mixture::grey(material.into(), vec![1.0]).unwrap();
    let how = RenderOptions {
        samples_per_pixel: 32,
        ..RenderOptions::default()
    };
    let captured = render(&scene, &material, &how);
    let mut options = FitOptions::default();
    options.cache.samples_per_cell = 2;
    let counted = targets::peak_bytes(|| {
        let images = Captured::of_pixels(&captured, |_| true);
        drop(fit(&scene, &images, dictionary, &options).unwrap());
    });
    let size = Size {
        cells: side * side,
        lights,
        atoms: dictionary.len(),
        bench_parameters: 0,
    };
    let estimated = size.values_bytes() + size.least_paths_bytes();
    [counted as f64, estimated as f64]
}

/// Refused is what would not fit, and not much more.
#[test]
fn the_memory_of_a_fit_is_estimated_from_above_and_closely() {
    let _turn = alone();
    let dictionaries = [
        Dictionary::rig26(),
        Dictionary::paper42(),
        Dictionary::rig65(),
    ];
    for (lights, dictionary) in [1, 3, 2].into_iter().zip(dictionaries) {
        let [small, large] = [24, 48].map(|side| memory_of_a_fit(side, lights, &dictionary));
        println!(
            "{lights} lights, {}: {small:?} and {large:?} bytes, counted and estimated",
            dictionary.name()
        );
        // What does not grow with the images belongs to the program.
        let [counted, estimated] = [0, 1].map(|k| large[k] - small[k]);
        let part = counted / estimated;
        assert!((0.3..1.0).contains(&part), "{}: {part}", dictionary.name());
    }
}

/// A raw frame of `size`, with noise, and how it was taken.
fn raw_frame(size: [usize; 2], kind: FrameKind, exposure_s: f64) -> (RawFrame, Sidecar) {
    let [width, height] = size;
    let counts = (0..width * height).map(|pixel| {
        let scattered = (pixel as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 58;
        let lit = 1e5 * (1.0 + (pixel % width) as f64 / width as f64) * exposure_s;
        let signal = if kind == FrameKind::Light { lit } else { 0.0 };
        (64.0 + signal + 0.3 * scattered as f64).min(4095.0) as u16
    });
    let frame = RawFrame::new(width as u32, height as u32, counts.collect());
    let settings = CameraSettings::new(Seconds(exposure_s), 1.0);
    let key = FrameKey::new(0, 0, 0, kind);
    let lamp = match kind {
        FrameKind::Light => LampState::On(LampChannel(0)),
        _ => LampState::Off,
    };
    let sidecar = Sidecar {
        mosaic: Mosaic::Rggb,
        ..Sidecar::of_frame(key, lamp, settings)
    };
    (frame, sidecar)
}

/// Merging takes a band, reading by rows a row of blocks, a report one merged image, however
/// large the sensor. A sixteenth of 20 MP; all of it with `RIG_LARGE=1`.
#[test]
fn a_large_sensor_takes_little_memory() {
    let _turn = alone();
    let parts = if std::env::var_os("RIG_LARGE").is_some() {
        1
    } else {
        4
    };
    let size = [5472 / parts, 3648 / parts];
    let pixels = size[0] * size[1];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("merged.exr");
    let megabytes = |name: &str, work: &mut dyn FnMut()| {
        let used = targets::peak_bytes(work) as f64 / 1e6;
        println!("{name}: {used:.0} MB for {:.1} MP", pixels as f64 / 1e6);
        used
    };

    let merging = megabytes("merging", &mut || {
        let noise = SensorNoise::ideal(0.5, 2.0, 64.0, 12);
        let mosaic = Mosaic::Rggb;
        let all: &[usize] = &[0, 1, 2];
        let home = folder.path().to_owned();
        let mut sink = RadianceSink::new(Arc::new(noise), mosaic, vec![all], home);
        sink.begin(0).unwrap();
        for exposure_s in [0.001, 0.004, 0.016] {
            for kind in [FrameKind::Light, FrameKind::Ambient, FrameKind::Dark] {
                let (frame, sidecar) = raw_frame(size, kind, exposure_s);
                sink.add(&frame, &sidecar).unwrap();
            }
        }
        std::fs::write(&path, sink.finish().unwrap()).unwrap();
    });
    // A band, one raw frame, and the file that is made.
    let file = std::fs::metadata(&path).unwrap().len() as f64 / 1e6;
    let frame = 2e-6 * pixels as f64;
    assert!(merging < 300.0 + frame + 3.0 * file, "{merging} MB");

    let rows = megabytes("rows", &mut || {
        let mut rows = exr::ExrRows::open(&path, None).unwrap();
        while rows.next_rows(16).unwrap().height > 0 {}
    });
    assert!(rows < 20.0, "{rows} MB");

    let report = megabytes("report", &mut || {
        let image = exr::read(&path).unwrap().image;
        let shown = CapturedInput::of(&image);
        assert!(shown.picture.width <= 512 && shown.picture.height <= 512);
        assert_eq!(shown.size_px, size.map(|n| n / 2));
    });
    // 25 bytes of a merged pixel while vectors grow, and its values sorted.
    assert!(report < 30.0 + 75e-6 * pixels as f64 / 4.0, "{report} MB");
}

/// The meter sees a size that is believed.
#[test]
#[should_panic(expected = "bytes of memory")]
fn a_declared_size_that_is_believed_is_noticed() {
    let _turn = alone();
    targets::check("a parser that believes", 8 << 20, b"1000000000", |bytes| {
        let declared: usize = str::from_utf8(bytes).unwrap().parse().unwrap();
        drop(std::hint::black_box(Vec::<u8>::with_capacity(declared)));
    });
}
