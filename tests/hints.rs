//! Every piece of advice of `src/cli/hints.rs` is reached by a test that runs the program.
//!
//! A row is a text of that source. A test reaches it by quoting a part that no other row
//! has: as the `hint` of a case of `tests/outside`, which compares it with the hint alone,
//! or in a test of this folder that runs the program.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Rows that need what no test has, and where the like is tested.
const ELSEWHERE: &[(&str, &str)] = &[];

/// A shorter quotation might be there by accident.
const SHORTEST_QUOTATION: usize = 10;
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

fn rows() -> Vec<String> {
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
    for file in files("tests", "rs") {
        let source = fs::read_to_string(&file).unwrap();
        let runs_it = [
            "CARGO_BIN_EXE_rig",
            "cargo_bin(\"rig\")",
            "mod command_support",
        ];
        if !file.ends_with("hints.rs") && runs_it.iter().any(|mark| source.contains(mark)) {
            quoted.extend(literals(&source));
        }
    }
    quoted.retain(|text| text.len() >= SHORTEST_QUOTATION);
    quoted
}

#[test]
fn every_hint_is_reached_by_a_test_that_runs_the_program() {
    let rows = rows();
    let quoted = quotations();
    assert!(rows.len() > 100 && quoted.len() > 100);
    let is_reached = |row: &String| {
        let parts = fixed_parts(row);
        quoted.iter().any(|text| {
            parts.iter().any(|part| part.contains(text.as_str()))
                && rows
                    .iter()
                    .filter(|other| other.contains(text.as_str()))
                    .count()
                    == 1
        })
    };
    let is_elsewhere = |row: &&String| ELSEWHERE.iter().any(|(part, _)| row.contains(part));
    let (reached, unreached): (Vec<&String>, Vec<&String>) =
        rows.iter().partition(|row| is_reached(row));
    let missing: Vec<_> = unreached.iter().filter(|row| !is_elsewhere(row)).collect();
    assert!(missing.is_empty(), "no test reaches {missing:#?}");
    // A row that is reached by now needs no excuse, and one that is gone neither.
    for (part, _) in ELSEWHERE {
        let needed = unreached.iter().filter(|row| row.contains(part)).count();
        assert_eq!(
            needed,
            1,
            "{part:?} is no unreached row; {} are reached",
            reached.len()
        );
    }
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
