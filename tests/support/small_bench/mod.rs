//! The shipped simulated bench with a camera of 64 × 64 pixels, for tests in which the size of
//! the images is not the point, and the records of its sensor.

// Each test uses some of it.
#![allow(dead_code)]

use std::path::Path;

/// The text of its rig file.
pub fn rig_file() -> String {
    let mut text = include_str!("../../../rig-configs/simulated.toml").to_owned();
    for (key, small) in [
        ("\nresolution_px = [640, 480]", "\nresolution_px = [64, 64]"),
        ("\nextent_mm = [29.3, 22.0]", "\nextent_mm = [22.0, 22.0]"),
        ("\npoint_spread_px = 0.5", "\npoint_spread_px = 0.0"),
    ] {
        assert!(text.contains(key), "{key}");
        text = text.replacen(key, small, 1);
    }
    text
}

/// Puts its records where a rig file in this folder finds them.
pub fn put_records(folder: &Path) {
    let records = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/support/small_bench/calibration"
    );
    for kind in ["sensor", "flat", "scale"] {
        let to = folder.join("calibration/simulated").join(kind);
        std::fs::create_dir_all(&to).unwrap();
        for entry in std::fs::read_dir(Path::new(records).join(kind)).unwrap() {
            let entry = entry.unwrap();
            std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
}
