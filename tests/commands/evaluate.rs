//! `rig evaluate`: tables, figures, and runs that are taken up again.

use std::path::Path;

use crate::command_support::{cases, ended, run_line};
use assert_cmd::Command;
use serde_json::Value;

fn rig(folder: &Path, line: &str) -> (i32, String, String) {
    ended(&run_line(folder, line))
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap()
}

const SHAPES: &str = "evaluate shapes --quick --resolution 12 --spp 16 --materials synthetic:cream-satin --portable --out out";

#[test]
fn a_table_its_figures_and_a_run_taken_up_again() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let (code, stdout, stderr) = rig(folder.path(), SHAPES);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(stdout, "out\n");
    let csv = read(&out.join("table.csv"));
    let json: Value = serde_json::from_str(&read(&out.join("table.json"))).unwrap();

    // One row per shape, and the same figures in both files.
    let rows = json["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 5);
    let header: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    assert_eq!(json["columns"], serde_json::json!(header));
    for (line, row) in csv.lines().skip(1).zip(rows) {
        for (column, field) in header.iter().zip(line.split(',')) {
            match &row[column] {
                Value::String(text) => assert_eq!(field, text),
                number => assert_eq!(&field.parse::<Value>().unwrap(), number),
            }
        }
    }
    for row in rows {
        let of = |column: &str| row[column].as_f64().unwrap();
        assert!(of("floor") > 0.0 && of("floor") <= of("reference_projection"));
        assert!(of("floor") <= of("environment_error") * (1.0 + 1e-9));
    }
    let settings = &json["settings"];
    assert_eq!(settings["resolution_px"], 12);
    assert_eq!(settings["kernel"], "portable");
    assert_eq!(settings["materials"][0], "synthetic:cream-satin");

    // The figure, twice.
    let svg = read(&out.join("shapes.svg"));
    assert!(svg.starts_with("<svg") && svg.contains("concave"));
    let png = std::fs::read(out.join("shapes.png")).unwrap();
    let image = image::load_from_memory(&png).unwrap().to_luma8();
    let dark = image.pixels().filter(|p| p.0[0] < 128).count();
    assert!(dark > image.pixels().len() / 200, "{dark} dark pixels");

    // Without its last case and with a torn line, the run is completed to the same table.
    let journal = read(&out.join("journal.jsonl"));
    let lines: Vec<&str> = journal.lines().collect();
    assert_eq!(lines.len(), 6);
    let torn = &lines[5][..lines[5].len() / 2];
    std::fs::write(
        out.join("journal.jsonl"),
        format!("{}\n{torn}", lines[..5].join("\n")),
    )
    .unwrap();
    let (code, _, stderr) = rig(folder.path(), SHAPES);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("4 cases were finished before"), "{stderr}");
    assert_eq!(read(&out.join("table.csv")), csv);

    // A text that no case has in its name; then one case alone, and the others after it.
    let (code, _, stderr) = rig(folder.path(), &format!("{SHAPES} --only torus"));
    assert_eq!(code, 1);
    assert!(
        stderr.contains("none of the 5 cases has \"torus\""),
        "{stderr}"
    );
    let parts = SHAPES.replace("--out out", "--out parts");
    let (code, _, stderr) = rig(folder.path(), &format!("{parts} --only bowl"));
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("4 other cases are open"), "{stderr}");
    let parts_out = folder.path().join("parts");
    assert_eq!(read(&parts_out.join("table.csv")).lines().count(), 2);
    assert!(!parts_out.join("shapes.svg").exists());
    let (code, _, stderr) = rig(folder.path(), &parts);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("1 case was finished before"), "{stderr}");
    assert_eq!(read(&parts_out.join("table.csv")), csv);
    assert!(parts_out.join("shapes.svg").exists());

    // Other settings are refused by name; --restart begins anew.
    let other = SHAPES.replace("--spp 16", "--spp 8");
    let (code, _, stderr) = rig(folder.path(), &other);
    assert_eq!(code, 1);
    assert!(
        stderr.contains("samples_per_pixel was 16, is 8") && stderr.contains("--restart"),
        "{stderr}"
    );
    assert_eq!(read(&out.join("table.csv")), csv);
    let (code, _, stderr) = rig(folder.path(), &format!("{other} --restart"));
    assert_eq!(code, 0, "{stderr}");
    assert_ne!(read(&out.join("table.csv")), csv);
}

