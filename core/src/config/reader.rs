//! Reads a TOML document key by key into valid values: every value is checked
//! where it is read, every key that was not asked for is refused, and every
//! error names the file, the line, the dotted key, the value and what may
//! stand there.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::DVec3;

use super::ConfigError;
use super::document::{self, Node, Value};
use super::slip;
use crate::shown::{MESSAGE, shortened};

/// The document that a value came from.
#[derive(Debug)]
struct Source {
    file: String,
    folder: PathBuf,
    /// Dotted paths of all keys that were asked for, indices as `[]`.
    asked: RefCell<BTreeSet<String>>,
}

/// A table whose keys are taken one by one.
#[derive(Debug)]
pub struct Section {
    source: Rc<Source>,
    path: String,
    line: usize,
    entries: BTreeMap<String, Node>,
    /// The keys asked for, and the lines of those that were there.
    known: Vec<(&'static str, Option<usize>)>,
}

/// What was found under a key: a valid value, or nothing.
#[derive(Debug)]
#[must_use]
pub struct Found<T> {
    value: Option<T>,
    missing: ConfigError,
}

impl<T> Found<T> {
    /// The value, or the default.
    pub fn or(self, default: T) -> T {
        self.value.unwrap_or(default)
    }

    /// The value, or an error that names the key and what it must be.
    pub fn required(self) -> Result<T, ConfigError> {
        self.value.ok_or(self.missing)
    }

    /// The value if there is one.
    pub fn optional(self) -> Option<T> {
        self.value
    }
}

impl Section {
    /// Parses a document. `file` is what errors call it; relative paths in it
    /// start at `folder`.
    pub fn parse(file: &str, folder: &Path, text: &str) -> Result<Self, ConfigError> {
        let entries = document::parse(text).map_err(|fault| ConfigError::Syntax {
            file: file.to_owned(),
            line: fault.line,
            column: fault.column,
            problem: shortened(&fault.problem, MESSAGE).into_owned(),
            slip: fault.slip,
        })?;
        Ok(Self {
            source: Rc::new(Source {
                file: file.to_owned(),
                folder: folder.to_owned(),
                asked: RefCell::default(),
            }),
            path: String::new(),
            line: 1,
            entries,
            known: Vec::new(),
        })
    }

    /// A finite number in `range`; integers count as numbers.
    pub fn number(
        &mut self,
        key: &'static str,
        range: RangeInclusive<f64>,
    ) -> Result<Found<f64>, ConfigError> {
        self.value(key, number_allowed(&range), |value| value.number(&range))
    }

    /// An integer in `range`.
    pub fn integer(
        &mut self,
        key: &'static str,
        range: RangeInclusive<u64>,
    ) -> Result<Found<u64>, ConfigError> {
        let allowed = format!("an integer from {} to {}", range.start(), range.end());
        self.value(key, allowed, |value| match value {
            Value::Integer(n) => u64::try_from(*n).ok().filter(|n| range.contains(n)),
            _ => None,
        })
    }

    /// An integer or a text, as the text that `parse` accepts; `allowed` completes "must be …".
    pub fn integer_or_text<T>(
        &mut self,
        key: &'static str,
        allowed: &str,
        parse: impl FnOnce(&str) -> Option<T>,
    ) -> Result<Found<T>, ConfigError> {
        self.value(key, allowed.to_owned(), |value| match value {
            Value::Text(text) => parse(text),
            Value::Integer(number) => parse(&number.to_string()),
            _ => None,
        })
    }

    /// `true` or `false`.
    pub fn flag(&mut self, key: &'static str) -> Result<Found<bool>, ConfigError> {
        self.value(key, "true or false".into(), |value| match value {
            Value::Flag(flag) => Some(*flag),
            _ => None,
        })
    }

    /// A text that is not empty.
    pub fn text(&mut self, key: &'static str) -> Result<Found<String>, ConfigError> {
        self.parsed(key, "a text that is not empty", |text| {
            (!text.trim().is_empty()).then(|| text.to_owned())
        })
    }

    /// A path, relative to the document's folder.
    pub fn path(&mut self, key: &'static str) -> Result<Found<PathBuf>, ConfigError> {
        let folder = self.source.folder.clone();
        self.without_control(key)?;
        self.parsed(key, "a path", |text| {
            (!text.is_empty()).then(|| folder.join(text))
        })
    }

