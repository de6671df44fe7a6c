use proptest::prelude::*;

use super::*;
use crate::session::example::fit as sample;

fn written() -> (tempfile::TempDir, PathBuf) {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("fits/0");
    write(&folder, &sample(), &FitImages::default()).unwrap();
    (home, folder)
}

#[test]
fn record_and_images_come_back_as_they_were() {
    let home = tempfile::tempdir().unwrap();
    let mut image = RadianceImage::new(3, 2);
    image.mean[4] = [0.5, -0.25, 2.0];
    image.variance[4] = [0.01, 0.02, 0.03];
    let images = FitImages {
        rendered: vec![image.clone(), image.clone()],
        residual: vec![image.clone(), image],
        cells_csv: String::new(),
    };
    let folder = next_folder(home.path());
    assert_eq!(folder, home.path().join("fits/0"));
    write(&folder, &sample(), &images).unwrap();
    assert_eq!(read(&folder).unwrap(), sample());
    assert_eq!(read_images(&folder).unwrap(), images);
    let files = encode(&folder, &sample(), &images).unwrap();
    assert_eq!(decode(&files).unwrap(), (sample(), images));
    assert_eq!(next_folder(home.path()), home.path().join("fits/1"));
    let names: Vec<_> = std::fs::read_dir(home.path().join("fits"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert_eq!(names, ["0"], "no temporary folder is left");
}

#[test]
fn a_filled_folder_is_never_overwritten() {
    let (_home, folder) = written();
    let error = write(&folder, &sample(), &FitImages::default()).unwrap_err();
    assert!(matches!(error, FitRecordError::Exists { .. }), "{error}");
}

#[test]
fn what_is_not_a_fit_is_not_written() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("fit");
    let mut record = sample();
    record.weights[1][2] = f64::NAN;
    let error = write(&folder, &record, &FitImages::default()).unwrap_err();
    assert!(error.to_string().contains("weight_g"), "{error}");
    assert!(!folder.exists());
}

/// (file, text to replace, replacement, what the error must name)
const CORRUPTIONS: &[(&str, &str, &str, &str)] = &[
    ("fit.toml", "loss = 1.25", "loss = \"low\"", "loss"),
    ("fit.toml", "loss = 1.25", "", "loss"),
    ("fit.toml", "loss = 1.25", "loss = inf", "loss"),
    ("fit.toml", "format = 1", "format = 9", "format"),
    ("fit.toml", "seed = 7", "seed = -7", "seed"),
    ("fit.toml", "[settings]", "[settings", "settings"),
    ("weights.csv", "sd_b", "sd_x", "sd_b"),
    ("weights.csv", "0.05", "rough", "alpha"),
    ("weights.csv", "0.7", "0.9", "weight_g"),
    ("weights.csv", "0.7", "-0.7", "weight_g"),
    ("weights.csv", "black,", "black,,", "row"),
    ("table.csv", "45.0,30.0", "45.0,31.0", "theta_d_deg"),
    ("table.csv", "45.0,60.0,", "45.0,60.0,1e999,", "row"),
    ("table.csv", "true", "perhaps", "constrained"),
    ("table.csv", "45.0,", "95.0,", "theta_h_deg"),
    ("trace.csv", "0.125", "soon", "seconds"),
    (
        "fit.toml",
        "discrepancy = 0.35",
        "discrepancy = -1.0",
        "discrepancy",
    ),
    ("discrepancy.csv", "ln_factor_g", "g", "ln_factor_g"),
    ("discrepancy.csv", ",0.1,", ",60.0,", "ln_factor_r"),
    ("discrepancy.csv", "1.0,12.0", "1.0,13.0", "theta_d_deg"),
    (
        "discrepancy.csv",
        "82.0,88.0,0.1,-0.2,0.0,0.0,0.0,0.0\n",
        "",
        "rows",
    ),
];

const FILES: [&str; 5] = [
    "fit.toml",
    "weights.csv",
    "table.csv",
    "trace.csv",
    "discrepancy.csv",
];

#[test]
fn a_corrupted_file_is_named_with_its_key() {
    for (file, from, to, key) in CORRUPTIONS {
        let (_home, folder) = written();
        let path = folder.join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{file} has no {from:?}");
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let error = read(&folder).expect_err(to).to_string();
        assert!(
            error.contains(file) && error.contains(key),
            "{from} -> {to}: {error}"
        );
        assert!(!error.contains('\n'), "one line: {error}");
    }
    for file in FILES {
        let (_home, folder) = written();
        std::fs::remove_file(folder.join(file)).unwrap();
        let error = read(&folder).expect_err(file).to_string();
        assert!(error.contains(file), "{file} missing: {error}");
    }
}

#[test]
fn posterior_samples_are_an_array_of_numpy() {
    let (_home, folder) = written();
    let path = folder.join("posterior.npy");
    let bytes = std::fs::read(&path).unwrap();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3, 3), }";
    assert_eq!(&bytes[10..10 + header.len()], header.as_bytes());
    assert_eq!((bytes.len() - 2 * 3 * 3 * 4) % 64, 0);

    let sampled = read(&folder).unwrap().sampled_materials(16).unwrap();
    assert_eq!(sampled.len(), 2);
    assert_eq!(sampled[1].mixture.weights()[2], [0.5, 0.25, 0.25]);

    for bad in [&b"text"[..], &bytes[..bytes.len() - 1], &bytes[..20]] {
        std::fs::write(&path, bad).unwrap();
        let error = read(&folder).unwrap_err().to_string();
        assert!(error.contains("posterior.npy"), "{error}");
    }
    // A fit of an earlier version has none.
    std::fs::remove_file(&path).unwrap();
    let toml = folder.join("fit.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    std::fs::write(&toml, text.replace("posterior_samples = 2\n", "")).unwrap();
    let old = read(&folder).unwrap();
    assert!(old.sampled_materials(16).unwrap().is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_valid_record_survives_the_disk(
        raw in prop::collection::vec((1e-12f64..1.0, 0.0f64..1e3, 1e-4f64..1.0), 1..12),
        loss in -1e300f64..1e300,
        termination in "\\PC{0,40}",
        chi2 in prop::collection::vec(prop::array::uniform3(0.0f64..1e9), 0..5),
        values in prop::collection::vec(prop::array::uniform3(0.0f64..1e30), 6),
        scored in any::<bool>(),
        departs in any::<bool>(),
        seed in 0u64..=i64::MAX as u64,
    ) {
        let mut record = sample();
        let sum: f64 = raw.iter().map(|(weight, ..)| weight).sum();
        record.atoms = raw.iter().enumerate().map(|(index, (_, _, alpha))| AtomRecord {
            index, kind: "ggx".to_owned(), alpha: Some(*alpha), eta: Some(1.5), albedo: None,
        }).collect();
        for channel in 0..3 {
            record.weights[channel] = raw.iter().map(|(weight, ..)| weight / sum).collect();
            record.weight_deviations[channel] = raw.iter().map(|(_, sd, _)| *sd).collect();
        }
        record.posterior = None;
        record.loss = loss;
        record.termination = termination;
        record.reduced_chi_square = chi2;
        record.settings.seed = seed;
        for (cell, value) in record.table.cells.iter_mut().zip(values) {
            cell.value = value;
            cell.constrained = value[0] > 1.0;
        }
        if !scored { record.score = None; }
        if !departs { record.discrepancy = None; }
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("fit");
        write(&folder, &record, &FitImages::default()).unwrap();
        prop_assert_eq!(read(&folder).unwrap(), record);
    }

    #[test]
    fn arbitrary_text_never_panics(text in "\\PC{0,200}", file in prop::sample::select(&FILES[..])) {
        let (_home, folder) = written();
        std::fs::write(folder.join(file), text).unwrap();
        let _ = read(&folder);
    }
}
