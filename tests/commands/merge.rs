//! `rig merge` and `rig calibrate response` on folders of frames.

use std::path::Path;

fn rig() -> assert_cmd::Command {
    assert_cmd::Command::cargo_bin("rig").unwrap()
}

fn bracket() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/response")
}

/// The bracket of `tests/data/response` under names that state the exposures.
fn named_bracket(folder: &Path) {
    for n in [1, 2, 4, 8, 16] {
        let from = bracket().join(format!("bracket_{n:03}.png"));
        std::fs::copy(from, folder.join(format!("scene_1-{n}s.png"))).unwrap();
    }
}

fn write_grey(path: &Path, width: u32, counts: Vec<u16>) {
    let height = counts.len() as u32 / width;
    image::ImageBuffer::<image::Luma<u16>, _>::from_raw(width, height, counts)
        .unwrap()
        .save(path)
        .unwrap();
}

/// A folder of 8-bit frames becomes a response record and, with it, radiance:
/// ratios of radiances as the curve of a display gamma has them.
#[test]
fn a_folder_of_photographs_becomes_a_response_and_radiance() {
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    std::fs::create_dir(&frames).unwrap();
    named_bracket(&frames);
    for (method, id) in [("debevec", "first"), ("robertson", "second")] {
        rig()
            .current_dir(&folder)
            .args(["calibrate", "response", "frames", "--rig", "simulated"])
            .args(["--method", method, "--out", "records", "--id", id])
            .assert()
            .success()
            .stdout(format!("records/response/{id}.toml\n"));
    }
    rig()
        .current_dir(&folder)
        .args([
            "merge",
            "frames",
            "--response",
            "records/response/first.toml",
        ])
        .args(["--out", "out.exr"])
        .assert()
        .success();
    let file = rig::radiance_image::exr::read(&folder.path().join("out.exr")).unwrap();
    assert_eq!((file.image.width, file.image.height), (48, 32));
    let half = image::open(frames.join("scene_1-2s.png"))
        .unwrap()
        .to_rgb8();
    let (mut compared, mut worst) = (0, 0.0f64);
    for p in 1..48 * 32 {
        let count = |p: usize| f64::from(half.get_pixel(p as u32 % 48, p as u32 / 48)[0]);
        let (a, b) = (count(p - 1), count(p));
        if !(60.0..200.0).contains(&a) || !(60.0..200.0).contains(&b) {
            continue;
        }
        let expected = 2.2 * (b / a).ln();
        let found = f64::from(file.image.mean[p][0] / file.image.mean[p - 1][0]).ln();
        worst = worst.max((found - expected).abs());
        compared += 1;
    }
    // Two counts of noise in one frame are 4% of a radiance, and the curve's 5%.
    assert!(compared > 500 && worst < 0.15, "{worst} over {compared}");
}

/// Linear frames whose names state the exposures: the report's ratios are 1, and
/// a mosaic keeps its size only if asked.
#[test]
fn names_state_exposures_and_the_report_shows_how_they_agree() {
    let folder = tempfile::tempdir().unwrap();
    for (name, dn) in [("a_2ms.png", 100), ("b_8ms.png", 400)] {
        write_grey(&folder.path().join(name), 20, vec![64 + dn; 400]);
    }
    let sensor = [
        "--gain",
        "0.4",
        "--read-noise",
        "2.5",
        "--black-level",
        "64",
    ];
    for (more, size) in [(&[][..], 10), (&["--full-resolution"], 20)] {
        let output = rig()
            .current_dir(&folder)
            .args([
                "merge",
                ".",
                "--mosaic",
                "rggb",
                "--bit-depth",
                "12",
                "--json",
            ])
            .args(sensor)
            .args(more)
            .output()
            .unwrap();
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["width"], size, "{report}");
        let steps = report["channels"][0].as_array().unwrap();
        assert_eq!(steps.len(), 2);
        assert_eq!(steps[1]["exposure_s"], 0.008);
        let ratio = steps[1]["signal_ratio"].as_f64().unwrap();
        assert!((ratio - 1.0).abs() < 1e-6, "{ratio}");
        assert_eq!(steps[1]["moved_pixels"], 0);
        let file = rig::radiance_image::exr::read(&folder.path().join("radiance.exr")).unwrap();
        // 100 DN are 250 electrons in 2 ms.
        let off = f64::from(file.image.mean[50][1]) - 125_000.0;
        assert!(off.abs() < 1.0, "{off}");
        std::fs::remove_file(folder.path().join("radiance.exr")).unwrap();
    }
}

