//! What a validation leaves on disk: `validations/<n>/` of a session, or the folder named by
//! `rig validate --out`. Plain data with its writer and reader; nothing here fits.
//!
//! | file | content |
//! |---|---|
//! | `validation.json` | [`Validation`]: the errors of each predicted light; written last, a folder without it is none |
//! | `light_L000.png` | of each predicted light: captured, predicted, difference with its scale |

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::fit_record::{
    FitRecordError, Verdict, commit_numbered, numbers_of, out_of_range, write_files,
};
use super::layout::VALIDATIONS_FOLDER;
use super::{Session, SessionWriter};
use crate::shown::{self, MESSAGE, shortened};

/// The record itself.
pub const VALIDATION_FILE: &str = "validation.json";
/// Version of the folder's layout; a reader refuses any other.
pub const FORMAT: u32 = 1;

/// A record of a thousand lights has 1 MB.
const LARGEST_RECORD_BYTES: u64 = 4 << 20;
/// A picture of three images of 400 pixels a side has up to 2 MB.
const LARGEST_PICTURE_BYTES: u64 = 16 << 20;

/// Errors over a set of pixels, each √(Σ (predicted − captured)² / Σ captured²) over pixels and
/// channels: no pixel is divided by its own radiance, so that dark ones count for little.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionScore {
    /// Pixels that are compared.
    pub pixels: usize,
    /// Of the fit; `None` without light, like the others.
    pub relative_rms: Option<f64>,
    /// What the captured images' own noise makes of it.
    pub noise: Option<f64>,
    /// Of a Lambertian, by least squares over the same fitted lights, direct light alone.
    pub lambertian: Option<f64>,
    /// Of the fitted lights' values at the nearest (θh, θd), direct light alone, over the pixels
    /// that have any; `None` where too few lights were fitted.
    pub neighbours: Option<f64>,
}

/// A light that was predicted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightScore {
    /// Its number, from 0.
    pub light: usize,
    /// All compared pixels.
    pub overall: RegionScore,
    /// Those with θh above 15°.
    pub away: RegionScore,
    /// Those with θh of 15° or less.
    pub highlight: RegionScore,
    /// Part of the captured values inside their predicted 95% interval, of posterior samples,
    /// render noise and capture noise together; `None` without posterior samples.
    pub coverage: Option<f64>,
    /// Median half width of these intervals over the predicted radiance.
    pub median_half_width: Option<f64>,
    /// Pixels of the sample that are not compared.
    pub left_out: LeftOut,
}

/// A part of a scene's lights was fitted, the rest predicted: how far the predictions are.
/// `validation.json` as it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// [`FORMAT`].
    pub format: u32,
    /// The images come from a simulated bench.
    pub simulated: bool,
    /// When it was made, RFC 3339.
    pub made_utc: String,
    /// The program's version.
    pub rig: String,
    /// Dictionary of the fit.
    pub dictionary: String,
    /// Verdict of the fit.
    pub verdict: Verdict,
    /// The image of every light, in the lights' order: its path, of a session the one inside.
    pub images: Vec<String>,
    /// The lights that were fitted, from 0.
    pub fitted_lights: Vec<usize>,
    /// Posterior samples that the intervals come from.
    pub posterior_samples: usize,
    /// Each predicted light.
    pub lights: Vec<LightScore>,
    /// All predicted lights together, sums over all their pixels; its number is that of the lights.
    pub all: LightScore,
}

/// Pixels of the sample that are not compared, by the first reason that applies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Dark in the mask.
    pub masked: usize,
    /// Clipped in every exposure, hot, or not a number.
    pub invalid: usize,
    /// Not lit by the lamp directly, or at more than 87° from the normal.
    pub unlit: usize,
}

impl std::ops::AddAssign for LeftOut {
    fn add_assign(&mut self, other: Self) {
        self.masked += other.masked;
        self.invalid += other.invalid;
        self.unlit += other.unlit;
    }
}

/// Name of the picture of a predicted light.
pub fn picture_file(light: usize) -> String {
    format!("light_L{light:03}.png")
}

