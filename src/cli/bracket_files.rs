//! The files of a bracket and their exposures: by a table, else as each file's
//! EXIF data or name state them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::{CliError, Context, HintExt, hints};
use crate::radiometry::bracket_table::{BracketRow, NoRow, parse_bracket_table, row_of};
use crate::radiometry::frame_exposure::{CameraNote, from_name};
use crate::radiometry::frame_file::{FrameFile, FrameFileError, decode, picture};
use crate::radiometry::merge::FrameRole;
use crate::shown::excerpt;
use crate::{outside_file, outside_text};

/// One frame of a bracket.
#[derive(Clone, Debug)]
pub(super) struct BracketFile {
    pub path: PathBuf,
    pub role: FrameRole,
    pub exposure_s: f64,
}

/// Endings of frames in a folder.
const ENDINGS: [&str; 5] = ["png", "tif", "tiff", "jpg", "jpeg"];
/// Endings of the raw files of cameras.
const RAW_ENDINGS: [&str; 12] = [
    "cr2", "cr3", "nef", "nrw", "arw", "dng", "orf", "rw2", "raf", "pef", "srw", "x3f",
];
/// Largest frame, bytes: 250 megapixels of 16-bit RGB, not compressed.
const LARGEST_FRAME_BYTES: u64 = 3 << 29;
/// Largest table of exposures, bytes.
const LARGEST_TABLE_BYTES: u64 = 1 << 20;
/// EXIF data and a name may differ by this factor, as cameras round.
const ROUNDING: f64 = 1.3;

/// The frames that `paths` (files, or folders of frames) name, with their exposures.
pub(super) fn find(
    paths: &[PathBuf],
    table: Option<&Path>,
    context: &Context,
) -> Result<Vec<BracketFile>, CliError> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            files.extend(frames_in(path)?);
        } else {
            files.push(path.clone());
        }
    }
    each_once(&files)?;
    let mut notes = Vec::new();
    for path in &files {
        notes.push(CameraNote::read(&read(path)?));
    }
    same_setting(&files, &notes)?;
    say_if_turned(&files, &notes, context);
    let rows = table.map(read_table).transpose()?;
    let files = files.into_iter().zip(&notes);
    let bracket_file = |(path, note): (PathBuf, &CameraNote)| {
        let (role, exposure_s) = match (&rows, table) {
            (Some(rows), Some(table)) => {
                let row = row_for(rows, &path, table)?;
                (row.role, row.exposure_s)
            }
            _ => (FrameRole::Light, stated(&path, note)?),
        };
        Ok(BracketFile {
            path,
            role,
            exposure_s,
        })
    };
    files.map(bracket_file).collect()
}

/// Refuses a file that is named twice, by whatever paths: it would count as two frames.
fn each_once(files: &[PathBuf]) -> Result<(), CliError> {
    let mut known = HashMap::new();
    for path in files {
        // What is not there has its own error.
        let Ok(place) = path.canonicalize() else {
            continue;
        };
        if let Some(other) = known.insert(place, path) {
            return Err(same_frame(other, path));
        }
    }
    Ok(())
}

fn same_frame(one: &Path, other: &Path) -> CliError {
    let fact = match one == other {
        true => format!("{} is named twice", one.display()),
        false => format!("{} and {} are one frame", one.display(), other.display()),
    };
    CliError::new(format!("{fact}, and would count as two"))
        .hint("leave one of them out: the noise of a copy is not independent")
}

/// Frames that have been read, by their counts.
#[derive(Default)]
pub(super) struct Distinct(HashMap<[u8; 32], PathBuf>);

impl Distinct {
    /// Refuses a frame with the very counts of an earlier one. Frames of one count throughout
    /// (black or clipped) may well be equal.
    pub fn add(&mut self, path: &Path, frame: &FrameFile) -> Result<(), CliError> {
        let mut hash = Sha256::new();
        let mut varies = false;
        for plane in &frame.planes {
            varies |= plane.windows(2).any(|pair| pair[0] != pair[1]);
            hash.update(bytemuck::cast_slice(plane));
        }
        match self.0.insert(hash.finalize().into(), path.to_owned()) {
            Some(other) if varies => Err(same_frame(&other, path)),
            _ => Ok(()),
        }
    }
}

