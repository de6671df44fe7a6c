//! `rig brdf`, run as a user does.

use crate::fitted_session;

use crate::command_support::{cases, ended, run, words};
use std::path::Path;

/// Exit code, stdout, stderr.
fn rig(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    ended(&run(folder, &[&["brdf"], arguments].concat()))
}

#[test]
fn values_at_angles() {
    let folder = tempfile::tempdir().unwrap();
    let angles = "theta_i_deg,theta_o_deg,phi_deg\n20,30,180\n0,0,0\n95,0,0\n";
    std::fs::write(folder.path().join("bad.csv"), angles).unwrap();
    let good = angles.trim_end_matches("95,0,0\n");
    std::fs::write(folder.path().join("good.csv"), good).unwrap();

    let arguments = ["eval", "--brdf", "ggx:0.1,1.5", "--angles", "good.csv"];
    let (code, out, _) = rig(folder.path(), &arguments);
    assert_eq!(code, 0);
    let rows: Vec<&str> = out.lines().collect();
    assert_eq!(rows[0], "theta_i_deg,theta_o_deg,phi_deg,f_r,f_g,f_b");
    // F(0)·D(0)/4 = 0.04/(4π·0.01).
    let coaxial: f64 = rows[2].split(',').nth(4).unwrap().parse().unwrap();
    assert!((coaxial - 0.04 / (4.0 * std::f64::consts::PI * 0.01)).abs() < 1e-6);

    let (code, out, err) = rig(
        folder.path(),
        &["eval", "--brdf", "ggx:0.1,1.5", "--angles", "bad.csv"],
    );
    assert_eq!((code, out.as_str()), (1, ""));
    assert!(
        err.contains("bad.csv: line 4: polar angle 95") && err.contains("hint:"),
        "{err}"
    );
}

#[test]
fn materials_are_listed_and_evaluated_at_an_angle() {
    let here = Path::new(".");
    let (code, list, _) = rig(here, &["list"]);
    assert_eq!((code, list.lines().count()), (0, 26));
    assert!(list.lines().is_sorted());
    let (_, json, _) = rig(here, &["list", "--json"]);
    let names: Vec<String> = serde_json::from_str(&json).unwrap();
    assert!(names.iter().map(String::as_str).eq(list.lines()));

    let name = list.lines().last().unwrap();
    let (code, out, err) = rig(
        here,
        &["eval", name, "--at", "30,30,180", "--at", "0,45,-90"],
    );
    assert_eq!((code, out.lines().count()), (0, 3), "{err}");
    assert!(
        out.contains("\n30,30,180,") && out.contains("\n0,45,-90,"),
        "{out}"
    );
    for (at, said) in [
        ("30,30", "three angles in degrees are needed"),
        ("30,95,0", "polar angle 95, allowed is 0 to 90"),
        ("30,x,0", "is no number"),
    ] {
        let (code, _, err) = rig(here, &["eval", name, "--at", at]);
        assert!(code != 0 && err.contains(said), "{err}");
    }
}

#[test]
fn a_converted_material_is_the_material() {
    let folder = tempfile::tempdir().unwrap();
    let (code, out, err) = rig(
        folder.path(),
        &["convert", "nbrdf:dark-red-paint", "--out", "paint.binary"],
    );
    assert_eq!((code, out.as_str()), (0, "paint.binary\n"), "{err}");
    let (code, out, err) = rig(
        folder.path(),
        &words("compare paint.binary nbrdf:dark-red-paint --size 12 --json"),
    );
    assert_eq!(code, 0, "{err}");
    let scores: serde_json::Value = serde_json::from_str(&out).unwrap();
    let error = |path: &str| scores.pointer(path).unwrap().as_f64().unwrap();
    assert!(error("/environment/mean/all") < 2e-3, "{out}");
    assert!(error("/brdf/cube_root/all") < 2e-3, "{out}");

    // A table cut short is refused with its sizes.
    let path = folder.path().join("paint.binary");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let (code, _, err) = rig(folder.path(), &["check", "paint.binary"]);
    assert_eq!(code, 1);
    assert!(err.contains("90 x 90 x 180 cells need 34992000"), "{err}");
}

