//! What Cargo cannot say of the crates, read from the source: neither the modules of a crate
//! nor its files import each other in a circle, and some words stay out of some modules.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The code alone: comments and strings blanked, so that prose may speak of
/// what the code may not do.
fn code(source: &str) -> String {
    let mut kept = String::with_capacity(source.len());
    let mut rest = source;
    while let Some(c) = rest.chars().next() {
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if let Some(length) = raw_string(rest) {
            length
        } else if c == '"' {
            quoted(rest)
        } else if rest.starts_with("'\"'") {
            3
        } else {
            kept.push(c);
            rest = &rest[c.len_utf8()..];
            continue;
        };
        kept.push(' ');
        rest = &rest[length..];
    }
    kept
}

/// Length of a raw string at the start of `text`.
fn raw_string(text: &str) -> Option<usize> {
    let after = text.strip_prefix('r')?;
    let hashes = after.len() - after.trim_start_matches('#').len();
    after[hashes..].strip_prefix('"')?;
    let start = 1 + hashes + 1;
    let close = format!("\"{}", "#".repeat(hashes));
    let end = text[start..].find(&close);
    Some(end.map_or(text.len(), |end| start + end + close.len()))
}

/// Length of the string that starts with the first quote.
fn quoted(text: &str) -> usize {
    let mut escaped = false;
    for (i, b) in text.bytes().enumerate().skip(1) {
        match b {
            _ if escaped => escaped = false,
            b'\\' => escaped = true,
            b'"' => return i + 1,
            _ => {}
        }
    }
    text.len()
}

/// The members of a `{…}` group, given what follows its opening brace.
fn members(group: &str) -> Vec<&str> {
    let (mut depth, mut start, mut found) = (0, 0, Vec::new());
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                found.push(group[start..i].trim());
                break;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                found.push(group[start..i].trim());
                start = i + 1;
            }
            _ => {}
        }
    }
    found
}

fn identifier(text: &str) -> String {
    text.chars()
        .take_while(|c| c.is_alphanumeric() || *c == '_')
        .collect()
}

/// The folders of the crates' sources.
const CRATES: [&str; 8] = [
    "core/src",
    "crates/device/src",
    "crates/setup/src",
    "crates/bench/src",
    "crates/desk/src",
    "crates/lab/src",
    "crates/console/src",
    "src",
];

/// Every file of a crate: the module it belongs to, its path in the crate's source, its text.
/// `lib.rs` and `main.rs` hold them all.
fn files(source_folder: &str) -> Vec<(String, PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(source_folder);
    let mut folders = vec![root.clone()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let inside = path.strip_prefix(&root).unwrap().to_owned();
            let first = inside.components().next().unwrap();
            let module = Path::new(&first).file_stem().unwrap().to_str().unwrap();
            let is_code = path.extension().is_some_and(|extension| extension == "rs");
            if is_code && module != "lib" && module != "main" {
                let source = std::fs::read_to_string(&path).unwrap();
                files.push((module.to_owned(), inside, source));
            }
        }
    }
    files.sort();
    files
}

/// A file as a module's path: `["brdf", "merl"]`; `mod.rs` is its folder.
fn module_path(path: &Path) -> Vec<String> {
    let without_ending = path.with_extension("");
    let parts = without_ending
        .iter()
        .map(|part| part.to_str().unwrap().to_owned());
    parts.filter(|part| part != "mod").collect()
}

/// The paths that `use` and other code name, each from `crate`, `self` or `super` on, groups
/// written out.
fn named_paths(code: &str) -> Vec<Vec<String>> {
    fn written_out(text: &str, before: &[String], found: &mut Vec<Vec<String>>) {
        let text = text.trim_start();
        if let Some(group) = text.strip_prefix('{') {
            members(group)
                .into_iter()
                .for_each(|member| written_out(member, before, found));
            return;
        }
        let name = identifier(text);
        let path: Vec<_> = before.iter().cloned().chain([name.clone()]).collect();
        match text[name.len()..].trim_start().strip_prefix("::") {
            Some(rest) if !name.is_empty() => written_out(rest, &path, found),
            _ => found.push(path),
        }
    }
    let mut found = Vec::new();
    for root in ["crate", "self", "super"] {
        for (at, _) in code.match_indices(&format!("{root}::")) {
            let before = code[..at].chars().next_back();
            if !before.is_some_and(|c| c.is_alphanumeric() || "_$:".contains(c)) {
                written_out(&code[at..], &[], &mut found);
            }
        }
    }
    found
}

