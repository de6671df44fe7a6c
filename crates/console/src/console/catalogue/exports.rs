//! The files that exports of a session's fits make: their formats, names and folder.
//!
//! They are no files of the session, whose folder has nothing but what its journal names:
//! they stand in a hidden folder next to the sessions.

use std::path::{Path, PathBuf};

use crate::beneath::{self, BeneathError};
use crate::export::{FORMATS, Format};

/// Under which a page finds the exports of a session.
pub const EXPORTS_FOLDER: &str = "exports";
/// Where they are, next to the sessions: a folder for each.
pub const EXPORTS_ROOT: &str = ".exports";

/// What a page asks for a certificate of measurement as, next to the formats.
pub const CERTIFICATE: &str = "certificate";

/// The name of a fit's certificate.
pub fn certificate_file(number: u32, is_pdf: bool) -> String {
    let ending = if is_pdf { "pdf" } else { "html" };
    format!("fit-{number}-{CERTIFICATE}.{ending}")
}

/// The names of the files that an export of fit `number` makes, the one with the format's
/// usual ending first; `None` if there is no such format.
pub fn files(number: u32, format: &str) -> Option<Vec<String>> {
    let format = Format::named(format)?;
    let file = PathBuf::from(format!("fit-{number}-{}.{}", format.name, format.ending));
    let names = format.files(&file).into_iter();
    Some(
        names
            .filter_map(|file| file.into_os_string().into_string().ok())
            .collect(),
    )
}

/// Whether an export makes a file of this name.
pub fn is_export(name: &str) -> bool {
    let number = name
        .strip_prefix("fit-")
        .and_then(|rest| rest.split_once('-'));
    let Some(number) = number.and_then(|(number, _)| number.parse().ok()) else {
        return false;
    };
    let is_certificate = [true, false].map(|is_pdf| certificate_file(number, is_pdf) == name);
    is_certificate.contains(&true)
        || FORMATS.iter().any(|format| {
            files(number, format.name).is_some_and(|made| made.iter().any(|of| of == name))
        })
}

/// The folder of a session's exports, made where it is missing; no link leads to it.
///
/// # Errors
/// A link in its place, or the system's error.
pub fn folder(sessions: &Path, session: &str) -> Result<PathBuf, BeneathError> {
    let relative = format!("{EXPORTS_ROOT}/{session}");
    for path in [EXPORTS_ROOT, &relative] {
        let made = std::fs::create_dir(sessions.join(path));
        if let Err(source) = made
            && source.kind() != std::io::ErrorKind::AlreadyExists
        {
            let path = sessions.join(path);
            return Err(BeneathError::Io { path, source });
        }
        beneath::check_folder(sessions, path)?;
    }
    Ok(sessions.join(relative))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_may_read_what_the_formats_make() {
        for format in FORMATS {
            let files = files(3, format.name).unwrap();
            assert!(files.iter().all(|name| is_export(name)), "{files:?}");
        }
        assert!(
            [true, false]
                .iter()
                .all(|pdf| is_export(&certificate_file(2, *pdf)))
        );
        assert_eq!(
            files(0, "pbrt").unwrap(),
            ["fit-0-pbrt.pbrt", "fit-0-pbrt.spectral.bsdf"]
        );
        assert_eq!(files(0, "exe"), None);
        for name in [
            "fit-0-json.exe",
            "fit-0-certificate.exe",
            "fit-x-certificate.pdf",
            "fit--json.json",
            "json",
            "fit-0-gltf.json",
            "fit-0-json.json/",
        ] {
            assert!(!is_export(name), "{name}");
        }
    }

    #[test]
    fn no_link_leads_to_the_folder_of_exports() {
        let folder = tempfile::tempdir().unwrap();
        let (sessions, outside) = (
            folder.path().join("sessions"),
            folder.path().join("outside"),
        );
        std::fs::create_dir(&sessions).unwrap();
        std::fs::create_dir(&outside).unwrap();
        for _ in 0..2 {
            let made = super::folder(&sessions, "a").unwrap();
            assert!(made.is_dir());
        }
        let link = |at: &str| std::os::unix::fs::symlink(&outside, sessions.join(at)).unwrap();
        link(".exports/b");
        assert!(super::folder(&sessions, "b").is_err());
        std::fs::remove_dir_all(sessions.join(EXPORTS_ROOT)).unwrap();
        link(EXPORTS_ROOT);
        assert!(super::folder(&sessions, "a").is_err());
        assert_eq!(std::fs::read_dir(&outside).unwrap().count(), 0);
    }
}
