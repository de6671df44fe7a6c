//! What the program says to bad input: one line that states the fact, a blank
//! line, a hint, exit code 1; never a panic.

use std::process::Output;

use crate::command_support::{SCENE, assert_fails, cases, rig, run, words};

/// Bad inputs and what must be said about them, one a line: name, command line, a text of the rig
/// or scene file with what it is replaced by, part of the error's line, part of the hint.
const CASES: &str = r#"
unknown command | captrue | | unrecognized subcommand 'captrue' | `rig --help`
unknown option | doctor --colour | | unexpected argument '--colour' | '--color'
bad value of an option | doctor --color sometimes | | invalid value 'sometimes' for '--color <WHEN>' | --help
missing argument | man | | --out <DIR> | `rig man --help`
contradicting options | doctor -q -v | | cannot be used with | `rig doctor --help`
folder that is a file | man --out rig.toml | | rig.toml: File exists | another folder
missing rig file | doctor --rig nowhere/rig.toml | | nowhere/rig.toml: No such file or directory | check the path
rig file that is a folder | doctor --rig ./ | | Is a directory | check the path
rig file that is no text | doctor --rig noise.toml | | noise.toml: it is no UTF-8 text | TOML
rig file that is a device | doctor --rig /dev/null | | /dev/null: it is a device, not a regular file | regular file
unknown rig name | doctor --rig simulate | | there is no rig named "simulate"; known: dmx-dome-v4l2, grbl-arm-tilted, grbl-arm-v4l2, rehearsal-ball, rehearsal-board, rehearsal-corner, rehearsal-edge, rehearsal-flat, rehearsal-tile, rehearsal-torch, simulated, simulated-5mp-bayer, simulated-ball, simulated-tilted, zaber-gantry-v4l2 | did you mean `simulated`?
not TOML | doctor --rig rig.toml | [rig] => [rig | not valid TOML | toml.io
unknown key | doctor --rig rig.toml | bit_depth = 12 => bit_deth = 12 | `camera.bit_depth` is missing; it must be an integer from 8 to 16 | is `bit_deth` meant to be it?
unknown key beside all that are needed | doctor --rig rig.toml | max_frames = => max_frame = | unknown key `capture.max_frame`; known here: shortest_ms, | did you mean `max_frames`?
unknown table | doctor --rig rig.toml | [fit] => [fits] | unknown key `fits` | did you mean `fit`?
wrong type | doctor --rig rig.toml | snr = 20.0 => snr = "high" | `capture.snr` is "high", but must be a number from 1 to 10000 | unit and range
value out of range | doctor --rig rig.toml | max_reflections = 16 => max_reflections = 65 | `fit.max_reflections` is 65, but must be an integer from 2 to 64 | unit and range
integer beyond 64 bits | doctor --rig rig.toml | seed = 7 => seed = 99999999999999999999999 | `simulation.seed` is 99999999999999999999999, but must be an integer | unit and range
not a number | doctor --rig rig.toml | extent_mm = [29.3, 22.0] => extent_mm = [29.3, nan] | `geometry.camera.extent_mm` is [29.3, NaN] | unit and range
camera that looks along its up direction | doctor --rig rig.toml | up = [0.0, 1.0, 0.0] => up = [0.0, 0.0, 1.0] | `geometry.camera.up` | unit and range
camera body without its length | doctor --rig rig.toml | point_spread_px = 0.5 => body = { radius_mm = 20.0 } | `geometry.camera.body.length_mm` is missing; it must be a number from 0.5 to 10000 | unit and range
camera body with a misspelt key | doctor --rig rig.toml | point_spread_px = 0.5 => body = { radius_mm = 20.0, length_mm = 100.0, font_mm = 5.0 } | unknown key `geometry.camera.body.font_mm` | did you mean `front_mm`?
camera body that reaches into the sample | doctor --rig rig.toml | point_spread_px = 0.5 => body = { radius_mm = 20.0, length_mm = 100.0, front_mm = 200.0 } | `geometry.camera.body.front_mm` is 200, but must be below 200.0, the distance at which the image is sharp | unit and range
exposures that the camera hasn't | doctor --rig rig.toml | longest_ms = 500.0 => longest_ms = 1e9 | `capture.longest_ms` is 1000000000, but must be a number from 0.05 to 2000 | unit and range
lamp command that acts out of turn | doctor --rig rig.toml | on = "M8" => on = "!" | `stage.lamp[2].on` is "!" | unit and range
one simulated and one real device | doctor --rig rig.toml | [stage]\n# "grbl" (GRBL 1.1 on a serial port) or "simulated" (the same protocol, spoken\n# by simulated firmware on a pseudo-terminal) (required).\ndriver = "simulated" => [stage]\ndriver = "grbl"\nport = "/dev/ttyUSB9" | `stage.driver` is "grbl", but must be simulated together with the camera | unit and range
report of a folder that is no session | report . | | is not a session | folder of a session
report of nothing | report sessions/gone | | sessions/gone | session
export in an unknown format | export . --format pdf | | invalid value 'pdf' for '--format <FORMAT>' | `rig export --help`
export of a folder without a fit | export . --format json | | fit | fit
"#;

/// Declares more vertices and faces than any file of its size can hold.
const HUGE_PLY: &str = "ply\nformat binary_little_endian 1.0\n\
    element vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\n\
    element face 4000000000\nproperty list uchar int vertex_indices\nend_header\n";

const SCENE_CASES: &str = r#"
missing scene | render --scene gone.toml --out x.exr | | gone.toml: No such file | check the path
unknown table of a scene | render --scene scene.toml --out x.exr | [brdf] => [brdff] | scene.toml:15: unknown key `brdff` | did you mean `brdf`?
missing mesh | render --scene scene.toml --out x.exr | shape = { kind = "bowl", radius_mm = 1.0, segments = 16 } => mesh = "gone.ply" | gone.ply: No such file | check the path
mesh of another kind | render --scene scene.toml --out x.exr | shape = { kind = "bowl", radius_mm = 1.0, segments = 16 } => mesh = "bad.step" | bad.step: the file name does not end in .ply |
STL mesh that declares more than it holds | render --scene scene.toml --out x.exr | shape = { kind = "bowl", radius_mm = 1.0, segments = 16 } => mesh = "bad.stl" | bad.stl: the file is cut short: it declares 2668988151 facets | it is not whole
mesh that is none | render --scene scene.toml --out x.exr | shape = { kind = "bowl", radius_mm = 1.0, segments = 16 } => mesh = "bad.ply" | bad.ply: | let it write a binary PLY
mesh that declares more than it holds | render --scene scene.toml --out x.exr | shape = { kind = "bowl", radius_mm = 1.0, segments = 16 } => mesh = "huge.ply" | huge.ply: | it is not whole
measured table that is none | render --scene scene.toml --out x.exr | mixture = [ { weight = 1.0, lambertian = { albedo = 0.5 } } ] => table = "bad.binary" | bad.binary | damaged
folder that doesn't exist | render --scene scene.toml --out gone/x.exr | | gone is not a folder | --out
missing image | fit --scene scene.toml --image gone.exr --out f | | gone.exr: No such file | check the path's spelling
image that is none | fit --scene scene.toml --image bad.exr --out f | | bad.exr is not a readable OpenEXR file | the image is damaged or no OpenEXR file: render or merge it again
unknown dictionary | fit --scene scene.toml --image bad.exr --out f --dictionary paper43 | | "paper43" is no BRDF or dictionary known here | names
session that isn't there | fit gone | | gone is not a session: there is no such folder | session
unknown material | brdf check nbrdf:unobtainium | | no embedded material "unobtainium" | red-plastic
width beyond the closed form | brdf check ggx:9,1.5 | | alpha 9, allowed is 0.001 to 1 | `rig brdf --help`
frame without an exposure | merge bad.png --exposures exposures.csv | | exposures.csv has no exposure for bad.png | add a line
table of exposures that isn't there | merge bad.png --exposures gone.csv | | gone.csv: No such file | CSV
shape that isn't one | shape bowl --radius=-1 --out s.ply | | -1 |
offset of a shape out of its range | shape designed --offset 5 --out s.ply | | invalid value '5' for '--offset <C>' | `rig shape --help`
mesh into a folder that doesn't exist | shape bowl --out gone/s.ply | | gone/s.ply: No such file or directory | check the path's spelling
plot into a folder that does not exist | brdf plot nbrdf:pvc --out gone/m.png | | gone/m.png: No such file or directory | choose a file in a folder that exists and can be written
mesh in place of a folder | shape bowl --out f.ply | | f.ply: it exists and is not a regular file |
calibration of no rig | calibrate sensor --rig gone.toml | | gone.toml: No such file | check the path
no such port | stage status --driver grbl --port gone/ttyUSB9 | | gone/ttyUSB9 does not exist | `rig devices`
unknown option of a nested command | brdf eval --angels a.csv | | unexpected argument '--angels' | `rig brdf eval --help`
"#;

/// The contract of a failed command.
pub fn assert_fails_well(name: &str, output: &Output, fact: &str, hint: &str) {
    println!("{name}");
    assert_fails(output, 1, fact, hint);
    assert_eq!(
        output.stderr.split(|&byte| byte == b'\n').count(),
        4,
        "{name}"
    );
    assert!(output.stdout.is_empty(), "{name} wrote to stdout");
}

/// Runs each case in a folder of its own, with `file` made from `text`.
fn run_cases(table: &str, file: &str, text: &str, others: &[(&str, &[u8])]) {
    for [name, arguments, change, fact, hint] in cases(table) {
        let folder = tempfile::tempdir().unwrap();
        let mut text = text.to_owned();
        if let Some((from, to)) = change.replace("\\n", "\n").split_once(" => ") {
            assert!(text.contains(from), "{name}: no {from:?}");
            text = text.replacen(from, to, 1);
        }
        std::fs::write(folder.path().join(file), text).unwrap();
        for (name, bytes) in others {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        std::fs::create_dir(folder.path().join("f.ply")).unwrap();
        let output = run(folder.path(), &words(arguments));
        assert_fails_well(name, &output, fact, hint);
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
    let mut doctor = rig(folder.path(), &["doctor"]);
    let output = doctor.env("RIG_CONFIG", "gone.toml").output().unwrap();
    assert_fails_well("RIG_CONFIG", &output, "gone.toml: No such file", "path");
    std::fs::write(folder.path().join("rig.toml"), "[rig]\n").unwrap();
    let output = run(folder.path(), &["doctor"]);
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
    let output = run(folder.path(), &["doctor", "--json"]);
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
