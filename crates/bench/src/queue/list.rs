//! The list of samples: a TOML file with a table `[[sample]]` for each.

use std::path::Path;

use super::QueueError;
use crate::capture::light_choice::CANDIDATES;
use crate::capture::lights::{Lights, MOST_LIGHTS};
use crate::config::reader::Section;
use crate::config::{ConfigError, read_text};
use crate::session::layout::is_sample_name;
use crate::units::StageAngles;

/// Characters of a note.
const LONGEST_NOTE: usize = 500;
/// Most sessions of one sample.
const MOST_REPEATS: u64 = 100;

/// The samples in their order.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleList {
    /// At least one; no name twice.
    pub samples: Vec<Sample>,
}

/// A sample that is to be captured.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Its name, which its sessions have.
    pub name: String,
    /// What is known of its material, for the sessions.
    pub material: Option<String>,
    /// Anything else, for the sessions.
    pub comment: Option<String>,
    /// Under which lights; `None`: those of the whole queue.
    pub lights: Option<Lights>,
    /// How many sessions it shall have, at least 1.
    pub repeats: usize,
    /// Whether there may be sessions of the sample from before.
    pub again: bool,
}

impl SampleList {
    /// Reads the file. `taken` names a session from before of a sample, if there is one.
    ///
    /// # Errors
    /// The file, key and line that are wrong, with what is allowed.
    pub fn read(path: &Path, taken: impl Fn(&str) -> Option<String>) -> Result<Self, QueueError> {
        let text = read_text(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut root = Section::parse(&path.display().to_string(), folder, &text)?;
        let tables = root.sections("sample")?.required()?;
        root.finish()?;
        let mut samples: Vec<Sample> = Vec::new();
        for mut table in tables {
            let sample = Sample::read(&mut table)?;
            let refused =
                |allowed: &str| table.conflict("name", format!("{:?}", sample.name), allowed);
            if let Some(first) = samples.iter().position(|other| other.name == sample.name) {
                let allowed = format!(
                    "another name than that of sample[{first}]; `repeats` asks for more sessions of one sample"
                );
                return Err(refused(&allowed).into());
            }
            if let Some(session) = taken(&sample.name).filter(|_| !sample.again) {
                let allowed = format!(
                    "a name without a session from before, which {session} is, or have `again = true`"
                );
                return Err(QueueError::Taken(refused(&allowed)));
            }
            samples.push(sample);
        }
        Ok(Self { samples })
    }
}

impl Sample {
    fn read(table: &mut Section) -> Result<Self, ConfigError> {
        let sample = Self {
            name: table
                .parsed(
                    "name",
                    "1 to 64 letters, digits, dots, hyphens or underscores, the first a letter or digit",
                    |text| is_sample_name(text).then(|| text.to_owned()),
                )?
                .required()?,
            material: note(table, "material")?,
            comment: note(table, "comment")?,
            lights: lights(table)?,
            repeats: table.integer("repeats", 1..=MOST_REPEATS)?.or(1) as usize,
            again: table.flag("again")?.or(false),
        };
        table.check_finished()?;
        Ok(sample)
    }
}

fn note(table: &mut Section, key: &'static str) -> Result<Option<String>, ConfigError> {
    let allowed = format!("a text of 1 to {LONGEST_NOTE} characters on one line");
    let is_note = |text: &str| {
        (1..=LONGEST_NOTE).contains(&text.trim().chars().count())
            && !text.trim().contains(char::is_control)
    };
    let found = table.parsed(key, &allowed, |text| {
        is_note(text).then(|| text.trim().to_owned())
    })?;
    Ok(found.optional())
}

/// `lights` as `rig capture --lights` has it, or a list of directions.
fn lights(table: &mut Section) -> Result<Option<Lights>, ConfigError> {
    let allowed = format!(
        "a number from 1 to {MOST_LIGHTS}, \"all\", or \"best:N\" with N from 1 to {CANDIDATES}"
    );
    let parse = |text: &str| text.parse().ok();
    let chosen = (table.integer_or_text("lights", &allowed, parse)?).optional();
    let Some(directions) = table.sections("light")?.optional() else {
        return Ok(chosen);
    };
    if chosen.is_some() {
        return Err(table.conflict("light", "a list of directions", "left out next to `lights`"));
    }
    let direction = |mut table: Section| {
        let angles = StageAngles::new(
            table.number("azimuth_deg", -720.0..=720.0)?.required()?,
            table.number("elevation_deg", -720.0..=720.0)?.required()?,
        );
        table.finish()?;
        Ok(angles)
    };
    let directions = directions.into_iter().map(direction);
    Ok(Some(Lights::Listed(directions.collect::<Result<_, _>>()?)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<SampleList, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("samples.toml");
        std::fs::write(&path, text).unwrap();
        let taken = |name: &str| (name == "old").then(|| "20261121T023400Z_old_0f3a".to_owned());
        SampleList::read(&path, taken).map_err(|error| {
            let shown = error.to_string();
            let start = path.display().to_string();
            assert!(shown.starts_with(&start), "{shown}");
            shown[start.len()..].to_owned()
        })
    }

    #[test]
    fn a_sample_has_what_the_file_says() {
        let list = read(
            r#"
[[sample]]
name = "cup"

[[sample]]
name = "bowl-7"
material = "red paint, batch 12"
comment = " matte side up "
lights = "best:6"
repeats = 3

[[sample]]
name = "old"
again = true
light = [{ azimuth_deg = 40, elevation_deg = 35.5 }]
"#,
        )
        .unwrap();
        let [cup, bowl, old] = list.samples.as_slice() else {
            panic!("{list:?}");
        };
        assert_eq!((cup.repeats, &cup.lights, cup.again), (1, &None, false));
        assert_eq!(bowl.material.as_deref(), Some("red paint, batch 12"));
        assert_eq!(bowl.comment.as_deref(), Some("matte side up"));
        assert_eq!((bowl.repeats, &bowl.lights), (3, &Some(Lights::Best(6))));
        let listed = vec![StageAngles::new(40.0, 35.5)];
        assert_eq!(old.lights, Some(Lights::Listed(listed)));
        assert_eq!(
            read("sample = [{ name = \"a\", lights = 4 }]")
                .unwrap()
                .samples
                .len(),
            1
        );
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line_and_what_is_allowed() {
        // `; ` ends a line of the file.
        const CASES: &str = r#"
| `sample` is missing | at least one table
sample = [] | `sample` is [] | at least one table
[[sample]] | :1: `sample[0].name` is missing
[[sample]]; name = "a b" | :2: `sample[0].name` is "a b" | 1 to 64 letters
[[sample]]; name = "a"; [[sample]]; name = "a" | :4: `sample[1].name` is "a" | another name than that of sample[0]
[[sample]]; name = "old" | :2: `sample[0].name` is "old" | 20261121T023400Z_old_0f3a
[[sample]]; name = "a"; repeat = 2 | :3: unknown key `sample[0].repeat` | repeats
[[sample]]; name = "a"; repeats = 0 | `sample[0].repeats` is 0 | 1 to 100
[[sample]]; name = "a"; lights = "best:99" | best:99 | N from 1 to 60
[[sample]]; name = "a"; lights = 0 | `sample[0].lights` is 0 | 1 to 100000
[[sample]]; name = "a"; lights = 2; light = [{ azimuth_deg = 0, elevation_deg = 1 }] | sample[0].light` | left out next to `lights`
[[sample]]; name = "a"; light = [{ azimuth_deg = 0 }] | `sample[0].light[0].elevation_deg` is missing
[[sample]]; name = "a"; comment = "a\nb" | on one line
lights = 4; [[sample]]; name = "a" | unknown key `lights`
[[sample]; name | not valid TOML
"#;
        for case in CASES.trim().lines() {
            let mut columns = case.split('|').map(str::trim);
            let text = &columns.next().unwrap().replace("; ", "\n");
            let shown = read(text).unwrap_err();
            for fact in columns {
                assert!(shown.contains(fact), "{text}: {shown}");
            }
            assert!(!shown.contains('\n'), "{shown}");
        }
    }
}
