//! The files of a bracket and their exposures: by a table, else as each file's
//! EXIF data or name state them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::{CliError, HintExt};
use crate::outside_file;
use crate::radiometry::bracket_table::{BracketRow, parse_bracket_table};
use crate::radiometry::frame_exposure::{CameraNote, from_exif, from_name};
use crate::radiometry::frame_file::{FrameFile, decode, picture};
use crate::radiometry::merge::FrameRole;

/// One frame of a bracket.
#[derive(Clone, Debug)]
pub(super) struct BracketFile {
    pub path: PathBuf,
    pub role: FrameRole,
    pub exposure_s: f64,
}

/// Endings of frames in a folder.
const ENDINGS: [&str; 5] = ["png", "tif", "tiff", "jpg", "jpeg"];
/// Largest frame, bytes: 250 megapixels of 16-bit RGB, not compressed.
const LARGEST_FRAME_BYTES: u64 = 3 << 29;
/// Largest table of exposures, bytes.
const LARGEST_TABLE_BYTES: u64 = 1 << 20;
/// EXIF data and a name may differ by this factor, as cameras round.
const ROUNDING: f64 = 1.3;

/// The frames that `paths` (files, or folders of frames) name, with their exposures.
pub(super) fn find(paths: &[PathBuf], table: Option<&Path>) -> Result<Vec<BracketFile>, CliError> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            files.extend(frames_in(path)?);
        } else {
            files.push(path.clone());
        }
    }
    each_once(&files)?;
    match table {
        Some(table) => {
            let rows = read_table(table)?;
            let file = |path: PathBuf| {
                let row = row_of(&rows, &path, table)?;
                let (role, exposure_s) = (row.role, row.exposure_s);
                Ok(BracketFile {
                    path,
                    role,
                    exposure_s,
                })
            };
            files.into_iter().map(file).collect()
        }
        None => stated(files),
    }
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
    decode(&read(path)?)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("frames are PNG, TIFF or JPEG files of 8 or 16 bits, grey or RGB")
}

/// A picture of any colours; of `size` (pixels per row, rows) where that is known.
pub(super) fn read_picture(
    path: &Path,
    size: Option<[usize; 2]>,
) -> Result<image::DynamicImage, CliError> {
    picture(&read(path)?, size)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
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

fn frames_in(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let entries = std::fs::read_dir(folder)
        .map_err(|error| CliError::new(format!("{}: {error}", folder.display())))
        .hint("check the folder's permissions")?;
    let is_frame = |path: &PathBuf| {
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
        ENDINGS.contains(&ending.to_ascii_lowercase().as_str())
    };
    let mut files: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(is_frame)
        .collect();
    files.sort();
    if files.is_empty() {
        return Err(
            CliError::new(format!("{} holds no frames", folder.display()))
                .hint("frames are files that end in .png, .tif, .tiff, .jpg or .jpeg"),
        );
    }
    Ok(files)
}

fn read(path: &Path) -> Result<Vec<u8>, CliError> {
    outside_file::read_regular(path, LARGEST_FRAME_BYTES)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("check the path's spelling and the file's permissions")
}

/// Exposures by EXIF data and names, which must not contradict each other, and
/// the same speed and aperture throughout.
fn stated(files: Vec<PathBuf>) -> Result<Vec<BracketFile>, CliError> {
    let mut first: Option<(PathBuf, CameraNote)> = None;
    let mut frames = Vec::new();
    for path in files {
        let note = from_exif(&read(&path)?)
            .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
            .hint("state the exposures in a table, --exposures")?;
        let name = path.file_name().and_then(|name| name.to_str());
        let by_name = name.and_then(from_name);
        if let (Some(note), Some(by_name)) = (note, by_name) {
            let ratio = note.exposure_s / by_name;
            if !(1.0 / ROUNDING..=ROUNDING).contains(&ratio) {
                return Err(CliError::new(format!(
                    "{} has an exposure of {by_name} s by its name and of {} s by its EXIF data",
                    path.display(),
                    note.exposure_s
                ))
                .hint("state the exposures in a table, --exposures"));
            }
        }
        if let Some(note) = note {
            match &first {
                None => first = Some((path.clone(), note)),
                Some((other, known)) => same_setting((other, known), (&path, &note))?,
            }
        }
        let exposure_s = note.map(|note| note.exposure_s).or(by_name);
        let exposure_s = exposure_s.ok_or_else(|| {
            CliError::new(format!("the exposure of {} is unknown", path.display())).hint(
                "name a table with --exposures, or put the exposure into the name: scene_20ms.png",
            )
        })?;
        frames.push(BracketFile {
            path,
            role: FrameRole::Light,
            exposure_s,
        });
    }
    Ok(frames)
}

fn same_setting(
    (first, known): (&Path, &CameraNote),
    (path, note): (&Path, &CameraNote),
) -> Result<(), CliError> {
    for (what, a, b) in [
        ("ISO", known.iso, note.iso),
        ("f/", known.f_number, note.f_number),
    ] {
        if let (Some(a), Some(b)) = (a, b)
            && (a - b).abs() > 1e-6 * a.abs()
        {
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

fn read_table(path: &Path) -> Result<Vec<BracketRow>, CliError> {
    let text = outside_file::read_text(path, LARGEST_TABLE_BYTES)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("--exposures names a CSV file with lines `file,exposure_s`")?;
    parse_bracket_table(&text)
        .map_err(|error| CliError::new(format!("{}, {error}", path.display())))
        .hint("each line is `file,exposure_s` or `file,exposure_s,light|ambient|dark`")
}

/// The table's line for a frame: by its path as given, else by its file name.
fn row_of<'a>(
    rows: &'a [BracketRow],
    path: &Path,
    table: &Path,
) -> Result<&'a BracketRow, CliError> {
    let by_path = rows.iter().find(|row| Path::new(&row.file) == path);
    let by_name = || {
        rows.iter()
            .find(|row| Path::new(&row.file).file_name() == path.file_name())
    };
    by_path.or_else(by_name).ok_or_else(|| {
        CliError::new(format!(
            "{} has no exposure for {}",
            table.display(),
            path.display()
        ))
        .hint("add a line `file,exposure_s` for it, or leave the frame out")
    })
}