/// Shards at once, one of them with a journal that was torn, and whoever joins them: the table
/// of one process, whatever the number of shards. Nobody works next to a run of all cases.
#[test]
fn shards_give_the_table_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let files = |out: &str| {
        ["table.csv", "table.json", "shapes.svg"]
            .map(|file| read(&folder.path().join(out).join(file)))
    };
    let done = |words: &str| {
        let (code, stdout, stderr) = rig(folder.path(), words);
        assert_eq!(code, 0, "{stderr}");
        (stdout, stderr)
    };
    let into = |out: &str| {
        SHAPES
            .replace("--spp 16", "--spp 4")
            .replace("--out out", &format!("--out {out}"))
    };
    done(&into("alone"));

    for of in [2, 7] {
        let out = format!("of-{of}");
        std::thread::scope(|scope| {
            for number in 1..=of {
                let words = format!("{} --shard {number}/{of}", into(&out));
                let folder = folder.path();
                scope.spawn(move || {
                    let (code, _, stderr) = rig(folder, &words);
                    assert_eq!(code, 0, "{stderr}");
                });
            }
        });
        // Killed while it wrote its last case.
        let journal = folder
            .path()
            .join(&out)
            .join(format!("journal-1-of-{of}.jsonl"));
        let text = read(&journal);
        assert_eq!(text.lines().count(), 1 + [3, 1][usize::from(of == 7)]);
        std::fs::write(&journal, &text[..text.len() - 9]).unwrap();
        assert!(!folder.path().join(&out).join("table.csv").exists());
        let (_, stderr) = done(&into(&out));
        assert!(stderr.contains("4 cases were finished before"), "{stderr}");
        assert_eq!(files(&out), files("alone"), "{of} shards");
    }

    // Locks as a run of all cases, and a shard of another division, hold them.
    let open = |name: &str| {
        let path = folder.path().join("of-2").join(name);
        std::fs::OpenOptions::new().append(true).open(path).unwrap()
    };
    for (name, words) in [
        ("journal.jsonl", " --shard 1/2"),
        ("journal-1-of-2.jsonl", " --shard 1/2"),
        ("journal-1-of-2.jsonl", " --shard 1/3"),
    ] {
        let file = open(name);
        file.try_lock().unwrap();
        let (code, _, stderr) = rig(folder.path(), &format!("{}{words}", into("of-2")));
        assert_eq!(code, 1, "{stderr}");
        assert!(
            stderr.contains("another process is at work in this folder"),
            "{stderr}"
        );
    }
    let shared = open("journal.jsonl");
    shared.try_lock_shared().unwrap();
    let (code, _, stderr) = rig(folder.path(), &into("of-2"));
    assert_eq!(code, 1, "{stderr}");
    done(&format!("{} --shard 2/2", into("of-2")));
    let (code, _, stderr) = rig(
        folder.path(),
        &SHAPES.replace("--out out", "--out of-2 --shard 1/2"),
    );
    assert_eq!(code, 1);
    assert!(
        stderr.contains("samples_per_pixel was 4, is 16"),
        "{stderr}"
    );
    drop(shared);

    // The script, which submits nothing.
    let (script, _) = done(&format!("{} --slurm 3 --time 7", into("new")));
    for part in [
        "#SBATCH --array=1-3\n",
        "#SBATCH --time=7\n",
        "--out new --shard \"$SLURM_ARRAY_TASK_ID\"/3\n",
    ] {
        assert!(script.contains(part), "{part} in\n{script}");
    }
    assert!(!script.contains("--slurm") && !folder.path().join("new").exists());
}

