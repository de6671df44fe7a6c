//! The files of a bracket and their exposures: from a table, else from each file's EXIF
//! data or name.

use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::bracket_table::{BracketRow, NoRow, parse_bracket_table, row_of};
use super::frame_exposure::{CameraNote, from_name};
use super::frame_file::{FrameFile, FrameFileError, decode, picture};
use super::merge::FrameRole;
use crate::outside_file::read_regular;
use crate::outside_text;
use crate::shown::excerpt;

/// One frame of a bracket.
#[derive(Clone, Debug)]
pub struct BracketFile {
    /// The file.
    pub path: PathBuf,
    /// What was lit.
    pub role: FrameRole,
    /// Exposure time, seconds.
    pub exposure_s: f64,
}

/// The frames of a bracket with their exposures.
#[derive(Clone, Debug)]
pub struct Bracket {
    /// The frames, at least one, in the order named (a folder's by name).
    pub files: Vec<BracketFile>,
    /// The first frame whose EXIF data state that the camera was turned, and the EXIF
    /// orientation, 2 to 8. Frames are never turned.
    pub turned: Option<(PathBuf, u32)>,
    /// The first frame whose white balance the camera chose by itself: its channels may be
    /// scaled otherwise than those of the next one, unless the counts are raw.
    pub automatic_white_balance: Option<PathBuf>,
    /// The first frame that the camera processed beyond the usual, and how.
    pub processed: Option<(PathBuf, &'static str)>,
}

/// Files that do not make a bracket.
#[derive(Debug, thiserror::Error)]
#[error("{fact}")]
pub struct BracketError {
    /// What kind of problem it is.
    pub problem: Problem,
    fact: String,
}

/// What is wrong with the files of a bracket.
#[derive(Debug)]
pub enum Problem {
    /// A file cannot be read.
    Unreadable,
    /// A folder cannot be read.
    Folder,
    /// A folder without frames.
    NoFrames,
    /// A camera's raw file.
    CameraRaw,
    /// Not a frame.
    NotAFrame(FrameFileError),
    /// One file by one or two names, or two files with the very same counts.
    SameFrame,
    /// Frames of two sizes, depths or numbers of channels.
    OtherKind,
    /// Frames of two ISO speeds, apertures, focal lengths, lenses or cameras, or with and
    /// without flash.
    OtherSetting,
    /// Name and EXIF data disagree, or the latter state no usable exposure.
    UnclearExposure,
    /// A name that can be read in more than one way.
    AmbiguousName,
    /// Neither name nor EXIF data state an exposure.
    NoExposure,
    /// The table of exposures cannot be read.
    UnreadableTable,
    /// A line of the table is wrong.
    Table {
        /// Whether it names a frame a second time.
        is_repeated: bool,
    },
    /// The table has no line for a frame.
    NoRow,
    /// The table has two lines for a frame.
    TwoRows,
}

impl Problem {
    fn with(self, fact: impl fmt::Display) -> BracketError {
        BracketError {
            problem: self,
            fact: fact.to_string(),
        }
    }

