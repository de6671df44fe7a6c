//! Every piece of advice of `src/cli/hints.rs` is reached by a test that runs the program.
//!
//! A row is a text of that source. A test reaches it by quoting a part that no other row
//! has: as the `hint` of a case of `tests/outside`, which compares it with the hint alone,
//! or in a test program that runs it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// A part of each row that no run of the program reaches in a test, and why.
const ELSEWHERE: &str = r#"
# What only hardware, or another user's, says; the errors themselves are made by the
# drivers' own tests.
`rig devices` shows which users may open it | a device file of another user
copy the session's folder itself | names that no session of this program has
name the first node of the camera | a camera with a metadata node
name the rig with --rig, RIG_CONFIG | a bench that is connected
end the other program that has the camera | a camera on the network that another program controls
lists what the camera has: resolution_px must be there | a webcam without such frames
which sees the mark of damaged frames | a kernel that hands damaged frames over
raw counts need an uncompressed format | a camera without raw formats
plug it into a port of another USB controller | a USB bus that is full
give the camera a network interface of its own | a GigE Vision camera whose packets are lost
check the cable, and that nothing else shares | a camera whose driver marks frames
check the cable and the USB hub's power | a cable that is pulled while no lamp is lit
see what the kernel reports (`dmesg`) | a driver of the kernel that fails
update the firmware of the device with Zaber | a Zaber device before firmware 6
its file system is not mounted `noexec` | a mount
it may still move, and its lamp be lit | a stop that a stage does not confirm, with the console's unit tests
correct camera.resolution_px in the rig file | a camera with frames of another size
`mesh`, `table` and `weights` in the rig file | a file that goes away while a capture is prepared
spreads the lights evenly | a bench with a coloured body
before a capture, `rig capture --lights best:N` | a session that was never fitted
correct camera.mosaic or camera.format | a camera with other colour filters
build it with the feature `serial` | a program built without it
build it with the feature `v4l` | a program built without it
build it with `cargo build --locked --release --features | a program built without it
# What a simulated bench meets in `tests/captures/run.rs` and `tests/captures/camera_faults.rs`, by
# the library: minutes of a capture each.
let the lamp warm up | a lamp that drifts
let it cool down | a sensor that is hot
resume once more, which homes the stage again | a stage that homes elsewhere
connect the camera that the session was begun with | two cameras
raise camera.settings_latency_frames | a camera that ignores its settings
check the lamp's power and cable, the lens cap | a dark lamp
a camera that ignores its exposure does the same | a lamp that is too bright
lower capture.shortest_ms in the rig file | a lamp that is too bright
nothing that was journalled is lost; free some space | a disk that fills meanwhile
the session was changed since it was captured | frames of another plan
paint it grey or black | a rig with a coloured body
# Kept for what the command line refuses or says itself before.
run it again with --verbose | an error without advice, of which none is known
ask for at least one light | refused as an argument
`rig capture --resume SESSION` captures the rest | `rig fit` names the session itself
makes one; without --fit the newest is taken | `rig report` says so itself
start a new session, or `rig capture --resume` this one | a defect
`rig capture --resume SESSION` continues it | the command names the session itself
or the limits in the rig file's [stage] table | a stage that reaches nothing
`rig fit SESSION` makes a fit that is journalled | a fit copied into a session
`rig session verify` lists every damaged file | a report of a damaged sidecar
the fit was changed by hand or damaged | a fit that was edited
# Calibration records: `crates/setup/src/calibration` and `tests/commands/calibrate.rs`.
the permissions of the calibration folder | a folder that cannot be read
correct the id in the rig file's [calibration] table | a record that is gone
or name a record that belongs to them | a record of another camera
give the new record another id | two records of one second
# Lenses that views of a board do not determine: `crates/setup/src/calibration/camera`.
add views with the board in the corners | a board in the middle alone
tilt the board by 20 to 40 degrees | boards of one tilt
the board must be flat and stand still | a board that is not flat
use fewer terms: --distortion radial | a lens that folds the image
name with --datum a view in which the whole board | a datum that shows a part of the board
`rig session verify` says whether the session is whole | a session of no image
# Fits: `rig fit` on a machine, or with a session, that no test makes.
free some memory or use a larger machine | a machine with too little memory
, or compare fewer cells | a fit that is too large for the memory allowed
`--kernel auto` takes the fastest that it has | a processor without AVX2
takes what is missing and merges the raw frames again | a session whose merged images are gone
# Batches.
would do; `--fit "--memory MIB"` bounds each fit | more fits at a time than the machine has memory for
# Images and scenes.
the equations of the fit hold no finite numbers | values near the largest
give an image of this camera | a pixel map of another size
images need the channels R, G, B | `tests/commands/outside_input.rs`
copy it again, or render or merge it again | `tests/commands/outside_input.rs`
the scene's resolution_px must be | `tests/commands/bad_input.rs`
the sample is too small in the image, or its pose | a pose that is not known
check that the scene's camera and sample are those | a sample between its edges
give image and irradiance in one unit | `tests/commands/nonsense.rs`
the file is no text: rig files and scenes | `tests/commands/bad_input.rs`
reduce it (in MeshLab: Simplification) | a mesh of hundreds of millions of facets
fit the sessions anew with one version | fits of another version: `crates/bench/src/catalogue/reproducibility.rs`
name one with --materials | `tests/commands/evaluate.rs`
"#;

/// A shorter quotation might be there by accident.
const SHORTEST_QUOTATION: usize = 8;
/// A shorter text is no advice.
const SHORTEST_ROW: usize = 20;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn files(folder: &str, ending: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(folder)).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths
        .filter(|path| path.extension().is_some_and(|is| is == ending))
        .collect()
}

/// The texts between double quotes, as the compiler reads them; comments have none.
fn literals(source: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = source;
    while let Some(c) = rest.chars().next() {
        if rest.starts_with("//") {
            rest = rest.split_once('\n').map_or("", |(_, after)| after);
        } else if let Some(after) = ["'\"'", "'\\\"'"].iter().find_map(|q| rest.strip_prefix(q)) {
            rest = after;
        } else if let Some(raw) = rest.strip_prefix("r#\"") {
            let (text, after) = raw.split_once("\"#").unwrap_or((raw, ""));
            found.push(text.to_owned());
            rest = after;
        } else if c == '"' {
            let (text, after) = literal(&rest[1..]);
            found.push(text);
            rest = after;
        } else {
            rest = &rest[c.len_utf8()..];
        }
    }
    found
}

/// The text up to its closing quote, and what comes after that.
fn literal(source: &str) -> (String, &str) {
    let mut text = String::new();
    let mut chars = source.chars();
    while let Some(c) = chars.next() {
        match c {
            '"' => break,
            '\\' => match chars.next() {
                Some('\n') => {
                    let after = chars.as_str().trim_start();
                    chars = after.chars();
                }
                Some('n') => text.push('\n'),
                Some(c) => text.push(c),
                None => break,
            },
            c => text.push(c),
        }
    }
    (text, chars.as_str())
}

/// What is fixed in a row: the parts between its placeholders.
fn fixed_parts(row: &str) -> Vec<&str> {
    row.split(['{', '}']).step_by(2).collect()
}

fn rows() -> BTreeSet<String> {
    let mut sources = files("src/cli/hints", "rs");
    sources.push(root().join("src/cli/hints.rs"));
    let of_file = |path: PathBuf| {
        let source = fs::read_to_string(path).unwrap();
        literals(source.split("#[cfg(test)]").next().unwrap())
    };
    let rows = sources.into_iter().flat_map(of_file);
    rows.filter(|row| row.len() >= SHORTEST_ROW && row.contains(' '))
        .collect()
}

fn quotations() -> BTreeSet<String> {
    let mut quoted = BTreeSet::new();
    for topic in fs::read_dir(root().join("tests/outside")).unwrap() {
        let topic = topic.unwrap().path();
        let cases = fs::read_dir(&topic).into_iter().flatten();
        for case in cases.map(|case| case.unwrap().path().join("case.toml")) {
            let Ok(text) = fs::read_to_string(&case) else {
                continue;
            };
            let case: toml::Value = toml::from_str(&text).unwrap();
            let runs = case["run"].as_array().unwrap();
            let hints = runs.iter().filter_map(|run| run.get("hint")?.as_str());
            quoted.extend(hints.map(str::to_owned));
        }
    }
    let programs = ["captures", "commands", "console", "devices", "physics"];
    let tests = programs.map(|program| files(&format!("tests/{program}"), "rs"));
    for file in tests.concat() {
        let source = fs::read_to_string(&file).unwrap();
        let runs_it = ["CARGO_BIN_EXE_rig", "cargo_bin(\"rig\")", "command_support"];
        if runs_it.iter().any(|mark| source.contains(mark)) {
            // A table has a case on each line. Names of keys and options are no phrases.
            for text in literals(&source) {
                let table = Some(text.as_str()).filter(|text| text.contains(" | "));
                let cells = table.into_iter().flat_map(|text| text.split(['|', '\n']));
                let phrases = [text.as_str()].into_iter().chain(cells.map(str::trim));
                quoted.extend(phrases.filter(|text| text.contains(' ')).map(str::to_owned));
            }
        }
    }
    quoted.retain(|text| text.len() >= SHORTEST_QUOTATION);
    quoted
}

/// Whether a quotation is a part of what is fixed in a row, or all of it with its
/// placeholders filled in.
fn is_of(quoted: &str, row: &str) -> bool {
    let parts = fixed_parts(row);
    if parts.iter().any(|part| part.contains(quoted)) {
        return true;
    }
    let mut rest = quoted;
    let is_filled_in = parts.iter().all(|part| match rest.find(part) {
        Some(at) => {
            rest = &rest[at + part.len()..];
            true
        }
        None => false,
    });
    // A placeholder at the end takes all that is left.
    let is_whole = rest.is_empty() || parts.last().is_some_and(|part| part.is_empty());
    is_filled_in && is_whole && quoted.starts_with(parts[0])
}

#[test]
fn every_hint_is_reached_by_a_test_that_runs_the_program() {
    let rows = rows();
    let quoted = quotations();
    assert!(rows.len() > 100 && quoted.len() > 100);
    let of_one: BTreeSet<&String> = quoted
        .iter()
        .filter_map(|text| {
            if let Some(row) = rows.get(text) {
                return Some(row);
            }
            let mut of = rows.iter().filter(|row| is_of(text, row));
            of.next().filter(|_| of.next().is_none())
        })
        .collect();
    let excuses = |row: &String| {
        // A part that is a whole row is for that row alone.
        let is_for = |part: &str| row == part || row.contains(part) && !rows.contains(part);
        let elsewhere = ELSEWHERE.lines().filter_map(|line| line.split_once(" | "));
        elsewhere.filter(|(part, _)| is_for(part)).count()
    };
    let is_missing = |row: &&String| !of_one.contains(row) && excuses(row) == 0;
    let missing: Vec<_> = rows.iter().filter(is_missing).collect();
    assert!(missing.is_empty(), "no test reaches {missing:#?}");
    // What is reached needs no excuse.
    let is_excused = |row: &&&String| excuses(row) > 0;
    let reached: Vec<_> = of_one.iter().filter(is_excused).collect();
    assert!(reached.is_empty(), "take out of ELSEWHERE: {reached:#?}");
}

#[test]
fn texts_are_found_as_the_compiler_reads_them() {
    let source = "a(\"one\\\n   two\", '\"', r) // \"no\"\n/// \"no\"\nb(\"say \\\"x\\\"\")";
    assert_eq!(literals(source), ["onetwo", "say \"x\""]);
    assert_eq!(
        fixed_parts("`fuser {device}` ends {}"),
        ["`fuser ", "` ends ", ""]
    );
}
