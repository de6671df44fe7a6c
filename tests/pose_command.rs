//! `rig calibrate pose` as the operator meets it: from a session to a record, and what
//! status says of it.

use std::path::Path;

use serde_json::Value;

fn rig(folder: &Path) -> assert_cmd::Command {
    let mut command = assert_cmd::Command::cargo_bin("rig").unwrap();
    command.current_dir(folder);
    command
}

fn json(command: &mut assert_cmd::Command) -> Value {
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The simulated bench's sample lies within what the record says of where it truly is.
#[test]
fn a_pose_is_measured_and_kept() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = std::fs::read_to_string(root.join("rig-configs/simulated.toml")).unwrap();
    let text = text
        .replace("\"realistic\"", "\"instant\"")
        .replace("samples_per_pixel = 512", "samples_per_pixel = 48");
    std::fs::write(at.join("rig.toml"), text).unwrap();
    let library = at.join("calibration/simulated");
    for kind in ["sensor", "flat", "scale"] {
        std::fs::create_dir_all(library.join(kind)).unwrap();
        let from = root.join("calibration/simulated").join(kind);
        for entry in std::fs::read_dir(from).unwrap().flatten() {
            std::fs::copy(entry.path(), library.join(kind).join(entry.file_name())).unwrap();
        }
    }
    let captured = rig(at)
        .args(["capture", "--lights", "3", "--no-fit"])
        .output()
        .unwrap();
    assert!(
        captured.status.success(),
        "{}",
        String::from_utf8_lossy(&captured.stderr)
    );
    let session = String::from_utf8(captured.stdout).unwrap();
    let session = session.lines().last().unwrap();
    let found = json(rig(at).args(["calibrate", "pose", session, "--id", "p", "--json"]));
    assert!(library.join("pose/p.toml").is_file());
    assert!(library.join("plots/p.svg").is_file());
    // Seed, position and orientation errors stand in the rig file.
    let [rotation_rad, translation_mm] = rig::simulation::pose_error(7, 0.02, 0.1);
    let number = |value: &Value| value.as_f64().unwrap();
    for axis in 0..3 {
        for (key, offset, truth) in [
            ("rotation_deg", 0, rotation_rad[axis].to_degrees()),
            ("translation_mm", 3, translation_mm[axis]),
        ] {
            let k = offset + axis;
            let std = number(&found["covariance"][k][k]).sqrt();
            let error = number(&found[key][axis]) - truth;
            eprintln!("{key}[{axis}]: {error:.4} ± {std:.4}");
            // Six numbers at 1e-3 together.
            assert!(error.abs() < 4.0 * std, "{key}[{axis}]: {error} ± {std}");
        }
    }
    // Across the view, a pixel being 0.34 mm.
    for axis in 0..2 {
        let error = number(&found["translation_mm"][axis]) - translation_mm[axis];
        assert!(error.abs() < 0.034, "{axis}: {error} mm");
    }
    let status = json(rig(at).args(["calibrate", "status", "--json"]));
    let records = status["records"].as_array().unwrap();
    let pose = records.iter().find(|line| line["kind"] == "pose").unwrap();
    assert_eq!(pose["state"], "good");

    // The same name again: refused, and the record is as it was.
    let before = std::fs::read(library.join("pose/p.toml")).unwrap();
    rig(at)
        .args(["calibrate", "pose", session, "--id", "p"])
        .assert()
        .code(1);
    assert_eq!(std::fs::read(library.join("pose/p.toml")).unwrap(), before);
}