#[test]
fn a_projection_shows_the_score_beside_its_floor() {
    let folder = tempfile::tempdir().unwrap();
    let (code, out, err) = rig(
        folder.path(),
        &words("project lambertian:0.5 --dictionary rig26 --size 12 --json --out weights.csv"),
    );
    assert_eq!(code, 0, "{err}");
    let answer: serde_json::Value = serde_json::from_str(&out).unwrap();
    for part in ["reference_projection", "floor"] {
        let error = answer[part]["environment"]["mean"]["all"].as_f64().unwrap();
        assert!(error < 1e-3, "{part}: {error}");
    }
    let (code, out, err) = rig(folder.path(), &["check", "rig26:weights.csv"]);
    assert_eq!(code, 0, "{err}");
    assert!(
        out.contains("largest albedo        0.50") || out.contains("largest albedo        0.49"),
        "{out}"
    );
    // Another dictionary's weights are not taken for this one's.
    let (code, _, err) = rig(folder.path(), &["check", "paper42:weights.csv"]);
    assert_eq!(code, 1);
    assert!(err.contains("eta 1.8, in paper42 it is 10"), "{err}");
}

#[test]
fn bad_input_is_one_line_and_a_hint() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("junk.binary"), b"junk").unwrap();
    std::fs::write(folder.path().join("junk.bsdf"), b"junk").unwrap();
    std::fs::write(folder.path().join("junk.json"), b"{\"atoms\": []}").unwrap();
    let wide = b"atoms = [{ type = \"ggx\", alpha = 2.0, eta = 1.5 }]";
    std::fs::write(folder.path().join("wide.toml"), wide).unwrap();
    for [line, said] in cases(
        r#"
        check nbrdf:gold | no embedded material "gold"
        check gold | "gold" is no BRDF
        check pvc | hint: the embedded material is nbrdf:pvc
        check ggx:2,1.5 | alpha 2
        check missing.binary | missing.binary
        check junk.binary | at least 12
        check junk.bsdf | ends inside its header
        check paper42:missing.csv | missing.csv
        project lambertian:0.5 --dictionary junk.json | 0 atoms
        project lambertian:0.5 --dictionary wide.toml | hint: a dictionary is a list `atoms`
        project lambertian:0.5 --size 4 | 8 to 512
        convert lambertian:0.5 --out x.merl | the name ends in none of .binary
        convert lambertian:0.5 --out no/folder/x.binary | x.binary
        plot lambertian:0.5 --out x.jpg | ends in .png
        eval --brdf lambertian:0.5 --angles none.csv | none.csv
        plot ggx:0.1,1.5 --kind difference --out x.png | a difference needs two BRDFs
        plot ggx:0.1,1.5 --kind lobes --angles 15,95 --out x.svg | allowed are 0 to 89 degrees
        plot ggx:0.1,1.5 --kind slices --channels rgr --out x.svg | the letters r, g and b
        plot ggx:0.1,1.5 gold --kind lobes --out x.svg | "gold" is no BRDF
        compare ggx:0.1,1.5 ggx:0.2,1.5 --constrained | neither ggx:0.1,1.5 nor ggx:0.2,1.5 is a fit
    "#,
    ) {
        let arguments = &words(line)[..];
        let (code, out, err) = rig(folder.path(), arguments);
        assert_eq!((code, out.as_str()), (1, ""), "{arguments:?}: {err}");
        assert!(
            err.starts_with("error: ") && err.contains(said),
            "{arguments:?}: {err}"
        );
        let lines = err.lines().count();
        assert!(
            lines == 1 || (lines == 3 && err.contains("\nhint: ")),
            "{err}"
        );
    }
    assert!(
        std::fs::read_dir(folder.path()).unwrap().count() == 4,
        "nothing was left behind"
    );
}

/// A MERL file of 6 x 6 x 6 cells that hold `value`, but for `others` of them.
fn merl(value: f64, others: &[(usize, f64)]) -> Vec<u8> {
    let mut bytes: Vec<u8> = [6i32; 3].iter().flat_map(|n| n.to_le_bytes()).collect();
    let mut cells = vec![value; 3 * 216];
    for &(cell, value) in others {
        cells[cell] = value;
    }
    bytes.extend(cells.iter().flat_map(|cell| cell.to_le_bytes()));
    bytes
}

