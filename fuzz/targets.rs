//! What is fuzzed: every parser that reads bytes from a device or a file. Used by
//! the fuzzing programs in `fuzz_targets/` and by `tests/fuzz_corpus/main.rs`, which
//! replays the corpus.
//!
//! A target fails where the parser panics, or where it allocates more than its
//! input can account for: a size that is only declared must not be believed.

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// One parser.
pub struct Target {
    /// Of the program and of the folder in `corpus/`.
    pub name: &'static str,
    parse: fn(&[u8]),
    /// Bytes of memory that a byte of the input may cost: what a byte of a text
    /// becomes, or what the format's compression makes of it.
    memory_per_byte: usize,
    /// Bytes that any input may cost: tables, buffers, messages.
    memory_at_least: usize,
}

/// Deflate makes up to 1032 bytes of one; 16-bit counts come to a frame of u16,
/// halves of an image to several f32 planes and their sum.
const DEFLATE: usize = 1032;

const fn target(name: &'static str, parse: fn(&[u8]), memory_per_byte: usize) -> Target {
    Target {
        name,
        parse,
        memory_per_byte,
        memory_at_least: ANY,
    }
}

/// The image whole and in rows: where the one can be read, so can the others.
fn exr_rows(bytes: &[u8]) {
    use rig::radiance_image::exr;
    let path = Path::new("image.exr");
    let rows = || -> Result<usize, exr::ExrError> {
        let mut rows = exr::ExrRows::of_bytes(bytes, path, None)?;
        let mut height = 0;
        loop {
            match rows.next_rows(5)?.height {
                0 => return Ok(height),
                more => height += more,
            }
        }
    };
    match (exr::decode(bytes, path), rows()) {
        (Ok(file), Ok(height)) => assert_eq!(file.image.height, height),
        (Err(_), Err(_)) => (),
        (whole, rows) => panic!(
            "whole: {:?}, rows: {rows:?}",
            whole.map(|file| file.has_variance)
        ),
    }
}

/// What a TIFF's tag may take, whose values are read before the reader can be given a limit.
const BEFORE_TIFF_LIMITS: usize = 256 << 20;

/// The TIFF reader opens the first image of a BigTIFF, and with it tags of up to 1 MiB, each value
/// of which takes some 32 bytes, whatever the file's size.
const BIG_TIFF_TAGS: usize = 64 << 20;

