//! What comes from outside cannot hold the program, fill its memory, or speak to the terminal:
//! special files, long input, control characters, changed records, limits of the shell.

use std::process::Output;

use assert_cmd::Command;

use crate::bad_input::assert_fails_well;
use crate::command_support::{SCENE, run, words};

/// A folder with a rig file, a scene, a named pipe under every ending that a reader knows, and
/// links to a device that never ends.
fn with_special_files() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(
        path("rig.toml"),
        include_str!("../../rig-configs/simulated.toml"),
    )
    .unwrap();
    std::fs::write(path("scene.toml"), SCENE).unwrap();
    image::GrayImage::new(8, 8)
        .save(path("whole_1ms.png"))
        .unwrap();
    for ending in ["toml", "exr", "png", "csv", "binary", "bsdf", "ply", "json"] {
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        let pipe = path(&format!("pipe_1ms.{ending}"));
        let kind = rustix::fs::FileType::Fifo;
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, kind, mode, 0).unwrap();
        let device = path(&format!("zero_1ms.{ending}"));
        std::os::unix::fs::symlink("/dev/zero", device).unwrap();
    }
    folder
}

/// Nothing waits for a pipe's writer, and nothing reads a device without end.
#[test]
fn what_is_no_regular_file_is_refused_at_once() {
    let folder = with_special_files();
    let sensor = "--gain 1 --read-noise 1 --black-level 0";
    for kind in ["pipe", "zero"] {
        for command in [
            "doctor --rig KIND_1ms.toml".to_owned(),
            "fit --scene KIND_1ms.toml --image a.exr --out o".into(),
            "fit --scene scene.toml --image KIND_1ms.exr --out o".into(),
            "fit --scene scene.toml --image KIND_1ms.exr --dictionary KIND_1ms.json --out o".into(),
            format!("merge KIND_1ms.png {sensor}"),
            format!("merge whole_1ms.png --exposures KIND_1ms.csv {sensor}"),
            "merge whole_1ms.png --response KIND_1ms.toml".into(),
            "brdf check KIND_1ms.binary".into(),
            "brdf check KIND_1ms.bsdf".into(),
            "brdf check rig26:KIND_1ms.csv".into(),
            "brdf eval lambertian:1 --angles KIND_1ms.csv".into(),
            "calibrate white KIND_1ms.exr --reflectance 0.9 --reflectance-std 0.01 --rig rig.toml"
                .into(),
        ] {
            let command = command.replace("KIND", kind);
            let output = Command::cargo_bin("rig")
                .unwrap()
                .current_dir(folder.path())
                .args(command.split_whitespace())
                .timeout(std::time::Duration::from_secs(60))
                .output()
                .unwrap();
            let fact = match kind {
                "pipe" => "it is a named pipe, not a regular file",
                _ => "it is a device, not a regular file",
            };
            assert_fails_well(&command, &output, fact, "");
        }
    }
}

