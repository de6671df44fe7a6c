use super::*;
use crate::calibration::record::{FlatValues, MapFile, Measured, ScaleValues, Settings};
use crate::config::{Surroundings, resolve_rig};

fn header<V: Values>(id: &str, date: &str, values: V) -> Record<V> {
    Record {
        id: id.into(),
        kind: V::KIND,
        rig: "arm".into(),
        device_serial: "S1".into(),
        date: date.into(),
        valid_until: None,
        method: "white reference".into(),
        source: "a test".into(),
        settings: Settings {
            gain: Some(2.0),
            ..Settings::default()
        },
        values,
    }
}

fn scale(id: &str, date: &str, value: f64) -> Record<ScaleValues> {
    let responsivity_e_s = Measured { value, std: 3.0 };
    header(id, date, ScaleValues { responsivity_e_s })
}

fn library() -> (tempfile::TempDir, Library) {
    let folder = tempfile::tempdir().unwrap();
    let library = Library::Folder(folder.path().to_owned());
    (folder, library)
}

#[test]
fn what_was_added_is_loaded_and_the_newest_wins() {
    let (_folder, library) = library();
    assert!(library.load::<ScaleValues>(None).unwrap().is_none());
    let newer = scale("b", "2026-11-21T00:00:00Z", 2e6);
    let older = scale("c", "2026-11-20T23:00:00Z", 1e6);
    library.add(&newer, &[]).unwrap();
    library.add(&older, &[]).unwrap();
    let loaded = library.load::<ScaleValues>(None).unwrap().unwrap();
    assert_eq!(loaded.record, newer);
    assert_eq!(loaded.sha256, sha256_hex(&loaded.files[0].1));
    let named = library.load::<ScaleValues>(Some("c")).unwrap().unwrap();
    assert_eq!(named.record, older);
    assert!(matches!(
        library.load::<ScaleValues>(Some("d")),
        Err(RecordError::NotFound { .. })
    ));
    assert!(matches!(
        library.add(&older, &[]),
        Err(RecordError::Exists { .. })
    ));
}

#[test]
fn maps_are_checked_against_their_sha256() {
    let (folder, library) = library();
    let map = MapFile {
        file: "f.png".into(),
        sha256: sha256_hex(b"pixels"),
    };
    let flat = FlatValues {
        map,
        response_per_count: 1.0 / 32768.0,
        std: 0.001,
        ambient: None,
    };
    let record = header("f", "2026-11-21T00:00:00Z", flat);
    library.add(&record, &[("f.png", b"pixels")]).unwrap();
    let loaded = library.load::<FlatValues>(None).unwrap().unwrap();
    assert_eq!(loaded.files[1], ("f.png".to_owned(), b"pixels".to_vec()));
    std::fs::write(folder.path().join("flat/f.png"), b"pixles").unwrap();
    assert!(matches!(
        library.load::<FlatValues>(None),
        Err(RecordError::Checksum { .. })
    ));
    std::fs::remove_file(folder.path().join("flat/f.png")).unwrap();
    assert!(matches!(
        library.load::<FlatValues>(None),
        Err(RecordError::Io { .. })
    ));
}

#[test]
fn bad_records_name_the_key() {
    let (folder, library) = library();
    library
        .add(&scale("s", "2026-11-21T00:00:00Z", 1e6), &[])
        .unwrap();
    let path = folder.path().join("scale/s.toml");
    let good = std::fs::read_to_string(&path).unwrap();
    for (from, to, expected) in [
        (
            "value = 1000000.0",
            "value = -1.0",
            "`values.responsivity_e_s.value` is -1",
        ),
        (
            "std = 3.0",
            "std = nan",
            "`values.responsivity_e_s.std` is NaN",
        ),
        ("id = \"s\"", "id = \"t\"", "`id` is t"),
        (
            "kind = \"scale\"",
            "kind = \"flat\"",
            "`kind` is flat, but must be scale",
        ),
        ("2026-11-21", "2026-13-21", "`date` is 2026-13-21T00:00:00Z"),
        ("rig = ", "rug = ", "unknown field `rug`"),
    ] {
        assert!(good.contains(from), "{from} in {good}");
        std::fs::write(&path, good.replace(from, to)).unwrap();
        let error = library.load::<ScaleValues>(None).unwrap_err().to_string();
        assert!(error.contains(expected), "{to}: {error}");
    }
}

#[test]
fn a_record_of_another_camera_or_gain_is_refused() {
    let (_folder, library) = library();
    library
        .add(&scale("s", "2026-11-21T00:00:00Z", 1e6), &[])
        .unwrap();
    let loaded = library.load::<ScaleValues>(None).unwrap().unwrap();
    let surroundings = Surroundings {
        environment: None,
        folder: "/nowhere".into(),
    };
    let rig = resolve_rig(Some("simulated"), &surroundings, Vec::new).unwrap();
    let mut camera = rig.config.camera;
    camera.gain = 2.0;
    assert!(loaded.check_camera("S1", &camera).is_ok());
    assert!(loaded.check_camera("", &camera).is_ok());
    let error = loaded.check_camera("S2", &camera).unwrap_err().to_string();
    assert!(error.contains("S1") && error.contains("S2"), "{error}");
    camera.gain = 1.0;
    let error = loaded.check_camera("S1", &camera).unwrap_err().to_string();
    assert_eq!(error, "s belongs to gain 2, the rig has 1");
}

/// The simulated rig with a record of one kind beside its file still has the others.
#[test]
fn built_in_records_stand_in_for_kinds_that_a_folder_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let library = Library::Before(folder.path().to_owned(), built_in::SIMULATED);
    let built_in = Library::BuiltIn(built_in::SIMULATED);
    let ids = |library: &Library, kind| library.ids(kind).unwrap();
    assert_eq!(ids(&library, Kind::Scale), ids(&built_in, Kind::Scale));
    library
        .add(&scale("own", "2020-01-01T00:00:00Z", 1e6), &[])
        .unwrap();
    assert_eq!(ids(&library, Kind::Scale), ["own"]);
    let newest = library.load::<ScaleValues>(None).unwrap().unwrap();
    assert_eq!(newest.record.id, "own");
    assert_eq!(ids(&library, Kind::Flat), ids(&built_in, Kind::Flat));
    assert!(library.load::<FlatValues>(None).unwrap().is_some());
}

/// Every built-in record is valid.
#[test]
fn built_in_records_load() {
    use crate::calibration::record::{LightsValues, SensorValues};
    let library = Library::BuiltIn(built_in::SIMULATED);
    for id in library.ids(Kind::Sensor).unwrap() {
        library.load::<SensorValues>(Some(&id)).unwrap();
    }
    for id in library.ids(Kind::Flat).unwrap() {
        library.load::<FlatValues>(Some(&id)).unwrap();
    }
    for id in library.ids(Kind::Scale).unwrap() {
        library.load::<ScaleValues>(Some(&id)).unwrap();
    }
    for id in library.ids(Kind::Lights).unwrap() {
        library.load::<LightsValues>(Some(&id)).unwrap();
    }
}
