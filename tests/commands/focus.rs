//! `rig calibrate focus` from capture to record on the simulated rig, whose lens is less sharp
//! than its rig file says.

use crate::command_support::{changed, good, printed_session, run, small_bench, text};
use serde_json::Value;

const POINT_SPREAD_PX: f64 = 0.8;
const OBJECT_NA: f64 = 0.06;
const FOCUS_MM: f64 = 201.0;

/// A white half plane at a height, its edge turned by 7°.
fn target(height_mm: f64) -> String {
    let (sin, cos) = 7f64.to_radians().sin_cos();
    let corners = [(0.3, -30.0), (30.0, -30.0), (30.0, 30.0), (0.3, 30.0)];
    let corners = corners.map(|(u, v)| {
        let (x, y) = (u * cos - v * sin, u * sin + v * cos);
        format!("{x} {y} {height_mm}\n")
    });
    format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n{}3 0 1 2\n3 0 2 3\n",
        corners.concat()
    )
}

/// The simulated rig with such a target as its sample, and a rig file for each height.
fn workplace(heights_mm: &[f64]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let lens = format!(
        "[simulation.lens]\npoint_spread_px = {POINT_SPREAD_PX}\nobject_na = {OBJECT_NA}\nfocus_mm = {FOCUS_MM}\n"
    );
    let changes = [
        ("[simulation.lens]\n", lens.as_str()),
        ("timing = \"realistic\"", "timing = \"instant\""),
        (
            "material = \"nbrdf:dark-red-paint\"",
            "brdf = { mixture = [ { weight = 1.0, lambertian = { albedo = 0.8 } } ] }",
        ),
        ("samples_per_pixel = 384", "samples_per_pixel = 600"),
        // The surroundings of the target are black: nothing is gained by waiting for its light.
        ("snr = 20.0", "snr = 1.0"),
        ("max_frames = 16", "max_frames = 2"),
        ("max_reflections = 32", "max_reflections = 1"),
        ("pose_error_mm = 0.02", "pose_error_mm = 0.0"),
        ("pose_error_deg = 0.1", "pose_error_deg = 0.0"),
    ];
    let common = changed(small_bench::rig_file(), &changes);
    std::fs::write(at.join("rig.toml"), &common).unwrap();
    let (before, after) = common.split_once("[geometry.sample]").unwrap();
    let (_, after) = after.split_once("# Where the stage's axes are").unwrap();
    for (i, height_mm) in heights_mm.iter().enumerate() {
        std::fs::write(at.join(format!("target{i}.ply")), target(*height_mm)).unwrap();
        let mesh = at.join(format!("target{i}.ply"));
        let sample = format!("[geometry.sample]\nmesh = {mesh:?}\n\n#");
        std::fs::write(
            at.join(format!("target{i}.toml")),
            format!("{before}{sample}{after}"),
        )
        .unwrap();
    }
    small_bench::put_records(at);
    folder
}

#[test]
fn a_lens_is_measured_and_captures_use_it() {
    let heights_mm = [-9.0, -1.0, 6.0];
    let folder = workplace(&heights_mm);
    let at = folder.path();
    let sessions: Vec<String> = (0..3)
        .map(|i| {
            let rig_file = format!("target{i}.toml");
            let arguments = ["capture", "--rig", &rig_file, "--light", "0,90", "--no-fit"];
            let session = printed_session(&good(run(at, &arguments)));
            session.display().to_string()
        })
        .collect();
    let focus = |more: &[&str]| {
        let mut arguments = vec!["calibrate", "focus", "--json"];
        arguments.extend(sessions.iter().map(String::as_str));
        arguments.extend(more);
        run(at, &arguments)
    };
    // Heights that are not those of the edges' images.
    let few = focus(&["--heights=-9,-1"]);
    assert_eq!(few.status.code(), Some(1));
    assert!(
        text(&few.stderr).contains("3 images and 0 regions"),
        "{}",
        text(&few.stderr)
    );
    let outside = focus(&["--heights=-9,-1,6", "--region", "40,4,20,20"]);
    assert_eq!(outside.status.code(), Some(1));
    assert!(
        text(&outside.stderr).contains("hint:"),
        "{}",
        text(&outside.stderr)
    );
    assert!(!at.join("calibration/simulated/focus").exists());

    let found = good(focus(&["--heights=-9,-1,6", "--id", "lens"]));
    let found: Value = serde_json::from_slice(&found.stdout).unwrap();
    let check = |measured: &Value, truth: f64, most_std: f64| {
        let [value, std] = ["value", "std"].map(|key| measured[key].as_f64().unwrap());
        assert!(
            (value - truth).abs() < 4.0 * std && std < most_std,
            "{value} ± {std} for {truth}"
        );
    };
    check(&found["point_spread_px"], POINT_SPREAD_PX, 0.05);
    check(&found["lens"]["focus_mm"], FOCUS_MM, 1.0);
    check(&found["lens"]["object_na"], OBJECT_NA, 0.01);
    assert!(at.join("calibration/simulated/plots/lens.svg").exists());
    let status = text(&good(run(at, &["calibrate", "status"])).stdout);
    assert!(status.contains("focus      ok"), "{status}");

    // The bowl is deeper than the depth of field, which is said; a session gets its copy.
    let planned = good(run(at, &["capture", "--lights", "2", "--dry-run"]));
    let warning = text(&planned.stderr);
    assert!(
        warning.contains("depth of field") && warning.contains("heights from"),
        "{warning}"
    );
    let doctor = text(&run(at, &["doctor"]).stdout);
    assert!(doctor.contains("warning  depth of field"), "{doctor}");
    let arguments = [
        "capture",
        "--rig",
        "target1.toml",
        "--light",
        "0,90",
        "--no-fit",
    ];
    let captured = good(run(at, &arguments));
    let copy = printed_session(&captured).join("calibration/focus/lens.toml");
    assert!(at.join(copy).exists());
}
