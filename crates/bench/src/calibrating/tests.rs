use std::cell::Cell;
use std::path::{Path, PathBuf};

use super::*;
use crate::calibration::Library;
use crate::calibration::mirror_sphere::outline::Stated;
use crate::calibration::record::{FlatValues, Measured, ScaleValues, SensorValues};
use crate::calibration::slanted_edge::EdgeError;
use crate::capture::open::OpenOptions;
use crate::config::{BUILT_IN, Origin, ResolvedRig, RigConfig};

/// Nobody; counts.
#[derive(Default)]
struct Counting(Cell<[u64; 2]>);

impl Attendant for Counting {
    fn cover(&self, _: bool) -> bool {
        false
    }
    fn switch(&self, _: bool) -> bool {
        false
    }
    fn progress(&self, done: u64, of: u64) {
        self.0.set([done, of]);
    }
}

fn simulated(folder: &Path) -> ResolvedRig {
    let text = BUILT_IN[0].1;
    ResolvedRig {
        config: RigConfig::parse("rig.toml", folder, text).unwrap(),
        origin: Origin::Argument,
        file: "rig.toml".to_owned(),
        folder: None,
    }
}

#[test]
fn a_flat_field_takes_the_sensor_record_measured_just_before() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = simulated(folder.path());
    rig.config.camera.resolution_px = [48, 40];
    if let Some(simulation) = &mut rig.config.simulation {
        simulation.sensor.resolution_px = [48, 40];
    }
    let mut place = Place::of_rig(&rig, Some(folder.path()));
    assert!(!place.instead_of_built_in);
    place.check().unwrap();
    let (attendant, open) = (Counting::default(), OpenOptions::default());
    let sensor = SensorRequest {
        rig: &rig.config,
        frames: 8,
        open: &open,
    };
    let sensor = sensor.measure(&attendant).unwrap();
    let [done, of] = attendant.0.get();
    assert_eq!(done, of);
    let kept = sensor.keep(&mut place).unwrap();
    assert!(kept.record.starts_with(folder.path().join("sensor")));

    let flat = FlatRequest {
        rig: &rig,
        frames: 8,
        ambient: false,
        radiance: Some(Measured::new(0.4, 0.002)),
        open: &open,
    };
    let flat = flat.measure(&place, &attendant).unwrap();
    let (_, scale, _) = flat.keep(&mut place).unwrap();
    assert!(scale.is_some());
    let library = Library::Folder(folder.path().to_owned());
    assert!(library.load::<SensorValues>(None).unwrap().is_some());
    assert!(library.load::<FlatValues>(None).unwrap().is_some());
    let scale = library.load::<ScaleValues>(None).unwrap().unwrap();
    let found = scale.record.values.responsivity_e_s;
    let truth = rig.config.simulation.unwrap().sensor.responsivity;
    assert!((found.value - truth).abs() < 5.0 * found.std, "{found:?}");
}

#[test]
fn what_cannot_be_measured_is_refused_before_devices_are_taken() {
    let folder = tempfile::tempdir().unwrap();
    let rig = simulated(folder.path());
    let lamp = LampRequest {
        rig: &rig.config,
        minutes: 2.0,
        interval_s: 1.0,
        burst: 16,
        channel: 9,
    };
    let refused = lamp.measure(&OpenOptions::default(), &Counting::default());
    let refused = refused.unwrap_err().to_string();
    assert_eq!(refused, "the lamp has no channel 9");
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let place = Place::of_rig(&rig, Some(&file));
    let refused = place.check().unwrap_err();
    assert!(matches!(refused, CalibratingError::Folder { .. }));
}

#[test]
fn images_that_are_not_of_the_rig_are_named() {
    let rig = simulated(Path::new(""));
    let input = [PathBuf::from("a.exr")];
    let spheres = SpheresRequest {
        rig: &rig,
        input: &input,
        outline: None,
        stated: Stated {
            radius_mm: 10.0,
            height_mm: 0.0,
        },
        near: &[],
        spheres: 1,
    };
    assert!(matches!(
        spheres.measure(&()),
        Err(CalibratingError::NoAngles)
    ));
    let edges = EdgesRequest {
        rig: &rig.config,
        input: &input,
        light: 0,
        regions: &[],
        heights_mm: &[1.0, 2.0],
        height_std_mm: 0.0,
    };
    let error = edges.measure().err().unwrap();
    assert!(
        matches!(error, CalibratingError::Focus(EdgeError::OneImage { .. })),
        "{error}"
    );
}
