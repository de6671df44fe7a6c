use std::sync::Arc;

use glam::Vec3;
use serde_json::Value;

use super::*;
use crate::brdf::discrepancy::{Discrepancy, NODES, Node};
use crate::brdf::{Brdf, Dictionary, Mixture};
use crate::session::fit_record::{AngleTable, DiscrepancyRecord, Interval};

fn record(simulated: bool) -> FitRecord {
    let channel = |gloss: usize, matte: f64| {
        let mut weights = vec![0.0; 42];
        (weights[gloss], weights[40]) = (0.3, matte);
        weights[41] = 0.7 - matte;
        weights
    };
    let cell = Interval {
        value: [0.5, 0.25, 0.125],
        lower: [0.4, 0.2, 0.1],
        upper: [0.6, 0.3, 0.2],
        constrained: true,
    };
    let weights = [channel(12, 0.6), channel(13, 0.2), channel(22, 0.1)];
    let mixture = Mixture::new(Arc::new(Dictionary::paper42()), weights).unwrap();
    FitRecord {
        simulated,
        reduced_chi_square: vec![[1.0; 3]],
        table: AngleTable {
            theta_h_deg: vec![0.0, 30.0],
            theta_d_deg: vec![0.0, 20.0, 40.0],
            cells: vec![cell; 6],
        },
        ..FitRecord::of_mixture(&mixture)
    }
}

/// A fit with a model discrepancy that differs between the channels.
fn with_discrepancy() -> FitRecord {
    let by_channel = [0.2, -0.3, 0.5].map(|scale| {
        let phase = |n: &Node| 0.1 * n.theta_h_deg + 0.03 * n.theta_d_deg;
        let mut g = Discrepancy::even(|n| scale * phase(n).sin());
        let slopes = Discrepancy::even(|n| 0.1 * scale * phase(n).cos());
        g.0.rows_mut(NODES, NODES)
            .copy_from(&slopes.0.rows(0, NODES));
        g
    });
    FitRecord {
        discrepancy: Some(DiscrepancyRecord {
            amplitude: 0.8,
            by_channel,
        }),
        ..record(true)
    }
}

/// The node's factors make of the weights' mixture the material.
#[test]
fn json_has_the_discrepancy() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("brdf.json");
    let record = with_discrepancy();
    export(&record, &json::FORMAT, &out).unwrap();
    let document: Value = serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap();
    assert_eq!(document["discrepancy"]["amplitude"], 0.8);
    let node = &document["discrepancy"]["nodes"][40];
    let angle = |name: &str| node[name].as_f64().unwrap().to_radians();
    let (to_light, to_viewer) = crate::brdf::HalfDifference {
        theta_h_rad: angle("theta_h_deg"),
        theta_d_rad: angle("theta_d_deg"),
        phi_d_rad: std::f64::consts::FRAC_PI_2,
    }
    .to_directions();
    let f = |brdf: &dyn Brdf| brdf.eval(to_light.as_vec3(), to_viewer.as_vec3());
    let mixture = f(&record.mixture().unwrap());
    let material = f(&*record.material().unwrap());
    for c in 0..3 {
        // At φd = 90°, cos 2φd is −1.
        let [even, slope] =
            ["ln_factor", "by_cos_2phi"].map(|name| node[name][c].as_f64().unwrap());
        let factor = (even - slope).exp();
        let ratio = f64::from(material[c] / mixture[c]);
        assert!((ratio / factor - 1.0).abs() < 1e-4, "{ratio} for {factor}");
        assert!((factor - 1.0).abs() > 0.01, "{factor}");
    }
}

/// Mitsuba's blends are the mixture alone, with a note of that.
#[test]
fn blends_have_a_note_that_they_lack_the_discrepancy() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.xml");
    let text = |record: &FitRecord| {
        export(record, &mitsuba::FORMAT, &out).unwrap();
        std::fs::read_to_string(&out).unwrap()
    };
    assert!(text(&with_discrepancy()).contains("model discrepancy"));
    assert!(!text(&record(true)).contains("model discrepancy"));
}

#[test]
fn json_has_the_whole_brdf() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("brdf.json");
    let record = record(true);
    let files = export(&record, &json::FORMAT, &out).unwrap().files;
    assert_eq!(files, std::slice::from_ref(&out));
    let document: Value = serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap();
    assert_eq!(document["simulated"], true);
    assert!(document["note"].as_str().unwrap().starts_with("SIMULATED"));
    // The document's dictionary and weights make the same BRDF again.
    let atoms = serde_json::from_value(document["dictionary"]["atoms"].clone()).unwrap();
    let weights = serde_json::from_value(document["weights"].clone()).unwrap();
    let back = Mixture::new(Arc::new(Dictionary::new("back", atoms).unwrap()), weights).unwrap();
    let (to_light, to_viewer) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.48, 0.36, 0.8));
    let expected = record.mixture().unwrap().eval(to_light, to_viewer);
    assert_eq!(back.eval(to_light, to_viewer), expected);
    let table = &document["table"];
    assert_eq!(table["upper"].as_array().unwrap().len(), 2);
    assert_eq!(table["upper"][1][2], serde_json::json!([0.6, 0.3, 0.2]));
    assert_eq!(table["constrained"][0][0], true);
}

