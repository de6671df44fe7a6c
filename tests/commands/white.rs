//! `rig calibrate white` on a session of several lights, whose strengths are those of the
//! rig file.

use std::path::PathBuf;

use crate::command_support::{changed, good, run, small_bench, text};
use serde_json::Value;

/// The simulated rig with a white plate on it, and no errors of its pose and stage.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let plate = at.join("plate.ply");
    std::fs::write(
        &plate,
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n-30 -30 0\n30 -30 0\n30 30 0\n-30 30 0\n3 0 1 2\n3 0 2 3\n",
    )
    .unwrap();
    let changes = [
        ("timing = \"realistic\"", "timing = \"instant\""),
        (
            "material = \"nbrdf:dark-red-paint\"",
            "brdf = { mixture = [ { weight = 1.0, lambertian = { albedo = 0.99 } } ] }",
        ),
        ("samples_per_pixel = 384", "samples_per_pixel = 16"),
        ("max_reflections = 32", "max_reflections = 1"),
        ("max_frames = 16", "max_frames = 2"),
        ("pose_error_mm = 0.02", "pose_error_mm = 0.0"),
        ("pose_error_deg = 0.1", "pose_error_deg = 0.0"),
        ("azimuth_offset_deg = 0.05", "azimuth_offset_deg = 0.0"),
        ("elevation_offset_deg = -0.05", "elevation_offset_deg = 0.0"),
        ("backlash = 0.2", "backlash = 0.0"),
        ("positioning = 0.05", "positioning = 0.0"),
        ("homing = 0.02", "homing = 0.0"),
    ];
    let rig = changed(small_bench::rig_file(), &changes);
    let (before, after) = rig.split_once("[geometry.sample]").unwrap();
    let (_, after) = after.split_once("# Where the stage's axes are").unwrap();
    let sample = format!("[geometry.sample]\nmesh = {plate:?}\n\n#");
    std::fs::write(at.join("rig.toml"), format!("{before}{sample}{after}")).unwrap();
    small_bench::put_records(at);
    folder
}

#[test]
fn lights_of_a_session_are_compared() {
    let folder = workplace();
    let at = folder.path();
    let capture = [
        "capture", "--light", "0,60", "--light", "120,50", "--no-fit",
    ];
    let captured = good(run(at, &capture));
    let session = PathBuf::from(text(&captured.stdout).lines().last().unwrap());
    let session = session.display().to_string();
    let white = |more: &[&str]| {
        let mut arguments = vec!["calibrate", "white", session.as_str(), "--json"];
        arguments.extend(["--reflectance-std", "0.005", "--reflectance"]);
        arguments.extend(more);
        run(at, &arguments)
    };
    for refused in [
        ["99", "--height=0"],
        ["0.99", "--region=60,60,40,40"],
        ["0.99", "--direction-std=2"],
    ] {
        let output = white(&refused);
        assert_eq!(output.status.code(), Some(1), "{refused:?}");
        assert!(
            text(&output.stderr).contains("hint:"),
            "{}",
            text(&output.stderr)
        );
    }
    assert!(!at.join("calibration/simulated/lights").exists());

    let known = [
        "--direction-std",
        "0.001",
        "--certificate",
        "PTB 4711, 2026-03-01",
    ];
    let found = good(white(&[&["0.99", "--id", "both"], &known[..]].concat()));
    let found: Value = serde_json::from_slice(&found.stdout).unwrap();
    let record = at.join(found["record"].as_str().unwrap());
    let record = std::fs::read_to_string(record).unwrap();
    assert!(
        record.contains("; standard's certificate PTB 4711, 2026-03-01"),
        "{record}"
    );
    let check = |measured: &Value, truth: f64, most_std: f64| {
        let [value, std] = ["value", "std"].map(|key| measured[key].as_f64().unwrap());
        assert!(
            (value - truth).abs() < 4.0 * std && std < most_std * truth,
            "{value} ± {std} for {truth}"
        );
    };
    let lights = found["lights"].as_array().unwrap();
    assert_eq!(lights.len(), 2);
    for light in lights {
        for channel in 0..3 {
            check(&light["relative"][channel], 1.0, 0.01);
        }
        assert!(light["uneven"].as_f64().unwrap() < 0.02, "{light}");
    }
    for (channel, irradiance) in [64.0, 80.0, 48.0].into_iter().enumerate() {
        // The sensor's scale, of which every capture takes its radiance, has its own error.
        let value = found["irradiance_w_m2"][channel]["value"].as_f64().unwrap();
        assert!(
            (value / irradiance - 1.0).abs() < 0.03,
            "{value} for {irradiance}"
        );
    }
    let status = text(&good(run(at, &["calibrate", "status"])).stdout);
    assert!(status.contains("lights     ok"), "{status}");
}
