//! A rig's records: finding, checking, adding.

use std::path::{Path, PathBuf};

use jiff::Timestamp;

use super::built_in;
use super::record::{BadValue, Kind, Record, Values};
use super::seal::{self, Seal};
use crate::checksum::sha256_hex;
use crate::config::{CameraConfig, ResolvedRig};
use crate::shown::{MESSAGE, excerpt, shortened};
use crate::{outside_file, whole_file};

/// Records and their maps are small; anything larger is another file.
const LARGEST_FILE_BYTES: u64 = 256 << 20;

/// Where a rig's records are.
#[derive(Clone, Debug, PartialEq)]
pub enum Library {
    /// A folder with one folder per kind.
    Folder(PathBuf),
    /// Built into the program: `<kind>/<file>` and bytes.
    BuiltIn(BuiltInFiles),
    /// A folder, and for kinds of which it has no record those built into the program.
    Before(PathBuf, BuiltInFiles),
}

type BuiltInFiles = &'static [(&'static str, &'static [u8])];

/// A record that is valid and whose files match its checksums.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded<V> {
    /// The record.
    pub record: Record<V>,
    /// SHA-256 of its file, hexadecimal.
    pub sha256: String,
    /// Whether its values are those that were measured; records built into the program have
    /// no need of a checksum.
    pub seal: Seal,
    /// Its files by name, the record's own first: what a session copies.
    pub files: Vec<(String, Vec<u8>)>,
}

/// A record that cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum RecordError {
    /// A file cannot be read or written.
    #[error("{file}: {source}")]
    Io {
        file: String,
        source: std::io::Error,
    },
    /// The named record doesn't exist.
    #[error("there is no {} record {id:?} in {library}", kind.folder())]
    NotFound {
        kind: Kind,
        id: String,
        library: String,
    },
    /// Not a record of this format.
    #[error("{file}:{line}: {problem}")]
    Syntax {
        file: String,
        /// Line, from 1.
        line: usize,
        problem: String,
    },
    /// A value outside its range, or one that contradicts the file's folder or name.
    #[error("{file}: `{key}` is {value}, but must be {allowed}")]
    Invalid {
        file: String,
        key: String,
        value: String,
        allowed: String,
    },
    /// A map's checksum is not the record's.
    #[error("{file} has SHA-256 {actual}, its record says {expected}")]
    Checksum {
        file: String,
        expected: String,
        actual: String,
    },
    /// The record belongs to another device or setting.
    #[error("{file} belongs to {what} {has}, the rig has {wanted}")]
    Mismatch {
        kind: Kind,
        file: String,
        /// Serial number, gain, …
        what: &'static str,
        has: String,
        wanted: String,
    },
    /// A record is never changed, only followed by a newer one.
    #[error("{file} exists already; records are never changed")]
    Exists { file: String },
}

impl Library {
    /// The rig's library: the folder its file names; else `calibration/<rig>`
    /// next to the rig file, above it, or in the working folder. Simulated rigs with the
    /// sensor of a built-in one have its records in addition.
    pub fn of_rig(rig: &ResolvedRig) -> Self {
        if let Some(folder) = &rig.config.calibration.folder {
            return Self::Folder(folder.clone());
        }
        let name = &rig.config.name;
        let found = rig.folder.as_ref().and_then(|folder| {
            let places = [folder.clone(), folder.join(".."), PathBuf::new()];
            let mut places = places.map(|place| place.join("calibration").join(name));
            let found = places.iter_mut().find(|place| place.is_dir())?;
            Some(std::mem::take(found))
        });
        match (found, name.as_str()) {
            (Some(folder), name) if built_in::RIGS.contains(&name) => {
                Self::Before(folder, built_in::SIMULATED)
            }
            (None, name) if built_in::RIGS.contains(&name) => Self::BuiltIn(built_in::SIMULATED),
            (Some(folder), _) => Self::Folder(folder),
            (None, _) => Self::Folder(Path::new("calibration").join(name)),
        }
    }

