//! `rig init`: questions as JSON, answers from a file, a session at a terminal, and what the
//! written file is worth to the other commands.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use crate::command_support::{assert_fails, cases, good, json, rig, run, text};
use rig::config::RigConfig;
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::{Value, json};

/// Answers for a camera that is not connected and a stage that is.
fn answers(stage: &str) -> Value {
    let mut answers = json!({
        "name": "cellar",
        "camera": "v4l /dev/v4l/by-id/usb-none-video-index0",
        "width_px": 800,
        "height_px": "600",
        "stage": stage,
        "port": "/dev/serial/by-id/usb-none-if00",
    });
    if stage == "zaber" {
        answers["mechanism"] = json!("gantry");
        answers["first_scale"] = json!(2016);
        answers["second_scale"] = json!(-2016.0);
    }
    answers
}

/// `rig init --answers -` in this folder.
fn init(folder: &Path, answers: &str, more: &[&str]) -> std::process::Output {
    let mut arguments = vec!["init", "--answers", "-"];
    arguments.extend(more);
    let mut child = rig(folder, &arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child
        .stdin
        .take()
        .unwrap()
        .write_all(answers.as_bytes())
        .unwrap();
    child.wait_with_output().unwrap()
}

/// What stands in the file is taken by `rig doctor` as far as that goes without the devices,
/// and by a dry run.
#[test]
fn the_written_file_serves_the_other_commands() {
    for stage in ["grbl", "zaber", "dmx", "manual"] {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let made = json(init(at, &answers(stage).to_string(), &["--json"]));
        assert_eq!(made["file"], "rig.toml");
        let next: Vec<&str> = made["next"]
            .as_array()
            .unwrap()
            .iter()
            .map(|step| step.as_str().unwrap())
            .collect();
        assert_eq!(next[0], "rig doctor");
        assert!(next.contains(&"rig calibrate sensor"), "{next:?}");
        assert_eq!(made["steps"].as_array().unwrap().len(), next.len());

        let written = RigConfig::load(&at.join("rig.toml")).unwrap();
        assert_eq!(
            (written.name.as_str(), written.camera.resolution_px),
            ("cellar", [800, 600])
        );

        // Only the devices and the records are not there yet.
        let output = run(at, &["doctor", "--json"]);
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        for check in found["checks"].as_array().unwrap() {
            let name = check["name"].as_str().unwrap();
            let may_fail = ["camera", "stage", "sensor"].contains(&name);
            assert!(check["verdict"] != "failed" || may_fail, "{stage}: {check}");
        }
        let plan = json(run(
            at,
            &["capture", "--lights", "4", "--dry-run", "--json"],
        ));
        let lights = plan["lights"].as_array().map(Vec::len);
        assert_eq!(lights, Some(4), "{stage}: {plan}");
    }
}

/// The commands of the list are commands: each is understood as far as its capitals allow.
#[test]
fn the_next_steps_are_commands() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let made = json(init(
        at,
        &answers("grbl").to_string(),
        &["--json", "--out", "arm.toml"],
    ));
    for step in made["next"].as_array().unwrap() {
        let command = step.as_str().unwrap();
        assert!(command.ends_with(" --rig arm.toml"), "{command}");
        let mut path: Vec<&str> = command
            .split(' ')
            .skip(1)
            .take_while(|word| word.chars().all(|c| c.is_ascii_lowercase()))
            .collect();
        path.push("--help");
        let help = text(&good(run(at, &path)).stdout);
        let options = command
            .split(' ')
            .filter_map(|word| word.strip_prefix("--"));
        for option in options.map(|option| option.split('=').next().unwrap()) {
            assert!(help.contains(&format!("--{option}")), "{command}: {option}");
        }
    }
}

#[test]
fn the_questions_are_listed_for_programs() {
    let folder = tempfile::tempdir().unwrap();
    let questions = json(run(folder.path(), &["init", "--questions", "--json"]));
    let questions = questions.as_array().unwrap();
    let of = |key: &str| {
        questions
            .iter()
            .find(|q| q["key"] == key)
            .unwrap_or_else(|| panic!("{key}"))
    };
    assert_eq!(of("width_px")["kind"], "number");
    assert_eq!(
        (&of("width_px")["least"], &of("width_px")["most"]),
        (&json!(16.0), &json!(16384.0))
    );
    assert_eq!(of("housing")["kind"], "yes-no");
    assert_eq!(
        of("mechanism")["when"],
        json!({"key": "stage", "is": ["grbl", "zaber"]})
    );
    assert_eq!(of("stage")["choices"][0]["value"], "grbl");
    assert_eq!(of("warm_up_s")["unit"], "s");
    assert!(!folder.path().join("rig.toml").exists());
    // The defaults of all of them, but for the port, make a file.
    let made = json(init(
        folder.path(),
        r#"{"camera": "v4l /dev/video0", "port": "/dev/ttyACM0"}"#,
        &["--json"],
    ));
    assert_eq!(made["file"], "rig.toml");
}

