//! What the program says to bad input: one line that states the fact, a blank
//! line, a hint, exit code 1; never a panic.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;

/// One bad input and what must be said about it.
struct Case {
    name: &'static str,
    /// The command line.
    args: &'static [&'static str],
    /// A text of the rig or scene file and what it is replaced with.
    change: Option<(&'static str, &'static str)>,
    /// Must be part of the error's line.
    fact: &'static str,
    /// Must be part of the hint.
    hint: &'static str,
}

const CASES: &[Case] = &[
    Case {
        name: "unknown command",
        args: &["captrue"],
        change: None,
        fact: "unrecognized subcommand 'captrue'",
        hint: "`rig --help`",
    },
    Case {
        name: "unknown option",
        args: &["doctor", "--colour"],
        change: None,
        fact: "unexpected argument '--colour'",
        hint: "'--color'",
    },
    Case {
        name: "bad value of an option",
        args: &["doctor", "--color", "sometimes"],
        change: None,
        fact: "invalid value 'sometimes' for '--color <WHEN>'",
        hint: "--help",
    },
    Case {
        name: "missing argument",
        args: &["man"],
        change: None,
        fact: "--out <DIR>",
        hint: "`rig man --help`",
    },
    Case {
        name: "contradicting options",
        args: &["doctor", "-q", "-v"],
        change: None,
        fact: "cannot be used with",
        hint: "`rig doctor --help`",
    },
    Case {
        name: "folder that is a file",
        args: &["man", "--out", "rig.toml"],
        change: None,
        fact: "rig.toml: File exists",
        hint: "another folder",
    },
    Case {
        name: "missing rig file",
        args: &["doctor", "--rig", "nowhere/rig.toml"],
        change: None,
        fact: "nowhere/rig.toml: No such file or directory",
        hint: "check the path",
    },
    Case {
        name: "rig file that is a folder",
        args: &["doctor", "--rig", "./"],
        change: None,
        fact: "Is a directory",
        hint: "check the path",
    },
    Case {
        name: "rig file that is no text",
        args: &["doctor", "--rig", "noise.toml"],
        change: None,
        fact: "noise.toml: it is no UTF-8 text",
        hint: "TOML",
    },
    Case {
        name: "rig file that is a device",
        args: &["doctor", "--rig", "/dev/null"],
        change: None,
        fact: "/dev/null: it is a device, not a regular file",
        hint: "regular file",
    },
    Case {
        name: "unknown rig name",
        args: &["doctor", "--rig", "simulate"],
        change: None,
        fact: "there is no rig named \"simulate\"; known: dmx-dome-v4l2, grbl-arm-tilted, grbl-arm-v4l2, rehearsal-ball, rehearsal-flat, rehearsal-tile, rehearsal-torch, simulated, simulated-5mp-bayer, simulated-ball, simulated-tilted, zaber-gantry-v4l2",
        hint: "did you mean `simulated`?",
    },
    Case {
        name: "not TOML",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("[rig]", "[rig")),
        fact: "not valid TOML",
        hint: "toml.io",
    },
    Case {
        name: "unknown key",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("bit_depth = 12", "bit_deth = 12")),
        fact: "`camera.bit_depth` is missing; it must be an integer from 8 to 16",
        hint: "is `bit_deth` meant to be it?",
    },
    Case {
        name: "unknown key beside all that are needed",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("max_frames =", "max_frame =")),
        fact: "unknown key `capture.max_frame`; known here: shortest_ms,",
        hint: "did you mean `max_frames`?",
    },
    Case {
        name: "unknown table",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("[fit]", "[fits]")),
        fact: "unknown key `fits`",
        hint: "did you mean `fit`?",
    },
    Case {
        name: "wrong type",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("snr = 20.0", "snr = \"high\"")),
        fact: "`capture.snr` is \"high\", but must be a number from 1 to 10000",
        hint: "unit and range",
    },
    Case {
        name: "value out of range",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("max_reflections = 16", "max_reflections = 65")),
        fact: "`fit.max_reflections` is 65, but must be an integer from 2 to 64",
        hint: "unit and range",
    },
    Case {
        name: "integer beyond 64 bits",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("seed = 7", "seed = 99999999999999999999999")),
        fact: "`simulation.seed` is 99999999999999999999999, but must be an integer",
        hint: "unit and range",
    },
    Case {
        name: "not a number",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("extent_mm = [29.3, 22.0]", "extent_mm = [29.3, nan]")),
        fact: "`geometry.camera.extent_mm` is [29.3, NaN]",
        hint: "unit and range",
    },
    Case {
        name: "camera that looks along its up direction",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("up = [0.0, 1.0, 0.0]", "up = [0.0, 0.0, 1.0]")),
        fact: "`geometry.camera.up`",
        hint: "unit and range",
    },
    Case {
        name: "camera body without its length",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("point_spread_px = 0.5", "body = { radius_mm = 20.0 }")),
        fact: "`geometry.camera.body.length_mm` is missing; it must be a number from 0.5 to 10000",
        hint: "unit and range",
    },
    Case {
        name: "camera body with a misspelt key",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some((
            "point_spread_px = 0.5",
            "body = { radius_mm = 20.0, length_mm = 100.0, font_mm = 5.0 }",
        )),
        fact: "unknown key `geometry.camera.body.font_mm`",
        hint: "did you mean `front_mm`?",
    },
    Case {
        name: "camera body that reaches into the sample",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some((
            "point_spread_px = 0.5",
            "body = { radius_mm = 20.0, length_mm = 100.0, front_mm = 200.0 }",
        )),
        fact: "`geometry.camera.body.front_mm` is 200, but must be below 200.0, the distance at which the image is sharp",
        hint: "unit and range",
    },
    Case {
        name: "exposures that the camera hasn't",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("longest_ms = 500.0", "longest_ms = 1e9")),
        fact: "`capture.longest_ms` is 1000000000, but must be a number from 0.05 to 2000",
        hint: "unit and range",
    },
    Case {
        name: "lamp command that acts out of turn",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some(("on = \"M8\"", "on = \"!\"")),
        fact: "`stage.lamp[2].on` is \"!\"",
        hint: "unit and range",
    },
    Case {
        name: "one simulated and one real device",
        args: &["doctor", "--rig", "rig.toml"],
        change: Some((
            "[stage]\n# \"grbl\" (GRBL 1.1 on a serial port) or \"simulated\" (the same protocol, spoken\n# by simulated firmware on a pseudo-terminal) (required).\ndriver = \"simulated\"",
            "[stage]\ndriver = \"grbl\"\nport = \"/dev/ttyUSB9\"",
        )),
        fact: "`stage.driver` is \"grbl\", but must be simulated together with the camera",
        hint: "unit and range",
    },
    Case {
        name: "report of a folder that is no session",
        args: &["report", "."],
        change: None,
        fact: "is not a session",
        hint: "folder of a session",
    },
    Case {
        name: "report of nothing",
        args: &["report", "sessions/gone"],
        change: None,
        fact: "sessions/gone",
        hint: "session",
    },
    Case {
        name: "export in an unknown format",
        args: &["export", ".", "--format", "pdf"],
        change: None,
        fact: "invalid value 'pdf' for '--format <FORMAT>'",
        hint: "`rig export --help`",
    },
    Case {
        name: "export of a folder without a fit",
        args: &["export", ".", "--format", "json"],
        change: None,
        fact: "fit",
        hint: "fit",
    },
];

