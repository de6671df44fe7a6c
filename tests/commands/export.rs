//! `rig export` and `rig report` on folders: what they print, where they fail.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Output;
use std::sync::Arc;

use crate::command_support::{run, stderr, words};
use rig::brdf::{Dictionary, Mixture};
use rig::session::fit_record::{self, FitImages, FitRecord};

fn rig(arguments: &[&str], folder: &Path) -> Output {
    run(folder, arguments)
}

fn write_fit(folder: &Path) {
    let dictionary = Dictionary::paper42();
    let channel = |gloss: usize, share: f64| {
        let mut weights = vec![0.0; dictionary.len()];
        (weights[gloss], weights[4], weights[40], weights[41]) = (share, 0.1, 0.3, 0.6 - share);
        weights
    };
    let weights = [channel(6, 0.5), channel(2, 0.35), channel(10, 0.6)];
    let mixture = Mixture::new(Arc::new(dictionary), weights).unwrap();
    let record = FitRecord {
        simulated: true,
        reduced_chi_square: vec![[1.0; 3]],
        ..FitRecord::of_mixture(&mixture)
    };
    fit_record::write(folder, &record, &FitImages::default()).unwrap();
}

/// Elements of an XML document in order, with their attributes; fails where tags do not close.
fn elements(xml: &str) -> Vec<(String, BTreeMap<String, String>)> {
    let (mut open, mut found) = (Vec::new(), Vec::new());
    for tag in xml.split('<').skip(1) {
        let (tag, text) = tag.split_once('>').expect("a tag ends");
        if tag.starts_with('!') || tag.starts_with('?') {
            assert!(!tag.trim_matches(['!', '-']).contains("--"), "{tag}");
            continue;
        }
        assert_eq!(text.trim(), "");
        let name = tag.split([' ', '/']).next().unwrap_or_default();
        if let Some(closed) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(closed.to_owned()));
            continue;
        }
        let mut attributes = BTreeMap::new();
        let mut rest = &tag[name.len()..];
        while let Some((key, after)) = rest.split_once("=\"") {
            let (value, after) = after.split_once('"').expect("a value ends");
            attributes.insert(key.trim().to_owned(), value.to_owned());
            rest = after;
        }
        if !tag.ends_with('/') {
            open.push(name.to_owned());
        }
        found.push((name.to_owned(), attributes));
    }
    assert!(open.is_empty(), "{open:?}");
    found
}

/// The JSON of a binary glTF, whose chunks must be whole.
fn json_of_glb(glb: &[u8]) -> serde_json::Value {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(&glb[..4], b"glTF");
    assert_eq!((word(4), word(8)), (2, glb.len()));
    let json = word(12);
    assert_eq!(&glb[16..20], b"JSON");
    let bin = 20 + json;
    assert_eq!(&glb[bin + 4..bin + 8], b"BIN\0");
    assert_eq!((json % 4, bin + 8 + word(bin)), (0, glb.len()));
    serde_json::from_slice(&glb[20..bin]).unwrap()
}