#[test]
fn what_cannot_be_is_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // A key and its value in JSON; or all that is given.
    for [key, value, fact] in cases(
        r#"
        warm_up_s | 8000 | `warm_up_s` is 8000, but must be a number from 0 to 7200 (s)
        name | "Cellar" | `name` is Cellar, but must be 1 to 40 of a-z
        lamp_power | 3 | there is no question `lamp_power`
        stage | "zaber" | `first_scale` is missing
        camera | "command ./photo" | `camera` is command ./photo, but must be
        | [1, 2] | not an object of answers
        | {"name": | not an object of answers
    "#,
    ) {
        let mut answers = answers("grbl");
        let (given, hint) = match key {
            "" => (
                value.to_owned(),
                r#"answers are a JSON object such as {"name": "arm", "width_px": 1920}; `rig init --questions --json` lists the keys"#,
            ),
            key => {
                answers[key] = serde_json::from_str(value).unwrap();
                let lists = "`rig init --questions --json` lists every question";
                (answers.to_string(), lists)
            }
        };
        let output = init(at, &given, &[]);
        assert_fails(&output, 1, fact, hint);
        assert_eq!(std::fs::read_dir(at).unwrap().count(), 0, "{fact}");
    }
    let missing = run(at, &["init", "--answers", "none.json"]);
    assert_fails(
        &missing,
        1,
        "none.json",
        "name the file of answers, or - for standard input",
    );
    let no_terminal = rig(at, &["init"]).stdin(Stdio::null()).output().unwrap();
    assert_fails(
        &no_terminal,
        1,
        "the questions need a terminal",
        "give a file of answers with --answers",
    );

    // What exists stays, whatever it is.
    std::fs::write(at.join("rig.toml"), "mine").unwrap();
    let output = init(at, &answers("grbl").to_string(), &[]);
    assert_fails(
        &output,
        1,
        "rig.toml exists",
        "name another file with --out; a rig file is never replaced",
    );
    assert_eq!(std::fs::read(at.join("rig.toml")).unwrap(), b"mine");
}

/// A still camera on USB, as gphoto2 lists it, is the first choice of cameras that have no
/// device file.
#[test]
fn still_cameras_are_choices() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("gphoto2");
    std::fs::write(
        &program,
        "#!/bin/sh\nprintf 'Model                          Port\\n----------------------------------------------------------\\nNikon DSC D850                 usb:001,005\\n'\n",
    )
    .unwrap();
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    std::fs::set_permissions(&program, mode).unwrap();
    let path = format!(
        "{}:{}",
        folder.path().display(),
        std::env::var("PATH").unwrap()
    );
    let output = rig(folder.path(), &["init", "--questions", "--json"])
        .env("PATH", path)
        .output()
        .unwrap();
    let questions = json(output);
    let camera = questions
        .as_array()
        .unwrap()
        .iter()
        .find(|q| q["key"] == "camera")
        .unwrap();
    let choice = camera["choices"]
        .as_array()
        .unwrap()
        .iter()
        .find(|choice| choice["value"] == "gphoto2 port=usb:001,005");
    let label = choice.unwrap_or_else(|| panic!("{camera}"))["label"]
        .as_str()
        .unwrap();
    assert!(label.contains("Nikon DSC D850"), "{label}");
}

/// `rig` at a terminal of its own, and what it shows there.
pub(crate) struct Terminal {
    child: Child,
    keys: File,
    shown: Receiver<Vec<u8>>,
    text: String,
}

