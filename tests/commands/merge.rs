//! `rig merge` and `rig calibrate response` on folders of frames.

use crate::command_support::{cases, words};
use std::f64::consts::TAU;
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
        .args(words("merge frames --response records/response/first.toml"))
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

/// Single frames of many lights: one image each, as a merge of that frame alone would be, with no
/// exposure needed; whatever cannot be so is refused before anything is written.
#[test]
fn single_frames_become_an_image_each() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (name, dn) in [("a.png", 100u16), ("b.png", 400), ("c_2s.png", 400)] {
        write_grey(&path(name), 20, (0..400).map(|p| dn + p % 2).collect());
    }
    std::fs::create_dir(path("other")).unwrap();
    write_grey(&path("other/a.png"), 20, (0..400).map(|p| p % 3).collect());
    write_grey(&path("small.png"), 10, (0..100).map(|p| p % 3).collect());
    let merge = |line: &str| {
        rig()
            .current_dir(&folder)
            .args(words("merge --gain 2 --read-noise 3 --black-level 0"))
            .args(words(line))
            .output()
            .unwrap()
    };
    for [words, fact, hint] in cases(
        "
        a.png other/a.png --each no | would both become no/a.exr | another name
        a.png small.png --each no | 10 x 10 | leave the odd frame out
        b.png c_2s.png --each no | exposure of b.png is unknown | --exposures
    ",
    ) {
        let output = merge(words);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            said.contains(fact) && said.contains(hint),
            "{words}: {said}"
        );
        assert!(!path("no").exists(), "{words}");
    }
    let output = merge("a.png b.png --each out");
    assert_eq!(
        String::from_utf8_lossy(&output.stdout),
        "out/a.exr\nout/b.exr\n"
    );
    std::fs::write(path("times.csv"), "b.png,1\n").unwrap();
    assert!(
        merge("b.png --exposures times.csv --out b.exr")
            .status
            .success()
    );
    let read = |name: &str| rig::radiance_image::exr::read(&path(name)).unwrap().image;
    let (each, alone) = (read("out/b.exr"), read("b.exr"));
    assert_eq!(each.mean, alone.mean);
    assert_eq!(each.variance, alone.variance);
    assert_eq!(
        (each.mean[0][0], read("out/a.exr").mean[0][0]),
        (200.0, 50.0)
    );
}

