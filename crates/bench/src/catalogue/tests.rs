//! Sessions on the disk, whole and damaged.

use std::path::Path;
use std::sync::Arc;

use crate::radiance_image::RadianceImage;
use crate::session::commit::SystemDisk;
use crate::session::fit_record::{self, FitImages};
use crate::session::layout::session_name;
use crate::session::*;

fn record(sample: &str, began: &str) -> SessionRecord {
    SessionRecord {
        sample: sample.to_owned(),
        created_utc: began.to_owned(),
        true_material: Some("ggx:0.1,1.5".to_owned()),
        ..example::record()
    }
}

/// Makes an interrupted session in the folder and returns its name.
pub fn session(folder: &Path, sample: &str, began: &str) -> String {
    let new = NewSession {
        parent: folder,
        created: began.parse().unwrap(),
        short_id: "0f3a",
        record: &record(sample, began),
        calibration: &[],
    };
    let writer = SessionWriter::create(Arc::new(SystemDisk), &new).unwrap();
    drop(writer);
    session_name(began.parse().unwrap(), sample, "0f3a").unwrap()
}

/// Adds a fit without images to a session.
pub fn add_fit(folder: &Path, session: &str, record: &fit_record::FitRecord) {
    let root = folder.join(session);
    let mut writer = SessionWriter::open(Arc::new(SystemDisk), &root).unwrap();
    fit_record::commit(&mut writer, record, &FitImages::default()).unwrap();
}

/// With a fit of two lights and a report, its capture ended.
pub fn fitted_session(folder: &Path) -> String {
    let name = session(folder, "bowl", "2026-11-21T02:34:00Z");
    let mut writer = SessionWriter::open(Arc::new(SystemDisk), &folder.join(&name)).unwrap();
    let image = || {
        let mut image = RadianceImage::new(6, 4);
        image.mean.fill([1.0, -2.0, 0.5]);
        image
    };
    let images = FitImages {
        rendered: vec![image(), image()],
        residual: vec![image(), image()],
        cells_csv: String::new(),
    };
    fit_record::commit(&mut writer, &fit_record::tests::sample(), &images).unwrap();
    writer
        .commit_file("report.html", b"<!doctype html>report")
        .unwrap();
    writer.finish().unwrap();
    name
}
