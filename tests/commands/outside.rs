//! What the programs and devices of others write and say, one small input a kind.
//!
//! Every folder `tests/outside/<topic>/<case>` holds the files that somebody has, and a
//! `case.toml` that says who reported the like (repository and issue number), which commands
//! are run in a copy of the folder, and what each must end in and say.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde::Deserialize;

/// A `case.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    /// What the person had.
    what: String,
    /// Reports of the like: `owner/repository#number`, or where the format says so.
    source: Vec<String>,
    /// Files of `tests/outside/shared` that the folder is given in addition.
    #[serde(default)]
    with: Vec<String>,
    run: Vec<Run>,
}

/// One command and what it must come to.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Run {
    /// The command line: words between spaces, the first is `rig`.
    command: String,
    /// The exit code.
    #[serde(default)]
    exit: i32,
    /// Texts that must be in what is said or printed; of an error, in its first line.
    #[serde(default)]
    says: Vec<String>,
    /// A text that must be in the hint.
    hint: Option<String>,
    /// Texts that must not be in it.
    #[serde(default)]
    never: Vec<String>,
}

#[test]
fn every_case_ends_as_its_file_says() {
    let cases = cases();
    assert!(!cases.is_empty());
    let failures: Vec<String> = cases.iter().flat_map(|folder| failures(folder)).collect();
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/outside")
}

fn folders(of: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(of).unwrap().map(|entry| entry.unwrap().path());
    let mut folders: Vec<PathBuf> = entries.filter(|path| path.is_dir()).collect();
    folders.sort();
    folders
}

fn cases() -> Vec<PathBuf> {
    let topics = folders(&root()).into_iter();
    topics
        .filter(|topic| !topic.ends_with("shared"))
        .flat_map(|topic| folders(&topic))
        .collect()
}

/// Everything in which the case ends otherwise than its file says.
fn failures(folder: &Path) -> Vec<String> {
    let name = folder.strip_prefix(root()).unwrap().display();
    let text = fs::read_to_string(folder.join("case.toml"))
        .unwrap_or_else(|error| panic!("{name}/case.toml: {error}"));
    let case: Case =
        toml::from_str(&text).unwrap_or_else(|error| panic!("{name}/case.toml: {error}"));
    assert!(!case.source.is_empty(), "{name} names no source");
    assert!(!case.run.is_empty(), "{name} runs nothing");

    let copy = tempfile::tempdir().unwrap();
    copy_folder(folder, copy.path());
    for file in &case.with {
        let from = root().join("shared").join(file);
        fs::copy(&from, copy.path().join(file))
            .unwrap_or_else(|error| panic!("{}: {error}", from.display()));
    }
    let complaints = case.run.iter().filter_map(|run| {
        let complaint = run.complaint(copy.path())?;
        Some(format!(
            "{name} ({}), {}: {complaint}",
            case.what, run.command
        ))
    });
    complaints.collect()
}

impl Run {
    fn complaint(&self, folder: &Path) -> Option<String> {
        let mut words = self.command.split_whitespace();
        assert_eq!(words.next(), Some("rig"), "{}", self.command);
        let output = Command::new(env!("CARGO_BIN_EXE_rig"))
            .args(words)
            .current_dir(folder)
            .env_remove("RIG_CONFIG")
            .env_remove("RUST_BACKTRACE")
            .output()
            .unwrap();
        let stdout = String::from_utf8_lossy(&output.stdout);
        let stderr = String::from_utf8_lossy(&output.stderr);
        let everything = format!("{stdout}{stderr}");
        let line = |start| everything.lines().find(|line| line.starts_with(start));

        let said = match self.exit {
            0 => &everything,
            _ => line("error: ").unwrap_or(""),
        };
        let missing = self.says.iter().find(|text| !said.contains(*text));
        let unwanted = self.never.iter().find(|text| everything.contains(*text));
        let hint = line("hint: ").unwrap_or("");
        let fault = if output.status.code() != Some(self.exit) {
            format!("ended with {:?} instead of {}", output.status, self.exit)
        } else if let Some(text) = missing {
            format!("does not say {text:?}")
        } else if let Some(text) = unwanted {
            format!("says {text:?}")
        } else if self.hint.as_ref().is_some_and(|text| !hint.contains(text)) {
            format!("does not advise {:?}", self.hint)
        } else {
            return None;
        };
        Some(format!("{fault}\n{everything}"))
    }
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}