/// What is quoted from a file is cut, whatever reader quotes it.
#[test]
fn long_input_does_not_come_back_whole() {
    let folder = tempfile::tempdir().unwrap();
    let long = "7".repeat(1 << 16);
    let scene = SCENE.replacen("[sample]", "[sample]\nmesh = \"m.obj\"", 1);
    for (name, text) in [
        (
            "a.obj",
            format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {long}x\n"),
        ),
        ("b.obj", format!("v {long}y 0 0\n")),
        (
            "c.stl",
            format!("solid s\nfacet normal 0 0 0\nouter loop\nvertex {long}z 0 0\n"),
        ),
        (
            "d.ply",
            format!("ply\nformat ascii 1.0\nelement vertex {long}\nend_header\n"),
        ),
        ("e.ply", format!("ply\nformat {long} 1.0\nend_header\n")),
        ("key.toml", format!("x{long} = 1\n")),
        ("value.toml", format!("camera = \"{long}\"\n")),
        ("syntax.toml", format!("{long} {long}\n")),
        ("table.csv", format!("a_1ms.png,{long}x\n")),
        (
            "weights.csv",
            format!("atom,kind,weight_r,weight_g,weight_b\n{long},ggx,1,1,1\n"),
        ),
        (
            "angles.csv",
            format!("theta_i_deg,theta_o_deg,phi_deg\n{long}x,1,1\n"),
        ),
        (
            "atoms.json",
            format!("{{\"atoms\": [{{\"type\": \"{long}\"}}]}}"),
        ),
        ("name_1ms.png", String::new()),
    ] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let meshes = ["a.obj", "b.obj", "c.stl", "d.ply", "e.ply"];
    for (number, mesh) in meshes.iter().enumerate() {
        let scene = scene.replace("m.obj", mesh);
        let without_shape: Vec<_> = scene.lines().filter(|l| !l.starts_with("shape")).collect();
        let name = format!("scene-{number}.toml");
        std::fs::write(folder.path().join(name), without_shape.join("\n")).unwrap();
    }
    let sensor = "--gain 1 --read-noise 1 --black-level 0";
    let mut commands: Vec<String> = (0..meshes.len())
        .map(|number| format!("render --scene scene-{number}.toml --out r.exr"))
        .collect();
    commands.extend([
        "doctor --rig key.toml".to_owned(),
        "doctor --rig value.toml".into(),
        "doctor --rig syntax.toml".into(),
        format!("merge name_1ms.png --exposures table.csv {sensor}"),
        "brdf check rig26:weights.csv".into(),
        "brdf eval --brdf lambertian:1 --angles angles.csv".into(),
        "fit --scene scene-0.toml --image a.exr --dictionary atoms.json --out o".into(),
    ]);
    for command in commands {
        let words: Vec<&str> = command.split_whitespace().collect();
        let output = run(folder.path(), &words);
        assert_fails_well(&command, &output, "", "");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            said.chars().count() < 2000,
            "{command}: {} characters",
            said.len()
        );
        assert!(
            said.contains('…') || !said.contains("777"),
            "{command}: {said}"
        );
    }
    // A reader that cuts nothing is still bounded where the error goes out.
    let name = "n".repeat(100_000);
    let output = run(folder.path(), &["brdf", "check", &name]);
    assert!(output.stderr.len() < 20_000, "{}", output.stderr.len());
}

/// Characters that a terminal obeys: colour, title, C1, order of the line, a line of its own.
const OBEYED: &str = "\u{1b}[31mA\u{7}\u{9b}2J\u{202e}B\u{2066}C\u{7f}";

fn assert_shown_escaped(what: &str, output: &Output) {
    let said = [&output.stdout[..], &output.stderr].concat();
    let said = String::from_utf8(said).unwrap();
    let raw = said
        .chars()
        .find(|&c| c != '\n' && rig::shown::is_obeyed(c));
    assert_eq!(raw, None, "{what}: {said:?}");
    assert!(
        said.contains("\\u{202e}B") || said.contains("\\u202eB"),
        "{what}: {said}"
    );
}

#[test]
fn nothing_that_a_terminal_obeys_reaches_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let simulated = include_str!("../../rig-configs/simulated.toml");
    // TOML writes them escaped; its reader gives them back raw.
    let escaped: String = OBEYED
        .chars()
        .map(|c| format!("\\u{:04X}", u32::from(c)))
        .collect();
    let key = format!("\"{escaped}\" = 1\n{simulated}");
    std::fs::write(path("key.toml"), key).unwrap();
    let serial = simulated.replace("SIM-0001", &escaped);
    assert_ne!(serial, simulated);
    std::fs::write(path("serial.toml"), serial).unwrap();
    let odd_name = format!("{OBEYED}\nok  fake_1ms.png");
    std::fs::write(path(&odd_name), "no image").unwrap();
    let odd = odd_name.as_str();
    for words in [
        &["doctor", "--rig", "key.toml"][..],
        &["doctor", "--rig", "serial.toml"],
        &["doctor", "--rig", "serial.toml", "--json"],
        &["calibrate", "status", "--rig", "serial.toml"],
        &["doctor", "--rig", odd],
        &["brdf", "check", odd],
        &words(&format!(
            "merge {odd} --gain 1 --read-noise 1 --black-level 0"
        )),
        &["session", "verify", odd],
        &["session", "list", odd],
        &["capture", "--lights", odd],
        &[odd],
    ] {
        let output = run(folder.path(), words);
        assert_shown_escaped(&format!("{words:?}"), &output);
        let lines = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!lines.lines().any(|l| l.starts_with("ok  fake")), "{lines}");
    }
}