/// All of them.
pub const TARGETS: &[Target] = &[
    target(
        "grbl",
        |bytes| drop(rig::device::grbl::protocol::parse(bytes)),
        64,
    ),
    target(
        "zaber",
        |bytes| drop(rig::device::zaber::protocol::parse(bytes)),
        64,
    ),
    target(
        "dmx_widget",
        |bytes| {
            use rig::device::dome::widget::{serial_number, take_message, version};
            let mut received = bytes.to_vec();
            while let Some((_, data)) = take_message(&mut received) {
                drop((version(&data), serial_number(&data)));
            }
        },
        64,
    ),
    target(
        "rig_file",
        |bytes| {
            text(bytes, |text| {
                drop(rig::config::RigConfig::parse(
                    "rig.toml",
                    Path::new(""),
                    text,
                ))
            });
        },
        4096,
    ),
    target(
        "scene_file",
        |bytes| {
            text(bytes, |text| {
                drop(rig::config::scene::SceneFile::parse(
                    "scene.toml",
                    Path::new(""),
                    text,
                ))
            });
        },
        4096,
    ),
    target(
        "session_record",
        |bytes| {
            text(bytes, |text| {
                drop(toml::from_str::<rig::session::SessionRecord>(text))
            });
        },
        4096,
    ),
    target(
        "validation",
        |bytes| {
            drop(rig::session::validation::parse(
                Path::new("validation.json"),
                bytes,
            ))
        },
        64,
    ),
    target(
        "sidecar",
        |bytes| {
            text(bytes, |text| {
                drop(toml::from_str::<rig::session::Sidecar>(text))
            });
        },
        4096,
    ),
    target(
        "bracket_table",
        |bytes| {
            let text = rig::outside_text::decode_any(bytes);
            drop(rig::radiometry::bracket_table::parse_bracket_table(&text));
            let _ = rig::radiometry::frame_exposure::from_name(&text);
            drop(rig::outside_text::decode(bytes.to_vec()));
        },
        1024,
    ),
    target(
        "journal",
        |bytes| drop(rig::session::Journal::parse(bytes)),
        256,
    ),
    target("queue", queue, 4096),
    target("sample_table", sample_table, 256),
    target("batch", batch, 4096),
    target(
        "camera_program",
        |bytes| {
            use rig::device::{command_camera::answer::parse, gphoto2::output};
            let text = String::from_utf8_lossy(bytes);
            drop((
                parse(&text),
                output::parse_detected(&text),
                output::parse_settings(&text),
            ));
        },
        256,
    ),
    target(
        "session_archive",
        |bytes| drop(rig::session::archive::check_bytes(bytes)),
        256,
    ),
    target("exr", exr_rows, 64 * DEFLATE),
    target(
        "png",
        |bytes| drop(rig::radiometry::frame_file::decode(bytes)),
        8 * DEFLATE,
    ),
    target(
        "frame_png",
        |bytes| drop(rig::session::frame::decode_png(bytes)),
        8 * DEFLATE,
    ),
    target(
        "ply",
        |bytes| {
            drop(rig::geometry::ply::parse(
                bytes,
                &rig::geometry::Placement::default(),
            ))
        },
        512,
    ),
    target(
        "obj",
        |bytes| {
            drop(rig::geometry::obj::parse(
                bytes,
                &rig::geometry::Placement::default(),
            ))
        },
        512,
    ),
    target(
        "stl",
        |bytes| {
            drop(rig::geometry::stl::parse(
                bytes,
                &rig::geometry::Placement::default(),
            ))
        },
        512,
    ),
    Target {
        name: "picture",
        parse: |bytes| {
            use rig::radiometry::frame_file::{decode, picture};
            drop((decode(bytes), picture(bytes, Some([8, 4]))));
        },
        memory_per_byte: 8 * DEFLATE,
        memory_at_least: BEFORE_TIFF_LIMITS,
    },
    Target {
        name: "exif",
        parse: |bytes| {
            let _ = rig::radiometry::frame_exposure::CameraNote::read(bytes).exposure_s();
        },
        memory_per_byte: 256,
        memory_at_least: BIG_TIFF_TAGS,
    },
    target(
        "pixel_map",
        |bytes| {
            let map = rig::calibration::record::MapFile {
                file: "map.png".into(),
                sha256: String::new(),
            };
            let map = rig::calibration::pixel_map::PixelMap {
                lowest: 0.0,
                per_count: 1.0,
                map,
            };
            drop((map.read(bytes, [8, 4]), map.read(bytes, [64, 64])));
        },
        8 * DEFLATE,
    ),
    target("record", record, 4096),
    target("environment", environment, 64 * DEFLATE),
    target(
        "weights",
        |bytes| {
            let atoms = vec![
                rig::brdf::Atom::Ggx {
                    alpha: 0.3,
                    eta: 3.0,
                },
                rig::brdf::Atom::Lambertian { albedo: 1.0 },
            ];
            if let Ok(dictionary) = rig::brdf::Dictionary::new("two", atoms) {
                text(bytes, |text| {
                    drop(rig::brdf::weights::parse(text, &dictionary))
                });
            }
        },
        256,
    ),
    target(
        "dictionary",
        |bytes| {
            text(bytes, |text| {
                let parse = |json| rig::brdf::Dictionary::parse("fuzzed", text, json);
                drop((parse(true), parse(false)));
            });
        },
        4096,
    ),
    target(
        "angles",
        |bytes| text(bytes, |text| drop(rig::material::parse_angles(text))),
        256,
    ),
    target("fit_folder", fit_folder, 4096),
    target("merl", |bytes| drop(rig::brdf::merl::parse(bytes)), 64),
    target(
        "rgl",
        |bytes| drop(rig::brdf::rgl::RglBrdf::parse(bytes)),
        256,
    ),
];

/// As a record of every kind, under the id that the text begins with.
fn record(bytes: &[u8]) {
    use rig::calibration::record::{
        FlatValues, LampValues, LightsValues, ResponseValues, ScaleValues, SensorValues,
    };
    use rig::calibration::{camera, directions, glare, parse_record, pose, slanted_edge};
    let text = String::from_utf8_lossy(bytes);
    let id = text
        .split("id = \"")
        .nth(1)
        .and_then(|rest| rest.split('"').next());
    let id = id.unwrap_or_default();
    macro_rules! each {
        ($($values:ty),*) => { $( drop(parse_record::<$values>(bytes, id, "record")); )* };
    }
    each!(
        SensorValues,
        FlatValues,
        ScaleValues,
        LightsValues,
        ResponseValues,
        LampValues
    );
    each!(directions::DirectionsValues, pose::PoseValues);
    each!(
        slanted_edge::FocusValues,
        camera::CameraValues,
        glare::GlareValues
    );
}