/// A scene that renders, and files that are not what they say.
const SCENE: &str = r#"
[camera]
model = "orthographic"
resolution_px = [8, 8]
extent_mm = [2.2, 2.2]
position_mm = [0.0, 0.0, 5.0]

[[light]]
kind = "directional"
to_light = [0.0, 0.0, 1.0]

[sample]
shape = { kind = "bowl", radius_mm = 1.0, segments = 16 }

[brdf]
mixture = [ { weight = 1.0, lambertian = { albedo = 0.5 } } ]
"#;

const SHAPE: &str = "shape = { kind = \"bowl\", radius_mm = 1.0, segments = 16 }";

/// Declares more vertices and faces than any file of its size can hold.
const HUGE_PLY: &str = "ply\nformat binary_little_endian 1.0\n\
    element vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\n\
    element face 4000000000\nproperty list uchar int vertex_indices\nend_header\n";

const SCENE_CASES: &[Case] = &[
    Case {
        name: "missing scene",
        args: &["render", "--scene", "gone.toml", "--out", "x.exr"],
        change: None,
        fact: "gone.toml: No such file",
        hint: "check the path",
    },
    Case {
        name: "unknown table of a scene",
        args: &["render", "--scene", "scene.toml", "--out", "x.exr"],
        change: Some(("[brdf]", "[brdff]")),
        fact: "scene.toml:15: unknown key `brdff`",
        hint: "did you mean `brdf`?",
    },
    Case {
        name: "missing mesh",
        args: &["render", "--scene", "scene.toml", "--out", "x.exr"],
        change: Some((SHAPE, "mesh = \"gone.ply\"")),
        fact: "gone.ply: No such file",
        hint: "check the path",
    },
    Case {
        name: "mesh of another kind",
        args: &["render", "--scene", "scene.toml", "--out", "x.exr"],
        change: Some((SHAPE, "mesh = \"bad.step\"")),
        fact: "bad.step: the file name does not end in .ply",
        hint: "",
    },
    Case {
        name: "STL mesh that declares more than it holds",
        args: &["render", "--scene", "scene.toml", "--out", "x.exr"],
        change: Some((SHAPE, "mesh = \"bad.stl\"")),
        fact: "bad.stl: the file is cut short: it declares 2668988151 facets",
        hint: "it is not whole",
    },
    Case {
        name: "mesh that is none",
        args: &["render", "--scene", "scene.toml", "--out", "x.exr"],
        change: Some((SHAPE, "mesh = \"bad.ply\"")),
        fact: "bad.ply:",
        hint: "let it write a binary PLY",
    },
    Case {
        name: "mesh that declares more than it holds",
        args: &["render", "--scene", "scene.toml", "--out", "x.exr"],
        change: Some((SHAPE, "mesh = \"huge.ply\"")),
        fact: "huge.ply:",
        hint: "it is not whole",
    },
    Case {
        name: "measured table that is none",
        args: &["render", "--scene", "scene.toml", "--out", "x.exr"],
        change: Some((
            "mixture = [ { weight = 1.0, lambertian = { albedo = 0.5 } } ]",
            "table = \"bad.binary\"",
        )),
        fact: "bad.binary",
        hint: "damaged",
    },
    Case {
        name: "folder that doesn't exist",
        args: &["render", "--scene", "scene.toml", "--out", "gone/x.exr"],
        change: None,
        fact: "gone is not a folder",
        hint: "--out",
    },
    Case {
        name: "missing image",
        args: &[
            "fit",
            "--scene",
            "scene.toml",
            "--image",
            "gone.exr",
            "--out",
            "f",
        ],
        change: None,
        fact: "gone.exr: No such file",
        hint: "check the path's spelling",
    },
    Case {
        name: "image that is none",
        args: &[
            "fit",
            "--scene",
            "scene.toml",
            "--image",
            "bad.exr",
            "--out",
            "f",
        ],
        change: None,
        fact: "bad.exr is not a readable OpenEXR file",
        hint: "the image is damaged or no OpenEXR file: render or merge it again",
    },
    Case {
        name: "unknown dictionary",
        args: &[
            "fit",
            "--scene",
            "scene.toml",
            "--image",
            "bad.exr",
            "--out",
            "f",
            "--dictionary",
            "paper43",
        ],
        change: None,
        fact: "\"paper43\" is no BRDF or dictionary known here",
        hint: "names",
    },
    Case {
        name: "session that isn't there",
        args: &["fit", "gone"],
        change: None,
        fact: "gone is not a session: there is no such folder",
        hint: "session",
    },
    Case {
        name: "unknown material",
        args: &["brdf", "check", "nbrdf:unobtainium"],
        change: None,
        fact: "no embedded material \"unobtainium\"",
        hint: "red-plastic",
    },
    Case {
        name: "width beyond the closed form",
        args: &["brdf", "check", "ggx:9,1.5"],
        change: None,
        fact: "alpha 9, allowed is 0.001 to 1",
        hint: "`rig brdf --help`",
    },
    Case {
        name: "frame without an exposure",
        args: &["merge", "bad.png", "--exposures", "exposures.csv"],
        change: None,
        fact: "exposures.csv has no exposure for bad.png",
        hint: "add a line",
    },
    Case {
        name: "table of exposures that isn't there",
        args: &["merge", "bad.png", "--exposures", "gone.csv"],
        change: None,
        fact: "gone.csv: No such file",
        hint: "CSV",
    },
    Case {
        name: "shape that isn't one",
        args: &["shape", "bowl", "--radius=-1", "--out", "s.ply"],
        change: None,
        fact: "-1",
        hint: "",
    },
    Case {
        name: "offset of a shape out of its range",
        args: &["shape", "designed", "--offset", "5", "--out", "s.ply"],
        change: None,
        fact: "invalid value '5' for '--offset <C>'",
        hint: "`rig shape --help`",
    },
    Case {
        name: "mesh into a folder that doesn't exist",
        args: &["shape", "bowl", "--out", "gone/s.ply"],
        change: None,
        fact: "gone/s.ply: No such file or directory",
        hint: "check the path's spelling",
    },
    Case {
        name: "mesh in place of a folder",
        args: &["shape", "bowl", "--out", "f.ply"],
        change: None,
        fact: "f.ply: it exists and is not a regular file",
        hint: "",
    },
    Case {
        name: "calibration of no rig",
        args: &["calibrate", "sensor", "--rig", "gone.toml"],
        change: None,
        fact: "gone.toml: No such file",
        hint: "check the path",
    },
    Case {
        name: "no such port",
        args: &[
            "stage",
            "status",
            "--driver",
            "grbl",
            "--port",
            "gone/ttyUSB9",
        ],
        change: None,
        fact: "gone/ttyUSB9 does not exist",
        hint: "`rig devices`",
    },
    Case {
        name: "unknown option of a nested command",
        args: &["brdf", "eval", "--angels", "a.csv"],
        change: None,
        fact: "unexpected argument '--angels'",
        hint: "`rig brdf eval --help`",
    },
];