/// The four lights that each shipped rig file plans, and what they tell of a white dielectric
/// on it: far less error than one light at the horizon, which is about 0.5.
#[test]
fn plans_of_the_shipped_benches_are_scored() {
    let folder = tempfile::tempdir().unwrap();
    let plans = "evaluate plans --quick --resolution 20 --spp 32 --materials synthetic:cream-satin --portable --only /4/planned --out out";
    let (code, _, stderr) = rig(folder.path(), plans);
    assert_eq!(code, 0, "{stderr}");
    let json: Value = serde_json::from_str(&read(&folder.path().join("out/table.json"))).unwrap();
    let rows = json["rows"].as_array().unwrap();
    assert_eq!(rows.len(), rig::config::BUILT_IN.len());
    for row in rows {
        let elevations = row["elevations_deg"].as_str().unwrap().split(' ');
        let elevations: Vec<f64> = elevations.map(|e| e.parse().unwrap()).collect();
        assert_eq!(elevations.len(), 4, "{row}");
        // Lights for a camera on the axis are not near the horizon.
        let name = row["rig"].as_str().unwrap();
        let (_, file) = rig::config::BUILT_IN
            .iter()
            .find(|of| of.0 == name)
            .unwrap();
        let config = rig::config::RigConfig::parse(name, Path::new(""), file).unwrap();
        let is_tilted = config.geometry.coaxial().z < 0.99;
        assert!(
            is_tilted || elevations.iter().all(|e| (30.0..=80.0).contains(e)),
            "{row}"
        );
        assert!(row["environment_error"].as_f64().unwrap() < 0.2, "{row}");
    }
}

#[test]
fn visits_of_the_table_are_as_the_paper_says() {
    let folder = tempfile::tempdir().unwrap();
    let words = "evaluate table-visits --quick --resolution 16 --spp 32 --json --out v";
    let (code, stdout, stderr) = rig(folder.path(), words);
    assert_eq!(code, 0, "{stderr}");
    let json: Value = serde_json::from_str(&stdout).unwrap();
    let cells = |shape: &str, reflections: u64| -> Vec<(f64, f64)> {
        let rows = json["rows"].as_array().unwrap();
        rows.iter()
            .filter(|row| row["shape"] == shape && row["reflections_up_to"] == reflections)
            .map(|row| ["theta_h_deg", "theta_d_deg"].map(|a| row[a].as_f64().unwrap()))
            .map(|[h, d]| (h, d))
            .collect()
    };
    // Three facets, three entries; one light, one column; and no second reflections.
    assert!(cells("convex corner", 2).len() <= 3);
    let sphere = cells("sphere", 2);
    assert!(sphere.iter().all(|(_, d)| *d == 0.0) && sphere.len() > 20);
    // Interreflections fill the table;
    for shape in ["concave corner", "bowl", "designed"] {
        assert!(cells(shape, 2).len() > 5 * cells(shape, 1).len(), "{shape}");
    }
    // only the designed shape shows mirror directions at small difference angles.
    let mirror = |shape| {
        let all = cells(shape, 2);
        all.iter()
            .filter(|(h, d)| *h == 0.0 && (6.0..24.0).contains(d))
            .count()
    };
    assert_eq!((mirror("designed"), mirror("bowl")), (6, 0));
}

