use std::path::PathBuf;
use std::sync::Arc;

use super::*;
use crate::device::*;
use crate::report::{self, tests::synthetic};
use crate::session::commit::SystemDisk;
use crate::session::*;
use crate::units::Seconds;

fn plan() -> PlanRecord {
    PlanRecord {
        lights: [80.0, 60.0]
            .map(|elevation_deg| StageAngles {
                azimuth_deg: 10.0,
                elevation_deg,
            })
            .into(),
        ..example::plan()
    }
}

fn record(true_material: Option<&str>) -> SessionRecord {
    let mut record = SessionRecord {
        sample: "red-plastic".into(),
        true_material: true_material.map(str::to_owned),
        material: None,
        comment: None,
        config: "[camera]\ndriver = \"simulated\"\n".into(),
        plan: plan(),
        calibration: vec![CalibrationCopy {
            id: "sensor".into(),
            file: "calibration/sensor.toml".into(),
            sha256: "ab12".into(),
        }],
        ..example::record()
    };
    record.versions.camera.model = "bench".into();
    record.versions.camera.serial = String::new();
    record
}

fn frame(repeat: u32, exposure: f64, pilot: bool) -> (RawFrame, Sidecar) {
    let settings = CameraSettings::new(Seconds(exposure), 1.0);
    let raw = RawFrame::new(4, 3, vec![100; 12]);
    let place = plan().lights[0];
    let key = FrameKey::new(0, (exposure * 1e3) as u32, repeat, FrameKind::Light);
    let sidecar = Sidecar {
        pilot,
        stage_target: place,
        stage_position: place,
        frames_discarded: 2,
        ..Sidecar::of_frame(key, LampState::On(LampChannel(0)), settings)
    };
    (raw, sidecar)
}

/// A session of which one of two lights is captured, with a fit if wanted.
fn session(parent: &Path, true_material: Option<&str>, fitted: bool) -> PathBuf {
    let new = NewSession {
        parent,
        created: jiff::Timestamp::UNIX_EPOCH,
        short_id: "0f3a9c",
        record: &record(true_material),
        calibration: &[],
    };
    let mut writer = SessionWriter::create(Arc::new(SystemDisk), &new).unwrap();
    let start = Event::LightStart {
        light: 0,
        azimuth_deg: 10.25,
        elevation_deg: 79.5,
    };
    writer.record(start).unwrap();
    for (repeat, exposure, pilot) in [
        (0, 0.002, true),
        (0, 0.004, false),
        (1, 0.004, false),
        (0, 0.032, false),
    ] {
        let (raw, sidecar) = frame(repeat, exposure, pilot);
        writer.commit_frame(&raw, &sidecar).unwrap();
    }
    let synthetic = synthetic();
    let image = &synthetic.lights[0].captured.as_ref().unwrap().picture;
    let bytes = exr::encode(image, Path::new("radiance")).unwrap();
    writer
        .commit_file(&layout::radiance_file(0), &bytes)
        .unwrap();
    writer.record(Event::LightStop { light: 0 }).unwrap();
    if fitted {
        let fit = synthetic.fit.unwrap();
        let folder = fit_record::commit(&mut writer, &fit.record, &fit.images).unwrap();
        assert!(folder.ends_with("fits/0"));
    }
    writer.root().to_owned()
}

#[test]
fn an_unfinished_session_without_a_fit_loads_as_what_it_is() {
    let home = tempfile::tempdir().unwrap();
    let root = session(home.path(), None, false);
    let input = load_with(&root, None, 8).unwrap();
    assert!(input.fit.is_none() && input.truth.is_none() && input.spheres.is_empty());
    assert_eq!(
        input.incomplete.as_deref(),
        Some("1 of 2 lights are finished.")
    );
    assert_eq!(input.captured, "2026-11-21 02:34 UTC");
    assert_eq!(input.lights.len(), 2);
    let [first, second] = &input.lights[..] else {
        panic!()
    };
    assert_eq!(first.place.unwrap().azimuth_deg, 10.25, "read back");
    assert_eq!(second.place.unwrap().elevation_deg, 60.0, "planned");
    let counted: Vec<_> = first
        .exposures
        .iter()
        .map(|e| (e.exposure.0, e.frames))
        .collect();
    assert_eq!(
        counted,
        [(0.004, 2), (0.032, 1)],
        "pilot frames are no part of the bracket"
    );
    assert!(first.captured.is_some() && second.captured.is_none());
    let html = report::render(&input).unwrap();
    for text in [
        "No fit yet",
        "SHA-256 ab12",
        "driver = &quot;simulated&quot;",
        "bench",
    ] {
        assert!(html.contains(text), "{text}");
    }
}

#[test]
fn a_fitted_session_loads_with_its_fit_and_truth() {
    let home = tempfile::tempdir().unwrap();
    let root = session(home.path(), Some("lambertian:0.5"), true);
    let input = load_with(&root, Some(&FitChoice::Number(0)), 8).unwrap();
    let synthetic = synthetic();
    let fit = input.fit.as_ref().unwrap();
    assert_eq!(fit.record, synthetic.fit.unwrap().record);
    assert_eq!(
        (fit.images.rendered.len(), fit.images.residual.len()),
        (2, 2)
    );
    assert_eq!(input.spheres.len(), EnvironmentMap::all().len());
    let sphere = input.spheres[0].truth.as_ref().unwrap();
    assert!(!sphere.valid[0] && sphere.valid[sphere.valid.len() / 2]);
    let check = crate::session::verify::verify(&root).unwrap();
    assert!(
        check.strays.is_empty(),
        "the fit is journalled: {:?}",
        check.strays
    );

    let error = load_with(&root, Some(&FitChoice::Number(3)), 8)
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("no fit 3") && error.contains("has 0"),
        "{error}"
    );
    std::fs::write(root.join("fits/0/residual_L001.exr"), b"not an image").unwrap();
    let error = load_with(&root, None, 8).err().unwrap().to_string();
    assert!(error.contains("residual_L001.exr"), "{error}");
}

/// What the journal does not vouch for is no fit, and no part of one.
#[test]
fn a_stray_fit_is_not_seen_and_an_edited_one_is_refused() {
    let home = tempfile::tempdir().unwrap();
    let root = session(home.path(), None, true);
    let stray = root.join("fits/7");
    std::fs::create_dir(&stray).unwrap();
    for file in std::fs::read_dir(root.join("fits/0")).unwrap() {
        let file = file.unwrap();
        std::fs::copy(file.path(), stray.join(file.file_name())).unwrap();
    }
    assert_eq!(load_with(&root, None, 8).unwrap().fit.unwrap().name, "0");
    let read = fit_record::read_in(&Session::open(&root).unwrap(), 7);
    let error = read.err().unwrap().to_string();
    assert!(
        error.ends_with("is not in the session's journal"),
        "{error}"
    );
    let weights = root.join("fits/0/weights.csv");
    let text = std::fs::read_to_string(&weights).unwrap();
    std::fs::write(&weights, text.replace("0.5", "0.50")).unwrap();
    let error = load_with(&root, None, 8).err().unwrap().to_string();
    assert!(
        error.contains("weights.csv") && error.contains("the journal records"),
        "{error}"
    );
}

#[test]
fn a_truth_that_cannot_be_evaluated_is_said_and_takes_only_the_comparison() {
    let home = tempfile::tempdir().unwrap();
    let root = session(home.path(), Some("unobtainium"), false);
    let input = load_with(&root, None, 8).unwrap();
    assert!(input.truth.is_none());
    let html = report::render(&input).unwrap();
    assert!(html.contains("unobtainium (cannot be evaluated: "));
}