    /// The part that has the records of a kind.
    fn part(&self, kind: Kind) -> Result<Self, RecordError> {
        let Self::Before(folder, built_in) = self else {
            return Ok(self.clone());
        };
        let own = Self::Folder(folder.clone());
        Ok(match own.ids(kind)?.is_empty() {
            true => Self::BuiltIn(built_in),
            false => own,
        })
    }

    /// Whether all of it is built into the program, so that no record can be added.
    pub fn is_built_in(&self) -> bool {
        matches!(self, Self::BuiltIn(_))
    }

    /// Where it is, for messages.
    pub fn place(&self) -> String {
        match self {
            Self::Folder(folder) | Self::Before(folder, _) => folder.display().to_string(),
            Self::BuiltIn(_) => "the built-in records".to_owned(),
        }
    }

    /// Ids of the records of a kind, in order.
    pub fn ids(&self, kind: Kind) -> Result<Vec<String>, RecordError> {
        let mut ids: Vec<String> = match self {
            Self::Before(..) => self.part(kind)?.ids(kind)?,
            Self::BuiltIn(files) => files
                .iter()
                .filter_map(|(path, _)| {
                    let name = path.strip_prefix(kind.folder())?.strip_prefix('/')?;
                    name.strip_suffix(".toml").map(str::to_owned)
                })
                .collect(),
            Self::Folder(folder) => {
                let folder = folder.join(kind.folder());
                let entries = match std::fs::read_dir(&folder) {
                    Ok(entries) => entries,
                    Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                        return Ok(Vec::new());
                    }
                    Err(source) => return Err(io_error(&folder, source)),
                };
                entries
                    .flatten()
                    .filter_map(|entry| {
                        let name = entry.file_name().into_string().ok()?;
                        name.strip_suffix(".toml").map(str::to_owned)
                    })
                    .collect()
            }
        };
        ids.sort();
        Ok(ids)
    }

    /// The record with this id; without one the newest of its kind, or `None`
    /// if there is none.
    pub fn load<V: Values>(&self, id: Option<&str>) -> Result<Option<Loaded<V>>, RecordError> {
        match id {
            Some(id) => self.load_id(id).map(Some),
            None => self.newest(|_| true),
        }
    }

    /// As [`Self::load`], but among several the newest that belongs to this gain,
    /// if one does.
    pub fn load_for<V: Values>(
        &self,
        id: Option<&str>,
        gain: f64,
    ) -> Result<Option<Loaded<V>>, RecordError> {
        if id.is_some() {
            return self.load(id);
        }
        let fits = |record: &Record<V>| {
            let own = record.settings.gain;
            own.is_none_or(|own| (own - gain).abs() <= 1e-6 * own)
        };
        match self.newest(fits)? {
            Some(found) => Ok(Some(found)),
            None => self.newest(|_| true),
        }
    }

    fn newest<V: Values>(
        &self,
        fits: impl Fn(&Record<V>) -> bool,
    ) -> Result<Option<Loaded<V>>, RecordError> {
        let mut newest: Option<(Timestamp, Loaded<V>)> = None;
        for id in self.ids(V::KIND)? {
            let loaded: Loaded<V> = self.load_id(&id)?;
            // The date was checked on loading.
            let date = loaded.record.date.parse().unwrap_or(Timestamp::MIN);
            let later = newest.as_ref().is_none_or(|(latest, _)| date >= *latest);
            if later && fits(&loaded.record) {
                newest = Some((date, loaded));
            }
        }
        Ok(newest.map(|(_, loaded)| loaded))
    }

    /// Adds a record with its maps (name and bytes); an existing one is never
    /// replaced. Returns the record's path; `None` for the built-in library.
    pub fn add<V: Values>(
        &self,
        record: &Record<V>,
        maps: &[(&str, &[u8])],
    ) -> Result<Option<PathBuf>, RecordError> {
        let (Self::Folder(folder) | Self::Before(folder, _)) = self else {
            return Ok(None);
        };
        let folder = folder.join(V::KIND.folder());
        std::fs::create_dir_all(&folder).map_err(|source| io_error(&folder, source))?;
        let path = folder.join(format!("{}.toml", record.id));
        let text = toml::to_string(record).map_err(|error| RecordError::Syntax {
            file: path.display().to_string(),
            line: 1,
            problem: error.to_string(),
        })?;
        let text = seal::sealed(&text).map_err(|error| RecordError::Syntax {
            file: path.display().to_string(),
            line: 1,
            problem: error.message().to_owned(),
        })?;
        check(record, &record.id, &path.display().to_string())?;
        for (name, bytes) in maps {
            write_new(&folder.join(name), bytes)?;
        }
        write_new(&path, text.as_bytes())?;
        Ok(Some(path))
    }

    fn load_id<V: Values>(&self, id: &str) -> Result<Loaded<V>, RecordError> {
        let name = format!("{id}.toml");
        let part = self.part(V::KIND)?;
        let file = part.file_name(V::KIND, &name);
        let bytes = part.read(V::KIND, &name)?.ok_or(RecordError::NotFound {
            kind: V::KIND,
            id: id.to_owned(),
            library: self.place(),
        })?;
        let (record, seal) = parse::<V>(&bytes, id, &file)?;
        let seal = match part {
            Self::BuiltIn(_) => Seal::Whole,
            _ => seal,
        };
        let sha256 = sha256_hex(&bytes);
        let mut files = vec![(name, bytes)];
        for map in record.values.maps() {
            let file = part.file_name(V::KIND, &map.file);
            let bytes = part
                .read(V::KIND, &map.file)?
                .ok_or_else(|| io_error(Path::new(&file), std::io::ErrorKind::NotFound.into()))?;
            let actual = sha256_hex(&bytes);
            if !actual.eq_ignore_ascii_case(&map.sha256) {
                return Err(RecordError::Checksum {
                    file,
                    expected: map.sha256.clone(),
                    actual,
                });
            }
            files.push((map.file.clone(), bytes));
        }
        Ok(Loaded {
            record,
            sha256,
            seal,
            files,
        })
    }

    fn file_name(&self, kind: Kind, name: &str) -> String {
        format!("{}/{}/{name}", self.place(), kind.folder())
    }

    /// The file's bytes; `None` if there is none.
    fn read(&self, kind: Kind, name: &str) -> Result<Option<Vec<u8>>, RecordError> {
        match self {
            Self::Before(..) => self.part(kind)?.read(kind, name),
            Self::BuiltIn(files) => {
                let path = format!("{}/{name}", kind.folder());
                let found = files.iter().find(|(known, _)| *known == path);
                Ok(found.map(|(_, bytes)| bytes.to_vec()))
            }
            Self::Folder(folder) => {
                let path = folder.join(kind.folder()).join(name);
                match outside_file::read_regular(&path, LARGEST_FILE_BYTES) {
                    Ok(bytes) => Ok(Some(bytes)),
                    Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
                    Err(source) => Err(io_error(&path, source)),
                }
            }
        }
    }
}