/// A path that a program reads from a pipe is the file's own name, to the byte.
#[test]
fn a_path_in_a_pipe_is_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(
        folder.path(),
        &[
            "shape",
            "bowl",
            "--segments",
            "12",
            "--out",
            "b\u{202e}.ply",
        ],
    );
    assert!(output.status.success(), "{output:?}");
    let output = run(
        folder.path(),
        &[
            "brdf",
            "plot",
            "lambertian:1",
            "--size",
            "8",
            "--out",
            "a\u{202e}b.png",
        ],
    );
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text, "a\u{202e}b.png\n");
}

/// A record that somebody edits is noticed; one that is made by hand has no checksum.
#[test]
fn a_record_that_was_changed_after_the_measurement_is_named() {
    use rig::calibration::record::ScaleValues;
    use rig::calibration::{Library, parse_record};
    let folder = tempfile::tempdir().unwrap();
    let simulated = include_str!("../../rig-configs/simulated.toml");
    std::fs::write(folder.path().join("rig.toml"), simulated).unwrap();
    let id = "20261121T020000Z-scale";
    let shipped = include_bytes!("../../calibration/simulated/scale/20261121T020000Z-scale.toml");
    let (record, seal) = parse_record::<ScaleValues>(shipped, id, id).unwrap();
    assert_eq!(seal, rig::calibration::Seal::Whole);
    let library = Library::Folder(folder.path().join("calibration/simulated"));
    let file = library.add(&record, &[]).unwrap().unwrap();
    let measured = std::fs::read_to_string(&file).unwrap();
    let checksum = measured.lines().next().unwrap();
    assert!(checksum.starts_with("checksum = \""), "{measured}");

    let value = "value = 999907.9163430559";
    assert!(measured.contains(value));
    let edited = measured.replace(value, "value = 1499907.9163430559");
    let changed = "was changed after the measurement";
    for (text, verdict, fact) in [
        (measured.clone(), "ok", "record 2026"),
        (
            format!("{measured}# checked by hand\n"),
            "ok",
            "record 2026",
        ),
        (edited.clone(), "warning", changed),
        (
            measured.replace("std = 2515", "std = 1515"),
            "warning",
            changed,
        ),
        (
            measured.replace("gain = 1.0", "gain = 1.0000001"),
            "warning",
            changed,
        ),
        (edited.replacen(checksum, "", 1), "ok", "has no checksum"),
    ] {
        std::fs::write(&file, text).unwrap();
        let output = run(folder.path(), &["doctor", "--json"]);
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let mut checks = found["checks"].as_array().unwrap().iter();
        let check = checks.find(|check| check["name"] == "scale").unwrap();
        assert_eq!(check["verdict"], verdict, "{check}");
        assert!(check["fact"].as_str().unwrap().contains(fact), "{check}");
        // A capture warns of the same concerns.
        let output = run(folder.path(), &["calibrate", "status"]);
        let status = String::from_utf8(output.stdout).unwrap();
        assert_eq!(status.contains(changed), fact == changed, "{status}");
    }
}

/// The shell's limit of a file's size is an error of the write, not a death without a word.
#[test]
fn a_file_beyond_the_shells_limit_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let program = assert_cmd::cargo::cargo_bin("rig");
    for command in [
        "shape bowl --segments 64 --out m.ply",
        "shape bowl --segments 64 --out m.stl",
        "brdf convert lambertian:1 --out m.binary",
    ] {
        let script = format!("ulimit -f 8; exec {} {command}", program.display());
        let output = std::process::Command::new("bash")
            .args(["-c", &script])
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert_fails_well(command, &output, "File too large", "");
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            0,
            "{command}"
        );
    }
}
