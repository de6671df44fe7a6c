//! `rig export` and `rig report` on folders: what they print, where they fail.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use rig::brdf::Dictionary;
use rig::session::fit_record::{self, AngleTable, AtomRecord, FitImages, FitRecord, FitSettings};

fn rig(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rig"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn write_fit(folder: &Path) {
    let dictionary = Dictionary::paper42();
    let atoms = dictionary.atoms();
    let channel = |gloss: usize, share: f64| {
        let mut weights = vec![0.0; atoms.len()];
        (weights[gloss], weights[4], weights[40], weights[41]) = (share, 0.1, 0.3, 0.6 - share);
        weights
    };
    let record = FitRecord {
        simulated: true,
        dictionary: dictionary.name().to_owned(),
        atoms: (0..atoms.len())
            .map(|n| AtomRecord::new(n, &atoms[n]))
            .collect(),
        weights: [channel(6, 0.5), channel(2, 0.35), channel(10, 0.6)],
        weight_deviations: [(); 3].map(|()| vec![0.01; atoms.len()]),
        settings: FitSettings {
            optimizer: "gauss-newton".to_owned(),
            samples_per_pixel: 64,
            max_reflections: 16,
            seed: 3,
            kernel: "portable".to_owned(),
            ..FitSettings::default()
        },
        loss: 1.0,
        reduced_chi_square: vec![[1.0; 3]],
        truncation_remainder: Vec::new(),
        outlier_fraction: Vec::new(),
        discrepancy: None,
        termination: "converged".to_owned(),
        trace: Vec::new(),
        timings: Vec::new(),
        versions: BTreeMap::new(),
        score: None,
        table: AngleTable::default(),
        warnings: Vec::new(),
        remarks: Vec::new(),
        bench: None,
        budget: None,
    };
    fit_record::write(folder, &record, &FitImages::default()).unwrap();
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
            &[
                "export",
                "whole",
                "--format",
                "merl",
                "--out",
                "whole/fit.toml",
            ],
            "whole/fit.toml: what is written here ends in .binary",
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