/// Linear frames whose names state the exposures: the report's ratios are 1, and
/// a mosaic keeps its size only if asked.
#[test]
fn names_state_exposures_and_the_report_shows_how_they_agree() {
    let folder = tempfile::tempdir().unwrap();
    for (name, dn) in [("a_2ms.png", 100), ("b_8ms.png", 400)] {
        write_grey(&folder.path().join(name), 20, vec![64 + dn; 400]);
    }
    for (more, size) in [("", 10), ("--full-resolution", 20)] {
        let output = rig()
            .current_dir(&folder)
            .args(words("merge . --mosaic rggb --bit-depth 12 --json"))
            .args(words("--gain 0.4 --read-noise 2.5 --black-level 64"))
            .args(words(more))
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
    let linear = "--gain 1 --read-noise 2 --black-level 0";
    let response = "calibrate response --rig simulated --out records";
    for [frames, more, fact] in cases(
        "
        empty | LINEAR | holds no frames
        odd | LINEAR | exposure of odd/plain.png is unknown
        photo | LINEAR | not proportional to light
        two | --response odd/plain.png | plain.png
        two | | 2 different exposures
        dark | | 0 pixels are well exposed
        odd | | unknown
        empty | | holds no frames
    ",
    ) {
        let line = match more {
            "" => format!("{response} {frames}"),
            more => format!("merge --out out.exr {frames} {more}"),
        };
        let line = line.replace("LINEAR", linear);
        let output = rig()
            .current_dir(&folder)
            .args(words(&line))
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
    for [frames, fact] in cases(
        "
        a_10ms.png a_10ms.png | a_10ms.png is named twice
        a_10ms.png ./a_10ms.png | are one frame
        a_10ms.png link_10ms.png | are one frame
        a_10ms.png copy_10ms.png | a_10ms.png and copy_10ms.png are one frame
        a_10ms.png longer_40ms.png | are one frame
        a_10ms.png b_10ms.png |
        black_10ms.png black_40ms.png |
    ",
    ) {
        let output = rig()
            .current_dir(&folder)
            .arg("merge")
            .args(words(frames))
            .args(words("--gain 1 --read-noise 2 --black-level 0"))
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        // Black frames, as clipped ones, may well be equal.
        let code = i32::from(!fact.is_empty());
        assert_eq!(output.status.code(), Some(code), "{frames:?}: {stderr}");
        assert!(stderr.contains(fact), "{frames:?}: {stderr}");
    }
}

/// A PNG of three channels.
fn write_rgb(path: &Path, width: u32, counts: Vec<u16>) {
    let height = counts.len() as u32 / width / 3;
    image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(width, height, counts)
        .unwrap()
        .save(path)
        .unwrap();
}

/// `rig merge . --json` in a folder: its report, or nothing, and what it says.
fn merge(folder: &Path, options: &str) -> (serde_json::Value, String) {
    let output = rig()
        .current_dir(folder)
        .args(["merge", ".", "--json"])
        .args(options.split(' '))
        .output()
        .unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (
        serde_json::from_slice(&output.stdout).unwrap_or_default(),
        said,
    )
}

const SIDE: usize = 32;

/// Raw frames of `seconds` under `electrons` per second by (pixel, frame), with noise; the
/// sensor has gain 1, read noise 2, black level 64, 12 bits.
fn raw(seconds: &[f64], electrons: impl Fn(usize, usize) -> f64) -> tempfile::TempDir {
    use rig::random::{Purpose, stream};
    let folder = tempfile::tempdir().unwrap();
    for (frame, exposure_s) in seconds.iter().enumerate() {
        let count = |p: usize| {
            let mut random = stream(5, Purpose::Experiment, frame as u64, p as u64, 0);
            let mean = exposure_s * electrons(p, frame);
            let noisy = mean + (mean + 4.0).sqrt() * random.normal();
            (64.0 + noisy).round().clamp(0.0, 4095.0) as u16
        };
        let letter = ["a", "b", "c"][frame];
        let name = format!("{letter}_{}ms.png", exposure_s * 1e3);
        write_grey(
            &folder.path().join(name),
            SIDE as u32,
            (0..SIDE * SIDE).map(count).collect(),
        );
    }
    folder
}

const SENSOR: &str = "--gain 1 --read-noise 2 --black-level 64 --bit-depth 12";

/// A filter's part of the light at a pixel of an RGGB sensor.
fn rggb(p: usize, colours: [f64; 3]) -> f64 {
    colours[[0, 1, 1, 2][(p / SIDE % 2) * 2 + p % 2]]
}

/// What is wrong with raw frames is said with its cause; and nothing where nothing is.
#[test]
fn raw_frames_that_do_not_agree_are_warned_of() {
    let even = |_: usize, _: usize| 1e4;
    let mosaic = |p: usize, _: usize| rggb(p, [2e3, 8e3, 1.2e4]);
    // A dimmed lamp while rows are read one after another; another phase in each frame.
    let flicker = |p: usize, frame: usize| {
        1e4 * (1.0 + 0.2 * ((p / SIDE) as f64 * 1.9 + 2.0 * frame as f64).sin())
    };
    // A pattern over single pixels that is another one in each frame.
    let patched =
        |p: usize, frame: usize| 1e4 * (1.0 + 0.2 * ((p * (7919 + 131 * frame)) as f64).sin());
    let late = |p: usize, frame: usize| 1e4 * if frame == 1 { 1.1 } else { 1.0 } + p as f64;
    // One period of a flicker over the image's height, at any phase; another one in each frame.
    let once = |phase: f64| {
        move |p: usize, frame: usize| {
            let height = (p / SIDE) as f64 / SIDE as f64;
            1e4 * (1.0 + 0.05 * (TAU * height + phase + 2.0 * frame as f64).sin())
        }
    };
    let columns = |p: usize, frame: usize| {
        1e4 * match (p % 2, frame) {
            (0, 1) => 0.96,
            (1, 1) => 1.04,
            _ => 1.0,
        }
    };
    let brighter = |p: usize, frame: usize| 1e4 * if frame == 1 { 1.03 } else { 1.0 } + p as f64;
    // The same in all frames is the scene.
    let ribbed = |p: usize, _: usize| 1e4 * (1.0 + 0.05 * (p % 2) as f64);
    let red = |p: usize, frame: usize| rggb(p, [if frame == 1 { 9e3 } else { 6e3 }, 8e3, 1.2e4]);
    let dark = |_: usize, frame: usize| if frame == 1 { 0.0 } else { 1e4 };
    let bracket = &[0.02, 0.08][..];
    let repeats = &[0.05, 0.05][..];
    let folders = [
        raw(bracket, even),
        raw(repeats, even),
        raw(bracket, mosaic),
        raw(bracket, mosaic),
        raw(bracket, mosaic),
        raw(bracket, flicker),
        raw(repeats, flicker),
        raw(bracket, once(0.0)),
        raw(bracket, once(1.6)),
        raw(bracket, columns),
        raw(bracket, ribbed),
        raw(bracket, brighter),
        raw(bracket, patched),
        raw(bracket, late),
        raw(bracket, red),
        raw(repeats, dark),
    ];
    let rows = cases(
        "
        even light | | |
        even repeats | | |
        mosaic | --mosaic rggb | |
        another order | --mosaic grbg | the two greens of the order grbg | is rggb or bggr
        no order | | needs --mosaic rggb or bggr |
        flicker | | the lamp flickers |
        flickering repeats | | the lamp flickers |
        one period | | slowly over the image's height: the lamp flickers |
        one period, later | | slowly over the image's height: the lamp flickers |
        columns | | columns of the exposure of 0.08 s differ by |
        ribs | | |
        3% brighter | | 0.08 s collected 1.02 |
        pattern | | reduced chi-square |
        exposure | | 0.08 s collected 1. | --measured-exposures
        one colour | --mosaic rggb | (red), | the colours differ
        dark frame | | have the role `dark` |
    ",
    );
    for ([what, options, says, also], folder) in rows.zip(folders) {
        let options = format!("{SENSOR} {options}");
        let (report, said) = merge(folder.path(), options.trim());
        assert!(report["width"].is_u64(), "{what}: {said}");
        assert!(said.contains(says) && said.contains(also), "{what}: {said}");
        assert_eq!(said.contains("warning"), !says.is_empty(), "{what}: {said}");
    }
}

/// Colours of few counts, cut to whole ones after the black level was subtracted, say little of
/// the exposure, and the report says so.
#[test]
fn each_colour_has_its_ratio_with_an_honest_uncertainty() {
    let folder = tempfile::tempdir().unwrap();
    for (name, exposure) in [("a_50ms.png", 1.0), ("b_200ms.png", 4.0)] {
        let counts = (0..SIDE * SIDE).map(|p| {
            let colours = [1.3, 60.0, 2.6];
            let level = rggb(p, colours) * (1.0 + 0.2 * (p as f64).sin());
            (exposure * level) as u16
        });
        write_grey(&folder.path().join(name), SIDE as u32, counts.collect());
    }
    let options = "--mosaic rggb --gain 0.03 --read-noise 10";
    let (report, said) = merge(folder.path(), &format!("{options} --black-level 0"));
    let step = |colour: usize| &report["channels"][colour][1];
    let value = |colour: usize, key: &str| step(colour)[key].as_f64().unwrap();
    for colour in [0, 2] {
        let off = (value(colour, "signal_ratio") - 1.0).abs();
        let std = value(colour, "signal_ratio_std");
        assert!(off > 0.05 && off < 3.0 * std, "{off} ± {std}: {said}");
    }
    assert!((value(1, "signal_ratio") - 1.0).abs() < 0.03, "{report}");
    assert!(value(1, "signal_ratio_std") > 1e-3);
    assert!(!said.contains("0.000 "), "{said}");
    // Half a count is what cutting loses.
    let (report, said) = merge(folder.path(), &format!("{options} --black-level -0.5"));
    let off = (report["channels"][1][1]["signal_ratio"].as_f64().unwrap() - 1.0).abs();
    assert!(off < 3e-3, "{off}: {said}");
}

/// Gain, read noise and black level of each colour: counts whose white was balanced become the
/// radiances that they were, on RGB frames and on a mosaic.
#[test]
fn each_colour_has_its_sensor() {
    let gains = [1.0, 1.2, 1.5];
    let folder = tempfile::tempdir().unwrap();
    let count = |gain: f64, signal: f64, black: f64| (black + gain * signal).round() as u16;
    let blacks = [60.0, 64.0, 70.0];
    let channel = |colour: usize, signal: f64| count(gains[colour], signal, blacks[colour]);
    for (name, signal) in [("a_10ms.png", 100.0), ("b_40ms.png", 400.0)] {
        let rgb = (0..SIDE * SIDE).flat_map(|_| [0, 1, 2].map(|c| channel(c, signal)));
        let grey = (0..SIDE * SIDE).map(|p| rggb(p, [0, 1, 2].map(|c| channel(c, signal).into())));
        for kind in ["rgb", "grey"] {
            std::fs::create_dir_all(folder.path().join(kind)).unwrap();
        }
        write_rgb(
            &folder.path().join("rgb").join(name),
            SIDE as u32,
            rgb.collect(),
        );
        let grey = grey.map(|count| count as u16).collect();
        write_grey(&folder.path().join("grey").join(name), SIDE as u32, grey);
    }
    let sensor = "--gain 1,1.2,1.5 --read-noise 2,2,3 --black-level 60,64,70";
    for (kind, options) in [("rgb", ""), ("grey", " --mosaic rggb")] {
        let path = folder.path().join(kind);
        let (_, said) = merge(&path, &format!("{sensor}{options}"));
        assert!(!said.contains("warning"), "{kind}: {said}");
        let file = rig::radiance_image::exr::read(&path.join("radiance.exr")).unwrap();
        for value in file.image.mean[7] {
            assert!((value / 1e4 - 1.0).abs() < 1e-4, "{kind}: {value}");
        }
        // More DN per electron: less of the rounding, more of the blue's read noise.
        let [red, green, blue] = file.image.variance[7];
        assert!(blue > red && green < red, "{kind}: {red} {green} {blue}");
    }
    let (_, said) = merge(&folder.path().join("grey"), sensor);
    assert!(
        said.contains("is grey") && said.contains("hint: give one value"),
        "{said}"
    );
    let (_, said) = merge(
        &folder.path().join("grey"),
        &sensor.replace("1,1.2,1.5", "1,2"),
    );
    assert!(said.contains("three for red, green and blue"), "{said}");
}

/// The exposures that the frames show replace the stated ones, with their uncertainty.
#[test]
fn measured_exposures_are_used_on_request() {
    // The second frame took 1.3 times, the third 0.9 times what its name states.
    let truth = [1.0, 1.3, 0.9];
    let folder = raw(&[0.005, 0.02, 0.08], |p, frame| {
        rggb(p, [4e3, 2e4, 9e3]) * truth[frame] * (1.0 + 0.5 * (p as f64 * 0.01).sin())
    });
    let options = format!("{SENSOR} --mosaic rggb --measured-exposures");
    let (report, said) = merge(folder.path(), &options);
    for (index, (stated_s, factor)) in [0.005, 0.02, 0.08].into_iter().zip(truth).enumerate() {
        let used = &report["measured_exposures"][index];
        assert_eq!(used["stated_s"], stated_s);
        let found = used["used_s"].as_f64().unwrap() / stated_s;
        let std = used["relative_std"].as_f64().unwrap();
        assert!((found / factor - 1.0).abs() <= 4.0 * std, "{found} ± {std}");
        assert!(std < 0.02 && (index == 0) == (std == 0.0), "{std}");
        let ratio = report["channels"][1][index]["signal_ratio"]
            .as_f64()
            .unwrap();
        assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    }
    assert!(
        said.contains("is used as stated, the others against it"),
        "{said}"
    );
    assert!(
        said.contains("as its light shows") && !said.contains("warning"),
        "{said}"
    );
    let (report, said) = merge(folder.path(), &options.replace(" --measured-exposures", ""));
    assert_eq!(report["measured_exposures"].as_array().unwrap().len(), 0);
    assert!(said.contains("0.02 s collected 1."), "{said}");
}

/// A column that might say something else is not passed over.
#[test]
fn a_column_that_is_not_known_is_named() {
    let folder = raw(&[0.02, 0.08], |_, _| 1e4);
    let table = "file,exposure_s,kind\na_20ms.png,0.02,light\nb_80ms.png,0.08,dark\n";
    std::fs::write(folder.path().join("table.csv"), table).unwrap();
    let options = format!("{SENSOR} --exposures table.csv");
    let (_, said) = merge(folder.path(), &options);
    assert!(
        said.contains("\"kind\" is not known") && said.contains("role (light"),
        "{said}"
    );
    let table = table.replace("kind", "role");
    std::fs::write(folder.path().join("table.csv"), table).unwrap();
    let (report, said) = merge(folder.path(), &options);
    assert_eq!(report["channels"][0].as_array().unwrap().len(), 1, "{said}");
}

/// Frames through a response are compared as raw ones are.
#[test]
fn exposures_through_a_response_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("good")).unwrap();
    named_bracket(&path("good"));
    rig()
        .current_dir(&folder)
        .args(["calibrate", "response", "good", "--rig", "simulated"])
        .args(["--out", "records", "--id", "r"])
        .assert()
        .success();
    let change = |name: &str, of: &dyn Fn(u32, u32, [u8; 3]) -> [f64; 3]| {
        std::fs::create_dir(path(name)).unwrap();
        named_bracket(&path(name));
        let file = path(name).join("scene_1-4s.png");
        let mut frame = image::open(&file).unwrap().to_rgb8();
        for (x, y, pixel) in frame.enumerate_pixels_mut() {
            let counts = of(x, y, pixel.0);
            pixel.0 = counts.map(|count| count.round().clamp(0.0, 255.0) as u8);
        }
        frame.save(&file).unwrap();
    };
    change("white", &|_, _, [r, g, b]| {
        [f64::from(r) * 0.8, g.into(), f64::from(b) * 1.1]
    });
    change("tone", &|x, _, counts| {
        counts.map(|count| f64::from(count) * (1.0 + 0.25 * (f64::from(x) * 0.26).sin()))
    });
    change(
        "moved",
        &|x, y, counts| match (10..16).contains(&x) && (10..16).contains(&y) {
            true => [150.0; 3],
            false => counts.map(f64::from),
        },
    );
    std::fs::create_dir(path("time")).unwrap();
    named_bracket(&path("time"));
    let time = |name: &str| path("time").join(name);
    std::fs::rename(time("scene_1-4s.png"), time("scene_500ms.png")).unwrap();
    std::fs::rename(time("scene_1-2s.png"), time("scene_501ms.png")).unwrap();
    std::fs::create_dir(path("rounded")).unwrap();
    named_bracket(&path("rounded"));
    let rounded = |name: &str| path("rounded").join(name);
    std::fs::rename(rounded("scene_1-2s.png"), rounded("scene_480ms.png")).unwrap();
    for [name, says, also] in cases(
        "
        good | |
        white | 0.25 s collected | the colours differ: white balance
        tone | 0.25 s | a response that changes from frame to frame
        moved | of the exposure of 0.25 s differ | something moved; they are not masked
        time | 0.501 s collected | an exposure time that is wrong
        rounded | 0.48 s collected 1.04 |
    ",
    ) {
        let (report, said) = merge(&path(name), "--response ../records/response/r.toml");
        let steps = report["channels"].as_array().unwrap();
        assert_eq!(
            (steps.len(), steps[2].as_array().unwrap().len()),
            (3, 5),
            "{said}"
        );
        assert!(said.contains(says) && said.contains(also), "{name}: {said}");
        assert_eq!(said.contains("warning"), !says.is_empty(), "{name}: {said}");
    }
}

