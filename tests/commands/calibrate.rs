//! `rig calibrate` as the operator meets it: records, figures, status, and that a
//! failure leaves what was there.

use crate::command_support::words;
use crate::small_bench;

use std::path::Path;

use serde_json::Value;

fn rig(folder: &Path) -> assert_cmd::Command {
    let mut command = assert_cmd::Command::cargo_bin("rig").unwrap();
    command.current_dir(folder);
    command
}

/// A simulated rig of which some lines are changed.
fn rig_file(folder: &Path, changes: &[(&str, &str)]) {
    let mut text = small_bench::rig_file();
    for (old, new) in changes {
        assert!(text.contains(old), "{old}");
        text = text.replace(old, new);
    }
    std::fs::write(folder.join("rig.toml"), text).unwrap();
}

fn json(output: &std::process::Output) -> Value {
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

fn state<'a>(status: &'a Value, kind: &str) -> &'a Value {
    let records = status["records"].as_array().unwrap();
    records.iter().find(|line| line["kind"] == kind).unwrap()
}

#[test]
fn records_figures_and_status() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // A folder that is named has nothing built in behind it.
    let own = "[calibration]\nfolder = \"calibration/simulated\"";
    rig_file(at, &[("[calibration]", own)]);
    std::fs::create_dir_all(at.join("calibration/simulated")).unwrap();
    let status = || {
        json(
            &rig(at)
                .args(["calibrate", "status", "--json"])
                .output()
                .unwrap(),
        )
    };
    let before = status();
    assert_eq!(state(&before, "sensor")["state"], "missing");
    assert_eq!(state(&before, "sensor")["run"], "rig calibrate sensor");

    rig(at)
        .args(["calibrate", "sensor", "--id", "one", "--valid-days", "30"])
        .assert()
        .success();
    let after = status();
    let sensor = state(&after, "sensor");
    assert_eq!(
        (&sensor["state"], &sensor["id"]),
        (&"good".into(), &"one".into())
    );
    for ending in ["svg", "png"] {
        let figure = at.join(format!("calibration/simulated/plots/one.{ending}"));
        assert!(
            std::fs::metadata(&figure).unwrap().len() > 1000,
            "{figure:?}"
        );
    }
    // The figures of EMVA 1288, in one file that needs no other.
    let page = at.join("calibration/simulated/plots/one.html");
    let page = std::fs::read_to_string(page).unwrap();
    for part in [
        "SIMULATED",
        "system gain",
        "μ<sub>e.sat</sub>",
        "PRNU<sub>1288</sub>",
        "quantum efficiency",
        "<svg",
    ] {
        assert!(page.contains(part), "{part}");
    }
    for outside in ["http://", "https://", "src="] {
        assert!(!page.contains(outside), "{outside}");
    }
    let shown = rig(at).args(["calibrate", "status"]).output().unwrap();
    let shown = String::from_utf8(shown.stdout).unwrap();
    assert!(shown.contains("sensor     ok"), "{shown}");

    // The same as JSON, of a measurement of fewer frames.
    let two = [
        "calibrate",
        "sensor",
        "--id",
        "two",
        "--frames",
        "8",
        "--json",
    ];
    let two = json(&rig(at).args(two).output().unwrap());
    let figures = &two["emva1288"];
    let value = |key: &str| figures[key]["value"].as_f64().unwrap();
    assert_eq!(
        figures["system_gain_dn_per_e"],
        two["values"]["gain_dn_per_e"]
    );
    let ratio = value("saturation_capacity_e") / value("sensitivity_threshold_e");
    assert!(
        (value("dynamic_range") / ratio - 1.0).abs() < 1e-9,
        "{figures}"
    );
    assert!((0.003..0.012).contains(&value("prnu")), "{figures}");
    std::fs::remove_file(at.join("calibration/simulated/sensor/two.toml")).unwrap();

    // A record of the same name is never replaced.
    let record = at.join("calibration/simulated/sensor/one.toml");
    let bytes = std::fs::read(&record).unwrap();
    rig(at)
        .args(["calibrate", "sensor", "--id", "one", "--frames", "8"])
        .assert()
        .code(1);
    assert_eq!(std::fs::read(&record).unwrap(), bytes);

    // Its time is over, or it is another camera's.
    let text = String::from_utf8(bytes).unwrap();
    let expired = text
        .lines()
        .map(|line| match line.starts_with("valid_until") {
            true => "valid_until = \"2026-01-01T00:00:00Z\"",
            false => line,
        });
    std::fs::write(&record, expired.collect::<Vec<_>>().join("\n")).unwrap();
    assert_eq!(state(&status(), "sensor")["state"], "doubtful");
    std::fs::write(&record, text.replace("SIM-0001", "SIM-0002")).unwrap();
    let other = status();
    let sensor = state(&other, "sensor");
    assert_eq!(sensor["state"], "refused");
    assert!(sensor["concerns"][0].as_str().unwrap().contains("SIM-0002"));
}

