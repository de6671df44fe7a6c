//! Writing and reading a fit's folder, in a session or outside.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{
    FIT_FILE, FORMAT, FitImages, FitRecord, FitRecordError, POSTERIOR_FILE, PosteriorRecord,
    Verdict, check, out_of_range, tables,
};
use crate::brdf::discrepancy::table as discrepancy_table;
use crate::brdf::fitted::{DISCREPANCY_FILE, WEIGHTS_FILE};
use crate::file_system;
use crate::outside_file::read_regular;
use crate::radiance_image::{RadianceImage, exr};
use crate::session::layout::FITS_FOLDER;
use crate::session::{Session, SessionError, SessionWriter};
use crate::shown::{self, MESSAGE, excerpt, shortened};
use crate::whole_file;

/// The compared cells of every light.
const CELLS_FILE: &str = "cells.csv";

/// Tables of a fit have some thousand rows.
const LARGEST_FILE_BYTES: u64 = 64 << 20;

/// `fit.toml`: the record with its version, and with the verdict for readers, which follows
/// from the rest.
#[derive(Serialize)]
struct FitToml<'a> {
    format: u32,
    simulated: bool,
    verdict: Verdict,
    #[serde(flatten)]
    record: &'a FitRecord,
}

/// The version alone, which decides whether the rest can be read.
#[derive(Deserialize)]
struct Version {
    format: u32,
}

/// The fit's files by name, `fit.toml` last.
///
/// # Errors
/// A value out of its range; `folder` is only named in the message.
pub fn encode(
    folder: &Path,
    record: &FitRecord,
    images: &FitImages,
) -> Result<Vec<(String, Vec<u8>)>, FitRecordError> {
    check(folder, record)?;
    let mut files = Vec::new();
    for (kind, series) in [
        ("rendered", &images.rendered),
        ("residual", &images.residual),
    ] {
        for (light, image) in series.iter().enumerate() {
            let name = image_name(kind, light);
            let bytes = exr::encode(image, &folder.join(&name))?;
            files.push((name, bytes));
        }
    }
    if !images.cells_csv.is_empty() {
        files.push((CELLS_FILE.to_owned(), images.cells_csv.clone().into_bytes()));
    }
    if let Some(discrepancy) = &record.discrepancy {
        let text = discrepancy_table::text(&discrepancy.by_channel);
        files.push((DISCREPANCY_FILE.to_owned(), text.into_bytes()));
    }
    if let Some(posterior) = &record.posterior {
        files.push((POSTERIOR_FILE.to_owned(), posterior.to_npy()));
    }
    for (name, text) in [
        (WEIGHTS_FILE, tables::weights_to_csv(record)),
        ("table.csv", tables::table_to_csv(&record.table)),
        ("trace.csv", tables::trace_to_csv(&record.trace)),
        (FIT_FILE, to_toml(record)),
    ] {
        files.push((name.to_owned(), text.into_bytes()));
    }
    Ok(files)
}

/// Reads what [`encode`] made.
///
/// # Errors
/// A file that is missing, or that does not parse.
pub fn decode(files: &[(String, Vec<u8>)]) -> Result<(FitRecord, FitImages), FitRecordError> {
    let find = |wanted: &str| files.iter().find(|(name, _)| name == wanted);
    let record = parse(Path::new(""), |path, name| match find(name) {
        Some((_, bytes)) => Ok(bytes.clone()),
        None => Err(FitRecordError::Io {
            path: path.to_owned(),
            source: std::io::ErrorKind::NotFound.into(),
        }),
    })?;
    let mut images = images_by(|name| {
        find(name).map(|(name, bytes)| Ok(exr::decode(bytes, Path::new(name))?.image))
    })?;
    if let Some((_, csv)) = find(CELLS_FILE) {
        images.cells_csv = String::from_utf8_lossy(csv).into_owned();
    }
    Ok((record, images))
}

/// Adds a fit to a session under the next free number and returns its folder.
/// Every file is journalled; `fit.toml`, the last one, makes the fit count.
///
/// # Errors
/// A value out of its range (nothing is written then), or the session's error.
pub fn commit(
    session: &mut SessionWriter,
    record: &FitRecord,
    images: &FitImages,
) -> Result<PathBuf, FitRecordError> {
    let folder = next_folder(session.root());
    let files = encode(&folder, record, images)?;
    Ok(commit_numbered(session, FITS_FOLDER, files)?)
}

/// Adds files as the next numbered folder of a session's folder `of`, in their order, and returns
/// its path.
pub(in crate::session) fn commit_numbered(
    session: &mut SessionWriter,
    of: &str,
    files: Vec<(String, Vec<u8>)>,
) -> Result<PathBuf, SessionError> {
    let folder = next_numbered(session.root(), of);
    let number = folder.file_name().unwrap_or_default().to_string_lossy();
    for (name, bytes) in files {
        session.commit_file(&format!("{of}/{number}/{name}"), &bytes)?;
    }
    Ok(folder)
}

