//! Replays the corpus of the fuzzing programs (`fuzz/README.md`): inputs that
//! between them reach what fuzzing has found, and every input that ever broke a
//! parser. Alone in its process, because memory is counted.

#[path = "../fuzz/targets.rs"]
mod targets;

use std::path::Path;

use rig::random::{Purpose, Stream, stream};

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

/// The meter sees a size that is believed.
#[test]
#[should_panic(expected = "bytes of memory")]
fn a_declared_size_that_is_believed_is_noticed() {
    targets::check("a parser that believes", 64, b"1000000000", |bytes| {
        let declared: usize = str::from_utf8(bytes).unwrap().parse().unwrap();
        drop(std::hint::black_box(Vec::<u8>::with_capacity(declared)));
    });
}
