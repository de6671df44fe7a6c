//! The path of docs/tutorial-torch.md at its rehearsal's bench, made small: a person at a terminal,
//! a session, its fit tested on a light that it has not seen, and the session as one file.

use std::path::Path;

use crate::command_support::{good, json, run, text, words};
use crate::init::Terminal;

/// The rehearsal's rig file with 60 × 40 pixels, fewer paths and a quick fit.
fn small_bench(folder: &Path) {
    let mut rig = include_str!("../../rig-configs/rehearsal-torch.toml").to_owned();
    for (shipped, small) in [
        ("resolution_px = [300, 200]", "resolution_px = [60, 40]"),
        ("samples_per_pixel = 384", "samples_per_pixel = 16"),
        ("segments = 256", "segments = 64"),
        (
            "refine_bench = true",
            "dictionary = \"two.toml\"\nsamples_per_pixel = 16\nmax_reflections = 4",
        ),
    ] {
        rig = rig.replace(shipped, small);
        assert!(rig.contains(small), "{shipped}");
    }
    std::fs::write(folder.join("rig.toml"), rig).unwrap();
    let two = "atoms = [{ type = \"ggx\", alpha = 0.1, eta = 1.5 }, { type = \"lambertian\", albedo = 1.0 }]";
    std::fs::write(folder.join("two.toml"), two).unwrap();
}

#[test]
fn a_torch_held_by_hand_leads_to_a_tested_fit() {
    let home = tempfile::tempdir().unwrap();
    let at = home.path();
    small_bench(at);
    good(run(at, &["calibrate", "sensor"]));
    good(run(
        at,
        &words("calibrate flat --radiance 0.4 --radiance-std 0.02"),
    ));
    // Each light is placed, switched on and switched off, and nothing else is asked.
    let mut person = Terminal::start(
        at,
        &["capture", "--lights", "3", "--sample", "bowl", "--no-fit"],
    );
    let off = "turn the lamp off, then press Enter";
    let mut wanted = vec![off];
    for _ in 0..3 {
        wanted.extend([
            "place the light at direction",
            "turn on channel 0 of the lamp",
            off,
        ]);
    }
    for request in wanted {
        person.wait_for(request);
        person.wait_for("not possible) ");
        person.enter("");
    }
    let session = person.finish();
    let session = session.trim();
    // What stands in the tutorial afterwards.
    let validate = |session: &str| {
        let mut found = json(run(at, &["validate", session, "--json"]));
        found.as_object_mut().unwrap().remove("made_utc");
        found
    };
    let found = validate(session);
    assert_eq!(found["fitted_lights"].as_array().map(Vec::len), Some(2));
    let error = found["all"]["overall"]["relative_rms"].as_f64().unwrap();
    assert!(error < 0.5, "{error}");
    good(run(at, &["session", "pack", session, "--out", "bowl.tar"]));
    let unpacked = text(
        &good(run(
            at,
            &["session", "unpack", "bowl.tar", "--out", "there"],
        ))
        .stdout,
    );
    assert_eq!(validate(unpacked.trim()), found);
}