/// The headings of [`Validation::table`].
pub const HEADINGS: [&str; 11] = [
    "light",
    "error",
    "θh > 15°",
    "θh ≤ 15°",
    "noise",
    "Lambertian",
    "neighbours",
    "in 95% interval",
    "half width",
    "pixels",
    "left out",
];

impl LightScore {
    /// The cells below [`HEADINGS`] but the first; empty where nothing can be stated.
    fn cells(&self) -> [String; 10] {
        let percent =
            |value: Option<f64>| value.map_or(String::new(), |v| format!("{:.1}%", 100.0 * v));
        let left_out = self.left_out;
        [
            percent(self.overall.relative_rms),
            percent(self.away.relative_rms),
            percent(self.highlight.relative_rms),
            percent(self.overall.noise),
            percent(self.overall.lambertian),
            percent(self.overall.neighbours),
            percent(self.coverage),
            percent(self.median_half_width),
            self.overall.pixels.to_string(),
            (left_out.masked + left_out.invalid + left_out.unlit).to_string(),
        ]
    }
}

impl Validation {
    /// A row for each predicted light, counted from 1, and one for all, cell by cell below [`HEADINGS`].
    pub fn table(&self) -> Vec<Vec<String>> {
        let lights = self
            .lights
            .iter()
            .map(|score| ((score.light + 1).to_string(), score));
        let rows = lights.chain([("all".to_owned(), &self.all)]);
        rows.map(|(name, score)| [name].into_iter().chain(score.cells()).collect())
            .collect()
    }

    /// [`table`](Self::table) below its headings, without columns that have nothing to state.
    pub fn headed_table(&self) -> (Vec<&'static str>, Vec<Vec<String>>) {
        let rows = self.table();
        let is_stated = |column: &usize| rows.iter().any(|row| !row[*column].is_empty());
        let stated: Vec<usize> = (0..HEADINGS.len()).filter(is_stated).collect();
        let kept = |row: &Vec<String>| stated.iter().map(|&n| row[n].clone()).collect();
        let headings = stated.iter().map(|&column| HEADINGS[column]).collect();
        (headings, rows.iter().map(kept).collect())
    }

    /// Which images were fitted and which predicted, in words; the fewer ones are named.
    pub fn division(&self) -> String {
        let predicted: Vec<usize> = self.lights.iter().map(|score| score.light).collect();
        let (named, lights, rest) = match self.fitted_lights.len() <= predicted.len() {
            true => ("fitted", &self.fitted_lights, "predicted"),
            false => ("predicted", &predicted, "fitted"),
        };
        let named_image = |&light: &usize| match self.images.get(light) {
            Some(image) => format!("{} ({image})", light + 1),
            None => (light + 1).to_string(),
        };
        let (ending, verb) = match lights.len() {
            1 => ("", "was"),
            _ => ("s", "were"),
        };
        let images: Vec<String> = lights.iter().map(named_image).collect();
        format!(
            "light{ending} {} {verb} {named}, the others {rest}",
            images.join(", ")
        )
    }
}

/// The record's file, for a folder named in messages alone.
///
/// # Errors
/// A value out of its range.
fn encode(folder: &Path, record: &Validation) -> Result<Vec<u8>, FitRecordError> {
    let path = folder.join(VALIDATION_FILE);
    check(&path, record)?;
    let mut text = serde_json::to_vec_pretty(record).map_err(|error| syntax(&path, &error))?;
    text.push(b'\n');
    Ok(text)
}

/// The files of a validation, the record last.
fn files_of(
    folder: &Path,
    record: &Validation,
    pictures: &[(String, Vec<u8>)],
) -> Result<Vec<(String, Vec<u8>)>, FitRecordError> {
    let text = encode(folder, record)?;
    let last = (VALIDATION_FILE.to_owned(), text);
    Ok(pictures.iter().cloned().chain([last]).collect())
}

/// Adds a validation with its pictures, by name, to a session under the next free number and
/// returns its folder. Every file is journalled; `validation.json`, the last one, makes it count.
///
/// # Errors
/// A value out of its range (nothing is written then), or the session's error.
pub fn commit(
    session: &mut SessionWriter,
    record: &Validation,
    pictures: &[(String, Vec<u8>)],
) -> Result<PathBuf, FitRecordError> {
    let files = files_of(Path::new(VALIDATIONS_FOLDER), record, pictures)?;
    Ok(commit_numbered(session, VALIDATIONS_FOLDER, files)?)
}