    /// One of `names` as it stands, or a path.
    pub fn name_or_path(
        &mut self,
        key: &'static str,
        names: &[&str],
    ) -> Result<Found<PathBuf>, ConfigError> {
        let folder = self.source.folder.clone();
        self.without_control(key)?;
        let allowed = format!("{} or a path", names.join(", "));
        self.parsed(key, &allowed, |text| match text {
            "" => None,
            name if names.contains(&name) => Some(name.into()),
            path => Some(folder.join(path)),
        })
    }

    /// Refuses a text with control characters, as a Windows path in double quotes has them.
    fn without_control(&self, key: &'static str) -> Result<(), ConfigError> {
        let Some(node) = self.entries.get(key) else {
            return Ok(());
        };
        match &node.value {
            Value::Text(text) if let Some(character) = slip::control(text) => {
                Err(ConfigError::ControlCharacter {
                    file: self.source.file.clone(),
                    line: node.line,
                    key: self.path_of(key),
                    value: node.value.to_string(),
                    character,
                })
            }
            _ => Ok(()),
        }
    }

    /// One of the named choices.
    pub fn choice<T: Clone>(
        &mut self,
        key: &'static str,
        choices: &[(&str, T)],
    ) -> Result<Found<T>, ConfigError> {
        let names: Vec<_> = choices
            .iter()
            .map(|(name, _)| format!("{name:?}"))
            .collect();
        self.parsed(key, &names.join(" or "), |text| {
            let found = choices.iter().find(|(name, _)| *name == text);
            found.map(|(_, choice)| choice.clone())
        })
    }

    /// A text that `parse` accepts; `allowed` completes "must be …".
    pub fn parsed<T>(
        &mut self,
        key: &'static str,
        allowed: &str,
        parse: impl FnOnce(&str) -> Option<T>,
    ) -> Result<Found<T>, ConfigError> {
        self.value(key, allowed.to_owned(), |value| match value {
            Value::Text(text) => parse(text),
            _ => None,
        })
    }

    /// `N` finite numbers in `range`.
    pub fn numbers<const N: usize>(
        &mut self,
        key: &'static str,
        range: RangeInclusive<f64>,
    ) -> Result<Found<[f64; N]>, ConfigError> {
        let allowed = format!("a list of {N}, each {}", number_allowed(&range));
        self.value(key, allowed, |value| value.numbers(&range))
    }

    /// The numbers of a list, in any number, without taking it.
    pub fn listed(&self, key: &str) -> Option<Vec<f64>> {
        match &self.entries.get(key)?.value {
            Value::List(nodes) => nodes
                .iter()
                .map(|node| node.value.number(&(f64::MIN..=f64::MAX)))
                .collect(),
            _ => None,
        }
    }

    /// Three numbers, or one that stands for all three.
    pub fn channels(
        &mut self,
        key: &'static str,
        range: RangeInclusive<f64>,
    ) -> Result<Found<[f64; 3]>, ConfigError> {
        let each = number_allowed(&range);
        self.value(key, format!("{each}, or a list of 3 such"), |value| {
            value
                .number(&range)
                .map(|number| [number; 3])
                .or_else(|| value.numbers(&range))
        })
    }

    /// Width and height in pixels.
    pub fn resolution(&mut self, key: &'static str) -> Result<Found<[u32; 2]>, ConfigError> {
        let allowed = "width and height, integers from 1 to 16384".to_owned();
        self.value(key, allowed, |value| {
            let sides: [f64; 2] = value.numbers(&(1.0..=16384.0))?;
            sides
                .iter()
                .all(|side| side.fract() == 0.0)
                .then(|| sides.map(|side| side as u32))
        })
    }

    /// A position or a translation, millimetres, each coordinate within ±1e6.
    pub fn position(&mut self, key: &'static str) -> Result<Found<DVec3>, ConfigError> {
        let found = self.numbers::<3>(key, -1e6..=1e6)?;
        Ok(Found {
            value: found.value.map(DVec3::from_array),
            missing: found.missing,
        })
    }

    /// A direction of any length above zero; returned with length 1.
    pub fn direction(&mut self, key: &'static str) -> Result<Found<DVec3>, ConfigError> {
        let allowed = "a list of 3 numbers that are not all zero".to_owned();
        self.value(key, allowed, |value| {
            DVec3::from_array(value.numbers(&(-1e6..=1e6))?).try_normalize()
        })
    }