/// A frame, whatever its format.
pub(super) fn read_frame(path: &Path) -> Result<FrameFile, CliError> {
    decode(&read(path)?).map_err(|error| no_frame(path, &error))
}

/// A picture of any colours; of `size` (pixels per row, rows) where that is known.
pub(super) fn read_picture(
    path: &Path,
    size: Option<[usize; 2]>,
) -> Result<image::DynamicImage, CliError> {
    picture(&read(path)?, size).map_err(|error| no_frame(path, &error))
}

fn no_frame(path: &Path, error: &FrameFileError) -> CliError {
    // Most raw files are TIFFs, some of which only their names tell from others.
    if has_ending(path, &RAW_ENDINGS) {
        return CliError::new(format!("{} is a camera's raw file", path.display()))
            .hint(hints::FOR_CAMERA_RAW);
    }
    CliError::new(format!("{}: {error}", path.display())).hint(hints::for_frame_file(error))
}

/// Two frames of one bracket have one size, depth and number of channels.
pub(super) fn same_kind(
    first: (&Path, &FrameFile),
    other: (&Path, &FrameFile),
) -> Result<(), CliError> {
    let kind = |frame: &FrameFile| (frame.width, frame.height, frame.planes.len(), frame.bits);
    if kind(first.1) == kind(other.1) {
        return Ok(());
    }
    let (path, frame) = other;
    Err(CliError::new(format!(
        "{} is {}, but {} is {}",
        path.display(),
        describe(frame),
        first.0.display(),
        describe(first.1)
    ))
    .hint("a bracket is taken by one camera with one setting; leave the odd frame out"))
}

fn describe(frame: &FrameFile) -> String {
    let channels = match frame.planes.len() {
        1 => "grey",
        _ => "RGB",
    };
    format!(
        "{} x {}, {}-bit {channels}",
        frame.width, frame.height, frame.bits
    )
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    endings.contains(&ending.to_ascii_lowercase().as_str())
}

fn frames_in(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let entries = std::fs::read_dir(folder)
        .map_err(|error| CliError::new(format!("{}: {error}", folder.display())))
        .hint("check the folder's permissions")?;
    // macOS keeps what other file systems cannot in hidden files of the same ending.
    let is_hidden = |path: &Path| {
        let name = path.file_name().unwrap_or_default();
        name.as_encoded_bytes().starts_with(b".")
    };
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|path| !is_hidden(path));
    files.sort();
    let raw = files
        .iter()
        .find(|path| has_ending(path, &RAW_ENDINGS))
        .cloned();
    files.retain(|path| has_ending(path, &ENDINGS));
    if !files.is_empty() {
        return Ok(files);
    }
    let fact = format!("{} holds no frames", folder.display());
    Err(match raw {
        Some(raw) => {
            let name = raw.file_name().unwrap_or_default().to_string_lossy();
            CliError::new(format!("{fact}, but a camera's raw files such as {name}"))
                .hint(hints::FOR_CAMERA_RAW)
        }
        None => CliError::new(fact)
            .hint("frames are files that end in .png, .tif, .tiff, .jpg or .jpeg"),
    })
}

fn read(path: &Path) -> Result<Vec<u8>, CliError> {
    outside_file::read_regular(path, LARGEST_FRAME_BYTES)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("check the path's spelling and the file's permissions")
}

