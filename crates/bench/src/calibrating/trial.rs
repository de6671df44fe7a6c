//! Records that are looked at before they are accepted: until then they lie in a folder of their
//! own among the rig's, which no capture or fit reads.

use std::ffi::OsStr;
use std::fs::{create_dir_all, read_dir, remove_dir_all, rename};
use std::io;
use std::path::{Path, PathBuf};

use crate::calibration::Library;
use crate::calibration::record::Kind;
use crate::config::ResolvedRig;

/// Its name among the folders of the kinds.
const FOLDER: &str = ".trial";
/// That of the figures.
const FIGURES: &str = "plots";

/// What was measured and is not in force yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trial {
    /// Of the rig's records.
    records: PathBuf,
}

impl Trial {
    /// Of a rig; `None` where its records are in the program, which takes no others.
    pub fn of_rig(rig: &ResolvedRig) -> Option<Self> {
        match Library::of_rig(rig) {
            Library::Folder(records) | Library::Before(records, _) => Some(Self { records }),
            Library::BuiltIn(_) => None,
        }
    }

    /// Where its records are kept meanwhile.
    pub fn folder(&self) -> PathBuf {
        self.records.join(FOLDER)
    }

    /// The kinds and names of its records.
    pub fn found(&self) -> Vec<(Kind, String)> {
        let of_kind = |kind: Kind| {
            let names = files(&self.folder().join(kind.folder())).into_iter();
            names.filter_map(move |name| Some((kind, name.strip_suffix(".toml")?.to_owned())))
        };
        Kind::ALL.into_iter().flat_map(of_kind).collect()
    }

    /// The figure of its record, PNG.
    pub fn figure(&self) -> Option<PathBuf> {
        let folder = self.folder().join(FIGURES);
        let name = files(&folder).into_iter().find(|name| is_png(name))?;
        Some(folder.join(name))
    }

    /// Puts its records in force, with their maps and figures.
    ///
    /// # Errors
    /// A file of that name is there, or the system's error: what was moved before stays.
    pub fn accept(&self) -> io::Result<()> {
        let mut folders = vec![FIGURES];
        folders.extend(Kind::ALL.map(Kind::folder));
        for folder in folders {
            let (from, to) = (self.folder().join(folder), self.records.join(folder));
            let mut names = files(&from);
            // A record is there once its maps are.
            names.sort_by_key(|name| name.ends_with(".toml"));
            for name in names {
                create_dir_all(&to)?;
                let new = to.join(&name);
                if new.symlink_metadata().is_ok() {
                    let fact = format!("{} exists already", new.display());
                    return Err(io::Error::new(io::ErrorKind::AlreadyExists, fact));
                }
                rename(from.join(&name), new)?;
            }
        }
        self.discard()
    }

    /// Removes what it has.
    ///
    /// # Errors
    /// The system's.
    pub fn discard(&self) -> io::Result<()> {
        match remove_dir_all(self.folder()) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }
}

fn is_png(name: &str) -> bool {
    Path::new(name).extension() == Some(OsStr::new("png"))
}

/// Names of the plain files of a folder, in order.
fn files(folder: &Path) -> Vec<String> {
    let entries = read_dir(folder).into_iter().flatten().flatten();
    let plain = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()));
    let mut names: Vec<_> = plain
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_in_force_once_it_is_accepted() {
        let folder = tempfile::tempdir().unwrap();
        let records = folder.path().to_owned();
        let trial = Trial { records };
        assert_eq!((trial.found(), trial.figure()), (vec![], None));
        trial.discard().unwrap();
        let write = |path: &str| {
            let path = folder.path().join(path);
            create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        };
        for file in [
            ".trial/flat/a-flat.toml",
            ".trial/flat/a-flat.png",
            ".trial/plots/a-flat.png",
        ] {
            write(file);
        }
        assert_eq!(trial.found(), [(Kind::Flat, "a-flat".to_owned())]);
        assert_eq!(
            trial.figure(),
            Some(trial.folder().join("plots/a-flat.png"))
        );
        trial.accept().unwrap();
        assert!(folder.path().join("flat/a-flat.toml").is_file());
        assert!(!trial.folder().exists() && trial.found().is_empty());
        // None is ever replaced.
        write(".trial/flat/a-flat.toml");
        let error = trial.accept().unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        trial.discard().unwrap();
        assert!(folder.path().join("flat/a-flat.toml").is_file());
    }
}