impl Terminal {
    pub(crate) fn start(folder: &Path, arguments: &[&str]) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        let open = || {
            File::options()
                .read(true)
                .write(true)
                .open(Path::new(name.to_str().unwrap()))
                .unwrap()
        };
        let child = rig(folder, arguments)
            .stdin(OwnedFd::from(open()))
            .stderr(OwnedFd::from(open()))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let keys = File::from(master);
        let mut screen = keys.try_clone().unwrap();
        let (sender, shown) = channel();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            // A terminal whose last program has gone answers with an error.
            while let Ok(bytes @ 1..) = screen.read(&mut buffer) {
                if sender.send(buffer[..bytes].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self {
            child,
            keys,
            shown,
            text: String::new(),
        }
    }

    /// Waits until this is shown, after what was waited for before.
    pub(crate) fn wait_for(&mut self, wanted: &str) {
        let began = Instant::now();
        loop {
            if let Some(at) = self.text.find(wanted) {
                self.text.drain(..at + wanted.len());
                return;
            }
            assert!(
                began.elapsed() < Duration::from_secs(60),
                "no {wanted:?} in {:?}",
                self.text
            );
            if let Ok(bytes) = self.shown.recv_timeout(Duration::from_millis(100)) {
                self.text += &String::from_utf8_lossy(&bytes);
            }
        }
    }

    pub(crate) fn enter(&mut self, line: &str) {
        self.keys.write_all(format!("{line}\n").as_bytes()).unwrap();
    }

    /// What it printed, once it has ended well.
    pub(crate) fn finish(mut self) -> String {
        let status = self.child.wait().unwrap();
        assert!(status.success(), "{}", self.text);
        let mut printed = String::new();
        let mut stdout = self.child.stdout.take().unwrap();
        stdout.read_to_string(&mut printed).unwrap();
        printed
    }

    /// Answers a question that is recognised by its title.
    fn answer(&mut self, title: &str, line: &str) {
        self.wait_for(title);
        self.wait_for("] ");
        self.enter(line);
    }

    /// Waits for a refusal, then answers the question anew.
    fn correct(&mut self, refusal: &str, line: &str) {
        self.wait_for(refusal);
        self.wait_for("] ");
        self.enter(line);
    }
}

/// Defaults by Enter, a choice by its number, bad answers asked again with the range, and a
/// relation named as soon as it is broken.
#[test]
fn a_session_at_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut terminal = Terminal::start(at, &["init"]);
    terminal.answer("Name of the bench", "My Bench");
    terminal.correct(
        "My Bench is not possible: it must be 1 to 40 of a-z, 0-9 and -",
        "attic",
    );
    terminal.answer("Camera", "v4l /dev/v4l/by-id/usb-none-video-index0");
    terminal.answer("Width of a frame", "640");
    terminal.answer("Height of a frame", "480");
    terminal.answer("Significant bits", "20");
    terminal.correct(
        "20 is not possible: it must be a whole number from 8 to 16 (bits)",
        "12",
    );
    terminal.answer("Colour filters", "1");
    terminal.answer("Lens", "");
    terminal.answer("Width of the field of view", "30");
    terminal.answer("Distance from the lens", "");
    terminal.answer("Angle of the camera's axis", "");
    terminal.answer("stand in the lamp's way", "no");
    terminal.answer("Shape of the sample", "2");
    terminal.answer("Radius of the sample", "14");
    terminal.correct("14 is not possible: it must be such that the sample (14 mm from its middle) is within 11.25 mm", "9");
    terminal.answer("Stage that brings", "4");
    for title in [
        "Distance from the lamp",
        "Directions of the lights",
        "Channels of the lamp",
    ] {
        terminal.answer(title, "");
    }
    terminal.answer("Wait with the lamp on", "600");
    terminal.answer("Will you state results", "yes");
    for (title, line) in [
        ("Company", "Institute of Optics"),
        ("Laboratory", "Attic"),
        ("Who works", "A. Miller"),
        ("Whom to ask", "B. Jones"),
        ("City of", "Espoo"),
        ("Temperature of the room", "22.5"),
        ("Relative humidity", "45"),
    ] {
        terminal.wait_for(title);
        terminal.wait_for(") ");
        terminal.enter(line);
    }
    terminal.wait_for("\r\nNext, in this order");
    terminal.wait_for("\r\n  1. rig doctor\r\n     ");
    terminal.wait_for("rig calibrate sensor");
    assert!(!terminal.text.contains("\\n"), "{}", terminal.text);
    assert_eq!(terminal.finish(), "rig.toml\n");
    let written = RigConfig::load(&at.join("rig.toml")).unwrap();
    assert_eq!(written.name, "attic");
    assert_eq!(written.stage.driver_name(), "manual");
    assert_eq!(written.capture.lamp_warm_up.0, 600.0);
    assert_eq!(written.lab.laboratory.as_deref(), Some("Attic"));
    assert_eq!(written.lab.room_temperature_c, Some(22.5));
    assert_eq!(written.geometry.camera_body, None);
}

/// Ctrl-C, and the end of input, leave nothing behind.
#[test]
fn a_session_that_ends_early_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut terminal = Terminal::start(at, &["init"]);
    terminal.answer("Name of the bench", "attic");
    terminal.wait_for("Camera");
    kill_process(Pid::from_child(&terminal.child), Signal::INT).unwrap();
    assert!(!terminal.child.wait().unwrap().success());
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 0);

    let mut terminal = Terminal::start(at, &["init"]);
    terminal.wait_for("Name of the bench");
    terminal.wait_for("] ");
    // Ctrl-D.
    terminal.keys.write_all(&[4]).unwrap();
    terminal.wait_for("the input ended before all questions were answered");
    terminal.wait_for("nothing was written; run it again and answer each, Enter takes the default");
    assert_eq!(terminal.child.wait().unwrap().code(), Some(1));
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 0);
}