/// A bracket is taken by one camera with one setting; what a camera did to its frames by itself
/// is said of those that are not raw.
#[test]
fn exif_data_of_other_settings_are_refused() {
    use exif::{Field, In, Rational, Tag, Value, experimental::Writer};
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, tag: Tag, value: &Value| {
        let field = Field {
            tag,
            ifd_num: In::PRIMARY,
            value: value.clone(),
        };
        let mut writer = Writer::new();
        writer.push_field(&field);
        let mut bytes = std::io::Cursor::new(Vec::new());
        writer.write(&mut bytes, false).unwrap();
        std::fs::write(folder.path().join(name), bytes.into_inner()).unwrap();
    };
    let tenths = |num| Value::Rational(vec![Rational { num, denom: 10 }]);
    let short = |value| Value::Short(vec![value]);
    let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
    for (tag, one, other, says) in [
        (
            Tag::FocalLength,
            tenths(42),
            tenths(69),
            "at 6.9 mm, but ./a_1s.tif at 4.2 mm",
        ),
        (
            Tag::FocalLengthIn35mmFilm,
            short(26),
            short(51),
            "at 51 mm in terms of 35 mm film",
        ),
        (
            Tag::DigitalZoomRatio,
            tenths(0),
            tenths(15),
            "with a digital zoom of 1.5",
        ),
        (
            Tag::LensModel,
            text("wide"),
            text("tele"),
            "with the lens tele",
        ),
        (Tag::Model, text("one"), text("two"), "with the camera two"),
        (
            Tag::Flash,
            short(0),
            short(1),
            "with flash, but ./a_1s.tif without flash",
        ),
        (
            Tag::WhiteBalance,
            short(0),
            short(0),
            "a_1s.tif: its EXIF data say automatic white",
        ),
        (
            Tag::CustomRendered,
            short(0),
            short(3),
            "b_2s.tif: its EXIF data say that it is proc",
        ),
        (
            Tag::CompositeImage,
            short(3),
            short(3),
            "composed of several exposures",
        ),
    ] {
        write("a_1s.tif", tag, &one);
        write("b_2s.tif", tag, &other);
        let response = bracket().join("none.toml");
        let (_, said) = merge(folder.path(), &format!("--response {}", response.display()));
        assert!(said.contains(says), "{tag}: {said}");
        let refused = said.contains("hint: a bracket varies the exposure time alone");
        assert_eq!(refused, said.contains("was taken"), "{tag}: {said}");
        let (_, said) = merge(folder.path(), SENSOR);
        assert_eq!(said.contains(says), refused, "{tag}, raw: {said}");
    }
}