    /// A table under this key.
    pub fn section(&mut self, key: &'static str) -> Result<Found<Section>, ConfigError> {
        let (source, path) = (self.source.clone(), self.path_of(key));
        let found = self.node(key, "a table".into(), |node| match &node.value {
            Value::Table(entries) => Some((node.line, entries.clone())),
            _ => None,
        })?;
        Ok(Found {
            value: found.value.map(|(line, entries)| Section {
                source,
                path,
                line,
                entries,
                known: Vec::new(),
            }),
            missing: found.missing,
        })
    }

    /// A table under this key; where there is none, an empty one, so that every
    /// key takes its default.
    pub fn section_or_empty(&mut self, key: &'static str) -> Result<Section, ConfigError> {
        let found = self.section(key)?.optional();
        Ok(found.unwrap_or_else(|| Section {
            source: self.source.clone(),
            path: self.path_of(key),
            line: self.line,
            entries: BTreeMap::new(),
            known: Vec::new(),
        }))
    }

    /// A list of at least one table (`[[key]]`, or a list of inline tables).
    pub fn sections(&mut self, key: &'static str) -> Result<Found<Vec<Section>>, ConfigError> {
        let (source, path) = (self.source.clone(), self.path_of(key));
        self.value(key, "a list of at least one table".into(), |value| {
            let Value::List(nodes) = value else {
                return None;
            };
            let tables = nodes
                .iter()
                .enumerate()
                .map(|(index, node)| match &node.value {
                    Value::Table(entries) => Some(Section {
                        source: source.clone(),
                        path: format!("{path}[{index}]"),
                        line: node.line,
                        entries: entries.clone(),
                        known: Vec::new(),
                    }),
                    _ => None,
                });
            tables
                .collect::<Option<Vec<_>>>()
                .filter(|tables| !tables.is_empty())
        })
    }

    /// Whether the key is there, without taking it.
    pub fn has(&self, key: &str) -> bool {
        self.entries.contains_key(key)
    }

    /// Refuses whatever is left.
    pub fn finish(self) -> Result<(), ConfigError> {
        self.check_finished()
    }

    /// Refuses whatever is left, and keeps the section.
    pub fn check_finished(&self) -> Result<(), ConfigError> {
        match self.entries.first_key_value() {
            None => Ok(()),
            Some((key, node)) => Err(ConfigError::UnknownKey {
                file: self.source.file.clone(),
                line: node.line,
                key: self.path_of(key),
                known: self
                    .known
                    .iter()
                    .map(|(key, _)| (*key).to_owned())
                    .collect(),
            }),
        }
    }

    /// An error about a relation between keys that each are valid alone.
    pub fn conflict(&self, key: &str, value: impl ToString, allowed: &str) -> ConfigError {
        let first = key.split('.').next().unwrap_or(key);
        let line = self.known.iter().find(|(known, _)| *known == first);
        ConfigError::Invalid {
            file: self.source.file.clone(),
            line: line.and_then(|(_, line)| *line).unwrap_or(self.line),
            key: self.path_of(key),
            value: value.to_string(),
            allowed: allowed.to_owned(),
        }
    }

    /// An error about a key that another key makes necessary.
    pub fn missing(&self, key: &str, allowed: &str) -> ConfigError {
        ConfigError::Missing {
            file: self.source.file.clone(),
            line: self.line,
            key: self.path_of(key),
            allowed: allowed.to_owned(),
            unread: self.entries.keys().cloned().collect(),
        }
    }

    /// Dotted paths of all keys that were asked for so far in the whole
    /// document, indices as `[]`: the vocabulary of a file.
    pub fn vocabulary(&self) -> BTreeSet<String> {
        self.source.asked.borrow().clone()
    }

    fn value<T>(
        &mut self,
        key: &'static str,
        allowed: String,
        convert: impl FnOnce(&Value) -> Option<T>,
    ) -> Result<Found<T>, ConfigError> {
        self.node(key, allowed, |node| convert(&node.value))
    }