/// The files that a file imports from; what holds it (`mod.rs` and above) and what it holds
/// do not count.
fn imported_files(
    own: &[String],
    code: &str,
    all: &BTreeSet<Vec<String>>,
) -> BTreeSet<Vec<String>> {
    let mut imported = BTreeSet::new();
    for path in named_paths(code) {
        let mut at = if path[0] == "crate" {
            Vec::new()
        } else {
            own.to_vec()
        };
        for part in &path {
            match part.as_str() {
                "crate" | "self" => {}
                "super" => drop(at.pop()),
                _ => {
                    at.push(part.clone());
                    if !all.contains(&at) {
                        at.pop();
                        break;
                    }
                }
            }
        }
        if !own.starts_with(&at) && !at.starts_with(own) {
            imported.insert(at);
        }
    }
    imported
}

/// What comes before a file's own tests.
fn without_tests(code: &str) -> &str {
    code.split("#[cfg(test)]\nmod ").next().unwrap_or(code)
}

/// What a crate's files import from, tests aside: its files by their paths, and its modules.
fn imports(source_folder: &str) -> [BTreeMap<String, BTreeSet<String>>; 2] {
    let files: BTreeMap<Vec<String>, String> = files(source_folder)
        .into_iter()
        .filter(|(_, path, _)| !path.ends_with("tests.rs"))
        .map(|(_, path, source)| (module_path(&path), code(&source)))
        .collect();
    let all: BTreeSet<_> = files.keys().cloned().collect();
    let [mut of_files, mut of_modules] = [BTreeMap::new(), BTreeMap::new()];
    for (path, code) in &files {
        let imported = imported_files(path, without_tests(code), &all);
        let modules = imported.iter().filter_map(|path| path.first());
        let others = modules.filter(|module| **module != path[0]).cloned();
        let known: &mut BTreeSet<String> = of_modules.entry(path[0].clone()).or_default();
        known.extend(others);
        let imported = imported.iter().map(|path| path.join("::")).collect();
        of_files.insert(path.join("::"), imported);
    }
    [of_files, of_modules]
}

#[test]
fn neither_modules_nor_files_import_each_other_in_a_circle() {
    for source_folder in CRATES {
        for edges in imports(source_folder) {
            assert!(!edges.is_empty(), "{source_folder}");
            assert_eq!(without_leaves(edges), BTreeMap::new(), "{source_folder}");
        }
    }
}

/// A graph's circles and what leads to them, empty where there is none: whatever imports nothing
/// of the rest is taken out until nothing is left to take.
fn without_leaves(
    mut edges: BTreeMap<String, BTreeSet<String>>,
) -> BTreeMap<String, BTreeSet<String>> {
    loop {
        let leaves: Vec<_> = edges
            .iter()
            .filter(|(_, to)| !to.iter().any(|to| edges.contains_key(to)))
            .map(|(from, _)| from.clone())
            .collect();
        if leaves.is_empty() {
            return edges;
        }
        for leaf in leaves {
            edges.remove(&leaf);
        }
    }
}

#[test]
fn some_words_stay_out_of_some_rooms() {
    /// A word of code, and the modules that may know it; tests may know any.
    const ONLY: &[(&str, &[&str])] = &[
        ("tokio", &["capture", "console"]),
        ("mock_devices", &["device", "simulation", "config", "cli"]),
    ];
    const NEVER: &[(&str, &str)] = &[("transport", "device")];
    for (module, path, source) in CRATES.into_iter().flat_map(files) {
        let code = code(&source);
        let words: BTreeSet<_> = code
            .split(|c: char| !c.is_alphanumeric() && c != '_')
            .collect();
        let is_test = path.ends_with("tests.rs");
        let path = path.display();
        for (word, rooms) in ONLY {
            let known = words.contains(word) && !is_test;
            let allowed = rooms.contains(&module.as_str()) || !known;
            assert!(allowed, "{path}: only {rooms:?} may know {word}");
        }
        for (word, room) in NEVER {
            let allowed = module != *room || !words.contains(word);
            assert!(allowed, "{path}: {room} may not know {word}");
        }
    }
}

