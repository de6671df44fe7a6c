//! Replays the corpus of the fuzzing programs (`fuzz/README.md`): inputs that
//! between them reach what fuzzing has found, and every input that ever broke a
//! parser. Alone in its process, because memory is counted.

#[path = "../fuzz/targets.rs"]
mod targets;

use std::path::Path;

#[test]
fn no_input_breaks_a_parser() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let mut total_bytes = 0;
    for target in targets::TARGETS {
        let folder = corpus.join(target.name);
        let mut inputs = 0;
        for entry in std::fs::read_dir(&folder).unwrap().flatten() {
            let bytes = std::fs::read(entry.path()).unwrap();
            println!("{}", entry.path().display());
            targets::run(target.name, &bytes);
            // Cut off anywhere, it is an input as well.
            for part in 1..8 {
                targets::run(target.name, &bytes[..bytes.len() * part / 8]);
            }
            total_bytes += bytes.len();
            inputs += 1;
        }
        assert!(inputs > 0, "{} has no input", folder.display());
    }
    assert!(total_bytes < 1 << 20, "the corpus has {total_bytes} bytes");
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
