//! Sessions on the disk as pages see them, whole and hostile.

use std::os::unix::fs::symlink;
use std::sync::Arc;

use super::*;
use crate::console::catalogue::exports::EXPORTS_ROOT;
use crate::fault::Advisor;
use crate::session::SessionWriter;
use crate::session::commit::SystemDisk;
use crate::session::example::fitted_session;
use crate::session::fit_record::{self, FitImages, Verdict};
use crate::session::validation;

#[test]
fn a_session_is_shown_with_its_fits_and_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let name = fitted_session(folder.path());
    let pages = SessionPages::new(folder.path(), Advisor::silent());
    let row = pages.catalogue().list("").unwrap().remove(0);
    assert!(row.complete && row.report && row.error.is_none(), "{row:?}");
    let [fit] = row.fits.as_slice() else {
        panic!("{row:?}");
    };
    let sample = crate::session::example::fit();
    assert_eq!(fit.verdict, Some(sample.verdict()));
    assert_eq!(
        (fit.name.as_str(), fit.chi2),
        ("0", sample.worst_reduced_chi_square())
    );
    assert!(fit.environment_error.is_some_and(|error| error > 0.0));

    let detail = serde_json::to_value(pages.detail(&name).unwrap()).unwrap();
    assert_eq!(detail["report_fit"], serde_json::Value::Null);
    let report = folder.path().join(&name).join("report.html");
    std::fs::write(report, "<meta name=\"rig-fit\" content=\"3\">").unwrap();
    assert_eq!(
        pages.detail(&name).unwrap().report_fit.as_deref(),
        Some("3")
    );
    assert_eq!(detail["name"], name.as_str());
    let fits = detail["fits"].as_array().unwrap();
    assert_eq!(fits.len(), 1, "{detail}");
    assert_eq!(fits[0]["dictionary"], "paper42");
    assert_eq!(fits[0]["settings"]["Seed"], "7");
    assert!(!fits[0]["warnings"].as_array().unwrap().is_empty());
    let pictures = fits[0]["pictures"].as_array().unwrap();
    assert_eq!(pictures.len(), 5, "{pictures:?}");
    let mut sizes = Vec::new();
    for picture in pictures {
        let served = pages
            .file(&name, picture["name"].as_str().unwrap())
            .unwrap();
        let picture = image::load_from_memory(&served.bytes).unwrap();
        sizes.push((picture.width(), picture.height()));
    }
    // R, G and B of 6 pixels, each with a gap of 4.
    assert_eq!(sizes[1..], [(30, 4), (6, 4), (30, 4), (6, 4)]);
    // The material, the truth and 18% grey.
    assert!(sizes[0].0 > 256 && sizes[0].1 == 3 * 132, "{sizes:?}");
    // The latest validation, with the picture that is a file.
    assert_eq!(detail["validation"], serde_json::Value::Null);
    let root = folder.path().join(&name);
    let mut writer = SessionWriter::open(Arc::new(SystemDisk), &root).unwrap();
    let picture = vec![(validation::picture_file(1), b"png".to_vec())];
    validation::commit(&mut writer, &validation::example(), &picture).unwrap();
    drop(writer);
    let detail = serde_json::to_value(pages.detail(&name).unwrap()).unwrap();
    let shown = &detail["validation"];
    assert_eq!(shown["rows"][1][1], "5.5%", "{shown}");
    let picture = shown["pictures"][0]["name"].as_str().unwrap();
    assert_eq!(*pages.file(&name, picture).unwrap().bytes, b"png");
    // Against itself and against a second one.
    assert!(matches!(
        pages.compare(&format!("{name}:0")).unwrap_err(),
        comparison::ComparisonError::Asked { .. }
    ));
    let missing = pages.compare(&format!("{name}:0/{name}:7")).unwrap_err();
    let same = pages.compare(&format!("{name}:0/{name}:0")).unwrap();
    assert!(!missing.to_string().is_empty() && same.fits.len() == 2);
    assert_eq!(same.pairs[0].environment_error, 0.0);
    assert_eq!(same.pairs[0].in_uncertainties, Some(0.0));
    // Made once.
    let residual = || pages.file(&name, "fits/0/residual_L000.png").unwrap().bytes;
    assert!(Arc::ptr_eq(&residual(), &residual()));
}

