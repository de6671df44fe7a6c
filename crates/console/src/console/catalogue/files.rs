//! Which files of a session a page may read, and as what.

use std::sync::Arc;

use super::exports::{EXPORTS_FOLDER, EXPORTS_ROOT, is_export};
use super::pages::SessionPages;
use super::pictures::{self, PictureOf};
use super::served::{FileError, Served, Shown};
use crate::beneath;
use crate::catalogue::row;
use crate::session::fit_record::POSTERIOR_FILE;
use crate::session::layout::{FITS_FOLDER, REPORT_FILE, VALIDATIONS_FOLDER};
use crate::session::validation;

/// A MERL table has 35 MB, a spectral one up to some 100 MB.
const LARGEST_FILE_BYTES: u64 = 512 << 20;

const PLAIN: &str = "text/plain; charset=utf-8";
const PNG: &str = "image/png";
const BYTES: &str = "application/octet-stream";

/// Files of a fit that may be read.
const OF_A_FIT: &[&str] = &[
    "fit.toml",
    "weights.csv",
    "table.csv",
    "trace.csv",
    "cells.csv",
    "discrepancy.csv",
];

/// What may be read under a name.
#[derive(Debug, PartialEq, Eq)]
enum Allowed {
    File(&'static str, Shown),
    Picture(PictureOf),
}

/// By the name alone: whether there is such a file is found out later.
fn allowed(file: &str) -> Option<Allowed> {
    if file == REPORT_FILE {
        return Some(Allowed::File("text/html; charset=utf-8", Shown::Page));
    }
    if let Some(picture) = PictureOf::parse(file) {
        return Some(Allowed::Picture(picture));
    }
    let (folder, name) = file.rsplit_once('/')?;
    if folder == EXPORTS_FOLDER {
        // An export's picture is shown next to its download.
        let as_what = match name.ends_with(".png") {
            true => Allowed::File(PNG, Shown::Inline),
            false => Allowed::File(BYTES, Shown::Download),
        };
        return is_export(name).then_some(as_what);
    }
    if let Some(number) = folder.strip_prefix(VALIDATIONS_FOLDER) {
        let number: u32 = number.strip_prefix('/')?.parse().ok()?;
        return of_a_validation(number, file);
    }
    let number = folder.strip_prefix(FITS_FOLDER)?.strip_prefix('/')?;
    number.parse::<u32>().ok()?;
    if name == POSTERIOR_FILE {
        return Some(Allowed::File(BYTES, Shown::Download));
    }
    OF_A_FIT
        .contains(&name)
        .then_some(Allowed::File(PLAIN, Shown::Inline))
}

/// A file of a validation; numbers have one spelling.
fn of_a_validation(number: u32, file: &str) -> Option<Allowed> {
    let name = file.rsplit_once('/')?.1;
    let light = name
        .strip_prefix("light_L")
        .and_then(|rest| rest.strip_suffix(".png"));
    let (kind, own) = match light {
        Some(light) => (PNG, validation::picture_file(light.parse().ok()?)),
        None => (PLAIN, validation::VALIDATION_FILE.to_owned()),
    };
    let is_it = file == validation::inside(number, &own);
    is_it.then_some(Allowed::File(kind, Shown::Inline))
}

impl SessionPages {
    /// A file of a session: one that is there, or a picture that is made of its images.
    /// Takes up to some seconds for a picture that is not known yet.
    ///
    /// # Errors
    /// See [`FileError`].
    pub fn file(&self, session: &str, file: &str) -> Result<Served, FileError> {
        let not_shown = || FileError::NotShown {
            file: file.to_owned(),
        };
        row::check_name(session)?;
        match allowed(file).ok_or_else(not_shown)? {
            Allowed::File(kind, shown) => {
                let path = match file.strip_prefix(EXPORTS_FOLDER) {
                    Some(export) => format!("{EXPORTS_ROOT}/{session}{export}"),
                    None => row::path(session, file),
                };
                let bytes = beneath::read(self.catalogue().folder(), &path, LARGEST_FILE_BYTES)?;
                Ok(Served {
                    kind,
                    shown,
                    bytes: Arc::new(bytes),
                })
            }
            Allowed::Picture(picture) => self.kept_or(session, file, || {
                let open = row::open(self.catalogue().folder(), session)?;
                Ok(Served {
                    kind: PNG,
                    shown: Shown::Inline,
                    bytes: Arc::new(pictures::png(&open, picture)?),
                })
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_decide_what_is_shown() {
        use Shown::*;
        for (file, shown) in [
            ("report.html", Page),
            ("fits/0/fit.toml", Inline),
            ("fits/12/table.csv", Inline),
            ("fits/0/posterior.npy", Download),
            ("validations/0/validation.json", Inline),
            ("validations/12/light_L003.png", Inline),
            ("exports/fit-0-merl.binary", Download),
            ("exports/fit-0-merl.binary.txt", Download),
            ("exports/fit-0-openpbr.mtlx.png", Inline),
            ("exports/fit-0-certificate.html", Download),
        ] {
            match allowed(file) {
                Some(Allowed::File(_, as_what)) => assert_eq!(as_what, shown, "{file}"),
                other => panic!("{file}: {other:?}"),
            }
        }
        for file in ["fits/0/residual_L000.png", "fits/0/spheres.png"] {
            assert!(matches!(allowed(file), Some(Allowed::Picture(_))), "{file}");
        }
        for file in [
            "",
            "session.toml",
            "journal.jsonl",
            "raw/L000_E00_R00_light.png",
            "report.html/",
            "REPORT.HTML",
            "sub/report.html",
            "fits/x/fit.toml",
            "fits/0/fit.toml.bak",
            "fits/0/../1/fit.toml",
            "fits/0/secret.csv",
            "exports/run.sh",
            "exports/brdf.binary",
            "exports/page.html",
            "exports/deep/fit-0-merl.binary",
            "exports/binary",
            "validations/0/light_L3.png",
            "validations/00/validation.json",
            "validations/0/../1/validation.json",
            "validations/light_L003.png",
            "calibration/sensor.toml",
        ] {
            assert_eq!(allowed(file), None, "{file}");
        }
    }
}