/// The exposure by EXIF data and name, which must not contradict each other, seconds.
fn stated(path: &Path, note: &CameraNote) -> Result<f64, CliError> {
    let by_exif = note
        .exposure_s()
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("state the exposures in a table, --exposures")?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    match (by_exif, from_name(&name)) {
        (Some(by_exif), Ok(Some(by_name))) => {
            let ratio = by_exif / by_name;
            if (1.0 / ROUNDING..=ROUNDING).contains(&ratio) {
                return Ok(by_exif);
            }
            let fact = format!(
                "{} has an exposure of {by_name} s by its name and of {by_exif} s by its EXIF data",
                path.display()
            );
            Err(CliError::new(fact).hint("state the exposures in a table, --exposures"))
        }
        (Some(exposure_s), _) | (None, Ok(Some(exposure_s))) => Ok(exposure_s),
        (None, Err(error)) => Err(CliError::new(format!("{}: {error}", path.display())).hint(
            "name the file so that it can be read in one way, such as scene_20ms.png, or state the exposures in a table, --exposures",
        )),
        (None, Ok(None)) => {
            let fact = format!("the exposure of {} is unknown", path.display());
            Err(CliError::new(fact).hint(
                "name a table with --exposures, or put the exposure into the name: scene_20ms.png",
            ))
        }
    }
}

/// A bracket has one ISO speed and aperture throughout, as far as they are stated.
fn same_setting(files: &[PathBuf], notes: &[CameraNote]) -> Result<(), CliError> {
    type Setting = (&'static str, fn(&CameraNote) -> Option<f64>);
    let settings: [Setting; 2] = [("ISO", |note| note.iso), ("f/", |note| note.f_number)];
    for (what, of) in settings {
        let stated = files.iter().zip(notes);
        let mut stated = stated.filter_map(|(path, note)| Some((path, of(note)?)));
        let Some((first, a)) = stated.next() else {
            continue;
        };
        if let Some((path, b)) = stated.find(|(_, b)| (a - b).abs() > 1e-6 * a.abs()) {
            return Err(CliError::new(format!(
                "{} was taken at {what} {b}, but {} at {what} {a}",
                path.display(),
                first.display()
            ))
            .hint("a bracket varies the exposure time alone; leave the odd frame out"));
        }
    }
    Ok(())
}

/// Says once that frames whose camera was held otherwise are not turned.
fn say_if_turned(files: &[PathBuf], notes: &[CameraNote], context: &Context) {
    let turned = |note: &CameraNote| note.orientation.filter(|n| (2..=8).contains(n));
    let mut found = files
        .iter()
        .zip(notes)
        .filter_map(|(path, note)| Some((path, turned(note)?)));
    if let Some((path, orientation)) = found.next() {
        context.note(format_args!(
            "{}: its EXIF data say orientation {orientation}; frames are not turned, because \
             the camera's calibration holds for the sensor as it is",
            path.display()
        ));
    }
}

fn read_table(path: &Path) -> Result<Vec<BracketRow>, CliError> {
    let bytes = outside_file::read_regular(path, LARGEST_TABLE_BYTES)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("--exposures names a CSV file with lines `file,exposure_s`")?;
    parse_bracket_table(&outside_text::decode_any(&bytes)).map_err(|error| {
        let hint = match error.is_repeated {
            true => "each file has one line: remove the one that is wrong",
            false => "each line is `file,exposure_s` or `file,exposure_s,light|ambient|dark`, or a first line names these columns; semicolons and tabs separate as well",
        };
        CliError::new(format!("{}, {error}", path.display())).hint(hint)
    })
}

/// The table's line for a frame.
fn row_for<'a>(
    rows: &'a [BracketRow],
    path: &Path,
    table: &Path,
) -> Result<&'a BracketRow, CliError> {
    let (table, frame) = (table.display(), path.display());
    row_of(rows, path).map_err(|error| match error {
        NoRow::None => CliError::new(format!("{table} has no exposure for {frame}"))
            .hint("add a line `file,exposure_s` for it, or leave the frame out"),
        NoRow::Several([one, other]) => CliError::new(format!(
            "{table} has two exposures that may be meant for {frame}, those of {} and {}",
            excerpt(&one),
            excerpt(&other)
        ))
        .hint("name the frame in the table with as many of its folders as tell it from the other"),
    })
}
