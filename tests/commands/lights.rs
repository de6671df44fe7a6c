//! `rig calibrate lights` from capture to fit on the simulated rig, whose stage stands
//! elsewhere than its rig file says.

use std::path::{Path, PathBuf};

use crate::command_support::{good, run, small_bench_with, text, words};
use serde_json::Value;

/// The simulated rig with a glossy sphere on it, and a stage that is turned by 0.8° and
/// counts elevations from -0.6°.
fn workplace() -> tempfile::TempDir {
    small_bench_with(&[
        ("kind = \"bowl\"", "kind = \"sphere\""),
        ("extent_mm = [22.0, 22.0]", "extent_mm = [26.0, 26.0]"),
        // No highlight on a pixel that is known to be hot.
        (
            "position_mm = [0.0, 0.0, 200.0]",
            "position_mm = [1.6, -1.2, 200.0]",
        ),
        (
            "look_at_mm = [0.0, 0.0, 0.0]",
            "look_at_mm = [1.6, -1.2, 0.0]",
        ),
        // Its highlights must not saturate the shortest exposure.
        (
            "irradiance_w_m2 = [64.0, 80.0, 48.0]",
            "irradiance_w_m2 = [0.64, 0.8, 0.48]",
        ),
        ("samples_per_pixel = 384", "samples_per_pixel = 1024"),
        (
            "material = \"nbrdf:dark-red-paint\"",
            "brdf = { mixture = [ { weight = 0.2, lambertian = { albedo = 0.5 } }, { weight = 0.8, ggx = { alpha = 0.04, eta = 1.5 } } ] }",
        ),
        ("timing = \"realistic\"", "timing = \"instant\""),
        ("max_reflections = 32", "max_reflections = 1"),
        ("azimuth_offset_deg = 0.05", "azimuth_offset_deg = 0.8"),
        (
            "elevation_offset_deg = -0.05",
            "elevation_offset_deg = -0.6",
        ),
        // At 45° the stage cannot come from below, so that its play would show.
        ("backlash = 0.2", "backlash = 0.0"),
        ("positioning = 0.05", "positioning = 0.02"),
    ])
}

/// Nine directions under which the sphere's highlights miss the pixels that are known to be hot.
const LIGHTS: [&str; 9] = [
    "0,90", "0,45", "180,45", "90,45", "-90,45", "45,45", "-135,45", "-45,45", "135,45",
];

fn capture(at: &Path, lights: &[&str]) -> PathBuf {
    let mut arguments = vec!["capture", "--sample", "sphere", "--no-fit"];
    arguments.extend(lights.iter().flat_map(|angles| ["--light", angles]));
    let output = good(run(at, &arguments));
    at.join(text(&output.stdout).lines().last().unwrap())
}

#[test]
fn a_stage_is_found_where_it_truly_stands_and_a_fit_uses_it() {
    let folder = workplace();
    let at = folder.path();
    let session = capture(at, &LIGHTS);
    let session = session.to_str().unwrap();
    let records = at.join("calibration/simulated/directions");

    // A radius that is not the sphere's: refused with advice, nothing kept.
    for (arguments, fact, advice) in [
        (vec!["--radius", "9"], "radius", "--radius"),
        (vec!["--radius", "0.01"], "must be", "correct"),
        (
            vec!["--radius", "10", "--near", "60,32,27"],
            "outside the view",
            "move the sphere",
        ),
    ] {
        let mut all = vec!["calibrate", "lights", session];
        all.extend(arguments);
        let refused = run(at, &all);
        let said = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{said}");
        assert!(
            said.contains(fact) && said.contains("hint:") && said.contains(advice),
            "{said}"
        );
        assert!(!records.exists(), "{said}");
    }

    let output = good(run(
        at,
        &words(&format!(
            "calibrate lights {session} --radius 10 --id one --json"
        )),
    ));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let stage = &found["values"]["stage"];
    let number = |v: &Value| v.as_f64().unwrap();
    let covariance = |i: usize| number(&stage["covariance_deg2"][i][i]);
    // The stage's errors, of which homing has 0.02° and each light 0.02°.
    let turned = [0, 1, 2].map(|i| number(&stage["rotation_deg"][i]));
    let truth = [0.0, 0.0, 0.8];
    for axis in 0..3 {
        let off = turned[axis] - truth[axis];
        let std = covariance(axis).sqrt().hypot(0.03);
        assert!(
            off.abs() < 0.1 && off.abs() < 4.0 * std,
            "axis {axis}: {off} ± {std}: {found}"
        );
    }
    let off = number(&stage["elevation_offset_deg"]) + 0.6;
    let std = covariance(3).sqrt().hypot(0.03);
    assert!(
        off.abs() < 0.1 && off.abs() < 4.0 * std,
        "offset: {off} ± {std}: {found}"
    );
    for ending in ["svg", "png"] {
        let figure = at.join(format!("calibration/simulated/plots/one.{ending}"));
        assert!(
            std::fs::metadata(&figure).unwrap().len() > 1000,
            "{figure:?}"
        );
    }
    let status = text(&good(run(at, &["calibrate", "status"])).stdout);
    assert!(status.contains("9 lights, each to ±"), "{status}");

    // A second record of the name is refused; the first stays.
    let record = records.join("one.toml");
    let bytes = std::fs::read(&record).unwrap();
    let again = run(
        at,
        &words(&format!("calibrate lights {session} --radius 10 --id one")),
    );
    assert_eq!(again.status.code(), Some(1));
    assert_eq!(std::fs::read(&record).unwrap(), bytes);

    // The irradiance of a white standard, and the directions, reach a fit.
    let lights = at.join("calibration/simulated/lights");
    std::fs::create_dir_all(&lights).unwrap();
    let white = "id = \"white\"\nkind = \"lights\"\nrig = \"simulated\"\ndevice_serial = \"\"\n\
        date = \"2026-11-21T00:00:00Z\"\nmethod = \"m\"\nsource = \"s\"\n[values]\nirradiance_w_m2 = [\
        { value = 64.0, std = 0.5 }, { value = 80.0, std = 0.5 }, { value = 48.0, std = 0.5 }]\n";
    std::fs::write(lights.join("white.toml"), white).unwrap();
    let next = capture(at, &LIGHTS[..2]);
    assert!(next.join("calibration/directions/one.toml").is_file());
    let fitted = good(run(
        at,
        &words(&format!(
            "fit {} --spp 2 --max-reflections 2",
            next.display()
        )),
    ));
    let said = text(&fitted.stderr);
    assert!(said.contains("light directions by record one"), "{said}");
    assert!(said.contains("irradiance by record white"), "{said}");
    let few = "warning: 2 paths per cell were followed";
    assert!(said.contains(few), "{said}");
}