/// `rig_core::outside_file` and what builds on it never wait for a file, and bound what they
/// read. Whatever else opens a file for reading is named here, with what it opens.
#[test]
fn files_are_read_by_the_one_bounded_reader() {
    const READS: &[&str] = &[
        "fs::read(",
        "fs::read_to_string(",
        "File::open(",
        ".read(true)",
        "image::open(",
        "ImageReader::open(",
        "fs::copy(",
    ];
    const ELSEWHERE: &[(&str, &str)] = &[
        ("core/src/outside_file.rs", "the reader itself"),
        ("core/src/file_system.rs", "folders, to synchronise them"),
        (
            "core/src/whole_file.rs",
            "its own temporary files and folders, to lock them",
        ),
        ("core/src/inverse/memory.rs", "/proc"),
        (
            "crates/device/src/device/command_camera/started.rs",
            "/proc",
        ),
        (
            "crates/bench/src/session/store.rs",
            "lock files, of which nothing is read",
        ),
        (
            "crates/lab/src/evaluate/growth.rs",
            "/proc, and what its own child wrote",
        ),
        (
            "crates/device/src/device/discovery.rs",
            "/sys, and /etc/group",
        ),
        ("crates/device/src/device/webcam/nokhwa_device.rs", "/sys"),
        ("crates/device/src/device/genicam/find.rs", "/sys"),
    ];
    let mut used = BTreeSet::new();
    for source_folder in CRATES.into_iter().chain(["python/src"]) {
        for (_, path, source) in files(source_folder) {
            let path = format!("{source_folder}/{}", path.display());
            let code = code(&source);
            let code = without_tests(&code);
            let is_test = path.ends_with("tests.rs") || path.contains("/tests/");
            let Some(read) = READS.iter().find(|read| !is_test && code.contains(**read)) else {
                continue;
            };
            let known = ELSEWHERE.iter().find(|(file, _)| path.starts_with(file));
            let Some((file, _)) = known else {
                panic!("{path}: {read}…) may wait or never end; take outside_file");
            };
            used.insert(*file);
        }
    }
    let unused = ELSEWHERE.iter().filter(|(file, _)| !used.contains(file));
    assert_eq!(unused.collect::<Vec<_>>(), [] as [&(&str, &str); 0]);
}

#[test]
fn a_circle_of_files_would_be_found() {
    let path = |text: &str| -> Vec<String> { text.split("::").map(str::to_owned).collect() };
    let all: BTreeSet<_> = ["a", "a::b", "a::c", "a::c::d", "e"].map(path).into();
    for (own, code, expected) in [
        ("a::b", "use super::c::{self, Thing};", vec!["a::c"]),
        (
            "a::b",
            "use crate::a::{c::{d::X}, c::Y};",
            vec!["a::c", "a::c::d"],
        ),
        (
            "a::b",
            "use super::{Thing, shown}; fn f() { crate::e::g() }",
            vec!["e"],
        ),
        ("a::c", "use self::d::X; use super::b;", vec!["a::b"]),
        (
            "a::c::d",
            "use super::Thing; use super::super::b::Thing;",
            vec!["a::b"],
        ),
    ] {
        let found = imported_files(&path(own), code, &all);
        assert_eq!(
            found,
            expected.into_iter().map(path).collect(),
            "{own}: {code}"
        );
    }
    let edges = [("a", "b"), ("b", "c"), ("c", "b"), ("d", "a")]
        .map(|(from, to)| (from.to_owned(), BTreeSet::from([to.to_owned()])));
    let left: Vec<_> = without_leaves(edges.into()).into_keys().collect();
    assert_eq!(left, ["a", "b", "c", "d"]);
}
