//! What `rig capture` plans and refuses before anything moves, on the simulated rig.

use std::path::Path;

use crate::command_support::{
    assert_refused, cases, no_session, run, text, with_body, words, workplace,
};
use rig::capture::reach::StageReach;
use rig::config::RigConfig;
use rig::units::StageAngles;

#[test]
fn the_best_lights_are_planned_within_the_limits() {
    let folder = tempfile::tempdir().unwrap();
    let words = ["capture", "--lights", "best:3", "--dry-run", "--json"];
    let output = run(&folder, &words);
    assert!(output.status.success());
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let lights = plan["lights"].as_array().unwrap();
    assert_eq!(lights.len(), 3);
    for (index, light) in lights.iter().enumerate() {
        let elevation_deg = light["elevation_deg"].as_f64().unwrap();
        assert!((45.0..=90.0).contains(&elevation_deg), "{light}");
        assert!(!lights[..index].contains(light), "{light} twice");
    }
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("best of 60 directions"), "{said}");
}

#[test]
fn a_dry_run_prints_the_plan_and_touches_nothing() {
    let folder = workplace(|text| text);
    let output = run(&folder, &["capture", "--lights", "4", "--dry-run"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(text(&output.stdout).contains("light 1: azimuth 0.000°, elevation 45.000°"));
    let output = run(
        &folder,
        &["capture", "--lights", "4", "--dry-run", "--json"],
    );
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plan["lights"].as_array().unwrap().len(), 4);
    assert!(plan["estimated_s"].as_f64().unwrap() > 1.0);
    assert!(plan["estimated_bytes"].as_f64().unwrap() > 4.0 * 64.0 * 64.0 * 2.0);
    no_session(&folder);
}

#[test]
fn bad_input_is_refused_before_anything_moves() {
    let folder = workplace(|text| text);
    std::fs::write(folder.path().join("file"), "").unwrap();
    for [line, fact] in cases(
        "
        capture | --lights
        capture --lights none | --lights
        capture --lights 99999 | the stage reaches
        capture --until 200% | --until
        capture --lights 1 --max-lights 3 | --until
        capture --light 0,10 | outside the stage's limits
        capture --light 0 | --light
        capture --light 0,60 --light 0,60 | the light direction azimuth 0.000°
        capture --light 10,60 --light 370,60 | is named twice, also as
        capture --light 0,90 --light 120,90 | is named twice, also as
        capture --lights 1 --sample ../x | sample name
        capture --lights 1 --out file/x | file
        capture --lights 1 --rig none.toml | none.toml
        capture --resume nowhere | nowhere
        capture --resume . | is not a session
        session verify nowhere | nowhere
        session list nowhere | nowhere
    ",
    ) {
        let arguments = &words(line)[..];
        let output = run(&folder, arguments);
        assert_refused(&output, fact);
        assert_eq!(text(&output.stdout), "", "{arguments:?}");
        no_session(&folder);
        // A dry run refuses what the capture refuses, in the same words.
        if arguments[0] == "capture" && !arguments.contains(&"--resume") {
            let dry = run(&folder, &[arguments, &["--dry-run"]].concat());
            assert_refused(&dry, fact);
            assert_eq!(text(&dry.stderr), text(&output.stderr), "{arguments:?}");
        }
    }
    let beneath_a_file = ["capture", "--lights", "1", "--out", "file/x"];
    let hint = "a part of this path is a file";
    assert!(text(&run(&folder, &beneath_a_file).stderr).contains(hint));
    let twice = ["capture", "--light", "0,60", "--light", "0,60"];
    let hint = "name each direction once; how well";
    assert!(text(&run(&folder, &twice).stderr).contains(hint));
    let red = "mesh = \"holder.stl\"\nbrdf = { mixture = [ { weight = [1.0, 0.5, 0.5], lambertian = { albedo = 0.5 } }, \
        { weight = [0.0, 0.5, 0.5], black = {} } ] }";
    let coloured = workplace(|text| with_body(&text, red));
    let capture = ["capture", "--lights", "1"];
    assert_refused(&run(&coloured, &capture), "holder.stl");
    let made = words("shape tetrahedron --radius 3 --depth 2 --out holder.stl");
    assert!(run(&coloured, &made).status.success());
    assert_refused(&run(&coloured, &capture), "geometry.body[0] is coloured");
    no_session(&coloured);
    let crowded =
        workplace(|text| text.replace("disk_reserve_mb = 200", "disk_reserve_mb = 1000000"));
    let free = rig::session::commit::free_bytes(crowded.path()).unwrap();
    if free < 1_000_000_000_000 {
        assert_refused(&run(&crowded, &["capture", "--lights", "1"]), "has only ");
    }
}

/// The pit of a tetrahedron as an OBJ file, each corner moved, its facets seen from above or,
/// inside out, from below.
fn pit(corner: impl Fn([f64; 3]) -> [f64; 3], inside_out: bool) -> String {
    let corners = [
        [10.0, 0.0, 0.0],
        [-5.0, 8.66, 0.0],
        [-5.0, -8.66, 0.0],
        [0.0, 0.0, -5.0],
    ];
    let mut obj = String::new();
    for [x, y, z] in corners.map(corner) {
        obj += &format!("v {x} {y} {z}\n");
    }
    for [a, b] in [[1, 2], [2, 3], [3, 1]] {
        let [a, b] = if inside_out { [b, a] } else { [a, b] };
        obj += &format!("f {a} {b} 4\n");
    }
    obj
}

/// What no capture can come of is refused by the doctor, by a dry run and by a capture, before
/// anything moves, with the sample's place and a remedy that is this case's.
#[test]
fn scenes_that_make_no_sense_are_refused_before_anything_moves() {
    let upright = |c: [f64; 3]| c;
    let scaled = |by: f64| move |c: [f64; 3]| c.map(|x| by * x);
    let out = "the sample is outside the camera's view: ";
    let back = "the sample's surface faces away from the camera: 0.0%";
    let dark = "reaches 0.0% of what the camera sees of the sample: 100% is turned away from it";
    let meshes = [
        pit(|[x, y, z]| [x + 30.0, y, z], false),
        pit(|[x, y, z]| [x, y + 18.0, z], false),
        pit(|[x, y, z]| [x, y, z + 300.0], false),
        pit(scaled(1000.0), false),
        pit(scaled(0.001), false),
        pit(scaled(0.1), false),
        pit(|[x, y, z]| [x, -y, -z], false),
        pit(upright, true),
        pit(|[x, y, z]| [x, y, 0.5 * z], false),
    ];
    let rows = cases(
        r#"
        aside | OUT | look_at_mm
        nearly aside | OUT | look_at_mm
        behind the camera | OUT | position_mm
        micrometres | OUT | mesh_unit = "um" in [geometry.sample]
        metres | the sample is too small in the image: it covers 0.0 pixels | mesh_unit = "m" in [geometry.sample]
        a grain | it covers 1 | the field of view of [geometry.camera]
        upside down | BACK | upside down, which mesh_to_sample corrects
        inside out | BACK | inside out, which flip_facets = true corrects
        lit from below | DARK | [geometry.sample_from_stage]
    "#,
    );
    for ([name, fact, remedy], mesh) in rows.zip(meshes) {
        let fact = match fact {
            "OUT" => out,
            "BACK" => back,
            "DARK" => dark,
            fact => fact,
        };
        let folder = workplace(|text| {
            let (before, rest) = text.split_once("[geometry.sample.shape]").unwrap();
            let (_, after) = rest.split_once("[geometry.sample_from_stage]").unwrap();
            let before = before.replace("# mesh = \"bowl.ply\"", "mesh = \"pit.obj\"");
            let before = before.replace("shading = \"smooth\"", "shading = \"flat\"");
            let from_below = match name {
                "lit from below" => {
                    after.replacen("rotation_deg = [0.0,", "rotation_deg = [180.0,", 1)
                }
                _ => after.to_owned(),
            };
            format!("{before}[geometry.sample_from_stage]{from_below}")
        });
        std::fs::write(folder.path().join("pit.obj"), mesh).unwrap();
        let doctor = run(&folder, &["doctor"]);
        let said = text(&doctor.stdout);
        assert_eq!(doctor.status.code(), Some(1), "{name}: {said}");
        let view = said
            .lines()
            .find(|line| line.starts_with("FAILED   view"))
            .expect(&said);
        let fact_there = match fact == dark {
            true => "none of 16 lights spread over the stage's reach",
            false => fact,
        };
        assert!(
            view.contains(fact_there) && said.contains(remedy),
            "{name}: {said}"
        );
        for command in [
            &["capture", "--lights", "2", "--dry-run"][..],
            &["capture", "--lights", "2"],
        ] {
            let output = run(&folder, command);
            assert_refused(&output, fact);
            let said = text(&output.stderr);
            assert!(said.contains(remedy), "{name}: {said}");
            assert!(
                fact == dark || said.contains("the field of view is 22.0 × 22.0 mm"),
                "{name}: {said}"
            );
            assert_eq!(text(&output.stdout), "", "{name}");
            no_session(&folder);
        }
    }
}

/// Shipped rig files describe benches that can exist: sample, lights and depth of field are
/// as they should be, and plans have lights within reach, each once, past the camera's body.
#[test]
fn shipped_benches_are_sound_and_plan_lights_that_nothing_blocks() {
    let folder = tempfile::tempdir().unwrap();
    for (name, file) in rig::config::BUILT_IN {
        let config = RigConfig::parse(name, Path::new(""), file).unwrap();
        assert!(config.geometry.camera_body.is_some() || config.is_simulated());
        let doctor = run(&folder, &["doctor", "--rig", name, "--json"]);
        let found: serde_json::Value = serde_json::from_slice(&doctor.stdout).unwrap();
        for check in ["view", "light paths", "depth of field"] {
            let checks = found["checks"].as_array().unwrap();
            let check = checks.iter().find(|c| c["name"] == check).unwrap();
            assert_eq!(check["verdict"], "ok", "{name}: {check}");
        }
        let reach = StageReach::of_rig(&config).unwrap();
        let mut longest = Vec::new();
        for count in ["8", "4", "1"] {
            let line = format!("capture --rig {name} --lights {count} --dry-run --json");
            let output = run(&folder, &words(&line));
            let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            let lights: Vec<StageAngles> = serde_json::from_value(plan["lights"].clone()).unwrap();
            assert_eq!(lights.len().to_string(), count, "{name}");
            reach.check(&lights).unwrap();
            for (number, light) in lights.iter().enumerate() {
                assert!(!lights[..number].contains(light), "{name}: {light} twice");
            }
            if longest.is_empty() {
                longest.clone_from(&lights);
            }
            assert_eq!(lights, longest[..lights.len()], "{name}");
        }
        let elevations = longest.iter().map(|light| light.elevation_deg);
        let [low, high] = [f64::min, f64::max].map(|of| elevations.clone().reduce(of).unwrap());
        let lowest = match config.geometry.coaxial().z < 0.99 {
            true => -30.0,
            false => 25.0,
        };
        assert!(
            (lowest..=90.0).contains(&low) && high - low > 15.0,
            "{name}: {low} to {high}"
        );
    }
}

/// A light from which the camera's body, or the lamp itself, hides the sample is named with
/// what is in the way and the nearest direction that is free.
#[test]
fn a_light_that_the_camera_blocks_is_refused() {
    let with_body = |body: &'static str| {
        move |text: String| {
            let key = "point_spread_px = 0.0";
            assert!(text.contains(key));
            text.replacen(key, &format!("{key}\nbody = {{ {body} }}"), 1)
        }
    };
    let telescope = "radius_mm = 30.0, length_mm = 100.0";
    // (30 + 10) mm aside at 200 mm: 11.3° from the axis. A front 50 mm farther down: 14.9°.
    // A lamp of 2° radius: 2° more.
    let lower = "radius_mm = 30.0, length_mm = 100.0, front_mm = 50.0";
    type Change = Box<dyn Fn(String) -> String>;
    let cases: [(&str, Change, &str, &str, &str); 5] = [
        (
            "coaxial",
            Box::new(with_body(telescope)),
            "10,90",
            "the camera's body keeps the light from 100% of the sample in view",
            "the nearest free direction is azimuth 10.000°, elevation 78.5°",
        ),
        (
            "at the edge",
            Box::new(with_body(telescope)),
            "-20,79",
            "the camera's body keeps the light from",
            "the nearest free direction is azimuth -20.000°, elevation 78.5°",
        ),
        (
            "a lower front",
            Box::new(with_body(lower)),
            "0,76",
            "the camera's body keeps the light from",
            "the nearest free direction is azimuth 0.000°, elevation 75.0°",
        ),
        (
            "a wide lamp",
            Box::new(move |text: String| {
                let text = with_body(telescope)(text);
                let key = "angular_radius_deg = ";
                let (before, rest) = text.split_once(&format!("\n{key}")).unwrap();
                let (_, after) = rest.split_once('\n').unwrap();
                format!("{before}\n{key}2.0\n{after}")
            }),
            "0,78.5",
            "the camera's body keeps the light from",
            "the nearest free direction is azimuth 0.000°, elevation 76.5°",
        ),
        (
            "a lamp in front of the lens",
            Box::new(move |text: String| {
                let text = with_body(telescope)(text);
                text.replacen(
                    "[geometry.light]",
                    "[geometry.light]\ndistance_mm = 100.0",
                    1,
                )
                .replacen(
                    "\nangular_radius_deg = ",
                    "\n# angular_radius_deg = ",
                    1,
                )
            }),
            "0,88",
            "the lamp stands in front of the camera, in its view",
            "the nearest free direction is azimuth 0.000°, elevation 83.5°",
        ),
    ];
    for (name, change, light, fact, free) in cases {
        let folder = workplace(change);
        let words = ["capture", "--light", "0,50", "--light", light, "--dry-run"];
        let output = run(&folder, &words);
        assert_refused(&output, fact);
        let said = text(&output.stderr);
        assert!(said.contains("light 2 (azimuth"), "{name}: {said}");
        let free = free.trim_end_matches('°');
        assert!(
            said.contains(free) && said.contains("--lights N"),
            "{name}: {said}"
        );
        let plan = run(&folder, &["capture", "--lights", "12", "--dry-run"]);
        assert_eq!(
            plan.status.code(),
            Some(0),
            "{name}: {}",
            text(&plan.stderr)
        );
        let doctor = run(&folder, &["doctor"]);
        let said = text(&doctor.stdout);
        assert!(said.contains("plans leave them out"), "{name}: {said}");
    }
}

