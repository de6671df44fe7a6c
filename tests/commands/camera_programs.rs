//! `rig camera` as a command: figures, the preview's page, and cameras that are
//! programs or folders.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::process::{Child, Stdio};

use crate::command_support::{ended, run};
use image::{ImageBuffer, Luma};
use serde_json::Value;

fn rig(arguments: &[&str], folder: &Path) -> (i32, String, String) {
    ended(&run(folder, arguments))
}

/// A rig whose camera is a program that copies an image of 6 × 4 pixels.
fn rig_file(folder: &Path, camera: &str) {
    let text = include_str!("../../rig-configs/grbl-arm-v4l2.toml");
    let (before, rest) = text.split_once("[camera]").unwrap();
    let (_, after) = rest.split_once("[stage]").unwrap();
    let size = "resolution_px = [6, 4]\nbit_depth = 12\nshortest_ms = 1.0\nlongest_ms = 1000.0\n";
    let text = format!("{before}[camera]\n{camera}\n{size}\n[stage]{after}");
    std::fs::write(folder.join("rig.toml"), text).unwrap();
    let ramp = ImageBuffer::from_fn(6, 4, |x, y| {
        Luma([if x + y == 0 {
            4095
        } else {
            (800 * x + y) as u16
        }])
    });
    ramp.save(folder.join("ramp.tif")).unwrap();
    std::fs::write(folder.join("photo.sh"), "echo $1 >> told; cp ramp.tif $2").unwrap();
}

const PROGRAM: &str = "driver = \"command\"\ncommand = \"sh photo.sh {exposure_s} {output}\"";

#[test]
fn one_measurement_as_json() {
    let folder = tempfile::tempdir().unwrap();
    rig_file(folder.path(), PROGRAM);
    let preview = [
        "camera",
        "preview",
        "--json",
        "--exposure-ms",
        "20",
        "--discard",
        "1",
    ];
    let (code, stdout, stderr) = rig(&preview, folder.path());
    assert_eq!(code, 0, "{stderr}");
    let figures: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (
            figures["minimum_dn"].as_u64(),
            figures["maximum_dn"].as_u64()
        ),
        (Some(1), Some(4095))
    );
    assert_eq!(figures["clipped_pixels"], 1);
    assert_eq!(figures["exposure_s"], 0.02);
    // Rows 1 and 2, columns 1 to 3 of the ramp: 800 to the right, 1 down.
    let mean = 1601.5;
    let expected = f64::sqrt(800.0 * 800.0 + 1.0) / mean;
    assert!(
        (figures["sharpness"].as_f64().unwrap() - expected).abs() < 1e-9,
        "{stdout}"
    );
    let told = std::fs::read_to_string(folder.path().join("told")).unwrap();
    assert_eq!(told, "0.02\n0.02\n");
}

/// Ends the program whatever happens to the test.
struct Preview(Child);

impl Drop for Preview {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn get(address: &str, path: &str) -> (String, Vec<u8>) {
    let (host, token) = address.split_once('/').unwrap();
    let token = token.trim_end_matches('/');
    let mut client = TcpStream::connect(host).unwrap();
    let request =
        format!("GET /{token}{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    client.write_all(request.as_bytes()).unwrap();
    let mut bytes = Vec::new();
    client.read_to_end(&mut bytes).unwrap();
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n");
    let end = end.unwrap();
    let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
    (head, bytes.split_off(end + 4))
}

#[test]
fn the_preview_is_a_page_with_picture_and_figures() {
    let folder = tempfile::tempdir().unwrap();
    rig_file(folder.path(), PROGRAM);
    let mut child = Command::new(assert_cmd::cargo::cargo_bin("rig"))
        .args(["camera", "preview", "--port", "0"])
        .current_dir(folder.path())
        .env_remove("RIG_CONFIG")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let mut preview = Preview(child);
    let address = line.trim().strip_prefix("http://").unwrap();
    assert!(address.starts_with("127.0.0.1:"), "{address}");
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
    let picture = loop {
        let (head, picture) = get(address, "/api/live.jpg");
        if head.starts_with("HTTP/1.1 200") {
            assert!(head.contains("image/jpeg"), "{head}");
            break picture;
        }
        assert!(head.starts_with("HTTP/1.1 204"), "{head}");
        assert!(std::time::Instant::now() < deadline, "no picture");
        std::thread::sleep(std::time::Duration::from_millis(20));
    };
    let picture = image::load_from_memory(&picture).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (6, 4));
    // The page is there for whoever has the token, and the sample's outline goes with it.
    assert!(get(address, "/").1.starts_with(b"<!doctype html>"));
    let outline: Value = serde_json::from_slice(&get(address, "/api/outline").1).unwrap();
    assert_eq!(
        (outline["width"].as_u64(), outline["height"].as_u64()),
        (Some(6), Some(4))
    );
    let (host, _) = address.split_once('/').unwrap();
    assert!(
        get(&format!("{host}/guessed/"), "/")
            .0
            .starts_with("HTTP/1.1 404")
    );
    // There is no stage, and no folder of sessions.
    assert!(get(address, "/api/sessions").0.starts_with("HTTP/1.1 404"));