fn environment(bytes: &[u8]) {
    drop(rig::brdf::environment::EnvironmentMap::parse("map", bytes));
}

/// The files of a fit, one after the other, each ended by a line of two hyphens.
fn fit_folder(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let files: Vec<&str> = text.split("\n--\n").collect();
    drop(rig::session::fit_record::parse(
        Path::new("fit"),
        |_, name| {
            let names = [
                "fit.toml",
                "weights.csv",
                "table.csv",
                "discrepancy.csv",
                "trace.csv",
            ];
            let file = names.iter().position(|known| *known == name);
            let file = file.and_then(|file| files.get(file)).unwrap_or(&"");
            Ok(file.as_bytes().to_vec())
        },
    ));
}

/// A file of samples and the journal of what was done of it, with a line of two hyphens between.
fn queue(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let (samples, journal) = text.split_once("\n--\n").unwrap_or((&text, ""));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("day.toml");
    let written = std::fs::write(&file, samples);
    let written =
        written.and_then(|()| std::fs::write(folder.path().join("day.queue.jsonl"), journal));
    written.expect("a temporary file");
    if let Ok(queue) = rig::queue::Queue::open(&file, folder.path()) {
        drop(queue.step());
    }
}

/// A table of samples; the list that is made of it can be read.
fn sample_table(bytes: &[u8]) {
    text(bytes, |table| {
        if let Ok(list) = rig::queue::list_of_table(table, true) {
            toml::from_str::<toml::Table>(&list).expect("a list");
        }
    });
}

/// The jobs of a batch and a list of sessions, with a line of two hyphens between. Jobs of another
/// version are read as if they were of this one.
fn batch(bytes: &[u8]) {
    use rig::batch::{Batch, BatchError, JOBS_FILE, NewBatch};
    let text = String::from_utf8_lossy(bytes);
    let (jobs, list) = text.split_once("\n--\n").unwrap_or((&text, ""));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let parse = |_: &[String]| Ok(rig::workflow::FitRequest::default());
    let open = |jobs: &str| {
        std::fs::write(folder.path().join(JOBS_FILE), jobs).expect("a temporary file");
        Batch::open(folder.path(), &parse)
    };
    if let Err(BatchError::OtherVersion { then, now, .. }) = open(jobs) {
        drop(open(&jobs.replacen(&then, &now, 1)));
    }
    let file = folder.path().join("list.toml");
    std::fs::write(&file, list).expect("a temporary file");
    let new = NewBatch {
        list: Some(&file),
        ..NewBatch::default()
    };
    drop(Batch::make(&folder.path().join("new"), &new, &parse));
}

fn text(bytes: &[u8], parse: impl FnOnce(&str)) {
    if let Ok(text) = str::from_utf8(bytes) {
        parse(text);
    }
}

/// What any parser may need: tables, buffers, messages.
const ANY: usize = 4 << 20;

/// Parses; panics where the parser does, or where it needed more memory than
/// the input can account for.
pub fn run(name: &str, bytes: &[u8]) {
    let target = TARGETS.iter().find(|target| target.name == name);
    let target = target.unwrap_or_else(|| panic!("no target {name}"));
    let allowed = target.memory_at_least + target.memory_per_byte * bytes.len();
    check(name, allowed, bytes, target.parse);
}

/// The most bytes that are allocated at a time while `work` is done, beyond those before.
pub fn peak_bytes(work: impl FnOnce()) -> usize {
    // One at a time: the meter counts for the whole process.
    static TURN: Mutex<()> = Mutex::new(());
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let before = LIVE.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    work();
    PEAK.load(Ordering::Relaxed).saturating_sub(before)
}

/// Parses and counts.
pub fn check(name: &str, allowed: usize, bytes: &[u8], parse: impl FnOnce(&[u8])) {
    let used = peak_bytes(|| parse(bytes));
    assert!(
        used <= allowed,
        "{name}: {used} bytes of memory for an input of {}",
        bytes.len()
    );
}

/// Counts what is allocated.
struct Meter;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

#[global_allocator]
static METER: Meter = Meter;

fn grown(bytes: usize) {
    let live = LIVE.fetch_add(bytes, Ordering::Relaxed) + bytes;
    PEAK.fetch_max(live, Ordering::Relaxed);
}

// SAFETY: every call is the system allocator's own.
unsafe impl GlobalAlloc for Meter {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        grown(size);
        unsafe { System.realloc(at, layout, size) }
    }
}
