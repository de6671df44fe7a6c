//! The rehearsals of docs/calibration.md, run as they stand there, in the order of a bench,
//! and each record compared with the truth of the simulation.

use std::path::{Path, PathBuf};

use crate::command_support::{good, run, text};
use rig::config::{RigConfig, Surroundings, resolve_rig};
use toml::Value;

/// Commands of the section, without their prompts; SESSION stands for the last capture's.
fn commands() -> Vec<String> {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/calibration.md");
    let page = std::fs::read_to_string(page).unwrap();
    let (_, section) = page.split_once("\n## Rehearse it first").unwrap();
    let section = section.split("\n## ").next().unwrap();
    let lines = section
        .lines()
        .filter_map(|line| line.strip_prefix("    rig "));
    lines.map(str::to_owned).collect()
}

/// The only record of a kind.
fn record(at: &Path, kind: &str) -> Value {
    let folder = at.join("calibration/rehearsal").join(kind);
    let files = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{folder:?}: {error}"));
    let mut records = files
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"));
    let record = records.next().unwrap();
    assert_eq!(records.next(), None, "{kind}");
    let record: Value = toml::from_str(&std::fs::read_to_string(record).unwrap()).unwrap();
    record["values"].clone()
}

fn number(value: &Value) -> f64 {
    value
        .as_float()
        .or(value.as_integer().map(|n| n as f64))
        .unwrap_or_else(|| panic!("{value}"))
}

/// A measured value against the truth: within `most` of it, and within 4 of its standard
/// uncertainties and of `other`, what nobody can know of the simulation.
#[track_caller]
fn check(what: &str, [value, std]: [f64; 2], truth: f64, other: f64, most: f64) {
    let off = value - truth;
    let total = std.hypot(other);
    assert!(
        off.abs() < 4.0 * total && off.abs() < most,
        "{what}: {value} ± {std} for {truth}"
    );
}

fn measured(value: &Value) -> [f64; 2] {
    ["value", "std"].map(|key| number(&value[key]))
}

fn rig_of(folder: &Path, name: &str) -> RigConfig {
    let surroundings = Surroundings {
        environment: None,
        folder: folder.to_owned(),
    };
    resolve_rig(Some(name), &surroundings, Vec::new)
        .unwrap()
        .config
}

#[test]
fn every_rehearsal_finds_its_bench() {
    // The benches are those of the program, as it is installed.
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut session = PathBuf::new();
    let mut ran = 0;
    for command in commands() {
        let words: Vec<String> = command
            .split_whitespace()
            .map(|word| match word {
                "SESSION" => session.display().to_string(),
                word => word.to_owned(),
            })
            .collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let output = good(run(at, &words));
        if words[0] == "capture" {
            session = PathBuf::from(text(&output.stdout).lines().last().unwrap());
        }
        ran += 1;
    }
    assert!(ran >= 11, "{ran} commands");

    let tile = rig_of(at, "rehearsal-tile");
    let simulation = tile.simulation.as_ref().unwrap();

    // Sensor and scale.
    let sensor = record(at, "sensor");
    let truth = &simulation.sensor;
    for (key, truth, most) in [
        ("gain_dn_per_e", truth.gain_dn_per_e, 0.004),
        ("read_noise_e", truth.read_noise_e, 0.05),
        ("black_level_dn", truth.black_level_dn, 0.05),
        ("full_well_e", truth.full_well_e, 60.0),
    ] {
        check(key, measured(&sensor[key]), truth, 0.0, most);
    }
    let scale = measured(&record(at, "scale")["responsivity_e_s"]);
    check(
        "responsivity",
        scale,
        truth.responsivity,
        0.0,
        0.03 * truth.responsivity,
    );

    // Lamp: how long until a thousandth is missing follows from warm-up fraction and constant.
    let lamp_bench = rig_of(at, "rehearsal-flat").simulation.unwrap().lamp;
    let lamp = record(at, "lamp");
    check(
        "drift",
        measured(&lamp["drift_per_hour"]),
        lamp_bench.drift_per_hour,
        0.0,
        5e-4,
    );
    let warm_s = lamp_bench.warm_up_s * (lamp_bench.warm_up_fraction / 1e-3).ln();
    check(
        "warm-up",
        [number(&lamp["warm_up_time_s"]), 0.03 * warm_s],
        warm_s,
        0.0,
        0.1 * warm_s,
    );

    // Lens.
    let lens = record(at, "camera");
    let std = |i: usize| number(&lens["covariance"][i][i]).sqrt();
    let true_lens = simulation.lens.mapping.unwrap();
    let px_per_mm = 160.0 / 29.3;
    let [k1, k2, _] = true_lens.distortion.radial;
    let [p1, p2] = true_lens.distortion.tangential;
    for (what, value, std, truth, most) in [
        ("mx", &lens["scale"][0], std(0), px_per_mm, 0.005),
        (
            "my",
            &lens["scale"][1],
            std(1),
            px_per_mm * true_lens.aspect,
            0.005,
        ),
        ("k1", &lens["radial"][0], std(2), k1, 0.003),
        ("k2", &lens["radial"][1], std(3), k2, 0.003),
        ("p1", &lens["tangential"][0], std(4), p1, 2e-4),
        ("p2", &lens["tangential"][1], std(5), p2, 2e-4),
    ] {
        check(what, [number(value), std], truth, 0.0, most);
    }

    // Focus.
    let focus = record(at, "focus");
    let lens = simulation.lens;
    check(
        "point spread",
        measured(&focus["point_spread_px"]),
        lens.point_spread_px.unwrap(),
        0.0,
        0.05,
    );
    check(
        "aperture",
        measured(&focus["lens"]["object_na"]),
        lens.object_na.unwrap(),
        0.0,
        0.003,
    );
    check(
        "focus",
        measured(&focus["lens"]["focus_mm"]),
        lens.focus_mm.unwrap(),
        0.0,
        2.0,
    );

    // Lights: a polished ball, whose highlights are clipped in every exposure.
    let stage = record(at, "directions")["stage"].clone();
    let errors = rig_of(at, "rehearsal-ball")
        .simulation
        .unwrap()
        .stage_errors;
    let std = |i: usize| number(&stage["covariance_deg2"][i][i]).sqrt();
    for (axis, truth) in [0.0, 0.0, errors.azimuth_offset_deg]
        .into_iter()
        .enumerate()
    {
        check(
            "stage",
            [number(&stage["rotation_deg"][axis]), std(axis)],
            truth,
            0.02,
            0.15,
        );
    }
    let offset = [number(&stage["elevation_offset_deg"]), std(3)];
    check("elevation", offset, errors.elevation_offset_deg, 0.02, 0.15);

    // White standard: the lamp's true power, by the scale that the flat field gave.
    let lights = record(at, "lights");
    for channel in 0..3 {
        let truth = tile.geometry.light.irradiance_w_m2[channel] * simulation.lamp.power[channel];
        let found = measured(&lights["irradiance_w_m2"][channel]);
        check("irradiance", found, truth, 0.01 * truth, 0.03 * truth);
    }
}