    // Ctrl-C ends it.
    let pid = rustix::process::Pid::from_child(&preview.0);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
    assert_eq!(preview.0.wait().unwrap().code(), Some(130));
    let mut said = String::new();
    let stderr = preview.0.stderr.take().unwrap();
    BufReader::new(stderr).read_to_string(&mut said).unwrap();
    assert!(!said.contains("error"), "{said}");
}

#[cfg(not(feature = "console"))]
#[test]
fn without_the_console_there_is_no_page() {
    let folder = tempfile::tempdir().unwrap();
    rig_file(folder.path(), PROGRAM);
    let (code, _, stderr) = rig(&["camera", "preview"], folder.path());
    assert_eq!(code, 1);
    assert!(stderr.contains("built without the console"), "{stderr}");
}

#[test]
fn a_program_that_fails_is_quoted() {
    let folder = tempfile::tempdir().unwrap();
    rig_file(folder.path(), PROGRAM);
    std::fs::write(
        folder.path().join("photo.sh"),
        "echo 'battery empty' >&2; exit 4",
    )
    .unwrap();
    let (code, stdout, stderr) = rig(&["camera", "grab"], folder.path());
    assert_eq!((code, stdout.as_str()), (1, ""));
    assert!(
        stderr.contains("exit code 4, and it wrote: battery empty"),
        "{stderr}"
    );
    assert!(stderr.contains("hint: "), "{stderr}");
}

#[test]
fn a_folder_is_a_camera() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("incoming")).unwrap();
    rig_file(
        folder.path(),
        "driver = \"folder\"\nfolder = \"incoming\"\nframe_timeout_s = 60.0",
    );
    let incoming = folder.path().join("incoming");
    let ramp = folder.path().join("ramp.tif");
    let photographer = std::thread::spawn(move || {
        let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
        while !incoming.join("rig-request.json").exists() && std::time::Instant::now() < deadline {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        std::fs::copy(ramp, incoming.join("IMG_0001.TIF")).unwrap();
    });
    let grab = [
        "camera",
        "grab",
        "--discard",
        "0",
        "--json",
        "--out",
        "frame.png",
    ];
    let (code, stdout, stderr) = rig(&grab, folder.path());
    photographer.join().unwrap();
    assert_eq!(code, 0, "{stderr}");
    let answer: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (answer["width"].as_u64(), answer["maximum_dn"].as_u64()),
        (Some(6), Some(4095))
    );
    let kept = image::open(folder.path().join("frame.png"))
        .unwrap()
        .to_luma16();
    let given = image::open(folder.path().join("ramp.tif"))
        .unwrap()
        .to_luma16();
    assert_eq!(kept, given);
}

#[test]
fn only_video4linux_cameras_have_controls() {
    let folder = tempfile::tempdir().unwrap();
    let (code, _, stderr) = rig(&["camera", "controls", "--rig", "simulated"], folder.path());
    assert_eq!(code, 1);
    assert!(
        stderr.contains("only Video4Linux cameras have controls"),
        "{stderr}"
    );
}