#[test]
fn bad_folders_are_refused_and_nothing_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for name in ["empty", "odd", "two", "dark", "photo"] {
        std::fs::create_dir(path(name)).unwrap();
    }
    write_grey(&path("odd/plain.png"), 4, vec![100; 16]);
    named_bracket(&path("two"));
    for n in [1, 2, 4] {
        std::fs::remove_file(path(&format!("two/scene_1-{n}s.png"))).unwrap();
    }
    for n in [1, 2, 4] {
        let black = image::RgbImage::new(32, 32);
        black.save(path(&format!("dark/scene_{n}s.png"))).unwrap();
    }
    image::RgbImage::new(8, 8)
        .save(path("photo/x_1s.jpg"))
        .unwrap();
    std::fs::write(path("out.exr"), "before").unwrap();
    let merge = ["merge", "--out", "out.exr"];
    let linear = ["--gain", "1", "--read-noise", "2", "--black-level", "0"];
    let response = [
        "calibrate",
        "response",
        "--rig",
        "simulated",
        "--out",
        "records",
    ];
    for (command, frames, more, fact) in [
        (&merge[..], "empty", &linear[..], "holds no frames"),
        (
            &merge,
            "odd",
            &linear,
            "exposure of odd/plain.png is unknown",
        ),
        (&merge, "photo", &linear, "not proportional to light"),
        (&merge, "two", &["--response", "odd/plain.png"], "plain.png"),
        (&response, "two", &[], "2 different exposures"),
        (&response, "dark", &[], "0 pixels are well exposed"),
        (&response, "odd", &[], "unknown"),
        (&response, "empty", &[], "holds no frames"),
    ] {
        let output = rig()
            .current_dir(&folder)
            .args(command)
            .arg(frames)
            .args(more)
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{fact}: {stderr}");
        assert!(stderr.contains(fact), "{fact}: {stderr}");
        assert!(stderr.contains("\n\nhint: "), "{fact}: {stderr}");
        assert_eq!(std::fs::read(path("out.exr")).unwrap(), b"before");
        assert!(!path("records").exists(), "{fact}: a record was written");
    }
}

/// A copy's noise is not independent: whatever names one frame twice is refused.
#[test]
fn one_frame_given_twice_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let counts = |seed: usize| (0..64).map(|p| (100 + p * seed % 97) as u16).collect();
    write_grey(&path("a_10ms.png"), 8, counts(7));
    write_grey(&path("b_10ms.png"), 8, counts(5));
    for copy in ["copy_10ms.png", "longer_40ms.png"] {
        std::fs::copy(path("a_10ms.png"), path(copy)).unwrap();
    }
    std::os::unix::fs::symlink("a_10ms.png", path("link_10ms.png")).unwrap();
    write_grey(&path("black_10ms.png"), 8, vec![0; 64]);
    write_grey(&path("black_40ms.png"), 8, vec![0; 64]);
    for (frames, fact) in [
        (
            &["a_10ms.png", "a_10ms.png"],
            Some("a_10ms.png is named twice"),
        ),
        (&["a_10ms.png", "./a_10ms.png"], Some("are one frame")),
        (&["a_10ms.png", "link_10ms.png"], Some("are one frame")),
        (
            &["a_10ms.png", "copy_10ms.png"],
            Some("a_10ms.png and copy_10ms.png are one frame"),
        ),
        (&["a_10ms.png", "longer_40ms.png"], Some("are one frame")),
        (&["a_10ms.png", "b_10ms.png"], None),
        // Black frames, as clipped ones, may well be equal.
        (&["black_10ms.png", "black_40ms.png"], None),
    ] {
        let output = rig()
            .current_dir(&folder)
            .arg("merge")
            .args(frames)
            .args(["--gain", "1", "--read-noise", "2", "--black-level", "0"])
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        match fact {
            Some(fact) => {
                assert_eq!(output.status.code(), Some(1), "{frames:?}: {stderr}");
                assert!(stderr.contains(fact), "{frames:?}: {stderr}");
            }
            None => assert_eq!(output.status.code(), Some(0), "{frames:?}: {stderr}"),
        }
    }
}