fn run(folder: &Path, args: &[&str], environment: Option<&str>) -> Output {
    let mut command = Command::cargo_bin("rig").unwrap();
    command
        .current_dir(folder)
        .env_remove("RIG_CONFIG")
        .env_remove("RUST_BACKTRACE")
        .args(args);
    if let Some(value) = environment {
        command.env("RIG_CONFIG", value);
    }
    command.output().unwrap()
}

/// The contract of a failed command.
fn assert_fails_well(name: &str, output: &Output, fact: &str, hint: &str) {
    let stderr = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(1), "{name}: {stderr}");
    let lines: Vec<_> = stderr.lines().collect();
    assert_eq!(lines.len(), 3, "{name}: {stderr}");
    assert!(lines[0].starts_with("error: "), "{name}: {stderr}");
    assert!(lines[0].contains(fact), "{name}: {stderr}");
    assert!(lines[1].is_empty(), "{name}: {stderr}");
    assert!(lines[2].starts_with("hint: "), "{name}: {stderr}");
    assert!(lines[2].contains(hint), "{name}: {stderr}");
    assert!(output.stdout.is_empty(), "{name} wrote to stdout");
}

/// Runs each case in a folder of its own, with `file` made from `text`.
fn run_cases(cases: &[Case], file: &str, text: &str, others: &[(&str, &[u8])]) {
    for case in cases {
        let folder = tempfile::tempdir().unwrap();
        let mut text = text.to_owned();
        if let Some((from, to)) = case.change {
            assert!(text.contains(from), "{}: no {from:?}", case.name);
            text = text.replacen(from, to, 1);
        }
        std::fs::write(folder.path().join(file), text).unwrap();
        for (name, bytes) in others {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        std::fs::create_dir(folder.path().join("f.ply")).unwrap();
        let output = run(folder.path(), case.args, None);
        assert_fails_well(case.name, &output, case.fact, case.hint);
    }
}

#[test]
fn every_bad_rig_or_command_line_gets_a_fact_a_hint_and_exit_code_1() {
    let simulated = include_str!("../../rig-configs/simulated.toml");
    let noise: &[u8] = &[0xff, 0xfd, 0x00, 0x80];
    run_cases(CASES, "rig.toml", simulated, &[("noise.toml", noise)]);
}

#[test]
fn every_bad_scene_or_file_gets_a_fact_a_hint_and_exit_code_1() {
    let noise: Vec<u8> = (0..300u32).map(|i| (i * 7919 % 251) as u8).collect();
    let mut files: Vec<(&str, &[u8])> = ["bad.exr", "bad.ply", "bad.stl", "bad.binary", "bad.png"]
        .map(|name| (name, noise.as_slice()))
        .to_vec();
    files.push(("huge.ply", HUGE_PLY.as_bytes()));
    files.push(("exposures.csv", b"a.png,1\n"));
    run_cases(SCENE_CASES, "scene.toml", SCENE, &files);
}

/// A rig that was named and fails is never replaced by another one.
#[test]
fn no_layer_of_the_configuration_is_skipped_because_it_fails() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), &["doctor"], Some("gone.toml"));
    assert_fails_well("RIG_CONFIG", &output, "gone.toml: No such file", "path");
    std::fs::write(folder.path().join("rig.toml"), "[rig]\n").unwrap();
    let output = run(folder.path(), &["doctor"], None);
    assert_fails_well(
        "./rig.toml",
        &output,
        "rig.toml:1: `rig.name` is missing",
        "unit",
    );
}

/// Damaged calibration records fail the doctor's check, not the doctor.
#[test]
fn a_damaged_record_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let simulated = include_str!("../../rig-configs/simulated.toml");
    std::fs::write(folder.path().join("rig.toml"), simulated).unwrap();
    let sensor = folder.path().join("calibration/simulated/sensor");
    std::fs::create_dir_all(&sensor).unwrap();
    std::fs::write(sensor.join("x.toml"), "id = \"x\"\nkind = \"nonsense\"\n").unwrap();
    let output = run(folder.path(), &["doctor", "--json"], None);
    assert_eq!(output.status.code(), Some(1));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = found["checks"].as_array().unwrap();
    let check = checks
        .iter()
        .find(|check| check["name"] == "sensor")
        .unwrap();
    assert_eq!(check["verdict"], "failed");
    assert!(
        check["fact"]
            .as_str()
            .unwrap()
            .contains("x.toml:2: unknown variant"),
        "{check}"
    );
    assert!(
        check["remedy"]
            .as_str()
            .unwrap()
            .contains("the record was changed or damaged"),
        "{check}"
    );
}