/// A record without maps, wherever its file lies.
///
/// # Errors
/// The file cannot be read or is no valid record of this kind.
pub fn record_in<V: Values>(path: &Path) -> Result<Record<V>, RecordError> {
    let bytes = outside_file::read_regular(path, LARGEST_FILE_BYTES)
        .map_err(|source| io_error(path, source))?;
    let id = path.file_stem().unwrap_or_default().to_string_lossy();
    parse(&bytes, &id, &path.display().to_string()).map(|(record, _)| record)
}

/// A record from its file's bytes, and whether its checksum holds; `file` is for messages.
///
/// # Errors
/// The bytes are no valid record of this kind and id.
pub fn parse<V: Values>(
    bytes: &[u8],
    id: &str,
    file: &str,
) -> Result<(Record<V>, Seal), RecordError> {
    let syntax = |problem: String, line| RecordError::Syntax {
        file: file.to_owned(),
        line,
        problem,
    };
    let text = std::str::from_utf8(bytes).map_err(|error| syntax(error.to_string(), 1))?;
    let (checksum, text) = seal::split(text);
    let at = |error: toml::de::Error| {
        let start = error.span().map_or(0, |span| span.start);
        let line = 1 + text.bytes().take(start).filter(|&b| b == b'\n').count();
        syntax(shortened(error.message(), MESSAGE).into_owned(), line)
    };
    let record: Record<V> = toml::from_str(text).map_err(at)?;
    let seal = Seal::of(checksum, text).map_err(at)?;
    check(&record, id, file)?;
    Ok((record, seal))
}