/// The outside method, learned without the material: more samples, less error, and what a
/// dictionary reaches stands next to it.
#[test]
fn the_outside_method_is_scored_like_a_fit() {
    let folder = tempfile::tempdir().unwrap();
    let words = "evaluate baseline --quick --materials nbrdf:pvc,nbrdf:green-latex --only pvc --json --out b";
    let (code, stdout, stderr) = rig(folder.path(), words);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("1 other case is open"), "{stderr}");
    let json: Value = serde_json::from_str(&stdout).unwrap();
    let rows = json["rows"].as_array().unwrap();
    let row = |samples: &str| rows.iter().find(|row| row["samples"] == samples).unwrap();
    let error = |samples: &str| row(samples)["environment_error"].as_f64().unwrap();
    assert_eq!(rows.len(), 7);
    // 25 other materials of three channels, and a ridge in proportion to the published one.
    for row in rows {
        assert_eq!(
            (&row["material"], &row["ridge"]),
            (&"pvc".into(), &10.0.into())
        );
        let of = |column: &str| row[column].as_f64().unwrap();
        assert!(of("floor") <= of("reference_projection"));
        let ratio = of("environment_error") / of("reference_projection");
        assert!((ratio / of("ratio_to_reference") - 1.0).abs() < 1e-9);
    }
    assert_eq!(row("20 directions")["components"], 20);
    // As many components as there are values, at most the 74 that 75 columns span.
    for row in rows {
        let of = |column: &str| row[column].as_u64().unwrap();
        assert_eq!(of("components"), of("observations").min(74), "{row}");
    }
    assert_eq!(row("all directions")["components"], 74);
    let angles = |samples: &str| {
        row(samples)["lights_deg"]
            .as_str()
            .unwrap()
            .split(' ')
            .count()
    };
    assert_eq!(
        (angles("1 sphere image"), angles("2 sphere images")),
        (1, 2)
    );
    assert!(error("all directions") < error("20 directions"));
    assert!(error("20 directions") < error("1 direction"));
    assert!(
        error("2 sphere images") < 0.3,
        "{}",
        error("2 sphere images")
    );
    assert!(!folder.path().join("b/baseline.svg").exists());

    // The other material later, to a table of both with a figure.
    let (code, _, stderr) = rig(folder.path(), &words.replace(" --only pvc", ""));
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("1 case was finished before"), "{stderr}");
    let csv = read(&folder.path().join("b/table.csv"));
    assert_eq!(csv.lines().count(), 15);
    assert!(read(&folder.path().join("b/baseline.svg")).contains("sphere image"));
}

#[test]
fn what_is_wrong_is_said_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("mine.txt"), "kept").unwrap();
    for [words, said] in cases(
        r#"
        evaluate nothing --out a | "nothing" is no experiment (known: atoms, accuracy
        evaluate atoms --lights 3 --out a | atoms has no setting lights
        evaluate shapes --materials gold --out a | "gold" is unknown (known: bundled, mirrors
        evaluate shapes --materials pvc --out a | did you mean `nbrdf:pvc`?
        evaluate shaps --out a | did you mean `shapes`?
        evaluate atoms --truth-spp 64 --out a | atoms has no setting truth-spp
        evaluate shapes --sphere 4 --out a | 8..=512
        evaluate form --materials nbrdf:pvc --out a | no material of class in-span
        evaluate shapes --out . | not empty, and no experiment's folder
        evaluate shapes | --out <DIR>
    "#,
    ) {
        let (code, _, stderr) = rig(folder.path(), words);
        assert_eq!(code, 1, "{words}");
        assert!(
            stderr.contains(said) && stderr.contains("hint: "),
            "{stderr}"
        );
        assert!(!folder.path().join("a").exists(), "{words}");
    }
    // A journal that is no file, and a path that would end the script's text.
    let of_shard = folder.path().join("b/journal-1-of-2.jsonl");
    std::fs::create_dir(folder.path().join("b")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", &of_shard).unwrap();
    for (words, said) in [
        (
            "evaluate atoms --quick --out b",
            "it is a device, not a regular file",
        ),
        (
            "evaluate atoms --quick --out b --shard 1/2",
            "it is a link, not a regular file",
        ),
        (
            "evaluate atoms --out y\u{2}END --slurm 2",
            "the command line of a job has a line break: ",
        ),
    ] {
        let arguments = words.split(' ').map(|word| word.replace('\u{2}', "\n"));
        let output = Command::new(env!("CARGO_BIN_EXE_rig"))
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.stdout.is_empty() && stderr.contains(said),
            "{words}: {stderr}"
        );
        let breaks = stderr.contains("name files and folders without line breaks");
        assert_eq!(breaks, words.contains("--slurm"), "{stderr}");
    }
    let (code, stdout, _) = rig(folder.path(), "evaluate --list");
    assert_eq!(code, 0);
    assert!(stdout.lines().count() > 10 && stdout.contains("light-count"));
}
