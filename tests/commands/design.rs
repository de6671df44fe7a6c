//! `rig design`.

use crate::command_support::{ended, run};
use serde_json::Value;

/// What a short search writes is a scene that can be evaluated and a plan of lamps within the
/// limits; what cannot be is refused.
#[test]
fn a_design_is_a_scene_and_a_plan() {
    let folder = tempfile::tempdir().unwrap();
    let rig = |words: &str| {
        let words: Vec<&str> = words.split(' ').collect();
        ended(&run(folder.path(), &words))
    };
    let search = "design --out d --images 1 --camera-tilt 0 --rounds 1 --materials pvc \
                  --form extruded --thickness 0.5 --json";
    let (code, stdout, stderr) = rig(search);
    assert_eq!(code, 0, "{stderr}");
    let found: Value = serde_json::from_str(&stdout).unwrap();
    let designs = found["designs"].as_array().unwrap();
    assert_eq!(designs.len(), 4, "found, bowl, ball, cap: {stdout}");
    let elevation_deg = designs[0]["lights"][0]["elevation_deg"].as_f64().unwrap();
    assert!((15.0..=70.0).contains(&elevation_deg), "{stdout}");
    let [exact, as_made] = ["error", "error_as_made"].map(|key| designs[0][key].as_f64().unwrap());
    assert!(
        exact < as_made && as_made < 4.0 * exact,
        "{exact} {as_made}"
    );
    for half in ["former-lower.stl", "former-upper.stl"] {
        assert!(stdout.contains(half), "{stdout}");
    }
    for file in found["files"].as_array().unwrap() {
        let file = folder.path().join(file.as_str().unwrap());
        assert!(file.is_file(), "{}", file.display());
    }

    let (code, stdout, stderr) = rig("design --evaluate d/scene.toml --materials pvc --json");
    assert_eq!(code, 0, "{stderr}");
    let scenes: Value = serde_json::from_str(&stdout).unwrap();
    let error = scenes["scenes"][0]["error"].as_f64().unwrap();
    assert!((0.01..0.5).contains(&error), "{error}");

    for (words, fact) in [
        (
            "--evaluate d/scene.toml --materials unobtainium",
            "unobtainium is no embedded material",
        ),
        ("--out e --form folded", "not one of revolved, extruded"),
        ("--out e --tolerance 0.1", "not a length in mm and an angle"),
        ("--out e --camera-tilt 75 --radius 20", "38.6 mm deep"),
        (
            "--out e --least-elevation 80 --camera-tilt 0",
            "4 images, but only 0 directions",
        ),
    ] {
        let (code, _, stderr) = rig(&format!("design {words}"));
        assert_eq!(code, 1, "{words}");
        assert!(
            stderr.contains(fact) && stderr.contains("hint:"),
            "{stderr}"
        );
    }
}