impl<V> Loaded<V> {
    /// Refuses a record of another camera, gain, depth or resolution. An empty
    /// `serial` (the camera has none) matches every record.
    pub fn check_camera(&self, serial: &str, camera: &CameraConfig) -> Result<(), RecordError> {
        let settings = &self.record.settings;
        let mismatch = |what, has: String, wanted: String| {
            Err(RecordError::Mismatch {
                kind: self.record.kind,
                file: self.record.id.clone(),
                what,
                has,
                wanted,
            })
        };
        if !serial.is_empty() && serial != self.record.device_serial {
            let has = self.record.device_serial.clone();
            return mismatch("the camera with serial number", has, serial.to_owned());
        }
        if let Some(gain) = settings.gain
            && (gain - camera.gain).abs() > 1e-6 * gain
        {
            return mismatch("gain", gain.to_string(), camera.gain.to_string());
        }
        if let Some(bits) = settings.bit_depth
            && bits != camera.bit_depth
        {
            return mismatch("bit depth", bits.to_string(), camera.bit_depth.to_string());
        }
        if let Some(pixels) = settings.resolution_px
            && pixels != camera.resolution_px
        {
            let text = |[width, height]: [u32; 2]| format!("{width} x {height}");
            return mismatch("resolution", text(pixels), text(camera.resolution_px));
        }
        Ok(())
    }

    /// Whether it may no longer be used.
    pub fn is_expired(&self, now: Timestamp) -> bool {
        let until = self.record.valid_until.as_deref();
        until.is_some_and(|until| until.parse::<Timestamp>().is_ok_and(|until| until < now))
    }
}

fn check<V: Values>(record: &Record<V>, id: &str, file: &str) -> Result<(), RecordError> {
    let invalid = |key: &str, value: &str, allowed: &str| RecordError::Invalid {
        file: file.to_owned(),
        key: key.to_owned(),
        value: excerpt(value).into_owned(),
        allowed: allowed.to_owned(),
    };
    if record.id != id {
        return Err(invalid("id", &record.id, "the file's name without .toml"));
    }
    if record.kind != V::KIND {
        return Err(invalid("kind", record.kind.folder(), V::KIND.folder()));
    }
    let dates = [
        ("date", Some(&record.date)),
        ("valid_until", record.valid_until.as_ref()),
    ];
    for (key, date) in dates {
        if let Some(date) = date
            && date.parse::<Timestamp>().is_err()
        {
            return Err(invalid(
                key,
                date,
                "a UTC time such as 2026-11-21T02:34:00Z",
            ));
        }
    }
    for map in record.values.maps() {
        let plain = Path::new(&map.file).file_name() == Some(map.file.as_ref());
        if !plain {
            return Err(invalid(
                "values.map.file",
                &map.file,
                "a file name without folder",
            ));
        }
    }
    let values = record.values.check();
    values.map_err(
        |BadValue {
             key,
             value,
             allowed,
         }| invalid(&key, &value, &allowed),
    )
}

fn write_new(path: &Path, bytes: &[u8]) -> Result<(), RecordError> {
    whole_file::create(path, bytes).map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => RecordError::Exists {
            file: path.display().to_string(),
        },
        _ => io_error(path, error),
    })
}

fn io_error(path: &Path, source: std::io::Error) -> RecordError {
    RecordError::Io {
        file: path.display().to_string(),
        source,
    }
}

#[cfg(test)]
mod tests;