/// Writes it to a folder outside a session, which must not exist or be empty and appears whole or
/// not at all.
///
/// # Errors
/// [`FitRecordError::Exists`], a value out of its range, or the system's error.
pub fn write(
    folder: &Path,
    record: &Validation,
    pictures: &[(String, Vec<u8>)],
) -> Result<(), FitRecordError> {
    write_files(folder, files_of(folder, record, pictures)?)
}

/// The number of a session's latest validation.
pub fn latest_in(session: &Session) -> Option<u32> {
    numbers_of(session, VALIDATIONS_FOLDER, VALIDATION_FILE).pop()
}

/// Path inside a session of a file of a validation.
pub fn inside(number: u32, name: &str) -> String {
    format!("{VALIDATIONS_FOLDER}/{number}/{name}")
}

/// Reads a validation of a session; its file must be the one that the journal vouches for.
///
/// # Errors
/// A file that is damaged, longer than any record, or does not parse.
pub fn read_in(session: &Session, number: u32) -> Result<Validation, FitRecordError> {
    let file = inside(number, VALIDATION_FILE);
    let bytes = session.read_file_within(&file, LARGEST_RECORD_BYTES)?;
    parse(&session.root().join(file), &bytes)
}

/// The picture (PNG) of a predicted light, as the journal vouches for it; `None` where the
/// validation was made without.
///
/// # Errors
/// A file that is damaged, or longer than any picture.
pub fn read_picture_in(
    session: &Session,
    number: u32,
    light: usize,
) -> Result<Option<Vec<u8>>, FitRecordError> {
    let file = inside(number, &picture_file(light));
    let is_there = session.vouches_for(&file);
    let read = is_there.then(|| session.read_file_within(&file, LARGEST_PICTURE_BYTES));
    Ok(read.transpose()?)
}

/// The record of a file's bytes; `path` is only named in messages.
///
/// # Errors
/// No JSON, a missing or unknown value, or one out of its range.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Validation, FitRecordError> {
    /// The version alone, which decides whether the rest can be read.
    #[derive(Deserialize)]
    struct Version {
        format: u32,
    }
    let Version { format } = serde_json::from_slice(bytes).map_err(|e| syntax(path, &e))?;
    if format != FORMAT {
        return Err(out_of_range(path, "format", format, &FORMAT.to_string()));
    }
    let record = serde_json::from_slice(bytes).map_err(|e| syntax(path, &e))?;
    check(path, &record)?;
    Ok(record)
}

fn syntax(path: &Path, error: &serde_json::Error) -> FitRecordError {
    FitRecordError::Syntax {
        path: path.to_owned(),
        line: error.line(),
        key: "document".to_owned(),
        fact: shortened(&shown::line(&error.to_string()), MESSAGE).into_owned(),
    }
}

/// Ranges, checked before writing and after reading.
fn check(path: &Path, record: &Validation) -> Result<(), FitRecordError> {
    let lights = record.images.len();
    let predicted = record.lights.iter().map(|score| score.light);
    let mut all = record.fitted_lights.iter().copied().chain(predicted);
    if let Some(light) = all.find(|&light| light >= lights) {
        let allowed = format!("a light of the {lights} images");
        return Err(out_of_range(path, "light", light, &allowed));
    }
    for score in record.lights.iter().chain([&record.all]) {
        let regions = [score.overall, score.away, score.highlight].into_iter();
        let errors = regions.flat_map(|r| [r.relative_rms, r.noise, r.lambertian, r.neighbours]);
        let mut sizes = errors.chain([score.median_half_width]).flatten();
        if let Some(bad) = sizes.find(|x| !(x.is_finite() && *x >= 0.0)) {
            return Err(out_of_range(path, "error", bad, "0 or more, finite"));
        }
        let coverage = score.coverage.unwrap_or(0.0);
        if !(0.0..=1.0).contains(&coverage) {
            return Err(out_of_range(path, "coverage", coverage, "0 to 1"));
        }
    }
    Ok(())
}