/// Whether [`write()`] could write this folder: asked before the fit, which may take hours.
///
/// # Errors
/// [`FitRecordError::Exists`], or the system's error.
pub fn check_folder(folder: &Path) -> Result<(), FitRecordError> {
    let path = folder.to_path_buf();
    let occupied = std::fs::read_dir(folder).is_ok_and(|mut inside| inside.next().is_some());
    if occupied || folder.is_file() {
        return Err(FitRecordError::Exists { path });
    }
    whole_file::check_folder(folder.parent().unwrap_or(Path::new("")))
        .map_err(|source| FitRecordError::Io { path, source })
}

/// Writes a fit's folder outside a session. `folder` must not exist, or be
/// empty. It appears whole or not at all.
///
/// # Errors
/// [`FitRecordError::Exists`], a value out of its range (nothing is written
/// then), or the system's error.
pub fn write(folder: &Path, record: &FitRecord, images: &FitImages) -> Result<(), FitRecordError> {
    write_files(folder, encode(folder, record, images)?)
}

/// Writes files as a folder, which must not exist or be empty and appears whole or not at all.
///
/// # Errors
/// [`FitRecordError::Exists`], or the system's error.
pub(in crate::session) fn write_files(
    folder: &Path,
    files: Vec<(String, Vec<u8>)>,
) -> Result<(), FitRecordError> {
    check_folder(folder)?;
    let io = |path: &Path| {
        let path = path.to_path_buf();
        move |source| FitRecordError::Io { path, source }
    };
    let parent = match folder.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(parent).map_err(io(parent))?;
    let partial = whole_file::Part::folder(folder).map_err(io(parent))?;
    for (name, bytes) in files {
        let path = partial.path().join(name);
        let written = File::create(&path).and_then(|mut file| {
            file.write_all(&bytes)?;
            file_system::sync_file(&file, &path)
        });
        written.map_err(io(&path))?;
    }
    file_system::sync_folder(partial.path()).map_err(io(partial.path()))?;
    // Not every file system can rename a folder onto another. One with files in it
    // stays, and stops the rename.
    drop(std::fs::remove_dir(folder));
    let renamed = partial.renamed(|partial| file_system::rename(partial, folder));
    renamed.map_err(io(folder))?;
    file_system::sync_folder(parent).map_err(io(parent))
}

fn image_name(kind: &str, light: usize) -> String {
    format!("{kind}_L{light:03}.exr")
}

/// Reads a fit's folder outside a session, without its images.
///
/// # Errors
/// Names the file and the key or column that is missing or wrong.
pub fn read(folder: &Path) -> Result<FitRecord, FitRecordError> {
    parse(folder, |path, _| {
        read_regular(path, LARGEST_FILE_BYTES).map_err(|source| FitRecordError::Io {
            path: path.to_path_buf(),
            source,
        })
    })
}

/// Reads a fit of a session, without its images; every file must be the one that
/// the journal vouches for.
///
/// # Errors
/// A file without a journal record or with other bytes, or one that does not parse.
pub fn read_in(session: &Session, number: u32) -> Result<FitRecord, FitRecordError> {
    let folder = session.root().join(FITS_FOLDER).join(number.to_string());
    parse(&folder, |path, name| {
        let relative = inside(number, name);
        if !session.vouches_for(&relative) {
            return Err(FitRecordError::NotVouchedFor {
                path: path.to_owned(),
            });
        }
        Ok(session.read_file(&relative)?)
    })
}

