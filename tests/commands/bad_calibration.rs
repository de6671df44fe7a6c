//! What cannot be calibrated from is refused with a fact and a hint, and leaves
//! the records as they were.

use crate::small_bench;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::command_support::run as rig;
use rig::radiance_image::{RadianceImage, exr};

/// The simulated rig with these lines changed, and a record of each kind that
/// must stay as it is.
fn workplace(changes: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut text = small_bench::rig_file();
    for (old, new) in changes {
        assert!(text.contains(old), "{old}");
        text = text.replace(old, new);
    }
    std::fs::write(folder.path().join("rig.toml"), text).unwrap();
    small_bench::put_records(folder.path());
    folder
}

/// Every file below a folder with its bytes.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.insert(path.clone(), std::fs::read(&path).unwrap());
        }
    }
    found
}

fn assert_refused(name: &str, folder: &Path, arguments: &[&str], fact: &str) -> String {
    let before = files(folder);
    let output = rig(folder, arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{name}: {stderr}");
    assert!(stderr.contains(fact), "{name}: {stderr}");
    assert!(stderr.contains("\n\nhint: "), "{name}: {stderr}");
    assert!(files(folder) == before, "{name}: a file has changed");
    stderr
}

#[test]
fn a_light_or_a_sensor_that_does_not_suit_is_named() {
    let (light, bend) = ("responsivity = 1.0e6", "nonlinearity = 0.0");
    let (dim, bright) = ("responsivity = 100.0", "responsivity = 1.0e10");
    let (too_dim, too_bright) = ("not to saturation", "in the shortest exposure of");
    let bent = "nonlinearity = -0.15";
    for (name, change, command, fact) in [
        ("dim", (light, dim), "sensor", too_dim),
        ("bright", (light, bright), "sensor", too_bright),
        (
            "bent",
            (bend, bent),
            "sensor",
            "at most 3% can be corrected",
        ),
        ("dim", (light, dim), "flat", too_dim),
        ("bright", (light, bright), "flat", too_bright),
    ] {
        let folder = workplace(&[change]);
        let name = format!("{command}, {name}");
        let arguments = ["calibrate", command, "--rig", "rig.toml", "--frames", "4"];
        let said = assert_refused(&name, folder.path(), &arguments, fact);
        let advice = "a steady, uniform light that saturates it";
        assert!(said.contains(advice), "{name}: {said}");
    }
    // A record of another camera is no ground for a flat field.
    let folder = workplace(&[("SIM-0001", "SIM-0009")]);
    let arguments = ["calibrate", "flat", "--rig", "rig.toml", "--frames", "4"];
    assert_refused("other camera", folder.path(), &arguments, "SIM-0001");
    // Neither is none, and a record needs its folder.
    let folder = workplace(&[("name = \"simulated\"", "name = \"other\"")]);
    let said = assert_refused("none", folder.path(), &arguments, "no sensor record");
    assert!(said.contains("run `rig calibrate sensor` first"), "{said}");
    let nowhere = [
        "calibrate",
        "sensor",
        "--rig",
        "rig.toml",
        "--out",
        "rig.toml/x",
    ];
    let said = assert_refused("no folder", folder.path(), &nowhere, "rig.toml/x: ");
    assert!(said.contains("records are kept there"), "{said}");
}

#[test]
fn a_standard_that_is_none_is_named() {
    let folder = workplace(&[]);
    let image = |name: &str, radiance: f32| {
        let mut image = RadianceImage::new(40, 30);
        image.mean.fill([radiance; 3]);
        image.variance.fill([1e-6; 3]);
        exr::write(&folder.path().join(name), &image).unwrap();
    };
    image("white.exr", 0.3);
    image("black.exr", 0.0);
    let whole = std::fs::read(folder.path().join("white.exr")).unwrap();
    std::fs::write(folder.path().join("torn.exr"), &whole[..whole.len() / 2]).unwrap();
    let good = ["--reflectance", "0.99", "--reflectance-std", "0.005"];
    for (name, file, certificate, more, fact) in [
        (
            "percent",
            "white.exr",
            ["--reflectance", "99", "--reflectance-std", "0.5"],
            &[][..],
            "a reflectance of 99",
        ),
        (
            "hardly known",
            "white.exr",
            ["--reflectance", "0.9", "--reflectance-std", "0.3"],
            &[],
            "0.9 ± 0.3",
        ),
        (
            "grazing",
            "white.exr",
            good,
            &["--incidence", "89"],
            "89.0 degrees",
        ),
        (
            "region outside",
            "white.exr",
            good,
            &["--region", "30,20,20,20"],
            "40 x 30 image",
        ),
        ("dark", "black.exr", good, &[], "the region is dark"),
    ] {
        let mut arguments = vec!["calibrate", "white", "--rig", "rig.toml", file];
        arguments.extend(certificate);
        arguments.extend(more);
        assert_refused(name, folder.path(), &arguments, fact);
    }
    // Damaged files are named; what to do about them is plain.
    let mut arguments = vec!["calibrate", "white", "--rig", "rig.toml", "torn.exr"];
    arguments.extend(good);
    let before = files(folder.path());
    let output = rig(folder.path(), &arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("torn.exr"), "{stderr}");
    assert!(files(folder.path()) == before);
}

#[test]
fn brackets_that_do_not_fit_together_are_named() {
    let folder = workplace(&[]);
    let png = |name: &str, width: u32| {
        let counts = vec![300u16; (width * 8) as usize];
        let path = folder.path().join(name);
        image::ImageBuffer::<image::Luma<u16>, _>::from_raw(width, 8, counts)
            .unwrap()
            .save(&path)
            .unwrap();
        path
    };
    png("a_1s.png", 8);
    png("b_2s.png", 10);
    // Nor do frames of a linear camera, or parts that no frame has, give a response.
    let response = ["calibrate", "response", "--rig", "rig.toml"];
    let frames = ["a_1s.png", "b_2s.png"];
    let said = assert_refused(
        "16 bits",
        folder.path(),
        &[&response[..], &frames].concat(),
        "a response is of 8",
    );
    let advice = "cameras that give more bits are linear";
    assert!(said.contains(advice), "{said}");
    for name in frames {
        let eight = image::GrayImage::new(8, 8);
        eight.save(folder.path().join(name)).unwrap();
    }
    let outside = ["--region", "4,4,8,8"];
    let said = assert_refused(
        "part outside",
        folder.path(),
        &[&response[..], &frames, &outside].concat(),
        "not inside the 8 x 8 frames",
    );
    let advice = "takes first column, first row, columns and rows";
    assert!(said.contains(advice), "{said}");
    png("a_1s.png", 8);
    png("b_2s.png", 10);
    let whole = std::fs::read(png("c_2s.png", 8)).unwrap();
    std::fs::write(folder.path().join("c_2s.png"), &whole[..whole.len() / 2]).unwrap();
    let linear = ["--gain", "1", "--read-noise", "2", "--black-level", "0"];
    for (name, second, fact) in [
        ("another size", "b_2s.png", "b_2s.png"),
        ("half a file", "c_2s.png", "c_2s.png"),
        ("no file", "d_2s.png", "d_2s.png"),
    ] {
        let mut arguments = vec!["merge", "a_1s.png", second, "--out", "out.exr"];
        arguments.extend(linear);
        let before = files(folder.path());
        let output = rig(folder.path(), &arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{name}: {stderr}");
        assert!(stderr.contains(fact), "{name}: {stderr}");
        assert!(files(folder.path()) == before, "{name}: a file has changed");
    }
}