/// A sample that is partly in view is a remark; one that is wholly in view is none.
#[test]
fn a_sample_partly_in_view_is_remarked() {
    let dry = ["capture", "--lights", "2", "--dry-run"];
    let whole = run(workplace(|text| text), &dry);
    assert_eq!(text(&whole.stderr), "");
    let folder = workplace(|text| {
        text.replace("look_at_mm = [0.0,", "look_at_mm = [6.0,")
            .replace("position_mm = [0.0,", "position_mm = [6.0,")
    });
    let cut = run(&folder, &dry);
    assert_eq!(cut.status.code(), Some(0));
    let said = text(&cut.stderr);
    assert!(
        said.contains("warning: the sample is only partly in view: 8"),
        "{said}"
    );
}

/// A plan needs no calibration; what it then estimates is marked.
#[test]
fn a_dry_run_without_records_marks_its_estimates() {
    let folder = workplace(|text| text.replace("name = \"simulated\"", "name = \"new-bench\""));
    let dry = ["capture", "--lights", "2", "--dry-run"];
    let output = run(&folder, &dry);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let mark = "estimated for a usual sensor, no sensor record: run `rig calibrate sensor`";
    assert!(
        text(&output.stdout).contains(mark),
        "{}",
        text(&output.stdout)
    );
    let output = run(&folder, &[&dry[..], &["--json"]].concat());
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plan["estimated"], mark);
    assert!(plan["sensor_record"].is_null());
    assert!(plan["estimated_s"].as_f64().unwrap() > 1.0);
    let refused = run(&folder, &["capture", "--lights", "2"]);
    assert_refused(&refused, "there is no sensor record");
    let hint = "run `rig calibrate sensor`, once for each camera and gain";
    assert!(text(&refused.stderr).contains(hint));
    // The doctor judges the same, in the same words.
    let doctor = run(&folder, &["doctor"]);
    assert_eq!(doctor.status.code(), Some(1));
    let checks = text(&doctor.stdout);
    let lines = checks
        .lines()
        .skip_while(|line| !line.starts_with("FAILED "));
    let lines: Vec<&str> = lines.take(2).map(str::trim).collect();
    assert!(
        lines[0].ends_with("there is no sensor record in calibration/new-bench"),
        "{checks}"
    );
    assert_eq!(lines[1], format!("-> {hint}"));
    no_session(&folder);
    let known = run(workplace(|text| text), &[&dry[..], &["--json"]].concat());
    let plan: serde_json::Value = serde_json::from_slice(&known.stdout).unwrap();
    assert_eq!(plan["sensor_record"], "20261121T020000Z-sensor");
    assert!(plan.get("estimated").is_none());
}