/// The stored numbers are the fit's BRDF at the database's nodes (θh = i²/90°,
/// θd = j°, φd = k°), and the reader gives every one of them back as it stands.
#[test]
fn a_merl_file_is_read_back_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("x.binary");
    let record = with_discrepancy();
    let files = export(&record, &merl_file::FORMAT, &out).unwrap().files;
    assert_eq!(files, [out.clone(), folder.path().join("x.binary.txt")]);
    assert!(
        std::fs::read_to_string(&files[1])
            .unwrap()
            .starts_with("SIMULATED")
    );

    let bytes = std::fs::read(&out).unwrap();
    let cells = 90 * 90 * 180;
    assert_eq!(bytes.len(), 12 + cells * 3 * 8);
    let table = merl::read(&out).unwrap();
    let material = record.material().unwrap();
    let mut compared = 0;
    for cell in (0..cells).step_by(101) {
        let stored = [0, 1, 2].map(|c| {
            let at = 12 + (c * cells + cell) * 8;
            f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) * merl::SCALE[c]
        });
        if stored[0] < 0.0 {
            continue; // Below the horizon.
        }
        assert_eq!(
            table.values()[cell],
            stored.map(|x| x as f32),
            "cell {cell}"
        );
        let (i, j, k) = (cell / (90 * 180), cell / 180 % 90, cell % 180);
        let theta_h = ((i * i) as f64 / 90.0).to_radians();
        let (sin_d, cos_d) = (j as f64).to_radians().sin_cos();
        let (sin_phi, cos_phi) = (k as f64).to_radians().sin_cos();
        let difference = glam::DVec3::new(sin_d * cos_phi, sin_d * sin_phi, cos_d);
        let to_sample = glam::DQuat::from_rotation_y(theta_h);
        let mirrored = glam::DVec3::new(-difference.x, -difference.y, difference.z);
        let (light, viewer) = (
            (to_sample * difference).as_vec3(),
            (to_sample * mirrored).as_vec3(),
        );
        if light.z.min(viewer.z) < 0.02 {
            continue; // Single precision decides the horizon.
        }
        for (got, want) in stored.into_iter().zip(material.eval(light, viewer)) {
            let want = f64::from(want);
            assert!(
                (got - want).abs() < 1e-3 * want,
                "cell {cell}: {got} for {want}"
            );
        }
        compared += 1;
    }
    assert!(compared > 5000, "{compared} cells");
}

#[test]
fn only_simulated_exports_are_marked() {
    let folder = tempfile::tempdir().unwrap();
    for (format, name) in [
        (&json::FORMAT, "a.json"),
        (&mitsuba::FORMAT, "a.xml"),
        (&rgl::FORMAT, "a.bsdf"),
        (&pbrt::FORMAT, "a.pbrt"),
    ] {
        for simulated in [true, false] {
            let out = folder.path().join(name);
            for file in export(&record(simulated), format, &out).unwrap().files {
                let bytes = std::fs::read(&file).unwrap();
                let marked = bytes.windows(9).any(|window| window == b"SIMULATED");
                assert_eq!(marked, simulated, "{}", file.display());
            }
        }
    }
}

#[test]
fn an_unusable_fit_or_place_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut bad = record(false);
    bad.atoms[0].alpha = None;
    let error = export(&bad, &mitsuba::FORMAT, &folder.path().join("a.xml")).unwrap_err();
    assert!(error.to_string().contains("paper42"), "{error}");
    let nowhere = folder.path().join("missing/a.json");
    let error = export(&record(false), &json::FORMAT, &nowhere).unwrap_err();
    assert!(error.to_string().contains("missing/a.json"), "{error}");
}

/// Files of different names hold materials of different names.
#[test]
fn names_of_materials_differ_as_those_of_files() {
    let brdf = Dictionary::paper42();
    let brdf = Mixture::grey(Arc::new(brdf), vec![1.0 / 42.0; 42]).unwrap();
    let names = [
        "赤漆",
        "青漆",
        "Größe",
        "Grüße",
        "a b",
        "a_b",
        "a-b",
        "1",
        "material_1",
    ];
    let mut known = std::collections::HashSet::new();
    for name in names {
        let out = PathBuf::from(format!("{name}.mtlx"));
        let subject = Subject {
            brdf: &brdf,
            description: "",
            simulated: false,
            name: None,
            closest: false,
            progress: &(),
            out: &out,
        };
        assert_eq!(subject.name(), name);
        let out = Path::new("brdf.mtlx");
        let named = Subject {
            name: Some(name),
            out,
            ..subject
        };
        assert_eq!(named.identifier(), subject.identifier());
        let identifier = subject.identifier();
        let is_allowed = |c: char| c.is_ascii_alphanumeric() || c == '_';
        assert!(identifier.chars().all(is_allowed), "{identifier}");
        assert!(identifier.starts_with(|c: char| c.is_ascii_alphabetic()));
        assert_eq!(identifier == name, ["a_b", "material_1"].contains(&name));
        assert!(known.insert(identifier), "{name}");
    }
}