/// One of two lights predicted, without intervals; for tests of what shows it.
#[doc(hidden)]
pub fn example() -> Validation {
    let region = |relative_rms| RegionScore {
        pixels: 1200,
        relative_rms: Some(relative_rms),
        noise: Some(0.013),
        lambertian: Some(0.108),
        neighbours: None,
    };
    let score = |light| LightScore {
        light,
        overall: region(0.055),
        away: region(0.033),
        highlight: region(0.115),
        coverage: Some(0.951),
        median_half_width: Some(0.12),
        left_out: LeftOut {
            masked: 3,
            invalid: 4,
            unlit: 5,
        },
    };
    Validation {
        format: FORMAT,
        simulated: true,
        made_utc: "2026-11-21T03:00:00.000Z".to_owned(),
        rig: "0.2.0".to_owned(),
        dictionary: "rig65".to_owned(),
        verdict: Verdict::Explains,
        images: ["derived/radiance_L000.exr", "derived/radiance_L001.exr"]
            .map(str::to_owned)
            .into(),
        fitted_lights: vec![0],
        posterior_samples: 16,
        lights: vec![score(1)],
        all: score(1),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::session::commit::SystemDisk;
    use crate::session::verify::verify;

    #[test]
    fn a_session_keeps_validations_by_number_and_vouches_for_them() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder
            .path()
            .join(crate::session::example::fitted_session(folder.path()));
        // The example's journal has no frames, which is remarked on.
        let before = verify(&root).unwrap();
        let mut writer = SessionWriter::open(Arc::new(SystemDisk), &root).unwrap();
        let picture = || vec![(picture_file(1), b"picture".to_vec())];
        for number in ["0", "1"] {
            let written = commit(&mut writer, &example(), &picture()).unwrap();
            assert_eq!(written, root.join(VALIDATIONS_FOLDER).join(number));
        }
        writer.refresh_manifest().unwrap();
        drop(writer);
        let found = verify(&root).unwrap();
        assert_eq!(found.good_files, before.good_files + 4, "{found:?}");
        assert_eq!(found.problems.len(), before.problems.len(), "{found:?}");
        assert!(found.strays.is_empty(), "{found:?}");
        let session = Session::open(&root).unwrap();
        assert_eq!(latest_in(&session), Some(1));
        assert_eq!(read_in(&session, 1).unwrap(), example());
        let picture = |light| read_picture_in(&session, 1, light).unwrap();
        assert_eq!((picture(1), picture(0)), (Some(b"picture".to_vec()), None));
        std::fs::write(root.join(inside(1, VALIDATION_FILE)), "{}").unwrap();
        assert!(matches!(
            read_in(&session, 1),
            Err(FitRecordError::Session(_))
        ));
    }

    #[test]
    fn what_nothing_is_known_of_has_no_column() {
        let (headings, rows) = example().headed_table();
        assert!(!headings.contains(&"neighbours") && headings.contains(&"half width"));
        assert_eq!(rows[1][..2], ["all", "5.5%"]);
        let said = example().division();
        assert_eq!(
            said,
            "light 1 (derived/radiance_L000.exr) was fitted, the others predicted"
        );
    }

    #[test]
    fn records_that_cannot_be_are_refused() {
        let text = String::from_utf8(encode(Path::new("v"), &example()).unwrap()).unwrap();
        assert_eq!(parse(Path::new("v"), text.as_bytes()).unwrap(), example());
        for (from, to, fact) in [
            ("\"format\": 1", "\"format\": 9", "allowed is 1"),
            ("\"light\": 1", "\"light\": 2", "of the 2 images"),
            ("0.055", "-0.055", "0 or more"),
            ("0.055", "1e400", "document"),
            ("0.951", "1.1", "0 to 1"),
            ("\"explains\"", "\"fine\"", "document"),
        ] {
            assert!(text.contains(from), "{from}");
            let error = parse(Path::new("v"), text.replacen(from, to, 1).as_bytes());
            let error = error.unwrap_err().to_string();
            assert!(error.contains(fact), "{from}: {error}");
        }
    }
}