    fn node<T>(
        &mut self,
        key: &'static str,
        allowed: String,
        convert: impl FnOnce(&Node) -> Option<T>,
    ) -> Result<Found<T>, ConfigError> {
        let line = self.entries.get(key).map(|node| node.line);
        self.known.push((key, line));
        let path = self.path_of(key);
        self.source
            .asked
            .borrow_mut()
            .insert(without_indices(&path));
        let value = match self.entries.remove(key) {
            None => None,
            Some(node) => match convert(&node) {
                Some(value) => Some(value),
                None => {
                    return Err(ConfigError::Invalid {
                        file: self.source.file.clone(),
                        line: node.line,
                        key: path,
                        value: node.value.to_string(),
                        allowed,
                    });
                }
            },
        };
        Ok(Found {
            value,
            missing: self.missing(key, &allowed),
        })
    }

    fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() {
            key.to_owned()
        } else {
            format!("{}.{key}", self.path)
        }
    }
}

fn number_allowed(range: &RangeInclusive<f64>) -> String {
    match (range.start().is_finite(), range.end().is_finite()) {
        (true, true) => format!("a number from {} to {}", range.start(), range.end()),
        (true, false) => format!("a number of at least {}", range.start()),
        (false, true) => format!("a number of at most {}", range.end()),
        (false, false) => "a finite number".to_owned(),
    }
}

fn without_indices(path: &str) -> String {
    let mut pieces = path.split('[');
    let mut kept = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        kept += "[]";
        kept += piece.split_once(']').map_or("", |(_, rest)| rest);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn document(text: &str) -> Section {
        Section::parse("rig.toml", Path::new("/bench"), text).unwrap()
    }

    #[test]
    fn errors_name_file_line_key_value_and_bound() {
        const CASES: &[(&str, &str)] = &[
            (
                "a = 1\n\n[stage]\nscale = 7.5\n",
                "rig.toml:4: `stage.scale` is 7.5, but must be a number from 0 to 2",
            ),
            (
                "[stage]\nscale = \"x\"\n",
                "rig.toml:2: `stage.scale` is \"x\", but must be a number from 0 to 2",
            ),
            (
                "[stage]\nscale = nan\n",
                "rig.toml:2: `stage.scale` is NaN, but must be a number from 0 to 2",
            ),
            (
                "\n[stage]\n",
                "rig.toml:2: `stage.scale` is missing; it must be a number from 0 to 2",
            ),
            (
                "[stage]\nscale = 1\nsclae = 2\n",
                "rig.toml:3: unknown key `stage.sclae`; known here: scale",
            ),
            (
                "[stage]\nscale = [1, 2]\n",
                "rig.toml:2: `stage.scale` is [1, 2], but must be a number from 0 to 2",
            ),
            (
                "stage = 3\n",
                "rig.toml:1: `stage` is 3, but must be a table",
            ),
        ];
        for (text, expected) in CASES {
            let read = || {
                let mut root = document(text);
                let mut stage = root.section("stage")?.required()?;
                stage.number("scale", 0.0..=2.0)?.required()?;
                stage.finish()
            };
            assert_eq!(read().unwrap_err().to_string(), *expected, "{text:?}");
        }
    }

    #[test]
    fn syntax_errors_have_a_line() {
        let error = Section::parse("x.toml", Path::new(""), "a = 1\nb = [1,\n").unwrap_err();
        assert!(
            matches!(error, ConfigError::Syntax { line: 2..=3, .. }),
            "{error}"
        );
    }

    #[test]
    fn lists_and_paths_of_tables_in_lists() {
        let mut root =
            document("[[light]]\nto = [0, 0, 2]\n[[light]]\nto = [0, 0, 0]\nmap = \"m/a.png\"\n");
        let mut lights = root.sections("light").unwrap().required().unwrap();
        assert_eq!(
            lights[0].direction("to").unwrap().required().unwrap(),
            DVec3::Z
        );
        let error = lights[1].direction("to").unwrap_err().to_string();
        assert!(
            error.starts_with("rig.toml:4: `light[1].to` is [0, 0, 0]"),
            "{error}"
        );
        let map = lights[1].path("map").unwrap().required().unwrap();
        assert_eq!(map, Path::new("/bench/m/a.png"));
        assert!(root.vocabulary().contains("light[].to"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused_with_a_line_inside_it(text in "[a-c=\\[\\]{}\".0-9\\n #-]{0,80}") {
            match Section::parse("x", Path::new(""), &text) {
                Ok(root) => { let _ = root.finish(); }
                Err(ConfigError::Syntax { line, .. }) => {
                    prop_assert!(line <= 1 + text.matches('\n').count());
                }
                Err(other) => prop_assert!(false, "{other}"),
            }
        }
    }
}