#[test]
fn cells_without_a_value_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let nan = f64::NAN;
    let unmeasured = merl(100.0, &[(0, -1.0)]);
    let above = [nan, f64::INFINITY].map(|value| merl(100.0, &[(7, value)]));
    let none = "nodes without value   0 not measured, 0 undefined";
    let one = "nodes without value   1 not measured, 0 undefined";
    let undefined = "1 above the horizon are undefined";
    let no_table = "is no measured table: of its 216 nodes,";
    let too_few = "are marked as not measured (allowed half)";
    let infinite = "undefined or infinite (allowed 0)";
    for (bytes, code, said) in [
        (merl(100.0, &[]), 0, none),
        (unmeasured, 0, one),
        (merl(nan, &[]), 1, no_table),
        (merl(-1.0, &[]), 1, too_few),
        (merl(1e300, &[]), 1, infinite),
        (above[0].clone(), 1, undefined),
        (above[1].clone(), 1, undefined),
        (merl(1e30, &[]), 1, "is not physical"),
    ] {
        std::fs::write(folder.path().join("m.binary"), bytes).unwrap();
        let (found, out, err) = rig(folder.path(), &["check", "m.binary"]);
        assert_eq!(found, code, "{said}: {out}{err}");
        assert!(format!("{out}{err}").contains(said), "{said}: {out}{err}");
    }
}

/// A fit's band and its grey part are in the picture, and nothing of a BRDF without a table.
#[test]
fn brdfs_are_drawn_over_each_other() {
    let home = tempfile::tempdir().unwrap();
    let fit = fitted_session::fit(false);
    let root = fitted_session::session(home.path(), &fit, "", true);
    let session = root.to_str().unwrap();
    let drawn = |arguments: &[&str]| {
        let arguments = [&["plot"], arguments, &["--out", "x.svg"]].concat();
        let (code, out, err) = rig(home.path(), &arguments);
        assert_eq!((code, out.as_str()), (0, "x.svg\n"), "{err}");
        std::fs::read_to_string(home.path().join("x.svg")).unwrap()
    };
    let (grey, band) = ("#a6a6a6", "95% interval of a fit");
    for more in [
        &["--kind", "lobes"] as &[&str],
        &["--kind", "lobes", "--axes", "cartesian"],
        &["--kind", "slices", "--angles", "10,80"],
    ] {
        let svg = drawn(&[&[session, "ggx:0.2,1.5"], more].concat());
        assert!(svg.contains(grey) && svg.contains(band), "{more:?}");
        assert!(svg.contains("ggx:0.2,1.5") && svg.contains("green"));
        let svg = drawn(&[&["ggx:0.3,1.5", "ggx:0.2,1.5"], more].concat());
        assert!(!svg.contains(grey) && !svg.contains(band), "{more:?}");
    }
    assert!(drawn(&["ggx:0.3,1.5", "--kind", "slices"]).contains("blue of ggx:0.3,1.5"));
    let spheres = drawn(&["ggx:0.3,1.5", "ggx:0.3,1.5", "--size", "8"]);
    assert!(spheres.contains("off by 0.0%") && spheres.contains("reference"));
    let ratios = drawn(&[session, "ggx:0.2,1.5", "--kind", "difference"]);
    assert!(ratios.contains("f over f of ggx:0.2,1.5"));
}

#[test]
fn errors_that_can_be_pictured() {
    let home = tempfile::tempdir().unwrap();
    let arguments = ["compare", "lambertian:0.4", "lambertian:0.5", "--size", "8"];
    let (code, out, err) = rig(home.path(), &arguments);
    assert_eq!(code, 0, "{err}");
    assert!(
        out.contains("at  45°                  -0.10") && out.contains("-20.0%"),
        "{out}"
    );
    // Over the constrained part of a fit: of the peaks those that it holds.
    let fit = fitted_session::fit(false);
    let root = fitted_session::session(home.path(), &fit, "", true);
    let root = root.to_str().unwrap();
    let (_, out, err) = rig(
        home.path(),
        &["compare", root, "lambertian:0.5", "--constrained", "--json"],
    );
    let found: serde_json::Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{err}"));
    let share = found["share"].as_f64().unwrap();
    // Up to midway between 40° and 54.4°; by random half and difference vectors 0.587.
    assert!((share - 0.587).abs() < 0.01, "{share}");
    assert_eq!(found["peak"].as_array().unwrap().len(), 3);
    assert!(found.get("environment").is_none());
}
