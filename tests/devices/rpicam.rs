//! The wrapper for Raspberry Pi cameras, with a program in place of `rpicam-still` that leaves
//! what that one leaves: a DNG file whose counts are in a sub-directory, and metadata.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use image::GenericImageView;

const SIZE: [u32; 2] = [6, 4];

/// Writes its arguments down, then leaves the files of its folder where it was asked to.
const STAND_IN: &str = r#"#!/bin/sh
here=$(dirname "$0")
echo "$@" > "$here/arguments"
while [ $# -gt 0 ]; do
  case $1 in
    --output) output=$2; shift;;
    --metadata) metadata=$2; shift;;
  esac
  shift
done
cat "$here/messages" >&2
[ -e "$here/fails" ] && exit 1
echo developed > "$output"
cp "$here/frame.dng" "${output%.*}.dng"
cp "$here/metadata.json" "$metadata"
"#;

/// As rpicam-still writes them; the first two lines are no JSON.
const METADATA: &str = r#"{
    "AfWindows": (0, 0),
    "FocusFoM": nan,
    "ExposureTime": 19994,
    "AnalogueGain": 1.000000,
    "SensorTemperature": 34.000000,
    "ScalerCrop": "(0, 0)/4056x3040"
}
"#;

fn count_at(x: u32, y: u32) -> u16 {
    (300 * y + 7 * x + 64) as u16
}

/// A small preview in colour first, and the counts in two strips of a sub-directory.
fn dng(big_endian: bool) -> Vec<u8> {
    let u16_of = |value: u16| match big_endian {
        true => value.to_be_bytes(),
        false => value.to_le_bytes(),
    };
    let u32_of = |value: u32| match big_endian {
        true => value.to_be_bytes(),
        false => value.to_le_bytes(),
    };
    let short = |value: u16| {
        let [a, b] = u16_of(value);
        [a, b, 0, 0]
    };
    let directory = |entries: &[(u16, u16, u32, [u8; 4])]| {
        let mut bytes = u16_of(entries.len() as u16).to_vec();
        for (tag, kind, count, value) in entries {
            bytes.extend(u16_of(*tag));
            bytes.extend(u16_of(*kind));
            bytes.extend(u32_of(*count));
            bytes.extend(value);
        }
        bytes.extend(u32_of(0));
        bytes
    };
    let [width, height] = SIZE;
    let strip = 2 * width * height / 2;
    // The header, the two directories, two numbers each of the strips, the counts.
    let (first, second) = (8, 8 + 2 + 12 * 5 + 4);
    let numbers = second + 2 + 12 * 7 + 4;
    let counts = numbers + 16;
    let mut file = match big_endian {
        true => b"MM\0*".to_vec(),
        false => b"II*\0".to_vec(),
    };
    file.extend(u32_of(first));
    file.extend(directory(&[
        (256, 4, 1, u32_of(64)),
        (257, 4, 1, u32_of(64)),
        (258, 3, 1, short(8)),
        (277, 3, 1, short(3)),
        (330, 4, 1, u32_of(second)),
    ]));
    file.extend(directory(&[
        (256, 4, 1, u32_of(width)),
        (257, 4, 1, u32_of(height)),
        (258, 3, 1, short(16)),
        (259, 3, 1, short(1)),
        (273, 4, 2, u32_of(numbers)),
        (277, 3, 1, short(1)),
        (279, 4, 2, u32_of(numbers + 8)),
    ]));
    for number in [counts, counts + strip, strip, strip] {
        file.extend(u32_of(number));
    }
    for y in 0..height {
        for x in 0..width {
            file.extend(u16_of(count_at(x, y)));
        }
    }
    file
}

struct Pi(tempfile::TempDir);

