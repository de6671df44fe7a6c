//! A small complete session with a fit, made by the library without a capture: for tests of what
//! states results.

// Each test uses some of it.
#![allow(dead_code)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rig::brdf::{Dictionary, Mixture};
use rig::config::BUILT_IN;
use rig::device::{CameraSettings, FrameKey, FrameKind, LampChannel, LampState, RawFrame};
use rig::session::commit::SystemDisk;
use rig::session::fit_record::{
    self, AngleTable, BudgetRecord, BudgetRow, FitImages, FitRecord, Interval,
};
use rig::session::{
    CalibrationCopy, Event, NewSession, SessionRecord, SessionWriter, Sidecar, example,
};
use rig::units::Seconds;

/// A lab that states everything.
pub const LAB: &str = r#"
[lab]
organisation = "Institute of Optics"
laboratory = "Reflectometry <1>"
operator = "A. Miller"
contact = "B. Jones"
email = "reflectometry@example.org"
website = "https://example.org/reflectometry"
street = "Long Street"
building = "8"
postal_code = "02150"
city = "Espoo"
country = "Finland"
room_temperature_c = 22.5
room_humidity_percent = 45
band_r_nm = [605, 640]
band_g_nm = [510, 550]
band_b_nm = [450, 480]
camera_band_nm = [400, 1000]
lamp_power_w = 9.0
"#;

/// A record of the lights' irradiance.
const LIGHTS: &str = r#"id = "20261101T100000Z-lights"
kind = "lights"
rig = "simulated"
device_serial = "SIM-0001"
date = "2026-11-01T10:00:00Z"
method = "diffuse standard of reflectance 0.985 ± 0.004"
source = "session 20261101T093000Z_white_0a1b2c"

[values]
irradiance_w_m2 = [{ value = 3.1, std = 0.0155 }, { value = 3.2, std = 0.016 }, { value = 3.0, std = 0.03 }]
"#;

/// A fit of `paper42` with a table that is constrained up to θh = 40° and a budget of two rows.
pub fn fit(simulated: bool) -> FitRecord {
    let dictionary = Dictionary::paper42();
    let channel = |gloss: usize, share: f64| {
        let mut weights = vec![0.0; dictionary.len()];
        (weights[gloss], weights[40], weights[41]) = (share, 0.3, 0.7 - share);
        weights
    };
    let theta_h_deg: Vec<f64> = (0..=9).map(|i| f64::from(i * i) / 0.9).collect();
    let theta_d_deg: Vec<f64> = (0..=6).map(|j| 15.0 * f64::from(j)).collect();
    let cell = |h: f64, d: f64| {
        let value = [0, 1, 2].map(|c| 0.1 + 0.01 * f64::from(c) + 0.2 / (1.0 + h) + 1e-3 * d);
        Interval {
            value,
            lower: value.map(|f| 0.9 * f),
            upper: value.map(|f| 1.15 * f),
            constrained: h <= 40.0 && d <= 75.0,
        }
    };
    let cells = theta_h_deg.iter();
    let cells = cells.flat_map(|&h| theta_d_deg.iter().map(move |&d| cell(h, d)));
    let row = |theta_h_deg: f64, theta_d_deg: f64, value: f64, relative_std: f64| BudgetRow {
        theta_h_deg,
        theta_d_deg,
        value,
        relative_std,
        share: vec![0.1, 0.2, 0.7],
    };
    let weights = [channel(6, 0.5), channel(2, 0.35), channel(10, 0.6)];
    let mixture = Mixture::new(Arc::new(dictionary), weights).unwrap();
    FitRecord {
        simulated,
        reduced_chi_square: vec![[1.0; 3]],
        versions: BTreeMap::from([("rig".to_owned(), "0.2.0".to_owned())]),
        table: AngleTable {
            cells: cells.collect(),
            theta_h_deg,
            theta_d_deg,
        },
        budget: Some(BudgetRecord {
            sources: ["capture noise", "pose", "model"].map(str::to_owned).into(),
            row: vec![
                row(0.0, 15.0, 0.312_345_678_9, 0.041_234_567_8),
                row(40.0, 45.0, 0.123_456_789, 0.087_654_321),
            ],
        }),
        ..FitRecord::of_mixture(&mixture)
    }
}

/// The session's folder; `lab` is appended to its rig file.
pub fn session(parent: &Path, fit: &FitRecord, lab: &str, complete: bool) -> PathBuf {
    let record = record(fit.simulated, lab);
    let new = NewSession {
        parent,
        created: "2026-11-21T02:34:00Z".parse().unwrap(),
        short_id: "0f3a9c",
        record: &record,
        calibration: &[(
            "lights/20261101T100000Z-lights.toml".to_owned(),
            LIGHTS.into(),
        )],
    };
    let mut writer = SessionWriter::create(Arc::new(SystemDisk), &new).unwrap();
    writer
        .record(Event::LightStart {
            light: 0,
            azimuth_deg: 10.0,
            elevation_deg: 80.0,
        })
        .unwrap();
    let key = FrameKey::new(0, 0, 0, FrameKind::Light);
    let settings = CameraSettings::new(Seconds(0.004), 1.0);
    let raw = RawFrame::new(4, 3, vec![100; 12]);
    let sidecar = Sidecar::of_frame(key, LampState::On(LampChannel(0)), settings);
    writer.commit_frame(&raw, &sidecar).unwrap();
    writer.record(Event::LightStop { light: 0 }).unwrap();
    fit_record::commit(&mut writer, fit, &FitImages::default()).unwrap();
    if complete {
        writer.finish().unwrap();
    }
    writer.root().to_owned()
}

fn record(simulated: bool, lab: &str) -> SessionRecord {
    let (_, rig) = BUILT_IN[0];
    let rig = rig.replace("\n[lab]\n", "\n");
    let mut record = SessionRecord {
        sample: "red-plastic".to_owned(),
        material: Some("red paint, batch 12".to_owned()),
        simulated,
        true_material: None,
        config: format!("{rig}\n{lab}"),
        calibration: vec![CalibrationCopy {
            id: "lights/20261101T100000Z-lights".to_owned(),
            file: "calibration/lights/20261101T100000Z-lights.toml".to_owned(),
            sha256: rig::checksum::sha256_hex(LIGHTS.as_bytes()),
        }],
        ..example::record()
    };
    record.versions.rig = "0.2.0".to_owned();
    let camera = &mut record.versions.camera;
    let [driver, model, serial] = ["v4l", "bench", "s-17"].map(str::to_owned);
    (camera.driver, camera.model, camera.serial) = (driver, model, serial);
    record.plan.lights.truncate(1);
    record
}
