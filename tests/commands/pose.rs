//! `rig calibrate pose` as the operator meets it: from a session to a record, and what
//! status says of it.

use std::path::Path;

use crate::command_support::{good, json, printed_session, run, small_bench_with, text};
use serde_json::Value;

/// Captures and returns the session's folder.
fn capture(at: &Path, lights: &str) -> String {
    let captured = good(run(at, &["capture", "--lights", lights, "--no-fit"]));
    printed_session(&captured).display().to_string()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Error of the alignment that its stated uncertainty does not hold and that shows where images
/// are nearly free of noise: up to 0.3° at pixels of 0.34 mm.
const OWN_DEG: f64 = 0.15;

/// The simulated bench's sample lies within what the record says of where it truly is.
#[test]
fn a_pose_is_measured_and_kept() {
    let folder = small_bench_with(&[
        ("\"realistic\"", "\"instant\""),
        ("samples_per_pixel = 384", "samples_per_pixel = 192"),
    ]);
    let at = folder.path();
    let library = at.join("calibration/simulated");
    let session = &capture(at, "3");
    let found = json(run(
        at,
        &["calibrate", "pose", session, "--id", "p", "--json"],
    ));
    assert!(library.join("pose/p.toml").is_file());
    assert!(library.join("plots/p.svg").is_file());
    // Seed, position and orientation errors stand in the rig file.
    let [rotation_rad, translation_mm] = rig::simulation::pose_error(7, 0.02, 0.1);
    for axis in 0..3 {
        for (key, offset, truth) in [
            ("rotation_deg", 0, rotation_rad[axis].to_degrees()),
            ("translation_mm", 3, translation_mm[axis]),
        ] {
            let k = offset + axis;
            let std = number(&found["covariance"][k][k]).sqrt();
            let error = number(&found[key][axis]) - truth;
            eprintln!("{key}[{axis}]: {error:.4} ± {std:.4}");
            // Six numbers at 1e-3 together, and the alignment's own error where images are as free
            // of noise as these.
            let own = if key == "rotation_deg" { OWN_DEG } else { 0.0 };
            assert!(
                error.abs() < 4.0 * std + own,
                "{key}[{axis}]: {error} ± {std}"
            );
        }
    }
    // Across the view, a pixel being 0.34 mm.
    for axis in 0..2 {
        let error = number(&found["translation_mm"][axis]) - translation_mm[axis];
        assert!(error.abs() < 0.034, "{axis}: {error} mm");
    }
    let status = json(run(at, &["calibrate", "status", "--json"]));
    let records = status["records"].as_array().unwrap();
    let pose = records.iter().find(|line| line["kind"] == "pose").unwrap();
    assert_eq!(pose["state"], "good");

    // The same name again: refused, and the record is as it was.
    let before = std::fs::read(library.join("pose/p.toml")).unwrap();
    let again = run(at, &["calibrate", "pose", session, "--id", "p"]);
    assert_eq!(again.status.code(), Some(1));
    assert_eq!(std::fs::read(library.join("pose/p.toml")).unwrap(), before);

    // The bench's material has no grain, so that a second capture is one of a turned sample.
    let other = capture(at, "3");
    let turned = format!("{other}=90");
    let arguments = ["calibrate", "pose", session, "--rotate", &turned];
    let said = text(&good(run(at, &arguments)).stdout);
    for what in ["uniformity: passed", "isotropy: passed"] {
        assert!(said.contains(what), "{said}");
    }
    let missing = run(at, &["calibrate", "pose", session, "--rotate", "nowhere"]);
    assert_eq!(missing.status.code(), Some(1));
}

/// A bench whose sample, lens and stage all stand otherwise than its rig file says: with
/// records of lens and directions the pose is found.
#[test]
fn a_pose_uses_the_records_of_lens_and_lights() {
    let lens = "principal_point_px = [34.5, 30.5]\nradial = [0.02, 0.0, 0.0]\n";
    let folder = small_bench_with(&[
        ("\"realistic\"", "\"instant\""),
        ("samples_per_pixel = 384", "samples_per_pixel = 192"),
        ("pose_error_mm = 0.02", "pose_error_mm = 0.25"),
        ("pose_error_deg = 0.1", "pose_error_deg = 0.8"),
        ("translation_mm = 0.2", "translation_mm = 0.3"),
        ("rotation_deg = 0.2", "rotation_deg = 1.0"),
        ("azimuth_offset_deg = 0.05", "azimuth_offset_deg = 1.2"),
        (
            "elevation_offset_deg = -0.05",
            "elevation_offset_deg = -0.9",
        ),
        // The directions' record below knows of none.
        ("backlash = 0.2", "backlash = 0.0"),
        ("[simulation.lens]", &format!("[simulation.lens]\n{lens}")),
    ]);
    let at = folder.path();
    let library = at.join("calibration/simulated");
    let head = |id: &str, kind: &str| {
        format!(
            "id = \"{id}\"\nkind = \"{kind}\"\nrig = \"simulated\"\ndevice_serial = \"SIM-0001\"\n\
             date = \"2026-11-21T00:00:00Z\"\nmethod = \"m\"\nsource = \"s\"\n[values]\n"
        )
    };
    // What `rig calibrate lights` and `camera` would find of this truth.
    let directions = head("d", "directions")
        + "light_std_deg = 0.06\ncommon_std_deg = 0.03\n\
        [values.stage]\nrotation_deg = [0.0, 0.0, 1.2]\nelevation_offset_deg = -0.9\n\
        covariance_deg2 = [[1e-3, 0.0, 0.0, 0.0], [0.0, 1e-3, 0.0, 0.0], [0.0, 0.0, 1e-3, 0.0], [0.0, 0.0, 0.0, 1e-3]]\n\
        scatter_deg = 0.06\n[[values.lights]]\nstage_deg = [0.0, 90.0]\nto_light = [0.0, 0.0, 1.0]\n\
        covariance_deg2 = [[1e-3, 0.0], [0.0, 1e-3]]\n";
    let camera = head("c", "camera")
        + "model = \"orthographic\"\nresolution_px = [64, 64]\nscale = [2.909090909090909, 2.909090909090909]\n\
        principal_point_px = [34.5, 30.5]\nradial = [0.02, 0.0, 0.0]\ntangential = [0.0, 0.0]\n\
        found = [\"mx\"]\ncovariance = [[1e-6]]\nviews = 1\ncorners = [48, 0]\nresidual_px = 0.02\n\
        reduced_chi2 = 1.0\n";
    for (kind, name, text) in [("directions", "d", directions), ("camera", "c", camera)] {
        std::fs::create_dir_all(library.join(kind)).unwrap();
        std::fs::write(library.join(kind).join(format!("{name}.toml")), text).unwrap();
    }
    let session = &capture(at, "3");
    assert!(
        at.join(session).join("calibration/camera/c.toml").is_file(),
        "no copy"
    );
    let arguments = ["calibrate", "pose", session, "--id", "p", "--json"];
    let measured = good(run(at, &arguments));
    let said = text(&measured.stderr);
    assert!(said.contains("light directions by record d"), "{said}");
    assert!(said.contains("lens by record c"), "{said}");
    let found: Value = serde_json::from_slice(&measured.stdout).unwrap();
    let [rotation_rad, translation_mm] = rig::simulation::pose_error(7, 0.25, 0.8);
    for axis in 0..3 {
        for (key, k, truth) in [
            ("rotation_deg", axis, rotation_rad[axis].to_degrees()),
            ("translation_mm", 3 + axis, translation_mm[axis]),
        ] {
            let std = number(&found["covariance"][k][k]).sqrt();
            let error = number(&found[key][axis]) - truth;
            eprintln!("{key}[{axis}]: {error:.4} ± {std:.4} of {truth:.4}");
            let own = if key == "rotation_deg" { OWN_DEG } else { 0.0 };
            assert!(
                error.abs() < 4.0 * std + own,
                "{key}[{axis}]: {error} ± {std}"
            );
        }
    }
}