/// Reads a fit's files; `load` gives the bytes of a path and name.
///
/// # Errors
/// As [`read`], and what `load` returns.
pub fn parse(
    folder: &Path,
    load: impl Fn(&Path, &str) -> Result<Vec<u8>, FitRecordError>,
) -> Result<FitRecord, FitRecordError> {
    let text = |name: &str| {
        let path = folder.join(name);
        let bytes = load(&path, name)?;
        match String::from_utf8(bytes) {
            Ok(text) => Ok((path, text)),
            Err(error) => Err(FitRecordError::Io {
                path,
                source: std::io::Error::new(std::io::ErrorKind::InvalidData, error.utf8_error()),
            }),
        }
    };
    let (toml_path, toml_text) = text(FIT_FILE)?;
    let Version { format } = from_toml(&toml_path, &toml_text)?;
    if format != FORMAT {
        return Err(out_of_range(
            &toml_path,
            "format",
            format,
            &FORMAT.to_string(),
        ));
    }
    let mut record: FitRecord = from_toml(&toml_path, &toml_text)?;
    let (path, csv) = text(WEIGHTS_FILE)?;
    (record.atoms, record.weights, record.weight_deviations) =
        tables::weights_from_csv(&path, &csv)?;
    let (path, csv) = text("table.csv")?;
    record.table = tables::table_from_csv(&path, &csv)?;
    if let Some(discrepancy) = &mut record.discrepancy {
        let (path, csv) = text(DISCREPANCY_FILE)?;
        discrepancy.by_channel =
            discrepancy_table::parse(&csv).map_err(|fact| FitRecordError::Table { path, fact })?;
    }
    if let Some(posterior) = &mut record.posterior {
        let path = folder.join(POSTERIOR_FILE);
        *posterior = PosteriorRecord::from_npy(&path, &load(&path, POSTERIOR_FILE)?)?;
    }
    let (path, csv) = text("trace.csv")?;
    record.trace = tables::trace_from_csv(&path, &csv)?;
    check(folder, &record)?;
    Ok(record)
}

/// Reads the images of a fit outside a session, as many lights as there are files.
///
/// # Errors
/// An image that is there but cannot be read.
pub fn read_images(folder: &Path) -> Result<FitImages, FitRecordError> {
    images_by(|name| {
        let path = folder.join(name);
        let read = || Ok(exr::read(&path)?.image);
        path.exists().then(read)
    })
}

/// Reads the images of a session's fit, as many lights as the journal knows.
///
/// # Errors
/// An image whose bytes are not the journalled ones, or that cannot be read.
pub fn read_images_in(session: &Session, number: u32) -> Result<FitImages, FitRecordError> {
    images_by(|name| {
        let path = inside(number, name);
        let read = || {
            let file = session.open_file(&path)?;
            Ok(exr::read_opened(file, &session.root().join(&path), None)?.image)
        };
        session.vouches_for(&path).then(read)
    })
}

/// Images of the lights from the first to the one before that which `read` finds none of, by their
/// files' names.
fn images_by(
    read: impl Fn(&str) -> Option<Result<RadianceImage, FitRecordError>>,
) -> Result<FitImages, FitRecordError> {
    let series = |kind: &str| {
        (0..)
            .map_while(|light| read(&image_name(kind, light)))
            .collect::<Result<Vec<_>, _>>()
    };
    Ok(FitImages {
        rendered: series("rendered")?,
        residual: series("residual")?,
        cells_csv: String::new(),
    })
}

fn inside(number: u32, name: &str) -> String {
    format!("{FITS_FOLDER}/{number}/{name}")
}

/// The numbers of a session's fits, lowest first: those whose `fit.toml`, the last
/// file to be written, is journalled.
pub fn numbers_in(session: &Session) -> Vec<u32> {
    numbers_of(session, FITS_FOLDER, FIT_FILE)
}

/// The numbers of the folders in a session's folder `of` whose file `last` is journalled, lowest
/// first.
pub(in crate::session) fn numbers_of(session: &Session, of: &str, last: &str) -> Vec<u32> {
    let mut numbers: Vec<u32> = session
        .journal()
        .files()
        .iter()
        .filter_map(|file| {
            let inside = file.path.strip_prefix(of)?.strip_prefix('/')?;
            let number = inside.strip_suffix(last)?.strip_suffix('/')?;
            number.parse().ok()
        })
        .collect();
    numbers.sort_unstable();
    numbers
}

/// The folder for the next fit of a session, one above the highest number in
/// use, finished or not; not yet made.
pub fn next_folder(session: &Path) -> PathBuf {
    next_numbered(session, FITS_FOLDER)
}

fn next_numbered(session: &Path, of: &str) -> PathBuf {
    let folder = session.join(of);
    let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let number = numbers.max().map_or(0, |number| number.saturating_add(1));
    folder.join(number.to_string())
}

fn to_toml(record: &FitRecord) -> String {
    let toml = FitToml {
        format: FORMAT,
        simulated: record.simulated,
        verdict: record.verdict(),
        record,
    };
    toml::to_string(&toml).expect("plain data with string keys is always TOML")
}

fn from_toml<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, FitRecordError> {
    toml::from_str(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start.min(text.len()));
        let before = text.get(..at).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let content = text.lines().nth(line - 1).unwrap_or_default();
        let key = match content.split_once('=') {
            Some((key, _)) => key.trim(),
            None => content.trim(),
        };
        FitRecordError::Syntax {
            path: path.to_path_buf(),
            line,
            key: excerpt(if key.is_empty() { "document" } else { key }).into_owned(),
            fact: shortened(&shown::line(error.message()), MESSAGE).into_owned(),
        }
    })
}