/// OpenPBR, Blender and glTF: each file is whole, says that the fit is simulated and what was
/// lost, and has its picture next to it.
#[test]
fn a_fit_becomes_the_material_of_other_programs() {
    let home = tempfile::tempdir().unwrap();
    write_fit(&home.path().join("fit"));
    for (format, file) in [
        ("openpbr", "a b.mtlx"),
        ("blender", "a.py"),
        ("gltf", "a.glb"),
    ] {
        let done = rig(
            &["export", "fit", "--format", format, "--out", file],
            home.path(),
        );
        let said = stderr(&done);
        assert!(done.status.success(), "{said}");
        assert_eq!(
            String::from_utf8(done.stdout).unwrap(),
            format!("{file}\n{file}.png\n")
        );
        assert!(
            said.contains("environment error") && said.contains("worst at θh"),
            "{said}"
        );
        let bytes = std::fs::read(home.path().join(file)).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        assert!(
            text.contains("SIMULATED") && text.contains("environment error"),
            "{format}"
        );
        let picture = image::open(home.path().join(format!("{file}.png"))).unwrap();
        assert!(picture.width() > 400 && picture.height() > 500);
    }

    // MaterialX: linear Rec. 709, a material of the file's name with its surface.
    let xml = std::fs::read_to_string(home.path().join("a b.mtlx")).unwrap();
    let elements = elements(&xml);
    assert_eq!(elements[0].1["colorspace"], "lin_rec709");
    assert_eq!(elements[1].0, "open_pbr_surface");
    let (kind, material) = &elements[elements.len() - 2];
    assert_eq!(kind, "surfacematerial");
    assert!(material["name"].starts_with("a_b_"), "{material:?}");
    assert_eq!(material["uiname"], "a b");
    assert_eq!(
        elements[elements.len() - 1].1["nodename"],
        elements[1].1["name"]
    );
    let input = |name: &str| {
        let with_name = |(_, a): &&(String, BTreeMap<String, String>)| {
            a.get("name").map(String::as_str) == Some(name)
        };
        elements.iter().find(with_name).unwrap().1["value"].clone()
    };
    let roughness: f64 = input("specular_roughness").parse().unwrap();
    assert!((0.05..=1.0).contains(&roughness));
    assert_eq!(input("base_color").split(", ").count(), 3);

    // glTF: the core is complete, extensions are declared, triangles index vertices.
    let json = json_of_glb(&std::fs::read(home.path().join("a.glb")).unwrap());
    let material = &json["materials"][0];
    let core = &material["pbrMetallicRoughness"];
    assert_eq!(core["baseColorFactor"].as_array().unwrap().len(), 4);
    assert_eq!(material["extras"]["simulated"], true);
    let used: Vec<&str> = json["extensionsUsed"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|e| e.as_str())
        .collect();
    let own = material["extensions"].as_object();
    assert_eq!(own.map_or(0, serde_json::Map::len), used.len());
    assert!(
        used.iter()
            .all(|extension| own.unwrap().contains_key(*extension)),
        "{used:?}"
    );
    let error = |key: &str| material["extras"][key].as_f64();
    assert!(error("environmentError").unwrap() > 0.0);

    // Blender: the sockets of the Principled BSDF since 4.0.
    let script = std::fs::read_to_string(home.path().join("a.py")).unwrap();
    for socket in [
        "Specular IOR Level",
        "Coat Weight",
        "Sheen Tint",
        "Specular Tint",
    ] {
        assert!(script.contains(&format!("\"{socket}\": ")), "{socket}");
    }
}

/// A dictionary's name is text, whatever it holds.
#[test]
fn names_from_outside_break_no_file() {
    let home = tempfile::tempdir().unwrap();
    let fit = home.path().join("fit");
    write_fit(&fit);
    let file = fit.join("fit.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let named = text.replace(
        "dictionary = \"paper42\"",
        "dictionary = \"red---v2 ---> \\u0001 \\\" \\n --\"",
    );
    assert_ne!(text, named);
    std::fs::write(&file, named).unwrap();
    for (format, name) in [
        ("openpbr", "a.mtlx"),
        ("blender", "a.py"),
        ("merl", "a.binary"),
    ] {
        let done = rig(
            &["export", "fit", "--format", format, "--out", name],
            home.path(),
        );
        assert!(done.status.success(), "{}", stderr(&done));
    }
    let read = |name: &str| std::fs::read_to_string(home.path().join(name)).unwrap();
    let xml = read("a.mtlx");
    assert_eq!(elements(&xml)[0].0, "materialx");
    let script = read("a.py");
    let note = script
        .lines()
        .find(|line| line.starts_with("NOTE = "))
        .unwrap();
    assert!(note.contains("red---v2 ---> \\\\u{1} \\\" --"), "{note}");
    for text in [xml, script, read("a.binary.txt")] {
        let is_bad = |c: char| c.is_control() && c != '\n';
        assert!(text.contains("red-") && !text.contains(is_bad));
    }
}

/// What no model can hold is one line with advice, and no file.
#[test]
fn a_black_material_is_not_exported() {
    let home = tempfile::tempdir().unwrap();
    let done = rig(
        &["brdf", "convert", "lambertian:0", "--out", "x.glb"],
        home.path(),
    );
    assert_eq!(done.status.code(), Some(1));
    let said = stderr(&done);
    assert!(
        said.contains("nothing to export: the BRDF reflects nothing"),
        "{said}"
    );
    assert!(said.contains("set the base colour to 0"), "{said}");
    assert!(!home.path().join("x.glb").exists());
}

