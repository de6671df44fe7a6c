//! Small sessions and their records, for tests of what reads and writes them.

use std::path::Path;
use std::sync::Arc;

use super::commit::SystemDisk;
pub use super::fit_record::example::fit;
use super::fit_record::{self, FitImages, FitRecord};
use super::layout::session_name;
use super::{ExposureRules, NewSession, PlanRecord, SessionRecord, SessionWriter, Versions};
use crate::device::{CameraInfo, LampChannel, Mosaic, StageInfo};
use crate::radiance_image::RadianceImage;
use crate::units::{Seconds, StageAngles};

/// Two lights at one direction, a camera of 4 × 3 pixels.
pub fn record() -> SessionRecord {
    SessionRecord {
        sample: "bowl".to_owned(),
        created_utc: "2026-11-21T02:34:00Z".to_owned(),
        simulated: true,
        true_material: Some("red plastic".to_owned()),
        material: None,
        comment: None,
        seed: 7,
        rig: "simulated".to_owned(),
        config: "[camera]\nname = \"x\"\n".to_owned(),
        versions: Versions {
            rig: "0.1.0".to_owned(),
            camera: CameraInfo {
                driver: "simulated".to_owned(),
                model: "m".to_owned(),
                serial: "s".to_owned(),
                resolution_px: [4, 3],
                bit_depth: 12,
                mosaic: Mosaic::None,
                exposure_range: [Seconds(1e-4), Seconds(1.0)],
                exposure_step: Seconds(1e-4),
            },
            stage: StageInfo {
                driver: "grbl".to_owned(),
                firmware: "1.1h".to_owned(),
                port: "/dev/x".to_owned(),
                has_watchdog: false,
            },
        },
        plan: plan(),
        calibration: Vec::new(),
    }
}

/// The plan of [`record`].
pub fn plan() -> PlanRecord {
    PlanRecord {
        channels: vec![LampChannel(0)],
        gain: 1.0,
        exposure: ExposureRules {
            pilot_s: Seconds(0.002),
            shortest_s: Seconds(0.001),
            longest_s: Seconds(1.0),
            step_s: Seconds(0.0001),
            peak_fraction: 0.7,
            dark_snr: 20.0,
            ratio: 4.0,
            max_frames: 4,
            ambient: true,
            dark_frames: 2,
        },
        settle_s: Seconds(0.1),
        lamp_settle_s: Seconds(0.0),
        lamp_warm_up_s: Seconds(0.0),
        settings_latency_frames: 2,
        revisit_first: false,
        stage_tolerance_deg: 0.0,
        limits: Default::default(),
        estimated_s: Seconds(12.0),
        estimated_bytes: 1000,
        estimated_files: 0,
        until: None,
        lights: vec![StageAngles::new(10.0, 80.0); 2],
    }
}

fn of(sample: &str, began: &str) -> SessionRecord {
    SessionRecord {
        sample: sample.to_owned(),
        created_utc: began.to_owned(),
        true_material: Some("ggx:0.1,1.5".to_owned()),
        ..record()
    }
}

/// Makes an interrupted session in the folder and returns its name.
pub fn session(folder: &Path, sample: &str, began: &str) -> String {
    let new = NewSession {
        parent: folder,
        created: began.parse().unwrap(),
        short_id: "0f3a",
        record: &of(sample, began),
        calibration: &[],
    };
    let writer = SessionWriter::create(Arc::new(SystemDisk), &new).unwrap();
    drop(writer);
    session_name(began.parse().unwrap(), sample, "0f3a").unwrap()
}

/// Adds a fit without images to a session.
pub fn add_fit(folder: &Path, session: &str, record: &FitRecord) {
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
    fit_record::commit(&mut writer, &fit(), &images).unwrap();
    writer
        .commit_file("report.html", b"<!doctype html>report")
        .unwrap();
    writer.finish().unwrap();
    name
}