impl Pi {
    fn new() -> Self {
        let pi = Self(tempfile::tempdir().unwrap());
        pi.put("rpicam-still", STAND_IN.as_bytes());
        let program = pi.0.path().join("rpicam-still");
        fs::set_permissions(program, PermissionsExt::from_mode(0o755)).unwrap();
        pi.put("frame.dng", &dng(false));
        pi.put("metadata.json", METADATA.as_bytes());
        pi.put("messages", b"Bayer format is BGGR-12\n");
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let wrapper = root.join("rig-configs/programs/rpicam");
        let text = fs::read_to_string(root.join("tests/outside/shared/program-camera.toml"));
        let command = format!(
            "{} {{exposure_s}} {{gain}} {{output}} --mode 6:4:12:U",
            wrapper.display()
        );
        let text = text
            .unwrap()
            .replace("./camera {output} {exposure_s}", &command);
        assert!(text.contains(&command));
        pi.put("rig.toml", text.as_bytes());
        pi
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        fs::write(self.0.path().join(name), bytes).unwrap();
    }

    /// `rig camera grab` of 20 ms; stdout, or the error with its hint.
    fn grab(&self, file: &str) -> Result<String, String> {
        let path = std::env::var("PATH").unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_rig"))
            .args("camera grab --rig rig.toml --exposure-ms 20 --json --out".split(' '))
            .arg(file)
            .current_dir(self.0.path())
            .env("PATH", format!("{}:{path}", self.0.path().display()))
            .env_remove("RIG_CONFIG")
            .output()
            .unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        match output.status.success() {
            true => Ok(text(&output.stdout)),
            false => Err(text(&output.stderr)),
        }
    }

    fn assert_counts(&self, file: &str) {
        let image = image::open(self.0.path().join(file)).unwrap();
        assert_eq!(image.dimensions(), (SIZE[0], SIZE[1]));
        for (x, y, pixel) in image.to_luma16().enumerate_pixels() {
            assert_eq!(pixel.0[0], count_at(x, y), "({x}, {y})");
        }
    }
}

#[test]
fn the_counts_and_what_was_reported_arrive() {
    let pi = Pi::new();
    let said = pi.grab("a.png").unwrap();
    let said: serde_json::Value = serde_json::from_str(&said).unwrap();
    let exposure_s = said["settings"]["exposure"].as_f64().unwrap();
    assert!((exposure_s - 0.019994).abs() < 1e-9, "{said}");
    assert_eq!(said["sensor_c"], 34.0);
    pi.assert_counts("a.png");
    let arguments = fs::read_to_string(pi.0.path().join("arguments")).unwrap();
    for option in [
        "--immediate",
        "--raw",
        "--shutter 20000",
        "--gain 1",
        "--awbgains 1,1",
        "--denoise off",
        "--mode 6:4:12:U",
    ] {
        assert!(arguments.contains(option), "{option}: {arguments}");
    }
    // Files of either byte order.
    pi.put("frame.dng", &dng(true));
    pi.grab("b.png").unwrap();
    pi.assert_counts("b.png");
}

#[test]
fn what_goes_wrong_on_a_pi_is_named() {
    let pi = Pi::new();
    let whole = dng(false);
    // An exposure that the sensor does not reach.
    pi.put(
        "metadata.json",
        METADATA.replace("19994", "10649").as_bytes(),
    );
    let error = pi.grab("none.png").unwrap_err();
    assert!(
        error.contains("the camera reports exposure 10.649 ms"),
        "{error}"
    );
    pi.put("metadata.json", METADATA.as_bytes());
    // Compressed counts, a file that is cut short, one without counts.
    pi.put("messages", b"Bayer format is BGGR-16-PISP\n");
    let error = pi.grab("none.png").unwrap_err();
    assert!(
        error.contains("BGGR-16-PISP is compressed with losses"),
        "{error}"
    );
    pi.put("messages", b"");
    for (bytes, named) in [
        (
            &whole[..whole.len() - 5],
            "cut short: 43 bytes of counts instead of 48",
        ),
        (&whole[..60], "cut short or damaged"),
        (b"no image", "is no TIFF file"),
    ] {
        pi.put("frame.dng", bytes);
        let error = pi.grab("none.png").unwrap_err();
        assert!(error.contains(named), "{named}: {error}");
    }
    // No camera.
    pi.put("frame.dng", &whole);
    pi.put("messages", b"ERROR: *** no cameras available ***\n");
    pi.put("fails", b"");
    let error = pi.grab("none.png").unwrap_err();
    assert!(
        error.contains("exit code 1, and it wrote: ERROR: *** no cameras available"),
        "{error}"
    );
}