#[test]
fn a_damaged_fit_is_shown_with_its_error_next_to_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let name = fitted_session(folder.path());
    let root = folder.path().join(&name);
    let mut writer = SessionWriter::open(Arc::new(SystemDisk), &root).unwrap();
    let record = crate::session::example::fit();
    fit_record::commit(&mut writer, &record, &FitImages::default()).unwrap();
    drop(writer);
    std::fs::write(root.join("fits/0/fit.toml"), "format = 1\n").unwrap();
    let pages = SessionPages::new(folder.path(), Advisor::silent());
    let row = pages.catalogue().list("").unwrap().remove(0);
    assert_eq!(row.fits.len(), 2);
    assert!(row.fits[0].error.is_some() && row.fits[0].verdict.is_none());
    assert!(row.fits[1].error.is_none());
    assert!(row.fits[1].verdict >= Some(Verdict::Explains));
    // So is one that a link leads elsewhere.
    std::fs::rename(
        root.join("fits/1/fit.toml"),
        folder.path().join("elsewhere"),
    )
    .unwrap();
    symlink(
        folder.path().join("elsewhere"),
        root.join("fits/1/fit.toml"),
    )
    .unwrap();
    let detail = pages.detail(&name).unwrap();
    let fault = detail.row.fits[1].row.error.as_ref().unwrap();
    assert!(fault.error.contains("symbolic link"), "{fault:?}");
}

#[test]
fn nothing_outside_the_folder_and_nothing_by_a_link_is_read() {
    let outside = tempfile::tempdir().unwrap();
    let folder = outside.path().join("sessions");
    let name = fitted_session(&folder);
    let other = fitted_session(&outside.path().join("others"));
    std::fs::write(outside.path().join("report.html"), "secret").unwrap();
    let exports = folder.join(EXPORTS_ROOT).join(&name);
    std::fs::create_dir_all(&exports).unwrap();
    std::fs::write(exports.join("fit-0-json.json"), "{}").unwrap();
    let secret = outside.path().join("report.html");
    symlink(&secret, exports.join("fit-1-json.json")).unwrap();
    symlink(
        outside.path().join("others").join(&other),
        folder.join("link"),
    )
    .unwrap();
    std::fs::create_dir(folder.join("plain")).unwrap();
    symlink(&secret, folder.join("plain/report.html")).unwrap();
    let pages = SessionPages::new(&folder, Advisor::silent());

    let report = pages.file(&name, "report.html").unwrap();
    assert_eq!(report.shown, served::Shown::Page);
    assert_eq!(
        *pages.file(&name, "exports/fit-0-json.json").unwrap().bytes,
        b"{}"
    );
    for (session, file) in [
        ("..", "report.html"),
        ("", "report.html"),
        (".", "report.html"),
        (".hidden", "report.html"),
        ("../others", "report.html"),
        ("/etc", "report.html"),
        ("link", "report.html"),
        ("plain", "report.html"),
        ("none", "report.html"),
        ("link", "fits/0/spheres.png"),
        (&name, "exports/fit-1-json.json"),
        (&name, "exports/../../x.json"),
        (&name, "../report.html"),
        (&name, "session.toml"),
        (&name, "fits/9/spheres.png"),
        (&name, "fits/0/residual_L007.png"),
    ] {
        let error = pages.file(session, file).unwrap_err();
        assert!(error.is_missing(), "{session} {file}: {error}");
    }
    for session in ["..", "", "link", "none", "../others", "a/b", "\0"] {
        assert!(pages.detail(session).is_err(), "{session:?}");
    }
}