#[test]
fn a_fit_is_exported_and_its_files_are_named() {
    let home = tempfile::tempdir().unwrap();
    write_fit(&home.path().join("fit"));
    let done = rig(
        &["export", "fit", "--format", "mitsuba", "--out", "a.xml"],
        home.path(),
    );
    assert!(done.status.success(), "{}", stderr(&done));
    assert_eq!(done.stdout, b"a.xml\n");
    assert!(stderr(&done).contains("simulated bench"));
    let xml = std::fs::read_to_string(home.path().join("a.xml")).unwrap();
    assert!(xml.contains("SIMULATED") && xml.contains("blendbsdf"));
    let done = rig(&["export", "fit", "--format", "json"], home.path());
    assert_eq!(done.stdout, b"brdf.json\n");
    let done = rig(&["export", "fit", "--format", "pbrt"], home.path());
    assert_eq!(done.stdout, b"brdf.pbrt\nbrdf.spectral.bsdf\n");
    let text = std::fs::read_to_string(home.path().join("brdf.pbrt")).unwrap();
    assert!(text.contains("\"brdf.spectral.bsdf\""), "{text}");
    let done = rig(&["export", "fit", "--format", "rgl"], home.path());
    assert_eq!(done.stdout, b"brdf.bsdf\n");
}

/// Also as the estimate of other commands, by the folder alone.
#[test]
fn a_fit_is_a_brdf_by_its_folder() {
    let home = tempfile::tempdir().unwrap();
    write_fit(&home.path().join("fit"));
    std::fs::write(
        home.path().join("angles.csv"),
        "theta_i_deg,theta_o_deg,phi_deg\n30,20,120\n",
    )
    .unwrap();
    let eval = |brdf: &str| {
        let arguments = ["brdf", "eval", "--brdf", brdf, "--angles", "angles.csv"];
        let done = rig(&arguments, home.path());
        assert!(done.status.success(), "{}", stderr(&done));
        String::from_utf8(done.stdout).unwrap()
    };
    // Without discrepancy, it is the mixture of its weights.
    assert_eq!(eval("fit"), eval("paper42:fit/weights.csv"));
}

/// (what is done to the fit, arguments, what the error says)
#[test]
fn failures_are_one_line_and_a_hint() {
    let home = tempfile::tempdir().unwrap();
    write_fit(&home.path().join("broken"));
    let weights = home.path().join("broken/weights.csv");
    let text = std::fs::read_to_string(&weights)
        .unwrap()
        .replace("0.35", "x");
    std::fs::write(&weights, text).unwrap();
    std::fs::create_dir(home.path().join("empty")).unwrap();
    write_fit(&home.path().join("whole"));
    let kept = std::fs::read(home.path().join("whole/fit.toml")).unwrap();
    let cases: &[(&[&str], &str)] = &[
        (
            &["export", "broken", "--format", "json"],
            "weights.csv, line 4: weight_g: \"x\" is not a number",
        ),
        (
            &["export", "empty", "--format", "json"],
            "empty holds no fit",
        ),
        (
            &["export", "broken", "--format", "pdf"],
            "possible values: json, merl, rgl, rgl-spectral, mitsuba, pbrt",
        ),
        (&["report", "empty"], "empty is not a session"),
        (
            &["brdf", "check", "empty"],
            "give the folder that `rig fit --out` wrote, or a session",
        ),
        (
            &words("export whole --format merl --out whole/fit.toml"),
            "whole/fit.toml: the name of such a file ends in .binary",
        ),
        (&["bench", "--only", "nothing"], "no case's name holds"),
    ];
    for (arguments, expected) in cases {
        let failed = rig(arguments, home.path());
        let text = stderr(&failed);
        assert_eq!(failed.status.code(), Some(1), "{arguments:?}: {text}");
        assert!(
            text.starts_with("error: ") && text.contains(expected),
            "{arguments:?}: {text}"
        );
        assert!(text.contains("\n\nhint: "), "{arguments:?}: {text}");
    }
    let left = std::fs::read(home.path().join("whole/fit.toml")).unwrap();
    assert_eq!(left, kept);
}