    /// Of a file.
    fn of(self, path: &Path, fact: impl fmt::Display) -> BracketError {
        self.with(format_args!("{}: {fact}", path.display()))
    }
}

/// Extensions of frames in a folder.
const EXTENSIONS: [&str; 5] = ["png", "tif", "tiff", "jpg", "jpeg"];
/// Extensions of the raw files of cameras.
const RAW_EXTENSIONS: [&str; 12] = [
    "cr2", "cr3", "nef", "nrw", "arw", "dng", "orf", "rw2", "raf", "pef", "srw", "x3f",
];
/// Largest frame, bytes: 250 megapixels of 16-bit RGB, not compressed.
const LARGEST_FRAME_BYTES: u64 = 3 << 29;
/// Largest table of exposures, bytes.
const LARGEST_TABLE_BYTES: u64 = 1 << 20;
/// EXIF data and a name may differ by this factor, as cameras round.
const ROUNDING: f64 = 1.3;

/// The frames that `paths` (files, or folders of frames) name, with their exposures from
/// `table`, a CSV file, where there is one.
pub fn find(paths: &[PathBuf], table: Option<&Path>) -> Result<Bracket, BracketError> {
    find_frames(paths, table, false)
}

/// As [`find`], of frames that are each an image by itself: where neither a table nor any of
/// them states an exposure, it is 1 s for all, because they are compared with none.
pub fn find_single(paths: &[PathBuf], table: Option<&Path>) -> Result<Bracket, BracketError> {
    find_frames(paths, table, true)
}

fn find_frames(
    paths: &[PathBuf],
    table: Option<&Path>,
    may_be_unstated: bool,
) -> Result<Bracket, BracketError> {
    let mut files = Vec::new();
    for path in paths {
        match path.is_dir() {
            true => files.extend(frames_in(path)?),
            false => files.push(path.clone()),
        }
    }
    each_once(&files)?;
    let notes = files.iter().map(|path| Ok(CameraNote::read(&read(path)?)));
    let notes = notes.collect::<Result<Vec<_>, BracketError>>()?;
    same_setting(&files, &notes)?;
    let turned = first_with(&files, &notes, |note| {
        note.orientation.filter(|n| (2..=8).contains(n))
    });
    let automatic = first_with(&files, &notes, |note| {
        note.automatic_white_balance.then_some(())
    });
    let processed = first_with(&files, &notes, |note| note.processing);
    let table = match table {
        Some(path) => Some((path, read_table(path)?)),
        None => None,
    };
    let mut each = files.iter().zip(&notes);
    let is_unstated =
        may_be_unstated && each.all(|(path, note)| matches!(by_itself(path, note), Ok(None)));
    let files = files.into_iter().zip(&notes).map(|(path, note)| {
        let (role, exposure_s) = match &table {
            Some((table, rows)) => {
                let row = row_for(rows, &path, table)?;
                (row.role, row.exposure_s)
            }
            None if is_unstated => (FrameRole::Light, 1.0),
            None => (FrameRole::Light, stated(&path, note)?),
        };
        Ok(BracketFile {
            path,
            role,
            exposure_s,
        })
    });
    Ok(Bracket {
        files: files.collect::<Result<_, BracketError>>()?,
        turned,
        automatic_white_balance: automatic.map(|(path, ())| path),
        processed,
    })
}

fn first_with<T>(
    files: &[PathBuf],
    notes: &[CameraNote],
    of: impl Fn(&CameraNote) -> Option<T>,
) -> Option<(PathBuf, T)> {
    let mut stated = files.iter().zip(notes);
    stated.find_map(|(path, note)| Some((path.clone(), of(note)?)))
}

/// Refuses a file that is named twice, by whatever paths: it would count as two frames.
fn each_once(files: &[PathBuf]) -> Result<(), BracketError> {
    let mut known = HashMap::new();
    for path in files {
        // A missing file has its own error.
        let Ok(resolved) = path.canonicalize() else {
            continue;
        };
        if let Some(one) = known.insert(resolved, path) {
            return Err(same_frame(one, path));
        }
    }
    Ok(())
}

fn same_frame(one: &Path, other: &Path) -> BracketError {
    let (a, b) = (one.display(), other.display());
    Problem::SameFrame.with(match one == other {
        true => format!("{a} is named twice, and would count as two"),
        false => format!("{a} and {b} are one frame, and would count as two"),
    })
}

/// The frames of one bracket, read one by one: of one kind, and no two the same.
#[derive(Default)]
pub struct FrameReader {
    /// Path, and size, channels and bits of the first frame.
    first: Option<(PathBuf, Kind)>,
    known: HashMap<[u8; 32], PathBuf>,
}

impl FrameReader {
    /// Reads the next frame of the bracket.
    ///
    /// # Errors
    /// Not a frame, a frame of another size, depth or number of channels than the first, or
    /// one with the very counts of an earlier one: the noise of a copy is not independent.
    /// (Frames of one count throughout, black or clipped, may well be equal.)
    pub fn read(&mut self, path: &Path) -> Result<FrameFile, BracketError> {
        let frame = read_frame(path)?;
        let kind = Kind::of(&frame);
        let (first, first_kind) = self.first.get_or_insert_with(|| (path.to_owned(), kind));
        if *first_kind != kind {
            let (path, first) = (path.display(), first.display());
            let fact = format!("{path} is {kind}, but {first} is {first_kind}");
            return Err(Problem::OtherKind.with(fact));
        }
        let mut hash = Sha256::new();
        let mut varies = false;
        for plane in &frame.planes {
            varies |= plane.windows(2).any(|pair| pair[0] != pair[1]);
            hash.update(bytemuck::cast_slice(plane));
        }
        match self.known.insert(hash.finalize().into(), path.to_owned()) {
            Some(one) if varies => Err(same_frame(&one, path)),
            _ => Ok(frame),
        }
    }
}

/// A frame of any format.
///
/// # Errors
/// An unreadable file, or one that is not a frame.
pub fn read_frame(path: &Path) -> Result<FrameFile, BracketError> {
    decode(&read(path)?).map_err(|error| not_a_frame(path, error))
}

/// A picture of any colours; of `size` (pixels per row, rows) where that is known.
///
/// # Errors
/// As [`read_frame`].
pub fn read_picture(
    path: &Path,
    size: Option<[usize; 2]>,
) -> Result<image::DynamicImage, BracketError> {
    picture(&read(path)?, size).map_err(|error| not_a_frame(path, error))
}

fn not_a_frame(path: &Path, error: FrameFileError) -> BracketError {
    // Most raw files are TIFFs, and for some only the name distinguishes them.
    if has_extension(path, &RAW_EXTENSIONS) {
        let fact = format!("{} is a camera's raw file", path.display());
        return Problem::CameraRaw.with(fact);
    }
    let fact = error.to_string();
    Problem::NotAFrame(error).of(path, fact)
}

#[derive(Clone, Copy, PartialEq)]
struct Kind {
    size: [usize; 2],
    channels: usize,
    bits: u32,
}

impl Kind {
    fn of(frame: &FrameFile) -> Self {
        Self {
            size: [frame.width, frame.height],
            channels: frame.planes.len(),
            bits: frame.bits,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let channels = if self.channels == 1 { "grey" } else { "RGB" };
        let [width, height] = self.size;
        write!(f, "{width} x {height}, {}-bit {channels}", self.bits)
    }
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    extensions.contains(&extension.to_ascii_lowercase().as_str())
}

fn frames_in(folder: &Path) -> Result<Vec<PathBuf>, BracketError> {
    let entries = std::fs::read_dir(folder).map_err(|error| Problem::Folder.of(folder, error))?;
    // macOS keeps what other file systems cannot in hidden files of the same extension.
    let is_hidden = |path: &Path| {
        let name = path.file_name().unwrap_or_default();
        name.as_encoded_bytes().starts_with(b".")
    };
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|path| !is_hidden(path));
    files.sort();
    let is_raw = |path: &&PathBuf| has_extension(path, &RAW_EXTENSIONS);
    let raw = files.iter().find(is_raw).cloned();
    files.retain(|path| has_extension(path, &EXTENSIONS));
    if !files.is_empty() {
        return Ok(files);
    }
    let fact = format!("{} holds no frames", folder.display());
    Err(match raw.as_deref().and_then(Path::file_name) {
        Some(raw) => Problem::CameraRaw.with(format_args!(
            "{fact}, but a camera's raw files such as {}",
            raw.to_string_lossy()
        )),
        None => Problem::NoFrames.with(fact),
    })
}

fn read(path: &Path) -> Result<Vec<u8>, BracketError> {
    read_regular(path, LARGEST_FRAME_BYTES).map_err(|error| Problem::Unreadable.of(path, error))
}

/// The exposure that a frame states, seconds.
fn stated(path: &Path, note: &CameraNote) -> Result<f64, BracketError> {
    by_itself(path, note)?.ok_or_else(|| {
        let fact = format!("the exposure of {} is unknown", path.display());
        Problem::NoExposure.with(fact)
    })
}

/// The exposure by EXIF data and name, which must not contradict each other, seconds; `None`
/// where neither states one.
fn by_itself(path: &Path, note: &CameraNote) -> Result<Option<f64>, BracketError> {
    let by_exif = note
        .exposure_s()
        .map_err(|error| Problem::UnclearExposure.of(path, error))?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    match (by_exif, from_name(&name)) {
        (Some(exif_s), Ok(Some(name_s)))
            if !(1.0 / ROUNDING..=ROUNDING).contains(&(exif_s / name_s)) =>
        {
            Err(Problem::UnclearExposure.with(format_args!(
                "{} has an exposure of {name_s} s by its name and of {exif_s} s by its EXIF data",
                path.display()
            )))
        }
        (Some(exposure_s), _) => Ok(Some(exposure_s)),
        (None, Err(error)) => Err(Problem::AmbiguousName.of(path, error)),
        (None, Ok(by_name)) => Ok(by_name),
    }
}

/// A bracket is taken by one camera with one setting throughout, as far as they are stated.
fn same_setting(files: &[PathBuf], notes: &[CameraNote]) -> Result<(), BracketError> {
    let mut first: HashMap<u16, (&Path, &str)> = HashMap::new();
    for (path, note) in files.iter().zip(notes) {
        for (tag, words) in &note.settings {
            let (one, before) = *first.entry(*tag).or_insert((path, words));
            if before != words {
                return Err(Problem::OtherSetting.with(format_args!(
                    "{} was taken {words}, but {} {before}",
                    path.display(),
                    one.display()
                )));
            }
        }
    }
    Ok(())
}

fn read_table(path: &Path) -> Result<Vec<BracketRow>, BracketError> {
    let bytes = read_regular(path, LARGEST_TABLE_BYTES)
        .map_err(|error| Problem::UnreadableTable.of(path, error))?;
    parse_bracket_table(&outside_text::decode_any(&bytes)).map_err(|error| {
        let is_repeated = error.is_repeated;
        Problem::Table { is_repeated }.with(format_args!("{}, {error}", path.display()))
    })
}

/// The table's line for a frame.
fn row_for<'a>(
    rows: &'a [BracketRow],
    frame: &Path,
    table: &Path,
) -> Result<&'a BracketRow, BracketError> {
    let (table, of) = (table.display(), frame.display());
    row_of(rows, frame).map_err(|error| match error {
        NoRow::None => Problem::NoRow.with(format_args!("{table} has no exposure for {of}")),
        NoRow::Several([one, other]) => Problem::TwoRows.with(format_args!(
            "{table} has two exposures that may be meant for {of}, those of {} and {}",
            excerpt(&one),
            excerpt(&other)
        )),
    })
}