/// A record notes how warm the sensor was; a capture that begins with a colder one warns,
/// and one that becomes too warm is suspended with what to do.
#[test]
fn heat_is_noted_compared_and_limited() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let changes = [
        ("sensor_c = 60.0", "sensor_c = 24.05"),
        ("margin_c = 5.0", "margin_c = 0.0"),
        ("record_differs_c = 10.0", "record_differs_c = 0.1"),
        ("timing = \"realistic\"", "timing = \"instant\""),
        ("samples_per_pixel = 384", "samples_per_pixel = 8"),
    ];
    rig_file(at, &changes);
    small_bench::put_records(at);
    rig(at)
        .args(["calibrate", "sensor", "--id", "one", "--frames", "4"])
        .assert()
        .success();
    let record = at.join("calibration/simulated/sensor/one.toml");
    let record: toml::Table = std::fs::read_to_string(record).unwrap().parse().unwrap();
    let sensor_c = record["settings"]["sensor_c"].as_float().unwrap();
    assert!((24.2..36.0).contains(&sensor_c), "{sensor_c}");

    let capture = rig(at)
        .args(["capture", "--lights", "1", "--no-fit"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&capture.stderr);
    assert_eq!(capture.status.code(), Some(1), "{said}");
    for part in [
        format!("record one was measured with the sensor at {sensor_c:.1} °C"),
        "more than the limit of 24.05 °C".to_owned(),
        "--resume".to_owned(),
    ] {
        assert!(said.contains(&part), "{part:?} is not in {said}");
    }
}

/// A record per gain: the one of the rig's gain is taken though another is newer.
#[test]
fn the_record_of_the_gain_in_use_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir_all(at.join("calibration/simulated")).unwrap();
    for (gain, id, date) in [
        ("gain = 1.0", "low", "2026-11-01T00:00:00Z"),
        ("gain = 2.0", "high", "2026-11-02T00:00:00Z"),
    ] {
        rig_file(at, &[("\ngain = 1.0", &format!("\n{gain}"))]);
        rig(at)
            .args(words(&format!(
                "calibrate sensor --frames 8 --id {id} --date {date}"
            )))
            .assert()
            .success();
    }
    for (gain, id) in [("gain = 1.0", "low"), ("gain = 2.0", "high")] {
        rig_file(at, &[("\ngain = 1.0", &format!("\n{gain}"))]);
        let status = json(
            &rig(at)
                .args(["calibrate", "status", "--json"])
                .output()
                .unwrap(),
        );
        let sensor = state(&status, "sensor");
        assert_eq!(
            (&sensor["id"], &sensor["state"]),
            (&id.into(), &"good".into())
        );
    }
}

#[test]
fn the_lamp_is_watched_and_a_failure_keeps_the_old_record() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir_all(at.join("calibration/simulated")).unwrap();
    let warming = |seconds: &str| {
        rig_file(
            at,
            &[
                ("warm_up_fraction = 0.0", "warm_up_fraction = 0.08"),
                ("warm_up_s = 60.0", &format!("warm_up_s = {seconds}")),
            ],
        );
    };
    warming("60.0");
    let lamp = ["calibrate", "lamp", "--minutes", "12"];
    let output = rig(at)
        .args(lamp)
        .args(["--json", "--id", "one"])
        .output()
        .unwrap();
    let report = json(&output);
    let warm_s = report["values"]["warm_up_time_s"].as_f64().unwrap();
    let expected_s = 60.0 * (0.08f64 / 1e-3).ln();
    assert!((warm_s / expected_s - 1.0).abs() < 0.1, "{warm_s}");
    assert!(at.join("calibration/simulated/plots/one.png").exists());

    // Too slow to be watched in twelve minutes: refused, and nothing was written.
    warming("900.0");
    let output = rig(at).args(lamp).args(["--id", "two"]).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    for part in ["still warming up", "let the lamp cool, put a white card"] {
        assert!(stderr.contains(part), "{stderr}");
    }
    let records = std::fs::read_dir(at.join("calibration/simulated/lamp")).unwrap();
    assert_eq!(records.count(), 1);
    for (wrong, advice) in [
        (["--minutes", "1"], "not a number in 2 to 240"),
        (["--channel", "7"], "its channels are 0 to 2"),
    ] {
        let output = rig(at).args(&lamp[..2]).args(wrong).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        assert!(stderr.contains(advice), "{stderr}");
    }
}
